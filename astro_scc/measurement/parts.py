# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The main speed, measured again from parts of the data."""

from itertools import combinations

import astropy.units as u
import numpy as np
import scipy

from astro_scc.columns import with_errors
from astro_scc.images.dates import date_labels
from astro_scc.spectrum.permutations import within
from astro_scc.streams import decomposed, finder, parts
from astro_scc.units import offset_unit

#: Speeds of two parts differ if their difference is larger than so many errors.
DIFFERENT = 2.0


def parts_of(search):
    """
    Measure the main speed from parts of the data.

    Parameters
    ----------
    search : ``StreamSearch``

    Returns
    -------
    list of dict
        Rows of the table, as plain numbers in mas/yr; the first is the whole.  Empty if
        nothing moves.
    """
    flow, streams, fit = search.flow, search.streams, search.fit
    moving = [k for k, s in enumerate(streams) if s.kind == "moving"]
    if not moving or fit is None:
        return []
    main = max(moving, key=lambda k: streams[k].share)
    start = list(zip(fit.mean, fit.sd, strict=True))

    def speed_of(part, intervals):
        """Return the speed with its error; what has no error is not known."""
        diagram = search.diagram if part is flow else None
        found = parts.fit_part(part, start=start, intervals=intervals, diagram=diagram)
        known = found is not None and found.knows(main)
        error = found.errors(stream=main).mean[0] if known else np.nan
        if not np.isfinite(error):
            return np.nan, np.nan
        return abs(found.fit.mean[main]) * flow.beam, error * flow.beam

    whole = abs(fit.mean[main]) * flow.beam, search.errors.mean[main] * flow.beam
    rows = [_row("the whole spectrum", whole)]
    for pair in _pairs_of_parts(search):
        both = []
        for name, part, intervals in pair:
            try:
                found = speed_of(part, intervals)
            except (np.linalg.LinAlgError, ValueError):
                found = np.nan, np.nan
            both.append(_row(name, found, whole))
        # Both parts may differ from the whole, if they have other features.
        sigma = largest_difference([*both, rows[0]])
        for row in both:
            p = 2 * scipy.special.ndtr(-sigma) if np.isfinite(row["pm"]) else np.nan
            row |= {"change_sigma": sigma, "p_value": p}
            row["significant"] = bool(sigma > DIFFERENT)
        rows += both
    return rows


def largest_difference(rows):
    """Return the largest known difference of two speeds in errors of both, or NaN."""
    off = [
        abs(a["pm"] - b["pm"]) / np.hypot(a["pm_err"], b["pm_err"])
        for a, b in combinations(rows, 2)
    ]
    return np.fmax.reduce(off)


def _row(choice, measured, main=None):
    """Return a row of the table; the whole, ``main``, does not change."""
    speed, error = measured
    change = (0.0, 0.0) if main is None else (speed - main[0], np.hypot(error, main[1]))
    row = {"change_sigma": 0.0, "p_value": 1.0, "significant": False}
    row |= {"choice": choice}
    return row | with_errors(pm=(speed, error), change=change)


def _pairs_of_parts(search):
    """Yield pairs of parts: the name, the flow and the intervals of each."""
    flow, every = search.flow, search.intervals
    apart = np.abs(flow.years - flow.years[:, None])
    apart = apart[np.triu_indices(len(apart), 1)]
    limit, unit = float(np.median(apart[within(apart, every)])), flow.cube.speed_unit
    shown = f"{(limit * u.yr).to_value(unit.bases[1]):.2g} {unit.bases[1]}"
    yield (
        (f"intervals up to {shown}", flow, (every[0], limit)),
        (f"intervals from {shown}", flow, (limit, every[1])),
    )
    middle = len(flow.years) // 2
    if middle >= finder.FEWEST_EPOCHS:
        date = date_labels(flow.cube.times)[middle]
        yield (
            (f"epochs before {date}", flow.part(epochs=slice(middle)), every),
            (f"epochs from {date} on", flow.part(epochs=slice(middle, None)), every),
        )
    r = decomposed.distances(flow.grids[0])
    seen = flow.planes[0].mask & (parts.weight_of(flow) > 0.5)
    if seen.any():
        border = float(np.median(r[seen]))
        unit = offset_unit(border * flow.beam)
        text = f"{(border * flow.beam * u.mas).to_value(unit):.3g} {unit}"
        inner, outer = (flow.part(places=[k * 1.0]) for k in (r < border, r >= border))
        yield (
            (f"inner half, up to {text}", inner, every),
            (f"outer half, from {text}", outer, every),
        )
