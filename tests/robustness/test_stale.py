# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What was kept of other data, settings or versions is not used."""

import os
import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.cli.survey import run_survey
from astro_scc.cli.survey_sources import read_survey
from astro_scc.exceptions import MeasurementWarning

SPEED = 5 * u.mas / u.yr


@pytest.fixture
def cube(epochs):
    return EpochCube.read(epochs)


@pytest.fixture
def scc():
    # With this noise everything matters that noise may depend on.
    return StackedCrossCorrelation(scales=[1, 2], max_speed=SPEED, noise="propagated")


def pixel(cube):
    data = cube.data.copy()
    data[1, 20, 12] += 1e-6
    return {"data": data}


def mask(cube):
    bad = cube.mask.copy()
    bad[2, 3, 4] = True
    return {"mask": bad}


IMAGES = {
    "images": pixel,
    "masks": mask,
    "noise": lambda cube: {"noise": np.full(5, 2e-3) * cube.unit},
}
SETTINGS = {
    "settings of the decomposition": {"detection": 5.0},
    "settings of the correlation": {"kappa": 0.7},
    "largest displacement": {"max_speed": 2 * SPEED},
}


def same(one, other):
    np.testing.assert_equal(vars(one.matches), vars(other.matches))
    for name in ("y", "x", "flux"):
        assert np.array_equal(getattr(one.ssps, name), getattr(other.ssps, name))
    assert np.array_equal(one.select, other.select)
    assert np.array_equal(one.region, other.region)


def check_stale(what, scc, cube, path, **options):
    """Those in the file are told to be stale, and new ones take their place."""
    # Noise and the largest displacement may depend on the rest.
    line = rf"m.fits: is of other {what}(, [\w ]+)*; not used, the epochs are matched"
    with pytest.warns(MeasurementWarning, match=line):
        found = scc.match(cube, cache=path, **options)
    same(found, scc.match(cube, **options))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        same(found, scc.match(cube, cache=path, **options))


@pytest.fixture
def kept(scc, cube, tmp_path):
    scc.match(cube, cache=tmp_path / "m.fits")
    return tmp_path / "m.fits"


@pytest.mark.slow
@pytest.mark.parametrize("what", IMAGES)
def test_of_other_images(scc, cube, kept, what):
    check_stale(what, scc, replace(cube, **IMAGES[what](cube)), kept)


@pytest.mark.parametrize("what", SETTINGS)
def test_of_other_settings(scc, cube, kept, what):
    check_stale(what, replace(scc, **SETTINGS[what]), cube, kept)


def test_of_another_region(scc, cube, kept):
    inside = np.zeros(cube.shape[1:], bool)
    inside[:24] = True
    check_stale("region", scc, cube, kept, region=inside)


# -- sources of a survey that are finished ------------------------------------------


@pytest.fixture
def survey(inputs, tmp_path):
    """A survey of one source that was measured, and a function that runs it again."""
    (tmp_path / "jet").mkdir()
    inputs.series(tmp_path / "jet", n=3)
    text = (
        '[sources.Jet]\nepochs = "jet/*.fits"\nscales = [2]\nn_trials = 2\n'
        'max_speed = "5 mas/yr"\nalign = "t.csv"\nregions = {r = "r.reg"}\n'
    )
    (tmp_path / "s.toml").write_text(text)
    (tmp_path / "r.reg").write_text("image\ncircle(24,20,20)\n")
    days = "".join(f"{day},0.0,0.0\n" for day in inputs.DAYS)
    (tmp_path / "t.csv").write_text(f"date,east_mas,north_mas\n{days}")

    def run(seen=True):
        told = []
        run_survey(
            read_survey(tmp_path / "s.toml"),
            tmp_path / "out",
            done=lambda *args: told.append(args[2]),
        )
        return told[0]

    assert run() is False
    assert run() is True
    return run


def rewrite(path, old, new):
    """Other content of the same size, with the time of the last change put back."""
    state = path.stat()
    content = path.read_bytes()
    assert old in content
    assert len(old) == len(new)
    path.write_bytes(content.replace(old, new))
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert path.stat().st_mtime_ns == state.st_mtime_ns


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("jet/e1.fits", b"2001-01-31", b"2001-01-30"),
        ("r.reg", b"24", b"25"),
        ("t.csv", b"0.0,0.0\n", b"0.0,0.1\n"),
        ("s.toml", b"n_trials = 2", b"n_trials = 3"),
    ],
)
def test_a_finished_source_of_another_content(survey, tmp_path, name, old, new):
    rewrite(tmp_path / name, old, new)
    assert survey() is False
    assert survey() is True


@pytest.mark.slow
def test_a_finished_source_of_other_versions(survey, monkeypatch):
    from astro_scc.writing import versions

    now = versions()
    monkeypatch.setattr(
        "astro_scc.cli.survey_sources.versions", lambda: {**now, "astro_scc": "0"}
    )
    assert survey() is False


@pytest.mark.slow
@pytest.mark.parametrize("content", ["", "{}", '{"key": 1}', "[]", "nothing"])
def test_a_state_that_makes_no_sense(survey, tmp_path, content):
    (state,) = (tmp_path / "out").rglob("source.json")
    state.write_text(content)
    assert survey() is False
