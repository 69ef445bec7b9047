# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Whether probabilities hold: few jets of matches always, many when asked for.

``benchmarks/calibration`` does the same on images.
"""

import numpy as np
import pytest
from scipy.stats import binom

from astro_scc.stacking import consecutive_pairs, find_velocities

from .test_significance import V_MAX, YEARS, S, matches, streams  # noqa: TID252

LEVEL = 0.05


def moving(displacements, years, seed, n_trials=99):
    found = find_velocities(
        displacements, consecutive_pairs(years), years, V_MAX, n_trials=n_trials,
        level=LEVEL, rng=np.random.default_rng(seed),
    )  # fmt: skip
    return [f for f in found if f.kind == "moving"]


def ballistic(rng, years):
    """Each feature has a velocity of its own."""
    own = np.stack([rng.uniform(0, 4, 15), rng.uniform(-0.5, 0.5, 15)], axis=1)
    return matches(rng, own, years=years)


def unrelated(rng, years):
    """Chance matches only."""
    d = matches(rng, rng.uniform(-3, 3, (25, 2)), years=years, chance=2.0)
    lucky = rng.permutation(len(d))[: len(d) // 2]
    motion = rng.uniform(-5, 5, (len(lucky), 2))
    d = d.select(lucky)
    d.motion[:], d.d1[:], d.d2[:] = motion, motion[:, 0], motion[:, 1]
    return d


def standing(rng, years):
    """Nothing moves."""
    return matches(rng, np.zeros((15, 2)), years=years)


KINDS = {"ballistic": ballistic, "unrelated": unrelated, "standing": standing}
UNEVEN = np.array([0, 0.4, 1.9, 2.3, 3.9, 4.6, 6.0, 7.0])


def false_alarms(kind, years, n_jets):
    return sum(
        bool(moving(KINDS[kind](np.random.default_rng(seed), years), years, seed))
        for seed in range(n_jets)
    )


def assert_holds(alarms, n_jets):
    """No more than chance gives of a level of 0.07, once in a thousand runs."""
    assert alarms <= binom.ppf(0.999, n_jets, 0.07)


@pytest.mark.parametrize("kind", KINDS)
def test_few_jets_without_a_common_velocity(kind):
    assert_holds(false_alarms(kind, YEARS, 12), 12)


@pytest.mark.slow
@pytest.mark.parametrize("years", [YEARS, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("kind", KINDS)
def test_many_jets_without_a_common_velocity(kind, years):
    assert_holds(false_alarms(kind, years, 150), 150)


def streams_found(n_jets, years):
    both = 0
    for seed in range(n_jets):
        rng = np.random.default_rng(seed)
        own = rng.uniform(-3, 3, (8, 2))
        jet = [*streams((12, 0.8, 0.0), (10, 3.0, -0.5)), *own]
        found = moving(matches(rng, jet, years=years), years, seed)
        both += all(
            any(np.hypot(f.v1 - v1, f.v2 - v2) < 2 * S for f in found)
            for v1, v2 in ((0.8, 0.0), (3.0, -0.5))
        )
    return both


def test_both_streams_of_few_jets():
    assert streams_found(5, YEARS) >= 4


@pytest.mark.slow
@pytest.mark.parametrize("years", [YEARS, UNEVEN], ids=["even", "uneven"])
def test_both_streams_of_many_jets(years):
    assert streams_found(60, years) >= 54
