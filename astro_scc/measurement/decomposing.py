# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The decomposition of all epochs of a cube."""

from dataclasses import replace

import numpy as np

from astro_scc.correlation.parallel import in_order
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.progress import progress

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
    tuple of ``Decomposition``
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
