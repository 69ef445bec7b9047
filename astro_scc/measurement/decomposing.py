# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The decomposition of all epochs of a cube."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np

from astro_scc.correlation.correlate import COMPILE_FROM, STACK_BYTES
from astro_scc.correlation.parallel import in_order, machine_memory
from astro_scc.decomposition import SSPs
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.progress import progress

#: Bytes of this package and its libraries in each process.
LIBRARIES = 250e6
#: Most bytes of the maps that a stack keeps and of what is made from them.
STACK = 500e6
#: Average bytes of the matches and displacements from one window.
WINDOW = 500.0
#: Blocks of work in memory for each process.
BLOCKS = 3
#: Images in double precision that a decomposition needs besides the planes.
IMAGES = 8
#: Processor seconds for each pixel of a plane that is made, and of a window that is
#: correlated by transforms or compiled loops (``benchmarks/scaling.py estimate``).
PLANE_PIXEL, WINDOW_PIXEL, COMPILED_PIXEL = 4e-7, 1.1e-7, 0.7e-7
#: Epochs from which the number of SSPs of all is estimated.
SAMPLE = 3
#: Apparent noise is structure if more than this share of it is in other epochs too...
SHARED = 0.5
#: ... and more than this many times the share by chance.  The largest correlation of
#: noise at any displacement is five times chance, seldom eight.
BEYOND_CHANCE = 6.0
#: Pairs of epochs examined; most must show structure, as one epoch may be there twice.
PAIRS = 3


def allow_for_structure(cube, decomposer):
    """
    Return a decomposer that does not take structure for noise.

    The noise of a plane is measured where the plane looks like empty sky.
    If a texture fills the images, there is no empty sky, and no pattern
    stands out from the texture.  Consecutive epochs share structure, though
    not its position, but no noise: their `shared_variance` separates the two.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`

    Returns
    -------
    `~astro_scc.decomposition.Decomposer`
        The same, or one with ``noise_factors``: the square root of the share
        of each plane's variance that epochs do not have in common.

    Warns
    -----
    `~astro_scc.exceptions.MeasurementWarning`
        If the decomposer needs ``noise_factors``.
    """
    if decomposer.noise == "propagated" or len(cube) < 2:
        return decomposer
    starts = np.unique(np.linspace(0, len(cube) - 2, PAIRS).astype(int))
    most = len(starts) // 2 + 1
    shares = []
    for left, k in zip(range(len(starts))[::-1], starts, strict=True):
        data, masks = cube.data[k : k + 2], cube.mask[k : k + 2]
        share, chance = decomposer.shared_variance(data, masks=masks)
        real = share > np.maximum(SHARED, BEYOND_CHANCE * chance)
        shares.append(np.where(real, share, 0.0))
        if np.count_nonzero(shares, axis=0).max() + left < most:
            return decomposer
    share = np.sort(shares, axis=0)[-most]
    full = share > 0
    scales = ", ".join(f"{scale:g}" for scale in np.array(decomposer.scales)[full])
    warn(
        f"the images are full of structure on scale {scales}: {share[full].min():.0%} "
        "or more of what looks like noise in one epoch is in others too and is not "
        "taken for noise; noise='propagated' takes the noise that the epochs are given "
        "instead",
        MeasurementWarning,
    )
    return replace(decomposer, noise_factors=tuple(np.sqrt(1 - share).tolist()))


def working_memory(cube, decomposer, n_workers, *, n_windows=0):
    """
    Estimate the memory that a measurement takes on this machine.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    n_workers : int, str or `dask.distributed.Client`
        The workers of a scheduler are assumed to run elsewhere.
    n_windows : int, optional
        Number of SSPs times the number of epochs that each is correlated with.

    Returns
    -------
    float
        In bytes.
    """
    n, pixels = len(cube), float(np.prod(cube.shape[1:]))
    scales = len(decomposer.scales)
    images = cube.data.nbytes + cube.mask.nbytes
    planes = 4 * n * scales * pixels
    if decomposer.noise == "local":
        planes *= 3
    processes = n_workers if isinstance(n_workers, int) else 0
    work = planes + processes * 8 * (scales + IMAGES) * pixels
    if processes > 1:
        work += processes * (LIBRARIES + BLOCKS * min(STACK_BYTES, planes))
    return LIBRARIES + images + WINDOW * n_windows + max(work, STACK)


def matching_time(cube, decomposer, reach, *, region=None, n_targets=None):
    """
    Estimate the time that decomposing and correlating take on one core.

    The SSPs of all epochs are estimated from those of three.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    reach : sequence of int
        Largest displacement in pixels along (y, x).
    region : optional
        Anything that ``cube.region_mask`` takes.
    n_targets : int, optional
        Epochs that each is correlated with, by default all others.

    Returns
    -------
    seconds : float
    n_ssps : float
        SSPs of all epochs in the region.
    """
    n = len(cube)
    n_targets = n - 1 if n_targets is None else min(n_targets, n - 1)
    sample = np.unique(np.linspace(0, n - 1, SAMPLE).astype(int))
    ssps, inside = ssps_inside(decompose_epochs(cube[sample], decomposer), cube, region)
    pixels = sum(
        _window_pixels(ssps.bbox[of_scale], inside[of_scale], reach)
        for of_scale in (ssps.scale == scale for scale in np.unique(ssps.scale))
    )
    of_all = n / len(sample)
    compiled = find_spec("numba") and of_all * inside.sum() * n_targets > COMPILE_FROM
    each = COMPILED_PIXEL if compiled else WINDOW_PIXEL
    seconds = of_all * n_targets * pixels * each
    planes = float(cube.data.size) * len(decomposer.scales)
    return seconds + PLANE_PIXEL * planes, of_all * float(inside.sum())


def _window_pixels(boxes, inside, reach):
    """Return the pixels of the windows of the SSPs of one scale that are inside."""
    low, high, reach = boxes[:, :2], boxes[:, 2:], np.asarray(reach) + 1
    # A window ends where no SSP of the scale can be reached.
    start = np.maximum(low - reach, low.min(axis=0) - (high - low))
    end = np.minimum(high + reach, high.max(axis=0) + (high - low))
    return float(np.prod(end - start, axis=1, dtype=float)[inside].sum())


def refuse_too_much(cube, decomposer, n_workers, *, n_windows=0):
    """
    Refuse a measurement that this machine cannot hold in memory.

    Parameters
    ----------
    cube, decomposer, n_workers, n_windows
        See `working_memory`.

    Raises
    ------
    MemoryError
        If the measurement needs more memory than the machine has.
    """
    need = working_memory(cube, decomposer, n_workers, n_windows=n_windows)
    have = machine_memory()
    if need <= have:
        return
    ny, nx = cube.shape[1:]
    windows = f" with {n_windows:.2g} windows of SSPs" if n_windows else ""
    several = isinstance(n_workers, int) and n_workers > 1
    workers = f" with {n_workers} workers" if several else ""
    raise MemoryError(
        f"{len(cube)} epochs of {nx} x {ny} pixels on {len(decomposer.scales)} "
        f"scales{windows} take about {need / 1e9:.2g} GB{workers}, this machine has "
        f"{have / 1e9:.2g}; a part of the images (--crop), fewer scales"
        f"{', a region' * bool(windows)}{' or fewer workers' * several} take less"
    )


def decompose_epochs(cube, decomposer, *, n_workers=1, progress_bar=False):
    """
    Decompose every epoch of a cube.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    n_workers : int, str or `dask.distributed.Client`, optional
        See `~astro_scc.correlation.Correlator`; the unit of work is an epoch.
    progress_bar : bool, optional

    Returns
    -------
    tuple of `~astro_scc.decomposition.Decomposition`
    """
    facts = noise_facts(cube, decomposer)
    work = (
        (decomposer, image, cube.mask[k], *own)
        for k, (image, own) in enumerate(zip(cube.data, facts, strict=True))
    )
    found = []
    with progress(len(cube), "Decomposing", show=progress_bar) as done:
        for decomposition in in_order(_decompose, work, n_workers):
            found.append(decomposition)
            done(1)
    return tuple(found)


def noise_facts(cube, decomposer):
    """
    Return what the decomposition of each epoch needs besides its image and mask.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`

    Returns
    -------
    list of tuple
        The rms of each image and the covariance of its beam in pixels; None
        where it is not needed or not known.
    """
    propagated = decomposer.noise == "propagated"
    rms = cube.noise_rms().value if propagated else [None] * len(cube)
    covariances = [None] * len(cube)
    if propagated and cube.beams is not None:
        inverse = np.linalg.inv(cube.pixel_matrix.value)
        covariances = [inverse @ b.covariance.value @ inverse.T for b in cube.beams]
    return list(zip(rms, covariances, strict=True))


def _decompose(epoch):
    """Decompose one epoch, given as the arguments of one task."""
    decomposer, image, mask, rms, beam_covariance = epoch
    return decomposer(image, mask=mask, rms=rms, beam_covariance=beam_covariance)


def ssps_inside(decompositions, cube, region):
    """
    Return the SSPs of all epochs, and which of them have centroids in a region.

    Parameters
    ----------
    decompositions : sequence of `~astro_scc.decomposition.Decomposition`
    cube : `~astro_scc.epochs.EpochCube`
    region : optional
        Anything that ``cube.region_mask`` takes, or None for everything.

    Returns
    -------
    ssps : `~astro_scc.decomposition.SSPs`
    select : `~numpy.ndarray` of bool, shape (n_ssps,)
    """
    ssps = SSPs.of_epochs(decompositions)
    return ssps, centroids_inside(ssps, cube, region)


def centroids_inside(ssps, cube, region):
    """
    Return which SSPs have their centroid in a region.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
    cube : `~astro_scc.epochs.EpochCube`
    region : optional
        Anything that ``cube.region_mask`` takes, or None for everything.

    Returns
    -------
    `~numpy.ndarray` of bool, shape (n_ssps,)
    """
    if region is None:
        return np.ones(len(ssps), bool)
    inside, centroid = cube.region_mask(region), (ssps.y_centroid, ssps.x_centroid)
    pixel = np.rint(centroid).astype(int).T
    return inside[tuple(np.clip(pixel, 0, np.array(inside.shape) - 1).T)]
