# Licensed under a 3-clause BSD style license - see LICENSE.rst
import numpy as np
import pytest

from astro_scc.streams.spread import mean_speed, separation


def test_a_single_feature_scatters_by_three_tenths():
    found = mean_speed([2.0], [0.1], [7])
    assert found.mean == 2.0
    assert found.error == pytest.approx(np.hypot(0.1, 0.6))
    assert np.isnan(found.dispersion)


def test_many_features_show_their_own_scatter():
    rng = np.random.default_rng(1)
    speed = rng.normal(1.0, 0.1, 400)
    found = mean_speed(speed, np.full(400, 0.02), np.ones(400))
    assert found.mean == pytest.approx(1.0, abs=0.02)
    assert found.error == pytest.approx(0.1 / 20, rel=0.15)
    assert found.dispersion == pytest.approx(0.1, rel=0.15)


def test_long_features_weigh_more():
    assert mean_speed([1.0, 2.0], [0.1, 0.1], [3, 1]).mean == pytest.approx(1.25)


def test_separation_of_known_distributions():
    rng = np.random.default_rng(2)
    assert separation(np.exp(rng.normal(size=4000))) == pytest.approx(
        2 / np.pi, abs=0.03
    )
    assert separation(np.exp(rng.uniform(size=4000))) == pytest.approx(0.75, abs=0.03)
    assert separation([1.0, 1.01, 3.0, 3.02]) > 0.99
    assert separation([1.0, 1.0]) == 0.0
