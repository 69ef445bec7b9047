# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What headers tell, also those that archives have."""

import re
import warnings
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.epochs import Beam, EpochCube, inspect_epochs
from astro_scc.images.dates import observing_time
from astro_scc.images.fits import read_header, read_plane
from astro_scc.images.headers import (
    celestial_wcs,
    contradicting_matrices,
    parse_unit,
)
from astro_scc.images.positions import axis_words, name_by_frame, sky_columns
from astro_scc.quantities import parse_date

DAY = "2006-03-09T00:00:00.000"
BEAM = Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg)


def header_beam(header, tables=()):
    return read_header(header, tables)["beam"]


def test_dates_of_all_sorts():
    for text, expected in [
        *((text, DAY) for text in (
            " 2006-03-09 ", "2006-03-09Z", "2006-3-9", "20060309", "2006 Mar 9")),
        ("2006-03-09T12:34:56.789012", "2006-03-09T12:34:56.789"),
        *((f"2006-03-09{end}", "2006-03-09T12:34:56.000") for end in (
            " 12:34:56 UTC", "T12:34:56+00:00")),
        ("2006.500", "2006-07-02T12:00:00.000"),
        ("21/03/95", "1995-03-21T00:00:00.000"),
        ("21/03/05", "2005-03-21T00:00:00.000"),
        ("2016-12-31T23:59:60", "2016-12-31T23:59:60.000"),
        *((text, None) for text in (
            "", "yesterday", "2006-02-30", "31/31/95", "2006.2")),
    ]:  # fmt: skip
        if expected is not None:
            assert parse_date(text).isot == expected
        else:
            with pytest.raises(ValueError, match="is no date; write it as 2006-03-09"):
                parse_date(text)


def test_units():
    for text, unit in [
        *((text, u.Jy / u.beam) for text in ("JY/BEAM", "jy / bm", "JY PER BEAM")),
        ("mJy/beam", u.mJy / u.beam), ("JY/PIXEL", u.Jy / u.pix), ("COUNTS", u.ct),
        ("counts / pixel", u.ct / u.pix), ("ELECTRONS/S", u.electron / u.s),
        ("K", u.K), ("MJy/sr", u.MJy / u.sr), ("MJY/SR", u.MJy / u.sr), (u.Jy, u.Jy),
        *((none, u.one) for none in ("", None)),
        *((odd, None) for odd in ("MJY/BEAM", "furlongs", "(((")),
    ]:  # fmt: skip
        assert parse_unit(text) == unit, text


def test_beam_from_the_header(aips_header):
    assert header_beam(aips_header()) == BEAM
    round_ = header_beam(aips_header(BMIN=None, BPA=None))
    assert round_ == Beam(1 * u.mas, 1 * u.mas)
    turned = header_beam(aips_header(BMAJ=0.5 / 3.6e6, BMIN=1 / 3.6e6))
    assert turned == Beam(1 * u.mas, 0.5 * u.mas, 83 * u.deg)
    assert header_beam({"beam": BEAM}) is BEAM
    for none in (None, 0.0):
        assert header_beam(aips_header(BMAJ=none)) is None
    odd = "BPA is missing or no number, and BMA"
    few = "not positive"
    for wrong, words in (
        *(({"BPA": lost}, odd) for lost in (None, "abc", np.nan)),
        ({"BMAJ": -1e-7}, few), ({"BMIN": 0}, few), ({"BMIN": -1}, few),
    ):  # fmt: skip
        record = read_header(dict(aips_header()) | wrong)
        assert record["beam"] is None
        assert words in record["beam_problem"]


def test_beam_from_the_history(aips_header):
    header = aips_header(BMAJ=None, BMIN=None, BPA=None)
    header.add_history("AIPS   IMAGR BMAJ= 9 BMIN= 9 BPA= 9")
    for major in ("3.0000E-07", "2.7778D-07"):
        header.add_history(f"AIPS   CLEAN BMAJ=  {major} BMIN= 1.3889E-07 BPA=  -7.00")
    header.add_history("AIPS   CLEAN NITER=      490 PRODUCT=1   / NORMAL")
    lines = {"HISTORY": [str(line) for line in header["HISTORY"]]}
    for own in (header, lines):
        found = header_beam(own)
        assert found.major.value == pytest.approx(1, rel=1e-4)
        assert found.pa == BEAM.pa
    assert header_beam({"HISTORY": "AIPS CLEAN BMAJ= 0.0 BMIN= 0.0 BPA= 0.0"}) is None


def test_beam_from_a_table(aips_header):
    for name, unit, scale in (
        ("AIPS CG", "DEGREES", 1 / 3.6e6),
        ("BEAMS", "ARCSECS", 1 / 1e3),
        ("BEAMS", None, 1 / 3.6e6),
    ):
        values = {"BMAJ": (unit, scale), "BMIN": (unit, scale / 2), "BPA": ("deg", -7)}
        pairs = values.items()
        columns = [fits.Column(k, "1E", unit=w, array=[v]) for k, (w, v) in pairs]
        tables = [fits.BinTableHDU.from_columns(columns, name=n) for n in ("CC", name)]
        beam = header_beam(aips_header(BMAJ=None), tables)
        assert [beam.major.value, beam.minor.value] == pytest.approx([1, 0.5], rel=1e-6)
    assert header_beam(aips_header(BMAJ=2 / 3.6e6), tables).major > 1.5 * u.mas


def test_repaired_headers_give_the_same_wcs_and_warn_of_nothing(aips_header):
    scale = 0.1 / 3.6e6
    for changes in [
        {},
        {"CTYPE2": "DEC---SIN"},
        {"CTYPE1": "RA--SIN", "CTYPE2": "DEC-SIN"},
        {"CTYPE1": "RA", "CTYPE2": "DEC"},
        {"CUNIT1": "DEGREES", "CUNIT2": "degree"},
        {"CUNIT1": "Arcseconds", "CUNIT2": "asec", "CDELT1": -1e-4, "CDELT2": 1e-4,
         "CRVAL1": 187.25 * 3600, "CRVAL2": 2.05 * 3600},
        {"DATE_OBS": "nonsense"},
        {"RADESYS": "GAPPT"},
    ]:  # fmt: skip
        with warnings.catch_warnings(action="error"):
            wcs = celestial_wcs(aips_header(**changes))
        assert list(wcs.wcs.ctype) == ["RA---SIN", "DEC--SIN"]
        expected = [[-scale, 0], [0, scale]]
        assert np.allclose(wcs.pixel_scale_matrix, expected, rtol=1e-12)
        assert [*wcs.wcs.crpix, *wcs.wcs.crval] == [16, 9, 187.25, 2.05]


TURN = {"PC1_1": 0.8, "PC1_2": 0.6, "PC2_1": -0.6, "PC2_2": 0.8}
ANGLE = np.degrees(np.arcsin(0.6))
STEPS = {"CD1_1": -1e-5, "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": 1e-5}
#: Cards, whether they turn the image, and a remark.
ROTATIONS = [
    (TURN, True, ""),
    *(({key: ANGLE}, True, "") for key in ("CROTA2", "CROTA1", "CROTA", "SC_ROLL")),
    # What the standard has counts.
    ({"CROTA2": 0.0, "SC_ROLL": ANGLE}, False, ""),
    (TURN | {"CROTA2": round(ANGLE, 1), "SC_ROLL": 5.0}, True, ""),
    (STEPS | {"CROTA2": 0.0, "CDELT1": 1.0, "CDELT2": 1.0}, False, ""),
    (TURN | {"CROTA2": -ANGLE}, True, "its PC and CROTA are of different scales or d"),
    (STEPS | {"CROTA2": ANGLE}, False, "its CD and CROTA are of different .* and CD "),
    (TURN | STEPS, True, "its PC and CD are of different scales .* and PC is taken; r"),
]


@pytest.mark.parametrize(("cards", "turned", "remark"), ROTATIONS)
def test_the_rotation_wherever_it_is(aips_header, cards, turned, remark):
    header = aips_header(CDELT1=-1e-5, CDELT2=1e-5, CROTA1=None, CROTA2=None)
    header.update(cards)
    matrix = celestial_wcs(header).pixel_scale_matrix / 1e-5
    wanted = [[-0.8, -0.6], [-0.6, 0.8]] if turned else [[-1, 0], [0, 1]]
    assert np.allclose(matrix, wanted, atol=1e-9)
    said = contradicting_matrices(header)
    assert re.match(remark, said)
    assert bool(said) == bool(remark)


def test_coordinates_of_older_images_of_the_sun(aips_header):
    axes = {"CTYPE1": "solar_x", "CTYPE2": "SOLAR-Y"}
    wcs = celestial_wcs(aips_header(**axes, CUNIT1="arcsec", CUNIT2="arcsec"))
    assert list(wcs.wcs.ctype) == ["HPLN-TAN", "HPLT-TAN"]


def test_unusable_coordinates_are_refused_in_one_line(aips_header):
    for changes, message in [
        ({"CTYPE1": "RA---XYZ", "CTYPE2": "DEC--XYZ"}, "cannot be read"),
        ({"CD1_1": 0.0, "CD2_2": 1e-7, "CDELT1": None}, "no pixel scale"),
        ({"PC1_1": 1.0, "PC1_2": 1.0, "PC2_1": 1.0, "PC2_2": 1.0}, "axes are parallel"),
        ({"RADESYS": "MYFRAME"}, "RADESYS = 'MYFRAME' is no frame; write ICRS, FK5"),
        ({"CRPIX1": "here"}, "CRPIX1 = 'here' is not a finite number"),
        ({"CTYPE1": "DEC--SIN", "CTYPE2": "RA---SIN"}, "transpose the image"),
    ]:
        with pytest.raises(ValueError, match=message) as caught:
            celestial_wcs(aips_header(**changes))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("terms", [{}, {"PV1_1": 1.0, "PV1_4": 0.02, "PV2_1": 1.0}])
def test_polynomials_are_of_degrees(aips_header, terms):
    """Whether the pixel scale is in CDELT or in the matrix, and without terms."""
    changes = {"CTYPE1": "RA---TPV", "CTYPE2": "DEC--TPV", **terms}
    steps = {"CD1_1": -1e-5, "CD2_2": 1e-5, "CDELT1": None, "CDELT2": None}
    one = celestial_wcs(aips_header(**changes, CDELT1=-1e-5, CDELT2=1e-5))
    other = celestial_wcs(aips_header(**changes, **steps))
    places = np.array([[0, 30, 900.0], [0, 10, 500.0]])
    found = [np.array(wcs.pixel_to_world_values(*places)) for wcs in (one, other)]
    assert np.allclose(*found, rtol=0, atol=1e-12)
    plain = celestial_wcs(aips_header(CTYPE1="RA---TAN", CTYPE2="DEC--TAN", **steps))
    away = np.abs(found[0] - plain.pixel_to_world_values(*places)).max()
    assert away < (1e-5 if terms else 1e-12)


def in_frame(*ctype):
    return SimpleNamespace(wcs=WCS({"CTYPE1": ctype[0], "CTYPE2": ctype[1]}))


def test_words_of_the_axes_and_columns_named_by_them():
    assert axis_words(in_frame("XLON-CAR", "XLAT-CAR"))[0] == "larger longitude"
    table = QTable({"pm_ra_cosdec": [1.0], "pm_dec_err": [0.1], "east": [2.0]})
    table["east"].info.description = "offset to the east"
    assert name_by_frame(table, in_frame("RA---SIN", "DEC--SIN")) is table
    name_by_frame(table, in_frame("HPLN-TAN", "HPLT-TAN"))
    assert table.colnames == ["pm_lon_coslat", "pm_lat_err", "lon_offset"]
    assert table["lon_offset"].info.description == "offset to solar west"
    assert sky_columns(table) == ("pm_lon_coslat", "pm_lat")


SHAPE = (24, 36)
PIXELS = np.random.default_rng(1).normal(size=SHAPE)
ARCSEC = 1 / 3600


def sky(scale=0.05, **changes):
    return {
        "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN",
        "CRVAL1": 83.0, "CRVAL2": 22.0, "CRPIX1": 18.0, "CRPIX2": 12.0,
        "CDELT1": -scale * ARCSEC, "CDELT2": scale * ARCSEC, **changes,
    }  # fmt: skip


def cd():
    own = sky()
    steps = own.pop("CDELT1"), own.pop("CDELT2")
    return own | {"CD1_1": steps[0], "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": steps[1]}


def image(cards, pixels=PIXELS, name=None):
    made = fits.ImageHDU(pixels) if name else fits.PrimaryHDU(pixels)
    made.header.update(cards)
    if name:
        made.name = name
    return made


SCI = PIXELS.astype("f4")
WEIGHT = np.where(PIXELS > 2, 0, 1).astype("f4")
FLAGS = np.where(PIXELS > 2, 4096, 0).astype("i2")
#: HDUs; and the date, unit, filter and number of bad pixels.
HEADERS = {
    "HST flt": (
        [image({"TELESCOP": "HST", "INSTRUME": "WFC3", "TARGNAME": "HH1",
                "FILTER": "F164N", "DATE-OBS": "2016-04-05", "TIME-OBS": "06:07:08",
                "EXPSTART": 57483.25495370, "EXPEND": 57483.26189815,
                "EXPTIME": 600.0}, None),
         image({"BUNIT": "ELECTRONS/S", **cd()}, SCI, "SCI"),
         image({"BUNIT": "ELECTRONS/S"}, SCI * 0 + 0.1, "ERR"),
         image({}, FLAGS, "DQ"), image({}, FLAGS * 0 + 9, "SAMP"),
         image({}, SCI * 0 + 600, "TIME")],
        ("2016-04-05T06:12:08", u.electron / u.s, "F164N", 15)),
    "JWST i2d": (
        [image({"TELESCOP": "JWST", "INSTRUME": "NIRCAM", "TARGNAME": "HH 211",
                "FILTER": "F444W", "PUPIL": "F470N", "DATE-OBS": "2022-08-28",
                "TIME-OBS": "17:02:17.123", "DATE-BEG": "2022-08-28T17:02:17.123",
                "TIMESYS": "UTC", "EFFEXPTM": 600.0}, None),
         image({"BUNIT": "MJy/sr", "MJD-BEG": 59819.71, "MJD-AVG": 59819.713667,
                **sky(scale=0.063, PC1_1=1.0, PC2_2=1.0)}, SCI, "SCI"),
         image({"BUNIT": "MJy/sr"}, SCI * 0 + 0.1, "ERR"), image({}, FLAGS, "CON"),
         image({}, WEIGHT, "WHT"), image({}, WEIGHT, "VAR_POISSON"),
         image({}, WEIGHT, "VAR_RNOISE"), image({}, WEIGHT, "VAR_FLAT")],
        ("2022-08-28T17:07:40.829", u.MJy / u.sr, "F444W + F470N", 15)),
}  # fmt: skip


@pytest.mark.parametrize("name", HEADERS)
def test_headers_of_archives(tmp_path, name):
    hdus, expected = HEADERS[name]
    path = tmp_path / "a.fits"
    fits.HDUList(hdus).writeto(path, output_verify="ignore")
    plane = read_plane(path)
    date, unit, wheel, bad = expected
    assert abs((plane.time - Time(date)).to_value(u.s)) < 2e-3
    assert (plane.unit, plane.beam) == (unit, None)
    assert (plane.facts.get("filter"), plane.mask.sum()) == (wheel, bad)
    assert np.allclose(plane.data, PIXELS, atol=1e-6)


#: 2015-06-18T14:24:00, and the middle of an exposure of 10 minutes from then on.
MJD = 57191.6
START, MIDDLE = "2015-06-18T14:24:00.000", "2015-06-18T14:29:00.000"
MIDNIGHT = "2015-06-18T00:00:00.000"
DATE = {"DATE-OBS": "2015-06-18"}
EXPOSURES = np.random.default_rng(1).normal(size=(3, 16, 32))
CLOCK = {"DATE-OBS": "2015-06-18T14:24:00"}

#: Cards, and the date that they tell.
DATES = [
    # The day alone, and the time of day elsewhere.
    (DATE, MIDNIGHT),
    (DATE | {"MJD-OBS": MJD}, START),
    ({"DATE-OBS": "2015-06-17", "TIME-OBS": "24:00:00"}, MIDNIGHT),
    ({"DATE-OBS": "2016-12-31T24:00:00", "EXPTIME": 600.0}, "2017-01-01T00:05:00.000"),
    ({"DATE_OBS": "2015/06/18", "TIME_OBS": "14:24"}, START),
    (DATE | {"TM-START": 51840}, START),
    (DATE | {"UT": ("14.4", "[h] start")}, START),
    # Several: the most precise one.
    (DATE | {"TIME-OBS": "14:24", "UT": "14:24:30"}, "2015-06-18T14:24:30.000"),
    (CLOCK | {"MJD-OBS": MJD + 0.4 / 86400}, "2015-06-18T14:24:00.400"),
    (DATE | {"UT": (14.4, "[s] start")}, "2015-06-18T00:00:14.400"),
    (DATE | {"UT": "77:00:00"}, MIDNIGHT),
    # What is no time of the day, or is of another time, does not count.
    (DATE | {"TIME-OBS": "142400.5"}, "2015-06-18T14:24:00.500"),
    (DATE | {"JD": 57192.1}, MIDNIGHT),
    (CLOCK | {"UT": "09:00:00"}, START),
    # The middle of the exposure.
    (CLOCK | {"EXPTIME": 600.0}, MIDDLE),
    (CLOCK | {"EXPTIME": (600e3, "exposure (ms)")}, MIDDLE),
    # The sum of many exposures.
    (CLOCK | {"EXPTIME": 1e6}, START),
    (CLOCK | {"DATE-END": "2015-06-18T14:34:00"}, MIDDLE),
    ({"EXPSTART": MJD, "EXPEND": MJD + 600 / 86400}, MIDDLE),
    ({"DATE-BEG": START, "DATE-AVG": MIDDLE, "DATE-END": "2015-06-18"}, MIDDLE),
    (CLOCK | {"DATE-AVG": "2015-06-18"}, START),
    (DATE | {"DATE-AVG": "2015-06-18T14:29:00"}, MIDDLE),
    (DATE | {"MJD-AVG": MJD + 300 / 86400, "EXPTIME": 99.0}, MIDDLE),
    (CLOCK | {"DATE-AVG": "2015-06-20T14:29:00"}, START),
    # Of long ones the time of the day does not matter.
    ({"DATE-OBS": "2015-06-08", "DATE-END": "2015-06-28"}, MIDNIGHT),
    ({"DATE-OBS": "2015-06-08T00:00:00", "DATE-END": "2015-06-28T04:48:00"},
     "2015-06-18T02:24:00.000"),
    # The end alone.
    (DATE | {"DATE-END": "2015-06-18T14:34:00", "EXPTIME": 600.0}, MIDDLE),
    # Exposures that last beyond midnight.
    ({"DATE-OBS": "2015-06-17T23:59:00", "DATE-AVG": "2015-06-18T00:04:00.5"},
     "2015-06-18T00:04:00.500"),
    # Other scales of time.
    ({"T_OBS": "2015.06.18_14:24:35.00_TAI"}, START),
    # The date at which a file was written is none.
    ({"DATE": "2022-07-29", "DATE-OBS": "", "DATE-BEG": "2015-06-18"}, MIDNIGHT),
    ({"MJD-OBS": MJD + 67.184 / 86400, "TIMESYS": "TT"}, START),
]  # fmt: skip


@pytest.mark.parametrize(("cards", "expected"), DATES)
def test_the_most_precise_date_counts(cards, expected):
    header = fits.Header()
    for key, value in cards.items():
        header[key] = value
    # Of a dict, which has no comments, keys may be in lower case.
    plain = {key.lower(): value for key, value in header.items()}
    commented = any(isinstance(value, tuple) for value in cards.values())
    for given in (header,) if commented else (header, plain):
        time, remark = observing_time(given)
        assert abs((time - Time(expected)).to_value(u.s)) < 2e-5
        assert (time.scale, remark) == ("utc", "")


#: Cards of which no date is made, or one of which doubts are told.
DOUBTS = [
    ({"DATE-OBS": "soon"}, None, "DATE-OBS: 'soon' is no date"),
    *(({"DATE-OBS": d}, None, "is no date") for d in ("2004-11", "2004-121", "200412")),
    ({"DATE-OBS": "2015-06-18T24:00:01"}, None, "'2015-06-18T24:00:01' is no date"),
    ({"MJD-OBS": 457191.6}, None, "MJD-OBS: 457191.6 is no (modified) Julian date; w"),
    (DATE | {"MJD-OBS": 50000.25}, MIDNIGHT, "is of 2015-06-18, which is taken, and "
     "MJD-OBS is of 1995-10-10"),
    (DATE | {"UT": 14.4}, MIDNIGHT, "its UT = 14.4 may be hours or seconds and is lef"),
    (DATE | {"TIME-OBS": 14.4}, "2015-06-18T00:00:14.400", "its TIME-OBS = 14.4 may be "
     "hours or seconds and is seconds; write it as"),
    ({"DATE-OBS": "05/03/97"}, "1997-03-05T00:00:00.000", "and may be month/day/year;"),
    (CLOCK | {"TIMESYS": "MST"}, START, "its time scale TIMESYS = MST is not known and "
     "taken for UTC"),
]  # fmt: skip


@pytest.mark.parametrize(("cards", "expected", "words"), DOUBTS)
def test_dates_of_which_there_are_doubts(cards, expected, words):
    record = read_header(fits.Header(cards))
    assert (record["time"] and record["time"].isot) == expected
    assert words in record.get("date_problem", "") + "".join(record["remarks"])


def test_the_same_date_and_the_same_exposure(make_epochs):
    for clocks, pixels, refused in [
        ((1, 1, 9), (0, 1, 2), True), ((1, 1.004, 9), (0, 0, 1), True),
        # Other pixels, or other dates.
        ((1, 1.004, 9), (0, 1, 2), False), ((1, 3, 9), (0, 0, 0), False),
    ]:  # fmt: skip
        dates = [f"2015-06-18T10:00:0{clock}" for clock in clocks]
        own = zip(dates, EXPOSURES[[*pixels]], strict=True)
        paths = make_epochs(*({"data": data, "DATE_OBS": text} for text, data in own))
        if refused:
            words = "1.fits: is of 2015-06-18T10:00:01, as is 0.fits"
            with pytest.raises(ValueError, match=words):
                EpochCube.read(paths)
        else:
            assert len(EpochCube.read(paths)) == 3


def cube(path, *, table=None, shape=(4, 16, 32), **changes):
    """A cube with an axis of time, which starts at 10 h."""
    header = fits.Header({
        "DATE-OBS": "2015-06-18T10:00:00", "BUNIT": "DN", "CTYPE1": "HPLN-TAN",
        "CTYPE2": "HPLT-TAN", "CDELT1": 1e-4, "CDELT2": 1e-4, "CRPIX1": 16.0,
        "CRPIX2": 8.0, "CTYPE3": "TIME", "CRVAL3": 0.0, "CDELT3": 10.0, "CRPIX3": 1.0,
        "CUNIT3": "s", **changes,
    })  # fmt: skip
    for key in [key for key, value in changes.items() if value is None]:
        del header[key]
    pixels = np.random.default_rng(1).normal(size=shape)
    hdus = [fits.PrimaryHDU(pixels, header)]
    if table is not None:
        hdus.append(fits.BinTableHDU.from_columns([table], name="TIMES"))
    fits.HDUList(hdus).writeto(path, overwrite=True)
    return pixels


SECONDS = [0.0, 10, 20, 30]
HOURS = [0, 3600, 7200, 10800]
DAYS = {"CRVAL3": 57191 + 10 / 24, "CDELT3": 1 / 24}
UNEVEN = np.array([0.0, 10, 25, 31])
#: Changes of the cube, and the seconds of its images after 10 h.
CUBES = [
    ({}, SECONDS),
    ({"CTYPE3": "UTC", "CUNIT3": "min", "CDELT3": 0.5}, [0, 30, 60, 90]),
    ({"CUNIT3": None, "TIMEUNIT": "min", "CDELT3": 0.5}, [0, 30, 60, 90]),
    (DAYS | {"CUNIT3": "d", "MJDREF": 0.0, "DATE-OBS": None}, HOURS),
    ({"JDREF": 2457191.5, "CRVAL3": 36000.0}, SECONDS),
    (DAYS | {"CTYPE3": "JD", "CUNIT3": None, "CRVAL3": 2457191.5 + 10 / 24}, HOURS),
    ({"CRVAL3": 57191 * 86400.0 + 36000}, SECONDS),
    ({"CTYPE3": "TAI", "CUNIT3": "s", "MJDREF": 57191.0, "CRVAL3": 36035.0}, SECONDS),
    # GPS time was ahead of UTC by 16 s, wherever the times count from.
    *(({"TIMESYS": "GPS", "DATE-OBS": "2015-06-18T10:00:16", **own}, SECONDS) for own in
      ({}, {"DATEREF": "2015-06-18T09:00:16", "CRVAL3": 3600.0},
       {"MJDREF": 57191.0, "CRVAL3": 36016.0})),
    ({"CTYPE4": "STOKES", "CRVAL4": 1.0, "CDELT4": 1.0, "shape": (1, 4, 16, 32)},
     SECONDS),
    ({"CTYPE3": "FREQ", "CRVAL3": 1e9, "CUNIT3": "Hz", "CTYPE4": "TIME",
      "CDELT4": 10.0, "shape": (4, 1, 16, 32)}, SECONDS),
    # Tables of times.
    ({"table": fits.Column("TIME", "1D", unit="s", array=UNEVEN)}, UNEVEN),
    ({"table": fits.Column("MJD", "1D", array=57191 + (36000 + UNEVEN) / 86400)},
     UNEVEN),
    ({"table": fits.Column("DATE-OBS", "23A", array=[
        f"2015-06-18T10:00:{s:06.3f}" for s in UNEVEN])}, UNEVEN),
    ({"CTYPE3": "TIME-TAB", "PS3_0": "TIMES", "PS3_1": "FRAME", "CDELT3": None,
      "table": fits.Column("FRAME", "1D", unit="s", array=UNEVEN)}, UNEVEN),
    ({"table": fits.Column("TIME", "1D", unit="s", array=[1.0, 2])}, SECONDS),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "seconds"), CUBES)
def test_an_axis_of_time_has_epochs(tmp_path, changes, seconds):
    pixels = cube(tmp_path / "movie.fits", **changes).reshape(4, 16, 32)
    found = EpochCube.read(tmp_path / "movie.fits")
    after = (found.times - Time("2015-06-18T10:00:00")).to_value(u.s)
    assert after == pytest.approx(np.asarray(seconds, dtype=float), abs=1e-4)
    assert np.array_equal(found.data, pixels)
    assert found.labels[3] == "movie.fits, image 4"
    table = inspect_epochs(tmp_path / "movie.fits")
    assert (len(table), set(table["problem"])) == (4, {""})


def test_axes_of_which_no_epochs_are_made(tmp_path):
    for changes, words in [
        ({"CDELT3": 0.0}, "has no step on axis TIME .CDELT3.; write it"),
        ({"CUNIT3": "m"}, "has the unit 'm' on axis TIME, which is no time; correct"),
        ({"DATE-OBS": None}, "has times on axis TIME and no date from which they coun"),
        ({"CTYPE3": "TIME-TAB"}, "has times in a table on axis TIME-TAB, which is not"),
    ]:
        cube(tmp_path / "movie.fits", **changes)
        with pytest.raises(ValueError, match=f"movie.fits: {words}"):
            EpochCube.read(tmp_path / "movie.fits")
        assert len(inspect_epochs(tmp_path / "movie.fits")["problem"][0]) > 20
