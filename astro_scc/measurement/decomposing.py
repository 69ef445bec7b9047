# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The decomposition of all epochs of a cube."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from astro_scc.correlation.workers import in_order
from astro_scc.decomposition import Decomposer

__all__ = ["LazyDecompositions", "decompose_epochs", "noise_facts"]


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
