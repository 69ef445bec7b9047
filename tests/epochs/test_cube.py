# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Cubes: what they hold, how files become one, and what inspection tells."""

import re
import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.epochs import Beam, EpochCube, inspect_epochs, plan_intervals
from astro_scc.epochs.inspection import repeated
from astro_scc.exceptions import EpochWarning
from astro_scc.images.fits import find_files
from astro_scc.images.positions import offset_wcs

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
    wcs = offset_wcs(0.36 * u.mas, (3, 4), SkyCoord(10, 20, unit="deg"))
    for name, value in changes.items():
        setattr(wcs.wcs, name, value)
    return wcs


def test_everything_is_sorted_by_date():
    data, order = images(), [1, 2, 0]
    cube = EpochCube(
        data, Time(DATES), celestial(), mask=data > 1, beams=DIFFERENT,
        noise=[1, 2, 3] * u.one, labels=list("abc"),
        epoch_wcs=[celestial(crval=(k, 0)) for k in range(3)],
        epoch_meta=[{"k": k} for k in range(3)],
    )  # fmt: skip
    assert np.array_equal(cube.data, data[order])
    assert np.array_equal(cube.mask, (data > 1)[order])
    assert [t[:10] for t in cube.times.isot] == [DATES[i] for i in order]
    assert [b.major.value for b in cube.beams] == cube.noise.value.tolist() == [2, 3, 1]
    assert cube.labels == ("b", "c", "a")
    assert [w.wcs.crval[0] for w in cube.epoch_wcs] == [1, 2, 0]
    assert [m["k"] for m in cube.epoch_meta] == [1, 2, 0]


def test_bad_arguments():
    for changes, message in [
        ({"data": np.ones((8, 12))}, r"shape \(n_epochs, ny, nx\), got"),
        ({"data": np.ones((3, 8, 12)) * 1j}, "complex128"),
        ({"data": np.full((3, 8, 12), np.nan), "labels": list("abc")},
         "a: no valid pixel; leave this epoch"),
        ({"unit": "furlong/beam"}, "'furlong/beam' is not one that"),
        ({"times": []}, "3 epochs need 3 times"),
        ({"times": np.arange(900.0)}, "got ndarray of float64; of numbers make Time"),
        ({"times": Time(DATES, scale="local")}, "scale 'local', which has no relation"),
        ({"times": None}, "needs data, times and wcs; EpochCube.from_arrays"),
        ({"times": MISSING}, "times has missing values"),
        ({"mask": np.ones((8, 12), bool)}, r"mask has shape \(8, 12\)"),
        ({"noise": [1, 2] * JY_BEAM}, "3 epochs need 3 noises"),
        ({"noise": -1 * JY_BEAM}, "finite and not negative"),
        ({"wcs": WCS(naxis=2)}, "wcs must have celestial axes"),
        ({"wcs": celestial(ctype=["DEC--SIN", "RA---SIN"])}, "latitude on its first"),
    ]:  # fmt: skip
        good = {"data": images(), "times": DATES, "wcs": celestial(), "unit": JY_BEAM}
        with pytest.raises((TypeError, ValueError), match=message) as caught:
            EpochCube(**{**good, **changes})
        assert "\n" not in str(caught.value)


def test_from_arrays_and_axes_that_are_not_celestial():
    position = SkyCoord("12h29m06.7s +02d03m08.6s")
    cube = make_cube(reference_pixel=(2, 3), position=position)
    assert (cube.reference_pixel, make_cube().reference_pixel) == ((2, 3), (5.5, 3.5))
    assert SkyCoord(*cube.wcs.wcs.crval * u.deg).separation(position) < 1e-9 * u.deg
    assert np.allclose(cube.pixel_matrix.value, [[-0.1, 0], [0, 0.1]])
    assert make_cube(1)._repr_html_().startswith("<p>EpochCube 1 epoch 2001-01-01")


def test_epochs_are_images_and_some_of_them_a_cube():
    cube = make_cube(beams=DIFFERENT, noise=[1, 2, 3] * JY_BEAM)
    image = cube[1]
    assert (image.unit, image.wcs.naxis) == (JY_BEAM, 2)
    assert np.array_equal(image.data, cube.data[1])
    assert np.array_equal(image.mask, cube.mask[1])
    assert image.meta["BMAJ"] == pytest.approx(3 / 3.6e6)
    for some in (slice(1, 3), [False, True, True], np.array([2, 1]), [1, -1]):
        part = cube[some]
        assert np.array_equal(part.data, cube.data[1:])
        assert (part.beams, part.labels) == (cube.beams[1:], cube.labels[1:])
        assert np.array_equal(part.noise, cube.noise[1:])
        assert (part.times == cube.times[1:]).all()
    for none, error, words in (
        (3, IndexError, "epoch 3 of a cube with 3 epochs"),
        ((0, slice(1, 3)), TypeError, "index epochs only"),
        ([False] * 3, ValueError, "holds none of 3 epochs"),
    ):
        with pytest.raises(error, match=words):
            cube[none]


@settings(max_examples=15)
@given(st.floats(-180, 180), st.booleans(), st.floats(-50, 50), st.floats(-50, 50))
def test_offsets_are_those_of_the_sky_and_have_an_inverse(angle, flipped, x, y):
    turn = np.radians(angle)
    rotation = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    wcs = celestial(pc=rotation, cdelt=[1e-7 if flipped else -1e-7, 1e-7])
    cube = EpochCube(images(1), ["2000-01-01"], wcs)
    offset = cube.pixel_to_offset(x, y)
    assert np.allclose(cube.offset_to_pixel(*offset), (x, y), atol=1e-6)
    origin = SkyCoord(10 * u.deg, 20 * u.deg)
    true = u.Quantity(origin.spherical_offsets_to(cube.wcs.pixel_to_world(x, y)))
    assert u.allclose(offset, true, rtol=1e-5, atol=1e-5 * u.mas)
    assert u.allclose(u.Quantity(cube.offsets())[:, 4, 3], 0 * u.mas)


def test_read_sorts_and_lays_on_reference_pixels(make_fits):
    one, two = images(1, 16, 32, 1), images(1, 16, 32, 2)
    there = {"DATE_OBS": "2000-01-01", "CRVAL1": 187.25001, "BUNIT": "mJy/beam"}
    paths = [make_fits("a.fits", one), make_fits("b.fits", two, **there)]
    with pytest.warns(EpochWarning, match="a.fits: its reference pixel and that of b"):
        cube = EpochCube.read(paths)
    assert cube.labels == ("b.fits", "a.fits")
    # The unit is that of the first.
    assert cube.unit == u.mJy / u.beam
    assert np.allclose(cube.data, [two[0], 1e3 * one[0]], rtol=1e-12)
    assert [w.wcs.crval[0] for w in cube.epoch_wcs] == [187.25001, 187.25]
    assert cube.epochs["frequency"][0] == 15.4 * u.GHz
    history = ["2 FITS images, aligned on their reference pixels"]
    assert cube.meta == {"object": "3C273", "history": history}


def test_patterns_and_paths(make_fits, make_epochs, tmp_path, monkeypatch):
    paths = make_epochs({}, {}, {})
    # A file that is given twice counts once.
    again = f"{tmp_path}/../{tmp_path.name}/0.fits"
    assert find_files([paths[0], f"{tmp_path}/*.fits", again]) == paths
    monkeypatch.setenv("HOME", str(tmp_path))
    assert find_files("~/0.fits") == paths[:1]
    odd = tmp_path / "[1].fits"
    odd.write_bytes(paths[0].read_bytes())
    assert find_files(odd) == [odd]
    (tmp_path / "x").mkdir()
    both = [paths[0], make_fits("x/0.fits", DATE_OBS="2007-01-01")]
    assert EpochCube.read(both).labels == tuple(map(str, both))
    for name, error, words in (
        ([], FileNotFoundError, "no files were given"),
        *((path, TypeError, "paths must be names or a patt") for path in (5, [b"a"])),
    ):
        with pytest.raises(error, match=words):
            EpochCube.read(name)


def test_given_dates_and_beams_replace_those_of_headers(make_epochs):
    own = {"DATE_OBS": None, "BMAJ": -1.0}
    *paths, other = make_epochs(own, own, {})
    times = ["2001-01-01", "2000-01-01"]
    cube = EpochCube.read(paths, times=times, beams=ROUND)
    assert (cube.labels, cube.beams) == (("1.fits", "0.fits"), (ROUND, ROUND))
    given_ = {"times": ["2004-01-01", None], "beams": ROUND}
    with pytest.warns(EpochWarning, match="^2.fits: the beam .* given, 1 x 1 mas at"):
        cube = EpochCube.read([paths[0], other], **given_)
    assert cube.labels == ("2.fits", "0.fits")
    for options, words in (
        ({}, r"0.fits: no date of observation .*times="),
        ({"times": "2001-01-01"}, "1 dates for 2 images; give one for each"),
        ({"times": times, "beams": Beam(1 * u.uas, 1 * u.uas)}, "smaller than a pixel"),
        ({"frame": "sky"}, "frame = 'sky' must be one of offset, abs"),
    ):
        with pytest.raises(ValueError, match=words):
            EpochCube.read(paths, **options)
    with pytest.raises(ValueError, match="at least one image"):
        EpochCube.from_ccddata([])


# Leap seconds of the future are not known.
@pytest.mark.filterwarnings("ignore:.*dubious year")
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"DATE_OBS": "2198-01-01"}, "1.fits: is of 2198-01-01, when no image can"),
        ({"data": 1e4 * np.arange(512.0).reshape(16, 32)}, "1.fits: its peak is .* ti"),
        ({"OBJECT": "0430+052"}, "1.fits: shows 0430.052, at the same place"),
        ({"CDELT1": 1 / 3.6e7}, "1.fits: east is to the right, unlike in most"),
    ],
)  # fmt: skip
def test_what_is_odd_and_no_reason_to_refuse_is_a_warning(make_epochs, changes, words):
    names = {"OBJECT": "Unknown"}, {"OBJECT": "1226+023"}
    paths = make_epochs({}, changes, *names)
    with pytest.warns(EpochWarning) as caught:
        cube = EpochCube.read(paths)
    said = [str(warning.message) for warning in caught]
    # A mirror image is also on another grid.
    said = [text for text in said if "on another grid" not in text]
    assert (len(said), caught[0].filename, len(cube)) == (1, __file__, 4)
    assert re.search(words, said[0])


def test_the_order_of_days_and_months_is_that_of_the_series(make_epochs):
    paths = make_epochs({"DATE_OBS": "05/03/97"}, {"DATE_OBS": "06/03/97"})
    with pytest.warns(EpochWarning, match="0.fits, 1.fits: its date .* month/day"):
        EpochCube.read(paths)
    assert all("month/day" in problem for problem in inspect_epochs(paths)["problem"])
    # One date of which the order is known tells that of all.
    paths += make_epochs({}, {}, {"DATE_OBS": "21/03/97"})[2:]
    paths[:2] = make_epochs({"DATE_OBS": "05/03/97"}, {"DATE_OBS": "06/03/97"})
    assert EpochCube.read(paths).times.isot[1][:10] == "1997-03-06"
    assert set(inspect_epochs(paths)["problem"]) == {""}


USUAL = {"FILTER": "F502N", "WAVELNTH": 171, "WAVEUNIT": "angstrom", "BAND": "L",
         "POLARIZ": "TOTAL", "BTYPE": "Intensity", "ENERGYLO": 500,
         "ENERGYHI": 2000}  # fmt: skip
#: Changes of an image that belongs to other images, and how it is named.
STRANGERS = [
    ({"WAVELNTH": 193}, "is of the wavelength .WAVELNTH. 193 angstrom, others are of "
     "171 angstrom; leave it out"),
    ({"ENERGYLO": 2000}, "is of energies .ENERGYLO. from 2000, others are of 500"),
    ({"ENERGYHI": 7000}, "is of energies .ENERGYHI. up to 7000, others are of 2000"),
    ({"BAND": "X"}, "is of the band X, others are of L"),
    ({"POLARIZ": 60.0}, "is of the polarisation .POLARIZ. 60.0, others are of TOTAL"),
    ({"BTYPE": "Beam"}, "is of the type .BTYPE. Beam, others are of Intensity"),
    ({"FILTER": None, "FILTER1": "CLEAR1L", "FILTER2": "F658N"}, "is of the filter F6"),
    ({"PUPIL": "F470N"}, "is of the filter F502N . F470N, others are of F502N"),
    ({"CTYPE3": None, "FREQ": 43e9}, "is at 43 GHz, others are at 15.4; leave"),
]  # fmt: skip
VELOCITY = {"CTYPE3": "VRAD", "CUNIT3": "m/s", "CDELT3": 1e3, "CRVAL3": 1e5}
#: Changes that are named and not refused.
NEIGHBOURS = [
    (VELOCITY | {"CRVAL3": 2e5}, "is of the channel VRAD 200000 m/s, others are of VR"),
    (
        {"CRVAL3": 15.43e9},
        "is at 15.43 GHz, as are 1 more, others are at 15.4, in the same band",
    ),
    ({"OBSRVTRY": "STEREO_B"}, "OBSRVTRY. STEREO_B, others are of STEREO_A; leave it"),
]


@pytest.mark.parametrize(("changes", "words"), NEIGHBOURS)
def test_images_of_a_neighbouring_channel_are_named(make_epochs, changes, words):
    usual = VELOCITY if "VRAD" in words else {"OBSRVTRY": "STEREO_A"}
    paths = make_epochs(usual, usual, usual, changes, changes)
    named = "3.fits" if "as are" in words else "3.fits, .*4.fits"
    with pytest.warns(EpochWarning, match=f"{named}: .*{words}") as caught:
        assert len(EpochCube.read(paths)) == 5
    assert len(caught) == 1
    words = words.partition(";")[0].removeprefix("OBSRVTRY. ")
    assert words in inspect_epochs(paths)["problem"][3]


def test_files_of_something_else_are_named(make_epochs):
    for changes, frame, words, unchecked in [
        ({"OBJECT": "3C120", "CRVAL1": 68.0}, "offset", "shows 3C120, somewhere else, "
         "where others show 3C273; leave it out .in Python, check=False reads it.", 1),
        *((own, "offset", words, 1) for own, words in STRANGERS),
        ({"data": images(1, 16, 32) > 0}, "offset", "has no more than two diff", 1),
        ({"BMAJ": None}, "offset", "no beam where other epochs have one; wr", 1),
        ({"DATE_OBS": "2000-01-01"}, "offset", "is of 2000-01-01, as is 0.fits", 1),
        ({"BUNIT": None}, "offset", "its unit is none, that of others is Jy / beam", 0),
        ({"CDELT1": -1e-6, "CDELT2": 1e-6}, "offset",
         "its pixels are 3.6 mas where others are 0.1 mas", 0),
        ({"CRVAL1": 188.0}, "absolute", "lies too far from .*0.fits", 0),
    ]:  # fmt: skip
        data = changes.get("data", images(1, 16, 32)).astype(float)
        paths = make_epochs(USUAL, USUAL, USUAL | changes | {"data": data})
        with pytest.raises(ValueError, match=f"2.fits: .*{words}") as caught:
            EpochCube.read(paths, frame=frame)
        assert "\n" not in str(caught.value)
        if unchecked:
            with warnings.catch_warnings(record=True, action="always") as caught:
                cube = EpochCube.read(paths, check=False)
            assert (len(cube), cube.beams is None) == (3, "BMAJ" in changes)
            # A beam is not lost, and a date is not doubled, without a word.
            for name, said in (("BMAJ", "s: no beam where"), ("DATE_OBS", "two ima")):
                if name in changes:
                    assert said in str(caught[0].message)


def gaussian(ny, nx, x0, y0, width=3.0):
    y, x = np.indices((ny, nx))
    return np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * width**2))


def test_absolute_coordinates_are_trusted_when_asked(make_epochs):
    data, step = gaussian(32, 48, 20, 15), 0.1 / 3.6e6
    here = {"data": data, "CRPIX1": 21.0, "CRPIX2": 16.0, "CRVAL2": 0.0}
    east, half = {"CRVAL1": 187.25 + 2 * step}, {"CRVAL2": 2.5 * step}
    paths = make_epochs(here, here | east, here | half)
    assert np.ptp(EpochCube.read(paths[:2]).data, axis=0).max() == 0
    with pytest.warns(EpochWarning, match=r"2.fits: on another grid"):
        cube = EpochCube.read(paths, frame="absolute")
    assert "absolute coordinates" in cube.meta["history"][0]
    y, x = np.indices(cube.shape[1:])
    filled = np.where(cube.mask, 0, cube.data)
    centres = [[np.sum(i * x), np.sum(i * y)] / np.sum(i) for i in filled]
    assert np.allclose(centres - centres[0], [[0, 0], [-2, 0], [0, 2.5]], atol=0.05)


def test_epochs_of_0003(shared_data):
    cube = EpochCube.read(f"{shared_data}/0003+380/*.fits")
    assert (cube.shape, cube.reference_pixel) == ((10, 256, 256), (127, 128))
    assert cube.times[0].isot[:10] == "2006-03-09"
    assert cube.beams[0].major.to_value(u.mas) == pytest.approx(1.084, abs=1e-3)
    paths = sorted((shared_data / "0003+380").glob("*.fits"))
    published = [fits.getval(path, "NOISE") for path in paths]
    assert np.allclose(cube.noise_rms().value, published, rtol=0.1)


YEARS = Time(["2000-01-01", "2000-07-01", "2001-01-01", "2002-01-01"])


def test_every_problem_is_named_and_nothing_raises(make_fits, tmp_path):
    fields = {"times": YEARS[:1], "pixel_scale": 1 * u.mas}
    EpochCube.from_arrays(np.ones((1, 4, 4)), **fields).write(tmp_path / "cube.fits")
    (tmp_path / "folder.fits").mkdir()
    # Changes of an image, if there is one, and what is said of it.
    files = {
        "good": ({}, ""),
        "date": ({"DATE_OBS": None}, "no date of observation"),
        "beam": ({"DATE_OBS": "2008-01-01", "BMAJ": None}, "no beam where other epoc"),
        "bad_beam": ({"DATE_OBS": "2009-01-01", "BMAJ": -1.0}, "is taken as unknown"),
        "unit": ({"DATE_OBS": "2010-01-01", "BUNIT": "ODD"}, "unit 'ODD' is not known"),
        "mask": ({"DATE_OBS": "2014-01-01", "data": np.eye(16, 32)}, "two different v"),
        "coarse": ({"DATE_OBS": "2011-01-01", "CDELT1": -1e-7, "CDELT2": 1e-7},
                   "on another grid than good.fits, the finest, and resampled"),
        "far": ({"DATE_OBS": "2013-01-01", "CRVAL2": 2.1},
                "its reference pixel and that of good.fits are 180 arcsec"),
        "nan": ({"data": np.full((4, 4), np.nan)}, "all are NaN"),
        "folder": (None, "is a directory"),
        "missing": (None, "no such file"), "cube": (None, "is a whole EpochCube"),
    }  # fmt: skip
    paths = {name: tmp_path / f"{name}.fits" for name in files}
    for name, (changes, _) in files.items():
        if changes is not None:
            make_fits(f"{name}.fits", **changes)
    table = inspect_epochs(paths.values())
    found = dict(zip(table["file"], table["problem"], strict=True))
    for name, (_, text) in files.items():
        problem = found[str(paths[name])]
        assert text in problem, name
        assert "\n" not in problem
    assert found[str(paths["good"])] == ""
    assert "its unit is none, that of others is Jy" in found[str(paths["unit"])]
    assert (table["date"].mask.sum(), np.isnan(table["noise"]).sum()) == (5, 5)
    # Two epochs of the same pixels.
    data = np.random.default_rng(1).normal(size=(4, 8, 8))
    data[3], data[2] = data[1], data[0]
    said = repeated(EpochCube.from_arrays(data, YEARS, pixel_scale=1 * u.mas))
    assert said[1].startswith("2002-01-01: has the same pixels as 2000-07-01, of ano")


def test_plans_that_cannot_be_made():
    fields = {"pixel_scale": 0.1 * u.mas, "beams": Beam(1 * u.mas, 0.5 * u.mas)}
    cube = EpochCube.from_arrays(np.ones((4, 100, 120)), YEARS, **fields)
    plan = plan_intervals(cube)
    assert "4 epochs over 2 yr, 0.498 to 0.999 yr apart" in str(plan)
    for speed, words in ((0, "must be positive"), (0.05, "nothing moves 0.3 of a bea")):
        with pytest.raises(ValueError, match=words):
            plan.baseline(speed * u.mas / u.yr)
