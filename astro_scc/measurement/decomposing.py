# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The decomposition of all epochs of a cube."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from astro_scc.correlation.correlate import STACK_BYTES
from astro_scc.correlation.parallel import in_order
from astro_scc.exceptions import MeasurementWarning

#: Bytes of this package with the libraries that it works with, in each process.
LIBRARIES = 250e6
#: Bytes of maps that a stack keeps, and what is made of them, at most.
STACK = 500e6
#: Bytes of what comes from one window, on average: matches and displacements.
WINDOW = 500.0
#: Blocks of work that are in memory for each process.
BLOCKS = 3
#: Images in double precision, beside the planes, that a decomposition works with.
IMAGES = 8
#: So much of what looks like noise in one epoch must be in others too...
SHARED = 0.5
#: ... and so many times what noise has in common by chance.  The largest of a noise's
#: correlations at all displacements is five times that, seldom eight.
BEYOND_CHANCE = 6.0
#: Most of so many pairs of epochs must show it: one epoch may be there twice.
PAIRS = 3


def allow_for_structure(cube, decomposer):
    """
    A decomposer that does not take structure for noise.

    The noise of a plane is measured in the plane, in what looks like empty
    sky.  Where a texture fills the images there is none, and no pattern
    stands out from the texture itself.  Noise is not the same in two
    epochs, structure is, but for where it is: by `shared_variance` of pairs
    of epochs that follow one another the noise is separated from it.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`

    Returns
    -------
    `~astro_scc.decomposition.Decomposer`
        The same, or with ``noise_factors``, the root of the share of each
        plane's variance that epochs have not in common.

    Warns
    -----
    `~astro_scc.exceptions.MeasurementWarning`
        If there are any.
    """
    if decomposer.noise == "propagated" or len(cube) < 2:
        return decomposer
    starts = np.unique(np.linspace(0, len(cube) - 2, PAIRS).astype(int))
    most = len(starts) // 2 + 1
    shares = []
    for left, k in zip(range(len(starts))[::-1], starts, strict=True):
        pair = slice(k, k + 2)
        share, chance = decomposer.shared_variance(
            cube.data[pair], masks=cube.mask[pair]
        )
        real = share > np.maximum(SHARED, BEYOND_CHANCE * chance)
        shares.append(np.where(real, share, 0.0))
        if np.count_nonzero(shares, axis=0).max() + left < most:
            return decomposer
    share = np.sort(shares, axis=0)[-most]
    full = share > 0
    if not full.any():
        return decomposer
    scales = ", ".join(f"{scale:g}" for scale in np.array(decomposer.scales)[full])
    warnings.warn(
        f"the images are full of structure on scale {scales}: {share[full].min():.0%} "
        "or more of what looks like noise in one epoch is in others too and is not "
        "taken for noise; noise='propagated' takes the noise that the epochs are given "
        "instead",
        MeasurementWarning,
        stacklevel=4,
    )
    return replace(decomposer, noise_factors=tuple(np.sqrt(1 - share).tolist()))


def working_memory(cube, decomposer, n_workers, *, n_windows=0):
    """
    About how many bytes a measurement takes on this machine.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    n_workers : int, str or `dask.distributed.Client`
        The workers of a scheduler are taken to be elsewhere.
    n_windows : int, optional
        SSPs times epochs that each is correlated with.

    Returns
    -------
    float
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


def refuse_too_much(cube, decomposer, n_workers, *, n_windows=0):
    """
    Refuse what the machine cannot hold, before it comes to a standstill.

    Parameters
    ----------
    cube, decomposer, n_workers, n_windows
        See `working_memory`.

    Raises
    ------
    MemoryError
        If it is more than the machine has.
    """
    from astro_scc.correlation.parallel import machine_memory

    need = working_memory(cube, decomposer, n_workers, n_windows=n_windows)
    have = machine_memory()
    if need <= have:
        return
    ny, nx = cube.shape[1:]
    what = f"{len(cube)} epochs of {nx} x {ny} pixels"
    what += f" on {len(decomposer.scales)} scales"
    less = "a part of the images (--crop), fewer scales"
    if n_windows:
        what += f" with {n_windows:.2g} windows of SSPs"
        less += ", a region"
    with_workers = ""
    if isinstance(n_workers, int) and n_workers > 1:
        with_workers = f" with {n_workers} workers"
        less += " or fewer workers"
    raise MemoryError(
        f"{what} take about {need / 1e9:.2g} GB{with_workers}, this machine has "
        f"{have / 1e9:.2g}; {less} take less"
    )


def decompose_epochs(cube, decomposer, *, n_workers=1):
    """
    Decompose every epoch of a cube.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    n_workers : int, str or `dask.distributed.Client`, optional
        See `~astro_scc.correlation.Correlator`; the unit of work is an epoch.

    Returns
    -------
    tuple of `~astro_scc.decomposition.Decomposition`
    """
    facts = noise_facts(cube, decomposer)
    work = (
        (decomposer, image, cube.mask[k], *own)
        for k, (image, own) in enumerate(zip(cube.data, facts, strict=True))
    )
    return tuple(in_order(_decompose, work, n_workers))


class LazyDecompositions(Sequence):
    """
    The decompositions of epochs, each made when it is asked for.

    Planes of a hundred large images are more than matches, stacks and errors
    take together, and none of these needs them.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    """

    def __init__(self, cube, decomposer):
        self.cube, self.decomposer = cube, decomposer
        self._made = {}

    @property
    def scales(self):
        """Numbers of the scales."""
        return self.decomposer.scales

    def __len__(self):
        return len(self.cube)

    def __getitem__(self, index):
        if isinstance(index, slice):
            return tuple(self[k] for k in range(*index.indices(len(self))))
        k = range(len(self))[index]
        if k not in self._made:
            facts = noise_facts(self.cube, self.decomposer)[k]
            self._made[k] = _decompose(
                (self.decomposer, self.cube.data[k], self.cube.mask[k], *facts)
            )
        return self._made[k]


def noise_facts(cube, decomposer):
    """
    What the decomposition of each epoch takes besides its image and mask.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`

    Returns
    -------
    list of tuple
        The rms of the image and the covariance of its beam in pixels, or
        None.
    """
    propagated = decomposer.noise == "propagated"
    rms = cube.noise_rms().value if propagated else [None] * len(cube)
    covariances = [None] * len(cube)
    if propagated and cube.beams is not None:
        inverse = np.linalg.inv(cube.pixel_matrix.value)
        covariances = [inverse @ b.covariance.value @ inverse.T for b in cube.beams]
    return list(zip(rms, covariances, strict=True))


def _decompose(epoch):
    """Decompose one epoch, given as a piece of work."""
    decomposer, image, mask, rms, beam_covariance = epoch
    return decomposer(image, mask=mask, rms=rms, beam_covariance=beam_covariance)
