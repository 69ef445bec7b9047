# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Maxima of surfaces, their fits, and errors from shifted positions."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.paper import Displacements, consecutive_pairs, stack
from astro_scc.paper.stack import match_velocities, velocity_axes

AXES = velocity_axes((10.0, 8.0), (0.5, 0.4))
BOX = (6.0, 6.0)


def gaussian(axes, x, y, sx, sy, angle=0.0, height=1.0):
    u, v = axes[0] - x, axes[1][:, None] - y
    c, s = np.cos(angle), np.sin(angle)
    p, q = c * u + s * v, -s * u + c * v
    return height * np.exp(-0.5 * ((p / sx) ** 2 + (q / sy) ** 2))


near, width = st.floats(-0.5, 0.5), st.floats(0.8, 2.0)


@given(near, near, width, width, st.floats(0, np.pi), st.floats(1e-6, 1e6))
def test_fit_of_a_gaussian_is_exact(x, y, sx, sy, angle, height):
    axes = velocity_axes(2.0, 0.25)
    surface = gaussian(axes, x, y, sx, sy, angle, height)
    found = stack.fit_gaussian(surface, *axes)
    np.testing.assert_allclose(found[:2], (x, y), atol=1e-6)


@pytest.mark.parametrize(
    "surface",
    [
        np.zeros((5, 5)),
        np.ones((5, 5)),
        np.add.outer(np.arange(5.0), np.arange(5.0)),  # a slope
        np.exp(0.1 * np.multiply.outer(np.arange(-2, 3.0), np.arange(-2, 3))),  # saddle
        np.eye(5),  # too few values
        np.exp(-0.1 * np.arange(-2, 3) ** 2) * (np.arange(5) == 2)[:, None],  # a line
    ],
)
def test_no_maximum_no_fit(surface):
    axis = np.arange(-2.0, 3)
    assert stack.fit_gaussian(surface, axis, axis) is None


@pytest.mark.parametrize("box", [(4.0, 4.0), (10.0, 10.0)])
@pytest.mark.parametrize(("separation", "second"), [(5.0, 0.6), (8.0, 1.0)])
def test_overlapping_gaussians_are_kept_apart(separation, second, box):
    """Four widths and more apart; the box holds the neighbour too."""
    scc = gaussian(AXES, -0.4, 0.3, 1.2, 1.0)
    scc += gaussian(AXES, separation - 0.4, -0.2, 1.2, 1.0, height=second)
    found = sorted(stack.find_velocity_peaks(scc, AXES, box)[0].tolist())
    true = [(-0.4, 0.3), (separation - 0.4, -0.2)]
    np.testing.assert_allclose(found, true, atol=0.05)


@pytest.mark.parametrize("place", [(10.0, 0.0), (0.0, -8.0), (10.0, 8.0), (11.0, 0.0)])
def test_a_maximum_on_the_border_is_none(place):
    found = stack.find_velocity_peaks(gaussian(AXES, *place, 1.0, 1.0), AXES, BOX)
    assert [len(part) for part in found] == [0, 0]


PAIRS = consecutive_pairs([0.0, 0.5])
HALF_YEAR = 0.5


def clump(n, *, velocity=(1.0, -0.5), s=(0.2, 0.2)):
    """Matches of two epochs with one displacement, each of an SSP of its own."""
    columns = np.outer([*np.multiply(velocity, HALF_YEAR), *s, 1.0], np.ones(n))
    return Displacements(
        *columns, reference=np.zeros(n, dtype=int), target=np.ones(n, dtype=int),
        ssp=np.arange(n), target_ssp=np.full(n, -1), n_ssps=np.array([n, n]),
    )  # fmt: skip


def jitter(d, n_trials=1000, *, pairs=PAIRS, at=(1.0, -0.5), box=(3.0, 3.0), seed=0):
    rng, (ends, _, columns) = np.random.default_rng(seed), match_velocities(d, pairs)
    return stack.jitter_positions(ends, columns, at, box, n_trials, rng)


def expected_error(s, n):
    """Error of the maximum, -f'/f'', of n Gaussians of width s at random places."""
    return 4 / 3 * s / np.sqrt(n)


@pytest.mark.parametrize("n", [60, 240])
def test_independent_ssps(n):
    """The fitted maximum is surer than the maximum itself, less sure than the mean."""
    found = jitter(clump(n))
    largest = expected_error(0.2 / HALF_YEAR, n)
    share = np.std(found, axis=0) / largest
    assert np.all((share < 1) & (share > 0.75))
    assert abs(np.corrcoef(found.T)[0, 1]) < 0.15
    assert np.abs(found.mean(axis=0)).max() < 0.15 * largest
    assert stack.normal_probability(found) > 0.01


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
    assert np.std(apart, axis=0)[0] == pytest.approx(expected_error(0.4, 160), rel=0.12)
    assert np.std(chained, axis=0)[0] < 0.75 * np.std(apart, axis=0)[0]


def test_a_maximum_farther_than_half_a_box_is_not_the_same_one():
    """A box of half-width s holds the maximum of one match of width s to 68%."""
    found = jitter(clump(1, s=(0.2, 0.02)), box=(0.8, 3.0))
    assert len(found) == pytest.approx(683, abs=60)
    # The standard deviation of a normal distribution that is cut off there.
    assert np.std(found, axis=0)[0] == pytest.approx(0.208, rel=0.1)
    assert len(jitter(clump(10), 10, at=(9.0, 9.0))) == 0
    assert jitter(clump(0), 10).shape == (0, 2)


def test_the_nearest_of_two_maxima_is_found_again():
    """Not the higher one, which is in the box, too."""
    both = clump(120)
    both.d1[40:] = 3.2 * HALF_YEAR
    found = jitter(both, 200, box=(5.0, 3.0))
    assert len(found) == 200
    assert np.abs(found).max() < 0.5


def test_normal_values_look_normal_and_others_do_not():
    rng = np.random.default_rng(3)
    turn = np.array([[2.0, 0.0], [1.5, 0.3]])
    p = [stack.normal_probability(rng.normal(size=(100, 2)) @ turn) for _ in range(400)]
    assert 0.02 < np.mean(np.array(p) < 0.05) < 0.08
    assert stack.normal_probability(rng.exponential(size=(100, 2))) < 1e-3
    assert stack.normal_probability(rng.uniform(size=(1000, 2)) @ turn) < 1e-3
