# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Scale, north and offsets of images in all projections, as the sky has them."""

import astropy.units as u
import numpy as np
import pytest
import regions
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.nddata import CCDData
from astropy.wcs import WCS
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from astro_scc.epochs import Beam, EpochCube, inspect_epochs
from astro_scc.exceptions import EpochWarning
from astro_scc.images.positions import north_in, turned, unwrapped
from astro_scc.images.regions import region_mask

NY, NX = 24, 32
DATES = ["2010-01-01", "2011-01-01", "2012-01-01"]
#: Projection -> the largest native latitude, or the largest distance from the centre,
#: at which places are tried, and its parameters.
CYLINDERS = {"CAR": {}, "CEA": {"PV2_1": 1.0}, "MER": {}, "CYP": {}}
OTHERS = {"HPX": {}, "SFL": {}, "AIT": {}, "MOL": {}, "PAR": {}, "COE": {"PV2_1": 45.0}}
ZENITHAL = {
    "TAN": {}, "SIN": {}, "ARC": {}, "STG": {}, "ZEA": {},
    "ZPN": {"PV2_1": 1.0, "PV2_3": 0.05},
    "TPV": {"PV1_1": 1.002, "PV1_2": 0.003, "PV2_1": 0.998, "PV2_4": 1e-3},
    "NCP": None,
}  # fmt: skip


def header(code, place=(0.0, 0.0), step=1e-4, turn=0.0, mirrored=False, kind="RA"):
    """Return a header whose image shows a place (lon, lat) in its middle."""
    made = fits.Header()
    first = {"RA": ("RA---", "DEC--"), "GLON": ("GLON-", "GLAT-")}
    first |= {"CRLN": ("CRLN-", "CRLT-"), "HPLN": ("HPLN-", "HPLT-")}
    made["CTYPE1"], made["CTYPE2"] = (name + code for name in first[kind])
    made["CUNIT1"] = made["CUNIT2"] = "deg"
    made["CRVAL1"], made["CRVAL2"] = 120.0, 0.0
    if code in ZENITHAL:
        made["CRVAL1"], made["CRVAL2"] = place[0] + 1.5, np.clip(place[1] - 1, -88, 88)
    if code == "COE":
        made["CRVAL2"] = 45.0
    made.update((CYLINDERS | OTHERS | ZENITHAL)[code] or {})
    if code == "NCP":
        made["CTYPE1"], made["CTYPE2"] = "RA---SIN", "DEC--SIN"
        made["CRVAL2"] = np.where(abs(made["CRVAL2"]) < 20, 30.0, made["CRVAL2"]).item()
        made["PV2_2"] = 1 / np.tan(np.radians(made["CRVAL2"]))
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    left = 1 if mirrored else -1
    matrix = step * np.array([[left * c, -left * s], [s, c]])
    for (i, k), value in np.ndenumerate(matrix):
        made[f"CD{i + 1}_{k + 1}"] = value
    made["CRPIX1"], made["CRPIX2"] = 0.0, 0.0
    x, y = WCS(made).world_to_pixel_values(*place)
    made["CRPIX1"], made["CRPIX2"] = (NX - 1) / 2 - x, (NY - 1) / 2 - y
    return made


def spots_of(shape, *spots):
    """Return an image of spots, each of x, y and flux, with something like noise."""
    y, x = np.indices(shape)
    made = sum(f * np.exp(-((x - a) ** 2 + (y - b) ** 2) / 4) for a, b, f in spots)
    return made + 1e-4 * np.sin(7.0 * x + 3.1 * y * y + spots[-1][0])


def images():
    """Return three images of a spot that moves along x, and one that stands still."""
    x, y, shape = (NX - 1) / 2, (NY - 1) / 2, (NY, NX)
    return [spots_of(shape, (x, y, 1.0), (x + 4 + 2.0 * i, y, 0.5)) for i in range(3)]


def stack(own, every, unit="ct", **options):
    """Return a cube of images, each with its own coordinates, or all with one."""
    every = every if isinstance(every, list) else [every] * len(own)
    pairs = zip(own, every, strict=True)
    made = [CCDData(image, unit=unit, wcs=wcs) for image, wcs in pairs]
    return EpochCube.from_ccddata(made, times=DATES[: len(own)], **options)


def read(head, own=None):
    return stack(images() if own is None else own, WCS(head))


def step_on_sky(wcs, x, y, dx, dy):
    """Return length and position angle of a step on the sky, in mas and radians."""
    wcs = wcs.deepcopy()
    wcs.wcs.bounds_check(False, False)
    lon, lat = wcs.pixel_to_world_values([x, x + dx], [y, y + dy])
    one, other = SkyCoord(lon, lat, unit="deg")
    return one.separation(other).to_value(u.mas), one.position_angle(other).rad


@settings(deadline=None, max_examples=30)
@given(
    code=st.sampled_from([*CYLINDERS, *OTHERS, *ZENITHAL]),
    kind=st.sampled_from(["RA", "GLON", "CRLN", "HPLN"]),
    place=st.tuples(st.floats(0, 360), st.floats(-80, 80)),
    turn=st.floats(0, 360),
    mirrored=st.booleans(),
    step=st.sampled_from([1e-8, 3e-5, 3e-4]),
    angle=st.floats(0, 2 * np.pi),
)
def test_a_step_is_as_long_as_on_the_sky_and_of_the_same_direction(
    code, kind, place, turn, mirrored, step, angle
):
    # Near the equator NCP shows nothing.
    assume(code != "NCP" or (kind == "RA" and abs(place[1]) > 25))
    head = header(code, place, step, turn, mirrored, kind)
    assume(np.all(np.isfinite([head["CRPIX1"], head["CRPIX2"]])))
    x, y = (NX - 1) / 2, (NY - 1) / 2
    dx, dy = 2 * np.cos(angle), 2 * np.sin(angle)
    length, pa = step_on_sky(WCS(head), x, y, dx, dy)
    assume(np.isfinite(length))
    cube = read(head)
    places = (cube.pixel_to_offset(x + dx, y + dy), cube.pixel_to_offset(x, y))
    east, north = np.subtract(*(u.Quantity(place).value for place in places))
    assert_allclose(np.hypot(east, north), length, rtol=1e-3)
    turn = (np.arctan2(east, north) - pa + np.pi) % (2 * np.pi) - np.pi
    assert abs(turn) < 1e-3
    # Pixels stay where they are on the sky, to a hundredth of their side.
    there = WCS(head)
    there.wcs.bounds_check(False, False)
    places = (wcs.pixel_to_world_values(x, y) for wcs in (cube.wcs, there))
    found, true = (SkyCoord(*place, unit="deg") for place in places)
    assert found.separation(true).deg < 0.03 * step
    assert np.hypot(*cube.pixel_to_offset(x, y)).value < 20 * length


@pytest.mark.parametrize("code", ["CAR", "HPX"])
def test_images_are_resampled_where_one_matrix_does_not_hold(code, tmp_path):
    shape = (80, 60)
    # Beyond latitudes of 41 degrees, HPX has gaps.
    head = header(code, (120.0, 28.0 if code == "HPX" else 55.0), 0.2)
    for i, n in ((1, shape[1] - NX), (2, shape[0] - NY)):
        head[f"CRPIX{i}"] += n / 2
    wcs = WCS(head)
    spots = [(20, 15), (40, 60), (25, 45)]
    own = [spots_of(shape, *((a + i, b, 1.0) for a, b in spots)) for i in range(3)]
    with pytest.warns(EpochWarning, match="all images are resa|north turns by") as said:
        cube = stack(own, wcs, "ct / pix")
    assert len({str(warning.message)[:5] for warning in said}) == 2
    assert cube.noise is None
    (tmp_path / "a.reg").write_text("image\ncircle(20,20,9)\n")
    with pytest.raises(ValueError, match="a.reg: is in pixels, .* in resampled images"):
        cube.region_mask(tmp_path / "a.reg")
    assert "resampled onto a tangent plane" in cube.meta["history"][-1]
    assert cube.wcs.wcs.ctype[0] == "RA---ARC"
    # Flux per pixel is kept, and each spot stays at its place and moves as on the sky.
    assert_allclose(np.nansum(cube.data[0]), own[0].sum(), rtol=0.03)
    for a, b in spots:
        sky = [wcs.pixel_to_world(a + i, b) for i in (0, 2)]
        there = [np.ravel(cube.wcs.world_to_pixel(place)) for place in sky]
        for i, place in zip((0, 2), there, strict=True):
            u0, v0 = np.rint(place).astype(int)
            near = cube.data[i, v0 - 1 : v0 + 2, u0 - 1 : u0 + 2]
            assert near.max() > 0.4 * np.nanmax(cube.data[i])
        length, _ = step_on_sky(wcs, a, b, 2, 0)
        step = cube.pixel_matrix.value @ np.subtract(*there)
        assert_allclose(np.hypot(*step), length, rtol=0.02)


def test_structure_over_much_of_the_sky_is_refused():
    head = header("CAR", (120.0, 30.0), 5.0)
    y, x = np.indices((NY, NX))
    own = [image + (x % 5 == 0) * (y % 5 == 0) for image in images()]
    words = "image 0 and the other.*projection .CAR.*crop"
    with pytest.raises(ValueError, match=words):
        read(head, own)
    wide = header("CAR", (120.0, 0.0), 5.0)
    flat = EpochCube.from_arrays(own, DATES, pixel_scale=1 * u.deg)
    with pytest.raises(ValueError, match="projection .CAR. changes the scale"):
        flat.reproject_to(WCS(wide), (NY, NX))
    # Pixels without sky.
    wcs = WCS(header("SIN", (120.0, 0.0), 1.0))
    wcs.wcs.crpix = [500, 500]
    assert unwrapped(wcs, (NY, NX)) is wcs
    with pytest.raises(ValueError, match="projection .SIN"):
        EpochCube(np.ones((1, NY, NX)), DATES[:1], wcs)


def test_far_reference_pixels_are_no_origin(tmp_path):
    """Along the equator the matrix of a cylinder holds, but its offsets say nothing."""
    paths = []
    for i, (image, date) in enumerate(zip(images(), DATES, strict=True)):
        for code, lat in (("CAR", 0.0), ("TAN", 30.0)):
            head = header(code, (170.0 if code == "CAR" else 100.0, lat), 1e-3)
            head["DATE-OBS"], head["BUNIT"] = date, "ct"
            paths.append(tmp_path / f"{code}{i}.fits")
            fits.writeto(paths[-1], image, head)
    for code in ("CAR", "TAN"):
        files = [path for path in paths if path.name.startswith(code)]
        table = inspect_epochs(files)
        offset = np.hypot(table["peak_east"], table["peak_north"]).to_value(u.deg)
        assert np.all(offset < 0.05)
        cube = EpochCube.read(files)
        assert np.all(np.abs(np.array(cube.reference_pixel) - [15.5, 11.5]) < 1)
        assert "offsets are from pixel" in cube.meta["history"][-1]
        assert cube.align("wcs").meta["alignment"][-1]["shift_east_mas"] == 0


@pytest.mark.filterwarnings("error", "ignore:.*on another grid")
def test_epochs_of_both_equinoxes_have_one_north():
    place, made = SkyCoord(83.0, 80.0, unit="deg", frame="fk5"), []
    for frame in ("fk4", "fk5"):
        where = place.transform_to(frame)
        head = header("SIN", (83.0, 80.0), 0.1 / 3.6e6)
        head.update({"CRVAL1": where.data.lon.deg, "CRVAL2": where.data.lat.deg})
        head.update({"EQUINOX": 1950.0 if frame == "fk4" else 2000.0})
        head.update({"CRPIX1": 8.0, "CRPIX2": 12.0})
        made.append(WCS(head))
    old, new = made
    turn = north_in(old, new)
    beam = Beam(0.6 * u.mas, 0.3 * u.mas, 20 * u.deg)
    # A spot in the frame of J2000, seen on the grid of B1950.
    east, north = 1.2, 0.4
    x, y = np.indices((NY, NX))[::-1]
    own = []
    for angle in (0.0, turn):
        step = turned(new, angle).pixel_scale_matrix * 3.6e6
        x0, y0 = np.linalg.solve(step, [east, north]) + [7, 11]
        own.append(np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / 8))
    cube = stack(own, [new, old], "Jy/beam", beams=beam)
    assert_allclose(np.nan_to_num(cube.data[0] - cube.data[1])[:, 3:-3], 0, atol=2e-3)
    assert_allclose(cube.beams[0].pa.to_value(u.deg), 20)
    turned_by = (cube.beams[1].pa - 20 * u.deg).to_value(u.rad)
    assert_allclose(np.sin(turned_by - turn), 0, atol=1e-6)
    # Each has the coordinates of its own file.
    assert cube.epoch_wcs[1].wcs.equinox == 1950
    matrices = (w.pixel_scale_matrix for w in (cube.epoch_wcs[1], turned(new, -turn)))
    assert_allclose(*matrices, atol=1e-12)


MAS = u.mas


@pytest.mark.parametrize(
    ("drawn", "image", "mirrored"),
    [("galactic", "RA", True), ("fk4", "RA", False), ("icrs", "GLON", False)],
)
def test_regions_are_turned_from_the_frame_of_their_drawing(drawn, image, mirrored):
    head = header("SIN", (83.0, 22.0), 0.1 / 3.6e6, 25.0, mirrored, image)
    head.update({"CRVAL1": 83.0, "CRVAL2": 22.0, "CRPIX1": 40.0, "CRPIX2": 40.0})
    wcs = WCS(head)
    cube = EpochCube(np.ones((1, 80, 80)), DATES[:1], wcs)
    frame = "icrs" if image == "RA" else "galactic"
    centre = SkyCoord(83.0, 22.0, unit="deg", frame=frame).transform_to(drawn)
    where = {"center": centre, "angle": 30 * u.deg}
    long = {"width": 6 * MAS, "height": 1 * MAS, **where}
    ring = {"inner_width": 0.1 * MAS, "outer_width": 6 * MAS, **where}
    ring |= {"inner_height": 0.05 * MAS, "outer_height": 1 * MAS}
    # Places on the sky in the frame of the drawing, along and across the region.
    for region in (
        regions.EllipseSkyRegion(**long),
        regions.RectangleSkyRegion(**long),
        regions.EllipseAnnulusSkyRegion(**ring),
        regions.RectangleAnnulusSkyRegion(**ring),
    ):
        inside = region_mask(cube, region)
        # The angle runs from the axis of longitude, which is west in DS9's images.
        pa = 30 * u.deg - 90 * u.deg
        for turn, away, expected in (
            (0, 2.7, True), (0, 3.3, False), (0, -2.7, True), (90, 0.9, False),
            (90, -0.9, False),
        ):  # fmt: skip
            place = centre.directional_offset_by(pa + turn * u.deg, away * MAS)
            x, y = np.rint(wcs.world_to_pixel(place)).astype(int)
            assert inside[y, x] == expected
    alone = regions.EllipseSkyRegion(**long)
    ball = regions.CircleSkyRegion(centre, 2 * MAS)
    both = region_mask(cube, alone) & region_mask(cube, ball)
    assert np.array_equal(region_mask(cube, alone & ball), both)
    corners = [(10, 2), (120, 2), (250, 3)]
    vertices = [centre.directional_offset_by(a * u.deg, r * MAS) for a, r in corners]
    assert region_mask(cube, regions.PolygonSkyRegion(SkyCoord(vertices)))[39, 39]
    hollow = regions.CircleAnnulusSkyRegion(centre, 1 * MAS, 3 * MAS)
    assert not region_mask(cube, hollow)[39, 39]


@pytest.mark.filterwarnings("error")
def test_left_over_distortions_are_ignored(tmp_path, caplog, capfd):
    head = header("TAN", (120.0, 30.0), 1e-5)
    plain = read(head)
    head.update({"A_ORDER": 2, "B_ORDER": 2, "A_2_0": 1e-5, "B_1_1": 7e-6})
    head.update({"AP_ORDER": 1, "A_DMAX": 1.0, "BP_1_0": 1e-4})
    head.update({"DATE-OBS": DATES[0], "BUNIT": "ct"})
    fits.writeto(tmp_path / "a.fits", images()[0], head)
    cube = EpochCube.read(tmp_path / "a.fits")
    assert_allclose(cube.pixel_matrix.value, plain.pixel_matrix.value, rtol=1e-6)
    assert "SIP" not in caplog.text + "".join(capfd.readouterr())
    del head["DATE-OBS"]
    made = EpochCube(np.array(images()), DATES, WCS(head), "ct")
    assert_allclose(made.pixel_matrix.value, plain.pixel_matrix.value, rtol=1e-6)
