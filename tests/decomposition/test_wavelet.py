# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Wavelet planes and their noise, against sums, textbooks and simulated noise."""

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.components.restoring import correlated_noise
from astro_scc.decomposition import Decomposer
from astro_scc.decomposition.wavelet import (
    KERNELS,
    atrous_transform,
    local_noise,
    plane_noise,
    propagated_noise,
    scale_size,
    wavelet_planes,
)
from astro_scc.epochs import Beam
from astro_scc.simulation import simulate_two_fluid


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
        ((16, 40), [4], {}, "too small for wavelet scale.*leave out the largest sc"),
        ((16, 40), [3], {"kernel": "b3"}, "too small for wavelet scale"),
        ((40, 2), [0], {"kernel": "b3"}, "too small for wavelet scale"),
        ((32, 32), [1.5], {"kernel": "haar"}, "unknown wavelet kernel 'haar'"),
        *(
            ((32, 32), [scale], {}, "not a number of the series")
            for scale in (-1, -0.5, 1.25, np.nan, np.inf)
        ),
    ],
)
def test_what_is_refused(shape, scales, options, message):
    with pytest.raises(ValueError, match=message):
        wavelet_planes(np.zeros(shape), scales, **options)


# -- noise of planes --------------------------------------------------------------


SCALES = (1, 2, 3, 4)
RMS = 0.002
BEAM = Beam(1 * u.mas, 1 * u.mas)  # full width of 10 pixels of 0.1 mas
COVARIANCE = np.eye(2) * (10 / np.sqrt(8 * np.log(2))) ** 2


def beam_noise(seed, shape=(128, 256), beam=BEAM, rms=RMS):
    return correlated_noise(
        shape, rms=rms, beam=beam, pixel_scale=0.1 * u.mas, rng=seed
    )


@pytest.mark.parametrize("kernel", ["b1", "b3"])
def test_propagated_white_noise_equals_measured(kernel):
    images = np.random.default_rng(1).normal(size=(4, 256, 256))
    planes = np.stack([wavelet_planes(i, SCALES, kernel=kernel) for i in images])
    measured = np.sqrt((planes**2).mean(axis=(0, 2, 3)))
    expected = propagated_noise(1.0, SCALES, kernel=kernel)
    assert (np.abs(measured / expected - 1) < [0.01, 0.02, 0.03, 0.06]).all()


def test_propagated_noise_equals_the_textbook():
    """Factors of the cubic spline (Starck & Murtagh 2006, Table 2.1)."""
    np.testing.assert_allclose(
        propagated_noise(1.0, [0, 1, 2, 3, 4], kernel="b3"),
        [0.890, 0.201, 0.086, 0.042, 0.021],
        atol=0.002,
    )


@pytest.mark.parametrize("kernel", ["b1", "b3"])
@pytest.mark.parametrize(
    "beam", [BEAM, Beam(1.2 * u.mas, 0.5 * u.mas, 30 * u.deg)], ids=["round", "long"]
)
def test_propagated_beam_noise_equals_measured(kernel, beam):
    images = [beam_noise(seed, (256, 256), beam) for seed in range(12)]
    planes = np.stack([wavelet_planes(i, SCALES, kernel=kernel) for i in images])
    # Away from the edges, where the slopes of the mirrored noise add power.
    planes = planes[..., 16:-16, 16:-16]
    measured = np.sqrt((planes**2).mean(axis=(0, 2, 3)))
    flip = np.diag([-1.0, 1.0])
    covariance = flip @ beam.covariance.to_value(u.mas**2) @ flip / 0.1**2
    expected = propagated_noise(RMS, SCALES, beam_covariance=covariance, kernel=kernel)
    assert (np.abs(measured / expected - 1) < [0.02, 0.02, 0.04, 0.08]).all()


def test_propagated_noise_between_whole_scales():
    sigma = propagated_noise(1.0, [1, 1.5, 2, 2.5, 3])
    assert (sigma > 0).all()
    white = np.random.default_rng(1).normal(size=(256, 256))
    measured = wavelet_planes(white, [1.5, 2.5]).std(axis=(1, 2))
    np.testing.assert_allclose(measured, sigma[[1, 3]], rtol=0.05)


def ratios(images, *, mask=None):
    """Measured over true noise of beam-correlated noise, (image, scale)."""
    expected = propagated_noise(RMS, SCALES, beam_covariance=COVARIANCE)
    return np.array(
        [
            [
                plane_noise(plane, scale, mask=mask)
                for plane, scale in zip(
                    wavelet_planes(image, SCALES, mask=mask), SCALES, strict=True
                )
            ]
            / expected
            for image in images
        ]
    )


def test_plane_noise_without_source():
    ratio = ratios([beam_noise(seed) for seed in range(12)])
    np.testing.assert_allclose(ratio.mean(axis=0), 1, atol=0.06)
    np.testing.assert_allclose(ratio, 1, atol=0.2)


@pytest.fixture(scope="module")
def jets():
    """Jets whose peak is about 2000 times their noise."""
    return np.concatenate(
        [simulate_two_fluid(rng=seed, n_epochs=2).cube.data for seed in range(10)]
    )


@pytest.mark.slow
def test_plane_noise_beside_a_bright_jet(jets):
    """
    The noise of a plane whose median coefficient is the jet's.

    On scale 4 the wavelets of the jet leave a tenth of 256 x 128 px, some
    ten independent patches of noise.
    """
    ratio = ratios(jets)
    assert (np.abs(ratio.mean(axis=0) - 1) < [0.06, 0.06, 0.08, 0.12]).all()
    assert (ratio.std(axis=0) < [0.08, 0.08, 0.08, 0.3]).all()


def test_plane_noise_where_the_source_fills_most_of_the_image():
    """More than half of the pixels are source: the median alone would be it."""
    rng = np.random.default_rng(2)
    plane = rng.normal(size=(128, 128))
    plane[:, :80] += 1e4 * rng.normal(size=(128, 80))
    assert 1.4826 * np.median(np.abs(plane)) > 1000
    assert plane_noise(plane, 1) == pytest.approx(1, abs=0.1)


def test_plane_noise_without_any_sky_is_that_of_all_pixels():
    """Every pixel is within a scale of some source."""
    plane = np.random.default_rng(0).normal(size=(64, 64))
    plane[::8, ::8] = 1e3
    assert plane_noise(plane, 4) == pytest.approx(
        1.4826 * np.median(np.abs(plane)), rel=1e-4
    )


def test_blanked_pixels_do_not_count():
    """CLEAN maps are exactly zero outside the field: their MAD is 0."""
    plane = np.zeros((128, 128))
    plane[:60, :60] = np.random.default_rng(0).normal(size=(60, 60))
    assert np.median(np.abs(plane)) == 0
    assert plane_noise(plane, 1) == pytest.approx(1, abs=0.05)
    assert plane_noise(np.zeros((32, 32)), 1) == 0
    assert (local_noise(np.zeros((32, 32)), 1) == 0).all()


def test_masked_pixels_do_not_count():
    image = beam_noise(3)
    mask = np.zeros(image.shape, dtype=bool)
    mask[20:60, 30:200] = True
    # The transform is undisturbed by what the mask covers.
    np.testing.assert_array_equal(
        ratios([np.where(mask, 1e9, image)], mask=mask), ratios([image], mask=mask)
    )
    np.testing.assert_allclose(ratios([image], mask=mask), 1, atol=0.25)
    plane = np.random.default_rng(0).normal(size=(64, 64))
    plane[:, 32:] *= 1000
    mask = np.zeros(plane.shape, dtype=bool)
    mask[:, 32:] = True
    assert plane_noise(plane, 1, mask=mask) == pytest.approx(1, abs=0.1)
    assert plane_noise(plane, 1, mask=np.ones(plane.shape, bool)) == 0


@pytest.mark.parametrize(("scale", "tolerance"), [(1, 0.15), (2, 0.15), (3, 0.25)])
@pytest.mark.parametrize("beam", [None, BEAM], ids=["white", "beam"])
def test_local_noise_follows_a_gradient(scale, tolerance, beam):
    gradient = np.linspace(1, 4, 256)
    shape = (256, 256)
    covariance = None if beam is None else COVARIANCE
    (true,) = propagated_noise(1.0, [scale], beam_covariance=covariance)
    found = []
    for seed in range(3):
        image = np.random.default_rng(seed).standard_normal(shape)
        if beam is not None:
            image = beam_noise(seed, shape, rms=1.0)
        (plane,) = wavelet_planes(image * gradient, [scale])
        found.append(local_noise(plane, scale))
    ratio = (np.mean(found, axis=0) / (true * gradient)).mean(axis=0)
    quarters = ratio.reshape(4, -1).mean(axis=1)
    np.testing.assert_allclose(quarters, 1, atol=tolerance)


def test_local_noise_of_scattered_pixels_is_constant():
    """Boxes with hardly a pixel tell nothing of a place."""
    rng = np.random.default_rng(0)
    plane, mask = rng.normal(size=(128, 128)), rng.random((128, 128)) < 0.95
    noise = local_noise(plane, 1, mask=mask)
    assert np.ptp(noise) == 0
    assert noise[0, 0] == plane_noise(plane, 1, mask=mask)
    assert noise[0, 0] == pytest.approx(1, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["plane", "local", "propagated"])
def test_false_positives_are_rare(noise):
    """Above 4 sigma, about one pattern in two images of pure noise."""
    decompose = Decomposer(noise=noise)
    images = [beam_noise(seed) for seed in range(5)]
    counts = [
        len(decompose(image, rms=RMS, beam_covariance=COVARIANCE).ssps)
        for image in images
    ]
    assert np.mean(counts) < 1.5
    brighter = Decomposer(noise=noise, detection=6, segmentation=5)
    assert (
        sum(
            len(brighter(image, rms=RMS, beam_covariance=COVARIANCE).ssps)
            for image in images
        )
        == 0
    )
