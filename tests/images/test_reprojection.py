# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Resampling inside a grid and onto another one."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs import WCS
from astropy.wcs.utils import pixel_to_pixel
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from astro_scc.epochs import Beam, EpochCube
from astro_scc.images.grid import reproject_cube, shared_grid, shift_image
from astro_scc.images.positions import offset_wcs

DATES = ["2000-01-01", "2001-01-01"]
SHAPE = (64, 80)
INNER = (slice(2, -2), slice(2, -2))


def grid(crpix=(40, 32), pixel=0.1, turn=0.0, crval=(187.0, 12.0), ctype="RA DEC"):
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    wcs = offset_wcs(pixel * u.mas, np.subtract(crpix, 1), SkyCoord(*crval, unit="deg"))
    wcs.wcs.ctype = [f"{name:-<5}SIN" for name in ctype.split()]
    wcs.wcs.pc = [[c, -s], [s, c]]
    return wcs


def spots(wcs, shape):
    """Round Gaussians at offsets in mas, an image for each."""
    probe = EpochCube(np.zeros((1, *shape)), DATES[:1], wcs)
    e, n = (v.to_value(u.mas) for v in probe.offsets())
    r2 = np.array([(e - 0.3) ** 2 + (n + 0.2) ** 2, (e + 0.8) ** 2 + (n - 0.9) ** 2])
    return np.exp(-r2 / (2 * 0.45**2))


def cube_of(wcs=None, shape=SHAPE, **fields):
    wcs = grid() if wcs is None else wcs
    return EpochCube(spots(wcs, shape), DATES, wcs, **fields)


@settings(max_examples=15)
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


def test_parts_of_a_pixel_move_a_source_and_its_bad_pixels():
    y, x = np.mgrid[:50, :60]

    def spot(x0, y0):
        return np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * 3**2))

    bad = np.zeros((50, 60), dtype=bool)
    moved, mask = shift_image(spot(27.3, 24.6), bad, (2.45, -3.7))
    assert_allclose(moved[~mask], spot(29.75, 20.9)[~mask], atol=2e-4)
    # Three columns come from outside on the left, four rows at the top.
    outside = (x < 3) | (y >= 46)
    assert_array_equal(mask, outside)
    bad[18:20, 24] = True
    moved, mask = shift_image(np.where(bad, 1e6, spot(20, 20)), bad, (0.5, 0.25))
    assert mask[INNER].sum() == mask[18:21, 24:26].sum() == 6
    assert_allclose(moved[~mask], spot(20.5, 20.25)[~mask], atol=5e-3)


def test_onto_finer_and_turned_pixels():
    new, new_shape = grid((60, 55), pixel=0.05, turn=30), (110, 120)
    result = reproject_cube(cube_of(unit=u.Jy / u.beam), new, new_shape)
    assert result.shape == (2, *new_shape)
    good = ~result.mask
    assert_allclose(result.data[good], spots(new, new_shape)[good], atol=5e-4)
    # The corners lie outside the old grid, on which north is up.
    east, north = result.offsets()
    outside = (np.abs(east) > 3.9 * u.mas) | (np.abs(north) > 3.1 * u.mas)
    assert not result.mask[:, ~outside].any()
    assert_array_equal(np.isnan(result.data), result.mask)
    assert "0.05 mas (interpolated)" in result.meta["history"][-1]


def test_averages_over_larger_pixels():
    data = spots(grid((40.5, 32.5)), SHAPE)
    sums = data.reshape(2, 32, 2, 40, 2).sum(axis=(2, 4))
    data[0, 20, 30] = np.nan
    cube = EpochCube(data, DATES, grid((40.5, 32.5)), unit=u.ct / u.pix)
    result = reproject_cube(cube, grid((20.5, 16.5), 0.2), (32, 40))
    assert "0.2 mas (averaged)" in result.meta["history"][-1]
    assert np.argwhere(result.mask).tolist() == [[0, 10, 15]]
    assert_allclose(result.data[~result.mask], sums[~result.mask], atol=1e-4)


def test_what_cannot_be_a_grid_is_refused():
    for target, options, words in [
        *((grid(), {"shape": shape}, "two positive integers")
          for shape in (64, "ab", (64,), (64, 0), (2.5, 3))),
        (fits.Header({"NAXIS1": 3, "NAXIS2": 3}), {}, "header of the new grid: it has"),
        (grid(), {"shape": None}, r"no shape of its own; give shape=\(ny, nx\)"),
        (WCS(naxis=2), {}, "must have celestial axes"),
        (3, {}, "must be a WCS, or one sliced, got"),
        (grid(ctype="GLON GLAT"), {}, "another celestial frame"),
        *((grid((x, 32)), {}, "no valid pixel") for x in (400, 400.5)),
    ]:  # fmt: skip
        cube = cube_of(beams=Beam(1 * u.mas, 1 * u.mas))
        with pytest.raises((ValueError, TypeError), match=words):
            reproject_cube(cube, target, **{"shape": SHAPE, **options})


def test_the_finest_pixels_and_the_widest_extent_are_shared():
    for grids in [
        [(SHAPE, grid(pixel=0.2)), ((100, 100), grid((50, 60)))],
        [(SHAPE, grid()), (SHAPE, grid(turn=45))],
    ]:
        wcs, shape = shared_grid(grids)
        finest = min((own for _, own in grids), key=lambda w: w.wcs.cdelt[1])
        # The finest grid keeps its pixels.
        step = np.array(pixel_to_pixel(finest, wcs, 3, 4))
        assert_allclose(step, np.rint(step), atol=1e-4)
        assert_allclose(wcs.pixel_scale_matrix, finest.pixel_scale_matrix)
        corners = [
            pixel_to_pixel(own, wcs, *(np.array([[0, 1, 0, 1], [0, 0, 1, 1]]) * end))
            for own, end in ((own, [[nx - 1], [ny - 1]]) for (ny, nx), own in grids)
        ]
        x, y = np.concatenate(corners, axis=1)
        # It holds all of them, and no more.
        assert -0.02 <= min(x.min(), y.min()) < 1
        assert_allclose([y.max(), x.max()], np.subtract(shape, 1.5), atol=0.52)
        assert wcs.array_shape == shape
        for far in ((187.1, 12.0), (7.0, -12.0)):
            with pytest.raises(ValueError, match="too far apart"):
                shared_grid([*grids, (SHAPE, grid(crval=far))])


def test_grids_of_headers_cubes_and_coordinates():
    cube, new = cube_of(), grid((70.25, 50), pixel=0.05, turn=20)
    expected = reproject_cube(cube, new, (50, 70))
    header, new.array_shape = new.to_header(), (50, 70)
    header.update({"NAXIS": 2, "NAXIS1": 70, "NAXIS2": 50, "CTYPE2": "DEC---SIN"})
    for target in (header, new, cube_of(new, (50, 70))):
        result = cube.reproject_to(target)
        assert_array_equal(result.mask, expected.mask)
        assert_allclose(result.data, expected.data, atol=1e-6)
    assert cube.reproject_to(header, (40, 60)).shape == (2, 40, 60)
