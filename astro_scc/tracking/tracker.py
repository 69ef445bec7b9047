# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Link the SSPs of a cube within limits of speed, and the features of these links."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import astropy.units as u
import numpy as np

from astro_scc import quantities as q
from astro_scc.alignment.registration import warn_of_misalignment
from astro_scc.correlation import Correlator, Matches
from astro_scc.correlation.correlate import COLUMNS, target_ssps
from astro_scc.decomposition import SSPs
from astro_scc.decomposition.segmentation import Decomposition, require_ssps
from astro_scc.epochs import EpochCube
from astro_scc.features import Features
from astro_scc.features.detections import finest_patterns, is_new, ssps_of
from astro_scc.features.tracks import Track, chains, lowest
from astro_scc.images.beam import require_common_beam
from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import PositionAngleFrame, RadialFrame
from astro_scc.kinematics.frames import frame_displacements
from astro_scc.matching.plan import mean_fwhm
from astro_scc.progress import progress
from astro_scc.settings import BEAMS, require
from astro_scc.tracking import linking
from astro_scc.tracking.linking import Links
from astro_scc.units import PM_UNIT

#: Without a largest speed, displacements up to this many beams are searched.
BEAMS_PER_INTERVAL = 4.0
#: Displacements may exceed the limits by this many tolerances.
MARGIN = 2.0
#: Checks of the settings that a measurement does not have, and their units.
SPEEDS = (q.check_range, "a smallest and a largest speed", "-1 4 mas/yr")
CHECKS = {
    "along": (PM_UNIT, *SPEEDS),
    "across": (PM_UNIT, *SPEEDS),
    "tolerance": (None, *BEAMS),
    "max_gap": (None, q.check_integer, 0),
    "min_epochs": (None, q.check_integer, 3),
}


@dataclass(frozen=True, kw_only=True)
class FeatureTracker:
    """
    Follow the SSPs of a cube from epoch to epoch.

    The object keeps the settings; calling it with a cube and its
    decompositions returns its features.  For dense flows whose speeds have known
    limits; elsewhere `~astro_scc.features.find_features` follows more of them.
    Settings with a unit may be text.

    Parameters
    ----------
    max_speed : `~astropy.units.Quantity`, optional
        Largest proper motion.  By default four beams over the median
        interval of consecutive epochs.
    position_angle : `~astropy.units.Quantity` or "radial", optional
        Direction of the jet, north through east, to which ``along`` and
        ``across`` refer.
    along, across : `~astropy.units.Quantity`, shape (2,), optional
        Smallest and largest proper motion along the jet, and across it
        (positive towards larger position angles).  Either replaces
        ``max_speed`` on its axis.
    tolerance : float, optional
        Standard deviation of a displacement from steady motion, in beams.
    max_gap : int, optional
        Most consecutive epochs at which a feature may be missing.
    min_epochs : int, optional
        Fewest epochs of a track.
    kappa : float, optional
        Smallest correlation of a candidate.
    common_beam : bool, optional
        Refuse epochs whose beams differ; ``cube.to_common_beam()`` gives them
        the same beam.  False tracks them as they are.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    `~astropy.units.UnitConversionError`
        If a unit cannot be converted.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> decompositions = [Decomposer(scales=[1, 2])(image) for image in cube.data]
    >>> tracker = FeatureTracker(max_speed=36 * u.mas / u.yr)
    >>> features = tracker(cube, decompositions)
    >>> len(features) > 5, features.table["pm"].unit
    (True, Unit("mas / yr"))
    """

    max_speed: u.Quantity | str | None = None
    position_angle: u.Quantity | str | None = None
    along: u.Quantity | Sequence[str] | None = None
    across: u.Quantity | Sequence[str] | None = None
    tolerance: float = 0.2
    max_gap: int = 1
    min_epochs: int = 3
    kappa: float = 0.5
    common_beam: bool = True

    def __post_init__(self):
        for name in (field.name for field in fields(self)):
            value = getattr(self, name)
            if name not in CHECKS:
                value = require(name, value)
            elif value is not None:
                unit, *check = CHECKS[name]
                value = q.named(name, check[0], value, *check[1:])
                value = value if unit is None else value.to(unit)
            object.__setattr__(self, name, value)
        if isinstance(self.position_angle, str) and self.position_angle != "radial":
            raise ValueError(
                f"position_angle = {self.position_angle!r} must be an angle or 'radial'"
            )
        if self._limited and self.position_angle is None:
            raise ValueError("along and across need a position_angle")

    def __call__(
        self, cube: EpochCube, decompositions: Sequence[Decomposition], *,
        n_workers: int = 1, progress_bar: bool = False,
    ) -> Features:  # fmt: skip
        """
        Return the features of a cube.

        Parameters
        ----------
        cube, decompositions, n_workers, progress_bar
            See `link`.

        Returns
        -------
        `~astro_scc.features.Features`
            A pattern that is followed on several scales is one feature.  The core
            is none.

        Raises
        ------
        ValueError
            See `link`.
        """
        how = {"n_workers": n_workers, "progress_bar": progress_bar}
        links = self.link(cube, decompositions, **how)
        ssps = SSPs.of_epochs(decompositions)
        core = linking.core_ssps(ssps, cube)
        tracks = [
            own
            for own in chains(links.source, links.target, len(ssps))
            if len(own) >= self.min_epochs and not core[own[0]]
        ]
        return linked_features(cube, ssps, tracks, core)

    def link(
        self, cube: EpochCube, decompositions: Sequence[Decomposition], *,
        n_workers: int = 1, progress_bar: bool = False,
    ) -> Links:  # fmt: skip
        """
        Link the SSPs of a cube, on each scale.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`
            Its epochs must be aligned.  Distances are measured from its
            reference pixel, and what stands there is the core.
        decompositions : sequence of ``Decomposition``
            One for each epoch.
        n_workers : int, optional
        progress_bar : bool, optional

        Returns
        -------
        ``Links``

        Raises
        ------
        ValueError
            If ``decompositions`` has not one entry per epoch, if no epoch shows an
            SSP, if no two epochs have different dates, or if beams differ and
            ``common_beam`` is True.

        Warns
        -----
        `~astro_scc.exceptions.MeasurementWarning`
            If the alignment of the epochs is as poor as 0.2 beams or worse.
        """
        if self.common_beam:
            require_common_beam(cube)
        warn_of_misalignment(cube)
        if len(decompositions) != len(cube):
            each = f"{len(decompositions)} decompositions for {len(cube)} epochs"
            raise ValueError(f"{each}: give one for each")
        ssps, years = SSPs.of_epochs(decompositions), cube.years.to_value(u.yr)
        gaps = np.diff(years)
        if not np.any(gaps > 0):
            date = cube.times[0].isot
            raise ValueError(f"tracking needs epochs of two dates, not only of {date}")
        scales = decompositions[0].scales
        require_ssps(ssps, scales)
        fwhm = mean_fwhm(cube, scales[len(scales) // 2])
        limit = BEAMS_PER_INTERVAL * fwhm / np.median(gaps[gaps > 0])
        if self.max_speed is not None:
            limit = self.max_speed.value
        # Smallest and largest speeds along and across, in mas/yr.
        given = self.along, self.across
        limits = np.array([[-limit, limit] if v is None else v.value for v in given])
        tolerance = self.tolerance * fwhm / cube.pixel_scale.to_value(u.mas)
        fastest = np.hypot(*np.abs(limits).max(axis=1)) if self._limited else limit
        how = {"n_workers": n_workers, "progress_bar": progress_bar}
        matches = self._match(cube, decompositions, fastest, tolerance, **how)
        target = target_ssps(matches, ssps)
        found = linking.find_candidates(matches, target, ssps, years, self.max_gap)
        # Features do not jump into the core or out of it.
        core = linking.core_ssps(ssps, cube)
        found = found.select(core[found.source] == core[found.target])
        found = found.select(self._inside(found, ssps, cube, limits, fwhm))
        return linking.link(found, ssps, tolerance)

    def _match(
        self, cube, decompositions, fastest, tolerance, n_workers, progress_bar
    ):  # fmt: skip
        """
        Correlate the SSPs of each epoch with the next epochs.

        The window of each pair of epochs is as large as its interval requires.
        """
        years = cube.years.to_value(u.yr)
        pairs = np.stack(np.triu_indices(len(years), 1), axis=1)
        interval = np.diff(years[pairs])[:, 0]
        keep = (np.diff(pairs)[:, 0] <= self.max_gap + 1) & (interval > 0)
        pairs, interval = pairs[keep], interval[keep]
        # Pixels may not be square.
        side = np.hypot(*cube.pixel_matrix.value)[::-1]
        radius = fastest * interval[:, None] / side + (MARGIN + 1) * tolerance
        # Few sizes of windows, two an octave, mean few calls of the correlation.
        radius = np.ceil(2 ** (np.ceil(2 * np.log2(radius)) / 2)).astype(int)
        radius = np.minimum(radius, np.array(cube.shape[1:]) - 1)
        columns, correlator = [], Correlator(self.kappa)
        kinds, kind = np.unique(radius, axis=0, return_inverse=True)
        with progress(len(pairs), "Correlating", show=progress_bar) as done:
            for k, window in enumerate(kinds.tolist()):
                own = pairs[kind.ravel() == k]
                part = correlator(decompositions, own, window, n_workers=n_workers)
                columns.append(tuple(getattr(part, name) for name in COLUMNS))
                done(len(own))
        return Matches.from_columns(columns, pairs)

    @property
    def _limited(self):
        """Whether speeds are limited along and across a direction, not in all alike."""
        return self.along is not None or self.across is not None

    def _inside(self, candidates, ssps, cube, limits, fwhm):
        """Return which candidates are within the limits of speed."""
        sky = candidates.motion[:, ::-1] @ cube.pixel_matrix.value.T
        (low, high), spare = limits.T, MARGIN * self.tolerance * fwhm
        time = candidates.interval[:, None]
        if not self._limited:
            return np.hypot(*sky.T) <= high[0] * candidates.interval + spare
        radial = isinstance(self.position_angle, str)
        frame = RadialFrame() if radial else PositionAngleFrame(self.position_angle)
        position = np.stack(ssp_offsets(ssps, cube), axis=1)[candidates.source]
        moved = frame_displacements(frame, position, sky)
        # A radial frame has no axes at its origin, and any will do there.
        moved = np.where(np.isfinite(moved), moved, sky)
        inside = (moved >= low * time - spare) & (moved <= high * time + spare)
        return inside.all(axis=1)


def linked_features(cube, ssps, tracks, core):
    """
    Return the features that tracks of SSPs make up, one row for each.

    A pattern that is followed on several scales is one feature, that of the finest
    scale.  Detections are the SSPs of these tracks, and of the others those that are
    not the same pattern, also the finest ones.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    tracks : list of `~numpy.ndarray` of int
        SSPs of each.
    core : `~numpy.ndarray` of bool, shape (n_ssps,)
        The SSPs that are the core.

    Returns
    -------
    `~astro_scc.features.Features`
        There are no disturbed assignments, so ``same_speed`` is 1; no track is
        ``proven``, as the rounds of `link` need not find the best links.
    """
    keep, kept = np.zeros(len(ssps), bool), []
    for track in sorted(tracks, key=lambda track: ssps.scale[track[0]]):
        if np.mean([is_new(ssps, keep, k) for k in track.tolist()]) > 0.5:
            keep[track] = True
            kept.append(track)
    own = finest_patterns(ssps, keep, ~core)
    # Detections are in the order of the epochs.
    kept = sorted((np.searchsorted(own, track) for track in kept), key=min)
    cores = np.flatnonzero(core)
    cores = cores[lowest(ssps.scale[cores], ssps.epoch[cores])]
    detections, core = (ssps_of(cube, ssps, which) for which in (own, cores))
    return Features(cube, detections, core, tuple(Track(k, 1.0, False) for k in kept))
