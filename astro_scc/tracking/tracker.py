# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Link the SSPs of a cube: settings, search windows, and the call."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import astropy.units as u
import numpy as np
from numpy.typing import ArrayLike

from astro_scc import quantities as q
from astro_scc.alignment.registration import warn_of_misalignment
from astro_scc.correlation import Correlator, Matches
from astro_scc.correlation.matches import COLUMNS, target_ssps
from astro_scc.decomposition import SSPs
from astro_scc.decomposition.decompose import Decomposition
from astro_scc.decomposition.segmentation import require_ssps
from astro_scc.epochs import EpochCube
from astro_scc.features import Features
from astro_scc.images.beam import require_common_beam
from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import PositionAngleFrame, RadialFrame
from astro_scc.kinematics.frames import frame_displacements
from astro_scc.progress import progress
from astro_scc.settings import BEAMS, require
from astro_scc.tracking.candidates import core_ssps, find_candidates
from astro_scc.tracking.likelihood import LinkLikelihood, coarser_ssps
from astro_scc.tracking.linking import Links, link
from astro_scc.tracking.tracks import linked_features, mean_fwhm
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
        for field in fields(self):
            value = _checked_setting(field.name, getattr(self, field.name))
            object.__setattr__(self, field.name, value)
        if isinstance(self.position_angle, str) and self.position_angle != "radial":
            raise ValueError(
                f"position_angle = {self.position_angle!r} must be an angle or 'radial'"
            )
        limited = self.along is not None or self.across is not None
        if limited and self.position_angle is None:
            raise ValueError("along and across need a position_angle")
        self._correlator()

    def _correlator(self):
        return Correlator(
            kappa=self.kappa, target=self.target, min_overlap=self.min_overlap
        )

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
        steps = steps[steps > 0]
        if len(steps) == 0:
            raise ValueError(
                f"tracking needs epochs of two different dates, all {len(cube)} are "
                f"of {cube.times[0].isot}"
            )
        if self.max_speed is not None:
            return u.Quantity(self.max_speed)
        fwhm = mean_fwhm(cube, scales).value
        return BEAMS_PER_INTERVAL * fwhm / np.median(steps) * PM_UNIT

    def _pairs(self, cube):
        """Return the pairs of epochs that may be linked, and their intervals."""
        years = cube.years.to_value(u.yr)
        first, second = np.triu_indices(len(years), 1)
        interval = years[second] - years[first]
        limit = np.inf if self.max_interval is None else self.max_interval.value
        keep = (second - first <= self.max_gap + 1) & (0 < interval)
        keep &= interval <= limit
        return np.stack([first[keep], second[keep]], axis=1), interval[keep]

    def match(
        self, cube: EpochCube, decompositions: Sequence[Decomposition], *,
        select: ArrayLike | None = None, n_workers: int = 1, progress_bar: bool = False,
    ) -> Matches:  # fmt: skip
        """
        Correlate the SSPs of each epoch with the next epochs.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`
        decompositions : sequence of ``Decomposition``
        select : array_like of bool, shape (n_ssps,), optional
            The SSPs that are tracked.
        n_workers : int, optional
        progress_bar : bool, optional

        Returns
        -------
        `~astro_scc.correlation.Matches`
            The window of each pair is as large as its interval requires.
        """
        pairs, interval = self._pairs(cube)
        scales = decompositions[0].scales
        margin = (MARGIN + 1) * self.tolerance * mean_fwhm(cube, scales)
        radius = self._fastest(cube, scales) * interval[:, None]
        radius += float(margin / cube.pixel_scale)
        radius = np.array(WINDOWS)[np.searchsorted(WINDOWS[:-1], radius)]
        radius = np.minimum(radius, np.array(cube.shape[1:]) - 1)
        columns, correlator = [], self._correlator()
        kinds, kind = np.unique(radius, axis=0, return_inverse=True)
        with progress(len(pairs), "Correlating", show=progress_bar) as done:
            for k, window in enumerate(kinds.tolist()):
                own = pairs[kind.ravel() == k]
                part = correlator(
                    decompositions, own, window, select=select, n_workers=n_workers
                )
                columns.append(tuple(getattr(part, name) for name in COLUMNS))
                done(len(own))
        reach = kinds.max(axis=0, initial=0).tolist()
        return Matches.from_columns(columns, pairs, reach, self.kappa).sorted()

    def _limits(self, cube, scales):
        """Return the ranges of speed along and across in mas/yr, shape (2, 2)."""
        limit = self.speed_limit(cube, scales).value
        given = self.along, self.across
        return np.array([[-limit, limit] if v is None else v.value for v in given])

    @property
    def _frame(self):
        """Axes of the limits of speed; None if speeds are limited in any direction."""
        if self.along is None and self.across is None:
            return None
        radial = isinstance(self.position_angle, str)
        return RadialFrame() if radial else PositionAngleFrame(self.position_angle)

    def _fastest(self, cube, scales):
        """Return the largest speeds along (y, x), in pixels per year."""
        limits, frame = self._limits(cube, scales), self._frame
        matrix = np.linalg.inv(cube.pixel_matrix.value)
        if isinstance(frame, PositionAngleFrame):
            corners = np.stack(np.meshgrid(*limits)).reshape(2, -1)
            # The frame's matrix is symmetric and orthogonal, so it is its own inverse.
            return np.abs(matrix @ frame.matrix() @ corners).max(axis=1)[::-1]
        ends = np.abs(limits).max(axis=1)
        fastest = ends[0] if frame is None else np.hypot(*ends)
        return fastest * np.hypot(*matrix.T)[::-1]

    def _inside(self, candidates, ssps, cube, scales):
        """Return which candidates are within the limits of speed."""
        pixels = np.stack([candidates.dx, candidates.dy], axis=1)
        sky = pixels @ cube.pixel_matrix.value.T
        low, high = self._limits(cube, scales).T
        spare = MARGIN * self.tolerance * mean_fwhm(cube, scales).value
        time = candidates.interval[:, None]
        if self._frame is None:
            inside = np.hypot(*sky.T) <= high[0] * candidates.interval + spare
        else:
            position = np.stack(ssp_offsets(ssps, cube), axis=1)[candidates.source]
            moved = frame_displacements(self._frame, position, sky)
            # A radial frame has no axes at its origin, and any will do there.
            moved = np.where(np.isfinite(moved), moved, sky)
            inside = (moved >= low * time - spare) & (moved <= high * time + spare)
            inside = inside.all(axis=1)
        if self.max_interval is not None:
            inside &= candidates.interval <= self.max_interval.value
        return inside

    def __call__(
        self, cube: EpochCube, decompositions: Sequence[Decomposition],
        matches: Matches | None = None, *, select: ArrayLike | None = None,
        n_workers: int = 1, progress_bar: bool = False,
    ) -> Features:  # fmt: skip
        """
        Return the features of a cube.

        Parameters
        ----------
        cube, decompositions, matches, select, n_workers, progress_bar
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
        links = self.link(
            cube, decompositions, matches, select=select, n_workers=n_workers,
            progress_bar=progress_bar,
        )  # fmt: skip
        ssps = SSPs.of_epochs(decompositions)
        return linked_features(
            cube, ssps, links, select=select, min_epochs=self.min_epochs
        )

    def link(
        self, cube: EpochCube, decompositions: Sequence[Decomposition],
        matches: Matches | None = None, *, select: ArrayLike | None = None,
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
        matches : `~astro_scc.correlation.Matches`, optional
            Matches of at least the pairs of epochs that may be linked.  By default
            those of `match`.
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
        if matches is None:
            matches = self.match(
                cube, decompositions, select=select, n_workers=n_workers,
                progress_bar=progress_bar,
            )  # fmt: skip
        scales = decompositions[0].scales
        matches = matches.of_ssps(select)
        matches = matches.select(matches.coefficient >= self.kappa)
        target = target_ssps(matches, ssps)
        target = np.where((target >= 0) & select[target], target, -1)
        core = core_ssps(ssps, cube)
        fwhm = float(mean_fwhm(cube, scales) / cube.pixel_scale)

        def inside(found):
            # Features do not jump into the core or out of it.
            same = core[found.source] == core[found.target]
            return same & self._inside(found, ssps, cube, scales)

        candidates = find_candidates(
            matches, target, ssps, cube.years.to_value(u.yr), max_gap=self.max_gap,
            inside=inside,
        )  # fmt: skip
        return link(
            candidates, ssps, parent=coarser_ssps(ssps, cube.shape[2]),
            likelihood=LinkLikelihood(tolerance=self.tolerance * fwhm),
        )  # fmt: skip

    def _checked(self, cube, decompositions, select):
        """Return the SSPs of all epochs, and which of them are linked."""
        if self.common_beam:
            require_common_beam(cube)
        warn_of_misalignment(cube)
        if len(decompositions) != len(cube):
            raise ValueError(
                f"{len(decompositions)} decompositions for {len(cube)} epochs: "
                "give one for each"
            )
        ssps = SSPs.of_epochs(decompositions)
        require_ssps(ssps, decompositions[0].scales)
        select = np.ones(len(ssps), bool) if select is None else np.asarray(select)
        if select.shape != (len(ssps),) or select.dtype != bool:
            raise ValueError(
                f"select must be one bool for each of the {len(ssps)} SSPs, "
                f"got {select.dtype} of shape {select.shape}"
            )
        return ssps, select


def _checked_setting(name, value):
    """Return the value of a setting in the unit of calculations."""
    if name not in CHECKS:
        return require(name, value)
    unit, check, *more = CHECKS[name]
    found = None if value is None else q.named(name, check, value, *more)
    return found if unit is None or found is None else found.to(unit)
