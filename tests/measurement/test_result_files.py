# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Results as files: what is written comes back to the bit, in another session too."""

import io
from dataclasses import fields, is_dataclass, replace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time
from astropy.utils.masked import Masked
from astropy.wcs import WCS

from astro_scc import EpochCube
from astro_scc.images import serialize
from astro_scc.kinematics import RidgeLine
from astro_scc.measurement import SCCResult
from astro_scc.measurement.publication import latex_text_of
from astro_scc.measurement.tables import paper_table
from astro_scc.quantities import decimals

FRAMES = {
    "sky": None,
    "jet": 270 * u.deg,
    "radial": "radial",
    "ridge": RidgeLine([0, -5, -12] * u.mas, [0, 0.1, 0.3] * u.mas),
}


def same(one, other, name="result"):
    """Return whether two objects are alike down to the bits of their arrays."""
    assert type(one) is type(other) or isinstance(one, np.generic), name
    if is_dataclass(one):
        for own in fields(one):
            same(getattr(one, own.name), getattr(other, own.name), own.name)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype, name
        assert one.shape == other.shape, name
        assert getattr(one, "unit", None) == getattr(other, "unit", None), name
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes(), name
    elif isinstance(one, dict):
        assert list(one) == list(other), name
        for key in one:
            same(one[key], other[key], f"{name}.{key}")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), name
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            same(a, b, f"{name}[{k}]")
    elif isinstance(one, WCS):
        for key in ("crval", "crpix", "cdelt", "pc"):
            assert np.array_equal(getattr(one.wcs, key), getattr(other.wcs, key)), name
    elif isinstance(one, Time):
        assert np.array_equal(one.jd1, other.jd1), name
        assert np.array_equal(one.jd2, other.jd2), name
    else:
        assert one == other or (np.isnan(one) and np.isnan(other)), name


def tables(result):
    return {
        "components": result.components,
        "features": result.features,
        "feature_positions": result.feature_positions,
        "ssps": result.ssps,
        "members": result.members(1),
    }


def text_of(table):
    text = io.StringIO()
    table.write(text, format="ascii.ecsv")
    return text.getvalue()


@pytest.fixture(scope="module")
def path(sky_result, tmp_path_factory):
    path = tmp_path_factory.mktemp("result") / "jet.fits"
    sky_result.write(path)
    return path


@pytest.mark.parametrize("name", FRAMES)
def test_everything_comes_back_to_the_bit(name, stacked, tmp_path):
    result = stacked(FRAMES[name])
    result.write(tmp_path / "jet.fits")
    again = SCCResult.read(tmp_path / "jet.fits")
    same(result, again)
    for kind, table in tables(again).items():
        assert text_of(table) == text_of(tables(result)[kind])
    for which in ("coefficient", "z_score"):
        one, other = (r.velocity_map(which).data for r in (result, again))
        assert one.tobytes() == other.tobytes()
    assert result.diagram().data.tobytes() == again.diagram().data.tobytes()
    assert repr(result) == repr(again)
    # Decompositions can be computed again.
    planes = (r.matched.decompositions[0].planes for r in (result, again))
    np.testing.assert_array_equal(*planes)


def test_files_are_not_replaced_unasked(path, sky_result):
    with pytest.raises(OSError, match=r"jet.fits: exists; pass overwrite=True"):
        sky_result.write(path)
    sky_result.write(path, overwrite=True)


def refused(path, match):
    with pytest.raises(OSError, match=match) as caught:
        SCCResult.read(path)
    assert len(str(caught.value).splitlines()) == 1


def test_what_is_no_result_is_refused_in_one_line(path, sky_result, tmp_path):
    refused(tmp_path / "none.fits", "No such file")
    other = tmp_path / "other.fits"
    other.write_text("nothing")
    refused(other, "other.fits: is no complete astro_scc result file")
    sky_result.cube.write(other, overwrite=True)
    refused(other, "other.fits: is no complete astro_scc result.*not written as one")
    sky_result.matched.write(other, overwrite=True)
    refused(other, "not written as one")
    whole = path.read_bytes()
    other.write_bytes(whole[: len(whole) // 2])
    refused(other, "other.fits: is no complete astro_scc result file")
    spot = len(whole) // 2
    other.write_bytes(whole[:spot] + bytes([whole[spot] ^ 1]) + whole[spot + 1 :])
    refused(other, "hecksum")
    with pytest.raises(ValueError, match=r"is a whole result; give .*SCCResult"):
        EpochCube.read(path)


def test_results_of_other_versions_are_refused(path, sky_result, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(serialize, "LAYOUT", 99)
        sky_result.write(tmp_path / "new.fits")
    refused(tmp_path / "new.fits", "new.fits: of layout 99; read it with the version")
    with fits.open(path) as hdus:
        text = hdus["META"].data.tobytes().replace(b"jitters:", b"tremors:")
        hdus["META"].data = np.frombuffer(text, np.uint8)
        hdus.writeto(tmp_path / "old.fits", checksum=True)
    refused(tmp_path / "old.fits", "its SCCResult is of another version of astro_scc")


class Axes:
    """A frame of a user, without fields that could be written."""


def test_what_cannot_be_written(sky_result, tmp_path):
    with pytest.raises(ValueError, match="frame: an object Axes cannot be"):
        replace(sky_result, frame=Axes()).write(tmp_path / "jet.fits")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3).T,
        np.arange(600, dtype=">i4").reshape(20, 30).T,
        np.arange(200, dtype=np.uint16),
        np.arange(200) % 3 == 0,
        np.array(2.5, dtype=np.float32),
        np.empty((0, 4)),
        np.full(200, np.nan),
        np.array(["a", "bc"] * 100),
    ],
)
def test_arrays_of_all_kinds(array, tmp_path):
    write = {"creator": "test", "overwrite": True}
    serialize.write_object({"a": [array]}, tmp_path / "a.fits", **write)
    (again,) = serialize.read_object(tmp_path / "a.fits", creator="test")["a"]
    assert again.dtype == array.dtype.newbyteorder("=")
    np.testing.assert_array_equal(again, array)


# Tables that are printed --------------------------------------------------------


def test_what_a_paper_table_cannot_know():
    table = QTable(
        {
            "feature": ["2001_s2", "50% & more"],
            "first": Time(["2001-01-01", "2002-05-01"]),
            "pm": [2.128, np.nan] * u.mas / u.yr,
            "pm_err": [np.nan, np.nan] * u.mas / u.yr,
            "t_ej": Masked([2000.12, 0.0] * u.yr, mask=[False, True]),
            "t_ej_err": Masked([0.1, 0.0] * u.yr, mask=[False, True]),
            "r_min": [-3.14159, 20.0] * u.mas,
        }
    )
    plain = paper_table(table)
    assert plain.colnames == ["feature", "r_min", "first", "pm", "t_ej"]
    assert list(plain["pm"]) == ["2.13 (error unknown)", "-"]
    rows = latex_text_of(table, "tracks", "aastex").splitlines()
    assert rows[rows.index(r"\startdata") + 1 : rows.index(r"\enddata")] == [
        r"2001\_s2 & $-3.142$ & 2001-01-01 & $2.13 \pm \ldots$ & $2000.12 \pm 0.10$ \\",
        r"50\% \& more & 20 & 2002-05-01 & \nodata & \nodata",
    ]


def test_printed_columns_are_rounded_to_their_errors(sky_result):
    table = sky_result.components
    least = table["pm_err"].value.min()
    digits = decimals(least)
    assert table["pm"].info.format == table["pm_err"].info.format == f".{digits}f"
    assert f"{least:.{digits}f}" in "".join(table["pm", "pm_err"].pformat())
    # The numbers are whole, in files too.
    assert table["pm"][0].value != round(table["pm"][0].value, digits)
    again = QTable.read(text_of(table), format="ascii.ecsv")
    np.testing.assert_array_equal(again["pm"], table["pm"])
