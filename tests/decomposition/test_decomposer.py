# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Wavelet planes and their noise, patterns of planes, and what is refused."""

import csv

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import ndimage

from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.decomposition.segmentation import find_ssps, gaussian_peak
from astro_scc.decomposition.wavelet import (
    KERNELS,
    atrous_transform,
    local_noise,
    measure_noise,
    median,
    plane_noise,
    propagated_noise,
    shared_variance,
    wavelet_planes,
)
from astro_scc.epochs import Beam
from astro_scc.epochs.restoring import correlated_noise
from astro_scc.simulation import simulate_two_fluid

NY, NX = 48, 64


def gaussians(positions, sigma=3.0, heights=None, shape=(NY, NX)):
    y, x = np.mgrid[: shape[0], : shape[1]]
    heights = [1.0] * len(positions) if heights is None else heights
    r2 = [(x - px) ** 2 + (y - py) ** 2 for py, px in positions]
    pairs = zip(heights, r2, strict=True)
    return sum(height * np.exp(-square / (2 * sigma**2)) for height, square in pairs)


def labels_of(ssps, shape=(NY, NX)):
    labels = np.zeros(shape, dtype=int)
    for index in range(len(ssps)):
        assert (labels.flat[ssps.pixels_of(index)] == 0).all()
        labels.flat[ssps.pixels_of(index)] = index + 1
    return labels


@pytest.mark.parametrize("value", [0.0, -2.5e9])
@pytest.mark.parametrize("noise", ["plane", "local"])
def test_nothing_in_a_constant_image(value, noise):
    image = np.full((64, 64), value)
    decompose = Decomposer(noise=noise)
    assert len(decompose(image).ssps) == 0
    holes = np.random.default_rng(0).random(image.shape) < 0.3
    assert len(decompose(np.where(holes, np.nan, image)).ssps) == 0


def test_what_is_refused():
    for settings_, image, message in [
        ({"scales": ()}, {}, "at least one wavelet scale"),
        ({"scales": (4,)}, {}, r"small for wavelet scale 4 \(16 px\): leave out the"),
        ({"scales": (1.5,), "kernel": "b3"}, {}, "kernel 'b1' only"),
        ({"kernel": "db2"}, {}, "unknown wavelet kernel"),
        *(({"scales": (j,)}, {}, "not a number of the") for j in (-0.5, 1.3, np.nan)),
        ({"segmentation": 0}, {}, "0 < segmentation <= detection"),
        ({"noise_factors": (0.5, 0.5)}, {}, "noise_factors must be 1 from 0 to 1"),
        ({}, {"image": np.full((16, 16), np.nan)}, "no valid pixel"),
        ({}, {"mask": np.zeros((4, 4), bool)}, r"mask has shape \(4, 4\)"),
        ({}, {"image": np.zeros((2, 16, 16))}, "two dimensions, this has 3"),
        ({"noise": "propagated"}, {"rms": np.nan}, "needs the rms of the image"),
    ]:
        image = {"image": np.zeros((16, 16)), **image}
        with pytest.raises(ValueError, match=message):
            Decomposer(**{"scales": (1,), **settings_})(**image)


SLOW = (pytest.param(k, marks=pytest.mark.slow) for k in ("two_fluid_dense", "random"))


@pytest.mark.parametrize("name", ["two_fluid", *SLOW])
def test_as_many_patterns_as_the_authors_program(shared_data, name):
    folder = shared_data / "paper_test" / name
    with (folder / "wise_ssps.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["in_roi"] == "1"]
    theirs = [sum(row["scale_px"] == str(2**j) for row in rows) for j in (1, 2, 3)]
    decompose = Decomposer(scales=(1, 2, 3))
    files = sorted(folder.glob("*.fits"))
    ssps = SSPs.of_epochs([decompose(fits.getdata(file).squeeze()) for file in files])
    region = (ssps.x >= 60) & (ssps.x <= 160)
    ours = [np.sum(region & (ssps.scale == j)) for j in (1, 2, 3)]
    np.testing.assert_allclose(ours, theirs, rtol=0.15)


@settings(max_examples=40)
@given(
    st.floats(0.05, 0.3), st.floats(0.05, 0.3), st.floats(-0.9, 0.9),
    st.floats(-0.49, 0.49), st.floats(-0.49, 0.49), st.sampled_from([1e-9, 1.0, 1e9]),
)  # fmt: skip
def test_gaussian_peak_is_exact_for_gaussians(a, b, skew, y0, x0, scale):
    y, x = np.mgrid[-1:2, -1:2]
    dy, dx, cross = y - y0, x - x0, skew * np.sqrt(a * b)
    values = scale * np.exp(-a * dx**2 - b * dy**2 - 2 * cross * dx * dy)
    assume(values.min() >= 0.1 * values[1, 1])
    found_y, found_x, height = gaussian_peak(values)
    assert (found_y, found_x) == pytest.approx((y0, x0), abs=1e-9)
    assert height == pytest.approx(max(scale, values[1, 1]), rel=1e-9)


@settings(max_examples=30)
@given(
    st.floats(12, NY - 13), st.floats(12, NX - 13), st.floats(1.5, 4),
    st.sampled_from([1e-9, 1.0, 1e9]),
)  # fmt: skip
def test_catalogue_of_one_pattern(py, px, sigma, scale):
    plane = scale * gaussians([(py, px)], sigma)
    ssps = find_ssps(plane, 1.5, 0.01 * scale)
    assert (len(ssps), ssps.scale[0], ssps.epoch[0]) == (1, 1.5, 0)
    assert (ssps.y[0], ssps.x[0]) == pytest.approx((py, px), abs=0.06)
    centroid = ssps.y_centroid[0], ssps.x_centroid[0]
    assert centroid == pytest.approx((py, px), abs=0.05)
    assert ssps.peak[0] == plane.max()
    assert ssps.snr[0] == pytest.approx(plane.max() / (0.01 * scale))
    inside = plane > 0.03 * scale
    y, x = np.nonzero(inside)
    assert ssps.flux[0] == pytest.approx(plane[inside].sum())
    assert ssps.bbox[0].tolist() == [y.min(), x.min(), y.max() + 1, x.max() + 1]
    np.testing.assert_array_equal(ssps.pixels_of(0), np.flatnonzero(inside))


def test_near_patterns_are_separated_unless_within_a_scale():
    plane = gaussians([(24, 25), (24, 36)], heights=[1.0, 0.7])
    ssps = find_ssps(plane, 1, 0.01)
    np.testing.assert_allclose(ssps.x, [25, 36], atol=0.6)
    np.testing.assert_allclose(ssps.y, 24, atol=0.05)
    labels = labels_of(ssps)
    np.testing.assert_array_equal(labels > 0, plane > 0.03)
    # The border runs through the saddle between them.
    saddle = 25 + np.argmin(plane[24, 25:37])
    assert labels[24, [saddle - 2, saddle + 2]].tolist() == [1, 2]
    plane = gaussians([(24, 25), (24, 33)], sigma=2.5)
    assert len(find_ssps(plane, 2, 0.01)) == 2
    assert len(find_ssps(plane, 4, 0.01)) == 1


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(0, 0.2), st.sampled_from([1, 1.5, 2]))
def test_segments_are_what_is_connected_to_the_seeds(seed, share, scale):
    """Together exactly the significant pixels joined to a maximum by an edge."""
    rng = np.random.default_rng(seed)
    plane = ndimage.gaussian_filter(rng.normal(size=(NY, NX)), rng.uniform(1, 3))
    plane /= plane.std()
    mask = rng.random(plane.shape) < share
    noise = rng.uniform(0.3, 0.6)
    ssps = find_ssps(plane, scale, noise, mask=mask)
    labels = labels_of(ssps)
    islands, _ = ndimage.label((plane > 3 * noise) & ~mask)
    seeded = np.unique(islands[labels > 0])
    np.testing.assert_array_equal(labels > 0, np.isin(islands, seeded[seeded > 0]))
    for index in range(len(ssps)):
        own = labels == index + 1
        assert ndimage.label(own)[1] == 1
        assert plane[own].max() >= 4 * noise
        assert ssps.snr[index] >= 4
    # No catalogued maximum within a scale of another.
    apart = [np.abs(np.subtract.outer(v, v)) for v in (ssps.y, ssps.x)]
    apart = np.max(apart, axis=0)[~np.eye(len(ssps), dtype=bool)]
    assert apart.min(initial=np.inf) > round(2**scale) - 1


def test_thresholds_in_sigma_of_the_place():
    plane = gaussians([(12, 16), (32, 46)], heights=[1.0, 0.45])
    for detection, number in ((4, 2), (5, 1), (10.1, 0)):
        assert len(find_ssps(plane, 1, 0.1, detection=detection)) == number
    for s in (1, 2, 4):
        ssps = find_ssps(plane, 1, 0.1, segmentation=s)
        assert ssps.n_pixels.sum() == (plane > s * 0.1).sum()
    # The same pattern is significant where the noise is low.
    plane = gaussians([(24, 16), (24, 48)])
    noise = np.full(plane.shape, 0.01)
    noise[:, 32:] = 0.5
    np.testing.assert_allclose(find_ssps(plane, 1, noise).x, [16], atol=0.01)
    noise[:, 32:] = 0.1
    np.testing.assert_allclose(np.sort(find_ssps(plane, 1, noise).snr), [10, 100])


def test_pattern_over_a_hole_is_kept():
    """A bad pixel at its very maximum costs a pattern one pixel."""
    plane = gaussians([(24.1, 30.2)])
    mask = np.zeros(plane.shape, dtype=bool)
    mask[24, 30] = True
    ssps = find_ssps(np.where(mask, np.nan, plane), 1, 0.01, mask=mask)
    assert (len(ssps), ssps.y[0], ssps.x[0]) == (1, 24, 31)
    assert ssps.x_centroid[0] == pytest.approx(30.2, abs=0.02)
    np.testing.assert_array_equal(labels_of(ssps) == 1, (plane > 0.03) & ~mask)


def test_no_maximum_at_the_edge_of_what_exists():
    """It may well be higher beyond the image, or beyond its valid part."""
    plane = gaussians([(24, 1.6), (24, 40)])
    np.testing.assert_allclose(find_ssps(plane[:, 2:], 1, 0.01).x, [38], atol=0.01)
    mask = np.zeros(plane.shape, dtype=bool)
    mask[:, :2] = mask[:3] = True
    ssps = find_ssps(np.where(mask, 0, plane), 1, 0.01, mask=mask)
    np.testing.assert_allclose(ssps.x, [40], atol=0.01)


def test_the_noise_of_the_image_is_propagated():
    how = {"beam_covariance": np.array([[9, 1], [1, 4]])}
    image = gaussians([(24, 30)])
    decompose = Decomposer((1, 2), noise="propagated")
    beyond = np.indices((NY, NX))[1] > 28
    found, rest = (decompose(image, mask=m, rms=0.01, **how) for m in (None, beyond))
    np.testing.assert_allclose(found.noise, propagated_noise(0.01, (1, 2), **how))
    assert len(rest.ssps) == 0
    assert SSPs.of_epochs([found, found]).epoch.tolist() == [0, 0, 1, 1]


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
            pairs = zip((y, x), (j, i), image.shape, strict=True)
            at = [mirrored(a + (k - half) * step, n) for a, k, n in pairs]
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


SCALES = (1, 2, 3, 4)
RMS = 0.002
BEAM = Beam(1 * u.mas, 1 * u.mas)  # full width of 10 pixels of 0.1 mas
LONG = Beam(1.2 * u.mas, 0.5 * u.mas, 30 * u.deg)
COVARIANCE = np.eye(2) * (10 / np.sqrt(8 * np.log(2))) ** 2


def beam_noise(seed, beam=BEAM):
    how = {"rms": 1.0, "beam": beam, "pixel_scale": 0.1 * u.mas, "rng": seed}
    return correlated_noise((256, 256), **how)


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
    plane = np.pad(rng.normal(size=(60, 60)), (0, 68))
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
    # Boxes with hardly a pixel tell nothing of a place.
    plane, mask = white.normal(size=(128, 128)), white.random((128, 128)) < 0.95
    noise = local_noise(plane, 1, mask=mask)
    assert np.ptp(noise) == 0
    assert noise[0, 0] == plane_noise(plane, 1, mask=mask)
    assert noise[0, 0] == pytest.approx(1, abs=0.2)


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


@pytest.mark.parametrize("n", [1, 2, 31, 64, 1000, 5001])
def test_median_is_that_of_numpy(n):
    values = np.random.default_rng(n).normal(size=n)
    # A sample of the last ones says nothing of the others.
    unlike = np.where(np.arange(n) % 32 == 0, 1e3, values)
    for each in (values, values.round(1), np.zeros(n), np.sort(values), unlike):
        assert median(each) == np.median(each)
