# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""Functions that the benchmarks share: MOJAVE jets, tables of text, time and memory."""

import csv
import os
import resource
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

# Use one core per process; libraries read this when they are loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import astropy.units as u
import numpy as np
from astropy.table import Table

from astro_scc.epochs import read_components, restore

#: Where tables are written, for a test elsewhere.
RESULTS = Path(os.environ.get("ASTRO_SCC_RESULTS") or Path(__file__).parent / "results")
PM_UNIT = u.mas / u.yr


def mojave_images(folder, table, beam, *, before=None, seed=1):
    """Restore epochs from the features of MOJAVE, with pixels of 0.1 mas."""
    components = read_components(folder / f"{table}.ecsv")
    if before is not None:
        components = components.select(before=before)
    noise = 0.3 * u.mJy / u.beam
    return restore(
        components, beam=beam, pixel_scale=0.1 * u.mas, noise=noise, rng=seed
    )


def feature_motions(folder, source, pa, *, before="9999", epochs=3):
    """
    Return the proper motions fitted to features, along a position angle.

    Parameters
    ----------
    folder : `~pathlib.Path`
        Folder with ``SOURCE.ecsv``, the features of each epoch, and
        ``SOURCE.linear-fits.csv``, the straight lines fitted to them.
    source : str
    pa : float
        Position angle in degrees.
    before : str, optional
        Use only epochs before this date, and features with at least
        ``epochs`` of them.

    Returns
    -------
    dict of `~numpy.ndarray`
        ``feature``, mean ``distance`` at these epochs, ``speed`` and
        ``error`` in mas/yr, and ``epochs``, an array of distances for
        each feature.
    """
    seen = Table.read(folder / f"{source}.ecsv", format="ascii.ecsv")
    fits = Table.read(folder / f"{source}.linear-fits.csv", format="ascii.csv")
    found = {"feature": [], "distance": [], "speed": [], "error": [], "epochs": []}
    for fit in fits:
        own = (seen["feature"] == fit["feature"]) & (
            np.asarray(seen["epoch"], dtype=str) < before
        )
        r = np.asarray(seen["separation"][own], dtype=float)
        if len(r) < epochs:
            continue
        turn = np.cos(np.radians(fit["pa_motion_deg"] - pa))
        found["feature"].append(int(fit["feature"]))
        found["distance"].append(r.mean())
        found["speed"].append(fit["mu_mas_yr"] * turn)
        found["error"].append(fit["mu_err"])
        found["epochs"].append(r)
    return {
        k: v if k == "epochs" else np.array(v, dtype=float) for k, v in found.items()
    }


def plain(value, unit=None):
    """Return a number from a table, Quantity or not, as a float."""
    return float(u.Quantity(value).to_value(unit)) if unit is not None else float(value)


def measured(value, error, digits=2):
    """Return a value with its error as text."""
    if not np.isfinite(error):
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def p_text(p):
    """Return a p-value as text."""
    return "" if not np.isfinite(p) else f"{p:.3f}" if p >= 0.001 else f"{p:.1g}"


def write_table(name, header, rows):
    """Print a table and write it to ``results``, for the documentation."""
    RESULTS.mkdir(exist_ok=True)
    with open(RESULTS / f"{name}.csv", "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])
    print_table(header, rows)


def print_table(header, rows):
    """Print a table."""
    rows = [[str(item) for item in row] for row in rows]
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
        """End a stage, and return its processor time and wall clock in seconds."""
        now = self._now()
        spent = tuple(b - a for a, b in zip(self._start, now, strict=True))
        self.stages[name] = spent
        self._start = now
        return spent

    @staticmethod
    def peak_memory():
        """Return the largest resident memory of this process so far, in GB."""
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (1e9 if sys.platform == "darwin" else 1e6)


class Sampler(threading.Thread):
    """Call a function several times a second while a block of code runs."""

    def __init__(self, function, interval=0.1):
        super().__init__(daemon=True)
        self.function, self.interval = function, interval
        self.values, self.done = [], threading.Event()

    def run(self):
        """Collect values until the block ends."""
        while not self.done.wait(self.interval):
            self.values.append(self.function())

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *args):
        self.done.set()
        self.join()


def memory_of(pid, kind="Pss"):
    """
    Return the memory in GB of a process and of all processes that it started.

    ``kind`` is ``"Rss"``, with all shared pages, or ``"Pss"``, with a share of them.
    """
    folder = Path(f"/proc/{pid}")
    try:
        text = (folder / "smaps_rollup").read_text(encoding="ascii")
        own = int(text.partition(f"{kind}:")[2].split()[0])
        below = [
            int(child)
            for path in (folder / "task").glob("*/children")
            for child in path.read_text(encoding="ascii").split()
        ]
    except (OSError, IndexError):
        return 0.0
    return own / 1e6 + sum(memory_of(child, kind) for child in below)


def watch(words, kind="Rss"):
    """Return the peak memory of a command in GB, see `memory_of`, and its seconds."""
    start = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "astro_scc", *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    with Sampler(partial(memory_of, process.pid, kind), 0.02) as memory:
        said, _ = process.communicate()
    if process.returncode:
        raise RuntimeError(f"{words[0]} ended with {process.returncode}: {said}")
    return max(memory.values), time.monotonic() - start
