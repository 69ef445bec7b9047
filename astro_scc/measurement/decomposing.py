# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The decomposition of all epochs of a cube."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from astro_scc.correlation.workers import in_order
from astro_scc.decomposition import Decomposer
from astro_scc.exceptions import MeasurementWarning

__all__ = [
    "LazyDecompositions",
    "allow_for_structure",
    "decompose_epochs",
    "noise_facts",
]

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
    of epochs that follow one another the noise is told from it.

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
        _Epoch(decomposer, image, cube.mask[k], *own)
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
                _Epoch(self.decomposer, self.cube.data[k], self.cube.mask[k], *facts)
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


@dataclass(frozen=True, eq=False)
class _Epoch:
    """An epoch to decompose, as a piece of work."""

    decomposer: Decomposer
    image: np.ndarray
    mask: np.ndarray
    rms: float | None
    beam_covariance: np.ndarray | None


def _decompose(epoch):
    return epoch.decomposer(
        epoch.image,
        mask=epoch.mask,
        rms=epoch.rms,
        beam_covariance=epoch.beam_covariance,
    )
