# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The result of tracking: tracks of features and their motion."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.table import MaskedColumn, QTable
from numpy.typing import ArrayLike

from astro_scc.decomposition import SSPs, scale_size
from astro_scc.epochs import EpochCube
from astro_scc.epochs.positions import beam_fwhm, position_errors, ssp_offsets
from astro_scc.kinematics.cosmology import table_in_c
from astro_scc.kinematics.ridge_search import mean_width
from astro_scc.quantities import named, to_quantity
from astro_scc.settings import require
from astro_scc.tracking.candidates import core_ssps
from astro_scc.tracking.linking import LinkedShare, Links
from astro_scc.tracking.motion import MotionFit, fit_motion, track_profile
from astro_scc.tracking.tables import feature_table, track_table

if TYPE_CHECKING:
    from astropy.cosmology import FLRW

#: Smallest error of a position, in beams (Lister et al. 2009).
POSITION_FLOOR = 0.05
#: Fewest epochs of a track for an accelerated fit.
ACCELERATED_EPOCHS = 10


@dataclass(frozen=True, eq=False, repr=False)
class Tracking:
    """
    The features of a cube, followed over its epochs.

    Attributes
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    select : `~numpy.ndarray` of bool, shape (n_ssps,)
        The SSPs that were tracked.
    links : `~astro_scc.tracking.Links`
    track : `~numpy.ndarray` of int, shape (n_ssps,)
        Number of the track of each SSP, -1 for none.
    shares : tuple
        The shares of SSPs that are linked, on all scales together and on each,
        see ``confidence``.
    n_trials : int
        Number of permutations of the epochs that were also linked.
    settings : dict

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    >>> decompositions = [Decomposer(scales=[2])(image) for image in cube.data]
    >>> tracker = FeatureTracker(max_speed=36 * u.mas / u.yr)
    >>> tracking = tracker(cube, decompositions)
    >>> len(tracking.tracks) == len(set(tracking.track.tolist()) - {-1})
    True
    """

    cube: EpochCube
    ssps: SSPs
    select: np.ndarray
    links: Links
    track: np.ndarray
    shares: tuple[LinkedShare, ...]
    n_trials: int
    settings: dict

    def __repr__(self):
        return (
            f"<Tracking: {self.n_tracks} tracks with {np.sum(self.track >= 0)} of "
            f"{np.sum(self.select)} SSPs in {len(self.cube)} epochs>"
        )

    @property
    def n_tracks(self) -> int:
        """Number of tracks."""
        return int(self.track.max(initial=-1)) + 1

    def members(self, number: int) -> np.ndarray:
        """
        Return the SSPs of a track, in time order.

        Parameters
        ----------
        number : int
            Number of the track, from 0.

        Returns
        -------
        `~numpy.ndarray` of int
        """
        own = np.flatnonzero(self.track == number)
        return own[np.argsort(self.ssps.epoch[own], kind="stable")]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """
        Names of the tracks: the date, scale and position at which each begins.

        A name does not change when epochs are added after the first one of its
        track, whatever the other tracks are.
        """
        dates = self.cube.times.isot
        days = [date[:10] for date in dates]
        dates = days if len(set(days)) == len(days) else dates
        decimals = max(0, int(np.ceil(-np.log10(self.cube.pixel_scale.value))))
        names, seen = [], Counter()
        for number in range(self.n_tracks):
            first = self.members(number)[0]
            date = str(dates[self.ssps.epoch[first]]).replace("-", "").replace(":", "")
            place = "".join(
                f"{np.round(offset, decimals) + 0.0:+.{decimals}f}"
                for offset in self.offsets[:, first]
            )
            name = f"{date}_s{self.ssps.scale[first]:g}_{place}"
            # Tracks with the same rounded position are numbered as in the catalogue.
            seen[name] += 1
            names.append(name if seen[name] == 1 else f"{name}.{seen[name]}")
        return tuple(names)

    @cached_property
    def fwhm(self) -> float:
        """Resolution in mas: the mean beam, or twice the middle scale."""
        return mean_fwhm(self.cube, np.unique(self.ssps.scale))

    @cached_property
    def offsets(self) -> np.ndarray:
        """Offsets of every SSP to the east and north in mas, shape (2, n_ssps)."""
        return np.stack(ssp_offsets(self.ssps, self.cube))

    @cached_property
    def offset_errors(self) -> np.ndarray:
        """
        Standard errors of the offsets in mas, shape (2, n_ssps).

        See ``position_errors``; the floor is the smallest error
        of one position, not of a displacement.
        """
        ssps = self.ssps
        fwhm = beam_fwhm(self.cube, ssps.epoch, ssps.scale, np.eye(2))
        return position_errors(ssps.snr, fwhm, np.sqrt(2) * POSITION_FLOOR).T

    @cached_property
    def fits(self) -> tuple[MotionFit, ...]:
        """
        Fitted motions: for each track, the `MotionFit` of a straight line.

        Offsets are in mas, times in Julian years since the first epoch.
        """
        return self._fits(1, 1)

    @cached_property
    def accelerated_fits(self) -> tuple[MotionFit | None, ...]:
        """Fits of a parabola; None for tracks of fewer than ten epochs."""
        return self._fits(2, ACCELERATED_EPOCHS)

    def _fits(self, degree, least):
        years = self.cube.years.to_value(u.yr)[self.ssps.epoch]
        offsets, errors = self.offsets, self.offset_errors
        return tuple(
            fit_motion(years[own], offsets[:, own], errors[:, own], degree=degree)
            if len(own) >= least
            else None
            for own in map(self.members, range(self.n_tracks))
        )

    @cached_property
    def features(self) -> QTable:
        """
        One row per feature and epoch, `~astropy.table.QTable`.

        Rows are ordered by track and ``date``, a `~astropy.time.Time`.  ``sky``
        is a `~astropy.coordinates.SkyCoord` with the proper motion of the track;
        frames without right ascension have ``lon``, ``lat``, ``pm_lon_coslat``
        and ``pm_lat`` instead.  ``link`` tells how the row continues the
        previous one of the track: "first", "link", or "gap" if epochs are
        missing between them.
        """
        return QTable(feature_table(self), meta=self._meta(), copy=False)

    @cached_property
    def tracks(self) -> QTable:
        """
        One row per track, `~astropy.table.QTable`.

        The table has all columns even if it has no row.  Accelerations and
        ejection epochs are masked for tracks without them.
        """
        return QTable(track_table(self), meta=self._meta(), copy=False)

    def tracks_in_c(
        self, *, redshift: float | str | u.Quantity | None = None,
        cosmology: FLRW | str | dict | None = None,
        distance: u.Quantity | str | None = None,
    ) -> QTable:  # fmt: skip
        """
        Return the tracks with apparent speeds in units of c.

        Parameters
        ----------
        redshift, cosmology, distance
            See `~astro_scc.kinematics.apparent_speed`.

        Returns
        -------
        `~astropy.table.QTable`
            ``tracks`` with the columns ``beta_app`` and ``beta_app_err``, see
            ``table_in_c``.
        """
        return table_in_c(
            self.tracks, redshift=redshift, cosmology=cosmology, distance=distance
        )

    @cached_property
    def confidence(self) -> QTable:
        """
        Shares of linked SSPs, observed and permuted, `~astropy.table.QTable`.

        The first row, with scale 0, is for all scales together.  The columns of
        permuted epochs are masked if there were no permutations.
        """
        table = QTable(
            rows=[(share.scale or 0.0, *share[1:]) for share in self.shares],
            names=("scale", "n_ssps", "n_linked", "share", "share_err",
                   "share_permuted", "share_permuted_err", "p_value"),
            dtype=(float, int, int, *[float] * 5),
        )  # fmt: skip
        for name in table.colnames[5:]:
            values = np.asarray(table[name])
            table[name] = MaskedColumn(np.nan_to_num(values), mask=np.isnan(values))
        return table

    def profile(
        self, radii: u.Quantity, *, half_width: u.Quantity = 2 * u.mas,
        scales: ArrayLike | None = None,
    ) -> QTable:  # fmt: skip
        """
        Return the mean radial speed of the features near each distance.

        At each radius, a straight line is fitted to the distances of every
        track within ``half_width`` of the radius, and the slopes are averaged
        (Mertens & Lobanov 2016, Sect. 3.3).  The core is left out.

        Parameters
        ----------
        radii : `~astropy.units.Quantity`, shape (n,)
            Distances from the core.
        half_width : `~astropy.units.Quantity`, optional
            Features within this distance of a radius are used; 2 mas in the
            paper.
        scales : sequence of float, optional
            The scales whose tracks are used.

        Returns
        -------
        `~astropy.table.QTable`
            ``r``, ``speed``, ``speed_err``, ``n_tracks``; radii without a
            track are left out.
        """
        # The core stands still because the epochs are aligned on it.
        use = (self.track >= 0) & (core_ssps(self.ssps, self.cube) < 0)
        if scales is not None:
            use &= np.isin(self.ssps.scale, scales)
        own = np.flatnonzero(use)
        offset, offset_error = self.offsets[:, own], self.offset_errors[:, own]
        distance = np.hypot(*offset)
        radial = offset / np.maximum(distance, 1e-30)
        error = np.sqrt(np.sum((radial * offset_error) ** 2, axis=0))
        error = np.maximum(error, offset_error.min(axis=0))
        wanted = "must be distances with a unit, such as '1 2 3 mas'"
        radii = named("radii", to_quantity, radii, u.mas, wanted).to(u.mas).reshape(-1)
        half_width = require("half_width", half_width).to(u.mas)
        speed, speed_err, n_tracks = track_profile(
            self.cube.years.to_value(u.yr)[self.ssps.epoch[own]], distance, error,
            self.track[own], radii.value, half_width=half_width.value,
            min_epochs=self.settings["min_epochs"], scale=self.ssps.scale[own],
        )  # fmt: skip
        columns = radii, speed * u.mas / u.yr, speed_err * u.mas / u.yr, n_tracks
        names = ["r", "speed", "speed_err", "n_tracks"]
        table = QTable(columns, names=names, meta={"half_width": half_width})
        return table[n_tracks > 0]

    def _meta(self):
        confidence = []
        for scale, *observed, permuted, _, p_value in self.shares:
            entry = dict(zip(LinkedShare._fields[1:5], observed, strict=True))
            entry = {"scale": "all" if scale is None else scale} | entry
            if self.n_trials:
                entry |= {"share_permuted": permuted, "p_value": p_value}
            confidence.append(entry)
        return {
            "settings": self.settings,
            "n_trials": self.n_trials,
            "confidence": confidence,
            "epochs": list(self.cube.labels),
            "history": list(self.cube.meta.get("history", ())),
        }


def mean_fwhm(cube, scales):
    """Return the resolution in mas: the mean beam, or twice the middle scale."""
    if cube.beams is None:
        middle = np.exp(np.mean(np.log([scale_size(s) for s in scales])))
        return 2 * middle * cube.pixel_scale
    return mean_width(cube) * u.mas
