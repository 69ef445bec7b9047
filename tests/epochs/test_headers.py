# Licensed under a 3-clause BSD style license - see LICENSE.rst
import string
import warnings
from contextlib import suppress
from datetime import datetime

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.time import Time
from hypothesis import example, given, settings
from hypothesis import strategies as st

from astro_scc.epochs import Beam, EpochCube
from astro_scc.images.headers import (
    axis_kind,
    celestial_wcs,
    epoch_header,
    get,
    header_facts,
    parse_unit,
    read_header,
)
from astro_scc.quantities import parse_date


def observing_time(header):
    return read_header(header)["time"]


def header_beam(header, tables=()):
    return read_header(header, tables)["beam"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2006-03-09", "2006-03-09T00:00:00.000"),
        (" 2006-03-09 ", "2006-03-09T00:00:00.000"),
        ("2006-03-09T12:34:56.789012", "2006-03-09T12:34:56.789"),
        ("2006-03-09T12:34:56Z", "2006-03-09T12:34:56.000"),
        ("2006-03-09Z", "2006-03-09T00:00:00.000"),
        ("2006-03-09 12:34:56 UTC", "2006-03-09T12:34:56.000"),
        ("2006-03-09T12:34:56+00:00", "2006-03-09T12:34:56.000"),
        ("2006-03-09T12:34", "2006-03-09T12:34:00.000"),
        ("2006/03/09", "2006-03-09T00:00:00.000"),
        ("2006-3-9", "2006-03-09T00:00:00.000"),
        ("20060309", "2006-03-09T00:00:00.000"),
        ("2006_03_09", "2006-03-09T00:00:00.000"),
        ("2006 Mar 9", "2006-03-09T00:00:00.000"),
        ("2006.500", "2006-07-02T12:00:00.000"),
        ("21/03/95", "1995-03-21T00:00:00.000"),
        ("21/03/05", "2005-03-21T00:00:00.000"),
        ("21/03/1995", "1995-03-21T00:00:00.000"),
        ("2016-12-31T23:59:60", "2016-12-31T23:59:60.000"),
    ],
)
def test_dates_of_all_sorts(text, expected):
    assert parse_date(text).isot == expected


@pytest.mark.parametrize(
    "text", ["", "yesterday", "2006-13-01", "2006-02-30", "31/31/95", "2006.2", "?" * 9]
)
def test_what_is_no_date_is_refused(text):
    with pytest.raises(ValueError, match="is no date; write it as 2006-03-09"):
        parse_date(text)


@settings(max_examples=20)
@given(st.datetimes(datetime(1960, 1, 1), datetime(2025, 1, 1)))
def test_iso_dates_of_python_are_understood(date):
    time = parse_date(date.isoformat())
    assert abs((time - Time(date.isoformat(), scale="utc")).sec) < 1e-6


@settings(max_examples=20)
@given(st.text(string.printable, max_size=25))
def test_any_text_is_a_date_or_a_value_error(text):
    with suppress(ValueError):
        assert isinstance(parse_date(text), Time)


def test_date_of_observation_not_of_writing():
    header = fits.Header({"DATE": "2022-07-29", "DATE-OBS": "2006-03-09"})
    assert observing_time(header).isot[:10] == "2006-03-09"
    del header["DATE-OBS"]
    assert observing_time(header) is None


@pytest.mark.parametrize(
    ("cards", "expected"),
    [
        ({"DATE-OBS": "1995-04-01", "TIME-OBS": "06:00:00"}, "1995-04-01T06:00:00.000"),
        ({"DATE-OBS": "", "DATE-BEG": "1995-04-01"}, "1995-04-01T00:00:00.000"),
        ({"DATE-OBS": "soon", "DATE-AVG": "1995-04-01"}, "1995-04-01T00:00:00.000"),
        ({"MJD-OBS": 49808.5}, "1995-04-01T12:00:00.000"),
        ({"DATE-OBS": "soon", "MJD-OBS": 49808.5}, "1995-04-01T12:00:00.000"),
        ({"EXPSTART": 49808.5}, "1995-04-01T12:00:00.000"),
        ({"MJD": 0, "EXPSTART": 49808.5}, "1995-04-01T12:00:00.000"),
        ({"DATE-OBS": "1995-04-01", "TIMESYS": "TAI"}, "1995-03-31T23:59:31.000"),
        ({"DATE-OBS": "1995-04-01", "TIMESYS": "odd"}, "1995-04-01T00:00:00.000"),
    ],
)
def test_where_the_date_is_looked_for(cards, expected):
    time = observing_time(fits.Header(cards))
    assert time.scale == "utc"
    assert time.isot == expected
    lower = {key.lower(): value for key, value in cards.items()}
    assert observing_time(lower).isot == expected


def test_a_time_in_the_meta_is_taken_as_it_is():
    time = Time("2000-01-01")
    assert observing_time({"date-obs": time}) is time


def test_no_date_or_no_readable_date():
    assert observing_time(fits.Header({"MJD": 0})) is None
    record = read_header(fits.Header({"DATE-OBS": "soon"}))
    assert record["time"] is None
    assert record["date_problem"].startswith("DATE-OBS: 'soon' is no date; write it as")


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("JY/BEAM", u.Jy / u.beam),
        ("Jy/beam", u.Jy / u.beam),
        ("jy / bm", u.Jy / u.beam),
        ("JY PER BEAM", u.Jy / u.beam),
        ("mJy/beam", u.mJy / u.beam),
        ("JY/PIXEL", u.Jy / u.pix),
        ("counts / pixel", u.ct / u.pix),
        ("ELECTRONS/S", u.electron / u.s),
        ("COUNTS", u.ct),
        ("K", u.K),
        ("MJy/sr", u.MJy / u.sr),
        ("MJY/SR", u.MJy / u.sr),
        ("", u.dimensionless_unscaled),
        (None, u.dimensionless_unscaled),
        (u.Jy, u.Jy),
        ("MJY/BEAM", None),
        ("furlongs", None),
        ("(((", None),
    ],
)
def test_units(text, unit):
    assert parse_unit(text) == unit


@settings(max_examples=20)
@example("1,")
@given(st.text(string.printable, max_size=20))
def test_any_text_is_a_unit_or_none(text):
    parsed = parse_unit(text)
    assert parsed is None or isinstance(parsed, u.UnitBase)


def test_get_skips_what_is_not_there():
    header = fits.Header([("A", None), ("B", "1.5D-3"), ("C", " "), ("D", "nan")])
    assert get(header, "A", "E") is None
    assert get(header, "A", "B", kind=float) == 1.5e-3
    assert get(header, "C", kind=str) is None
    assert get(header, "D", "C", kind=float) is None
    broken = fits.Header.fromstring("X       = 1 2 3 'a".ljust(80))
    assert get(broken, "X") is None


def test_beam_from_the_header(aips_header):
    beam = header_beam(aips_header())
    assert beam == Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg)
    assert header_beam(aips_header(BMIN=None, BPA=None)).minor == beam.major
    turned = header_beam(aips_header(BMAJ=0.5 / 3.6e6, BMIN=1 / 3.6e6))
    assert turned == Beam(1 * u.mas, 0.5 * u.mas, 83 * u.deg)
    assert header_beam({"beam": beam}) == beam
    assert header_beam(aips_header(BMAJ=None)) is None
    assert header_beam(aips_header(BMAJ=0.0)) is None


def test_beam_from_the_history(aips_header):
    header = aips_header(BMAJ=None, BMIN=None, BPA=None)
    header.add_history("AIPS   IMAGR BMAJ= 9 BMIN= 9 BPA= 9")
    for major in ("3.0000E-07", "2.7778D-07"):
        header.add_history(f"AIPS   CLEAN BMAJ=  {major} BMIN= 1.3889E-07 BPA=  -7.00")
    header.add_history("AIPS   CLEAN NITER=      490 PRODUCT=1   / NORMAL")
    expected = Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg)
    assert header_beam(header).major.value == pytest.approx(1, rel=1e-4)
    assert header_beam(header).pa == expected.pa
    lines = {"HISTORY": [str(line) for line in header["HISTORY"]]}
    assert header_beam(lines).major == header_beam(header).major
    line = {"history": "AIPS CLEAN BMAJ= 2.0E-7 BMIN= 1.0E-7 BPA= 3.0"}
    assert header_beam(line).pa == 3 * u.deg
    assert header_beam({"HISTORY": "AIPS CLEAN BMAJ= 0.0 BMIN= 0.0 BPA= 0.0"}) is None


@pytest.mark.parametrize(
    ("name", "unit", "scale"),
    [("AIPS CG", "DEGREES", 1.0), ("BEAMS", "arcsec", 3600.0)],
)
def test_beam_from_a_table(aips_header, name, unit, scale):
    columns = [
        fits.Column("FREQUENCY", "1D", array=[15e9]),
        fits.Column("BMAJ", "1E", unit=unit, array=[scale / 3.6e6]),
        fits.Column("BMIN", "1E", unit=unit, array=[scale / 7.2e6]),
        fits.Column("BPA", "1E", unit="deg", array=[-7.0]),
    ]
    tables = [
        fits.BinTableHDU.from_columns(columns, name="AIPS CC"),
        fits.BinTableHDU.from_columns(columns, name=name),
    ]
    beam = header_beam(aips_header(BMAJ=None), tables)
    assert beam.major.value == pytest.approx(1, rel=1e-6)
    assert beam.minor.value == pytest.approx(0.5, rel=1e-6)
    assert header_beam(aips_header(BMAJ=2 / 3.6e6), tables).major > 1.5 * u.mas


@pytest.mark.parametrize("changes", [{"BMAJ": -1e-7}, {"BMIN": 0.0}, {"BMIN": -1.0}])
def test_impossible_beams_are_left_out(aips_header, changes):
    record = read_header(aips_header(**changes))
    assert record["beam"] is None
    assert "is not positive" in record["beam_problem"]


def test_facts(aips_header):
    assert header_facts(aips_header()) == {
        "object": "3C273",
        "telescope": "VLBA",
        "frequency": 15.4e9,
        "stokes": "I",
    }
    hst = {"TARGNAME": "HH 34", "FILTER": "F673N", "RESTFREQ": 1e9, "STOKES": "Q"}
    assert header_facts(hst) == {
        "object": "HH 34",
        "filter": "F673N",
        "frequency": 1e9,
        "stokes": "Q",
    }
    assert header_facts({"FILTER1": "F502N", "FILTER2": "POL0V"}) == {
        "filter": "F502N + POL0V"
    }
    assert header_facts({"FILTNAM1": "F606W"}) == {"filter": "F606W"}
    shifted = aips_header(CRPIX3=2.0, CRVAL4=-9.0)
    assert header_facts(shifted)["frequency"] == 15.4e9 - 64e6
    assert "stokes" not in header_facts(shifted)
    assert "frequency" not in header_facts(aips_header(CRVAL3=None))


def test_celestial_wcs_of_four_axes_warns_of_nothing(aips_header):
    header = aips_header()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wcs = celestial_wcs(header)
    assert wcs.naxis == 2
    assert list(wcs.wcs.crpix) == [16, 9]
    assert list(wcs.wcs.crval) == [187.25, 2.05]
    assert wcs.wcs.radesys == "FK5"
    assert celestial_wcs(aips_header(EPOCH=1950.0)).wcs.radesys == "FK4"
    assert celestial_wcs(aips_header(EPOCH=None)).wcs.radesys in ("", "ICRS")


@pytest.mark.parametrize(
    "changes",
    [
        {"CTYPE2": "DEC---SIN"},
        {"CTYPE1": "RA--SIN", "CTYPE2": "DEC-SIN"},
        {"CTYPE1": "RA", "CTYPE2": "DEC"},
        {"CTYPE1": "ra---sin", "CTYPE2": "dec--sin"},
        {"CUNIT1": "DEGREES", "CUNIT2": "degree"},
        {"DATE_OBS": "nonsense"},
    ],
)
def test_repaired_headers_give_the_same_wcs(aips_header, changes):
    expected = celestial_wcs(aips_header())
    wcs = celestial_wcs(aips_header(**changes))
    assert list(wcs.wcs.ctype) == ["RA---SIN", "DEC--SIN"]
    assert np.allclose(wcs.pixel_scale_matrix, expected.pixel_scale_matrix, rtol=1e-12)
    assert np.array_equal(wcs.wcs.crval, expected.wcs.crval)


def test_reference_value_defaults_to_zero_and_signs_are_kept(aips_header):
    wcs = celestial_wcs(aips_header(CRVAL1=None, CRVAL2=None, CDELT1=2e-8))
    assert list(wcs.wcs.crval) == [0, 0]
    assert wcs.pixel_scale_matrix[0, 0] > 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"CTYPE1": None, "CTYPE2": None}, "no celestial coordinates.*from_arrays"),
        ({"CTYPE2": "FREQ"}, "no celestial coordinates"),
        ({"CTYPE1": "RA---XYZ", "CTYPE2": "DEC--XYZ"}, "cannot be read"),
        ({"CTYPE1": "RA---SIN", "CTYPE2": "DEC--TAN"}, "cannot be read"),
        ({"CDELT1": None, "CDELT2": None}, "no pixel scale"),
        ({"CDELT1": 0.0}, "no pixel scale"),
        ({"CD1_1": 0.0, "CD2_2": 1e-7, "CDELT1": None}, "no pixel scale"),
        ({"PC1_1": 0.0, "CROTA1": None, "CROTA2": None}, "cannot be read"),
        ({"CRPIX1": "here"}, "CRPIX1 = 'here' is not a finite number"),
        ({"CTYPE1": "DEC--SIN", "CTYPE2": "RA---SIN"}, "transpose the image"),
    ],
)
def test_unusable_coordinates_are_refused_in_one_line(aips_header, changes, message):
    with pytest.raises(ValueError, match=message) as caught:
        celestial_wcs(aips_header(**changes))
    assert "\n" not in str(caught.value)


def test_axis_kind():
    kinds = {
        "longitude": ("RA---SIN", "GLON-CAR", "HPLN-TAN", "RA"),
        "latitude": ("DEC---SIN", "HPLT-TAN"),
        None: ("FREQ", "RADIUS", ""),
    }
    for kind, names in kinds.items():
        assert {axis_kind(name) for name in names} == {kind}


def test_epoch_header_reads_back():
    facts = {"object": "3C273", "frequency": 15.4e9, "stokes": "I", "telescope": "VLBA"}
    beam = Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg)
    cube = EpochCube.from_arrays(
        np.ones((1, 4, 4)),
        Time(["2006-03-09T01:02:03"], scale="tai"),
        pixel_scale=0.1 * u.mas,
        unit=u.mJy / u.beam,
        beams=beam,
        noise=0.1 * u.mJy / u.beam,
    ).with_step("named", labels=["épreuve.fits"], epoch_meta=[facts])
    header = epoch_header(cube, 0)
    assert header_beam(header) == beam
    assert header_facts(header) == facts
    assert header["LABEL"] == "?preuve.fits"
    assert header["NOISE"] == 0.1
    difference = observing_time(header) - Time("2006-03-09T01:02:03", scale="tai")
    assert abs(difference.sec) < 1e-3
