# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Regions and crops."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from regions import (
    CirclePixelRegion,
    CircleSkyRegion,
    EllipseSkyRegion,
    PixCoord,
    PointPixelRegion,
    RectanglePixelRegion,
    RegionMeta,
    Regions,
)

from astro_scc.epochs import Beam, EpochCube
from astro_scc.images.cutout import crop, distance_mask, refuse_pixels, region_mask

SHAPE = (40, 50)
MAS = u.mas.to(u.deg)


def grid(turn=0.0, crval=(187.0, 12.0)):
    angle = np.radians(turn)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---SIN", "DEC--SIN"]
    wcs.wcs.cdelt = [-0.1 * MAS, 0.1 * MAS]
    wcs.wcs.crpix = (21, 16)
    wcs.wcs.crval = crval
    wcs.wcs.pc = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return wcs


def make(turn=0.0, **fields):
    data = np.random.default_rng(1).normal(size=(2, *SHAPE))
    return EpochCube(data, ["2000-01-01", "2001-01-01"], grid(turn), **fields)


def disc(x, y, r):
    yy, xx = np.indices(SHAPE)
    return (xx - x) ** 2 + (yy - y) ** 2 < r**2


# -- regions -----------------------------------------------------------------


def test_everything_or_an_array_or_nothing_excluded():
    inside = disc(20, 20, 5)
    mask = region_mask(make(), inside)
    assert_array_equal(mask, inside)
    assert mask is not inside
    assert region_mask(make(), None).all()
    away = CirclePixelRegion(PixCoord(500, 20), 4, meta=RegionMeta({"include": False}))
    assert region_mask(make(), [away]).all()


@pytest.mark.parametrize(
    "text",
    [
        "# Region file format: DS9\nimage\ncircle(21,21,8.5)\n-circle(21,21,4.5)\n",
        "#CRTFv0\ncircle[[20pix,20pix],8.5pix]\n-circle[[20pix,20pix],4.5pix]\n",
    ],
)
def test_files_of_regions(tmp_path, text):
    path = tmp_path / "jet.reg"
    path.write_text(text)
    for name in (path, str(path)):
        expected = disc(20, 20, 8.5) & ~disc(20, 20, 4.5)
        assert_array_equal(region_mask(make(), name), expected)
    with pytest.raises(FileNotFoundError, match=r"no.reg"):
        region_mask(make(), tmp_path / "no.reg")


@pytest.mark.parametrize("turn", [0, 25])
def test_sky_regions_of_milliarcseconds(turn):
    cube = make(turn)
    centre = cube.wcs.pixel_to_world(24, 18)
    found = region_mask(cube, CircleSkyRegion(centre, 0.52 * u.mas))
    assert_array_equal(found, disc(24, 18, 5.2))
    ellipse = EllipseSkyRegion(centre, 1.6 * u.mas, 0.6 * u.mas, 30 * u.deg)
    east, north = (
        v.to_value(u.mas) - w.to_value(u.mas)
        for v, w in zip(cube.offsets(), cube.pixel_to_offset(24, 18), strict=True)
    )
    # The angle of a region is from west (longitude decreasing to the right)
    # towards north.
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    along, across = -east * c + north * s, east * s + north * c
    expected = (along / 0.8) ** 2 + (across / 0.3) ** 2 < 1
    assert np.sum(region_mask(cube, ellipse) != expected) <= 2


def test_regions_unite_and_exclusions_are_taken_away():
    one, two = (
        CirclePixelRegion(PixCoord(15, 20), 8),
        CirclePixelRegion(PixCoord(25, 20), 8),
    )
    hole = CirclePixelRegion(PixCoord(20, 20), 4, meta=RegionMeta({"include": False}))
    cube = make()
    union = disc(15, 20, 8) | disc(25, 20, 8)
    expected = union & ~disc(20, 20, 4)
    for items in ([one, two, hole], [hole, one, two], Regions([one, hole, two])):
        assert_array_equal(region_mask(cube, items), expected)
    assert_array_equal(region_mask(cube, (one, two)), union)
    assert_array_equal(region_mask(cube, hole), ~disc(20, 20, 4))


def test_compound_regions():
    both = CirclePixelRegion(PixCoord(15, 20), 8) & CirclePixelRegion(
        PixCoord(22, 20), 8
    )
    assert_array_equal(region_mask(make(), both), disc(15, 20, 8) & disc(22, 20, 8))


def test_ds9_files_written_by_regions_of_the_sky(tmp_path):
    cube = make(25)
    region = CircleSkyRegion(cube.wcs.pixel_to_world(24, 18), 0.52 * u.mas)
    path = tmp_path / "jet.reg"
    Regions([region]).write(path, format="ds9", precision=12)
    assert_array_equal(region_mask(cube, path), disc(24, 18, 5.2))


SKY = SkyCoord("12h30m49.423382s +12d23m28.0443217s")
LON, LAT = SKY.ra.deg, SKY.dec.deg
CORNERS = [(x, y) for x in (-1, 1) for y in (-x, x)]
SQUARE = [(LON + x * 6e-7, LAT + y * 6e-7) for x, y in CORNERS]


@pytest.mark.parametrize(
    ("name", "text", "enough"),
    [
        # What regions and CARTA write as CRTF, and DS9 in degrees and in hours.
        ("r.crtf", f"circle[[{LON:.6f}deg, {LAT:.6f}deg], 0.000001deg]", False),
        ("r.crtf", f"circle[[{LON:.12f}deg, {LAT:.12f}deg], 0.000000555556deg]", True),
        ("r.crtf", f"circle[[{LON:.12f}deg, {LAT:.12f}deg], 0.0020arcsec]", True),
        ("r.reg", f'icrs\ncircle({LON:.7f},{LAT:.7f},0.0020")', False),
        ("r.reg", f'icrs\ncircle({LON:.8f},{LAT:.8f},0.0020")', True),
        ("r.reg", 'icrs\ncircle(12:30:49.4234,+12:23:28.044,0.0020")', False),
        ("r.reg", 'icrs\ncircle(12:30:49.423382,+12:23:28.04432,0.0020")', True),
        ("r.reg", f'icrs\nellipse({LON:.9f},{LAT:.9f},0.002",0.002",12.34567)', True),
        ("r.reg", "icrs\npolygon(%s)", False),
    ],
)
def test_regions_of_too_few_digits_are_refused(tmp_path, name, text, enough):
    cube = EpochCube.from_arrays(
        np.ones((1, 90, 90)), ["2000-01-01"], pixel_scale=0.1 * u.mas, position=SKY
    )
    if "%s" in text:
        text %= ",".join(f"{value:.6f}" for corner in SQUARE for value in corner)
    text = "#CRTFv0\nglobal coord=ICRS\n" * name.endswith("crtf") + text
    (tmp_path / name).write_text(text)
    if enough:
        yy, xx = np.indices((90, 90)) - 44.5
        wrong = region_mask(cube, tmp_path / name) != (xx**2 + yy**2 < 20**2)
        assert wrong.sum() < 40
    else:
        with pytest.raises(
            ValueError, match=rf"{name}: a \w+ of .* is written in steps"
        ):
            region_mask(cube, tmp_path / name)


def test_round_numbers_that_somebody_wrote_are_meant(tmp_path):
    cube = make()
    for text in (
        'icrs\ncircle(187.0,12.0,0.0018")',
        'icrs\ncircle(187,12,0.0018")',
        'icrs\ncircle(12:28:00.0,+12:00:00.0,0.0018")',
    ):
        path = tmp_path / "r.reg"
        path.write_text(text)
        assert np.sum(region_mask(cube, path) != disc(20, 15, 18)) < 4


def test_what_regions_writes_by_default(tmp_path):
    cube = make(25)
    region = CircleSkyRegion(cube.wcs.pixel_to_world(24.3, 18.2), 0.52 * u.mas)
    Regions([region]).write(tmp_path / "r.crtf", format="crtf")
    # The radius has become 0.
    with pytest.raises(ValueError, match=r"r.crtf: cannot be read .* strictly posit"):
        region_mask(cube, tmp_path / "r.crtf")
    Regions([region]).write(tmp_path / "r.reg", format="ds9")
    # Eight decimals are 0.04 mas.
    moved = region_mask(cube, tmp_path / "r.reg") != disc(24.3, 18.2, 5.2)
    assert moved.sum() < 4


def test_fits_region_files_are_refused(tmp_path):
    path = tmp_path / "r.fits"
    Regions([CirclePixelRegion(PixCoord(20, 20), 8)]).write(path, format="fits")
    with pytest.raises(ValueError, match="r.fits: is not a text file; give a DS9 or"):
        region_mask(make(), path)


def test_regions_on_the_sphere():
    regions = pytest.importorskip("regions", minversion="0.12")
    cube = make(25)
    centre = cube.wcs.pixel_to_world(24.3, 18.2)
    circle = regions.CircleSphericalSkyRegion(centre, 0.52 * u.mas)
    hole = regions.CircleSphericalSkyRegion(
        centre, 0.2 * u.mas, meta=RegionMeta({"include": False})
    )
    assert_array_equal(region_mask(cube, circle), disc(24.3, 18.2, 5.2))
    expected = disc(24.3, 18.2, 5.2) & ~disc(24.3, 18.2, 2)
    assert_array_equal(region_mask(cube, [circle, hole]), expected)
    corners = cube.wcs.pixel_to_world([10.5, 30.5, 30.5, 10.5], [5.5, 5.5, 20.5, 20.5])
    square = regions.PolygonSphericalSkyRegion(corners)
    assert region_mask(cube, square).sum() == 20 * 15
    assert region_mask(cube, circle | square).sum() == 320
    between = regions.RangeSphericalSkyRegion(
        longitude_range=[1, 2] * u.deg, frame="icrs"
    )
    with pytest.raises(ValueError, match="RangeSphericalSkyRegion cannot be") as e:
        region_mask(cube, between)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.reg", b"garbage\n", "holds no region"),
        ("a.reg", b"", "holds no region"),
        ("a.reg", b"image\ncircle(1,2\n", "cannot be read as a ds9 region file"),
        ("a.crtf", b"#CRTFv0\ncircle[[1pix],2]\n", "cannot be read as a crtf"),
        ("a.fits", b"\xff\xfe\x00\x80", "not a text file"),
        ("a.reg", b"image\ncircle(500,21,8)\n", "holds no pixel of the 50 x 40 image"),
        ("a.reg", b"image\ncircle(21.5,21.5,0.1)\n", "holds no pixel"),
        ("a.reg", b"image\npoint(21,21)\n", "PointPixelRegion has no inside"),
    ],
)
def test_region_files_that_cannot_be_used(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        region_mask(make(), path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_regions_that_cannot_be_used():
    cube = make()
    with pytest.raises(ValueError, match="no pixel"):
        region_mask(cube, CirclePixelRegion(PixCoord(-30, 20), 4))
    with pytest.raises(ValueError, match="no pixel"):
        region_mask(cube, np.zeros(SHAPE, dtype=bool))
    with pytest.raises(ValueError, match=r"array of bool of the images' shape"):
        region_mask(cube, np.ones((3, 3), dtype=bool))
    with pytest.raises(ValueError, match="array of float64"):
        region_mask(cube, np.ones(SHAPE))
    with pytest.raises(ValueError, match="has no inside"):
        region_mask(cube, PointPixelRegion(PixCoord(3, 4)))
    for wrong in (3, [], [3]):
        with pytest.raises(TypeError, match="region must be"):
            region_mask(cube, wrong)


# -- crops --------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 38), st.integers(1, 40), st.integers(0, 48), st.integers(1, 50))
def test_offsets_and_values_stay_where_they_are(y0, height, x0, width):
    cube = make(25, epoch_wcs=[grid(25), grid(25, crval=(187.0, 12.0 + 1e-7))])
    part = crop(cube, (slice(y0, y0 + height), slice(x0, x0 + width)))
    y1, x1 = min(y0 + height, 40), min(x0 + width, 50)
    assert_array_equal(part.data, cube.data[:, y0:y1, x0:x1])
    for mine, theirs in zip(part.offsets(), cube.offsets(), strict=True):
        assert_allclose(mine.value, theirs.value[y0:y1, x0:x1], atol=1e-9)
    before = cube.epoch_wcs[1].pixel_to_world(x0, y0)
    assert part.epoch_wcs[1].pixel_to_world(0, 0).separation(before) < 1e-4 * u.mas
    assert part.wcs.array_shape == part.shape[1:]


def test_cropping_to_a_region_with_a_margin():
    unit = u.Jy / u.beam
    beams = Beam(1 * u.mas, 1 * u.mas)
    mask = np.zeros((2, *SHAPE), dtype=bool)
    mask[1, 12, 21] = True
    cube = make(mask=mask, unit=unit, beams=beams, noise=[1, 2] * unit)
    region = RectanglePixelRegion(PixCoord(22, 12), 8, 4)
    part = crop(cube, region, pad=2)
    inside = np.argwhere(region_mask(cube, region))
    (ya, xa), (yb, xb) = inside.min(axis=0), inside.max(axis=0)
    expected = cube.data[:, ya - 2 : yb + 3, xa - 2 : xb + 3]
    assert_array_equal(part.data, expected)
    assert part.mask.sum() == 1
    assert_array_equal(part.noise, cube.noise)
    assert part.beams == cube.beams
    assert "cropped to pixels x 17 to 27" in part.meta["history"][-1]
    part.data[:] = 0
    assert cube.data.any()


def test_a_margin_ends_at_the_edge():
    part = crop(make(), (slice(0, 5), slice(None)), pad=3)
    assert part.shape == (2, 8, 50)


def test_negative_slices_count_from_the_end():
    cube = make()
    part = crop(cube, (slice(-10, None), slice(3, -3)))
    assert_array_equal(part.data, cube.data[:, -10:, 3:-3])


def test_crops_that_cannot_be_made():
    cube = make()
    with pytest.raises(ValueError, match="hold no pixel of the 50 x 40 image"):
        crop(cube, (slice(40, 60), slice(None)))
    for wrong in ((slice(None, None, 2), slice(None)), (slice(None),)):
        with pytest.raises(ValueError, match="must be two, .y, x., without a step"):
            crop(cube, wrong)
    for pad in (-1, 1.5):
        with pytest.raises(ValueError, match="whole number"):
            crop(cube, (slice(None), slice(None)), pad=pad)


# -- rings ----------------------------------------------------------------------


@pytest.mark.parametrize("turn", [0, 25])
def test_rings_share_no_pixel_and_leave_none_out(turn):
    cube = make(turn)
    edges = [0, 0.5, 1.0, 1.7, 10] * u.mas
    rings = [distance_mask(cube, a, b) for a, b in zip(edges, edges[1:], strict=False)]
    assert_array_equal(np.sum(rings, axis=0), 1)
    # Pixels five steps away are at 0.5 mas but for rounding.
    assert rings[0][15, 20]
    assert rings[1][15, 25]
    assert rings[1][10, 20]


def test_rings_about_another_point():
    cube = make(25)
    offset = u.Quantity(cube.pixel_to_offset(30, 22))
    sky = cube.wcs.pixel_to_world(30, 22)
    for origin in (offset, offset.to(u.uas), sky):
        inside = distance_mask(cube, 0 * u.mas, 400.1 * u.uas, origin=origin)
        assert_array_equal(inside, disc(30, 22, 4.001))


def test_rings_that_cannot_be_made():
    cube = make()
    for low, high in ((1, 1), (2, 1), (-1, 1), (np.nan, 1)):
        with pytest.raises(ValueError, match="0 <= r_min < r_max"):
            distance_mask(cube, low * u.mas, high * u.mas)
    with pytest.raises(ValueError, match="no pixel of the image is"):
        distance_mask(cube, 1 * u.arcsec, 2 * u.arcsec)
    with pytest.raises(ValueError, match="pair of offsets"):
        distance_mask(cube, 0 * u.mas, 1 * u.mas, origin=3 * u.mas)
    with pytest.raises(u.UnitsError):
        distance_mask(cube, 0 * u.s, 1 * u.s)


def test_a_position_in_another_frame():
    cube = make()
    sky = cube.wcs.pixel_to_world(30, 22).galactic
    assert isinstance(sky, SkyCoord)
    inside = distance_mask(cube, 0 * u.mas, 0.4001 * u.mas, origin=sky)
    assert_array_equal(inside, disc(30, 22, 4.001))


def test_region_files_in_pixels_are_known(tmp_path):
    path = tmp_path / "r.reg"
    path.write_text('icrs\ncircle(187d,12d,0.001")\nimage\ncircle(20,20,8)\n')
    with pytest.raises(ValueError, match=r"r.reg: is in pixels, which are others in a"):
        refuse_pixels(path)
    path.write_text('icrs\ncircle(187d,12d,0.001")\n')
    assert refuse_pixels(path) is None
