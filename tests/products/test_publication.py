# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tables in the forms of journals and archives, and published features beside them."""

import re

import astropy.units as u
import numpy as np
import pytest
from astropy.io import ascii
from astropy.io.votable import parse, validate
from astropy.io.votable.ucd import check_ucd
from astropy.table import QTable, vstack
from astropy.time import Time

from astro_scc.columns import column_of, columns_of
from astro_scc.epochs import ComponentList
from astro_scc.exceptions import EpochWarning
from astro_scc.kinematics.cosmology import table_in_c_as
from astro_scc.products import publication
from astro_scc.report.answer import published_lines

NAMES = ("streams", "features", "positions")


@pytest.fixture(scope="module")
def printed(sky_result):
    """Tables of a measurement with speeds in units of c and the name of a source."""
    streams = sky_result.components_in_c(redshift=0.158)
    features = table_in_c_as(sky_result.features, streams)
    meta = streams.meta | {"object": "3C_1 50%", "position": "1h00m00s +30d00m00s"}
    found = streams, features, sky_result.feature_positions
    made = {name: table.copy() for name, table in zip(NAMES, found, strict=True)}
    for table in made.values():
        table.meta = meta
    return made


@pytest.fixture(scope="module")
def folder(printed, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    paths = publication.write_publication(printed, out)
    assert {path.parent for path in paths} == {out / "publication"}
    wanted = {f"{n}_{k}.tex" for n in NAMES[:2] for k in ("aastex", "aa")}
    wanted |= {f"{n}{end}" for n in NAMES for end in ("_mrt.txt", ".vot")}
    assert {path.name for path in paths} == wanted
    return out / "publication"


@pytest.mark.parametrize("name", NAMES)
def test_archives_read_the_numbers(folder, printed, name):
    path, table = folder / f"{name}_mrt.txt", printed[name]
    text = path.read_text()
    assert f"description of file: {path.name}".lower() in text.lower()
    assert re.search(r"\nTable: .* of .*3C_1 50%", text) or name == "features"
    assert "Note: Apparent speeds are for redshift 0.158, " in text
    found = ascii.read(str(path), format="mrt")
    # The core is the reference, and in no paper.
    assert len(found) == len(table)
    for own, column in zip(found.colnames, table.colnames, strict=True):
        stem = column.removesuffix("_err").replace("_err_", "_")
        assert own == (f"e_{stem}" if "_err" in column else column)
        one = table[column]
        assert (found[own].unit or u.one) == (getattr(one, "unit", None) or u.one)
        if getattr(one, "dtype", np.dtype(str)).kind != "f":
            continue
        values = np.asarray(getattr(one, "value", one), dtype=float)
        known = np.isfinite(values)
        got = np.ma.filled(np.ma.asarray(found[own], dtype=float), np.nan)
        assert np.array_equal(np.isfinite(got), known)
        near = 1e-2 * np.abs(values)
        if f"{column}_err" in table.colnames:
            near = 0.06 * u.Quantity(table[f"{column}_err"]).value
        least = np.min(near[known & (near > 0)], initial=1.0)
        # Errors and probabilities have two digits, and so have z-scores.
        rough = "_err" in column or column.startswith(("p_", "z_"))
        how = {"atol": least, "rtol": 0.05 if rough else 5e-4}
        np.testing.assert_allclose(got[known], values[known], **how)


@pytest.mark.parametrize("name", NAMES)
def test_a_votable_says_of_what_it_is(folder, name, capsys):
    path = folder / f"{name}.vot"
    assert validate(path), capsys.readouterr().out
    votable = parse(path, verify="exception")
    table, (resource,) = votable.get_first_table(), votable.resources
    (frame,), times = resource.coordinate_systems, resource.time_systems
    assert all(field.ucd for field in table.fields if field.name != "scale_groups")
    params = {param.name: param for param in table.params}
    assert params["object"].value == "3C_1 50%"
    assert (params["ra"].value, params["dec"].value) == pytest.approx((15, 30))
    assert params["ra"].ref == frame.ID
    dates = [field for field in table.fields if field.ref]
    assert len(dates) == {"streams": 0, "features": 3, "positions": 1}[name]
    assert [k.timescale for k in times] == ["UTC"] * bool(dates)


def test_columns_are_described_and_have_ucds_of_the_vocabulary(sky_result):
    for own in ("streams", "features", "positions", "ssps", "added"):
        for name in columns_of(own):
            ucd = column_of(name)["ucd"]
            assert check_ucd(ucd, check_controlled_vocabulary=True), name
            assert ucd.startswith("stat.error;") == ("_err" in name)
    assert column_of("unheard_of")["ucd"] == ""
    names = "streams features feature_positions ssps sensitivity spectrum".split()
    for table in (getattr(sky_result, k) for k in names):
        assert [n for n in table.colnames if not table[n].info.description] == []


@pytest.mark.parametrize("rows", [2, publication.ONE_PAGE + 1])
@pytest.mark.parametrize("journal", ["aastex", "aa"])
def test_latex_of_both_journals(printed, journal, rows):
    table, long = printed["streams"], rows > publication.ONE_PAGE
    meta = table.meta
    table = vstack([table] * rows, metadata_conflicts="silent")[:rows]
    table.meta = meta
    text = publication.latex_texts_of(table, "streams")[journal]
    begun, ended = (re.findall(rf"\\{k}\{{(.*?)\}}", text) for k in ("begin", "end"))
    assert sorted(begun) == sorted(ended)
    wanted = {"aastex": ["deluxetable*"], "aa": ["table*", "tabular"]}[journal]
    assert begun == (["longtable"] if long and journal == "aa" else wanted)
    assert (r"\startlongtable" in text) == (long and journal == "aastex")
    for words in (r"Velocities of the streams of 3C\_1 50\%.", "H0 = 71 km/s/Mpc"):
        assert words in text
    assert r"(\mathrm{mas\,yr^{-1}}" in text.replace("$", "")
    assert " <" not in text.partition(r"\tablecomments")[0]
    body = [line for line in text.splitlines() if re.match(r"\d+ & (mov|stat)", line)]
    (align,) = set(re.findall(r"\{(l{3,})\}", text))
    lines = [line for line in text.splitlines() if " & " in line]
    assert {len(re.findall(r"(?<!\\)&", line)) for line in lines} == {len(align) - 1}
    for line, row in zip(body, table, strict=True):
        value, error = map(float, re.search(r"\$(\S+) \\pm (\S+)\$", line).groups())
        assert value == pytest.approx(row["pm"].value, abs=0.06 * row["pm_err"].value)
        assert error == pytest.approx(row["pm_err"].value, rel=0.06)
    assert journal == "aastex" or r"\providecommand{\nodata}" in text


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
        return publication.published_positions(path, known_features.cube)

    return write


def test_the_same_features_have_their_numbers_and_speeds(known_features, written):
    published = written(0.02)
    table = publication.with_published(known_features.table, known_features, published)
    other = np.arange(len(table)) == 2
    assert np.array_equal(table["published"].mask, other)
    assert np.array_equal(table["published"][~other], np.flatnonzero(~other) + 1)
    close = table["published_pm"].unmasked - table["pm"]
    error = np.hypot(table["pm_err"], table["published_pm_err"].unmasked)
    assert np.all((np.abs(close) <= 3 * error)[~other])


def test_how_many_agree_is_said(known_features, written):
    table = publication.with_published(known_features.table, known_features, written())
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
    none = publication.with_published(known_features.table, known_features, None)
    assert published_lines(none) == []


def test_speeds_are_those_of_straight_lines(known_features, shared_data):
    table = shared_data / "mojave_xviii" / "1226+023.ecsv"
    # A table of one source may give it another name.
    with pytest.warns(EpochWarning, match="source is 3C 273, that of the images jet"):
        published = publication.published_positions(table, known_features.cube)
    wanted = QTable.read(shared_data / "mojave_xviii" / "1226+023.linear-fits.csv")
    for row in wanted[:5]:
        own = published[published["published"] == row["feature"]]
        place = np.stack([own[k].value for k in ("ra_offset", "dec_offset")])
        speed, error = publication.speed_of(own["date"].jyear, place)
        assert speed == pytest.approx(row["mu_mas_yr"], rel=0.01)
        assert error == pytest.approx(row["mu_err"], rel=0.1)


def test_a_table_of_other_things_is_refused(known_features, tmp_path, shared_data):
    zero, path = [0] * u.mas, tmp_path / "a.ecsv"
    one = {"times": Time(["2001-01-01"]), "epoch": [0], "flux": [1] * u.Jy}
    ComponentList(**one, east=zero, north=zero).to_table().write(path)
    with pytest.raises(ValueError, match=r"a\.ecsv: numbers no features; give a table"):
        publication.published_positions(path, known_features.cube)
    # Its fault is not that it does not name the source.
    path.write_text(path.read_text().replace("Jy", "mas"))
    with pytest.raises(ValueError, match="column 'flux' has the unit mas"):
        publication.published_positions(path, known_features.cube)
    journal = shared_data / "mojave_xviii" / "apjac230ft4_mrt.txt"
    with pytest.raises(ValueError, match="no source 'jet'; it has 0003"):
        publication.published_positions(journal, known_features.cube)
    # Of a table of many it is the object.
    known = known_features.cube.with_step("named", meta={"object": "0003+380"})
    assert set(publication.published_positions(journal, known)["published"]) == {
        *range(1, 8)
    }
