# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Regions, crops, rings, parts of files, and images on other grids."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.time import Time
from astropy.wcs.utils import pixel_to_pixel
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from regions import CirclePixelRegion, CircleSkyRegion, PixCoord, RegionMeta, Regions

from astro_scc.epochs import Beam, EpochCube, write_epochs
from astro_scc.exceptions import EpochWarning
from astro_scc.images.grid import reproject_cube, shared_grid, shift_image
from astro_scc.images.positions import offset_wcs
from astro_scc.images.regions import crop, distance_mask, region_mask

DATES = ["2000-01-01", "2001-01-01"]
SHAPE = (40, 50)
EXCLUDED = RegionMeta({"include": False})


def grid(crpix=(40, 32), pixel=0.1, turn=0.0, crval=(187.0, 12.0), ctype="RA DEC"):
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    wcs = offset_wcs(pixel * u.mas, np.subtract(crpix, 1), SkyCoord(*crval, unit="deg"))
    wcs.wcs.ctype = [f"{name:-<5}SIN" for name in ctype.split()]
    wcs.wcs.pc = [[c, -s], [s, c]]
    return wcs


def make(turn=0.0, **fields):
    data = np.random.default_rng(1).normal(size=(2, *SHAPE))
    return EpochCube(data, DATES, grid((21, 16), turn=turn), **fields)


CUBE = make()


def disc(x, y, r):
    yy, xx = np.indices(SHAPE)
    return (xx - x) ** 2 + (yy - y) ** 2 < r**2


def circle(x, y, r, **meta):
    return CirclePixelRegion(PixCoord(x, y), r, **meta)


ONE, TWO, HOLE = circle(15, 20, 8), circle(25, 20, 8), circle(20, 20, 4, meta=EXCLUDED)
UNION = disc(15, 20, 8) | disc(25, 20, 8)


@pytest.mark.parametrize(
    ("region", "expected"),
    [
        (None, np.ones(SHAPE, bool)),
        (disc(20, 20, 5), disc(20, 20, 5)),
        ([circle(500, 20, 4, meta=EXCLUDED)], np.ones(SHAPE, bool)),
        # Far larger than the images, whose memory suffices.
        (circle(20, 20, 1e7), np.ones(SHAPE, bool)),
        ((ONE, TWO), UNION),
        (Regions([ONE, HOLE, TWO]), UNION & ~disc(20, 20, 4)),
        (HOLE, ~disc(20, 20, 4)),
        (ONE & circle(22, 20, 8), disc(15, 20, 8) & disc(22, 20, 8)),
        ("# Region file format: DS9\nimage\ncircle(21,21,8.5)\n-circle(21,21,4.5)\n",
         disc(20, 20, 8.5) & ~disc(20, 20, 4.5)),
        ("#CRTFv0\ncircle[[20pix,20pix],8.5pix]\n-circle[[20pix,20pix],4.5pix]\n",
         disc(20, 20, 8.5) & ~disc(20, 20, 4.5)),
    ],
)  # fmt: skip
def test_regions_unite_and_exclusions_are_taken_away(tmp_path, region, expected):
    if isinstance(region, str):
        (tmp_path / "jet.reg").write_text(region)
        assert_array_equal(region_mask(CUBE, str(tmp_path / "jet.reg")), expected)
        region = tmp_path / "jet.reg"
    mask = region_mask(CUBE, region)
    assert_array_equal(mask, expected)
    assert mask is not region


SKY = SkyCoord("12h30m49.423382s +12d23m28.0443217s")
LON, LAT = SKY.ra.deg, SKY.dec.deg
CORNERS = [(x, y) for x in (-1, 1) for y in (-x, x)]
SQUARE = [v for x, y in CORNERS for v in (LON + x * 6e-7, LAT + y * 6e-7)]
CRTF = "#CRTFv0\nglobal coord=ICRS\n"
# Round numbers are those of somebody who wrote them.
ROUND = {'icrs\ncircle(12:28:00.0,+12:00:00.0,0.002")': SkyCoord(187, 12, unit="deg")}


def test_regions_of_too_few_digits_are_refused(tmp_path):
    for text, enough in [
        # What regions and CARTA write as CRTF, and DS9 in degrees and in hours.
        (f"{CRTF}circle[[{LON:.6f}deg, {LAT:.6f}deg], 0.000001deg]", False),
        (f"{CRTF}circle[[{LON:.12f}deg, {LAT:.12f}deg], 0.000000555556deg]", True),
        (f'icrs\ncircle({LON:.7f},{LAT:.7f},0.0020")', False),
        ('icrs\ncircle(12:30:49.4234,+12:23:28.044,0.0020")', False),
        ('icrs\ncircle(12:30:49.423382,+12:23:28.04432,0.0020")', True),
        (f"icrs\npolygon({','.join(f'{v:.6f}' for v in SQUARE)})", False),
        (Regions([CircleSkyRegion(SKY, 2 * u.mas)]).serialize("ds9"), True),
        *((text, True) for text in ROUND),
    ]:
        place = {"pixel_scale": 0.1 * u.mas, "position": ROUND.get(text, SKY)}
        cube = EpochCube.from_arrays(np.ones((1, 90, 90)), ["2000-01-01"], **place)
        (tmp_path / "r.reg").write_text(text)
        if enough:
            yy, xx = np.indices((90, 90)) - 44.5
            wrong = region_mask(cube, tmp_path / "r.reg") != (xx**2 + yy**2 < 20**2)
            assert wrong.sum() < 40
        else:
            with pytest.raises(ValueError, match=r"r.reg: a \w+ of .* is written in"):
                region_mask(cube, tmp_path / "r.reg")


def test_regions_that_cannot_be_used(tmp_path):
    for region, message in [
        (b"garbage\n", "r.reg: holds no region"),
        (b"physical\nbox(9,9,9,9,0)\n", '"physical" frame .* not .* save it as fk5'),
        (b"image\ncircle(1,2\n", "r.reg: cannot be read as a ds9 region file"),
        (b"#CRTFv0\ncircle[[1pix],2]\n", "r.reg: cannot be read as a crtf"),
        (b"\xff\xfe\x00\x80", "r.reg: is not a text file"),
        # Its mask would need 30 TiB.
        (b"image\ncircle(-3000000,0,2900000)\n", "r.reg: holds no pixel"),
        (b"image\npoint(21,21)\n", "r.reg: the PointPixelRegion has no inside"),
        (b"image\nellipse(21,21,4,1e200,0)\n", "the EllipsePixelRegion has no inside"),
        (b"icrs\ncircle(4:33:11,5:21:15,0.5\")\n", "r.reg: .* that the images show"),
        (np.zeros(SHAPE, dtype=bool), "no pixel"),
        (np.ones(SHAPE), "array of float64"),
        *((wrong, "region must be") for wrong in (3, [], [3])),
    ]:  # fmt: skip
        if isinstance(region, bytes):
            (tmp_path / "r.reg").write_bytes(region)
            region = tmp_path / "r.reg"
        with pytest.raises((ValueError, TypeError, OSError), match=message) as caught:
            region_mask(CUBE, region)
        assert "\n" not in str(caught.value)


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 38), st.integers(1, 40), st.integers(0, 48), st.integers(1, 50))
def test_offsets_and_values_stay_where_they_are(y0, height, x0, width):
    own = [grid((21, 16), turn=25, crval=(187, 12 + north)) for north in (0, 1e-7)]
    cube = make(25, epoch_wcs=own)
    part = crop(cube, (slice(y0, y0 + height), slice(x0, x0 + width)))
    y1, x1 = min(y0 + height, 40), min(x0 + width, 50)
    assert_array_equal(part.data, cube.data[:, y0:y1, x0:x1])
    for mine, theirs in zip(part.offsets(), cube.offsets(), strict=True):
        assert_allclose(mine.value, theirs.value[y0:y1, x0:x1], atol=1e-9)
    before = cube.epoch_wcs[1].pixel_to_world(x0, y0)
    assert part.epoch_wcs[1].pixel_to_world(0, 0).separation(before) < 1e-4 * u.mas
    assert part.wcs.array_shape == part.shape[1:]


def test_rings_share_no_pixel_and_leave_none_out():
    cube = make(25)
    edges = [0, 0.5, 1.0, 1.7, 10] * u.mas
    rings = [distance_mask(cube, a, b) for a, b in zip(edges, edges[1:], strict=False)]
    assert_array_equal(np.sum(rings, axis=0), 1)
    # Pixels five steps away are at 0.5 mas but for rounding.
    assert rings[0][15, 20]
    assert rings[1][[15, 10], [25, 20]].all()


def test_rings_and_crops_that_cannot_be_made():
    for function, arguments, words in [
        (distance_mask, [np.nan, 1] * u.mas, "0 <= r_min < r_max"),
        (distance_mask, [1, 2] * u.arcsec, "no pixel is 1.0 arcsec to"),
        (crop, [(slice(None, None, 2), slice(None))], "two, .y, x., without a step"),
        (crop, [ONE, 1.5], "whole number"),
    ]:
        with pytest.raises((ValueError, u.UnitsError), match=words):
            function(CUBE, *arguments)


PART = slice(9, 30), slice(14, 50)


def series(n=3, **fields):
    rng, shape = np.random.default_rng(5), (40, 60)
    options = {
        "times": Time("2001-01-01") + np.arange(n) * 30 * u.day,
        "pixel_scale": 0.1 * u.mas, "reference_pixel": (20, 15), "unit": u.Jy / u.beam,
        "beams": [Beam((1 + 0.1 * i) * u.mas, 0.8 * u.mas) for i in range(n)],
        "mask": rng.uniform(size=(n, *shape)) < 0.02,
    }  # fmt: skip
    return EpochCube.from_arrays(rng.normal(size=(n, *shape)), **{**options, **fields})


def same(one, other):
    assert_array_equal(one.mask, other.mask)
    assert_array_equal(one.data[~one.mask], other.data[~one.mask])
    assert one.times.isot.tolist() == other.times.isot.tolist()
    for name in ("labels", "unit", "beams", "epoch_meta"):
        assert getattr(one, name) == getattr(other, name)
    # Of a part there is nothing to say about the grid of all.
    assert one.meta["history"][-1] == other.meta["history"][-1]
    grids = [(cube.wcs, *(cube.epoch_wcs or ())) for cube in (one, other)]
    for own, its in zip(*grids, strict=True):
        assert own.to_header_string() == its.to_header_string()
    assert one.wcs.array_shape == other.wcs.array_shape


@pytest.fixture
def paths(tmp_path):
    # The last epoch is the first of the files.
    return write_epochs(series(), tmp_path)[::-1]


def test_as_reading_all_and_cropping(paths, tmp_path):
    whole = EpochCube.read(paths)
    path = tmp_path / "jet.reg"
    path.write_text("image\ncircle(21,21,8.5)\nblob(3,4)\n")
    with pytest.warns(EpochWarning, match="blob") as caught:
        same(EpochCube.read(paths, region=path, pad=3), whole.crop(path, pad=3))
    assert caught[0].filename == __file__
    same(EpochCube.read(paths, region=PART), whole.crop(PART))
    cube = series(noise=1 * u.Jy / u.beam)
    cube.write(tmp_path / "cube.fits")
    part = EpochCube.read(tmp_path / "cube.fits", region=PART, pad=2)
    same(part, cube.crop(PART, pad=2))
    assert_array_equal(part.noise, cube.noise)


def test_images_that_lie_whole_pixels_aside(tmp_path):
    cube = series(mask=None)
    # The second image has five rows and seven columns less.
    smaller = cube[[1]].crop((slice(5, 40), slice(7, 60)))
    paths = write_epochs(cube[[0]], tmp_path) + write_epochs(smaller, tmp_path / "b")
    whole = EpochCube.read(paths)
    part = EpochCube.read(paths, region=PART)
    same(part, whole.crop(PART))
    assert not part.mask.any()
    # Beyond the edge of one of them.
    corner = slice(0, 20), slice(0, 20)
    same(EpochCube.read(paths, region=corner), EpochCube.read(paths).crop(corner))
    with pytest.raises(ValueError, match="nothing of the region lies in it; leave it"):
        EpochCube.read(paths, region=(slice(0, 4), slice(0, 20)))
    # Pixels of a file are not those of a grid that holds several.
    assert "laid on a shared grid of 60 x 40 pixels" in whole.meta["history"][1]
    (tmp_path / "a.reg").write_text("image\ncircle(20,20,9)\n")
    for other in (whole, part, reproject_cube(cube, cube.wcs, (50, 50))):
        with pytest.raises(ValueError, match="a.reg: is in pixels, which are others"):
            other.region_mask(tmp_path / "a.reg")
    with pytest.warns(EpochWarning, match="region: is in pixels, .* of cube.wcs, not"):
        whole.region_mask(CirclePixelRegion(PixCoord(20, 20), 9))


WIDE = (64, 80)
INNER = (slice(2, -2), slice(2, -2))


def spots(wcs, shape):
    """Round Gaussians at offsets in mas, an image for each."""
    probe = EpochCube(np.zeros((1, *shape)), DATES[:1], wcs)
    e, n = (v.to_value(u.mas) for v in probe.offsets())
    r2 = np.array([(e - 0.3) ** 2 + (n + 0.2) ** 2, (e + 0.8) ** 2 + (n - 0.9) ** 2])
    return np.exp(-r2 / (2 * 0.45**2))


def cube_of(wcs=None, shape=WIDE, **fields):
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
    data = spots(grid((40.5, 32.5)), WIDE)
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
        (3, {}, "must be a WCS, or one sliced, got"),
        (grid(ctype="GLON GLAT"), {}, "another celestial frame"),
        (grid((400.5, 32)), {}, "no valid pixel"),
    ]:  # fmt: skip
        cube = cube_of(beams=Beam(1 * u.mas, 1 * u.mas))
        with pytest.raises((ValueError, TypeError), match=words):
            reproject_cube(cube, target, **{"shape": WIDE, **options})


def test_the_finest_pixels_and_the_widest_extent_are_shared():
    for grids in [
        [(WIDE, grid(pixel=0.2)), ((100, 100), grid((50, 60)))],
        [(WIDE, grid()), (WIDE, grid(turn=45))],
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
                shared_grid([*grids, (WIDE, grid(crval=far))])


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
