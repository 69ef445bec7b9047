# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What inspection tells of files, and the speeds that dates allow."""

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time

from astro_scc.epochs import Beam, EpochCube, inspect_epochs, plan_intervals
from astro_scc.epochs.inspection import repeated

YEARS = Time(["2000-01-01", "2000-07-01", "2001-01-01", "2002-01-01"])
SPEED = u.mas / u.yr


def plan(times=YEARS):
    fields = {"pixel_scale": 0.1 * u.mas, "beams": Beam(1 * u.mas, 0.5 * u.mas)}
    data = np.ones((len(times), 100, 120))
    return plan_intervals(EpochCube.from_arrays(data, times, **fields))


def test_every_problem_is_named_and_nothing_raises(make_fits, tmp_path):
    fields = {"times": YEARS[:1], "pixel_scale": 1 * u.mas}
    EpochCube.from_arrays(np.ones((1, 4, 4)), **fields).write(tmp_path / "cube.fits")
    (tmp_path / "text.fits").write_text("text")
    (tmp_path / "folder").mkdir()
    files = {
        "good": {},
        "date": {"DATE_OBS": None},
        "beam": {"DATE_OBS": "2008-01-01", "BMAJ": None},
        "bad_beam": {"DATE_OBS": "2009-01-01", "BMAJ": -1.0},
        "unit": {"DATE_OBS": "2010-01-01", "BUNIT": "ODD"},
        "mask": {"DATE_OBS": "2014-01-01", "data": np.eye(16, 32)},
        "coarse": {"DATE_OBS": "2011-01-01", "CDELT1": -1e-7, "CDELT2": 1e-7},
        "far": {"DATE_OBS": "2013-01-01", "CRVAL2": 2.1},
        "nan": {"data": np.full((4, 4), np.nan)},
        "wcs": {"CTYPE1": None, "CTYPE2": None},
    }
    paths = {name: make_fits(f"{name}.fits", **own) for name, own in files.items()}
    paths |= {name: tmp_path / f"{name}.fits" for name in ("text", "missing", "cube")}
    paths["folder"] = tmp_path / "folder"
    table = inspect_epochs(paths.values())
    found = dict(zip(table["file"], table["problem"], strict=True))
    expected = {
        "date": "no date of observation",
        "beam": "no beam where other epochs have one",
        "bad_beam": "its beam is taken as unknown",
        "unit": "unit 'ODD' is not known",
        "mask": "no more than two different values",
        "coarse": "on another grid than good.fits, the finest, and resampled",
        "far": "its reference pixel and that of good.fits are 180 arcsec",
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
    assert (table["date"].mask.sum(), np.isnan(table["noise"]).sum()) == (7, 7)


def test_two_epochs_of_the_same_pixels():
    data = np.random.default_rng(1).normal(size=(4, 8, 8))
    data[3] = data[1]
    said = repeated(EpochCube.from_arrays(data, YEARS, pixel_scale=1 * u.mas))
    assert said.startswith("2002-01-01: has the same pixels as 2000-07-01, of another")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: plan().baseline(0 * SPEED), "speed must be positive"),
        (lambda: plan().baseline(0.05 * SPEED), "nothing moves 0.3 of a beam in the 2"),
        (lambda: plan(YEARS[:1]), "at least two epochs of different date"),
    ],
)
def test_plans_that_cannot_be_made(call, words):
    assert "4 epochs over 2 yr, 0.498 to 0.999 yr apart" in str(plan())
    with pytest.raises(ValueError, match=words):
        call()
