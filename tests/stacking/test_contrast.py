# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Contrast maps against sums of Gaussians written out."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.stacking import Contrast, Witnesses, contrast

ALL = range(4)
S1, S2 = 0.5, 0.3
V_MAX = (6.0, 4.0)


def witnesses(v1, v2, s1=S1, s2=S2, weight=1.0):
    v1, v2, s1, s2, weight = np.broadcast_arrays(v1, v2, s1, s2, weight)
    n = len(v1)
    return Witnesses(
        v1=v1.astype(float),
        v2=v2.astype(float),
        s1=s1.astype(float),
        s2=s2.astype(float),
        weight=weight.astype(float),
        n_dates=np.ones(n, int),
        group=np.arange(n),
    )


def scattered(rng, n, reach=V_MAX, **kwargs):
    return witnesses(
        rng.uniform(-reach[0], reach[0], n),
        rng.uniform(-reach[1], reach[1], n),
        weight=rng.uniform(0.6, 5, n),
        **kwargs,
    )


def maps_of(c, w, directions=ALL):
    return c.maps(w.v1[None], w.v2[None], w.weight, directions)[:, 0]


def gaussian(grid, v1, v2, s1, s2):
    """Of unit area, times the area of a grid cell."""
    profile1 = np.exp(-0.5 * ((grid.v1 - v1) / s1) ** 2) / s1
    profile2 = np.exp(-0.5 * ((grid.v2 - v2) / s2) ** 2) / s2
    cell = grid.step[0] * grid.step[1]
    return cell / (2 * np.pi) * np.outer(profile2, profile1)


def slow_maps(c, w, directions=ALL, *, on_grid=True):
    """Gaussians less the mean at 3, 4, 5 s on both sides, one after another."""
    total = np.zeros((4, *c.grid.shape))
    for k in np.flatnonzero(c.kind >= 0):
        s1, s2 = c.s1[c.kind[k]], c.s2[c.kind[k]]
        corners = [(w.v1[k], w.v2[k], 1.0)]
        if on_grid:
            x, y = ((v[k] - g[0]) / (g[1] - g[0]) for v, g in
                    ((w.v1, c.grid.v1), (w.v2, c.grid.v2)))  # fmt: skip
            i, j = np.floor(x), np.floor(y)
            corners = [
                (
                    c.grid.v1[0] + (i + a) * c.grid.step[0],
                    c.grid.v2[0] + (j + b) * c.grid.step[1],
                    abs(1 - a - (x - i)) * abs(1 - b - (y - j)),
                )
                for a in (0, 1)
                for b in (0, 1)
            ]
        for v1, v2, share in corners:
            peak = gaussian(c.grid, v1, v2, s1, s2)
            for u, (e1, e2) in enumerate(contrast.DIRECTIONS):
                ring = [
                    gaussian(c.grid, v1 + r * e1 * s1, v2 + r * e2 * s2, s1, s2)
                    for r in (-5, -4, -3, 3, 4, 5)
                ]
                total[u] += w.weight[k] * share * (peak - np.mean(ring, axis=0))
    return total[list(directions)]


def test_maps_are_sums_of_gaussians_less_their_surroundings():
    w = scattered(np.random.default_rng(0), 60)
    c = Contrast.of(w, V_MAX)
    found, slow = maps_of(c, w), slow_maps(c, w)
    # What a grid of 0.75 standard errors folds back of a Gaussian.
    np.testing.assert_allclose(found, slow, atol=5e-4 * slow.max())
    exact = slow_maps(c, w, on_grid=False)
    np.testing.assert_allclose(found, exact, atol=0.15 * exact.max())


def test_witnesses_of_different_widths():
    rng = np.random.default_rng(1)
    width = np.repeat([0.2, 0.5, 1.0, 2.0, 10.0], 30)
    w = scattered(rng, 150, s1=S1 * width, s2=S2 * width)
    c = Contrast.of(w, V_MAX)
    assert len(c.s1) > 1
    found, slow = maps_of(c, w), slow_maps(c, w)
    np.testing.assert_allclose(found, slow, atol=5e-4 * slow.max())


def test_classes_are_near_the_widths_and_have_the_ratio_of_the_axes():
    rng = np.random.default_rng(2)
    size = 2.0 ** rng.uniform(-2, 2, 500)
    w = scattered(rng, 500, s1=S1 * size, s2=S2 * size)
    c = Contrast.of(w, V_MAX)
    np.testing.assert_allclose(c.s1 / c.s2, S1 / S2)
    relative = size / np.median(size)
    np.testing.assert_array_equal(c.kind < 0, relative > contrast.WIDEST)
    own = c.kind >= 0
    ratio = c.s1[c.kind[own]] / (S1 * np.maximum(size[own], 0.5 * np.median(size)))
    limit = contrast.CLASS_RATIO**0.5 * (1 + 1e-9)
    assert np.all((ratio <= limit) & (ratio >= 1 / limit))
    # Narrow ones are raised, not lost.
    assert c.s1.min() >= S1 * np.median(size) * 0.5 / limit
    assert c.grid.step[0] <= 0.75 * c.s1.min()


def test_wide_witnesses_tell_nothing():
    rng = np.random.default_rng(3)
    width = np.where(np.arange(50) < 10, 5.0, 1.0)
    w = scattered(rng, 50, s1=S1 * width, s2=S2 * width)
    c = Contrast.of(w, V_MAX)
    np.testing.assert_array_equal(c.kind, np.where(np.arange(50) < 10, -1, 0))
    before = maps_of(c, w)
    w.weight[:10] = 1e6
    np.testing.assert_allclose(maps_of(c, w), before, atol=1e-9)


@pytest.mark.parametrize("u", ALL)
def test_along_a_ridge_there_is_no_contrast(u):
    """A ridge along a direction, evenly filled: at its crest, nought."""
    e1, e2 = contrast.DIRECTIONS[u]
    along = np.arange(-60, 60, 0.25)
    w = witnesses(along * e1 * S1, along * e2 * S2)
    c = Contrast.of(w, V_MAX)
    at = tuple(n // 2 for n in c.grid.shape)
    t = maps_of(c, w)[(slice(None), *at)]
    crest = t.max()
    assert abs(t[u]) < 0.01 * crest
    across = [2, 3] if u < 2 else [0, 1]
    assert t[across].min() > 0.9 * crest


def test_a_peak_on_a_ridge_has_the_contrast_of_the_peak():
    along = np.arange(-60, 60, 0.25)
    v1 = np.concatenate([along * S1, np.full(20, 1.0)])
    w = witnesses(v1, np.zeros_like(v1))
    c = Contrast.of(w, V_MAX)
    least = maps_of(c, w).min(axis=0)
    row, column = np.unravel_index(least.argmax(), least.shape)
    assert abs(c.grid.v1[column] - 1) <= c.grid.step[0]
    assert c.grid.v2[row] == 0
    peak = replace(w, weight=(np.arange(len(v1)) >= len(along)).astype(float))
    alone = slow_maps(c, peak)
    assert least.max() == pytest.approx(alone[0].max(), rel=0.05)


def test_a_level_field_has_no_contrast():
    v1, v2 = np.meshgrid(np.arange(-15, 15, S1 / 2), np.arange(-10, 10, S2 / 2))
    w = witnesses(v1.ravel(), v2.ravel())
    c = Contrast.of(w, V_MAX)
    level = 4 * c.grid.step[0] * c.grid.step[1] / (S1 * S2)
    assert np.abs(maps_of(c, w)).max() < 0.01 * level


@given(
    st.floats(-60, 60),
    st.floats(-60, 60),
    st.sampled_from([0, 1, 2, 3]),
)
def test_nothing_comes_in_again_on_the_other_side(x, y, u):
    """However far outside, a witness is where it is."""
    rng = np.random.default_rng(4)
    w = scattered(rng, 5, reach=(2.0, 2.0))
    far = witnesses(
        np.append(w.v1, x * S1), np.append(w.v2, y * S2), weight=np.append(w.weight, 9)
    )
    c = Contrast.of(far, V_MAX)
    slow = slow_maps(c, far, [u])[0]
    found = maps_of(c, far, [u])[0]
    np.testing.assert_allclose(found, slow, atol=1e-3 * slow.max())


def test_witnesses_of_many_widths_do_not_come_in_again():
    """The widest class sets the margin, whatever class is outside."""
    for x in (7.0, 12.0, 20.0, 40.0):
        w = witnesses([0.0, 0.5, 1.0, x, -x], np.zeros(5), s1=[S1, S1, 2 * S1, S1, S1])
        c = Contrast.of(w, V_MAX)
        slow = slow_maps(c, w)
        np.testing.assert_allclose(maps_of(c, w), slow, atol=1e-3 * slow.max())


def test_trials_are_maps_of_their_own(monkeypatch):
    rng = np.random.default_rng(5)
    w = scattered(rng, 40, s1=S1 * 2.0 ** rng.integers(0, 2, 40))
    c = Contrast.of(w, V_MAX)
    v1 = w.v1 + rng.normal(size=(7, 40))
    v2 = w.v2 + rng.normal(size=(7, 40))
    together = c.maps(v1, v2, w.weight, [2, 0])
    assert together.shape == (2, 7, *c.grid.shape)
    for t in range(7):
        alone = c.maps(v1[t : t + 1], v2[t : t + 1], w.weight, ALL)[:, 0]
        np.testing.assert_allclose(together[:, t], alone[[2, 0]], atol=1e-12)
    monkeypatch.setattr(contrast, "CACHED", 1)
    np.testing.assert_allclose(c.maps(v1, v2, w.weight, [2, 0]), together, atol=1e-12)


def test_maps_are_linear_in_the_weights():
    rng = np.random.default_rng(6)
    w = scattered(rng, 30)
    c = Contrast.of(w, V_MAX)
    other = rng.uniform(0, 1, 30)

    def maps(weight):
        return c.maps(w.v1[None], w.v2[None], weight, ALL)

    np.testing.assert_allclose(
        maps(2 * w.weight + other), 2 * maps(w.weight) + maps(other), atol=1e-12
    )


def test_shifted_by_grid_steps_the_map_is_shifted():
    rng = np.random.default_rng(7)
    w = scattered(rng, 30, reach=(2.0, 1.5))
    c = Contrast.of(w, V_MAX)
    step1, step2 = c.grid.step
    moved = c.maps(w.v1[None] + 3 * step1, w.v2[None] - 2 * step2, w.weight, ALL)[:, 0]
    np.testing.assert_allclose(moved[:, :-2, 3:], maps_of(c, w)[:, 2:, :-3], atol=1e-9)


def test_sharp_witnesses_count_more():
    """Of unit area: twice as sharp on both axes is four times as high."""
    w = witnesses([0.0, 0.0], [0.0, 0.0], s1=[S1, 2 * S1], s2=[S2, 2 * S2])
    peaks = []
    for k in (0, 1):
        w.weight[:] = np.arange(2) == k
        c = Contrast.of(w, V_MAX)
        peaks.append(maps_of(c, w).min(axis=0).max())
    assert peaks[0] / peaks[1] == pytest.approx(4.0, rel=1e-3)


def test_the_grid_is_bounded():
    w = witnesses([0.0], [0.0], s1=1e-4, s2=1e-4)
    c = Contrast.of(w, V_MAX)
    assert max(c.grid.shape) <= contrast.MAX_SIZE
    assert np.isfinite(maps_of(c, w)).all()
