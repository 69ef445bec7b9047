# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The main speed from parts of the data."""

from itertools import combinations

import numpy as np
from scipy.special import ndtr

from astro_scc.columns import with_errors
from astro_scc.spectrum.diagram import correlate
from astro_scc.spectrum.equations import set_up
from astro_scc.spectrum.errors import fit_errors
from astro_scc.spectrum.gaussians import fit_streams

#: Fewest epochs of half of the dates.
FEWEST_OF_HALF = 6
#: Speeds of two parts differ if their difference is larger than so many errors.
DIFFERENT = 2.0


def part_rows(search, main, parts):
    """
    Fit the streams again to parts of the data.

    Parameters
    ----------
    search : ``StreamSearch``
    main : int
        Number of the stream that is compared, from 0.
    parts : sequence of (str, dict), two by two
        Name of each part, and the arguments of ``flow.part``, or ``intervals``.

    Returns
    -------
    list of dict
        Rows of the table, as plain numbers in mas/yr; the first is the whole.
    """
    if search.fit is None:
        return []
    flow = search.flow
    start = list(zip(search.fit.mean, search.fit.sd, strict=True))

    def speed_of(part, intervals):
        planes = part.planes[0].square_root()
        region = part.regions[0]
        diagram = correlate(planes, region=region)
        equations = set_up(diagram, fastest=flow.fastest, intervals=intervals)
        fit = fit_streams(equations, start)
        if not fit.amplitude[main] > 0:
            return np.nan, np.nan
        errors = fit_errors(planes, diagram, equations, fit, region=region)
        speed = abs(fit.mean[main]) * flow.beam, errors.mean[main] * flow.beam
        # What has no error, or goes to the limit of the search, is not known.
        inside = abs(fit.mean[main]) < 0.99 * equations.speed[-1]
        return speed if np.isfinite(speed[1]) and inside else (np.nan, np.nan)

    speed, error = search.fit.mean[main], search.errors.mean[main]
    whole = abs(speed) * flow.beam, error * flow.beam
    rows = [_row("as measured", whole)]
    for pair in zip(parts[::2], parts[1::2], strict=True):
        own = []
        for name, how in pair:
            part = dict(how)
            intervals = part.pop("intervals", search.intervals)
            try:
                found = speed_of(flow.part(**part), intervals)
            except (np.linalg.LinAlgError, ValueError):
                found = np.nan, np.nan
            own.append(_row(name, found, whole))
        # Both parts may differ from the whole, if they have other features.
        sigma = largest_difference([*own, rows[0]])
        for row in own:
            p = 2 * ndtr(-sigma) if np.isfinite(row["pm"]) else np.nan
            row |= {"change_sigma": sigma, "p_value": p}
            row["significant"] = bool(sigma > DIFFERENT)
        rows += own
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
