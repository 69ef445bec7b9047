# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""
Measure the level of the test on series of images in which nothing moves.

    python benchmarks/level.py [--kinds flux ripple] [--seeds 300] [--epochs 15]
                               [--jobs 2] [--write]

Counts the series whose smallest ``p_global`` is at most 0.05 and 0.01, and the rows
that move.  Without ``--write`` the table is only printed.  Jets that move are those of
``calibration/run.py``.
"""

import argparse
import os
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import print_table, write_table
from resolved import layers_of

from astro_scc import measure_velocities
from astro_scc.simulation import (
    simulate_jet,
    simulate_resolved_jet,
    simulate_unrelated,
)

sys.path.insert(0, str(Path(__file__).parent / "calibration"))
from run import static

#: Fewest and most features of a static jet.
FEATURES = (2, 8)
#: What differs among the epochs of static jets, as `simulate_jet` names it.
JETS = {
    "flux": {"memory": 0.0, "flux_variation": 0.4},
    "red": {"memory": 5.0, "flux_variation": 0.8},
    "align": {"alignment_error": 0.1},
    "misaligned": {"alignment_error": 0.3},
    "ripple": {"ripple": 0.004, "bowl": 0.01},
}
#: Kinds of `resolved.layers_of`: clumps that stay, and clumps that live and fade.
RESOLVED = {"m87": "static", "m87-lives": "static-lives"}
LEVELS = (0.05, 0.01)
HEADER = ["kind", "series", *(f"p <= {level:g}" for level in LEVELS),
          "with rows that move", "rows that move"]  # fmt: skip


@dataclass(frozen=True)
class Flares:
    """
    Standing features that flare, as a stream of a `JetSimulation`.

    Times are in intervals.  Flares rise like a Gaussian of standard deviation ``rise``.
    Each feature has one that decays like it, or, with a time ``decay``, some that decay
    exponentially: as many as Poisson's distribution of mean one draws.
    """

    name: str
    rise: float
    decay: float = 0.0
    n_features: int = 12
    flux: float = 0.2
    base: float = 0.1

    def features(self, jet, rng):
        """Draw places and flares."""
        n, times, length = self.n_features, jet.times, np.ptp(jet.extent)
        number = rng.poisson(1, n) if self.decay else np.ones(n, dtype=int)
        flux = np.full((n, times.size), self.base)
        for i, own in enumerate(number):
            # Flares of before the first epoch still decay.
            since = times - rng.uniform(-3 * self.decay, times[-1], (own, 1))
            up = np.exp(-0.5 * (since / self.rise) ** 2)
            down = np.exp(-since / self.decay) if self.decay else up
            shape = np.where(since < 0, up, down)
            flux[i] += np.sum(rng.lognormal(0, 0.5, (own, 1)) * shape, axis=0)
        s = rng.uniform(jet.beam_length, length, (n, 1)) + 0 * times
        y = jet.axis + 0.5 * jet.beam_length * rng.standard_normal((n, 1)) + 0 * times
        fwhm = np.full(s.shape, 0.5 * jet.beam_length)
        group = np.full(n, self.name)
        columns = {"x": jet.extent[0] + s, "y": y, "flux": self.flux * flux}
        return columns | {"fwhm": fwhm, "group": group}


FLARES = {
    # One smooth flare of each feature, over a part of the series.
    "flares": Flares("flares", rise=2.0),
    # A fast rise and a slow decay, seldom.
    "rare-flares": Flares("rare flares", rise=0.3, decay=4.0),
}
KINDS = (*JETS, "unrelated", *RESOLVED, *FLARES)


def static_cube(kind, rng, n_epochs=15):
    """
    Return images in which nothing moves.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    rng : int or `~numpy.random.Generator`
    n_epochs : int, optional
    """
    rng = np.random.default_rng(rng)
    dates = {"n_epochs": n_epochs}
    if kind in JETS:
        standing = int(rng.integers(*FEATURES, endpoint=True))
        return static(standing=standing, **JETS[kind], **dates)(rng).cube
    if kind == "unrelated":
        return simulate_unrelated(rng=rng, **dates).cube
    if kind in RESOLVED:
        layers = layers_of(RESOLVED[kind])
        return simulate_resolved_jet(layers=layers, rng=rng, **dates).cube
    flares = {"streams": [FLARES[kind]], "flux_variation": 0.0}
    return simulate_jet(**flares, **dates, rng=rng).cube


def measure(task, n_epochs):
    """Return the smallest p-value of a series, and the number of rows that move."""
    kind, seed = task
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rows = measure_velocities(static_cube(kind, seed, n_epochs), rng=seed)
    p = np.asarray(rows["p_global"], dtype=float)
    return min(p[np.isfinite(p)], default=1.0), np.sum(rows["kind"] == "moving")


def main():
    """Measure series of all kinds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--seeds", type=int, default=300, help="series of a kind")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--epochs", type=int, default=15)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--write", action="store_true", help="also to results/")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    table, task = [], partial(measure, n_epochs=args.epochs)
    with ProcessPoolExecutor(args.jobs) as pool:
        for kind in args.kinds:
            p, moving = np.transpose([*pool.map(task, product([kind], seeds))])
            counts = [int(np.sum(p <= level)) for level in LEVELS]
            total = int(moving.sum())
            table.append([kind, len(p), *counts, np.count_nonzero(moving), total])
            print(*table[-1], flush=True)
    print()
    show = partial(write_table, "level") if args.write else print_table
    show(HEADER, table)


if __name__ == "__main__":
    main()
