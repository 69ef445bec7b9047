# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What headers tell, also those that archives have."""

import warnings
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.epochs import Beam
from astro_scc.images.fits import read_header, read_plane
from astro_scc.images.headers import celestial_wcs, parse_unit
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


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        *((text, u.Jy / u.beam) for text in ("JY/BEAM", "jy / bm", "JY PER BEAM")),
        ("mJy/beam", u.mJy / u.beam), ("JY/PIXEL", u.Jy / u.pix), ("COUNTS", u.ct),
        ("counts / pixel", u.ct / u.pix), ("ELECTRONS/S", u.electron / u.s),
        ("K", u.K), ("MJy/sr", u.MJy / u.sr), ("MJY/SR", u.MJy / u.sr), (u.Jy, u.Jy),
        ("", u.one), (None, u.one),
        ("MJY/BEAM", None), ("furlongs", None), ("(((", None),
    ],
)  # fmt: skip
def test_units(text, unit):
    assert parse_unit(text) == unit


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


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"CTYPE2": "DEC---SIN"},
        {"CTYPE1": "RA--SIN", "CTYPE2": "DEC-SIN"},
        {"CTYPE1": "RA", "CTYPE2": "DEC"},
        {"CUNIT1": "DEGREES", "CUNIT2": "degree"},
        {"CUNIT1": "Arcseconds", "CUNIT2": "asec", "CDELT1": -1e-4, "CDELT2": 1e-4,
         "CRVAL1": 187.25 * 3600, "CRVAL2": 2.05 * 3600},
        {"DATE_OBS": "nonsense"},
        {"RADESYS": "GAPPT"},
    ],
)  # fmt: skip
def test_repaired_headers_give_the_same_wcs_and_warn_of_nothing(aips_header, changes):
    with warnings.catch_warnings(action="error"):
        wcs = celestial_wcs(aips_header(**changes))
    assert list(wcs.wcs.ctype) == ["RA---SIN", "DEC--SIN"]
    scale = 0.1 / 3.6e6
    assert np.allclose(wcs.pixel_scale_matrix, [[-scale, 0], [0, scale]], rtol=1e-12)
    assert [*wcs.wcs.crpix, *wcs.wcs.crval] == [16, 9, 187.25, 2.05]


def test_unusable_coordinates_are_refused_in_one_line(aips_header):
    for changes, message in [
        ({"CTYPE1": None, "CTYPE2": None}, "no celestial coordinates.*from_arrays"),
        ({"CTYPE1": "RA---XYZ", "CTYPE2": "DEC--XYZ"}, "cannot be read"),
        ({"CDELT1": None, "CDELT2": None}, "no pixel scale"),
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
    expected = {
        ("RA---SIN", "DEC--SIN"): ("east", "north", True),
        ("HPLN-TAN", "HPLT-TAN"): ("solar west", "solar north", False),
        ("GLON-CAR", "GLAT-CAR"): ("galactic east", "galactic north", True),
        ("XLON-CAR", "XLAT-CAR"): ("larger longitude", "larger latitude", True),
    }
    assert {ctype: axis_words(in_frame(*ctype)) for ctype in expected} == expected
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


def sky(projection="TAN", scale=0.05, **changes):
    return {
        "CTYPE1": f"RA---{projection}", "CTYPE2": f"DEC--{projection}",
        "CRVAL1": 83.0, "CRVAL2": 22.0, "CRPIX1": 18.0, "CRPIX2": 12.0,
        "CDELT1": -scale * ARCSEC, "CDELT2": scale * ARCSEC, **changes,
    }  # fmt: skip


def cd():
    own = sky()
    steps = own.pop("CDELT1"), own.pop("CDELT2")
    return own | {"CD1_1": steps[0], "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": steps[1]}


def sun(scale, **changes):
    own = {"CTYPE1": "HPLN-TAN", "CTYPE2": "HPLT-TAN", "CUNIT1": "arcsec",
           "CUNIT2": "arcsec", "CDELT1": scale, "CDELT2": scale, "CRVAL1": 0.0,
           "CRVAL2": 0.0}  # fmt: skip
    return sky() | own | changes


def image(cards, pixels=PIXELS, name=None):
    """An HDU; cards that are text stand as they are."""
    made = fits.ImageHDU(pixels) if name else fits.PrimaryHDU(pixels)
    for key, value in cards.items():
        if key in ("HISTORY", "COMMENT"):
            for line in value:
                made.header[key] = line
        else:
            made.header[key] = value
    if name:
        made.name = name
    return made


STOKES = {"CTYPE4": "STOKES", "CRVAL4": 1.0, "CDELT4": 1.0, "CRPIX4": 1.0}
FOUR = PIXELS[None, None]
WIDE = Beam(5 * u.arcsec, 4 * u.arcsec, 30 * u.deg)
AIPS = ["AIPS   IMNAME='3C273' IMCLASS='ICLN'",
        "AIPS   CLEAN BMAJ=  1.3889E-03 BMIN=  1.1111E-03 BPA=  30.00"]  # fmt: skip
SCI = PIXELS.astype("f4")
WEIGHT = np.where(PIXELS > 2, 0, 1).astype("f4")
FLAGS = np.where(PIXELS > 2, 4096, 0).astype("i2")
#: HDUs; and the date, unit, beam, filter, wavelength and bad pixels.
HEADERS = {
    "THINGS": (
        [image({"OBJECT": "NGC628", "TELESCOP": "VLA", "DATE-OBS": "1997-01-24",
                "BUNIT": "JY/B*M/S", "EPOCH": 2000.0, **sky("SIN", 1.5),
                "CTYPE3": "VELOCITY", "CRVAL3": 7e5, "CDELT3": 2.6e3, "CRPIX3": 1.0,
                **STOKES, "HISTORY": AIPS}, FOUR)],
        ("1997-01-24T00:00:00", u.one, WIDE, None, None, 0)),
    "HST flt": (
        [image({"TELESCOP": "HST", "INSTRUME": "WFC3", "TARGNAME": "HH1",
                "FILTER": "F164N", "DATE-OBS": "2016-04-05", "TIME-OBS": "06:07:08",
                "EXPSTART": 57483.25495370, "EXPEND": 57483.26189815,
                "EXPTIME": 600.0}, None),
         image({"BUNIT": "ELECTRONS/S", **cd()}, SCI, "SCI"),
         image({"BUNIT": "ELECTRONS/S"}, SCI * 0 + 0.1, "ERR"),
         image({}, FLAGS, "DQ"), image({}, FLAGS * 0 + 9, "SAMP"),
         image({}, SCI * 0 + 600, "TIME")],
        ("2016-04-05T06:12:08", u.electron / u.s, None, "F164N", None, 15)),
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
        ("2022-08-28T17:07:40.829", u.MJy / u.sr, None, "F444W + F470N", None, 15)),
    "AIA": (
        [image({}, None),
         image({"TELESCOP": "SDO/AIA", "INSTRUME": "AIA_3", "WAVELNTH": 171,
                "WAVEUNIT": "angstrom", "DATE-OBS": "2011-06-07T06:33:00.34",
                "T_OBS": "2011-06-07T06:33:01.34Z", "EXPTIME": 1.999,
                "T_REC": "2011-06-07T06:33:02Z", **sun(0.6)}, None, "COMPRESSED")],
        ("2011-06-07T06:33:01.34", u.one, None, None, "171 angstrom", 0)),
    "HMI": (
        [image({"TELESCOP": "SDO/HMI", "DATE-OBS": "2014-01-01T00:00:07.30", "CONTENT":
                "MAGNETOGRAM", "T_OBS": "2014.01.01_00:00:42.50_TAI", "BUNIT": "Gauss",
                "T_REC": "2014.01.01_00:00:45_TAI", "WAVELNTH": 6173.0,
                **sun(0.504, CROTA2=0.0)})],
        ("2014-01-01T00:00:07.5", u.Gauss, None, None, "6173", 0)),
}  # fmt: skip
HEADERS["AIA"][0][1].data = PIXELS.astype("f4")


@pytest.mark.parametrize("name", HEADERS)
def test_headers_of_archives(tmp_path, name):
    hdus, expected = HEADERS[name]
    path = tmp_path / "a.fits"
    fits.HDUList(hdus).writeto(path, output_verify="ignore")
    plane = read_plane(path)
    date, unit, beam, *facts, bad = expected
    assert abs((plane.time - Time(date)).to_value(u.s)) < 2e-3
    assert (plane.unit, plane.beam is None) == (unit, beam is None)
    if beam is not None:
        assert u.isclose(plane.beam.major, beam.major, rtol=1e-4)
        assert u.isclose(plane.beam.minor, beam.minor, rtol=1e-4)
    assert [plane.facts.get(k) for k in ("filter", "wavelength")] == facts
    assert plane.mask.sum() == bad
    assert np.allclose(plane.data, PIXELS, atol=1e-6)
    assert ("unit" in "".join(plane.notes)) == (name == "THINGS")
