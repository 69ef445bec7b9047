# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""How the shuffle counts trials, with statistics that are given."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from astro_scc.stacking import PairMaps, ShuffleNull, VelocityGrid, consecutive_pairs

nulls = sys.modules[ShuffleNull.__module__]


class Orders:
    """Orders that are given."""

    name = "given"

    def __init__(self, drawn, number):
        self.drawn, self.count = drawn, number

    def draw(self, n_epochs, n_trials, rng):
        return np.tile(np.arange(n_epochs), (self.drawn, 1))

    def number(self, n_epochs):
        return self.count

    def exhausts(self, n_epochs, n_trials):
        return False


def run(monkeypatch, here, largest, number=1000.0, n_matches=5):
    grid = VelocityGrid.covering(2.0, 0.5)
    witnesses = SimpleNamespace(s1=np.ones(3), s2=np.ones(3))
    scene = SimpleNamespace(
        pairs=consecutive_pairs(np.arange(5.0)), grid=grid, witnesses=witnesses,
        displacements=np.zeros(n_matches), free=np.ones(grid.shape, bool),
    )  # fmt: skip
    maps = SimpleNamespace(both_ways=lambda: None)
    monkeypatch.setattr(PairMaps, "of", lambda *args: maps)
    statistics = np.array(here, dtype=float), np.array(largest, dtype=float)
    monkeypatch.setattr(nulls, "_excess", lambda *args: statistics)
    null = ShuffleNull(Orders(len(here) - 1, number))
    return null.test(scene, len(here) - 1, np.random.default_rng(1))


def test_ties_count_and_the_own_order_does(monkeypatch):
    here = [3.0, 3.0, 1.0, 4.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    largest = [3.0, 3.0, 5.0, 4.0, 2.9, 1.0, 3.0 - 1e-9, 1.0, 1.0, 1.0]
    found = run(monkeypatch, here, largest)
    assert found.n_trials == 9
    assert found.p_local == pytest.approx((2 + 1) / 10)
    # As good but for rounding is as good.
    assert found.p_global == pytest.approx((4 + 1) / 10)
    assert found.smallest == pytest.approx(1 / 10)


def test_none_as_good(monkeypatch):
    found = run(monkeypatch, [3.0, *np.zeros(19)], [3.0, *np.ones(19)])
    assert found.p_local == found.p_global == pytest.approx(1 / 20)
    few = run(monkeypatch, [3.0, *np.zeros(19)], [3.0, *np.ones(19)], number=8)
    assert few.p_local == few.p_global == few.smallest == pytest.approx(1 / 8)


def test_nothing_to_shuffle(monkeypatch):
    assert run(monkeypatch, [1.0, 0.0], [1.0, 0.0], n_matches=0).p_global == 1
    alone = run(monkeypatch, [1.0], [1.0], number=1.0)
    assert (alone.p_local, alone.p_global, alone.n_trials) == (1, 1, 0)
