# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Find and follow the features of a cube, and their tables."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.columns import build_table, describe, round_to_errors, with_errors
from astro_scc.decomposition import SSPs
from astro_scc.epochs import EpochCube
from astro_scc.features.detections import (
    Detections,
    gaussians_of,
    pixel_flux,
    ssps_of,
)
from astro_scc.features.motion import (
    Motion,
    are_secure,
    fit_motion,
    p_false_of,
    properties,
)
from astro_scc.features.tracks import TrackSettings, find_tracks
from astro_scc.images.positions import name_by_frame
from astro_scc.quantities import check_choice
from astro_scc.units import in_speed_unit

if TYPE_CHECKING:
    from collections.abc import Mapping

    from distributed import Client


@dataclass(frozen=True, eq=False, repr=False)
class Features:
    """
    The features of a cube, followed from epoch to epoch.

    Attributes
    ----------
    cube : `~astro_scc.EpochCube`
    detections : ``Detections``
        Offsets from the core; the core itself is not among them.
    core : ``Detections``
        The core of each epoch, if it is seen.
    tracks : tuple of `~numpy.ndarray` of int
        The detections of each feature, one per epoch, in the order of the epochs;
        features are in the order of their first ones.
    same_speed, proven : `~numpy.ndarray`, shape (n_features,)
        How sure each track is, see ``find_tracks``.
    doubts : dict of str: list of int
        Numbers of features that are secure by themselves, and why they are not: images
        of neighbouring dates have little in common, or the flow passes them.

    Examples
    --------
    >>> from astro_scc.features import find_features
    >>> from astro_scc.simulation import simulate_jet
    >>> features = find_features(simulate_jet(n_epochs=8, rng=3).cube)
    >>> features.table["pm"].unit
    Unit("mas / yr")
    """

    cube: EpochCube
    detections: Detections
    core: Detections
    tracks: tuple[np.ndarray, ...]
    same_speed: np.ndarray
    proven: np.ndarray
    doubts: dict[str, list[int]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.tracks)

    def __repr__(self):
        secure = int(np.sum(self.secure))
        return (
            f"<Features: {len(self)}, {secure} of them secure, from "
            f"{len(self.detections)} detections in {len(self.cube)} epochs>"
        )

    @cached_property
    def motions(self) -> tuple[Motion, ...]:
        """Straight line or parabola of each feature."""
        d = self.detections
        return tuple(
            fit_motion(d.time[k], d.place[k], d.place_error[k], d.fwhm)
            for k in self.tracks
        )

    @property
    def n_epochs(self) -> np.ndarray:
        """Number of epochs in which each is seen."""
        return np.array([len(track) for track in self.tracks], dtype=int)

    @property
    def number(self) -> np.ndarray:
        """
        Number of each feature, by which it is known.

        A hundred times the number of the first epoch in which it is seen, from 1,
        plus the number of its detection there: 503 begins with the third detection
        of epoch 5, for Gaussians the third brightest.  Later epochs leave the numbers
        as they are.
        """
        d = self.detections
        first = np.array([track[0] for track in self.tracks], dtype=int)
        # Images of structure everywhere have more than a hundred detections.
        step = 10 ** max(2, len(str(d.number.max(initial=0) + 1)))
        return step * (d.epoch[first] + 1) + d.number[first] + 1

    @cached_property
    def p_false(self) -> np.ndarray:
        """Probability of each that it is no feature, or parts of several."""
        return p_false_of(self._properties)

    @cached_property
    def _properties(self):
        each = zip(self.tracks, self.motions, strict=True)
        return [properties(self.detections, *one) for one in each]

    @property
    def moved(self) -> np.ndarray:
        """Motion of each in beams along it, from its first to its last date."""
        moved = np.array([m.moved for m in self.motions]).reshape(-1, 2)
        return np.hypot(*self.detections.to_beams(moved).T)

    @cached_property
    def secure(self) -> np.ndarray:
        """Whether each is reliable: one feature that moves, with this speed."""
        return self._are_secure(self.p_false)

    @property
    def secure_without_core(self) -> np.ndarray:
        """Whether each is, if no core is known: moving towards it is no fault then."""
        return self._are_secure(p_false_of(self._properties, outward=True))

    def _are_secure(self, p_false):
        errors = np.array([m.speed / m.speed_err for m in self.motions], dtype=float)
        secure = are_secure(p_false, self.same_speed, self.moved, errors, self.n_epochs)
        doubtful = [number for numbers in self.doubts.values() for number in numbers]
        return secure & ~np.isin(self.number, doubtful)

    @property
    def coverage(self) -> float:
        """Share of the detections that are of secure features."""
        return self.n_epochs[self.secure].sum() / max(len(self.detections), 1)

    @cached_property
    def core_error(self) -> float:
        """Scatter and error of the position of the core along an axis, in mas."""
        if len(self.core) == 0:
            return 0.0
        square = self.core.place**2 + self.core.place_error**2
        return float(np.sqrt(square.mean()))

    @cached_property
    def table(self) -> QTable:
        """One row a feature, a `~astropy.table.QTable`; without any, all columns."""
        return feature_table(self)

    @property
    def places(self) -> np.ndarray:
        """Places of the motions at their dates, shape (n, 2) in mas."""
        return np.reshape([motion.place for motion in self.motions], (-1, 2))

    @property
    def velocities(self) -> np.ndarray:
        """Velocities of the motions, shape (n, 2) in mas/yr."""
        return np.reshape([motion.velocity for motion in self.motions], (-1, 2))

    @cached_property
    def positions(self) -> QTable:
        """One row for each feature and epoch, a `~astropy.table.QTable`."""
        cube, d = self.cube, self.detections
        number = np.repeat(self.number, self.n_epochs)
        d = d.select(np.concatenate([[], *self.tracks]).astype(int))
        place, error = d.place.T * u.mas, d.place_error.T * u.mas
        east, north = zip(place, error, strict=True)
        offsets = with_errors(ra_offset=east, dec_offset=north)
        used = np.concatenate([[], *(m.used for m in self.motions)]).astype(bool)
        table = build_table(
            "positions", feature=number, epoch=d.epoch, used=used,
            date=_dates(cube, d.epoch), **offsets,
            flux=d.flux * pixel_flux(cube).unit, size=d.size * u.mas,
        )  # fmt: skip
        table.meta.update(cube.facts)
        return round_to_errors(name_by_frame(table, cube))


def doubts_in_words(doubts: Mapping[str, list[int]]) -> list[str]:
    """Return how many features are not secure for a reason alone, a line a reason."""
    return [
        f"{len(numbers)} feature{' is' if len(numbers) == 1 else 's are'} not secure "
        f"for this alone: {reason}"
        for reason, numbers in doubts.items()
    ]


def find_features(
    cube: EpochCube, *, detections: str = "gaussians", ssps: SSPs | None = None,
    region: Any = None, settings: TrackSettings | None = None, seed: int = 0,
    n_workers: int | str | Client = 1, progress_bar: bool = False,
) -> Features:  # fmt: skip
    """
    Find the features of a cube and follow them through its epochs.

    Each image is modelled by Gaussians convolved with its beam, see
    ``fit_gaussians``, or described by its SSPs.  Where one ellipse would do as well as
    several of them, they are one detection if they keep their distance from epoch to
    epoch, or if it is one in other epochs, of the same size and where the ellipse is.
    Detections are assigned to tracks, each to one at most, see ``find_tracks``.  What
    stands at the reference pixel is the core, and all offsets are from it.

    Parameters
    ----------
    cube : `~astro_scc.EpochCube`
        Its epochs must be aligned on the core.
    detections : {"gaussians", "ssp"}, optional
        Cubes without beams always have detections from SSPs.
    ssps : `~astro_scc.decomposition.SSPs`, optional
        SSPs of all epochs, needed for ``"ssp"``; on several scales, the finest one
        on which a pattern is seen is used.
    region : optional
        Anything that ``cube.region_mask`` takes: detections outside are not used.
    settings : `TrackSettings`, optional
    seed : int, optional
        Seed of the disturbed assignments.
    n_workers : int, str or `dask.distributed.Client`, optional
        Number of processes that fit images, or a Dask scheduler.
    progress_bar : bool, optional

    Returns
    -------
    `Features`

    Raises
    ------
    ValueError
        If ``detections`` is unknown, or SSPs are needed and not given.

    Examples
    --------
    >>> from astro_scc.features import find_features
    >>> from astro_scc.simulation import simulate_jet
    >>> features = find_features(simulate_jet(n_epochs=12, dispersion=0.1, rng=1).cube)
    >>> bool(features.secure.any())
    True
    """
    check_choice(detections, "gaussians", "ssp")
    settings = TrackSettings() if settings is None else settings
    if detections == "ssp" or cube.beams is None:
        if ssps is None:
            raise ValueError(
                "features of SSPs need ssps, the SSPs of all epochs"
                + ("" if cube.beams else "; without beams no Gaussians can be fitted")
            )
        found = ssps_of(cube, ssps)
    else:
        found = gaussians_of(cube, n_workers=n_workers, progress_bar=progress_bar)
    found = found.aligned()
    if region is not None:
        found = found.select(found.core(settings.core) | _inside(found, cube, region))
    found, known = without_alternatives(found, settings, seed)
    is_core = found.core(settings.core)
    jet = found.select(~is_core)
    if known is None:
        known = find_tracks(jet, settings, seed=seed)
    return Features(cube, jet, found.select(is_core), *known)


#: Parts of one elongated feature keep their distance and direction: in so many epochs
#: or more, with a scatter of less than so many beams, or such a share of the distance,
#: beyond their errors.  Where there are parts in fewer epochs, the whole has the size
#: of the feature in the others to so many beams.
ELONGATED_EPOCHS, STEADY = 3, 0.2


def without_alternatives(found, settings, seed=0):
    """
    Return detections of which those with parts are features that are elongated.

    Parameters
    ----------
    found : ``Detections``
    settings : `TrackSettings`
    seed : int, optional

    Returns
    -------
    detections : ``Detections``
    known : tuple or None
        What ``find_tracks`` finds in the detections without the core, where no parts
        replace any.
    """
    if not np.any(found.group < 0):
        return found, None
    whole, every = np.zeros(len(found), dtype=bool), np.flatnonzero(found.group <= 0)
    joined = found.select(every)
    is_core = joined.core(settings.core)
    jet = np.flatnonzero(~is_core)
    known = find_tracks(joined.select(jet), settings, seed=seed)
    for members in (np.flatnonzero(is_core), *(jet[track] for track in known[0])):
        group = found.group[every[members]]
        split, plain = every[members[group < 0]], every[members[group == 0]]
        if len(split) >= ELONGATED_EPOCHS:
            whole[split] = _keep_their_distance(found, split)
        elif len(plain) >= settings.least_epochs and not is_core[members[0]]:
            whole[split] = [_continues(found, plain, k) for k in split.tolist()]
    chosen = found.chosen(whole)
    same = np.array_equal(chosen.group, joined.group)
    return chosen, known if same else None


def _continues(found, plain, k):
    """Return whether one, rather than a part of it, is on a track and has its size."""
    time = found.time - found.time[k]
    line = np.polynomial.polynomial.polyfit(time[plain], found.in_beams[plain], 1)
    off = np.hypot(*(found.in_beams[[k, *found.parts(k)]] - line[0]).T)
    change = abs(found.size[k] - np.median(found.size[plain]))
    return off[0] <= off.min() and change < STEADY * found.fwhm


def _keep_their_distance(found, split):
    """Return whether the parts of some detections are as far apart in all epochs."""
    each = np.array([found.elongation(k) for k in split.tolist()])
    parts = np.concatenate([found.parts(k) for k in split.tolist()])
    # Those that lie outside of a region have no parts.
    error = (found.place_error[parts] ** 2).sum() / max(len(parts), 1) / found.fwhm**2
    size = max(1.0, np.trace(each.mean(axis=0)))
    return each.var(axis=0).sum() < (STEADY * size) ** 2 + error


def _inside(detections, cube, region):
    """Return which detections lie in a region."""
    mask = cube.region_mask(region)
    east, north = detections.place.T * u.mas
    x, y = (np.rint(v).astype(int) for v in cube.offset_to_pixel(east, north))
    inside = (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
    inside[inside] = mask[y[inside], x[inside]]
    return inside


def feature_table(features, stream=0):
    """
    Return the features of a cube as a table.

    Parameters
    ----------
    features : `~astro_scc.features.Features`
    stream : int or array_like of int, shape (n,), optional
        Stream that each belongs to, 0 for none.

    Returns
    -------
    `~astropy.table.QTable`
        One row a feature, also without any with all columns and units.  Values
        that are not measured are NaN: accelerations unless a parabola is better
        than a line, and dates of ejection unless the motion is radial.
    """
    rows = [_row(features, k) for k in range(len(features))]
    cube, d, tracks = features.cube, features.detections, features.tracks
    years = np.array([motion.date for motion in features.motions], dtype=float)
    date = Time(years, format="jyear", scale="utc")
    date.format = "isot"
    flux = np.array([np.median(d.flux[k]) for k in tracks], dtype=float)
    table = build_table(
        "features", rows, date=date, flux=flux * pixel_flux(cube).unit,
        feature=features.number, stream=np.full(len(features), stream),
        motion=features.moved * u.one,
        first=_dates(cube, [d.epoch[k[0]] for k in tracks]),
        last=_dates(cube, [d.epoch[k[-1]] for k in tracks]),
        p_false=features.p_false, secure=features.secure,
    )  # fmt: skip
    unit = cube.speed_unit
    if unit.bases[1] != u.yr:
        years = table["t_ej"].value
        known = np.isfinite(years)
        table["t_ej"], table["t_ej_err"] = years * u.day, table["t_ej_err"].to(u.day)
        mjd = Time(years[known], format="jyear", scale="utc").mjd
        table["t_ej"][known] = mjd * u.day
        describe(table, "features")
        table["t_ej"].info.description = "MJD at which it was at the core"
    in_speed_unit(table, unit)
    table.meta |= cube.facts | ({"doubts": features.doubts} if features.doubts else {})
    return round_to_errors(name_by_frame(table, cube))


def _dates(cube, epoch):
    """Return the dates of epochs by their numbers."""
    return Time(cube.times[np.array(epoch, dtype=int)], format="isot")


def _row(features, number):
    """Return the columns of one feature as plain numbers."""
    d, track = features.detections, features.tracks[number]
    motion = features.motions[number]
    r, v = motion.place, motion.velocity
    distance, speed = np.hypot(*r), motion.speed
    outward = r / distance if distance > 0 else np.array([0.0, 1.0])
    around = np.array([outward[1], -outward[0]])
    along = v / speed if speed > 0 else outward
    across = np.array([along[1], -along[0]])
    across_err = motion.error_along(across)
    tangential = float(np.hypot(*(around * motion.place_err)))
    # Neither direction can be wrong by more than half a turn.
    pm_pa_err = min(across_err / speed, np.pi) if speed > 0 else np.pi
    pa_err = min(tangential / distance, np.pi) if distance > 0 else np.pi
    bend, bend_err = motion.acceleration, motion.acceleration_err
    return {
        "n_epochs": len(track),
        **with_errors(
            ra_offset=(r[0], motion.place_err[0]),
            dec_offset=(r[1], motion.place_err[1]),
            separation=(distance, np.hypot(*(outward * motion.place_err))),
            position_angle=(np.degrees(np.arctan2(*r)) % 360, np.degrees(pa_err)),
            pm_ra_cosdec=(v[0], motion.velocity_err[0]),
            pm_dec=(v[1], motion.velocity_err[1]),
            pm=(speed, motion.speed_err),
            pm_pa=(np.degrees(np.arctan2(*v)) % 360, np.degrees(pm_pa_err)),
            pm_radial=(v @ outward, motion.error_along(outward)),
            pm_nonradial=(v @ around, motion.error_along(around)),
            acc_parallel=(bend @ along, np.hypot(*(along * bend_err))),
            acc_perpendicular=(bend @ across, np.hypot(*(across * bend_err))),
            t_ej=motion.ejection(features.core_error, d.fwhm),
        ),
        "size": np.median(d.size[track]),
        "proven": features.proven[number],
    }
