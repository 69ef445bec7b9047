# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Wavelet planes and their noise, against sums, textbooks and simulated noise."""

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from astro_scc.components.restoring import correlated_noise
from astro_scc.decomposition.wavelet import (
    KERNELS,
    atrous_transform,
    local_noise,
    measure_noise,
    plane_noise,
    propagated_noise,
    scale_size,
    shared_variance,
    wavelet_planes,
)
from astro_scc.epochs import Beam
from astro_scc.simulation import simulate_two_fluid


def slow_smooth(image, exists, kernel, step):
    """The normalised convolution as a literal sum over the filter's taps."""
    half = len(kernel) // 2
    result = np.zeros_like(image)

    def mirrored(index, n):
        """Index into n pixels, reflected about the centres of the outermost."""
        period = 2 * (n - 1)
        return min(index % period, period - index % period)

    for y, x in np.argwhere(exists):
        total = weight = 0.0
        for j, i in np.ndindex(len(kernel), len(kernel)):
            at = [
                mirrored(a + (k - half) * step, n)
                for a, k, n in zip((y, x), (j, i), image.shape, strict=True)
            ]
            if exists[*at]:
                total += kernel[j] * kernel[i] * image[*at]
                weight += kernel[j] * kernel[i]
        result[y, x] = total / weight
    return result


CASES = st.tuples(
    st.tuples(st.integers(3, 40), st.integers(3, 40)),
    st.integers(1, 4),
    st.sampled_from(sorted(KERNELS)),
    st.integers(0, 2**32 - 1),
).filter(lambda c: (len(KERNELS[c[2]]) // 2) * 2 ** (c[1] - 1) < min(c[0]))


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
    smooth = np.where(mask, 0.0, image)
    for level, plane in enumerate(planes):
        following = slow_smooth(smooth, ~mask, KERNELS[kernel], 2**level)
        np.testing.assert_allclose(plane, smooth - following, atol=1e-13)
        smooth = following
    np.testing.assert_allclose(residual, smooth, atol=1e-13)


@settings(max_examples=30)
@given(CASES, st.floats(0, 0.9), st.floats(-1e6, 1e6))
def test_missing_pixels_never_spread(case, share, value):
    shape, n_levels, kernel, seed = case
    rng = np.random.default_rng(seed)
    image, mask = rng.normal(size=shape), rng.random(shape) < share
    planes, residual = atrous_transform(image, n_levels, kernel=kernel, mask=mask)
    assert (planes[:, mask] == 0).all()
    total = planes.sum(axis=0) + residual
    np.testing.assert_allclose(total[~mask], image[~mask], atol=1e-13)
    # What stands behind the mask is of no account.
    other = np.where(mask, np.nan, image)
    again, _ = atrous_transform(other, n_levels, kernel=kernel, mask=mask)
    np.testing.assert_array_equal(planes, again)
    # A constant image with holes has no planes.
    constant = np.full(shape, value)
    planes, _ = atrous_transform(constant, n_levels, kernel=kernel, mask=mask)
    assert np.abs(planes).max() <= 1e-13 * abs(value) + 1e-300


def test_planes_are_those_of_the_transform():
    image = np.random.default_rng(0).normal(size=(50, 60))
    linear, _ = atrous_transform(image, 4, kernel="b1")
    cubic, _ = atrous_transform(image, 4, kernel="b3")
    planes = wavelet_planes(image, [3, 1, 1.5, 2.5])
    np.testing.assert_array_equal(planes, [linear[3], linear[1], cubic[1], cubic[2]])
    planes = wavelet_planes(image, [1, 3], kernel="b3")
    np.testing.assert_array_equal(planes, [cubic[1], cubic[3]])
    assert [scale_size(j) for j in (0, 0.5, 1, 1.5, 4)] == [1, 1.5, 2, 3, 16]


SCALES = (1, 2, 3, 4)
RMS = 0.002
BEAM = Beam(1 * u.mas, 1 * u.mas)  # full width of 10 pixels of 0.1 mas
LONG = Beam(1.2 * u.mas, 0.5 * u.mas, 30 * u.deg)
COVARIANCE = np.eye(2) * (10 / np.sqrt(8 * np.log(2))) ** 2


def beam_noise(seed, beam=BEAM):
    how = {"rms": 1.0, "beam": beam, "pixel_scale": 0.1 * u.mas, "rng": seed}
    return correlated_noise((256, 256), **how)


def test_propagated_noise_equals_the_textbook():
    """Factors of the cubic spline (Starck & Murtagh 2006, Table 2.1)."""
    np.testing.assert_allclose(
        propagated_noise(1.0, [0, 1, 2, 3, 4], kernel="b3"),
        [0.890, 0.201, 0.086, 0.042, 0.021],
        atol=0.002,
    )


@pytest.mark.parametrize(("kernel", "beam"), [("b1", None), ("b3", BEAM), ("b1", LONG)])
def test_propagated_noise_equals_measured(kernel, beam):
    images, covariance = np.random.default_rng(1).normal(size=(4, 256, 256)), None
    if beam is not None:
        images = [beam_noise(seed, beam) for seed in range(8)]
        flip = np.diag([-1.0, 1.0])
        covariance = flip @ beam.covariance.to_value(u.mas**2) @ flip / 0.1**2
    scales = [*SCALES, 1.5] if kernel == "b1" else SCALES
    planes = np.stack([wavelet_planes(i, scales, kernel=kernel) for i in images])
    # Away from the edges, where the slopes of the mirrored noise add power.
    planes = planes[..., 16:-16, 16:-16]
    measured = np.sqrt((planes**2).mean(axis=(0, 2, 3)))
    expected = propagated_noise(1.0, scales, beam_covariance=covariance, kernel=kernel)
    tolerance = [0.02, 0.02, 0.04, 0.08, 0.02][: len(scales)]
    assert (np.abs(measured / expected - 1) < tolerance).all()


@pytest.mark.slow
def test_plane_noise_beside_a_bright_jet():
    """The noise of a plane whose median coefficient is the jet's."""
    jets = [simulate_two_fluid(rng=seed, n_epochs=2).cube.data for seed in range(10)]
    expected = propagated_noise(RMS, SCALES, beam_covariance=COVARIANCE)
    planes = [wavelet_planes(image, SCALES) for image in np.concatenate(jets)]
    found = [[*map(plane_noise, own, SCALES)] for own in planes]
    ratio = np.array(found) / expected
    assert (np.abs(ratio.mean(axis=0) - 1) < [0.06, 0.06, 0.08, 0.12]).all()
    assert (ratio.std(axis=0) < [0.08, 0.08, 0.08, 0.3]).all()


def test_plane_noise_of_sources_without_sky_and_of_blanked_pixels():
    rng = np.random.default_rng(2)
    # More than half of the pixels are source: the median alone would be it.
    plane = rng.normal(size=(128, 128))
    plane[:, :80] += 1e4 * rng.normal(size=(128, 80))
    assert plane_noise(plane, 1) == pytest.approx(1, abs=0.1)
    # Every pixel is within a scale of some source: the noise is that of all pixels.
    plane = rng.normal(size=(64, 64))
    plane[::8, ::8] = 1e3
    everything = 1.4826 * np.median(np.abs(plane))
    assert plane_noise(plane, 4) == pytest.approx(everything, rel=1e-4)
    # Beyond five sigma and a scale around, no pixel of a faint edge counts.
    y, x = np.mgrid[-64:64, -64:64]
    plane = rng.normal(size=y.shape) + 200 * np.exp(-(x**2 + y**2) / 2 / 15**2)
    sigma = plane_noise(1e-3 * plane, 2) / 1e-3
    sky = ndimage.distance_transform_edt(np.abs(plane) <= 5 * sigma) > 4
    converged = 1.4826 * np.median(np.abs(plane[sky]))
    assert sigma == pytest.approx(converged, rel=2e-3)
    # CLEAN maps are exactly zero outside the field: their MAD is 0.
    plane = np.zeros((128, 128))
    plane[:60, :60] = rng.normal(size=(60, 60))
    assert plane_noise(plane, 1) == pytest.approx(1, abs=0.05)
    assert plane_noise(np.zeros((32, 32)), 1) == 0
    assert (local_noise(np.zeros((32, 32)), 1) == 0).all()


@pytest.mark.parametrize(
    ("scale", "beam", "tolerance"), [(1, None, 0.15), (2, BEAM, 0.15), (3, BEAM, 0.25)]
)
def test_local_noise_follows_a_gradient(scale, beam, tolerance):
    gradient, white = np.linspace(1, 4, 256), np.random.default_rng(1)
    covariance = None if beam is None else COVARIANCE
    (true,) = propagated_noise(1.0, [scale], beam_covariance=covariance)
    found = []
    for seed in range(3):
        image = beam_noise(seed) if beam else white.standard_normal((256, 256))
        (plane,) = wavelet_planes(image * gradient, [scale])
        found.append(local_noise(plane, scale))
    ratio = (np.mean(found, axis=0) / (true * gradient)).mean(axis=0)
    np.testing.assert_allclose(ratio.reshape(4, -1).mean(axis=1), 1, atol=tolerance)


def test_shared_variance_is_that_of_what_both_images_show():
    rng = np.random.default_rng(3)
    same, *own = rng.normal(size=(3, 96, 96))
    mask = np.zeros(same.shape, bool)
    mask[:20] = True
    # Two thirds of the variance moves by (3, -5) px; what is beyond the mask is blank.
    moved = np.roll(same, (3, -5), (0, 1))
    planes = own[0] + np.sqrt(2) * same, own[1] + np.sqrt(2) * moved
    share, chance = shared_variance([(plane, None) for plane in planes], 1)
    assert share == pytest.approx(2 / 3, abs=0.05)
    assert chance == pytest.approx(1 / 96, rel=0.3)
    share, chance = shared_variance([(own[0], mask), (own[1], None)], 1)
    assert share < 6 * chance
    assert shared_variance([(same, None), (0 * same, None)], 1) == (0, np.inf)


def test_noise_of_an_image():
    rng = np.random.default_rng(4)
    image = rng.normal(5, 2, size=(128, 128))
    image[30:70, 30:70] += 1000
    none = np.zeros(image.shape, bool)
    assert measure_noise(image, none) == pytest.approx(2, rel=0.03)
    # Blanked, masked and missing pixels do not count.
    mask = np.arange(128)[:, None] + none >= 100
    blanked = np.where(mask, 1e6, image)
    blanked[:30], blanked[90, 5] = 0, np.nan
    assert measure_noise(blanked, mask) == pytest.approx(2, rel=0.05)
    assert measure_noise(image, ~none) == 0
    # More than half of the pixels are alike.
    alike = np.ones((10, 10))
    alike[0, 0] = 2
    assert measure_noise(alike, alike > 2) == pytest.approx(alike.std())


def test_local_noise_of_scattered_pixels_is_constant():
    """Boxes with hardly a pixel tell nothing of a place."""
    rng = np.random.default_rng(0)
    plane, mask = rng.normal(size=(128, 128)), rng.random((128, 128)) < 0.95
    noise = local_noise(plane, 1, mask=mask)
    assert np.ptp(noise) == 0
    assert noise[0, 0] == plane_noise(plane, 1, mask=mask)
    assert noise[0, 0] == pytest.approx(1, abs=0.2)
