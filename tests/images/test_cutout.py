# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Regions, crops, rings, and parts of files that are read without the rest."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.time import Time
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from regions import CirclePixelRegion, CircleSkyRegion, PixCoord, RegionMeta, Regions

from astro_scc.epochs import Beam, EpochCube, write_epochs
from astro_scc.exceptions import EpochWarning
from astro_scc.images.positions import offset_wcs
from astro_scc.images.regions import crop, distance_mask, region_mask

SHAPE = (40, 50)
EXCLUDED = RegionMeta({"include": False})


def grid(turn=0.0, north=0.0):
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    wcs = offset_wcs(0.1 * u.mas, (20, 15), SkyCoord(187, 12 + north, unit="deg"))
    wcs.wcs.pc = [[c, -s], [s, c]]
    return wcs


def make(turn=0.0, **fields):
    data = np.random.default_rng(1).normal(size=(2, *SHAPE))
    return EpochCube(data, ["2000-01-01", "2001-01-01"], grid(turn), **fields)


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
    cube = make(25, epoch_wcs=[grid(25), grid(25, north=1e-7)])
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
        (crop, [(slice(40, 60), slice(None))], "holds no pixel of the 50 x 40 image"),
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
    for name in ("labels", "unit", "beams", "meta", "epoch_meta"):
        assert getattr(one, name) == getattr(other, name)
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
