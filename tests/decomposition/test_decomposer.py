# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Patterns of planes and of images, and what is refused."""

import csv

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.decomposition.segmentation import find_ssps, quadratic_peak
from astro_scc.decomposition.wavelet import propagated_noise

NY, NX = 48, 64


def gaussians(positions, sigma=3.0, heights=None, shape=(NY, NX)):
    y, x = np.mgrid[: shape[0], : shape[1]]
    heights = [1.0] * len(positions) if heights is None else heights
    return sum(
        height * np.exp(-((x - px) ** 2 + (y - py) ** 2) / (2 * sigma**2))
        for height, (py, px) in zip(heights, positions, strict=True)
    )


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


@pytest.mark.parametrize(
    ("settings_", "image", "message"),
    [
        ({"scales": ()}, {}, "at least one wavelet scale"),
        ({"scales": (4,)}, {}, r"small for wavelet scale 4 \(16 px\): leave out the"),
        ({"scales": (1.5,), "kernel": "b3"}, {}, "kernel 'b1' only"),
        ({"kernel": "db2"}, {}, "unknown wavelet kernel"),
        ({"noise": "mad"}, {}, "must be one of plane, local, propagated"),
        *(({"scales": (j,)}, {}, "not a number of the") for j in (-0.5, 1.3, np.nan)),
        ({"segmentation": 0}, {}, "0 < segmentation <= detection"),
        ({"noise_factors": (0.5, 0.5)}, {}, "noise_factors must be 1 from 0 to 1"),
        ({}, {"image": np.full((16, 16), np.nan)}, "no valid pixel"),
        ({}, {"mask": np.zeros((4, 4), bool)}, r"mask has shape \(4, 4\)"),
        ({}, {"image": np.zeros((2, 16, 16))}, "two dimensions, this has 3"),
        ({"noise": "propagated"}, {"rms": np.nan}, "needs the rms of the image"),
    ],
)
def test_what_is_refused(settings_, image, message):
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
    st.floats(-1, 1), st.floats(0.05, 1), st.floats(0.05, 1), st.floats(-0.9, 0.9),
    st.floats(-0.49, 0.49), st.floats(-0.49, 0.49), st.sampled_from([1e-9, 1.0, 1e9]),
)  # fmt: skip
def test_quadratic_peak_is_exact_for_quadratics(level, a, b, skew, y0, x0, scale):
    y, x = np.mgrid[-1:2, -1:2]
    dy, dx, cross = y - y0, x - x0, skew * np.sqrt(a * b)
    values = scale * (level - a * dx**2 - b * dy**2 - 2 * cross * dx * dy)
    found_y, found_x, height = quadratic_peak(values)
    assert (found_y, found_x) == pytest.approx((y0, x0), abs=1e-9)
    assert height == pytest.approx(max(scale * level, values[1, 1]), abs=1e-9 * scale)


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


def test_catalogues_are_joined():
    first = find_ssps(gaussians([(12, 16), (32, 46)]), 1, 0.01)
    second = find_ssps(gaussians([(20, 20)]), 2, 0.01)
    joined = SSPs.concatenate([first, SSPs.empty(), second])
    assert repr(joined) == "<SSPs: 2 on scale 1, 1 on scale 2>"
    np.testing.assert_array_equal(joined.pixels_of(1), first.pixels_of(1))
    np.testing.assert_array_equal(joined.pixels_of(2), second.pixels_of(0))
    np.testing.assert_array_equal(joined.x, [*first.x, *second.x])
    for none in (SSPs.empty(), SSPs.of_epochs([])):
        assert (len(none), none.n_pixels.shape, repr(none)) == (0, (0,), "<SSPs: none>")


def test_the_noise_of_the_image_is_propagated():
    how = {"beam_covariance": np.array([[9, 1], [1, 4]])}
    image = gaussians([(24, 30)])
    found = Decomposer((1, 2), noise="propagated")(image, rms=0.01, **how)
    np.testing.assert_allclose(found.noise, propagated_noise(0.01, (1, 2), **how))
    assert len(found.ssps) == 2
