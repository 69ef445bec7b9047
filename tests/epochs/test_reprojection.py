# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Resampling inside a grid and onto another one."""

import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS
from astropy.wcs.utils import pixel_to_pixel
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from astro_scc.epochs import Beam, EpochCube
from astro_scc.exceptions import EpochWarning
from astro_scc.images.grid import fill_masked, reproject_cube, shared_grid, shift_image

DATES = ["2000-01-01", "2001-01-01"]
MAS = u.mas.to(u.deg)


def grid(crpix, pixel=0.1, turn=0.0, crval=(187.0, 12.0)):
    angle = np.radians(turn)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---SIN", "DEC--SIN"]
    wcs.wcs.cdelt = [-pixel * MAS, pixel * MAS]
    wcs.wcs.crpix = crpix
    wcs.wcs.crval = crval
    wcs.wcs.pc = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return wcs


def spots(wcs, shape, positions=((0.3, -0.2), (-0.8, 0.9)), sigma=0.45):
    """Round Gaussians at offsets in mas, an image for each."""
    probe = EpochCube(np.zeros((1, *shape)), DATES[:1], wcs)
    e, n = (v.to_value(u.mas) for v in probe.offsets())
    return np.array(
        [np.exp(-((e - a) ** 2 + (n - b) ** 2) / (2 * sigma**2)) for a, b in positions]
    )


def cube_of(wcs, shape, **fields):
    return EpochCube(spots(wcs, shape), DATES, wcs, **fields)


# -- filling and shifting ---------------------------------------------------


def test_filling_continues_a_slope():
    ramp = np.add.outer(np.arange(20.0), 3 * np.arange(24.0))
    hole = np.zeros(ramp.shape, dtype=bool)
    hole[8:11, 12:15] = True
    filled = fill_masked(np.where(hole, np.nan, ramp), hole)
    assert_allclose(filled, ramp, atol=0.2)
    assert_array_equal(filled[~hole], ramp[~hole])


def test_filling_when_nothing_or_everything_is_bad():
    image = np.arange(6.0).reshape(2, 3)
    clean = np.zeros((2, 3), dtype=bool)
    filled = fill_masked(image, clean)
    assert_array_equal(filled, image)
    assert filled is not image
    assert_array_equal(fill_masked(np.full((2, 3), np.nan), ~clean), 0)


@given(st.integers(-9, 9), st.integers(-12, 12))
def test_whole_pixels_are_copied(dy, dx):
    rng = np.random.default_rng(1)
    image, mask = rng.normal(size=(7, 9)), rng.random((7, 9)) < 0.2
    moved, moved_mask = shift_image(image, mask, (dx, dy))
    expected, bad = np.full((7, 9), np.nan), np.ones((7, 9), dtype=bool)
    for y, x in np.ndindex(7, 9):
        if 0 <= y + dy < 7 and 0 <= x + dx < 9:
            bad[y + dy, x + dx] = mask[y, x]
            expected[y + dy, x + dx] = np.nan if mask[y, x] else image[y, x]
    assert_array_equal(moved, expected)
    assert_array_equal(moved_mask, bad)


def test_parts_of_a_pixel_move_a_source_exactly():
    y, x = np.mgrid[:50, :60]

    def spot(x0, y0):
        return np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * 3**2))

    clean = np.zeros((50, 60), dtype=bool)
    moved, mask = shift_image(spot(27.3, 24.6), clean, (2.45, -3.7))
    assert_allclose(moved[~mask], spot(29.75, 20.9)[~mask], atol=2e-4)
    # Three columns come from outside on the left, four rows at the top.
    assert mask[:, :3].all()
    assert mask[-4:].all()
    assert not mask[:-4, 3:].any()


def test_bad_pixels_stay_bad_and_do_not_spread():
    y, x = np.mgrid[:40, :40]
    image = np.exp(-((x - 20) ** 2 + (y - 20) ** 2) / 50)
    mask = np.zeros((40, 40), dtype=bool)
    mask[18:20, 24] = True
    moved, moved_mask = shift_image(np.where(mask, 1e6, image), mask, (0.5, 0.25))
    truth = np.exp(-((x - 20.5) ** 2 + (y - 20.25) ** 2) / 50)
    inside = (slice(2, -2), slice(2, -2))
    assert moved_mask[inside].sum() == 6
    assert moved_mask[18:21, 24:26].all()
    assert_allclose(moved[~moved_mask], truth[~moved_mask], atol=2e-3)


# -- onto another grid --------------------------------------------------------


@pytest.mark.parametrize("order", ["bilinear", "biquadratic", "bicubic"])
def test_onto_finer_and_turned_pixels(order):
    shape, new_shape = (64, 80), (110, 120)
    cube = cube_of(grid((40, 32)), shape, unit=u.Jy / u.beam)
    new = grid((60, 55), pixel=0.05, turn=30)
    result = reproject_cube(cube, new, new_shape, order=order)
    assert result.shape == (2, *new_shape)
    tolerance = {"bilinear": 2e-2, "biquadratic": 2e-3, "bicubic": 5e-4}[order]
    good = ~result.mask
    assert_allclose(result.data[good], spots(new, new_shape)[good], atol=tolerance)
    # The corners lie outside the old grid, on which north is up.
    east, north = result.offsets()
    outside = (np.abs(east) > 3.9 * u.mas) | (np.abs(north) > 3.1 * u.mas)
    assert not result.mask[:, ~outside].any()
    assert_array_equal(np.isnan(result.data), result.mask)
    assert result.wcs is not new
    assert_array_equal(result.wcs.wcs.crpix, [60, 55])
    assert f"0.05 mas ({order})" in result.meta["history"][-1]


@pytest.mark.parametrize("method", ["exact", "adaptive"])
def test_averages_over_larger_pixels(method):
    shape, new_shape = (64, 80), (32, 40)
    cube = cube_of(grid((40.5, 32.5)), shape, unit=u.Jy / u.beam)
    bad = np.zeros((2, *shape), dtype=bool)
    bad[0, 20, 30] = True
    cube = EpochCube(
        np.where(bad, np.nan, cube.data), DATES, cube.wcs, unit=u.ct / u.pix
    )
    new = grid((20.5, 16.5), pixel=0.2)
    result = reproject_cube(cube, new, new_shape, method=method)
    assert f"0.2 mas ({method})" in result.meta["history"][-1]
    assert result.mask[0, 10, 15]
    assert np.sum(result.mask[0] & ~result.mask[1]) < (2 if method == "exact" else 20)
    # Sums of four pixels.
    sums = cube_of(grid((40.5, 32.5)), shape).data.reshape(2, 32, 2, 40, 2)
    good = ~result.mask
    tolerance = 1e-4 if method == "exact" else 0.3
    assert_allclose(result.data[good], sums.sum(axis=(2, 4))[good], atol=tolerance)


def test_white_noise_on_coarser_pixels():
    noise = np.random.default_rng(1).normal(size=(1, 128, 128))
    cube = EpochCube(noise, DATES[:1], grid((64.5, 64.5)))
    coarse = grid((16.5, 16.5), pixel=0.4), (32, 32)
    with pytest.warns(EpochWarning, match="pixels of 0.1 mas are interpolated at"):
        taken = reproject_cube(cube, *coarse)
    assert np.nanstd(taken.data) > 0.5
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.nanstd(reproject_cube(cube, *coarse, method="exact").data) < 0.28
        assert np.nanstd(reproject_cube(cube, *coarse, method="adaptive").data) < 0.28
        # A beam that is sampled is all there is.
        for fwhm in (0.8, 2.0):
            beams = Beam(fwhm * u.mas, fwhm * u.mas)
            reproject_cube(replace(cube, beams=beams), *coarse)
        reproject_cube(cube, grid((64.5, 64.5), turn=5), (128, 128))
    with pytest.warns(EpochWarning, match="use method='exact' or 'adaptive' to"):
        reproject_cube(replace(cube, beams=Beam(0.7 * u.mas, 0.6 * u.mas)), *coarse)


def test_grids_of_headers_cubes_and_coordinates():
    cube = cube_of(grid((40, 32)), (64, 80))
    new = grid((70.25, 50), pixel=0.05, turn=20)
    expected = reproject_cube(cube, new, (100, 140))
    header = new.to_header()
    header.update({"NAXIS": 2, "NAXIS1": 140, "NAXIS2": 100, "CTYPE2": "DEC---SIN"})
    shaped = new.deepcopy()
    shaped.array_shape = (100, 140)
    other = cube_of(new, (100, 140))
    for target in (header, shaped, other, other[0]):
        result = cube.reproject_to(target)
        assert_array_equal(result.mask, expected.mask)
        good = ~result.mask
        assert_allclose(result.data[good], expected.data[good], atol=1e-6)
    assert cube.reproject_to(header, (50, 60), "bilinear").shape == (2, 50, 60)


def test_beams_units_and_meta_are_kept_and_noise_is_not():
    beams = [Beam(1 * u.mas, 0.5 * u.mas), Beam(1 * u.mas, 0.7 * u.mas)]
    unit = u.mJy / u.beam
    cube = cube_of(
        grid((40, 32)),
        (64, 80),
        unit=unit,
        beams=beams,
        noise=[1, 2] * unit,
        labels=("a", "b"),
        epoch_meta=({"object": "x"}, {"object": "y"}),
        meta={"history": ["made"], "caution": 1},
    )
    result = reproject_cube(cube, grid((41.5, 32)), (64, 80))
    assert result.noise is None
    assert result.unit == unit
    assert result.beams == cube.beams
    assert result.labels == ("a", "b")
    assert result.epoch_meta[1] == {"object": "y"}
    assert result.meta["caution"] == 1
    assert len(result.meta["history"]) == 2


def test_one_bad_pixel_does_not_make_all_bad():
    cube = cube_of(grid((40, 32)), (64, 80))
    data = cube.data.copy()
    data[0, 30, 40] = np.nan
    cube = EpochCube(data, cube.times, cube.wcs)
    new = grid((40.4, 32.3))
    result = reproject_cube(cube, new, (64, 80))
    inside = (slice(2, -2), slice(2, -2))
    assert result.mask[0][inside].sum() == 4
    assert result.mask[0, 30, 40]
    assert not result.mask[1][inside].any()
    good = ~result.mask
    assert_allclose(result.data[good], spots(new, (64, 80))[good], atol=2e-3)


def test_whole_pixels_of_another_grid_are_copied():
    unit = u.Jy / u.beam
    cube = cube_of(grid((40, 32)), (64, 80), unit=unit, noise=[1, 2] * unit)
    result = reproject_cube(cube, grid((35, 40)), (70, 60))
    assert_array_equal(result.data[:, 8:70, :60], cube.data[:, :62, 5:65])
    assert result.mask[:, :8].all()
    assert not result.mask[:, 8:].any()
    assert_array_equal(result.noise.value, [1, 2])
    assert "copied" in result.meta["history"][-1]


def test_a_grid_beside_the_image_has_no_valid_pixel():
    cube = cube_of(grid((40, 32)), (64, 80))
    for crpix in ((400, 32), (-400, 32), (400.5, 32)):
        with pytest.raises(ValueError, match="no valid pixel"):
            reproject_cube(cube, grid(crpix), (64, 80))


@pytest.mark.parametrize("name", ["pix", "pixel"])
def test_intensities_per_pixel_follow_the_area(name):
    shape, new_shape = (64, 80), (128, 160)
    cube = cube_of(grid((40.5, 32.5)), shape, unit=u.ct / u.Unit(name))
    result = reproject_cube(cube, grid((80.5, 64.5), pixel=0.05), new_shape)
    total = result.data[~result.mask].sum()
    assert_allclose(total, cube.data.sum(), rtol=1e-3)


def test_absolute_coordinates_move_to_the_new_grid():
    shape = (64, 80)
    old = grid((40, 32))
    own = (grid((40, 32)), grid((40, 32), crval=(187.0 + 3 * MAS, 12.0 - 2 * MAS)))
    cube = cube_of(old, shape, epoch_wcs=own)
    new = grid((70, 50), pixel=0.05, turn=20)
    result = reproject_cube(cube, new, (100, 140))
    for before, after in zip(own, result.epoch_wcs, strict=True):
        pixel = np.array([31.0, 87.0])
        there = pixel_to_pixel(new, old, *pixel)
        sky, expected = after.pixel_to_world(*pixel), before.pixel_to_world(*there)
        assert sky.separation(expected) < 1e-3 * u.mas


def test_absolute_coordinates_that_are_turned_are_dropped():
    cube = cube_of(
        grid((40, 32)), (64, 80), epoch_wcs=(grid((40, 32)), grid((40, 32), turn=5))
    )
    assert reproject_cube(cube, grid((41, 32)), (64, 80)).epoch_wcs is None


def test_what_cannot_be_a_grid_is_refused():
    cube = cube_of(grid((40, 32)), (64, 80), beams=Beam(1 * u.mas, 1 * u.mas))
    with pytest.raises(ValueError, match="order = 'cubic' must be one of"):
        reproject_cube(cube, cube.wcs, (64, 80), order="cubic")
    for shape in ((64,), (64, 0), (2.5, 3)):
        with pytest.raises(ValueError, match="two positive integers"):
            reproject_cube(cube, cube.wcs, shape)
    with pytest.raises(ValueError, match="method = 'flux' must be one of interp, e"):
        reproject_cube(cube, cube.wcs, (64, 80), method="flux")
    with pytest.raises(ValueError, match="method='exact' has no order; leave it out"):
        reproject_cube(cube, cube.wcs, (64, 80), "bilinear", method="exact")
    with pytest.raises(ValueError, match=r"no shape of its own; give shape=\(ny, nx\)"):
        reproject_cube(cube, cube.wcs)
    with pytest.raises(ValueError, match="must have celestial axes"):
        reproject_cube(cube, WCS(naxis=2), (64, 80))
    with pytest.raises(TypeError, match="must be a WCS, or one sliced, got"):
        reproject_cube(cube, 3, (64, 80))
    with pytest.raises(ValueError, match="the header of the new grid: it has no"):
        reproject_cube(cube, fits.Header({"NAXIS1": 3, "NAXIS2": 3}))
    galactic = grid((40, 32))
    galactic.wcs.ctype = ["GLON-SIN", "GLAT-SIN"]
    with pytest.raises(ValueError, match="another celestial frame"):
        reproject_cube(cube, galactic, (64, 80))


# -- a grid for all ------------------------------------------------------------


def test_the_finest_pixels_and_the_widest_extent_are_shared():
    coarse, fine = grid((40, 32), pixel=0.2), grid((50, 60))
    wcs, shape = shared_grid([((64, 80), coarse), ((100, 100), fine)])
    assert_allclose(wcs.proj_plane_pixel_scales()[0].to_value(u.mas), 0.1)
    for size, own in (((64, 80), coarse), ((100, 100), fine)):
        x, y = pixel_to_pixel(
            own, wcs, np.array([0, size[1] - 1]), np.array([0, size[0] - 1])
        )
        assert np.min([x, y]) > -0.51
        assert np.max(x) < shape[1] - 0.49
        assert np.max(y) < shape[0] - 0.49
    # The finest grid keeps its pixels.
    step = np.array(pixel_to_pixel(fine, wcs, 3, 4))
    assert_allclose(step, np.rint(step), atol=1e-4)
    assert wcs.array_shape == shape


def test_one_grid_is_its_own_shared_grid():
    wcs, shape = shared_grid([((64, 80), grid((40, 32)))] * 2)
    assert shape == (64, 80)
    assert_array_equal(wcs.wcs.crpix, [40, 32])


def test_turned_grids_fit_in():
    wcs, shape = shared_grid(
        [((64, 80), grid((40, 32))), ((64, 80), grid((40, 32), turn=45))]
    )
    corners = np.array([[0, 79, 0, 79], [0, 0, 63, 63]])
    x, y = pixel_to_pixel(grid((40, 32), turn=45), wcs, *corners)
    assert min(x.min(), y.min()) >= -0.02
    assert x.max() <= shape[1] - 0.98
    assert y.max() <= shape[0] - 0.98


def test_grids_that_cannot_be_shared_are_refused():
    for far in ((187.1, 12.0), (7.0, -12.0)):
        with pytest.raises(ValueError, match="too far apart"):
            shared_grid(
                [((64, 80), grid((40, 32))), ((64, 80), grid((40, 32), crval=far))]
            )
