# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Published features beside those that were measured."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable, vstack
from astropy.time import Time

from astro_scc.epochs import ComponentList
from astro_scc.exceptions import EpochWarning
from astro_scc.features import find_features
from astro_scc.products.publication import (
    published_positions,
    speed_of,
    with_published,
)
from astro_scc.report.answer import published_lines
from astro_scc.simulation import simulate_jet


@pytest.fixture(scope="module")
def features():
    return find_features(simulate_jet(n_epochs=8, dispersion=0.1, rng=1).cube, seed=1)


def written(features, path, shift=0.0):
    """Write the measured positions as published, the third feature elsewhere."""
    table = features.positions
    numbers = np.searchsorted(features.number, table["feature"]) + 1
    east = table["ra_offset"] + shift * u.mas + 9 * u.mas * (numbers == 3)
    dates, epoch = np.unique(table["date"].jyear, return_inverse=True)
    found = ComponentList(
        times=Time(dates, format="jyear", scale="utc"), epoch=epoch,
        flux=np.ones(len(table)) * u.Jy, east=east, north=table["dec_offset"],
        feature=numbers,
    )  # fmt: skip
    found.to_table().write(path, format="ascii.ecsv")
    return published_positions(path, features.cube)


def test_the_same_features_have_their_numbers_and_speeds(features, tmp_path):
    published = written(features, tmp_path / "t.ecsv", shift=0.02)
    table = with_published(features.table, features, published)
    other = np.arange(len(table)) == 2
    assert np.array_equal(table["published"].mask, other)
    assert np.array_equal(table["published"][~other], np.flatnonzero(~other) + 1)
    close = table["published_pm"].unmasked - table["pm"]
    error = np.hypot(table["pm_err"], table["published_pm_err"].unmasked)
    assert np.all((np.abs(close) <= 3 * error)[~other])
    assert all(table[k].info.description for k in table.colnames)
    # Later positions of a feature that accelerates do not count.
    later = published.copy()
    later["date"] += 20 * u.yr
    later["ra_offset"] += 99 * u.mas
    far = vstack([published, later])
    far.sort(["published", "date"])
    again = with_published(features.table, features, far)
    np.testing.assert_array_equal(again["published_pm"], table["published_pm"])
    # They survive in the file.
    table.write(tmp_path / "out.ecsv")
    assert QTable.read(tmp_path / "out.ecsv")["published"].mask.sum() == 1


def test_how_many_agree_is_said(features, tmp_path):
    table = with_published(
        features.table, features, written(features, tmp_path / "t.ecsv")
    )
    n, m = np.sum(table["secure"]), np.sum(table["secure"] & ~table["published"].mask)
    assert m > 1
    (line,) = published_lines(table)
    assert line == (
        f"{m} of {n} secure features are published ones, of which {m} have the "
        "published speed within 2 errors."
    )
    first = np.flatnonzero(table["secure"])[0]
    table["published_pm"][first] *= 3
    assert f"; not {table['feature'][first]} (" in published_lines(table)[0]
    table["published"].mask = True
    assert published_lines(table) == [f"0 of {n} secure features are published ones."]
    assert published_lines(features.table) == []


def test_too_far_or_too_few_are_others(features, tmp_path):
    beam = features.detections.fwhm
    published = written(features, tmp_path / "t.ecsv", shift=1.5 * beam)
    found = with_published(features.table, features, published)["published"]
    assert not np.any(found.filled(-1) == np.arange(len(found)) + 1)
    published = written(features, tmp_path / "u.ecsv")
    few = published[published["date"] < features.cube.times[2]]
    assert np.all(with_published(features.table, features, few)["published"].mask)


def test_speeds_are_those_of_straight_lines(features, shared_data):
    table = shared_data / "mojave_xviii" / "1226+023.ecsv"
    # A table of one source may give it another name.
    with pytest.warns(EpochWarning, match="source is 3C 273, that of the images jet"):
        published = published_positions(table, features.cube)
    wanted = QTable.read(shared_data / "mojave_xviii" / "1226+023.linear-fits.csv")
    for row in wanted[:5]:
        own = published[published["published"] == row["feature"]]
        place = np.stack([own[k].value for k in ("ra_offset", "dec_offset")])
        speed, error = speed_of(own["date"].jyear, place)
        assert speed == pytest.approx(row["mu_mas_yr"], rel=0.01)
        assert error == pytest.approx(row["mu_err"], rel=0.1)


def test_a_table_of_other_things_is_refused(features, tmp_path, shared_data):
    found = ComponentList(
        times=Time(["2001-01-01"]), epoch=[0], flux=[1] * u.Jy, east=[0] * u.mas,
        north=[0] * u.mas,
    )  # fmt: skip
    found.to_table().write(tmp_path / "a.ecsv")
    with pytest.raises(ValueError, match=r"a\.ecsv: numbers no features; give a table"):
        published_positions(tmp_path / "a.ecsv", features.cube)
    journal = shared_data / "mojave_xviii" / "apjac230ft4_mrt.txt"
    with pytest.raises(ValueError, match="no source 'jet'; it has 0003"):
        published_positions(journal, features.cube)
    # Of a table of many it is the object.
    known = features.cube.with_step("named", meta={"object": "0003+380"})
    assert set(published_positions(journal, known)["published"]) == {*range(1, 8)}
