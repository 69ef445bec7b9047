# Licensed under a 3-clause BSD style license - see LICENSE.rst
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from astro_scc.correlation.zncc import Template, correlate_windows, find_peaks, zncc


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


def test_differs_from_the_double_loop_by_rounding():
    rng = np.random.default_rng(0)
    footprint = rng.random((12, 14)) < 0.7
    values, window = rng.normal(size=footprint.shape), rng.normal(size=(52, 54))
    coefficient, _ = correlate_windows(values, footprint, window, (20, 20))
    expected, _ = double_loop(values, footprint, window, (20, 20))
    np.testing.assert_allclose(coefficient, expected, atol=1e-13)


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


@given(
    patterns(),
    st.floats(-9, 9),
    st.floats(-9, 9),
    st.floats(-100, 100),
    st.floats(-100, 100),
    st.booleans(),
)
def test_unit_and_offset_do_not_matter(case, own, other, own_zero, zero, masked):
    values, footprint, window, reach = case
    valid = None
    if masked:
        valid = np.random.default_rng(0).random(window.shape) < 0.8
    settings_ = {"valid": valid, "min_overlap": 0.5}
    expected, _ = correlate_windows(values, footprint, window, reach, **settings_)
    found, _ = correlate_windows(
        10**own * (values + own_zero),
        footprint,
        10**other * (window + zero),
        reach,
        **settings_,
    )
    np.testing.assert_allclose(found, expected, atol=1e-6)


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


def faint_pattern(contrast, seed=0, reach=(24, 24)):
    """A pattern of unit variance in a window with a bright core."""
    rng = np.random.default_rng(seed)
    window = ndimage.gaussian_filter(rng.normal(size=(60, 60)), 2)
    window /= window.std()
    footprint = ndimage.gaussian_filter(rng.normal(size=(12, 12)), 3) > 0
    values = window[24:36, 20:32].copy()
    y, x = np.mgrid[:60, :60]
    distance = (x - 48) ** 2 + (y - 40) ** 2
    window += contrast * np.where(distance < 64, np.exp(-distance / 12.5), 0)
    return values, footprint, window, reach


@pytest.mark.slow
@pytest.mark.parametrize(
    ("contrast", "tolerance"),
    [(0, 1e-12), (1e2, 1e-10), (1e4, 1e-6), (1e5, 1e-5), (1e6, 2e-3)],
)
@pytest.mark.parametrize("masked", [False, True])
def test_bright_core_beside_a_faint_pattern(contrast, tolerance, masked):
    """Its squares would drown the pattern's variance in single precision."""
    for seed in range(4):
        values, footprint, window, reach = faint_pattern(contrast, seed)
        valid = np.ones(window.shape, dtype=bool)
        valid[:6] = not masked
        found, _ = correlate_windows(values, footprint, window, reach, valid=valid)
        expected, _ = double_loop(values, footprint, window, reach, valid)
        counts = found != 0  # the rest varies less than the rounding
        np.testing.assert_allclose(found[counts], expected[counts], atol=tolerance)
        assert counts[expected != 0].mean() > (0.9 if contrast > 1e5 else 0.9999)
        for mine, theirs in zip(
            find_peaks(found[None], 0.6), find_peaks(expected[None], 0.6), strict=True
        ):
            # The same peaks, flat ones moved a little by the rounding.
            np.testing.assert_allclose(mine, theirs, atol=150 * tolerance)


def test_planes_in_single_precision():
    """Transformed in double precision the storage costs 1e-6 at most."""
    values, footprint, window, reach = faint_pattern(100)
    found, _ = correlate_windows(
        values.astype(np.float32), footprint, window.astype(np.float32), reach
    )
    expected, _ = double_loop(values, footprint, window, reach)
    np.testing.assert_allclose(found, expected, atol=1e-6)


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


def test_flat_part_of_a_window_gives_zero():
    """Beside a core, zeros are no pattern, whatever the rounding."""
    values, footprint, window, reach = faint_pattern(1e6)
    window = np.where(window > 100, window, 0)
    found, _ = correlate_windows(values, footprint, window, reach)
    expected, _ = double_loop(values, footprint, window, reach)
    assert (expected == 0).any()
    assert (found[expected == 0] == 0).all()


def test_window_without_a_single_pixel():
    coefficient, overlap = correlate_windows(
        np.arange(9.0).reshape(3, 3), np.ones((3, 3), bool),
        np.full((2, 7, 7), np.nan), (2, 2), min_overlap=0.1,
    )  # fmt: skip
    assert (coefficient == 0).all()
    assert (overlap == 0).all()


@settings(max_examples=20)
@given(st.integers(-9, 9), st.integers(-9, 9), st.integers(0, 2**32 - 1))
def test_displacement_is_where_the_pattern_went(dy, dx, seed):
    rng = np.random.default_rng(seed)
    window = rng.normal(size=(26, 28))
    footprint = rng.random((6, 8)) < 0.8
    values = window[10 + dy : 16 + dy, 10 + dx : 18 + dx]
    coefficient, _ = correlate_windows(values, footprint, window, (10, 10))
    assert coefficient[10 + dy, 10 + dx] == pytest.approx(1)
    assert coefficient.argmax() == np.ravel_multi_index((10 + dy, 10 + dx), (21, 21))


def test_template_remembers_shapes():
    template = Template(np.eye(3), np.ones((3, 3), bool), (4, 2))
    assert template.window_shape == (11, 7)
    assert template.result_shape == (9, 5)
    assert template.n_pixels == 9


def test_errors():
    values, footprint = np.eye(4), np.ones((4, 4), dtype=bool)
    with pytest.raises(ValueError, match="pattern's shape and some pixels"):
        correlate_windows(values, footprint[:3], np.zeros((8, 8)), (2, 2))
    with pytest.raises(ValueError, match="pattern's shape and some pixels"):
        correlate_windows(values, np.zeros((4, 4)), np.zeros((8, 8)), (2, 2))
    with pytest.raises(ValueError, match=r"windows must have shape \(8, 8\)"):
        correlate_windows(values, footprint, np.zeros((8, 9)), (2, 2))
    for reach in ((2,), (2, -1), (1, 2, 3)):
        with pytest.raises(ValueError, match="search radius must be two numbers"):
            correlate_windows(values, footprint, np.zeros((8, 8)), reach)
