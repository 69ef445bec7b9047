# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from hypothesis import example, given, settings
from hypothesis import strategies as st

from astro_scc.epochs import Beam, EpochCube, inspect_epochs, plan_intervals

YEARS = ["2000-01-01", "2000-07-01", "2001-01-01", "2002-01-01"]
BEAM = Beam(1 * u.mas, 0.5 * u.mas)


def test_good_files_have_no_problem(make_fits):
    data = np.random.default_rng(0).normal(scale=1e-3, size=(64, 64))
    data[20, 40] = 1
    paths = [
        make_fits("b.fits", data, DATE_OBS="2007-01-01"),
        make_fits("a.fits", data, BUNIT="mJy/beam"),
    ]
    table = inspect_epochs(paths)
    assert table["file"].tolist() == [str(paths[1]), str(paths[0])]
    assert [str(date)[:10] for date in table["date"]] == ["2006-03-09", "2007-01-01"]
    assert table["problem"].tolist() == ["", ""]
    assert table["nx"].tolist() == [64, 64]
    assert u.allclose(table["pixel"], 0.1 * u.mas)
    assert u.allclose(table["major"], 1 * u.mas)
    assert u.allclose(table["pa"], -7 * u.deg)
    assert u.allclose(table["peak"], [1, 1000] * u.mJy / u.beam)
    assert u.allclose(table["noise"], [1e-3, 1] * u.mJy / u.beam, rtol=0.05)
    assert u.allclose(table["peak_east"], (40 - 15) * -0.1 * u.mas)
    assert u.allclose(table["peak_north"], (20 - 8) * 0.1 * u.mas)
    assert table["object"].tolist() == ["3C273", "3C273"]
    assert u.allclose(table["frequency"], 15.4 * u.GHz)


def test_every_problem_is_named_and_nothing_raises(make_fits, tmp_path):
    (tmp_path / "text.fits").write_text("text")
    (tmp_path / "folder").mkdir()
    EpochCube.from_arrays(
        np.ones((1, 4, 4)), ["2000-01-01"], pixel_scale=1 * u.mas
    ).write(tmp_path / "cube.fits")
    paths = {
        "good": make_fits("good.fits"),
        "same": make_fits("same.fits"),
        "date": make_fits("date.fits", DATE_OBS=None),
        "odd_date": make_fits("odd_date.fits", DATE_OBS="soon"),
        "beam": make_fits("beam.fits", DATE_OBS="2008-01-01", BMAJ=None),
        "bad_beam": make_fits("bad_beam.fits", DATE_OBS="2009-01-01", BMAJ=-1.0),
        "unit": make_fits("unit.fits", DATE_OBS="2010-01-01", BUNIT="ODD"),
        "band": make_fits("band.fits", DATE_OBS="2011-01-01", CRVAL3=43e9),
        "other": make_fits("o.fits", DATE_OBS="2012-01-01", OBJECT="X", CRVAL1=3.0),
        "grid": make_fits("grid.fits", np.eye(5) + np.arange(5), DATE_OBS="2013-01-01"),
        "mask": make_fits("mask.fits", np.eye(16, 32), DATE_OBS="2014-01-01"),
        "nan": make_fits("nan.fits", np.full((4, 4), np.nan)),
        "wcs": make_fits("wcs.fits", CTYPE1=None, CTYPE2=None),
        "text": tmp_path / "text.fits",
        "folder": tmp_path / "folder",
        "missing": tmp_path / "missing.fits",
        "cube": tmp_path / "cube.fits",
    }
    table = inspect_epochs(paths.values())
    found = dict(zip(table["file"], table["problem"], strict=True))
    expected = {
        "good": "",
        "same": "is of 2006-03-09, as is good.fits",
        "date": "no date of observation",
        "odd_date": "DATE-OBS: 'soon' is no date",
        "beam": "no beam where others have one",
        "bad_beam": "its beam is taken as unknown",
        "unit": "unit 'ODD' is not known",
        "band": "is at 43 GHz",
        "other": "shows X, somewhere else",
        "grid": "on another grid than most (32 x 16 of 0.1 mas)",
        "mask": "no more than two different values",
        "nan": "all are NaN",
        "wcs": "no celestial coordinates",
        "text": "no FITS",
        "folder": "is a directory",
        "missing": "no such file",
        "cube": "is a whole EpochCube",
    }
    for name, text in expected.items():
        problem = found[str(paths[name])]
        assert text in problem, name
        assert "\n" not in problem
        assert str(tmp_path) not in problem.replace(f"{paths['folder']}/", "")
    assert found[str(paths["good"])] == ""
    assert "its unit is none, that of others is Jy" in found[str(paths["unit"])]
    assert table["date"].mask.sum() == 8
    assert np.isnan(table["noise"]).sum() == 7


def test_nothing_but_bad_files(tmp_path):
    (tmp_path / "a.fits").write_text("text")
    table = inspect_epochs(f"{tmp_path}/*.fits")
    assert len(table) == 1
    assert table["date"].mask.all()
    with pytest.raises(FileNotFoundError, match="no file matches this pattern"):
        inspect_epochs(f"{tmp_path}/*.fit")


def test_plan_is_that_of_the_formulas():
    times = Time(YEARS)
    plan = plan_intervals(times, BEAM, extent=10 * u.mas)
    b = np.sqrt(0.5)
    span = (times[-1] - times[0]).to_value(u.yr)
    gap = np.median(np.diff(times.jd)) / 365.25
    speed = u.mas / u.yr
    assert plan.n_epochs == 4
    assert plan.span.to_value(u.yr) == pytest.approx(span)
    assert plan.median.to_value(u.yr) == pytest.approx(gap)
    assert plan.shortest.to_value(u.day) == pytest.approx(182)
    assert plan.longest.to_value(u.day) == pytest.approx(365)
    assert plan.resolution.to_value(u.mas) == pytest.approx(b)
    assert plan.slowest.to_value(speed) == pytest.approx(0.2 * b / span)
    assert plan.fastest.to_value(speed) == pytest.approx(5 / gap)
    assert plan.consecutive.to_value(speed) == pytest.approx(
        [0.3 * b / gap, 1.5 * b / gap]
    )
    assert plan.baseline(1 * speed).to_value(u.yr) == pytest.approx([0.3 * b, 1.5 * b])
    assert plan.baseline(0.2 * speed)[1] == plan.span


def test_baselines_of_the_real_jets():
    # 3C 273: 0.8 mas/yr and a beam of 1.0 x 0.5 mas work with 0.25 to 1.2 yr.
    times = Time("2000-01-01") + np.arange(50) * 75 * u.day
    plan = plan_intervals(times, BEAM)
    assert plan.baseline(0.8 * u.mas / u.yr).to_value(u.yr) == pytest.approx(
        [0.265, 1.33], abs=0.01
    )


@pytest.mark.parametrize(
    ("speed", "message"),
    [
        (0 * u.mas / u.yr, "speed must be positive"),
        (-1 * u.mas / u.yr, "speed must be positive"),
        (0.05 * u.mas / u.yr, "nothing moves 0.3 of a beam in the 2 yr of the series"),
    ],
)
def test_speeds_without_a_baseline(speed, message):
    with pytest.raises(ValueError, match=message):
        plan_intervals(Time(YEARS), BEAM).baseline(speed)


def test_plan_of_a_cube():
    data = np.ones((4, 50, 80))
    cube = EpochCube.from_arrays(data, YEARS, pixel_scale=0.1 * u.mas, beams=BEAM)
    plan = plan_intervals(cube)
    assert u.isclose(plan.resolution, np.sqrt(0.5) * u.mas)
    assert u.isclose(plan.fastest, 5 * u.mas / (2 * plan.median))
    bare = EpochCube.from_arrays(data, YEARS, pixel_scale=0.1 * u.mas)
    assert u.isclose(plan_intervals(bare).resolution, 0.3 * u.mas)
    assert u.isclose(plan_intervals(bare, 2 * u.mas).resolution, 2 * u.mas)
    assert u.isclose(plan_intervals(bare, [BEAM] * 4).resolution, plan.resolution)


def test_plan_in_words():
    text = str(plan_intervals(Time(YEARS), BEAM, extent=10 * u.mas))
    assert "4 epochs over 2 yr, 0.498 to 0.999 yr apart, median 0.504 yr" in text
    assert "distinguished from standing still; faster than 9.93 mas / yr" in text
    assert "Consecutive epochs suit speeds of 0.42 to 2.1 mas / yr" in text
    assert "further apart, which are used for them." in text
    assert "leaves" not in str(plan_intervals(Time(YEARS), BEAM))
    assert "further apart" not in str(plan_intervals(Time(YEARS[:2]), BEAM))


def test_plan_in_the_units_of_the_series():
    hours = Time("2014-06-01") + [0, 1, 3] * u.hour
    plan = plan_intervals(hours, 2 * u.arcsec)
    assert plan.slowest.unit == u.arcsec / u.hour
    assert plan.span == 3 * u.hour
    days = Time("2014-06-01") + [0, 1, 9] * u.day
    assert plan_intervals(days, 2 * u.mas).slowest.unit == u.mas / u.day


def test_plan_needs_two_dates_and_a_resolution():
    with pytest.raises(ValueError, match="at least two epochs of different date"):
        plan_intervals(Time(["2000-01-01", "2000-01-01"]), BEAM)
    with pytest.raises(ValueError, match="at least two epochs"):
        plan_intervals(Time("2000-01-01"), BEAM)
    with pytest.raises(ValueError, match="need a beam, or the resolution as an angle"):
        plan_intervals(Time(YEARS))


@settings(max_examples=30)
@given(
    st.lists(st.integers(0, 8000), min_size=2, max_size=20, unique=True),
    st.floats(0.01, 10),
)
@example([0, 7], 7.0)
def test_plans_are_in_order(days, size):
    times = Time("2000-01-01") + np.array(days) * u.day
    plan = plan_intervals(times, Beam(size * u.mas, size * u.mas))
    assert plan.shortest <= plan.median <= plan.longest <= plan.span
    assert plan.slowest < plan.consecutive[0] < plan.consecutive[1]
    first, last = plan.baseline(plan.consecutive[0])
    assert u.isclose(first, plan.median)
    assert last >= first
    assert all(line.endswith(".") for line in plan.lines())


def test_inspection_of_real_files(shared_data):
    table = inspect_epochs(
        [shared_data / "0003+380" / "*.fits", shared_data / "README.md"]
    )
    assert len(table) == 11
    assert table["problem"][:10].tolist() == [""] * 10
    assert "no FITS" in table["problem"][10]
    quirks = inspect_epochs(shared_data / "quirks" / "*.fits")
    assert [bool(text) for text in quirks["problem"]] == [False, True, True]
