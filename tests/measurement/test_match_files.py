# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches on disk: the same when they are read, refused when they are stale."""

from dataclasses import fields, replace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits

from astro_scc import StackedCrossCorrelation
from astro_scc.correlation.correlate import match_block
from astro_scc.exceptions import MeasurementWarning
from astro_scc.measurement import MatchedEpochs, select_ssps
from astro_scc.simulation import simulate_two_fluid

SETTINGS = {"scales": [1, 2], "max_speed": 30 * u.mas / u.yr}


@pytest.fixture(scope="module")
def scc():
    return StackedCrossCorrelation(**SETTINGS)


@pytest.fixture(scope="module")
def cube():
    return simulate_two_fluid(
        n_epochs=3, rng=3, shape=(48, 120), axis=24.0, extent=(10.0, 110.0)
    ).cube


@pytest.fixture(scope="module")
def made(scc, cube):
    return scc.match(cube)


@pytest.fixture
def counted(monkeypatch):
    """How many blocks were correlated."""
    blocks = []

    def count(block):
        blocks.append(block)
        return match_block(block)

    monkeypatch.setattr("astro_scc.correlation.correlate.match_block", count)
    # A block for each epoch.
    monkeypatch.setattr("astro_scc.correlation.correlate.BLOCK_WORK", 1)
    return blocks


def same(one, other):
    assert one.matches.same_as(other.matches)
    for own in fields(one.ssps):
        a, b = getattr(one.ssps, own.name), getattr(other.ssps, own.name)
        np.testing.assert_array_equal(a, b)
        assert a.dtype == b.dtype, own.name
    np.testing.assert_array_equal(one.select, other.select)
    assert one.scales == other.scales


def test_round_trip(made, cube, tmp_path, scc):
    made.write(tmp_path / "m.fits")
    read = MatchedEpochs.read(tmp_path / "m.fits", cube)
    same(made, read)
    # Planes are made again, and the same, if somebody asks for them.
    assert len(read.decompositions) == len(cube)
    np.testing.assert_array_equal(
        read.decompositions[2].planes, made.decompositions[2].planes
    )
    loose = replace(scc, alpha=0.5)
    one, other = (loose.stack(m, n_trials=10, rng=1) for m in (made, read))
    np.testing.assert_array_equal(one.coefficient, other.coefficient)
    assert np.array_equal(one.components["pm"], other.components["pm"])
    with pytest.raises(FileExistsError):
        made.write(tmp_path / "m.fits")
    made.write(tmp_path / "m.fits", overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["m.fits"]


def test_dates_do_not_matter_but_images_and_versions_do(
    made, cube, tmp_path, monkeypatch
):
    """Each of those alone is in ``tests/robustness/test_stale.py``."""
    path = tmp_path / "m.fits"
    made.write(path)
    later = replace(cube, times=cube.times + 1 * u.yr)
    assert MatchedEpochs.read(path, later).cube.times[0] == later.times[0]
    with pytest.raises(ValueError, match="m.fits: is of other images, masks, beams;"):
        MatchedEpochs.read(path, cube[:2])
    other = "astro_scc.measurement.matched.versions", lambda: {"astro_scc": "0"}
    monkeypatch.setattr(*other)
    with pytest.raises(ValueError, match="is of other versions; match the epochs"):
        MatchedEpochs.read(path, cube)


def test_files_that_are_no_matches(cube, tmp_path):
    """Damaged ones are in ``test_result_files.py``."""
    path = tmp_path / "m.fits"
    with pytest.raises(FileNotFoundError):
        MatchedEpochs.read(path, cube)
    path.write_text("nothing")
    with pytest.raises(OSError, match="is no complete astro_scc matches file"):
        MatchedEpochs.read(path, cube)
    fits.PrimaryHDU(np.ones((3, 3))).writeto(path, overwrite=True)
    with pytest.raises(OSError, match="it was not written as one"):
        MatchedEpochs.read(path, cube)


def test_matches_without_provenance(made, tmp_path):
    with pytest.raises(ValueError, match="no provenance"):
        replace(made, provenance={}).write(tmp_path / "m.fits")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["m.fits", "folder"])
def test_a_cache_is_used_when_only_the_stack_changes(
    scc, cube, made, counted, tmp_path, name
):
    path = tmp_path / name
    same(made, scc.match(cube, cache=path))
    assert len(counted) == len(cube)
    again = replace(scc, alpha=0.5, position_angle=90 * u.deg)
    same(made, again.match(cube, cache=path))
    result = again(cube, n_trials=10, rng=1, cache=path)
    assert len(counted) == len(cube)
    assert result.matched.matches.same_as(made.matches)
    files = [p for p in tmp_path.rglob("*") if p.is_file()]
    assert len(files) == 1


def test_a_cache_that_cannot_be_read_is_made_again(scc, cube, made, counted, tmp_path):
    path = tmp_path / "m.fits"
    path.write_text("nothing")
    with pytest.warns(MeasurementWarning, match="is no complete astro_scc matches"):
        same(made, scc.match(cube, cache=path))
    same(made, scc.match(cube, cache=path))
    assert len(counted) == len(cube)


def test_a_part_that_was_chosen_later_is_no_cache(scc, made, cube, tmp_path):
    path = tmp_path / "m.fits"
    part = select_ssps(made, scales=[1])
    part.write(path)
    same(part, MatchedEpochs.read(path, cube))
    with pytest.warns(MeasurementWarning, match="other region"):
        same(made, scc.match(cube, cache=path))
