# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Correlation coefficients and their peaks, against loops over displacements."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from astro_scc.correlation.zncc import correlate_windows, find_peaks


def zncc(a, b):
    """The zero-mean normalised cross-correlation; 0 without variance."""
    flat = [np.ptp(v) <= 1e-14 * np.abs(v).max() for v in (a, b)]
    if any(flat):
        return 0.0
    a, b = a - a.mean(), b - b.mean()
    norm = np.sqrt(np.sum(a * a) * np.sum(b * b))
    return np.sum(a * b) / norm


def double_loop(values, footprint, window, reach, valid=None, min_overlap=0.8):
    """The paper's equation, one displacement after the other."""
    height, width = footprint.shape
    shape = tuple(2 * r + 1 for r in reach)
    coefficient, overlap = np.zeros(shape), np.zeros(shape)
    if valid is None:
        valid = np.ones(window.shape, dtype=bool)
    for y in range(shape[0]):
        for x in range(shape[1]):
            box = (slice(y, y + height), slice(x, x + width))
            both = footprint & valid[box]
            overlap[y, x] = both.sum() / footprint.sum()
            if overlap[y, x] >= min_overlap and both.any():
                coefficient[y, x] = zncc(values[both], window[box][both])
    return coefficient, overlap


@st.composite
def patterns(draw):
    """A pattern, its footprint and a window around it."""
    height, width = draw(st.integers(1, 7)), draw(st.integers(1, 7))
    reach = draw(st.integers(0, 6)), draw(st.integers(0, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    footprint = rng.random((height, width)) < draw(st.floats(0.3, 1))
    footprint[rng.integers(height), rng.integers(width)] = True
    shape = (height + 2 * reach[0], width + 2 * reach[1])
    # Rounded, so that no local variance is lost beside the window's energy.
    window = np.round(rng.normal(size=shape), 2)
    if draw(st.booleans()):
        # Zero almost everywhere, as a plane outside its SSPs.
        window[rng.random(shape) < 0.7] = 0
    if draw(st.booleans()):
        values = window[
            reach[0] : reach[0] + height, reach[1] : reach[1] + width
        ].copy()
    else:
        values = rng.normal(size=footprint.shape)
    return values, footprint, window, reach


def test_zncc_of_the_textbook():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 5, 8))
    assert zncc(a, b) == pytest.approx(np.corrcoef(a.ravel(), b.ravel())[0, 1])
    assert zncc(a, 3 * a + 7) == pytest.approx(1)
    assert zncc(a, -a) == pytest.approx(-1)


@pytest.mark.parametrize("value", [0.0, 0.1, -1e9, 1 / 3])
def test_zncc_of_nothing_is_zero(value):
    flat = np.full(7, value)
    assert zncc(flat, np.arange(7)) == 0
    assert zncc(np.arange(7), flat) == 0
    assert zncc(flat, flat) == 0


@given(patterns())
def test_equals_the_double_loop(case):
    values, footprint, window, reach = case
    coefficient, overlap = correlate_windows(values, footprint, window, reach)
    expected, _ = double_loop(values, footprint, window, reach)
    np.testing.assert_allclose(coefficient, expected, atol=1e-8)
    assert (overlap == 1).all()


@given(patterns(), st.floats(0, 0.6), st.floats(0.05, 1), st.integers(0, 2**32 - 1))
def test_masked_equals_the_double_loop(case, share, min_overlap, seed):
    values, footprint, window, reach = case
    valid = np.random.default_rng(seed).random(window.shape) >= share
    coefficient, overlap = correlate_windows(
        values, footprint, window, reach, valid=valid, min_overlap=min_overlap
    )
    expected, expected_overlap = double_loop(
        values, footprint, window, reach, valid, min_overlap
    )
    np.testing.assert_allclose(overlap, expected_overlap, atol=1e-12)
    np.testing.assert_allclose(coefficient, expected, atol=1e-8)
    # What stands in missing pixels is of no account.
    other = np.where(valid, window, np.nan)
    again, _ = correlate_windows(
        values, footprint, other, reach, min_overlap=min_overlap
    )
    np.testing.assert_allclose(again, coefficient, atol=1e-8)


def test_many_windows_are_one_after_the_other():
    rng = np.random.default_rng(0)
    values, footprint = rng.normal(size=(6, 5)), rng.random((6, 5)) < 0.7
    windows = rng.normal(size=(2, 3, 16, 17))
    valid = rng.random(windows.shape) < 0.9
    all_, overlap = correlate_windows(
        values, footprint, windows, (5, 6), valid=valid, min_overlap=0.6
    )
    assert all_.shape == overlap.shape == (2, 3, 11, 13)
    for index in np.ndindex(2, 3):
        one, _ = correlate_windows(
            values, footprint, windows[index], (5, 6), valid=valid[index],
            min_overlap=0.6,
        )  # fmt: skip
        np.testing.assert_allclose(all_[index], one, atol=1e-12)


@pytest.mark.parametrize("value", [0.0, 0.1, 1e9])
def test_flat_windows_and_patterns_give_zero(value):
    rng = np.random.default_rng(0)
    footprint = np.ones((4, 4), dtype=bool)
    window = np.full((12, 12), value)
    valid = rng.random(window.shape) < 0.9
    for keywords in ({}, {"valid": valid, "min_overlap": 0.1}):
        pattern = rng.normal(size=(4, 4))
        coefficient, _ = correlate_windows(
            pattern, footprint, window, (4, 4), **keywords
        )
        assert (coefficient == 0).all()
        flat = np.full((4, 4), value)
        noise = rng.normal(size=window.shape)
        coefficient, _ = correlate_windows(flat, footprint, noise, (4, 4), **keywords)
        assert (coefficient == 0).all()


def slow_peaks(maps, threshold):
    """Pixels that no neighbour exceeds, nor any later one equals."""
    found = []
    for k, plane in enumerate(maps):
        for y in range(1, plane.shape[0] - 1):
            for x in range(1, plane.shape[1] - 1):
                around = plane[y - 1 : y + 2, x - 1 : x + 2].ravel()
                before, centre, after = around[:4], around[4], around[5:]
                if (
                    centre >= threshold
                    and (centre >= before).all()
                    and (centre > after).all()
                ):
                    found.append((k, y, x))
    return found


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 3),
    st.integers(1, 14),
    st.integers(1, 14),
    st.floats(0, 3),
    st.floats(-0.2, 0.9),
    st.booleans(),
    st.floats(0, 0.2),
)
def test_equals_brute_force(seed, n, ny, nx, smooth, threshold, ties, missing):
    rng = np.random.default_rng(seed)
    maps = ndimage.gaussian_filter(
        rng.uniform(-1, 1, (n, ny, nx)), (0, smooth, smooth), mode="wrap"
    )
    if ties:
        maps = np.round(maps, 1)
    maps[rng.random(maps.shape) < missing] = np.nan
    index, y, x, value = find_peaks(maps, threshold)
    expected = slow_peaks(maps, threshold)
    assert len(index) == len(expected)
    for k, (map_, py, px) in enumerate(expected):
        assert index[k] == map_
        assert abs(y[k] - py) <= 0.5
        assert abs(x[k] - px) <= 0.5
        assert maps[map_, py, px] <= value[k] <= max(1, maps[map_, py, px])


@pytest.mark.parametrize("shape", [(0, 5, 5), (2, 1, 1), (2, 2, 9), (3, 5, 5)])
def test_no_peaks(shape):
    for column in find_peaks(np.zeros(shape), 0.5):
        assert column.shape == (0,)
