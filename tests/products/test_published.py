# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Published features beside those that were measured."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time

from astro_scc.epochs import ComponentList
from astro_scc.exceptions import EpochWarning
from astro_scc.products.publication import published_positions, speed_of, with_published
from astro_scc.report.answer import published_lines


@pytest.fixture
def written(known_features, tmp_path):
    """Write the measured positions as published, the third feature elsewhere."""

    def write(shift=0.0):
        table = known_features.positions
        numbers = np.searchsorted(known_features.number, table["feature"]) + 1
        east = table["ra_offset"] + shift * u.mas + 9 * u.mas * (numbers == 3)
        dates, epoch = np.unique(table["date"].jyear, return_inverse=True)
        found = ComponentList(
            times=Time(dates, format="jyear", scale="utc"), epoch=epoch,
            flux=np.ones(len(table)) * u.Jy, east=east, north=table["dec_offset"],
            feature=numbers,
        )  # fmt: skip
        path = tmp_path / f"{shift:g}.ecsv"
        found.to_table().write(path, format="ascii.ecsv")
        return published_positions(path, known_features.cube)

    return write


def test_the_same_features_have_their_numbers_and_speeds(
    known_features, written, tmp_path
):
    published = written(0.02)
    table = with_published(known_features.table, known_features, published)
    other = np.arange(len(table)) == 2
    assert np.array_equal(table["published"].mask, other)
    assert np.array_equal(table["published"][~other], np.flatnonzero(~other) + 1)
    close = table["published_pm"].unmasked - table["pm"]
    error = np.hypot(table["pm_err"], table["published_pm_err"].unmasked)
    assert np.all((np.abs(close) <= 3 * error)[~other])
    assert all(table[k].info.description for k in table.colnames)
    # They survive in the file.
    table.write(tmp_path / "out.ecsv")
    assert QTable.read(tmp_path / "out.ecsv")["published"].mask.sum() == 1


def test_how_many_agree_is_said(known_features, written):
    table = with_published(known_features.table, known_features, written())
    n, m = np.sum(table["secure"]), np.sum(table["secure"] & ~table["published"].mask)
    assert m > 1
    assert published_lines(table) == [
        f"{m} of {n} secure features are published ones, of which {m} have the "
        "published speed within 2 errors."
    ]
    first = np.flatnonzero(table["secure"])[0]
    table["published_pm"][first] *= 3
    assert f"; not {table['feature'][first]} (" in published_lines(table)[0]
    table["published"].mask = True
    assert published_lines(table) == [f"0 of {n} secure features are published ones."]
    assert (
        published_lines(with_published(known_features.table, known_features, None))
        == []
    )


def test_speeds_are_those_of_straight_lines(known_features, shared_data):
    table = shared_data / "mojave_xviii" / "1226+023.ecsv"
    # A table of one source may give it another name.
    with pytest.warns(EpochWarning, match="source is 3C 273, that of the images jet"):
        published = published_positions(table, known_features.cube)
    wanted = QTable.read(shared_data / "mojave_xviii" / "1226+023.linear-fits.csv")
    for row in wanted[:5]:
        own = published[published["published"] == row["feature"]]
        place = np.stack([own[k].value for k in ("ra_offset", "dec_offset")])
        speed, error = speed_of(own["date"].jyear, place)
        assert speed == pytest.approx(row["mu_mas_yr"], rel=0.01)
        assert error == pytest.approx(row["mu_err"], rel=0.1)


def test_a_table_of_other_things_is_refused(known_features, tmp_path, shared_data):
    zero, path = [0] * u.mas, tmp_path / "a.ecsv"
    one = {"times": Time(["2001-01-01"]), "epoch": [0], "flux": [1] * u.Jy}
    ComponentList(**one, east=zero, north=zero).to_table().write(path)
    with pytest.raises(ValueError, match=r"a\.ecsv: numbers no features; give a table"):
        published_positions(path, known_features.cube)
    journal = shared_data / "mojave_xviii" / "apjac230ft4_mrt.txt"
    with pytest.raises(ValueError, match="no source 'jet'; it has 0003"):
        published_positions(journal, known_features.cube)
    # Of a table of many it is the object.
    known = known_features.cube.with_step("named", meta={"object": "0003+380"})
    assert set(published_positions(journal, known)["published"]) == {*range(1, 8)}
