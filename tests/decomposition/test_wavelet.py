# Licensed under a 3-clause BSD style license - see LICENSE.rst
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.decomposition import Decomposer
from astro_scc.decomposition.wavelet import (
    KERNELS,
    atrous_transform,
    scale_size,
    wavelet_planes,
)


def mirrored(index, n):
    """Index into n pixels, reflected about the centres of the outermost."""
    period = 2 * (n - 1) if n > 1 else 1
    index %= period
    return index if index < n else period - index


def slow_smooth(image, exists, kernel, step):
    """The normalised convolution as a literal sum over the filter's taps."""
    ny, nx = image.shape
    half = len(kernel) // 2
    result = np.zeros_like(image)
    for y in range(ny):
        for x in range(nx):
            if not exists[y, x]:
                continue
            total = weight = 0.0
            for j, hy in enumerate(kernel):
                for i, hx in enumerate(kernel):
                    at = (
                        mirrored(y + (j - half) * step, ny),
                        mirrored(x + (i - half) * step, nx),
                    )
                    if exists[at]:
                        total += hy * hx * image[at]
                        weight += hy * hx
            result[y, x] = total / weight
    return result


def slow_transform(image, n_levels, kernel, exists):
    planes, smooth = [], np.where(exists, image, 0.0)
    for level in range(n_levels):
        following = slow_smooth(smooth, exists, KERNELS[kernel], 2**level)
        planes.append(smooth - following)
        smooth = following
    return np.array(planes), smooth


def large_enough(shape, n_levels, kernel):
    return (len(KERNELS[kernel]) // 2) * 2 ** (n_levels - 1) < min(shape)


cases = st.tuples(
    st.tuples(st.integers(3, 40), st.integers(3, 40)),
    st.integers(1, 4),
    st.sampled_from(sorted(KERNELS)),
    st.integers(0, 2**32 - 1),
).filter(lambda case: large_enough(*case[:3]))


@given(cases, st.floats(0, 0.9))
def test_missing_pixels_never_spread(case, share):
    shape, n_levels, kernel, seed = case
    rng = np.random.default_rng(seed)
    image = rng.normal(size=shape)
    mask = rng.random(shape) < share
    nan = rng.random(shape) < share / 4
    image[nan] = rng.choice([np.nan, np.inf, -np.inf], size=nan.sum())
    missing = mask | nan
    planes, residual = atrous_transform(image, n_levels, kernel=kernel, mask=mask)
    assert np.isfinite(planes).all()
    assert np.isfinite(residual).all()
    assert (planes[:, missing] == 0).all()
    np.testing.assert_allclose(
        (planes.sum(axis=0) + residual)[~missing], image[~missing], atol=1e-13
    )
    # What stands behind the mask is of no account.
    other = np.where(missing, 1e6, image)
    again, _ = atrous_transform(other, n_levels, kernel=kernel, mask=missing)
    np.testing.assert_array_equal(planes, again)


@given(cases, st.floats(0, 0.9), st.floats(-1e6, 1e6))
def test_constant_image_with_holes_has_no_planes(case, share, value):
    shape, n_levels, kernel, seed = case
    mask = np.random.default_rng(seed).random(shape) < share
    planes, _ = atrous_transform(
        np.full(shape, value), n_levels, kernel=kernel, mask=mask
    )
    assert np.abs(planes).max() <= 1e-13 * abs(value) + 1e-300


@settings(max_examples=10)
@given(
    st.tuples(st.integers(5, 12), st.integers(5, 12)),
    st.integers(1, 2),
    st.sampled_from(sorted(KERNELS)),
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.3]),
)
def test_equals_literal_convolution(shape, n_levels, kernel, seed, share):
    rng = np.random.default_rng(seed)
    image, mask = rng.normal(size=shape), rng.random(shape) < share
    planes, residual = atrous_transform(image, n_levels, kernel=kernel, mask=mask)
    slow_planes, slow_residual = slow_transform(image, n_levels, kernel, ~mask)
    np.testing.assert_allclose(planes, slow_planes, atol=1e-13)
    np.testing.assert_allclose(residual, slow_residual, atol=1e-13)


def test_planes_are_those_of_the_transform():
    image = np.random.default_rng(0).normal(size=(50, 60))
    linear, _ = atrous_transform(image, 4, kernel="b1")
    cubic, _ = atrous_transform(image, 4, kernel="b3")
    planes = wavelet_planes(image, [3, 1, 1.5, 2.5])
    np.testing.assert_array_equal(planes, [linear[3], linear[1], cubic[1], cubic[2]])
    planes = wavelet_planes(image, [1, 3], kernel="b3")
    np.testing.assert_array_equal(planes, [cubic[1], cubic[3]])


@pytest.mark.parametrize(
    ("scale", "size"), [(0, 1), (0.5, 1.5), (1, 2), (1.5, 3), (2, 4), (2.5, 6), (4, 16)]
)
def test_scale_size(scale, size):
    assert scale_size(scale) == size


@pytest.mark.parametrize(
    ("shape", "scales", "options", "message"),
    [
        ((4, 32, 32), [1], {}, "two dimensions, this has 3"),
        ((16, 40), [4], {"kernel": "b1"}, "too small for wavelet scale"),
        ((16, 40), [3], {"kernel": "b3"}, "too small for wavelet scale"),
        ((40, 2), [0], {"kernel": "b3"}, "too small for wavelet scale"),
        ((32, 32), [2], {"mask": np.zeros(32, bool)}, r"mask has shape \(32,\)"),
        ((32, 32), [2], {"kernel": "b2"}, "unknown wavelet kernel 'b2'"),
        ((32, 32), [1.5], {"kernel": "haar"}, "unknown wavelet kernel 'haar'"),
        ((32, 32), [1.5], {"kernel": "b3"}, "between those of kernel 'b1' only"),
        ((32, 32), [], {}, "at least one wavelet scale"),
        *(
            ((32, 32), [scale], {}, "not a number of the series")
            for scale in (-1, -0.5, 1.25, np.nan, np.inf)
        ),
    ],
)
def test_what_is_refused(shape, scales, options, message):
    with pytest.raises(ValueError, match=message):
        wavelet_planes(np.zeros(shape), scales, **options)


def test_what_to_do_about_a_small_image():
    with pytest.raises(ValueError, match="leave out the largest scales"):
        Decomposer(scales=[4])(np.zeros((16, 40)))
