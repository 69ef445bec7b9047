# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Plan observations: the number and spacing of epochs that distinguish two speeds."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import astropy.units as u
import numpy as np
from astropy.table import QTable, Row

from astro_scc.epochs.beam import Beam
from astro_scc.measurement import versions
from astro_scc.measurement.products import plain_meta
from astro_scc.measurement.stacking import seeded
from astro_scc.measurement.tables import build_table
from astro_scc.quantities import named, one_quantity
from astro_scc.recovery.completeness import (
    check_trials,
    epochs_needed,
    positive_quantities,
    run_all,
    share,
    smallest_p,
)
from astro_scc.stacking import SearchSettings
from astro_scc.units import PM_UNIT

#: Width of a simulated beam in pixels, as in the paper's test, and the scales for it.
BEAM_PIXELS = 10
SCALES = (1, 2, 3)
#: Position angle of the simulated jets.
JET = 270 * u.deg
#: Smallest difference of motion over the whole time, in beams, that two streams need,
#: because the features of one scatter as much.
RESOLVED = 0.5
#: Largest share of the field that features may cross between consecutive epochs.
CROSSED = 0.5
#: Beams per interval by which the search goes beyond the faster speed.
MARGIN = 2.0
#: Largest difference of a component from a stream, relative to its speed and to one
#: beam per interval.
TOLERANCE = 0.2
#: Length of the simulated field by default, in beams.
FIELD = 20.0
#: Columns of the table: unit and description.
COLUMNS = {
    "n_epochs": (None, "number of epochs"),
    "interval": (None, "time between consecutive epochs"),
    "total_time": (None, "time from the first to the last epoch"),
    "motion_slow": (None, "motion of the slower stream per interval, in beams"),
    "motion_fast": (None, "motion of the faster stream per interval, in beams"),
    "p_smallest": (None, "smallest p_global of something that moves, 2/N!"),
    "limit": (None, "why the speeds cannot be distinguished; empty if they may be"),
    "n_jets": (None, "simulated jets that were measured"),
}
_LIMIT = "limit of the 95% interval (Jeffreys)"
FRACTIONS = {
    "fraction_slow": "share of jets in which the slower stream is found",
    "fraction_fast": "share of jets in which the faster stream is found",
    "fraction_both": "share of jets in which both are found",
}
for _name, _text in FRACTIONS.items():
    COLUMNS[_name] = None, _text
    COLUMNS[f"{_name}_low"] = COLUMNS[f"{_name}_high"] = None, _LIMIT


def plan(
    *, speeds: u.Quantity, beam: Beam | u.Quantity, n_epochs: int | Sequence[int],
    intervals: u.Quantity | Sequence[u.Quantity],
    position_angle: u.Quantity | None = None, field: u.Quantity | None = None,
    n_jets: int = 20, n_trials: int = 200, alpha: float = 0.05, wanted: float = 0.9,
    rng: np.random.Generator | int | None = None, n_workers: int = 1,
    progress_bar: bool = False, **options: Any,
) -> QTable:  # fmt: skip
    """
    Find the number and spacing of epochs that distinguish two speeds.

    For every number of epochs and interval, the jet of the paper's two-fluid
    test is simulated with the two speeds and measured, unless a simple
    estimate says that they cannot be distinguished.

    Parameters
    ----------
    speeds : `~astropy.units.Quantity`, shape (2,)
        Proper motions of the two streams, in any order.
    beam : `~astro_scc.epochs.Beam` or `~astropy.units.Quantity`
        The beam, or the full width of a round one.
    n_epochs : int or sequence of int
    intervals : `~astropy.units.Quantity`, scalar or shape (n,), or sequence
        Times between consecutive epochs.
    position_angle : `~astropy.units.Quantity`, optional
        Direction of the jet, north through east, relative to which the beam is
        oriented.  Without it, the beam is replaced by a round one of the same
        area.
    field : `~astropy.units.Quantity`, optional
        Visible length of the jet, an angle; 20 beams by default.
    n_jets : int, optional
        Number of simulated jets for each row.  With 0, nothing is simulated and
        the table holds only the simple estimate.
    n_trials : int, optional
        Number of trials of each measurement.
    alpha : float, optional
        Largest ``p_global`` of a component.
    wanted : float, optional
        Share of jets in which both streams must be found for
        ``meta["smallest"]``, see `smallest_plan`.
    rng : None, int or `~numpy.random.Generator`, optional
        Every jet has a generator of its own, so the table is the same for any
        ``n_workers``.
    n_workers : int, optional
        Number of threads.
    progress_bar : bool, optional
    **options
        Options of `~astro_scc.simulation.simulate_two_fluid` (``densities``,
        ``dense``, ``jitter``) and `~astro_scc.simulation.JetSimulation`
        (``noise``, ``core``); lengths there are in pixels, ten to the beam.

    Returns
    -------
    `~astropy.table.QTable`
        One row per number of epochs and interval: ``n_epochs``, ``interval``,
        ``total_time``, ``motion_slow`` and ``motion_fast`` (beams per
        interval), ``p_smallest``, ``limit``, ``n_jets``, and the shares
        ``fraction_slow``, ``fraction_fast`` and ``fraction_both``, each with
        its 95% interval ``_low`` and ``_high`` (Jeffreys), masked if nothing
        was simulated.  ``meta["smallest"]`` is the row that `smallest_plan`
        finds, as a dictionary, or None.

    Raises
    ------
    ValueError
        If an argument is out of its range.
    `~astropy.units.UnitConversionError`
        If a unit cannot be converted.

    Notes
    -----
    The simple estimate, ``limit``, is the reason why two speeds v < V cannot be
    distinguished.  With N epochs over the time T, and b the beam along the jet:

    - "epochs": 2 / N! is above ``alpha``;
    - "rest": v T < b, and the slower stream is not searched because blended
      standing features drift as far (``slowest`` of
      `~astro_scc.stacking.SearchSettings`);
    - "field": features of the faster stream cross more than half of the field
      between consecutive epochs;
    - "difference": (V - v) T < 0.5 b, and the speeds of features scatter as
      much.

    A stream is found if a component moves with ``p_global <= alpha`` and its
    velocity agrees within 20% and within 0.2 beams over the interval.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.recovery import plan
    >>> table = plan(speeds=[0.5, 1] * u.mas / u.yr, beam=0.8 * u.mas,
    ...              n_epochs=[4, 8, 15], intervals=[0.2, 0.5] * u.yr, n_jets=0)
    >>> table["n_epochs", "interval", "motion_slow", "motion_fast", "limit"].pprint()
    n_epochs interval motion_slow motion_fast limit
                yr
    -------- -------- ----------- ----------- ------
           4      0.2       0.125        0.25 epochs
           4      0.5      0.3125       0.625 epochs
           8      0.2       0.125        0.25   rest
           8      0.5      0.3125       0.625
          15      0.2       0.125        0.25
          15      0.5      0.3125       0.625
    >>> table.meta["smallest"]["n_epochs"], table.meta["smallest"]["interval"]
    (8, <Quantity 0.5 yr>)
    """
    slow, fast = _two_speeds(speeds)
    beam, width = _beam(beam, position_angle)
    length = FIELD * width if field is None else _angle("field", field)
    numbers = np.atleast_1d(n_epochs)
    if numbers.size == 0 or numbers.dtype.kind not in "iu" or numbers.min() < 2:
        raise ValueError(f"n_epochs must be one or more numbers from 2, got {n_epochs}")
    intervals = positive_quantities("intervals", intervals, "0.5 yr")
    if n_jets < 0:
        raise ValueError(f"n_jets must be zero or positive, got {n_jets}")
    for name, value in (("alpha", alpha), ("wanted", wanted)):
        if not 0 < value < 1:
            raise ValueError(f"{name} must be between 0 and 1, got {value}")
    if n_jets:
        check_trials(n_trials, alpha)
    rng, seed = seeded(rng)
    campaigns = [
        _Campaign(int(n), interval, slow, fast, width, length, alpha)
        for n in numbers
        for interval in intervals.to_value(u.yr)
    ]

    def measure(campaign, own):
        return campaign.measure(beam, n_trials, own, options)

    wanted_jets = [0 if campaign.limit else n_jets for campaign in campaigns]
    how = n_workers, "Planning", progress_bar
    found = run_all(measure, campaigns, wanted_jets, np.random.default_rng(rng), *how)
    times = np.tile(intervals.value, len(numbers))
    rows = [
        campaign.row(interval, np.array(own, dtype=bool).reshape(-1, 2))
        for campaign, interval, own in zip(campaigns, times, found, strict=True)
    ]
    columns = dict(COLUMNS)
    for name in ("interval", "total_time"):
        columns[name] = intervals.unit, COLUMNS[name][1]
    table = build_table(rows, columns)
    row = smallest_plan(table, wanted)
    table.meta = {
        "speeds": [slow, fast] * PM_UNIT,
        "beam_along": width * u.mas,
        "field": length * u.mas,
        "n_trials": n_trials,
        "alpha": alpha,
        "wanted": wanted,
        "epochs_needed": epochs_needed(alpha),
        "seed": seed,
        "versions": versions(),
        "smallest": None if row is None else _as_dict(row),
    }
    return table


def smallest_plan(table: QTable, wanted: float = 0.9) -> Row | None:
    """
    Return the smallest row of a plan that reaches a share.

    It is the row with the fewest epochs and, among these, the shortest total
    time.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        From `plan`.
    wanted : float, optional
        Smallest ``fraction_both``.  If nothing was simulated, rows without a
        ``limit`` qualify.

    Returns
    -------
    `~astropy.table.Row` or None
        None if no row reaches it.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.recovery import plan, smallest_plan
    >>> table = plan(speeds=[1, 4] * u.mas / u.yr, beam=1 * u.mas, n_epochs=[3, 10],
    ...              intervals=90 * u.day, n_jets=0)
    >>> int(smallest_plan(table)["n_epochs"])
    10
    """
    if np.any(table["n_jets"] > 0):
        reached = np.ma.filled(table["fraction_both"], -1.0) >= wanted
    else:
        reached = table["limit"] == ""
    rows = np.flatnonzero(reached)
    if len(rows) == 0:
        return None
    time = table["total_time"].value
    return table[min(rows, key=lambda k: (table["n_epochs"][k], time[k]))]


@dataclass(frozen=True)
class _Campaign:
    """Epochs at one spacing; speeds are in mas/yr, times in yr, angles in mas."""

    n_epochs: int
    interval: float
    slow: float
    fast: float
    width: float
    field: float
    alpha: float

    @property
    def total(self):
        return (self.n_epochs - 1) * self.interval

    @property
    def limit(self):
        """The reason why the speeds cannot be distinguished, or an empty string."""
        if smallest_p(self.n_epochs) > self.alpha:
            return "epochs"
        # Rounding must not decide.
        beam = self.width * (1 - 1e-9)
        if self.slow * self.total < SearchSettings().slowest * beam:
            return "rest"
        if self.fast * self.interval > CROSSED * self.field * (1 + 1e-9):
            return "field"
        if (self.fast - self.slow) * self.total < RESOLVED * beam:
            return "difference"
        return ""

    def row(self, interval, found):
        """Return the row of the table, given the streams ``found`` in each jet."""
        per_beam = self.interval / self.width
        row = {
            "n_epochs": self.n_epochs,
            "interval": interval,
            "total_time": interval * (self.n_epochs - 1),
            "motion_slow": per_beam * self.slow,
            "motion_fast": per_beam * self.fast,
            "p_smallest": smallest_p(self.n_epochs),
            "limit": self.limit,
            "n_jets": len(found),
        }
        counts = *found.sum(axis=0), found.all(axis=1).sum()
        for name, count in zip(FRACTIONS, counts, strict=True):
            limits = share(count, len(found)) if len(found) else [None] * 3
            row[name], row[f"{name}_low"], row[f"{name}_high"] = limits
        return row

    def measure(self, beam, n_trials, rng, options):
        """Return whether the slow and the fast stream of one jet are found."""
        from astro_scc.scc import StackedCrossCorrelation
        from astro_scc.simulation import simulate_two_fluid

        jet_rng, trial_rng = rng.spawn(2)
        pixel = np.sqrt(beam.major * beam.minor) / BEAM_PIXELS
        start = 2.0 * BEAM_PIXELS
        end = start + self.field / pixel.value
        jet = {
            "n_epochs": self.n_epochs,
            "interval": self.interval * u.yr,
            "pixel_scale": pixel,
            "beams": beam,
            "extent": (start, end),
            "shape": (128, int(end) + 4 * BEAM_PIXELS),
        }
        speeds = {"slow": self.slow * PM_UNIT, "fast": self.fast * PM_UNIT}
        jet = simulate_two_fluid(**speeds, rng=jet_rng, **(jet | options))
        per_interval = self.width / self.interval
        scc = StackedCrossCorrelation(
            scales=SCALES,
            max_speed=(self.fast + MARGIN * per_interval) * PM_UNIT,
            position_angle=JET,
            alpha=self.alpha,
        )
        table = scc(jet.cube, n_trials=n_trials, rng=trial_rng).components
        moving = table[table["kind"] == "moving"]
        along = moving["pm_parallel"].to_value(PM_UNIT)
        across = moving["pm_transverse"].to_value(PM_UNIT)

        def found(speed):
            near = TOLERANCE * min(speed, per_interval)
            return bool(np.any(np.hypot(along - speed, across) <= near))

        return [found(self.slow), found(self.fast)]


def _as_dict(row):
    """Return a row as a dictionary that ECSV can keep in a meta."""
    fraction = row["fraction_both"]
    found = {name: row[name] for name in ("n_epochs", "interval", "total_time")}
    found["fraction_both"] = None if fraction is np.ma.masked else fraction
    return plain_meta(found)


def _angle(name, value):
    return named(name, one_quantity, value, "an angle", "1 mas").to_value(u.mas)


def _two_speeds(speeds):
    """Return the slower and the faster of two speeds, in mas/yr."""
    values = positive_quantities("speeds", speeds, "2 mas/yr").to_value(PM_UNIT)
    if len(values) != 2 or values[0] == values[1]:
        raise ValueError(f"speeds must be two different ones, got {speeds}")
    return sorted(values.tolist())


def _beam(beam, position_angle):
    """Return the beam in the frame of the simulated jet, and its width along it."""
    if not hasattr(beam, "major"):
        width = _angle("beam", beam) * u.mas
        beam = Beam(width, width)
    if position_angle is None:
        width = np.sqrt(beam.major * beam.minor)
        beam = Beam(width, width)
    else:
        how = "an angle", "65 deg", False
        turn = JET - named("position_angle", one_quantity, position_angle, *how)
        beam = Beam(beam.major, beam.minor, beam.pa + turn)
    return beam, float(beam.fwhm_along(JET).to_value(u.mas))
