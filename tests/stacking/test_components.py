# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The maximum near a velocity, and errors from shifted positions."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.stacking.stack import (
    VelocityPeak,
    find_velocity_peaks,
    jitter_positions,
    velocity_peak_near,
)
from astro_scc.stacking.velocities import (
    VelocityGrid,
    VelocitySamples,
    consecutive_pairs,
)

GRID = VelocityGrid.covering((10.0, 8.0), (0.5, 0.4))
BOX = (6.0, 6.0)


def gaussian(grid, x, y, sx, sy, angle=0.0, height=1.0):
    u, v = grid.v1 - x, grid.v2[:, None] - y
    c, s = np.cos(angle), np.sin(angle)
    p, q = c * u + s * v, -s * u + c * v
    return height * np.exp(-0.5 * ((p / sx) ** 2 + (q / sy) ** 2))


TWO = gaussian(GRID, -3.0, 1.0, 0.6, 0.6)
TWO += gaussian(GRID, 2.0, -2.0, 0.6, 0.6, height=0.3)


@given(st.floats(-6, 5), st.floats(-4, 3))
def test_the_maximum_near_a_velocity_or_that_velocity_itself(v1, v2):
    """Distance is in units of the box; beyond half of it there is no maximum."""
    box = (4.0, 2.0)
    peaks = find_velocity_peaks(TWO, GRID, box)
    distance = [np.hypot((c.v1 - v1) / box[0], (c.v2 - v2) / box[1]) for c in peaks]
    c = velocity_peak_near(TWO, GRID, box, v1, v2)
    if min(distance) <= np.clip(np.hypot(v1 / box[0], v2 / box[1]) / 2, 0.1, 0.5):
        assert c == peaks[int(np.argmin(distance))]
        return
    assert (c.v1, c.v2) == (v1, v2)
    # The coefficient of the nearest point of the grid.
    assert abs(GRID.v1[c.column] - v1) <= GRID.step[0] / 2 + 1e-9
    assert abs(GRID.v2[c.row] - v2) <= GRID.step[1] / 2 + 1e-9
    assert c.coefficient == TWO[c.row, c.column]


@pytest.mark.parametrize("height", [0.0, 1.0])
def test_without_a_maximum_the_velocity_stays(height):
    c = velocity_peak_near(np.full(GRID.shape, height), GRID, BOX, 0.6, 0.5)
    assert (c.v1, c.v2, c.row, c.column) == (0.6, 0.5, 21, 21)
    assert c.coefficient == height


# -- errors from shifted positions ------------------------------------------------


PAIRS = consecutive_pairs([0.0, 0.5])
HALF_YEAR = 0.5


def clump(n, *, velocity=(1.0, -0.5), interval=0.5, s=(0.2, 0.2), shared=False):
    """Matches of two epochs with one displacement, each of an SSP of its own."""
    one = np.ones(n)
    return VelocitySamples(
        d1=velocity[0] * interval * one,
        d2=velocity[1] * interval * one,
        s1=s[0] * one,
        s2=s[1] * one,
        weight=one,
        reference=np.zeros(n, dtype=int),
        target=np.ones(n, dtype=int),
        ssp=np.zeros(n, dtype=int) if shared else np.arange(n),
        target_ssp=np.full(n, -1),
        n_ssps=np.array([n, n]),
    )


def errors(found):
    """Standard errors along both axes."""
    return np.sqrt(np.diag(found))


def component(v1=1.0, v2=-0.5):
    return VelocityPeak(v1, v2, 1.0, 0, 0)


def jitter(d, n_trials=1000, *, pairs=PAIRS, at=None, box=(3.0, 3.0), seed=0):
    return jitter_positions(
        d, pairs, at or component(), box, n_trials, rng=np.random.default_rng(seed)
    )


def expected_error(s, n, shared=0.0):
    """
    Standard deviation of the maximum of n Gaussians of width s at random places.

    A share of the variance s^2 of the places is common to all.  The maximum
    of f = sum g(x_i, y_i) lies at -f'/f'' to first order; with the variance q
    of the rest in units of s^2, E[f'^2] = n q / (1 + 2 q)^2 and
    E[f''] = -n / (1 + q)^2.
    """
    q = 1 - shared
    own = q * (1 + q) ** 4 / (1 + 2 * q) ** 2 / n
    return s * np.sqrt(shared + own)


@pytest.mark.parametrize("n", [60, 240])
def test_independent_ssps(n):
    """Four thirds of s / sqrt(n): the maximum is less sure than the mean."""
    found = jitter(clump(n))
    expected = expected_error(0.2 / HALF_YEAR, n)
    assert expected == pytest.approx(4 / 3 * 0.4 / np.sqrt(n))
    np.testing.assert_allclose(errors(found), expected, rtol=0.12)
    assert abs(found[0, 1]) < 0.15 * np.prod(errors(found))


def test_one_ssp_that_all_matches_share():
    """Its shift moves all of them: its half of the variance does not average out."""
    found = jitter(clump(60, shared=True))
    expected = expected_error(0.4, 60, shared=0.5)
    assert expected > 0.4 / np.sqrt(2)
    np.testing.assert_allclose(errors(found), expected, rtol=0.08)


def chains(n, n_epochs):
    """SSPs that are matched from epoch to epoch, all at one velocity."""
    feature, epoch = np.mgrid[:n, : n_epochs - 1].reshape(2, -1)
    return replace(
        clump(feature.size), reference=epoch, target=epoch + 1,
        ssp=epoch * n + feature, target_ssp=(epoch + 1) * n + feature,
        n_ssps=np.full(n_epochs, n),
    )  # fmt: skip


def test_shifts_of_chains_cancel():
    """What an SSP adds to the one displacement it takes from the next."""
    d = chains(20, 9)
    pairs = consecutive_pairs(HALF_YEAR * np.arange(9))
    chained = jitter(d, pairs=pairs)
    apart = jitter(replace(d, target_ssp=np.full(len(d), -1)), pairs=pairs)
    assert errors(apart)[0] == pytest.approx(expected_error(0.4, 160), rel=0.12)
    assert errors(chained)[0] < 0.75 * errors(apart)[0]


def test_too_few_maxima_have_no_error():
    """A box of half-width s holds the maximum of one match of width s to 68%."""
    # The standard deviation of a normal distribution that is cut off there.
    one = errors(jitter(clump(1, s=(0.2, 0.02)), box=(0.8, 3.0)))
    assert one[0] == pytest.approx(0.208, rel=0.1)
    for n_trials in (0, 2):
        assert np.isnan(jitter(clump(10), n_trials)).all()
    assert np.isfinite(jitter(clump(10), 3)).all()
    assert np.isnan(jitter(clump(10), 10, at=component(9.0, 9.0))).all()
    assert np.isnan(jitter(clump(10).select(slice(0, 0)), 10)).all()
