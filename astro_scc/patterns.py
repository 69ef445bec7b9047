# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""From a cube to the significant structural patterns (SSPs) of its epochs."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.epochs import EpochCube
from astro_scc.epochs.registration import warn_of_misalignment
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.features import Features, find_features
from astro_scc.images.beam import different_beam
from astro_scc.parallel import Workers, in_order, progress

__all__ = ["DecomposedEpochs"]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class DecomposedEpochs:
    """
    Decomposed epochs: their SSPs, and the features that are followed through them.

    Attributes
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
        That of every epoch.
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    select : `~numpy.ndarray` of bool, shape (n_ssps,)
        The SSPs of the region.
    region : `~numpy.ndarray` of bool, shape (ny, nx), optional
        The pixels of the region; None for all.
    matches : `~astro_scc.paper.Matches`, optional
        Of the SSPs in other epochs, see `~astro_scc.StackedCrossCorrelation.match`.

    Examples
    --------
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=2, rng=1).cube
    >>> decomposed = StackedCrossCorrelation(scales=[2]).decompose(cube)
    >>> int(decomposed.select.sum()) == len(decomposed.ssps)
    True
    """

    cube: EpochCube
    decomposer: Decomposer
    ssps: SSPs
    select: np.ndarray
    region: np.ndarray | None = None
    matches: Any = None

    def __repr__(self):
        n, n_ssps = len(self.cube), np.count_nonzero(self.select)
        more = "" if self.matches is None else f", {len(self.matches)} matches"
        return f"<DecomposedEpochs: {n} epochs, {n_ssps} SSPs{more}>"

    @property
    def scales(self) -> tuple[float, ...]:
        """Numbers of the scales that were decomposed."""
        return tuple(self.decomposer.scales)

    @cached_property
    def _followed(self):
        """The features in a list, empty until they have been followed."""
        return []

    @property
    def features(self) -> Features:
        """
        The features that are followed from epoch to epoch.

        They are `~astro_scc.features.Features` of Gaussian models of the images or,
        without beams, of SSPs, inside the region.
        """
        return self.follow()

    def follow(self, *, n_workers: Workers = 1, progress_bar: bool = False) -> Features:
        """
        Return the `features`, which are found only once.

        Parameters
        ----------
        n_workers, progress_bar : optional
            See `~astro_scc.features.find_features`.

        Returns
        -------
        `~astro_scc.features.Features`
        """
        if not self._followed:
            self._followed.append(find_features(
                self.cube, ssps=self.ssps, region=self.region, n_workers=n_workers,
                progress_bar=progress_bar,
            ))  # fmt: skip
        return self._followed[0]


def check_cube(cube, common_beam):
    """Refuse what is no cube and beams that differ, warn of misalignment."""
    if not hasattr(cube, "beams"):
        raise TypeError(
            f"cube must be an EpochCube, got {type(cube).__name__}: read files by "
            "EpochCube.read"
        )
    if common_beam is not False and (k := different_beam(cube.beams)) is not None:
        raise ValueError(
            f"the beams differ, {cube.beams[0]} in {cube.labels[0]} and "
            f"{cube.beams[k]} in {cube.labels[k]}: give cube.to_common_beam(), "
            "or state common_beam=False to measure them as they are"
        )
    for k in np.flatnonzero(np.diff(cube.times.mjd) == 0):
        if np.array_equal(*cube.data[k : k + 2], equal_nan=True):
            raise ValueError(
                f"{cube.labels[k]} and {cube.labels[k + 1]} are the same image of one "
                "date: leave one out"
            )
    warn_of_misalignment(cube)


def empty_region(decomposed, region):
    """Return in words that no SSP has its centroid in the region, or nothing."""
    if decomposed.select.any() or region is None or len(decomposed.ssps) == 0:
        return ""
    name = region if isinstance(region, str | os.PathLike) else "the region"
    return (
        f"{name}: no significant pattern has its centroid inside, "
        f"{len(decomposed.ssps)} in the rest of the images: check where it lies, or "
        "make it larger"
    )


# -- decomposition -----------------------------------------------------------------


def allow_for_structure(
    cube, decomposer, *, most_shared=0.5, beyond_chance=6.0, n_pairs=3
):
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
    most_shared : float, optional
        Apparent noise is structure if more than this share of its variance is in other
        epochs too, ...
    beyond_chance : float, optional
        ... and more than so many times the share by chance.  The largest correlation
        of noise at any displacement is five times chance, seldom eight.
    n_pairs : int, optional
        Pairs of epochs examined; most must show structure, as one epoch may be there
        twice.

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
    starts = np.unique(np.linspace(0, len(cube) - 2, n_pairs).astype(int))
    most = len(starts) // 2 + 1
    shares = []
    for left, k in zip(range(len(starts))[::-1], starts, strict=True):
        data, masks = cube.data[k : k + 2], cube.mask[k : k + 2]
        share, chance = decomposer.shared_variance(data, masks=masks)
        real = share > np.maximum(most_shared, beyond_chance * chance)
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


def decompose_epochs(cube, decomposer, *, region=None, n_workers=1, progress_bar=False):
    """
    Decompose every epoch of a cube, and choose the SSPs of a region.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    region : optional
        Anything that ``cube.region_mask`` takes, or None for everything.
    n_workers : int, str or `dask.distributed.Client`, optional
        See `~astro_scc.paper.Correlator`; the unit of work is an epoch.
    progress_bar : bool, optional

    Returns
    -------
    `DecomposedEpochs`
    list of ``Decomposition``
    """
    # A propagated noise needs the rms of each image and its beam in pixels.
    rms = beams = [None] * len(cube)
    if decomposer.noise == "propagated":
        rms = cube.noise_rms().value
        beams = beams if cube.beams is None else cube.beam_shapes
    images = cube.data, cube.mask, rms, beams
    work = zip([decomposer] * len(cube), *images, strict=True)
    found = []
    with progress(len(cube), "Decomposing", show=progress_bar) as done:
        for decomposition in in_order(_decompose, work, n_workers):
            found.append(decomposition)
            done(1)
    ssps = SSPs.of_epochs(found)
    inside = None if region is None else cube.region_mask(region)
    select = centroids_inside(ssps, cube, inside)
    return DecomposedEpochs(
        cube=cube, decomposer=decomposer, ssps=ssps, select=select, region=inside
    ), found


def _decompose(work):
    decomposer, image, mask, rms, beam_covariance = work
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
