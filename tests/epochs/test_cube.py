# Licensed under a 3-clause BSD style license - see LICENSE.rst
import warnings
from datetime import datetime
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.nddata import CCDData, NDData
from astropy.time import Time
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.epochs import Beam, EpochCube
from astro_scc.epochs.inspection import Problem, problems
from astro_scc.exceptions import EpochWarning
from astro_scc.images.fits import find_files, looks_like_mask
from astro_scc.images.positions import readable_angle
from astro_scc.images.series import measure_noise

DATES = ["2001-01-01", "2000-01-01", "2000-06-01"]
JY_BEAM = u.Jy / u.beam
MISSING = Time(np.ma.masked_array([1, 2, 3], [0, 0, 1]), format="mjd")
ROUND = Beam(1 * u.mas, 1 * u.mas)


DIFFERENT = [Beam(k * u.mas, 1 * u.mas) for k in (1, 2, 3)]


def images(n=3, ny=8, nx=12, seed=1):
    return np.random.default_rng(seed).normal(size=(n, ny, nx))


def make_cube(n=3, **kwargs):
    options = {"pixel_scale": 0.1 * u.mas, "unit": JY_BEAM, **kwargs}
    return EpochCube.from_arrays(images(n), DATES[:n], **options)


def celestial(**changes):
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = "RA---SIN", "DEC--SIN"
    wcs.wcs.cdelt = -1e-7, 1e-7
    wcs.wcs.crpix = 4, 5
    wcs.wcs.crval = 10, 20
    for name, value in changes.items():
        setattr(wcs.wcs, name, value)
    return wcs


# -- construction ----------------------------------------------------------------


def test_everything_is_sorted_by_date():
    data = images()
    cube = EpochCube(
        data=data,
        times=Time(DATES),
        wcs=celestial(),
        mask=data > 1,
        beams=DIFFERENT,
        noise=[1, 2, 3] * u.dimensionless_unscaled,
        labels=list("abc"),
        epoch_wcs=[celestial(crval=(k, 0)) for k in range(3)],
        epoch_meta=[{"k": k} for k in range(3)],
    )
    order = [1, 2, 0]
    assert np.array_equal(cube.data, data[order])
    assert np.array_equal(cube.mask, (data > 1)[order])
    assert [t[:10] for t in cube.times.isot] == [DATES[i] for i in order]
    assert [b.major.value for b in cube.beams] == [2, 3, 1]
    assert cube.noise.value.tolist() == [2, 3, 1]
    assert cube.labels == ("b", "c", "a")
    assert [w.wcs.crval[0] for w in cube.epoch_wcs] == [1, 2, 0]
    assert [m["k"] for m in cube.epoch_meta] == [1, 2, 0]


@settings(max_examples=30)
@given(st.permutations(range(5)))
def test_any_order_gives_the_same_cube(order):
    data = images(5, 2, 3)
    days = np.array([0.0, 1.5, 1.5, 30.0, 31.0])
    times = Time(51544 + days[list(order)], format="mjd")
    cube = EpochCube(data[list(order)], times, celestial())
    assert np.all(np.diff(cube.times.mjd) >= 0)
    for value, day in zip(cube.data, cube.times.mjd - 51544, strict=True):
        assert any(np.array_equal(value, data[i]) for i in np.flatnonzero(days == day))


def test_defaults():
    cube = EpochCube(images(), DATES, celestial())
    assert cube.unit == u.dimensionless_unscaled
    assert cube.mask.shape == cube.shape
    assert not cube.mask.any()
    assert cube.beams is None
    assert cube.noise is None
    assert cube.epoch_wcs is None
    assert cube.labels == ("2000-01-01", "2000-06-01", "2001-01-01")
    assert cube.epoch_meta == ({}, {}, {})
    assert len(cube) == 3


def test_pixels_that_are_not_finite_are_masked():
    data = images()
    data[0, 0, 0] = np.nan
    data[1, 1, 1] = np.inf
    masked = np.ma.masked_array(data, mask=data == data[2, 2, 2])
    cube = EpochCube(masked, Time(DATES), celestial())
    assert cube.mask.sum() == 3


def test_quantity_and_integers_become_float64():
    cube = EpochCube(
        np.ones((1, 2, 3), dtype=">i2") * u.mJy, ["2000-01-01"], celestial()
    )
    assert cube.unit == u.mJy
    assert cube.data.dtype == np.float64
    cube = EpochCube(np.ones((1, 2, 3)) * u.mJy, "2000-01-01", celestial(), unit=u.Jy)
    assert cube.data[0, 0, 0] == pytest.approx(1e-3)


def test_one_beam_and_one_noise_are_those_of_every_epoch():
    cube = make_cube(beams=ROUND, noise=1 * u.mJy / u.beam)
    assert cube.beams == (ROUND,) * 3
    assert cube.noise.unit == JY_BEAM
    assert cube.noise.value.tolist() == [1e-3] * 3
    assert np.array_equal(cube.noise_rms(), cube.noise)


def test_beams_of_radio_beam_and_alike():
    radio_beam = pytest.importorskip("radio_beam")
    other = radio_beam.Beam(1 * u.arcsec, 0.5 * u.arcsec, 10 * u.deg)
    expected = Beam(1 * u.arcsec, 0.5 * u.arcsec, 10 * u.deg)
    assert make_cube(beams=other).beams == (expected,) * 3
    alike = SimpleNamespace(major=1 * u.mas, minor=1 * u.mas, pa=0 * u.deg)
    assert make_cube(beams=[alike, other, ROUND]).beams[2] == ROUND


def test_dates_are_taken_in_many_forms():
    for times in (
        Time(DATES),
        DATES,
        [Time(date) for date in DATES],
        [datetime.fromisoformat(date) for date in DATES],
        np.array(DATES, dtype="datetime64[D]"),
        ["01/01/01", "2000-01-01Z", "2000/06/01"],
    ):
        cube = EpochCube(images(), times, celestial())
        assert [t[:10] for t in cube.times.isot] == sorted(DATES)
    assert EpochCube(images(1), Time("2000-01-01"), celestial()).shape[0] == 1
    assert EpochCube(images(1), datetime(2000, 1, 1), celestial()).shape[0] == 1


def test_dates_older_than_utc_warn_of_nothing():
    times = ["1939-11-01", "1992-01-01"]
    cube = EpochCube.from_arrays(images(2), times, pixel_scale=0.2 * u.arcsec)
    assert cube.years.value[1] == pytest.approx(52.16, abs=0.01)
    assert cube.labels[0] == "1939-11-01"
    assert "1939-11-01" in repr(cube)
    assert len(cube.epochs) == 2


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"data": np.ones((8, 12))}, ValueError, r"shape \(n_epochs, ny, nx\), got"),
        ({"data": np.ones((3, 0, 2))}, ValueError, "shape"),
        ({"data": "image"}, TypeError, "real numbers"),
        ({"data": [[1, 2], [3]]}, TypeError, "real numbers"),
        ({"data": np.ones((3, 8, 12)) * 1j}, TypeError, "complex128"),
        ({"unit": "furlong/beam"}, ValueError, "'furlong/beam' is not one that"),
        ({"times": DATES[:2]}, ValueError, "3 epochs need 3 times"),
        ({"times": []}, ValueError, "3 epochs need 3 times"),
        ({"times": [2000.1, 2000.2, 2001]}, TypeError, "times must be a Time or"),
        ({"times": ["x", "y", "z"]}, ValueError, "'x' is no date"),
        ({"times": MISSING}, ValueError, "times has missing values"),
        ({"mask": np.ones((8, 12), bool)}, ValueError, r"mask has shape \(8, 12\)"),
        ({"beams": [ROUND]}, ValueError, "3 epochs need 3 beams, got 1"),
        ({"beams": [ROUND, None, ROUND]}, TypeError, "a beam has major, minor and pa"),
        ({"noise": [1, 2] * JY_BEAM}, ValueError, "3 epochs need 3 noises"),
        ({"noise": -1 * JY_BEAM}, ValueError, "finite and not negative"),
        ({"noise": 1.0}, TypeError, "noise must be a Quantity in Jy / beam"),
        ({"noise": 1 * u.K}, TypeError, "noise must be a Quantity in Jy / beam"),
        ({"labels": ["a"]}, ValueError, "3 epochs need 3 labels"),
        ({"epoch_wcs": [celestial()]}, ValueError, "3 epochs need 3 epoch_wcs"),
        ({"epoch_meta": [{}]}, ValueError, "3 epochs need 3 epoch_meta"),
        ({"wcs": None}, TypeError, "wcs must be a WCS, or one sliced, got"),
        ({"wcs": WCS(naxis=2)}, ValueError, "wcs must have celestial axes"),
    ],
)
def test_bad_arguments(changes, error, message):
    good = {"data": images(), "times": DATES, "wcs": celestial(), "unit": JY_BEAM}
    with pytest.raises(error, match=message) as caught:
        EpochCube(**{**good, **changes})
    assert "\n" not in str(caught.value)


def test_an_epoch_without_valid_pixels_is_named():
    data = images()
    data[1] = np.nan
    with pytest.raises(ValueError, match="b.fits: no valid pixel; leave this epoch"):
        EpochCube(data, Time(DATES), celestial(), labels=["a.fits", "b.fits", "c.fits"])


def test_wcs_with_more_axes_or_distortions():
    four = WCS(naxis=4)
    four.wcs.ctype = "RA---SIN", "DEC--SIN", "FREQ", "STOKES"
    four.wcs.cdelt = -1e-7, 1e-7, 1, 1
    assert EpochCube(images(), DATES, four).wcs.naxis == 2
    reverse = celestial(ctype=["DEC--SIN", "RA---SIN"])
    with pytest.raises(ValueError, match="latitude on its first axis"):
        EpochCube(images(), DATES, reverse)
    from astropy.wcs import Sip

    sip = celestial(ctype=["RA---TAN-SIP", "DEC--TAN-SIP"])
    matrix = np.zeros((3, 3))
    matrix[2, 0] = 1e-4
    sip.sip = Sip(matrix, matrix, None, None, sip.wcs.crpix)
    with pytest.raises(ValueError, match="no distortions"):
        EpochCube(images(), DATES, sip)


def test_from_arrays():
    position = SkyCoord("12h29m06.7s +02d03m08.6s")
    cube = make_cube(reference_pixel=(2, 3), position=position)
    assert cube.reference_pixel == (2, 3)
    assert SkyCoord(*cube.wcs.wcs.crval * u.deg).separation(position) < 1e-9 * u.deg
    assert make_cube().reference_pixel == (5.5, 3.5)
    assert cube.pixel_scale.to_value(u.mas) == pytest.approx(0.1)
    assert np.allclose(cube.pixel_matrix.value, [[-0.1, 0], [0, 0.1]])
    with pytest.raises(ValueError, match=r"shape \(n_epochs, ny, nx\), got \(8, 12\)"):
        EpochCube.from_arrays(images()[0], DATES, pixel_scale=1 * u.mas)
    with pytest.raises(ValueError, match="pixel_scale = .* must be finite and above 0"):
        make_cube(pixel_scale=-1 * u.mas)


# -- what it gives --------------------------------------------------------------


def test_one_epoch_is_a_ccddata_of_its_own():
    cube = make_cube(beams=ROUND, noise=1 * JY_BEAM)
    image = cube[1]
    assert isinstance(image, CCDData)
    assert image.unit == JY_BEAM
    assert image.wcs.naxis == 2
    assert np.array_equal(image.data, cube.data[1])
    assert np.array_equal(image.mask, cube.mask[1])
    assert image.meta["DATE-OBS"] == "2000-06-01T00:00:00.000"
    assert image.meta["LABEL"] == "2000-06-01"
    assert image.meta["BMAJ"] == pytest.approx(1 / 3.6e6)
    image.meta["OBJECT"] = "changed"
    assert "OBJECT" not in cube[1].meta
    assert np.array_equal(cube[-1].data, cube.data[-1])
    assert image[2:4, 3:5].shape == (2, 2)
    with pytest.raises(IndexError, match="epoch 3 of a cube with 3 epochs"):
        cube[3]


def test_some_epochs_are_a_cube():
    cube = make_cube(beams=DIFFERENT, noise=[1, 2, 3] * JY_BEAM)
    for selection in (
        slice(1, 3),
        [False, True, True],
        [1, 2],
        np.array([2, 1]),
        [1, -1],
    ):
        part = cube[selection]
        assert np.array_equal(part.data, cube.data[1:])
        assert part.beams == cube.beams[1:]
        assert part.labels == cube.labels[1:]
        assert np.array_equal(part.noise, cube.noise[1:])
        assert (part.times == cube.times[1:]).all()
    for nothing in (slice(3, 5), [False] * 3, []):
        with pytest.raises(ValueError, match="holds none of 3 epochs|none of 3"):
            cube[nothing]
    with pytest.raises(TypeError, match=r"index epochs only"):
        cube[0, 1:3]
    with pytest.raises(IndexError):
        cube[[7]]


def test_steps_leave_a_line_and_the_first_cube_as_it_was():
    cube = make_cube()
    other = cube.with_step("doubled", data=2 * cube.data)
    assert other.meta["history"] == ["3 epochs from arrays", "doubled"]
    assert cube.meta["history"] == ["3 epochs from arrays"]
    assert np.array_equal(other.data, 2 * cube.data)
    third = other.with_step("named", meta={**other.meta, "object": "x"})
    assert third.meta["object"] == "x"
    assert len(third.meta["history"]) == 3


@settings(max_examples=30)
@given(st.floats(-180, 180), st.booleans(), st.floats(-50, 50), st.floats(-50, 50))
def test_offsets_and_pixels_are_inverse(angle, flipped, x, y):
    turn = np.radians(angle)
    rotation = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    wcs = celestial(pc=rotation, cdelt=[1e-7 if flipped else -1e-7, 1e-7])
    cube = EpochCube(images(1), ["2000-01-01"], wcs)
    again = cube.offset_to_pixel(*cube.pixel_to_offset(x, y))
    assert np.allclose(again, (x, y), atol=1e-6)


def test_offsets_are_those_of_the_sky():
    cube = EpochCube(images(1), ["2000-01-01"], celestial())
    east, north = cube.offsets()
    assert east.shape == north.shape == cube.shape[1:]
    assert east[4, 3] == north[4, 3] == 0
    assert east[0, 0] > 0 > north[0, 0]
    origin = SkyCoord(10 * u.deg, 20 * u.deg)
    corner = cube.wcs.pixel_to_world(0, 0)
    true = origin.spherical_offsets_to(corner)
    assert u.isclose(east[0, 0], true[0], rtol=1e-6)
    assert u.isclose(north[0, 0], true[1], rtol=1e-6)
    assert u.allclose(cube.pixel_to_offset(0, 0), [east[0, 0], north[0, 0]])
    x, y = cube.offset_to_pixel(east.to(u.arcsec), north.to(u.deg))
    assert np.allclose(x[2], np.arange(12))
    assert np.allclose(y[:, 2], np.arange(8))


def test_table_of_epochs():
    cube = make_cube(beams=ROUND)
    table = cube.epochs
    assert table.colnames[:6] == ["epoch", "label", "date", "major", "minor", "pa"]
    assert table["noise"].unit == JY_BEAM
    assert np.isnan(table["frequency"]).all()
    assert "major" not in make_cube().epochs.colnames


def test_how_it_looks():
    assert repr(make_cube(beams=ROUND)) == (
        "<EpochCube 3 epochs 2000-01-01 to 2001-01-01, 12 x 8 pixels of 0.1 mas, "
        "Jy / beam, beam 1 mas x 1 mas>"
    )
    assert "beams that differ" in repr(make_cube(beams=DIFFERENT))
    assert "1 epoch 2001-01-01" in repr(make_cube(1))
    html = make_cube()._repr_html_()
    assert html.startswith("<p>EpochCube 3 epochs")
    assert "<table" in html
    same_day = EpochCube(images(2), ["2000-01-01T01", "2000-01-01T02:00"], celestial())
    assert same_day.labels == ("2000-01-01T01:00:00", "2000-01-01T02:00:00")


def test_mean_image_leaves_masked_pixels_out():
    data = images()
    data[0, 0, 0] = np.nan
    data[:, 1, 1] = np.nan
    cube = EpochCube(data, DATES, celestial(), unit=JY_BEAM)
    mean = cube.mean_image()
    assert mean.data[0, 0] == pytest.approx(data[1:, 0, 0].mean())
    assert mean.data[2, 2] == pytest.approx(data[:, 2, 2].mean())
    assert np.argwhere(mean.mask).tolist() == [[1, 1]]
    assert np.isnan(mean.data[1, 1])
    assert mean.unit == JY_BEAM


@pytest.mark.parametrize(
    "text", "2 arcsec/50 mas/0.1 mas/0.02 mas/3.125 uas/1 deg".split("/")
)
def test_readable_angles(text):
    assert readable_angle(u.Quantity(text).to(u.mas)) == text


# -- noise ----------------------------------------------------------------------


def test_noise_is_measured_beside_the_source():
    rng = np.random.default_rng(3)
    image = rng.normal(scale=0.5, size=(200, 200)) + 7
    image[50:100, 50:150] += np.geomspace(0.1, 1e4, 100)
    assert measure_noise(image) == pytest.approx(0.5, rel=0.05)
    mask = np.zeros(image.shape, dtype=bool)
    mask[50:100, 50:150] = True
    assert measure_noise(image, mask=mask) == pytest.approx(0.5, rel=0.02)
    image[mask] = np.nan
    assert measure_noise(image) == pytest.approx(0.5, rel=0.02)


def test_noise_of_blanked_and_of_trivial_images():
    rng = np.random.default_rng(3)
    image = np.zeros((100, 100))
    image[:30] = rng.normal(size=(30, 100))
    assert measure_noise(image) == pytest.approx(1, rel=0.05)
    assert measure_noise(np.zeros((4, 4))) == 0
    assert measure_noise(np.full((4, 4), np.nan)) == 0
    assert measure_noise(np.full((4, 4), 3.0)) == 0
    sparse = np.full((10, 10), 2.0)
    sparse[0] = 3
    assert measure_noise(sparse) == pytest.approx(0.3)


@settings(max_examples=30)
@given(st.floats(1e-9, 1e9), st.floats(-10, 10))
def test_noise_scales_with_the_image(factor, level):
    image = images(1, 32, 32)[0]
    expected = factor * measure_noise(image)
    assert measure_noise(factor * (image + level)) == pytest.approx(expected, rel=1e-6)


# -- from CCDData ---------------------------------------------------------------


def test_from_nddata_with_given_dates_and_beams():
    parts = [NDData(plane, wcs=celestial()) for plane in images()]
    cube = EpochCube.from_ccddata(parts, times=DATES, beams=ROUND)
    assert np.array_equal(cube.data, images()[[1, 2, 0]])
    assert cube.beams == (ROUND,) * 3
    assert cube.labels[0] == "2000-01-01"
    masked = NDData(images(1), mask=images(1) > 0, wcs=celestial())
    assert EpochCube.from_ccddata([masked], Time("2000-01-01")).mask.any()


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (NDData(np.ones((2, 3)), wcs=celestial()), "image 0: no date of observation"),
        (NDData(np.ones((2, 3)), meta={"DATE-OBS": "2000-01-01"}), "0: it has no WCS"),
        (NDData(np.ones((2, 2, 3)), wcs=celestial()), r"0: has shape \(2, 2, 3\)"),
        (NDData(np.full((2, 3), np.nan), wcs=celestial()), "image 0: no valid pixel"),
    ],
)
def test_images_that_lack_something_are_named(image, message):
    with pytest.raises(ValueError, match=message):
        EpochCube.from_ccddata([image])


def test_no_images_or_wrong_numbers():
    with pytest.raises(ValueError, match="at least one image"):
        EpochCube.from_ccddata([])
    with pytest.raises(ValueError, match="3 images need 3 times, got 2"):
        EpochCube.from_ccddata(list(make_cube()), times=DATES[:2])
    with pytest.raises(ValueError, match="frame = 'sky' must be one of offset, abs"):
        EpochCube.from_ccddata(list(make_cube()), frame="sky")


def test_impossible_beam_in_the_meta_is_left_out():
    image = NDData(np.ones((2, 3)), wcs=celestial(), meta={"BMAJ": 1.0, "BMIN": -1.0})
    with pytest.warns(EpochWarning, match="image 0: its beam is taken as unknown"):
        cube = EpochCube.from_ccddata([image], times=["2000-01-01"])
    assert cube.beams is None


# -- from NDCube ----------------------------------------------------------------


def time_wcs(first):
    axes = ["RA---TAN", "DEC--TAN"]
    axes.insert(0 if first else 2, "TIME")
    wcs = WCS(naxis=3)
    wcs.wcs.ctype = axes
    wcs.wcs.cunit = ["s" if axis == "TIME" else "deg" for axis in axes]
    wcs.wcs.cdelt = [3600.0 if axis == "TIME" else 1e-4 for axis in axes]
    wcs.wcs.crpix = [1] * 3
    wcs.wcs.dateref = "2014-06-01T00:00:00"
    wcs.wcs.mjdref = 56809, 0
    wcs.wcs.set()
    return wcs


@pytest.mark.parametrize("first", [True, False])
def test_from_ndcube_with_a_time_axis(first):
    ndcube = pytest.importorskip("ndcube")
    data = images()
    array = np.moveaxis(data, 0, 2) if first else data
    source = ndcube.NDCube(array, wcs=time_wcs(first), unit=u.ct, mask=array > 1)
    cube = EpochCube.from_ndcube(source)
    assert np.array_equal(cube.data, data)
    assert np.array_equal(cube.mask, data > 1)
    assert cube.unit == u.ct
    assert cube.years.to_value(u.hour) == pytest.approx([0, 1, 2])
    assert cube.times[0].isot[:10] == "2014-06-01"
    given = EpochCube.from_ndcube(source, times=sorted(DATES), beams=ROUND)
    assert given.times[0].isot[:10] == "2000-01-01"
    assert given.beams[0] == ROUND


def test_from_ndcube_of_other_shapes():
    ndcube = pytest.importorskip("ndcube")
    parts = [ndcube.NDCube(plane, wcs=celestial()) for plane in images()]
    sequence = ndcube.NDCubeSequence(parts)
    cube = EpochCube.from_ndcube(sequence, times=sorted(DATES))
    assert np.array_equal(cube.data, images())
    no_sky = ndcube.NDCube(images(), wcs=WCS(naxis=3))
    with pytest.raises(ValueError, match="must have two celestial axes"):
        EpochCube.from_ndcube(no_sky)


# -- from files -----------------------------------------------------------------


def test_read_sorts_and_lays_on_reference_pixels(make_fits):
    paths = [
        make_fits("a.fits", images(1, 16, 32, 1), DATE_OBS="2001-01-01"),
        make_fits(
            "b.fits", images(1, 16, 32, 2), DATE_OBS="2000-01-01", CRVAL1=187.25001
        ),
    ]
    with pytest.warns(EpochWarning, match="reference pixels are .* apart on the sky"):
        cube = EpochCube.read(paths)
    assert cube.labels == ("b.fits", "a.fits")
    assert np.array_equal(cube.data[0], images(1, 16, 32, 2)[0])
    assert np.array_equal(cube.data[1], images(1, 16, 32, 1)[0])
    assert [w.wcs.crval[0] for w in cube.epoch_wcs] == [187.25001, 187.25]
    assert cube.wcs.wcs.crval[0] == 187.25001
    assert cube.unit == JY_BEAM
    assert cube.beams[0] == Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg)
    assert cube.epoch_meta[0]["frequency"] == 15.4e9
    assert cube.epochs["frequency"][0] == 15.4 * u.GHz
    assert cube.meta["object"] == "3C273"
    assert cube.meta["history"] == ["2 FITS images, aligned on their reference pixels"]


def test_patterns_and_paths(make_fits, tmp_path, monkeypatch):
    paths = [make_fits(f"{k}.fits", DATE_OBS=f"200{k}-01-01") for k in range(3)]
    assert len(EpochCube.read(f"{tmp_path}/*.fits")) == 3
    assert len(EpochCube.read(tmp_path / "[01].fits")) == 2
    assert len(EpochCube.read([paths[0], f"{tmp_path}/*.fits"])) == 3
    assert len(EpochCube.read(str(paths[0]))) == 1
    monkeypatch.setenv("HOME", str(tmp_path))
    assert find_files("~/0.fits") == [tmp_path / "0.fits"]
    assert find_files(iter([paths[0], paths[0]])) == [paths[0]]
    odd = tmp_path / "[1].fits"
    odd.write_bytes(paths[0].read_bytes())
    assert find_files(odd) == [odd]


@pytest.mark.parametrize(
    ("paths", "error", "message"),
    [
        ("nowhere/*.fits", FileNotFoundError, r"nowhere/\*.fits: no file matches this"),
        ("nowhere.fits", FileNotFoundError, "nowhere.fits: no such file"),
        ([], FileNotFoundError, "no files were given"),
        (3, TypeError, "paths must be names or a pattern, got 3"),
        ([3], TypeError, "paths must be names"),
        (b"a.fits", TypeError, "paths must be"),
        ([b"a.fits"], TypeError, "paths must be text"),
    ],
)
def test_files_that_are_not_there(paths, error, message):
    with pytest.raises(error, match=message):
        EpochCube.read(paths)


def test_given_dates_and_beams_replace_those_of_headers(make_fits):
    paths = [make_fits(f"{k}.fits", DATE_OBS=None, BMAJ=None) for k in range(2)]
    with pytest.raises(ValueError, match=r"0.fits: no date of observation .*times="):
        EpochCube.read(paths)
    cube = EpochCube.read(paths, times=["2001-01-01", "2000-01-01"], beams=ROUND)
    assert cube.labels == ("1.fits", "0.fits")
    assert cube.beams == (ROUND, ROUND)
    other = make_fits("2.fits", DATE_OBS="2003-01-01", BMAJ=None)
    cube = EpochCube.read([paths[0], other], times=["2004-01-01", None])
    assert cube.labels == ("2.fits", "0.fits")
    cube = EpochCube.read(paths, times=Time(["2001-01-01", "2000-01-01"]))
    assert cube.labels == ("1.fits", "0.fits")
    with pytest.raises(ValueError, match="2 images need 2 times"):
        EpochCube.read(paths, times="2001-01-01")
    bad = make_fits("3.fits", BMAJ=-1.0)
    assert EpochCube.read(bad, beams=ROUND).beams == (ROUND,)


def test_beams_of_some_epochs_only(make_fits):
    paths = [make_fits("a.fits"), make_fits("b.fits", DATE_OBS="2007-01-01", BMAJ=None)]
    with pytest.warns(EpochWarning, match="b.fits: no beam where other epochs have"):
        assert EpochCube.read(paths).beams is None


def test_notes_on_many_files_are_one_warning(make_fits):
    paths = [
        make_fits(f"{k}.fits", DATE_OBS=f"200{k}-01-01", BUNIT="ODD") for k in range(5)
    ]
    with pytest.warns(EpochWarning) as caught:
        EpochCube.read(paths)
    assert len(caught) == 1
    assert str(caught[0].message).startswith(
        "0.fits, 1.fits, 2.fits and 2 more: its unit 'ODD'"
    )
    assert caught[0].filename == __file__


def test_two_files_of_one_date_are_kept(make_fits):
    paths = [make_fits("a.fits"), make_fits("b.fits")]
    with pytest.warns(EpochWarning, match="b.fits: is of .*, as is a.fits; leave"):
        cube = EpochCube.read(paths)
    assert len(cube) == 2


def test_files_of_one_name_in_two_folders(make_fits, tmp_path):
    (tmp_path / "x").mkdir()
    paths = [make_fits("a.fits"), make_fits("x/a.fits", DATE_OBS="2007-01-01")]
    assert EpochCube.read(paths).labels == tuple(str(path) for path in paths)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"OBJECT": "3C120", "CRVAL1": 68.0}, "shows 3C120, somewhere else, where"),
        ({"CRVAL3": 43e9}, r"is at 43 GHz, others are at 15.4"),
        ({"CRVAL4": 2.0}, "is of Stokes Q, others are of I"),
        ({"FILTER": "F673N"}, "is of the filter F673N, others are of F502N"),
    ],
)
def test_files_of_something_else_are_named(make_fits, changes, message):
    paths = [
        make_fits(f"{k}.fits", DATE_OBS=f"200{k}-01-01", FILTER="F502N")
        for k in range(3)
    ]
    paths.insert(1, make_fits("odd.fits", **changes))
    with pytest.raises(ValueError, match=message) as caught:
        EpochCube.read(paths)
    assert str(caught.value).startswith(str(paths[1]))
    assert str(caught.value).endswith("leave it out (in Python, check=False reads it)")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EpochWarning)
        assert len(EpochCube.read(paths, check=False)) == 4


def test_another_name_of_the_same_place_is_a_warning(make_fits):
    paths = [
        make_fits("a.fits", OBJECT="3C 273"),
        make_fits("b.fits", OBJECT="3c273", DATE_OBS="2007-01-01"),
        make_fits("c.fits", OBJECT="Unknown", DATE_OBS="2008-01-01"),
    ]
    EpochCube.read(paths)
    paths.append(make_fits("d.fits", OBJECT="1226+023", DATE_OBS="2009-01-01"))
    with pytest.warns(EpochWarning, match="d.fits: shows 1226.023, at the same place"):
        EpochCube.read(paths)


def test_masks_are_refused(make_fits):
    mask = (images(1, 16, 32) > 0).astype("u1")
    paths = [make_fits("a.fits"), make_fits("m.fits", mask, DATE_OBS="2007-01-01")]
    with pytest.raises(ValueError, match=r"m.fits: has no more than two different"):
        EpochCube.read(paths)
    assert len(EpochCube.read(paths, check=False)) == 2


def test_units_are_brought_to_that_of_the_first(make_fits):
    data = images(1, 16, 32)
    paths = [
        make_fits("a.fits", data, BUNIT="mJy/beam"),
        make_fits("b.fits", data, DATE_OBS="2007-01-01"),
    ]
    cube = EpochCube.read(paths)
    assert cube.unit == u.mJy / u.beam
    assert np.allclose(cube.data[1], 1000 * cube.data[0])
    paths.append(make_fits("c.fits", data, DATE_OBS="2008-01-01", BUNIT="K"))
    with pytest.raises(ValueError, match="c.fits: its unit is K, that of others is"):
        EpochCube.read(paths)
    plain = make_fits("d.fits", data, DATE_OBS="2008-01-01", BUNIT=None)
    with pytest.raises(ValueError, match=r"d.fits: its unit is none, that of"):
        EpochCube.read([paths[0], plain])


def test_whole_cubes_are_not_epochs(make_fits, tmp_path):
    make_cube().write(tmp_path / "cube.fits")
    with pytest.raises(ValueError, match="cube.fits: is a whole EpochCube"):
        EpochCube.read([make_fits(), tmp_path / "cube.fits"])
    with pytest.raises(ValueError, match="an EpochCube; it has its dates and beams"):
        EpochCube.read(tmp_path / "cube.fits", times=["2000-01-01"])


def gaussian(ny, nx, x0, y0, width=3.0):
    y, x = np.indices((ny, nx))
    return np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * width**2))


def test_whole_pixels_are_moved_without_interpolation(make_fits):
    one, two = images(1, 16, 32, 1)[0], images(1, 20, 24, 2)[0]
    paths = [
        make_fits("a.fits", one),
        make_fits("b.fits", two, DATE_OBS="2007-01-01", CRPIX1=12.0, CRPIX2=14.0),
    ]
    cube = EpochCube.read(paths)
    assert cube.shape == (2, 21, 32)
    assert cube.reference_pixel == (15, 13)
    assert np.array_equal(cube.data[0, 5:, :], one)
    assert np.array_equal(cube.data[1, :20, 4:28], two)
    assert cube.mask[0, :5].all()
    assert not cube.mask[0, 5:].any()
    assert cube.mask[1].sum() == 21 * 32 - 20 * 24


STEP = 0.1 / 3.6e6
COARSE = {"DATE_OBS": "2007-01-01", "CDELT1": -2 * STEP, "CDELT2": 2 * STEP}


def test_other_grids_are_resampled_in_offsets(make_fits):
    fine = gaussian(64, 64, 31 + 10, 31 + 6)
    coarse = gaussian(40, 40, 19 + 5, 19 + 3, 1.5)
    own = {**COARSE, "CRPIX1": 20.0, "CRPIX2": 20.0, "CRVAL1": 187.25 + 3 * STEP}
    paths = [
        make_fits("a.fits", fine, CRPIX1=32.0, CRPIX2=32.0),
        make_fits("b.fits", coarse, **own),
    ]
    with pytest.warns(EpochWarning, match=r"b.fits: on another grid") as caught:
        cube = EpochCube.read(paths)
    assert len(caught) == 1
    assert cube.pixel_scale.to_value(u.mas) == pytest.approx(0.1)
    x0, y0 = cube.reference_pixel
    expected = gaussian(*cube.shape[1:], x0 + 10, y0 + 6)
    for k in range(2):
        good = ~cube.mask[k]
        assert np.allclose(cube.data[k][good], expected[good], atol=0.02)
    assert cube.wcs.wcs.crval[0] == 187.25
    assert cube.epoch_wcs[1].wcs.crval[0] == 187.25 + 3 * STEP
    assert np.array_equal(cube.epoch_wcs[1].wcs.crpix, cube.wcs.wcs.crpix)


def test_intensity_per_pixel_keeps_its_sum(make_fits):
    fine, coarse = gaussian(64, 64, 31, 31, 6), 4 * gaussian(32, 32, 15.0, 15.0, 3)
    common = {"BUNIT": "JY/PIXEL", "BMAJ": None}
    paths = [
        make_fits("a.fits", fine, CRPIX1=32.0, CRPIX2=32.0, **common),
        make_fits("b.fits", coarse, CRPIX1=16.0, CRPIX2=16.0, **COARSE, **common),
    ]
    with pytest.warns(EpochWarning, match="on another grid"):
        cube = EpochCube.read(paths)
    sums = np.nansum(cube.data, axis=(1, 2))
    assert sums[1] == pytest.approx(sums[0], rel=0.02)


def test_pixels_or_positions_too_different_for_one_grid(make_fits):
    paths = [make_fits("a.fits"), make_fits("b.fits", DATE_OBS="2007-01-01")]
    coarse = {"CDELT1": -1e-6, "CDELT2": 1e-6, "DATE_OBS": "2008-01-01"}
    paths.append(make_fits("c.fits", **coarse))
    with pytest.raises(ValueError, match=r"c.fits: its pixels are 3.6 mas where"):
        EpochCube.read(paths)
    far = {"CRVAL1": 188.0, "DATE_OBS": "2008-01-01"}
    paths[2] = make_fits("d.fits", **far)
    with pytest.raises(ValueError, match=r"d.fits: lies too far from .*a.fits"):
        EpochCube.read(paths, frame="absolute")


def test_absolute_coordinates_are_trusted_when_asked(make_fits):
    data = gaussian(32, 48, 20, 15)
    here = {"CRPIX1": 21.0, "CRPIX2": 16.0, "CRVAL2": 0.0}
    east = {**here, "CRVAL1": 187.25 + 2 * STEP, "DATE_OBS": "2007-01-01"}
    half = {**here, "CRVAL2": 2.5 * STEP, "DATE_OBS": "2008-01-01"}
    paths = [make_fits("a.fits", data, **here), make_fits("b.fits", data, **east)]
    offset = EpochCube.read(paths)
    assert np.array_equal(offset.data[0], offset.data[1])
    cube = EpochCube.read(paths, frame="absolute")
    peaks = [np.unravel_index(np.nanargmax(plane), plane.shape) for plane in cube.data]
    assert peaks[0][1] - peaks[1][1] == 2
    assert peaks[0][0] == peaks[1][0]
    assert not np.isnan(cube.data[1][~cube.mask[1]]).any()
    assert "absolute coordinates" in cube.meta["history"][0]
    paths.append(make_fits("c.fits", data, **half))
    with pytest.warns(EpochWarning, match=r"c.fits: on another grid"):
        cube = EpochCube.read(paths, frame="absolute")
    image = np.where(cube.mask[2], 0, cube.data[2])
    rows = np.arange(cube.shape[1])[:, None]
    first = np.where(cube.mask[0], 0, cube.data[0])
    centres = [np.sum(rows * i) / np.sum(i) for i in (first, image)]
    assert centres[1] - centres[0] == pytest.approx(2.5, abs=0.05)


def test_solar_coordinates_need_no_solar_library(make_fits):
    solar = {"CTYPE1": "HPLN-TAN", "CTYPE2": "HPLT-TAN", "CRVAL1": 0.1, "CRVAL2": 0.1}
    data = images(1, 16, 32)
    paths = [
        make_fits("a.fits", data, **solar),
        make_fits("b.fits", data, DATE_OBS="2007-01-01", CRPIX1=18.0, **solar),
    ]
    cube = EpochCube.read(paths)
    assert cube.shape == (2, 16, 34)
    assert list(cube.wcs.wcs.ctype) == ["HPLN-TAN", "HPLT-TAN"]
    assert list(cube.epoch_wcs[1].wcs.crval) == [0.1, 0.1]


# -- odd ones -------------------------------------------------------------------


def plane_of(**facts):
    wcs = celestial(crval=(facts.pop("lon", 10), 20))
    plane = {"name": "x", "time": facts.pop("time", None), "extent": 1e-6}
    return SimpleNamespace(facts=facts, wcs=wcs, unit=u.one, **plane)


def test_problems_of_few_facts():
    assert problems([plane_of(), plane_of()]) == []
    planes = [plane_of(object=name, lon=10 + (name == "B")) for name in "AAB"]
    there = "shows B, somewhere else, where others show A"
    assert problems(planes) == [Problem(2, there)]
    assert problems(planes, check=False) == []
    bands = [plane_of(frequency=15.3e9), plane_of(frequency=15.4e9), plane_of()]
    assert problems(bands) == []
    assert problems([plane_of(stokes="RR"), plane_of(stokes="I"), plane_of()]) == []


def test_same_dates_and_masks():
    times = Time(["2000-01-02", "2000-01-01", "2000-01-02T00:00:00.5"])
    (found,) = problems([plane_of(time=time) for time in [*times, None]])
    assert (found.index, found.refused) == (2, False)
    assert not looks_like_mask(np.full((2, 2), np.nan))


# -- real files -----------------------------------------------------------------


def test_epochs_of_0003(shared_data):
    cube = EpochCube.read(f"{shared_data}/0003+380/*.fits")
    assert cube.shape == (10, 256, 256)
    assert cube.pixel_scale.to_value(u.mas) == pytest.approx(0.1)
    assert cube.times[0].isot[:10] == "2006-03-09"
    assert cube.beams[0].major.to_value(u.mas) == pytest.approx(1.084, abs=1e-3)
    assert cube.reference_pixel == (127, 128)
    published = [
        fits.getval(path, "NOISE")
        for path in sorted((shared_data / "0003+380").glob("*.fits"))
    ]
    assert np.allclose(cube.noise_rms().value, published, rtol=0.1)


@pytest.mark.parametrize(
    ("name", "shape", "reference"),
    [("0506+056", (3, 512, 512), None), ("paper_test/two_fluid", (10, 128, 256), 20)],
)
def test_other_series(shared_data, name, shape, reference):
    cube = EpochCube.read(f"{shared_data}/{name}/*.fits")
    assert cube.shape == shape
    if reference is not None:
        assert cube.reference_pixel == (reference, 64)
        assert np.allclose(np.diff(cube.times.jd), 30)
    else:
        north = [wcs.wcs.crval[1] * 3.6e6 for wcs in cube.epoch_wcs]
        assert north[2] - north[0] == pytest.approx(-0.33, abs=0.01)
