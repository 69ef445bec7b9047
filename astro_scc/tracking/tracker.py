# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Link the SSPs of a cube within limits of speed, and the features of these links."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import astropy.units as u
import numpy as np
from numpy.typing import ArrayLike

from astro_scc import quantities as q
from astro_scc.alignment.registration import warn_of_misalignment
from astro_scc.correlation import Correlator, Matches
from astro_scc.correlation.correlate import COLUMNS, target_ssps
from astro_scc.decomposition import SSPs
from astro_scc.decomposition.segmentation import Decomposition, require_ssps
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.epochs import EpochCube
from astro_scc.features import Features
from astro_scc.features.detections import finest_patterns, is_new, ssp_sizes, ssps_of
from astro_scc.features.tracks import Track
from astro_scc.images.beam import require_common_beam
from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import PositionAngleFrame, RadialFrame
from astro_scc.kinematics.frames import frame_displacements, mean_width
from astro_scc.progress import progress
from astro_scc.settings import BEAMS, require
from astro_scc.tracking import linking
from astro_scc.tracking.linking import Links
from astro_scc.units import PM_UNIT

#: Without a largest speed, displacements up to this many beams are searched.
BEAMS_PER_INTERVAL = 4.0
#: Displacements may exceed the limits by this many tolerances.
MARGIN = 2.0
#: Sizes of windows in pixels; few sizes mean few calls of the correlation.
WINDOWS = (8, 12, 16, 20, 24, 32, 40, 48, 56, 64, 72, 80, 96, 112, 128, 160, 192, 224,
           256, 320, 384, 448, 512, 768, 1024)  # fmt: skip
#: Checks of the settings that a measurement does not have, and their units.
SPEEDS = (q.check_range, "a smallest and a largest speed", "-1 4 mas/yr")
CHECKS = {
    "along": (PM_UNIT, *SPEEDS),
    "across": (PM_UNIT, *SPEEDS),
    "tolerance": (None, *BEAMS),
    "max_gap": (None, q.check_integer, 0),
    "max_interval": (u.yr, q.one_quantity, "a time", "1 yr"),
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
    max_interval : `~astropy.units.Quantity`, optional
        Longest time between two epochs that are linked.
    min_epochs : int, optional
        Fewest epochs of a track.
    kappa : float, optional
        Smallest correlation of a candidate.
    target, min_overlap
        See `~astro_scc.correlation.Correlator`.
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
    max_interval: u.Quantity | str | None = None
    min_epochs: int = 3
    kappa: float = 0.5
    target: str = "segments"
    min_overlap: float = 0.8
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
        limited = self.along is not None or self.across is not None
        if limited and self.position_angle is None:
            raise ValueError("along and across need a position_angle")

    def speed_limit(self, cube: EpochCube, scales: ArrayLike) -> u.Quantity:
        """
        Return the largest speed that is searched.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`
        scales : sequence of float

        Returns
        -------
        `~astropy.units.Quantity`
            In mas/yr.

        Raises
        ------
        ValueError
            If no two epochs have different dates.
        """
        steps = np.diff(cube.years.to_value(u.yr))
        if not np.any(steps > 0):
            date = cube.times[0].isot
            raise ValueError(
                f"tracking needs epochs of two different dates, not {date}"
            )
        if self.max_speed is not None:
            return u.Quantity(self.max_speed)
        step = np.median(steps[steps > 0])
        return BEAMS_PER_INTERVAL * mean_fwhm(cube, scales) / step * PM_UNIT

    def __call__(
        self, cube: EpochCube, decompositions: Sequence[Decomposition], *,
        select: ArrayLike | None = None, **how: Any,
    ) -> Features:  # fmt: skip
        """
        Return the features of a cube.

        Parameters
        ----------
        cube, decompositions, select, **how
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
        links = self.link(cube, decompositions, select=select, **how)
        ssps = SSPs.of_epochs(decompositions)
        core = linking.core_ssps(ssps, cube)
        jet = ~core if select is None else np.asarray(select) & ~core
        tracks = [
            t for t in linking.chains(links, ssps, self.min_epochs) if jet[t].all()
        ]
        return linked_features(cube, ssps, tracks, core, jet)

    def link(
        self, cube: EpochCube, decompositions: Sequence[Decomposition], *,
        select: ArrayLike | None = None, n_workers: int = 1, progress_bar: bool = False,
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
        select : array_like of bool, shape (n_ssps,), optional
            The SSPs that are linked.
        n_workers : int, optional
        progress_bar : bool, optional

        Returns
        -------
        ``Links``

        Raises
        ------
        ValueError
            If ``decompositions`` has not one entry per epoch or ``select`` not
            one value per SSP, if no epoch shows an SSP, if no two epochs have
            different dates, or if beams differ and ``common_beam`` is True.

        Warns
        -----
        `~astro_scc.exceptions.MeasurementWarning`
            If the alignment of the epochs is as poor as 0.2 beams or worse.
        """
        ssps, select = self._checked(cube, decompositions, select)
        fwhm = mean_fwhm(cube, decompositions[0].scales)
        limit = self.speed_limit(cube, decompositions[0].scales).value
        # Smallest and largest speeds along and across, in mas/yr.
        given = self.along, self.across
        limits = np.array([[-limit, limit] if v is None else v.value for v in given])
        how = {"select": select, "n_workers": n_workers, "progress_bar": progress_bar}
        matches = self._match(cube, decompositions, limits, fwhm, **how)
        target = target_ssps(matches, ssps)
        target = np.where((target >= 0) & select[target], target, -1)
        core = linking.core_ssps(ssps, cube)

        def inside(found):
            # Features do not jump into the core or out of it.
            same = core[found.source] == core[found.target]
            return same & self._inside(found, ssps, cube, limits, fwhm)

        how = {"max_gap": self.max_gap, "inside": inside}
        of = matches, target, ssps, cube.years.to_value(u.yr)
        candidates = linking.find_candidates(*of, **how)
        parent = linking.coarser_ssps(ssps, cube.shape[2])
        tolerance = self.tolerance * fwhm / cube.pixel_scale.to_value(u.mas)
        return linking.link(candidates, ssps, parent=parent, tolerance=tolerance)

    def _match(
        self, cube, decompositions, limits, fwhm, *, select, n_workers, progress_bar
    ):
        """
        Correlate the SSPs of each epoch with the next epochs.

        The window of each pair of epochs is as large as its interval requires.
        """
        years = cube.years.to_value(u.yr)
        pairs = np.stack(np.triu_indices(len(years), 1), axis=1)
        interval = np.diff(years[pairs])[:, 0]
        limit = np.inf if self.max_interval is None else self.max_interval.value
        keep = np.diff(pairs)[:, 0] <= self.max_gap + 1
        keep &= (0 < interval) & (interval <= limit)
        pairs, interval = pairs[keep], interval[keep]
        margin = (MARGIN + 1) * self.tolerance * fwhm / cube.pixel_scale.to_value(u.mas)
        radius = self._fastest(cube, limits) * interval[:, None] + margin
        radius = np.array(WINDOWS)[np.searchsorted(WINDOWS[:-1], radius)]
        radius = np.minimum(radius, np.array(cube.shape[1:]) - 1)
        columns, how = [], {"select": select, "n_workers": n_workers}
        correlator = Correlator(self.kappa, self.target, self.min_overlap)
        kinds, kind = np.unique(radius, axis=0, return_inverse=True)
        with progress(len(pairs), "Correlating", show=progress_bar) as done:
            for k, window in enumerate(kinds.tolist()):
                own = pairs[kind.ravel() == k]
                part = correlator(decompositions, own, window, **how)
                columns.append(tuple(getattr(part, name) for name in COLUMNS))
                done(len(own))
        return Matches.from_columns(columns, pairs)

    @property
    def _frame(self):
        """Axes of the limits of speed; None if speeds are limited in any direction."""
        if self.along is None and self.across is None:
            return None
        radial = isinstance(self.position_angle, str)
        return RadialFrame() if radial else PositionAngleFrame(self.position_angle)

    def _fastest(self, cube, limits):
        """Return the largest speeds along (y, x), in pixels per year."""
        frame = self._frame
        matrix = np.linalg.inv(cube.pixel_matrix.value)
        if isinstance(frame, PositionAngleFrame):
            corners = np.stack(np.meshgrid(*limits)).reshape(2, -1)
            # The frame's matrix is symmetric and orthogonal, so it is its own inverse.
            return np.abs(matrix @ frame.matrix() @ corners).max(axis=1)[::-1]
        ends = np.abs(limits).max(axis=1)
        fastest = ends[0] if frame is None else np.hypot(*ends)
        return fastest * np.hypot(*matrix.T)[::-1]

    def _inside(self, candidates, ssps, cube, limits, fwhm):
        """Return which candidates are within the limits of speed."""
        pixels = np.stack([candidates.dx, candidates.dy], axis=1)
        sky = pixels @ cube.pixel_matrix.value.T
        (low, high), spare = limits.T, MARGIN * self.tolerance * fwhm
        time = candidates.interval[:, None]
        if self._frame is None:
            return np.hypot(*sky.T) <= high[0] * candidates.interval + spare
        position = np.stack(ssp_offsets(ssps, cube), axis=1)[candidates.source]
        moved = frame_displacements(self._frame, position, sky)
        # A radial frame has no axes at its origin, and any will do there.
        moved = np.where(np.isfinite(moved), moved, sky)
        inside = (moved >= low * time - spare) & (moved <= high * time + spare)
        return inside.all(axis=1)

    def _checked(self, cube, decompositions, select):
        """Return the SSPs of all epochs, and which of them are linked."""
        if self.common_beam:
            require_common_beam(cube)
        warn_of_misalignment(cube)
        if len(decompositions) != len(cube):
            each = f"{len(decompositions)} decompositions for {len(cube)} epochs"
            raise ValueError(f"{each}: give one for each")
        ssps = SSPs.of_epochs(decompositions)
        require_ssps(ssps, decompositions[0].scales)
        select = np.ones(len(ssps), bool) if select is None else np.asarray(select)
        if select.shape != (len(ssps),) or select.dtype != bool:
            raise ValueError(
                f"select must be one bool for each of the {len(ssps)} SSPs, "
                f"got {select.dtype} of shape {select.shape}"
            )
        return ssps, select


def linked_features(cube, ssps, tracks, core, jet):
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
    core, jet : `~numpy.ndarray` of bool, shape (n_ssps,)
        The SSPs that are the core, and those that are detections.

    Returns
    -------
    `~astro_scc.features.Features`
        There are no disturbed assignments, so ``same_speed`` is 1; no track is
        ``proven``, as the rounds of `link` need not find the best links.
    """
    size, keep, kept = ssp_sizes(ssps), np.zeros(len(ssps), bool), []
    for track in sorted(tracks, key=lambda track: size[track[0]]):
        if np.mean([is_new(ssps, keep, k) for k in track.tolist()]) > 0.5:
            keep[track] = True
            kept.append(track)
    own = finest_patterns(ssps, keep, jet)
    number = np.full(len(ssps), -1)
    number[own] = np.arange(len(own))
    # Detections are in the order of the epochs.
    kept = sorted((number[track] for track in kept), key=lambda own: own[0])
    cores = np.flatnonzero(core)
    cores = cores[linking.lowest(size[cores], ssps.epoch[cores])]
    fwhm = mean_fwhm(cube, np.unique(ssps.scale))
    detections, core = (ssps_of(cube, ssps, which, fwhm) for which in (own, cores))
    return Features(cube, detections, core, tuple(Track(k, 1.0, False) for k in kept))


def mean_fwhm(cube, scales):
    """Return the resolution in mas: the mean beam, or twice the middle scale."""
    if cube.beams is None:
        middle = np.exp(np.mean(np.log([scale_size(s) for s in scales])))
        return 2 * middle * cube.pixel_scale.to_value(u.mas)
    return mean_width(cube)
