# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the benchmarks share: parts of a jet, the features in it, tables of text."""

import csv
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import Table

from astro_scc.epochs.positions import ssp_offsets

RESULTS = Path(__file__).parent / "results"
PM_UNIT = u.mas / u.yr


def part(matched, *, r_min=0.0, r_max=np.inf, scales=None):
    """
    The matches of the SSPs in a ring about the core and on some scales.

    Nothing is correlated again: what is chosen is whose matches are stacked.
    """
    ssps = matched.ssps
    distance = np.hypot(*ssp_offsets(ssps, matched.cube, centroid=True))
    select = matched.select & (distance >= r_min) & (distance < r_max)
    if scales is not None:
        select &= np.isin(ssps.scale, scales)
    return replace(matched, select=select)


def feature_motions(folder, source, pa, *, before="9999", sightings=3):
    """
    Proper motions that were fitted to features, along a position angle.

    Parameters
    ----------
    folder : `~pathlib.Path`
        With ``SOURCE.ecsv``, the features of each epoch, and
        ``SOURCE.linear-fits.csv``, the straight lines fitted to them.
    source : str
    pa : float
        In degrees.
    before : str, optional
        Only sightings before this date, of features with so many
        ``sightings`` at least.

    Returns
    -------
    dict of `~numpy.ndarray`
        ``feature``, ``distance`` (mean, of these sightings), ``speed`` and
        ``error`` in mas/yr, and ``sightings``, an array of distances for
        each feature.
    """
    seen = Table.read(folder / f"{source}.ecsv", format="ascii.ecsv")
    fits = Table.read(folder / f"{source}.linear-fits.csv", format="ascii.csv")
    found = {"feature": [], "distance": [], "speed": [], "error": [], "sightings": []}
    for fit in fits:
        own = (seen["feature"] == fit["feature"]) & (
            np.asarray(seen["epoch"], dtype=str) < before
        )
        r = np.asarray(seen["separation"][own], dtype=float)
        if len(r) < sightings:
            continue
        turn = np.cos(np.radians(fit["pa_motion_deg"] - pa))
        found["feature"].append(int(fit["feature"]))
        found["distance"].append(r.mean())
        found["speed"].append(fit["mu_mas_yr"] * turn)
        found["error"].append(fit["mu_err"])
        found["sightings"].append(r)
    return {
        k: v if k == "sightings" else np.array(v, dtype=float) for k, v in found.items()
    }


def feature_quartiles(motions, r_min, r_max):
    """Quartiles of the speeds of the features sighted in a ring, or None."""
    times = np.array(
        [np.sum((r >= r_min) & (r < r_max)) for r in motions["sightings"]], dtype=int
    )
    speeds = np.repeat(motions["speed"], times)
    if len(speeds) < 3:
        return None
    return np.percentile(speeds, [25, 50, 75])


def plain(value, unit=None):
    """A number out of a table, Quantity or not."""
    return float(u.Quantity(value).to_value(unit)) if unit is not None else float(value)


def measured(value, error, digits=2):
    """A value with its error as text."""
    if not np.isfinite(error):
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def p_text(p):
    """A p-value as text."""
    return "" if not np.isfinite(p) else f"{p:.3f}" if p >= 0.001 else f"{p:.1g}"


def write_table(name, header, rows):
    """Print a table and write it to ``results``, for the documentation."""
    RESULTS.mkdir(exist_ok=True)
    rows = [[str(item) for item in row] for row in rows]
    with open(RESULTS / f"{name}.csv", "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    for row in (header, ["-" * w for w in widths], *rows):
        line = "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True))
        print(line.rstrip())
    print(flush=True)


class Stopwatch:
    """Processor time of stages, and the memory at their end."""

    def __init__(self):
        self.stages = {}
        self._start = self._now()

    @staticmethod
    def _now():
        return time.process_time(), time.perf_counter()

    def lap(self, name):
        """End a stage: its seconds of processor and of wall clock."""
        now = self._now()
        spent = tuple(b - a for a, b in zip(self._start, now, strict=True))
        self.stages[name] = spent
        self._start = now
        return spent

    @staticmethod
    def peak_memory():
        """Largest resident memory of this process so far, in GB."""
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (1e9 if sys.platform == "darwin" else 1e6)
