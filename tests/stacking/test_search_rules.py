# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The rules of the search, one by one, on findings that are made up."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from astro_scc.stacking import baseline_pairs, consecutive_pairs, find_velocities
from astro_scc.stacking.contrast import FILTER_REACH
from astro_scc.stacking.significance import (
    FEW_FEATURES,
    FEWEST_FEATURES,
    _judged,
    _rejected,
    _widened,
    _without_rest,
)

search = sys.modules[find_velocities.__module__]


def finding(kind="moving", n_features=9, p_global=0.01, scramble=None):
    tests = {} if scramble is None else {"scramble": SimpleNamespace(p_global=scramble)}
    return SimpleNamespace(
        kind=kind, n_features=n_features, p_global=p_global, tests=tests
    )


@pytest.mark.parametrize(
    ("kinds", "n"),
    [("", 0), ("u", 1), ("uu", 1), ("m", 1), ("mu", 2), ("muu", 2), ("umu", 3),
     ("uuus", 4), ("msuuu", 3)],
)  # fmt: skip
def test_findings_end_with_the_first_that_is_none(kinds, n):
    names = {"u": "uncertain", "m": "moving", "s": "stationary"}
    findings = [finding(names[kind]) for kind in kinds]
    assert _without_rest(findings) == findings[:n]


@pytest.mark.parametrize(
    ("what", "ends"),
    [
        ({"p_global": 0.01}, False),
        ({"p_global": 0.05}, False),
        ({"p_global": 0.06}, True),
        # The scramble is asked first, if there is one.
        ({"p_global": 0.06, "scramble": 0.01}, False),
        ({"p_global": 0.01, "scramble": 0.06}, True),
        ({"p_global": 0.9, "n_features": FEW_FEATURES - 1}, False),
        ({"p_global": 0.9, "n_features": FEW_FEATURES}, True),
    ],
)
def test_when_the_search_ends(what, ends):
    assert _rejected(finding(**what), 0.05) is ends


def test_sightings_beyond_the_limits_are_out_of_reach(random_displacements):
    d = random_displacements(np.random.default_rng(1), s1=(0.1, 0.5), s2=(0.2, 0.9))
    pairs = baseline_pairs([0.0, 0.4, 1.0, 1.1], 0.0, 2.0)
    limits = _widened(d, (4.0, 3.0), pairs)
    # That of the least precise one, at the shortest interval.
    widest = max(d.s1) / 0.1, max(d.s2) / 0.1
    for limit, v, s in zip(limits, (4.0, 3.0), widest, strict=True):
        assert v + FILTER_REACH * s <= limit < v + 2 * FILTER_REACH * s
    none = d.select(np.zeros(len(d), bool))
    assert _widened(none, (4.0, 3.0), pairs) == (4.0, 3.0)
    assert _widened(d, (4.0, 3.0), consecutive_pairs([0.0])) == (4.0, 3.0)


class Says:
    """A null hypothesis with its mind made up."""

    def __init__(self, name, p_local, p_global, error=0.01):
        self.name = name
        self.result = SimpleNamespace(p_local=p_local, p_global=p_global, error=error)

    def test(self, scene, n_trials, rng):
        return self.result


def judge(monkeypatch, v, nulls, n_features=9, level=0.05):
    monkeypatch.setattr(search, "count_features", lambda *args: n_features)
    one = np.ones(4)
    witnesses = SimpleNamespace(
        v1=np.array([0.0, 1.0, 1.1, 3.0]), v2=0 * one, s1=0.2 * one, s2=0.2 * one,
        group=None,
    )  # fmt: skip
    scene = SimpleNamespace(velocity=v, witnesses=witnesses)
    seen = SimpleNamespace(near=lambda *args: None)
    rng = np.random.default_rng(1)
    return _judged(scene, seen, nulls, 9, level, rng)


def test_the_worst_of_the_nulls_is_told(monkeypatch):
    nulls = Says("scramble", 0.02, 0.01, 0.1), Says("shuffle", 0.01, 0.04, 0.2)
    found = judge(monkeypatch, (1.0, 0.0), nulls)
    assert found["kind"] == "moving"
    numbers = found["p_local"], found["p_global"], found["p_error"]
    assert numbers == (0.02, 0.04, 0.2)
    assert found["n_witnesses"] == 2
    assert set(found["tests"]) == {"scramble", "shuffle"}
    assert judge(monkeypatch, (1.0, 0.0), nulls, level=0.04)["kind"] == "moving"
    assert judge(monkeypatch, (1.0, 0.0), nulls, level=0.03)["kind"] == "uncertain"


def test_what_stands_needs_no_order(monkeypatch):
    nulls = Says("scramble", 0.01, 0.02), Says("shuffle", 0.5, 0.8)
    # Within 0.75 standard errors of no motion.
    for v, kind in (((0.1, 0.1), "stationary"), ((0.1, 0.12), "uncertain")):
        found = judge(monkeypatch, v, nulls)
        assert found["kind"] == kind
        assert found["p_global"] == (0.02 if kind == "stationary" else 0.8)
    # Only the scramble can tell.
    assert judge(monkeypatch, (0.0, 0.0), nulls[1:])["kind"] == "uncertain"
    late = Says("scramble", 0.01, 0.06), nulls[1]
    assert judge(monkeypatch, (0.0, 0.0), late)["kind"] == "uncertain"


def test_few_features_have_no_common_velocity(monkeypatch):
    nulls = (Says("scramble", 0.01, 0.02),)
    found = judge(monkeypatch, (1.0, 0.0), nulls, n_features=FEWEST_FEATURES - 1)
    assert found["kind"] == "uncertain"
    assert (found["p_local"], found["p_global"], found["p_error"]) == (1.0, 1.0, 0.0)
    enough = judge(monkeypatch, (1.0, 0.0), nulls, n_features=FEWEST_FEATURES)
    assert enough["kind"] == "moving"
