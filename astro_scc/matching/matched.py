# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches: decompositions of epochs, choice of SSPs, and files of matches."""

from __future__ import annotations

import hashlib
import json
import operator
import os
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import astropy.units as u
import numpy as np
from numpy.typing import ArrayLike

from astro_scc.correlation import Correlator, Matches, all_pairs
from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.decomposition.segmentation import Decomposition
from astro_scc.epochs import EpochCube
from astro_scc.epochs.serialize import read_object, write_object
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.features import Features, find_features
from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import RidgeLine
from astro_scc.matching.plan import scale_numbers
from astro_scc.parallel import in_order, workers_of
from astro_scc.progress import progress
from astro_scc.settings import require
from astro_scc.writing import versions

#: What the files are, in their headers and in messages.
MATCHES = "astro_scc matches"
#: Apparent noise is structure if more than this share of it is in other epochs too...
SHARED = 0.5
#: ... and more than this many times the share by chance.  The largest correlation of
#: noise at any displacement is five times chance, seldom eight.
BEYOND_CHANCE = 6.0
#: Pairs of epochs examined; most must show structure, as one epoch may be there twice.
PAIRS = 3


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

    def __repr__(self):
        n, n_ssps = len(self.cube), np.count_nonzero(self.select)
        return f"<{type(self).__name__}: {n} epochs, {n_ssps} SSPs>"

    @property
    def scales(self) -> tuple[float, ...]:
        """Numbers of the scales that were decomposed."""
        return tuple(self.decomposer.scales)

    @property
    def decompositions(self) -> tuple[Decomposition, ...]:
        """Decompositions of all epochs, which are computed again at each access."""
        return decompose_epochs(self.cube, self.decomposer)

    @property
    def features(self) -> Features:
        """
        The features that are followed from epoch to epoch.

        They are `~astro_scc.features.Features` of Gaussian models of the images or,
        without beams, of SSPs, inside the region.
        """
        return self.follow()

    def follow(self, **how: Any) -> Features:
        """
        Return the `features`, which are found only once.

        Parameters
        ----------
        **how
            ``n_workers`` and ``progress_bar`` of `~astro_scc.features.find_features`.

        Returns
        -------
        `~astro_scc.features.Features`
        """
        if "features" not in vars(self):
            how |= {"ssps": self.ssps, "region": self.region}
            vars(self)["features"] = find_features(self.cube, **how)
        return vars(self)["features"]

    def part(self, select: np.ndarray) -> DecomposedEpochs:
        """
        Return the same epochs with another selection of SSPs.

        Parameters
        ----------
        select : `~numpy.ndarray` of bool, shape (n_ssps,)

        Returns
        -------
        `DecomposedEpochs`
            Of the same class.
        """
        found = replace(self, select=select)
        # The same features, which are found only once.
        vars(found)["features"] = self.features
        return found


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class MatchedEpochs(DecomposedEpochs):
    """
    Decomposed and correlated epochs: their SSPs and matches.

    Attributes
    ----------
    cube, decomposer, ssps, select, region
        See `DecomposedEpochs`.
    matches : `~astro_scc.correlation.Matches`
    correlator : `~astro_scc.correlation.Correlator`
    reach : tuple of int
        Largest displacement along (y, x), in pixels.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=2, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> matched = scc.match(cube)
    >>> int(matched.select.sum()) == len(matched.ssps)
    True
    >>> matched.write("matches.fits")
    >>> again = type(matched).read("matches.fits", cube)
    >>> len(again.matches) == len(matched.matches)
    True
    """

    matches: Matches
    correlator: Correlator
    reach: tuple[int, int]

    def __repr__(self):
        return f"{super().__repr__()[:-1]}, {len(self.matches)} matches>"

    def write(self, path: Path | str, *, overwrite: bool = False) -> None:
        """
        Write the SSPs and their matches.

        Parameters
        ----------
        path : path
            A FITS file.
        overwrite : bool, optional

        Raises
        ------
        OSError
            If the file exists and ``overwrite`` is False, or cannot be
            written.

        Notes
        -----
        The file holds neither the images nor their wavelet planes, which are
        quickly computed again.
        """
        of = self.cube, self.decomposer, self.correlator, self.reach, self.region
        made = match_provenance(*of)
        inside = centroids_inside(self.ssps, self.cube, self.region)
        if not np.array_equal(self.select, inside):
            # No region that can be requested gives SSPs that were selected later.
            made["region"] = "chosen SSPs"
        parts = {"matched": replace(self, cube=None), "provenance": made}
        write_object(parts, path, creator=MATCHES, overwrite=overwrite)

    @classmethod
    def read(
        cls, path: Path | str, cube: EpochCube, *, wanted: dict | None = None
    ) -> MatchedEpochs:
        """
        Read what `write` wrote.

        Parameters
        ----------
        path : path
        cube : `~astro_scc.epochs.EpochCube`
            The cube that was matched; its dates may differ.
        wanted : dict, optional
            Provenance that the matches must have; by default the images and
            versions must be the present ones.

        Returns
        -------
        `MatchedEpochs`
            With the dates of ``cube``.

        Raises
        ------
        OSError
            If the file cannot be read, or is not a file of matches.
        ValueError
            If it was made from other images, or by other settings or versions.
        """
        parts = read_object(path, creator=MATCHES)
        found = parts["provenance"]
        if wanted is None:
            wanted = {**image_provenance(cube), "versions": versions()}
        stale = [name for name, value in wanted.items() if found.get(name) != value]
        if stale:
            what = ", ".join(stale)
            raise ValueError(f"{path}: is of other {what}; match the epochs again")
        return replace(parts["matched"], cube=cube)


def match_epochs(
    cube, decomposer, correlator, reach, *, region=None, n_workers=1, cache=None,
    progress_bar=False,
):  # fmt: skip
    """
    Decompose epochs and correlate their SSPs, unless the cache has their matches.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    correlator : `~astro_scc.correlation.Correlator`
    reach : tuple of int
        Largest displacement in pixels.
    region, n_workers, cache, progress_bar
        See `~astro_scc.StackedCrossCorrelation.match`.

    Returns
    -------
    `MatchedEpochs`
    """
    inside = None if region is None else cube.region_mask(region)
    found, path = None, None if cache is None else Path(cache)
    if path is not None:
        wanted = match_provenance(cube, decomposer, correlator, reach, inside)
        if path.suffix.lower() != ".fits":
            # A folder has a file for each provenance.
            digest = _digest(json.dumps(wanted, sort_keys=True))[:16]
            path /= f"matches-{digest}.fits"
        if path.exists():
            try:
                found = MatchedEpochs.read(path, cube, wanted=wanted)
            except (OSError, ValueError) as error:
                why = str(error).removesuffix("; match the epochs again")
                why += "; not used, the epochs are matched again"
                warn(why, MeasurementWarning)
    if found is None:
        with workers_of(n_workers) as workers:
            how = {"n_workers": workers, "progress_bar": progress_bar}
            decompositions = decompose_epochs(cube, decomposer, **how)
            ssps = SSPs.of_epochs(decompositions)
            select = centroids_inside(ssps, cube, inside)
            with progress(len(cube), "Correlating", show=progress_bar) as done:
                how = {"select": select, "n_workers": workers, "progress": done}
                work = decompositions, all_pairs(len(cube)), reach
                matches = correlator(*work, **how)
        # Matches need no planes, which are larger than everything else.
        found = MatchedEpochs(
            cube=cube, decomposer=decomposer, ssps=ssps, select=select, matches=matches,
            correlator=correlator, reach=reach, region=inside,
        )  # fmt: skip
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            found.write(path, overwrite=True)
    _warn_of_empty(found, region)
    return found


def find_patterns(cube, decomposer, *, region=None, n_workers=1, progress_bar=False):
    """
    Decompose epochs into SSPs.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    region, n_workers, progress_bar
        See `~astro_scc.StackedCrossCorrelation.decompose`.

    Returns
    -------
    `DecomposedEpochs`
    """
    inside = None if region is None else cube.region_mask(region)
    with workers_of(n_workers) as workers:
        found = decompose_epochs(
            cube, decomposer, n_workers=workers, progress_bar=progress_bar
        )
    ssps = SSPs.of_epochs(found)
    select = centroids_inside(ssps, cube, inside)
    made = DecomposedEpochs(
        cube=cube, decomposer=decomposer, ssps=ssps, select=select, region=inside
    )
    _warn_of_empty(made, region)
    return made


def _warn_of_empty(found, region):
    """Warn if no SSP has its centroid in the region."""
    if region is not None and len(found.ssps) and not found.select.any():
        name = region if isinstance(region, str | os.PathLike) else "the region"
        warn(
            f"{name}: no significant pattern has its centroid inside, "
            f"{len(found.ssps)} in the rest of the images: check where it lies, or "
            "make it larger",
            MeasurementWarning,
        )


# -- files -------------------------------------------------------------------------


def image_provenance(cube):
    """
    Return the images of a cube as digests: SHA-256 of values and masks.

    Matches are in pixels, so that neither dates nor the size of pixels change them.
    """
    return {"images": _digest(cube.data), "masks": _digest(np.packbits(cube.mask))}


def match_provenance(cube, decomposer, correlator, reach, inside):
    """
    Return all that determines the matches of a cube.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    decomposer : `~astro_scc.decomposition.Decomposer`
    correlator : `~astro_scc.correlation.Correlator`
    reach : tuple of int
        Largest displacement in pixels.
    inside : `~numpy.ndarray` of bool, shape (ny, nx), or None
        The region, or None for everything.

    Returns
    -------
    dict
        Text, numbers and lists, which JSON can hold.  The dates of the epochs
        enter only through their order and through ``reach``.
    """
    noise = noise_facts(cube, decomposer)
    made = {
        **image_provenance(cube),
        "settings of the decomposition": asdict(decomposer),
        "settings of the correlation": asdict(correlator),
        "noise": _digest([(rms, np.asarray(beam).tolist()) for rms, beam in noise]),
        "largest displacement": list(reach),
        "region": "everything" if inside is None else _digest(np.packbits(inside)),
        "versions": versions(),
    }
    # Give it the types that it will have when it is read.
    return json.loads(json.dumps(made))


def _digest(value):
    """Return the SHA-256 of an array, or of the text that another object shows."""
    if not isinstance(value, np.ndarray):
        return hashlib.sha256(repr(value).encode()).hexdigest()
    sum_ = hashlib.sha256(f"{value.dtype.str}{value.shape}".encode())
    sum_.update(np.ascontiguousarray(value).data)
    return sum_.hexdigest()


# -- decomposition -----------------------------------------------------------------


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
    each = zip(cube.data, cube.mask, noise_facts(cube, decomposer), strict=True)
    work = (
        partial(decomposer, image, mask=mask, rms=rms, beam_covariance=covariance)
        for image, mask, (rms, covariance) in each
    )
    found = []
    with progress(len(cube), "Decomposing", show=progress_bar) as done:
        for decomposition in in_order(operator.call, work, n_workers):
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


# -- choice of SSPs ----------------------------------------------------------------


def ssp_distances(matched, *, origin=None, ridge=None):
    """
    Return the distances of the centroids of SSPs from a point or along a line.

    Parameters
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
    origin : `~astropy.units.Quantity`, shape (2,), optional
        (east, north) of the core, by default the reference pixel.
    ridge : `~astro_scc.kinematics.RidgeLine`, optional
        Measure along this line instead of from ``origin``.

    Returns
    -------
    `~astropy.units.Quantity`, shape (n_ssps,)
        In mas.
    """
    east, north = ssp_offsets(matched.ssps, matched.cube, centroid=True) * u.mas
    if ridge is not None:
        return ridge.coordinates(east, north)[0]
    origin = u.Quantity([0, 0] * u.mas if origin is None else origin)
    return np.hypot(east - origin[0], north - origin[1]).to(u.mas)


def select_ssps(
    matched: DecomposedEpochs, *, region: Any = None, r_min: u.Quantity | None = None,
    r_max: u.Quantity | None = None, scales: ArrayLike | None = None,
    origin: u.Quantity | None = None, ridge: RidgeLine | None = None,
) -> DecomposedEpochs:  # fmt: skip
    """
    Return the matches of the SSPs in a part of the jet and on some scales.

    Nothing is correlated again; only the matches of the selected SSPs are
    stacked.  An SSP is selected by its centroid; its matches may lie outside.

    Parameters
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
    region : optional
        Anything that ``cube.region_mask`` takes.
    r_min, r_max : `~astropy.units.Quantity`, optional
        ``r_min <= r < r_max``.
    scales : sequence of float or `~astropy.units.Quantity`, optional
        Numbers, or angles.
    origin, ridge : optional
        Point from which, or line along which, r is measured, see
        ``ssp_distances``.

    Returns
    -------
    `~astro_scc.matching.MatchedEpochs`

    Raises
    ------
    ValueError
        If ``r_min`` is not below ``r_max``, or a scale was not decomposed.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.matching import select_ssps
    >>> from astro_scc.simulation import simulate_static
    >>> matched = StackedCrossCorrelation(scales=[1, 2]).match(
    ...     simulate_static(n_epochs=3, rng=1).cube)
    >>> inner = select_ssps(matched, r_max=8 * u.mas, scales=[1])
    >>> bool(0 < inner.select.sum() < matched.select.sum())
    True
    """
    select = matched.select & centroids_inside(matched.ssps, matched.cube, region)
    if r_min is not None or r_max is not None:
        low = 0 * u.mas if r_min is None else u.Quantity(r_min)
        high = np.inf * u.mas if r_max is None else u.Quantity(r_max)
        if not low < high:
            raise ValueError(f"r_min={r_min} must be below r_max={r_max}")
        r = ssp_distances(matched, origin=origin, ridge=ridge)
        select &= (r >= low) & (r < high)
    if scales is not None:
        numbers = scale_numbers(matched.cube, require("scales", scales))
        have = matched.scales
        missing = [s for s in numbers if s not in have]
        if missing:
            what, there = (", ".join(f"{s:g}" for s in v) for v in (missing, have))
            raise ValueError(f"scale {what} was not decomposed; there are {there}")
        select &= np.isin(matched.ssps.scale, numbers)
    return matched.part(select)
