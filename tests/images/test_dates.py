# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""When images were taken: the most precise date that agrees on the day."""

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.time import Time

from astro_scc.epochs import EpochCube, inspect_epochs
from astro_scc.images.dates import observing_time
from astro_scc.images.fits import read_header

#: 2015-06-18T14:24:00, and the middle of an exposure of 10 minutes from then on.
MJD = 57191.6
START, MIDDLE = "2015-06-18T14:24:00.000", "2015-06-18T14:29:00.000"
MIDNIGHT = "2015-06-18T00:00:00.000"
DAY = {"DATE-OBS": "2015-06-18"}
PIXELS = np.random.default_rng(1).normal(size=(3, 16, 32))
CLOCK = {"DATE-OBS": "2015-06-18T14:24:00"}

#: Cards, and the date that they tell.
DATES = [
    # The day alone, and the time of day elsewhere.
    (DAY, MIDNIGHT),
    (DAY | {"MJD-OBS": MJD}, START),
    ({"DATE-OBS": "2015-06-17", "TIME-OBS": "24:00:00"}, MIDNIGHT),
    ({"DATE-OBS": "2016-12-31T24:00:00", "EXPTIME": 600.0}, "2017-01-01T00:05:00.000"),
    ({"DATE_OBS": "2015/06/18", "TIME_OBS": "14:24"}, START),
    (DAY | {"TIME-OBS": "14:24:00.0"}, START),
    (DAY | {"TM-START": 51840}, START),
    (DAY | {"UT": ("14.4", "[h] start")}, START),
    # Several: the most precise one.
    (DAY | {"TIME-OBS": "14:24", "UT": "14:24:30"}, "2015-06-18T14:24:30.000"),
    (CLOCK | {"MJD-OBS": MJD + 0.4 / 86400}, "2015-06-18T14:24:00.400"),
    (DAY | {"UT": (14.4, "[s] start")}, "2015-06-18T00:00:14.400"),
    (DAY | {"UT": "77:00:00"}, MIDNIGHT),
    # What is no time of the day, or is of another time, does not count.
    (DAY | {"TIME-OBS": "142400.5"}, "2015-06-18T14:24:00.500"),
    (DAY | {"JD": 57192.1}, MIDNIGHT),
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
    (DAY | {"DATE-AVG": "2015-06-18T14:29:00"}, MIDDLE),
    (DAY | {"MJD-AVG": MJD + 300 / 86400, "EXPTIME": 99.0}, MIDDLE),
    (CLOCK | {"DATE-AVG": "2015-06-20T14:29:00"}, START),
    # The end alone.
    (DAY | {"DATE-END": "2015-06-18T14:34:00", "EXPTIME": 600.0}, MIDDLE),
    # Exposures that last beyond midnight.
    ({"DATE-OBS": "2015-06-17T23:59:00", "DATE-AVG": "2015-06-18T00:04:00.5"},
     "2015-06-18T00:04:00.500"),
    # Other scales of time.
    ({"T_OBS": "2015.06.18_14:24:35.00_TAI"}, START),
    ({"DATE-OBS": "2015-06-18T14:24:16", "TIMESYS": "GPS"}, START),
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
    (DAY | {"MJD-OBS": 50000.25}, MIDNIGHT, "is of 2015-06-18, which is taken, and "
     "MJD-OBS is of 1995-10-10"),
    (DAY | {"UT": 14.4}, MIDNIGHT, "its UT = 14.4 may be hours or seconds and is left"),
    (DAY | {"TIME-OBS": 14.4}, "2015-06-18T00:00:14.400", "its TIME-OBS = 14.4 may be "
     "hours or seconds and is seconds; write it as"),
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
        own = zip(dates, PIXELS[[*pixels]], strict=True)
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
    ({"MJDREF": 57191.0, "CRVAL3": 36000.0}, SECONDS),
    (DAYS | {"CUNIT3": "d", "MJDREF": 0.0, "DATE-OBS": None}, HOURS),
    ({"JDREF": 2457191.5, "CRVAL3": 36000.0}, SECONDS),
    ({"DATEREF": "2015-06-18T09:00:00", "CRVAL3": 3600.0}, SECONDS),
    (DAYS | {"CTYPE3": "JD", "CUNIT3": None, "CRVAL3": 2457191.5 + 10 / 24}, HOURS),
    ({"CRVAL3": 57191 * 86400.0 + 36000}, SECONDS),
    ({"CTYPE3": "TAI", "CUNIT3": "s", "MJDREF": 57191.0, "CRVAL3": 36035.0}, SECONDS),
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
        ({"CTYPE3": "WAVE"}, "has 4 planes on axis WAVE; write the one to use"),
    ]:
        cube(tmp_path / "movie.fits", **changes)
        with pytest.raises(ValueError, match=f"movie.fits: {words}"):
            EpochCube.read(tmp_path / "movie.fits")
        assert len(inspect_epochs(tmp_path / "movie.fits")["problem"][0]) > 20
