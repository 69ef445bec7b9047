# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Convolution to a common beam."""

from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.wcs import WCS
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from astro_scc.epochs import Beam, EpochCube
from astro_scc.images.beam import (
    common_beam,
    gaussian_smooth,
    is_per,
    smallest_common_beam,
)

DATES = ["2000-01-01", "2001-01-01", "2002-01-01"]
PIXEL = 0.1 * u.mas


def beam(major, minor, pa=0.0):
    return Beam(major * u.mas, minor * u.mas, pa * u.deg)


def sky_grid(turn=0.0, shape=(96, 80)):
    """A WCS of 0.1 mas pixels whose axes are turned against the sky."""
    angle = np.radians(turn)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---SIN", "DEC--SIN"]
    wcs.wcs.cdelt = [-PIXEL.to_value(u.deg), PIXEL.to_value(u.deg)]
    wcs.wcs.crpix = [shape[1] / 2, shape[0] / 2]
    wcs.wcs.crval = [187.0, 12.0]
    wcs.wcs.pc = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return wcs


def source(cube, covariance, east, north):
    """A Gaussian of peak 1 on the grid of a cube, from sky covariances."""
    e, n = (v.to_value(u.mas) for v in cube.offsets())
    offset = np.stack([e - east, n - north])
    return np.exp(
        -0.5 * np.einsum("iyx,ij,jyx->yx", offset, np.linalg.inv(covariance), offset)
    )


def point_sources(beams, unit=u.Jy / u.beam, turn=0.0, shape=(96, 80)):
    """Images of one point source of 1 Jy by several beams."""
    empty = EpochCube(
        np.zeros((len(beams), *shape)), DATES[: len(beams)], sky_grid(turn, shape)
    )
    data = [source(empty, b.covariance.to_value(u.mas**2), 0.33, -0.21) for b in beams]
    return EpochCube(data, empty.times, empty.wcs, unit=unit, beams=beams)


@pytest.mark.parametrize("turn", [0, 35])
def test_point_sources_come_out_as_the_common_beam(turn):
    beams = [beam(1.0, 0.6, -20), beam(0.9, 0.7, 40), beam(0.8, 0.55, 80)]
    cube = point_sources(beams, turn=turn)
    result = common_beam(cube)
    expected = source(cube, result.beams[0].covariance.to_value(u.mas**2), 0.33, -0.21)
    for image in result.data:
        assert_allclose(image, expected, atol=5e-6)
    assert result.unit == cube.unit
    assert result.noise is None
    assert "3 of 3 epochs" in result.meta["history"][-1]


def test_flux_density_is_conserved():
    cube = point_sources([beam(1.0, 0.6, -20), beam(0.7, 0.7)])
    result = common_beam(cube, beam(1.5, 1.2, 10))
    for images, beams in ((cube.data, cube.beams), (result.data, result.beams)):
        pixels = [float(b.area / PIXEL**2) for b in beams]
        assert_allclose(images.sum(axis=(1, 2)) / pixels, 1, rtol=1e-6)


def test_intensities_per_pixel_are_only_smoothed():
    cube = point_sources([beam(0.8, 0.8), beam(0.6, 0.6)], unit=u.Jy / u.pix)
    result = common_beam(cube)
    assert_allclose(result.data.sum(axis=(1, 2)), cube.data.sum(axis=(1, 2)), rtol=1e-9)
    assert result.data[1].max() < 0.6


def test_kernels_narrower_than_a_pixel():
    """The beam grows by 0.05 px only, and exactly by that."""
    narrow, wide = beam(0.8, 0.8), beam(0.8006, 0.8006)
    cube = point_sources([narrow])
    result = common_beam(cube, wide)
    expected = source(cube, wide.covariance.to_value(u.mas**2), 0.33, -0.21)
    assert_allclose(result.data[0], expected, atol=5e-6)
    assert np.abs(result.data[0] - cube.data[0]).max() > 5e-4


def test_epochs_with_the_beam_stay_as_they_are():
    cube = point_sources([beam(1.0, 1.0), beam(0.7, 0.5)])
    rng = np.random.default_rng(3)
    cube = EpochCube(
        cube.data + rng.normal(size=cube.shape),
        cube.times,
        cube.wcs,
        unit=cube.unit,
        beams=cube.beams,
        noise=[1, 1] * cube.unit,
    )
    result = common_beam(cube)
    assert result.beams[0] == cube.beams[0]
    assert_array_equal(result.data[0], cube.data[0])
    assert np.any(result.data[1] != cube.data[1])
    assert result.noise is None

    again = common_beam(result.with_step("noise", noise=[2, 3] * cube.unit))
    assert_array_equal(again.data, result.data)
    assert_array_equal(again.noise.value, [2, 3])
    assert "0 of 2" in again.meta["history"][-1]


def test_single_precision_headers_count_as_the_same_beam():
    value = float(np.float32(0.83))
    cube = point_sources([beam(value, 0.6, 12)])
    assert_array_equal(common_beam(cube, beam(0.83, 0.6, 12)).data, cube.data)


def test_bad_pixels_and_edges_do_not_darken():
    data = np.full((1, 40, 50), 7.0)
    data[0, 10:14, 20] = np.nan
    mask = np.zeros(data.shape, dtype=bool)
    mask[0, 30, 5:9] = True
    data[mask] = 1e9
    cube = EpochCube.from_arrays(
        data,
        DATES[:1],
        pixel_scale=PIXEL,
        mask=mask,
        beams=beam(0.2, 0.2),
        unit=u.Jy / u.pix,
    )
    result = common_beam(cube, beam(1.0, 0.7))
    assert_array_equal(result.mask, cube.mask)
    assert_array_equal(np.isnan(result.data), cube.mask)
    assert_allclose(result.data[~result.mask], 7, rtol=1e-9)


def test_a_beam_of_another_package_is_accepted():
    theirs = SimpleNamespace(major=1.2 * u.mas, minor=900 * u.uas, pa=10 * u.deg)
    result = common_beam(point_sources([beam(0.8, 0.8)]), theirs)
    assert result.beams[0] == beam(1.2, 0.9, 10)


def test_what_is_no_common_beam_is_refused():
    cube = point_sources([beam(0.5, 0.5), beam(1.0, 0.6)])
    with pytest.raises(ValueError, match=r"2001-01-01: its beam 1 x 0.6 mas at .* fit"):
        common_beam(cube, beam(0.9, 0.9))
    with pytest.raises(TypeError, match="beam"):
        common_beam(cube, 3.0)
    with pytest.raises(ValueError, match="no beams"):
        common_beam(EpochCube(cube.data, cube.times, cube.wcs))
    with pytest.raises(ValueError, match="at least one beam"):
        smallest_common_beam([])


def test_a_kernel_in_one_direction_only():
    image = np.zeros((31, 31))
    image[15, 15] = 1
    smooth = gaussian_smooth(image, [[4, 0], [0, 0]])
    assert_allclose(smooth[15].sum(), 1, atol=1e-6)
    assert_allclose(np.delete(smooth, 15, axis=0), 0, atol=1e-12)


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        (u.Jy / u.beam, True),
        (u.mJy / u.beam, True),
        (u.Unit("JY/BEAM", parse_strict="silent"), True),
        (u.Unit("Jy Beam-1", parse_strict="silent"), True),
        (u.Jy / u.pix, False),
        (u.Jy, False),
        (u.dimensionless_unscaled, False),
        (u.Unit("COUNTS/S", parse_strict="silent"), False),
    ],
)
def test_units_per_beam(unit, expected):
    assert is_per(unit, "beam") is expected


def contains(large, small, tolerance=1e-9):
    difference = (large.covariance - small.covariance).value
    return np.linalg.eigvalsh(difference)[0] >= -tolerance * large.major.value**2


BEAMS = st.lists(
    st.builds(
        lambda major, ratio, pa: beam(major, major * ratio, pa),
        st.floats(0.3, 3),
        st.floats(0.2, 1),
        st.floats(-90, 90),
    ),
    min_size=1,
    max_size=6,
)


def least_area(beams):
    """Major times minor axis of the least ellipse, by a grid that closes in."""
    others = np.array([b.covariance.value for b in beams]) * 8 * np.log(2)
    steps = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 2), axis=-1).reshape(-1, 2)
    centre, width, least = np.zeros(2), 3.0, np.inf
    for _ in range(40):
        # Ellipses of area 1: logarithm of the axis ratio along two directions.
        points = centre + width * steps
        r = np.hypot(*points.T)
        a, b = (points * (np.sinh(r) / np.maximum(r, 1e-12))[:, None]).T
        inverse = np.moveaxis(
            np.array([[np.cosh(r) - a, -b], [-b, np.cosh(r) + a]]), -1, 0
        )
        largest = np.linalg.eigvals(inverse[:, None] @ others).real.max(axis=(1, 2))
        centre, width = points[np.argmin(largest)], 0.75 * width
        least = min(least, largest.min())
    return least


@pytest.mark.slow
@settings(max_examples=20)
@given(BEAMS)
@example([beam(1.0, 1.0, 0.0), beam(2.0, 0.4375, 45.0)])
def test_the_smallest_common_beam_contains_all(beams):
    result = smallest_common_beam(beams)
    assert all(contains(result, b, 2e-6) for b in beams)
    area = float(result.major * result.minor / u.mas**2)
    assert area <= least_area(beams) * (1 + 1e-5)


@pytest.mark.parametrize("scale", [2e-5, 1.0, 3.6e6])
def test_common_beams_of_any_size(scale):
    """Micro-arcseconds for the EHT, degrees for single dishes."""
    beams = [beam(scale, 0.5 * scale, pa) for pa in (-20, 20)]
    result = smallest_common_beam(beams)
    assert all(contains(result, b) for b in beams)
    assert 1.0 < result.major.value / scale < 1.2
    assert abs(result.pa.value) < 0.1


@pytest.mark.parametrize("spread", [1e-7, 1e-5, 1e-3])
def test_common_beams_of_nearly_equal_ones(spread):
    rng = np.random.default_rng(0)
    for _ in range(5):
        major, minor = (1 + spread * rng.uniform(-1, 1, (2, 12))) * [[0.9], [0.6]]
        beams = [beam(*b, 10) for b in zip(major, minor, strict=True)]
        result = smallest_common_beam(beams)
        assert all(contains(result, b, 2e-6) for b in beams)
        assert result.major.value < 0.9 * (1 + spread) * 1.003


def test_mojave_epochs(shared_data):
    """Every epoch keeps its flux density within the noise, and gets one beam."""
    cube = EpochCube.read(str(shared_data / "0003+380" / "*.fits"))
    result = common_beam(cube)
    assert all(contains(result.beams[0], b) for b in cube.beams)
    pixels = float(result.pixel_scale.value**2)
    middle = (slice(None), slice(64, 192), slice(64, 192))
    for c in (cube, result):
        areas = np.array([b.area.value for b in c.beams])
        flux = c.data[middle].sum(axis=(1, 2)) * pixels / areas
        if c is cube:
            before = flux
    assert_allclose(flux, before, rtol=5e-3)
