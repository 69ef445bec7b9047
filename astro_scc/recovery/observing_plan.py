# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Plan observations: the number and spacing of epochs that distinguish two speeds."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import astropy.units as u
import numpy as np
from astropy.table import QTable, Row

from astro_scc.columns import build_table
from astro_scc.epochs.beam import Beam
from astro_scc.measurement import versions
from astro_scc.measurement.products import plain_meta
from astro_scc.measurement.stacking import seeded
from astro_scc.recovery.completeness import (
    check_trials,
    direction,
    epochs_needed,
    in_mas,
    positive_quantities,
    run_all,
    share,
    smallest_p,
)
from astro_scc.scc import StackedCrossCorrelation
from astro_scc.simulation import simulate_two_fluid
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
    pair = positive_quantities("speeds", speeds, "2 mas/yr").to_value(PM_UNIT)
    if len(pair) != 2 or pair[0] == pair[1]:
        raise ValueError(f"speeds must be two different ones, got {speeds}")
    slow, fast = sorted(pair.tolist())
    beam, width = _beam(beam, position_angle)
    length = FIELD * width if field is None else in_mas("field", field)
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
    n, times = np.repeat(numbers, len(intervals)), np.tile(intervals, len(numbers))
    years, smallest = times.to_value(u.yr), np.array([smallest_p(k) for k in n])
    # Rounding must not decide.
    total, least = (n - 1) * years, width * (1 - 1e-9)
    limits = {
        "epochs": smallest > alpha,
        "rest": slow * total < SearchSettings().slowest * least,
        "field": fast * years > CROSSED * length * (1 + 1e-9),
        "difference": (fast - slow) * total < RESOLVED * least,
    }
    limit = np.select(list(limits.values()), list(limits), "")
    jet = _jet(beam, length) | options
    how = {"width": width, "alpha": alpha, "n_trials": n_trials, "jet": jet}
    measure = partial(_find, speeds=(slow, fast), **how)
    wanted_jets = np.where(limit == "", n_jets, 0).tolist()
    campaigns = list(zip(n.tolist(), years.tolist(), strict=True))
    how = n_workers, "Planning", progress_bar
    found = run_all(measure, campaigns, wanted_jets, np.random.default_rng(rng), *how)
    values = {
        "n_epochs": n,
        "interval": times.value,
        "total_time": times.value * (n - 1),
        "motion_slow": years / width * slow,
        "motion_fast": years / width * fast,
        "p_smallest": smallest,
        "limit": limit,
        "n_jets": wanted_jets,
    }
    rows = [
        dict(zip(values, row, strict=True)) | _fractions(own)
        for own, row in zip(found, zip(*values.values(), strict=True), strict=True)
    ]
    of_time = {k: (times.unit, COLUMNS[k][1]) for k in ("interval", "total_time")}
    table = build_table(rows, COLUMNS | of_time)
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


def _jet(beam, length):
    """Return the options of a simulated jet with a beam and a length in mas."""
    pixel = np.sqrt(beam.major * beam.minor) / BEAM_PIXELS
    start = 2.0 * BEAM_PIXELS
    end = start + length / pixel.value
    shape = (128, int(end) + 4 * BEAM_PIXELS)
    return {"pixel_scale": pixel, "beams": beam, "extent": (start, end), "shape": shape}


def _find(campaign, rng, *, speeds, width, alpha, n_trials, jet):
    """Return whether the slow and the fast stream of one simulated jet are found."""
    (n_epochs, interval), (jet_rng, trial_rng) = campaign, rng.spawn(2)
    slow, fast = speeds * PM_UNIT
    jet = {"n_epochs": n_epochs, "interval": interval * u.yr} | jet
    cube = simulate_two_fluid(slow=slow, fast=fast, rng=jet_rng, **jet).cube
    per_interval = width / interval
    scc = StackedCrossCorrelation(
        scales=SCALES,
        max_speed=fast + MARGIN * per_interval * PM_UNIT,
        position_angle=JET,
        alpha=alpha,
    )
    table = scc(cube, n_trials=n_trials, rng=trial_rng).components
    moving = table[table["kind"] == "moving"]
    along, across = (
        moving[name].to_value(PM_UNIT) for name in ("pm_parallel", "pm_transverse")
    )
    return [
        np.any(np.hypot(along - v, across) <= TOLERANCE * min(v, per_interval))
        for v in speeds
    ]


def _fractions(found):
    """Return the shares of jets in which the streams are found, with their limits."""
    found = np.array(found, dtype=bool).reshape(-1, 2)
    counts = *found.sum(axis=0), found.all(axis=1).sum()
    row = {}
    for name, count in zip(FRACTIONS, counts, strict=True):
        limits = share(count, len(found)) if len(found) else [None] * 3
        row[name], row[f"{name}_low"], row[f"{name}_high"] = limits
    return row


def _as_dict(row):
    """Return a row as a dictionary that ECSV can keep in a meta."""
    fraction = row["fraction_both"]
    found = {name: row[name] for name in ("n_epochs", "interval", "total_time")}
    found["fraction_both"] = None if fraction is np.ma.masked else fraction
    return plain_meta(found)


def _beam(beam, position_angle):
    """Return the beam in the frame of the simulated jet, and its width along it."""
    if not hasattr(beam, "major"):
        width = in_mas("beam", beam) * u.mas
        beam = Beam(width, width)
    if position_angle is None:
        width = np.sqrt(beam.major * beam.minor)
        beam = Beam(width, width)
    else:
        turn = JET - direction(position_angle)
        beam = Beam(beam.major, beam.minor, beam.pa + turn)
    return beam, float(beam.fwhm_along(JET).to_value(u.mas))
