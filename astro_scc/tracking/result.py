# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracked features: the result, with its tables."""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.decomposition import SSPs, scale_size
from astro_scc.epochs import EpochCube
from astro_scc.epochs.positions import beam_fwhm, position_errors, ssp_offsets
from astro_scc.kinematics.cosmology import table_in_c
from astro_scc.quantities import named, to_quantity
from astro_scc.settings import require
from astro_scc.tracking.chains import track_names
from astro_scc.tracking.confidence import LinkedShare
from astro_scc.tracking.fits import fit_motion
from astro_scc.tracking.linking import Links
from astro_scc.tracking.profile import track_profile
from astro_scc.tracking.tables import (
    feature_table,
    motion_row,
    share_table,
    track_table,
)

__all__ = ["Tracking", "mean_fwhm"]

#: Positions are not known better than to this part of a beam (Lister et al. 2009).
POSITION_FLOOR = 0.05
#: Tracks of so many epochs get an accelerated fit.
ACCELERATED_EPOCHS = 10


def mean_fwhm(cube, scales):
    """
    Size of the resolution, the mean beam or twice the middle scale.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    scales : sequence of float

    Returns
    -------
    `~astropy.units.Quantity`
        In mas.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_static
    >>> from astro_scc.tracking import mean_fwhm
    >>> mean_fwhm(simulate_static(n_epochs=2, rng=1).cube, [1, 2])
    <Quantity 1. mas>
    """
    if cube.beams is None:
        middle = np.exp(np.mean(np.log([scale_size(s) for s in scales])))
        return 2 * middle * cube.pixel_scale
    areas = [(b.major * b.minor).to_value(u.mas**2) for b in cube.beams]
    return np.sqrt(np.mean(areas)) * u.mas


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
    shares : tuple of `~astro_scc.tracking.LinkedShare`
        Of all scales, and of each: the confidence.
    n_trials : int
        Shuffled orders that were linked.
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
    def n_tracks(self):
        """Number of tracks."""
        return int(self.track.max(initial=-1)) + 1

    def members(self, number):
        """
        SSPs of a track, in time order.

        Parameters
        ----------
        number : int
            From 0.

        Returns
        -------
        `~numpy.ndarray` of int
        """
        own = np.flatnonzero(self.track == number)
        return own[np.argsort(self.ssps.epoch[own], kind="stable")]

    @cached_property
    def names(self):
        """Names of the tracks, see `track_names`."""
        scale = self.cube.pixel_scale.value
        dates = self.cube.times.isot
        days = [date[:10] for date in dates]
        return tuple(
            track_names(
                self.track,
                self.ssps,
                days if len(set(days)) == len(days) else dates,
                self.offsets,
                decimals=max(0, int(np.ceil(-np.log10(scale)))),
            )
        )

    @cached_property
    def fwhm(self):
        """Size of the resolution in mas, see `mean_fwhm`."""
        return mean_fwhm(self.cube, np.unique(self.ssps.scale))

    @cached_property
    def offsets(self):
        """East and north of every SSP in mas, shape (2, n_ssps)."""
        return np.stack(ssp_offsets(self.ssps, self.cube))

    @cached_property
    def offset_errors(self):
        """
        Standard errors of the offsets in mas, shape (2, n_ssps).

        See `~astro_scc.epochs.positions.position_errors`; the floor is that of one
        position.
        """
        ssps = self.ssps
        fwhm = beam_fwhm(self.cube, ssps.epoch, ssps.scale, np.eye(2))
        return position_errors(ssps.snr, fwhm, np.sqrt(2) * POSITION_FLOOR).T

    @cached_property
    def fits(self):
        """
        Fitted motions, a `MotionFit` of a straight line for each track.

        Offsets in mas, times in Julian years since the first epoch.
        """
        return tuple(self._fit(number, 1) for number in range(self.n_tracks))

    @cached_property
    def accelerated_fits(self):
        """Fits of a parabola, None for tracks of less than ten epochs."""
        return tuple(
            self._fit(number, 2)
            if len(self.members(number)) >= ACCELERATED_EPOCHS
            else None
            for number in range(self.n_tracks)
        )

    def _fit(self, number, degree):
        own = self.members(number)
        years = self.cube.years.to_value(u.yr)
        return fit_motion(
            years[self.ssps.epoch[own]],
            self.offsets[:, own],
            self.offset_errors[:, own],
            degree=degree,
        )

    @cached_property
    def features(self):
        """One row a feature and epoch, `~astropy.table.QTable`."""
        table = feature_table(self)
        table.meta.update(self._meta())
        return table

    @cached_property
    def tracks(self):
        """One row a track, `~astropy.table.QTable`."""
        rows = [motion_row(self, number) for number in range(self.n_tracks)]
        return track_table(rows, self.cube, meta=self._meta())

    def tracks_in_c(self, *, redshift=None, cosmology=None, distance=None):
        """
        The tracks with apparent speeds in units of c.

        Parameters
        ----------
        redshift, cosmology, distance
            See `~astro_scc.kinematics.apparent_speed`.

        Returns
        -------
        `~astropy.table.QTable`
            `tracks` with the columns ``beta_app`` and ``beta_app_err``, see
            `~astro_scc.kinematics.apparent_speed`.
        """
        return table_in_c(
            self.tracks, redshift=redshift, cosmology=cosmology, distance=distance
        )

    @cached_property
    def confidence(self):
        """
        Shares of linked SSPs, observed and shuffled, `~astropy.table.QTable`.

        The first row, with scale 0, is that of all scales.
        """
        return share_table(self.shares)

    def profile(self, radii, *, half_width=2 * u.mas, scales=None):
        """
        Mean radial speed of the features near each distance from the core.

        Parameters
        ----------
        radii : `~astropy.units.Quantity`, shape (n,)
        half_width : `~astropy.units.Quantity`, optional
            Features within this of a radius count, 2 mas in the paper.
        scales : sequence of float, optional
            The scales whose tracks count.

        Returns
        -------
        `~astropy.table.QTable`
            ``r``, ``speed``, ``speed_err``, ``n_tracks``; radii without a
            track are left out.  See `track_profile`.
        """
        own = np.flatnonzero(self.track >= 0)
        if scales is not None:
            own = own[np.isin(self.ssps.scale[own], scales)]
        east, north = self.offsets[:, own]
        distance = np.hypot(east, north)
        radial = np.stack([east, north]) / np.maximum(distance, 1e-30)
        error = np.sqrt(np.sum((radial * self.offset_errors[:, own]) ** 2, axis=0))
        error = np.maximum(error, self.offset_errors[:, own].min(axis=0))
        wanted = "must be distances with a unit, such as '1 2 3 mas'"
        radii = named("radii", to_quantity, radii, u.mas, wanted).to(u.mas).reshape(-1)
        half_width = require("half_width", half_width)
        speed, speed_err, n_tracks = track_profile(
            self.cube.years.to_value(u.yr)[self.ssps.epoch[own]],
            distance,
            error,
            self.track[own],
            radii.value,
            half_width=half_width.to_value(u.mas),
            min_epochs=self.settings["min_epochs"],
            scale=self.ssps.scale[own],
        )
        use = n_tracks > 0
        table = QTable(
            {
                "r": radii[use],
                "speed": speed[use] * u.mas / u.yr,
                "speed_err": speed_err[use] * u.mas / u.yr,
                "n_tracks": n_tracks[use],
            }
        )
        table.meta["half_width"] = half_width.to(u.mas)
        return table

    def _meta(self):
        return {
            "settings": self.settings,
            "n_trials": self.n_trials,
            "confidence": [
                {
                    "scale": "all" if s.scale is None else s.scale,
                    "n_ssps": s.n_ssps,
                    "n_linked": s.n_linked,
                    "share": s.share,
                    "share_err": s.share_err,
                    **(
                        {"share_shuffled": s.shuffled, "p_value": float(s.p_value)}
                        if self.n_trials
                        else {}
                    ),
                }
                for s in self.shares
            ],
            "epochs": list(self.cube.labels),
            "history": list(self.cube.meta.get("history", ())),
        }
