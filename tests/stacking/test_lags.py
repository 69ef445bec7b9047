# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The steps of the test of lags against plain versions."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import t

from astro_scc.stacking import Sightings, lag_test
from astro_scc.stacking.lags import BEAM, FEWEST, NEAR, _displacement, _line


def sample(rng, n=60, rest=0.0, sigma=0.2):
    """Sightings that agree on a place beside what is expected."""
    s = sigma * rng.uniform(0.8, 1.2, n)
    expected = rng.uniform(1, 3, n)
    along = expected + rest + rng.normal(0, s)
    return along, rng.normal(0, s), expected, s, rng.uniform(0.5, 1, n)


@pytest.mark.parametrize("rest", [-0.7, 0.0, 1.1])
def test_a_displacement_is_the_maximum_of_the_sightings(rest):
    along, across, expected, s, w = sample(np.random.default_rng(1), rest=rest)
    w2 = w * np.exp(-0.5 * (across / s) ** 2)
    off = along - expected

    def density(x, power=0):
        return -np.sum(w2 * s**power * np.exp(-0.5 * ((x - off) / s) ** 2))

    # A mean that weighs by the Gaussians alone is the maximum of s^2 times them.
    top = minimize_scalar(density, bounds=(rest - 0.1, rest + 0.1), args=(2,)).x
    found, total, count = _displacement(along, across, expected, s, w)
    assert found == pytest.approx(top, abs=1e-3)
    own = w2 * np.exp(-0.5 * ((off - top) / s) ** 2)
    assert total == pytest.approx(own.sum(), rel=1e-3)
    kept = w2 > 1e-3
    assert abs(count - (own > 0.1 * w2)[kept].sum()) <= 1


def test_what_is_far_along_or_across_does_not_count():
    rng = np.random.default_rng(2)
    near = sample(rng)
    alone = _displacement(*near)
    limit = NEAR * BEAM * 0.16
    for along, across in ((limit * 1.8, 0.0), (-limit * 1.8, 0.0), (0.5, 2.5)):
        far = sample(rng, n=400, rest=along)
        far = far[0], far[1] + across, *far[2:]
        both = [np.concatenate(pair) for pair in zip(near, far, strict=True)]
        found = _displacement(*both)
        assert found[0] == pytest.approx(alone[0], abs=1e-9)
        assert found[1] == pytest.approx(alone[1], rel=1e-9)


def test_a_higher_maximum_further_away_is_another():
    rng = np.random.default_rng(3)
    near, far = sample(rng, n=40), sample(rng, n=120, rest=1.8)
    both = [np.concatenate(pair) for pair in zip(near, far, strict=True)]
    assert _displacement(*both)[0] == pytest.approx(_displacement(*near)[0], abs=1e-3)


@pytest.mark.parametrize("n", [0, FEWEST - 1])
def test_too_few_sightings_agree_on_nothing(n):
    found = _displacement(*sample(np.random.default_rng(4), n=n))
    assert np.isnan(found[0])
    assert found[1:] == (0.0, n)
    assert np.isfinite(_displacement(*sample(np.random.default_rng(4), n=FEWEST))[0])


def jackknife(values):
    n = len(values)
    return np.sqrt((n - 1) * np.var(values, axis=0))


@pytest.mark.parametrize("n_blocks", [4, 9])
def test_the_line_is_that_of_least_squares(n_blocks):
    rng = np.random.default_rng(n_blocks)
    lag = np.array([0.5, 1.0, 1.7, 2.2])
    d = 0.3 + 1.5 * lag + rng.normal(0, 0.1, 4)
    others = d + rng.normal(0, [0.01, 0.03, 0.02, 0.05], (n_blocks, 4))
    found = _line(lag, d, others)
    error = jackknife(others)
    np.testing.assert_allclose(found["error"], error)
    speed, offset = np.polyfit(lag, d, 1, w=1 / error)
    assert found["speed"] == pytest.approx(speed)
    assert found["offset"] == pytest.approx(offset)
    lines = [np.polyfit(lag, other, 1, w=1 / error) for other in others]
    speed_err, offset_err = jackknife(lines)
    assert found["speed_err"] == pytest.approx(speed_err)
    assert found["offset_err"] == pytest.approx(offset_err)
    p = 2 * t.sf(abs(offset) / offset_err, n_blocks - 2)
    assert found["p_offset"] == pytest.approx(p)


def test_lines_through_few_groups():
    rng = np.random.default_rng(1)
    lag, d = np.array([0.5, 1.0, 2.0]), np.array([1.0, 2.0, 4.5])
    others = d + rng.normal(0, 0.1, (6, 3))
    few = _line(lag, d, others[:3])
    assert np.isnan([few["speed"], few["offset"], few["p_offset"]]).all()
    assert np.isinf([few["speed_err"], few["offset_err"], *few["error"]]).all()
    # Two groups have a line, but nothing that it could miss.
    d[1] = np.nan
    others[:, 1] = np.nan
    two = _line(lag, d, others)
    assert two["speed"] == pytest.approx(3.5 / 1.5)
    assert two["offset"] == pytest.approx(1 - 0.5 * 3.5 / 1.5)
    assert np.isfinite([two["speed_err"], two["offset_err"]]).all()
    assert np.isnan(two["p_offset"])
    d[2] = np.nan
    assert np.isnan(_line(lag, d, others)["speed"])


def test_a_group_of_one_block_keeps_its_displacement():
    lag, d = np.array([0.5, 1.0, 2.0]), np.array([1.0, 2.0, 4.5])
    others = d + np.random.default_rng(1).normal(0, 0.1, (6, 3))
    others[2, 1] = np.nan
    filled = others.copy()
    filled[2, 1] = d[1]
    one, other = _line(lag, d, others), _line(lag, d, filled)
    np.testing.assert_equal(one, other)


def test_lags_along_any_direction():
    rng = np.random.default_rng(8)
    n = 500
    lag, when, x = rng.uniform(0.5, 2, n), rng.uniform(0, 20, n), rng.uniform(0, 9, n)
    one, zero = np.ones(n), np.zeros((n, 2))
    v = np.array([1.2, -0.9])
    # A third goes as fast, but across.
    way = np.where(rng.random(n)[:, None] < 0.67, v, v[::-1] * [-1, 1])
    d = way * lag[:, None] + rng.normal(0, 0.05, (n, 2))
    seen = Sightings(
        v1=d[:, 0] / lag, v2=d[:, 1] / lag, s1=0.1 / lag, s2=0.1 / lag, weight=one,
        time=when, interval=lag, middle=zero, velocity=zero, sigma=0.1 * one,
        first=one, ssp=np.arange(n), match=np.arange(n),
    )  # fmt: skip
    found = lag_test(seen, *v, distance=x, n_groups=4)
    np.testing.assert_allclose(found.displacement, 1.5 * found.lag, atol=0.03)
    assert found.speed == pytest.approx(1.5, abs=0.05)
    along = (way == v).all(axis=1)
    edges = np.quantile(lag, np.linspace(0, 1, 5))
    for k in range(4):
        group = (lag >= edges[k]) & (lag <= edges[k + 1])
        assert found.lag[k] == pytest.approx(lag[group].mean(), rel=0.01)
        assert found.n_sightings[k] == pytest.approx((group & along).sum(), rel=0.15)
        assert found.coefficient[k] == pytest.approx(along[group].mean(), rel=0.35)
