# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tables as VOTable."""

import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.io.votable import parse, validate
from astropy.table import MaskedColumn, QTable
from astropy.time import Time
from astropy.utils.masked import Masked

from astro_scc.measurement import write_votable
from astro_scc.measurement.tables import component_table


def test_components_and_ssps(sky_result, tmp_path):
    for name, table in (("c", sky_result.components), ("s", sky_result.ssps)):
        path = tmp_path / f"{name}.vot"
        write_votable(table, path)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read = QTable.read(path, format="votable")
        assert read.colnames == table.colnames
        for column in table.colnames:
            one, other = table[column], read[column]
            # VOTable has a unit for each real number.
            assert (getattr(one, "unit", None) or u.one) == (
                getattr(other, "unit", None) or u.one
            )
            np.testing.assert_array_equal(np.asarray(one), np.asarray(other))
            assert (other.info.description or "") == (one.info.description or "")


def test_empty_and_meta(tmp_path):
    path = tmp_path / "a.vot"
    meta = {"seed": 1, "level": 0.05, "done": True, "note": "two words", "settings": {}}
    write_votable(component_table([], meta=meta), path)
    votable = parse(path).get_first_table()
    params = {param.name: param.value for param in votable.params}
    assert params == {"seed": 1, "level": 0.05, "done": True, "note": "two words"}
    assert votable.get_field_by_id_or_name("pm").unit == u.mas / u.yr
    with pytest.raises(OSError, match=r"a\.vot: exists"):
        write_votable(component_table([]), path)


def test_dates_and_short_numbers(tmp_path):
    path = tmp_path / "a.vot"
    table = QTable({"date": Time(["2000-01-01"]), "sign": np.array([-1], np.int8)})
    write_votable(table, path)
    read = QTable.read(path)
    assert read["date"][0] == "2000-01-01T00:00:00.000"
    assert read["sign"][0] == -1
    write_votable(table[:0], path, overwrite=True)
    assert QTable.read(path)["date"].dtype.kind in "OU"


def test_what_a_row_has_not_stays_masked(tmp_path):
    path = tmp_path / "a.vot"
    epoch = Masked([1.5, 2.5] * u.yr, mask=[True, False])
    share = MaskedColumn([0.5, 0.25], mask=[False, True])
    write_votable(QTable({"t_ej": epoch, "share": share}), path)
    read = QTable.read(path)
    assert read["t_ej"].mask.tolist() == [True, False]
    assert read["t_ej"][1] == 2.5 * u.yr
    assert read["share"].mask.tolist() == [False, True]


def test_validates(sky_result, tmp_path, capsys):
    path = tmp_path / "a.vot"
    write_votable(sky_result.components, path)
    assert validate(path), capsys.readouterr().out
