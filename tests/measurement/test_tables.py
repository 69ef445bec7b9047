# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tables and results, as shown and on disk, and adjusted p-values."""

import io
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.epochs.align import alignment_errors
from astro_scc.kinematics import SkyFrame
from astro_scc.measurement import SCCResult, false_discovery_rate
from astro_scc.measurement.cautions import _of_pointing
from astro_scc.measurement.tables import paper_table, stream_table, velocity_columns


def test_the_settings_of_a_table_can_be_used_again(sky_result, tmp_path):
    sky_result.components.write(tmp_path / "c.ecsv")
    meta = QTable.read(tmp_path / "c.ecsv").meta
    assert meta["versions"]["numpy"] == np.__version__
    again = StackedCrossCorrelation(**meta["settings"])
    assert again.to_dict() == sky_result.meta["settings"]


speeds, errors = st.floats(-5, 5), st.floats(0.01, 2)
correlations = st.floats(-0.95, 0.95)


@given(speeds, speeds, errors, errors, correlations, st.floats(-360, 360))
def test_on_the_sky_frame(east, north, err1, err2, correlation, pa):
    covariance = np.diag([err1, err2])
    covariance = covariance @ [[1, correlation], [correlation, 1]] @ covariance
    velocity, speed = np.array([east, north]), np.hypot(east, north)
    row = velocity_columns(velocity, covariance, SkyFrame(), pa * u.deg)
    along = np.array([np.sin(np.radians(pa)), np.cos(np.radians(pa))])
    axes = {"ra_cosdec": np.array([1, 0]), "dec": np.array([0, 1]), "parallel": along}
    axes["transverse"] = np.array([along[1], -along[0]])
    for name, axis in axes.items():
        expected = pytest.approx(axis @ velocity, rel=1e-9, abs=1e-9)
        assert row[f"pm_{name}"] == expected
        error = np.sqrt(axis @ covariance @ axis)
        assert row[f"pm_{name}_err"] == pytest.approx(error, rel=1e-6)
    assert row["pm"] == pytest.approx(speed)
    assert 0 <= row["pm_pa"] <= 360
    if speed > 1e-6:
        unit, pa = velocity / speed, np.radians(row["pm_pa"])
        np.testing.assert_allclose((np.sin(pa), np.cos(pa)), unit, atol=1e-9)
        assert row["pm_err"] == pytest.approx(np.sqrt(unit @ covariance @ unit))


def table(p, **columns):
    return QTable({"p_global": np.array(p, dtype=float), **columns})


probability = st.integers(1, 40).map(lambda b: b / 40)
probabilities = st.lists(probability, min_size=1, max_size=9)


@settings(max_examples=30)
@given(groups=st.lists(probabilities, min_size=1, max_size=4))
def test_is_the_procedure_over_all_tables_together(groups):
    """The smallest rate at which the procedure would accept each of them."""
    got = [t["p_fdr"] for t in false_discovery_rate([table(p) for p in groups])]
    p = np.concatenate(groups)
    rates = {other: len(p) * other / np.sum(p <= other) for other in p}
    expected = [min(1.0, *(rates[other] for other in p if other >= own)) for own in p]
    np.testing.assert_allclose(np.concatenate(got), expected, rtol=1e-12)


def test_empty_tables_are_searches_and_what_stands_still_is_none():
    own = {"a": table([0.01, 1.0], kind=["moving", "stationary"]), "b": table([0.02])}
    own |= {f"none {k}": stream_table([]) for k in range(18)}
    once = false_discovery_rate(own)
    assert once["a"]["p_fdr"].tolist() == pytest.approx([0.2, 1.0])
    assert once["b"]["p_fdr"].tolist() == pytest.approx([0.2])
    assert once["a"].meta["false_discovery"] == {"method": "bh", "n_tests": 20}
    empty = once["none 1"]["p_fdr"]
    assert (len(empty), empty.dtype) == (0, float)
    assert empty.info.description
    # They are copies, and can be adjusted again.
    twice = false_discovery_rate(once)
    assert own["b"].colnames == ["p_global"]
    np.testing.assert_array_equal(once["b"]["p_fdr"], twice["b"]["p_fdr"])
    assert false_discovery_rate([]) == []


def test_says_what_is_wrong():
    for tables, words in [
        (table([0.1]), r"got one: give \[table\]"),
        ([table([0.1]), QTable()], "table 1 has no column p_global"),
        ({"inner": table([np.nan])}, "between 0 and 1"),
    ]:
        with pytest.raises((TypeError, ValueError), match=words):
            false_discovery_rate(tables)


def test_errors_of_the_alignment_are_given_or_those_that_it_found():
    data, times = np.zeros((3, 81, 81)), Time("2010-01-01") + [0, 73, 292] * u.day
    cube = EpochCube.from_arrays(data, times, pixel_scale=0.1 * u.mas)
    np.testing.assert_array_equal(alignment_errors(cube), np.zeros((3, 2)))
    one = alignment_errors(cube, 0.2e-3 * u.arcsec)
    np.testing.assert_allclose(one, np.full((3, 2), 0.2))
    each = alignment_errors(cube, [0.1, 0.0, 0.3] * u.mas)
    np.testing.assert_allclose(each, [[0.1, 0.1], [0, 0], [0.3, 0.3]])
    with pytest.raises(ValueError, match="must be 1 or 3 angles, got 2"):
        alignment_errors(cube, [0.1, 0.2] * u.mas)
    columns = {"east": [0, 0, 0], "north": [0, 0, 0]}
    columns |= {"east_err": [3, 1, 0], "north_err": [4, 1, 0]}
    table = QTable({name: values * u.uas for name, values in columns.items()})
    table["epoch"] = [time.isot[:10] for time in cube.times]
    aligned = cube.align("table", table=table)
    found = alignment_errors(aligned)
    np.testing.assert_allclose(found[:, 0], [np.sqrt(12.5e-6), 1e-3, 0], atol=1e-9)
    np.testing.assert_array_equal(alignment_errors(aligned[1:]), found[1:])


def test_what_moves_as_its_coordinates_drift_is_said(jet_cube):
    wcs, years = jet_cube.wcs, jet_cube.years.to_value(u.yr)
    drifted = [wcs.deepcopy() for _ in years]
    for one, t in zip(drifted, years - years[0], strict=True):
        one.wcs.crval += [0, 2 * t / 3.6e6]
    cube = replace(jet_cube, epoch_wcs=drifted)
    for images, north, said in [(cube, -2, 1), (cube, 2, 0), (jet_cube, -2, 0)]:
        row = {"pm_ra_cosdec": 0.1, "pm_dec": north, "pm_err": 0.1}
        assert len(_of_pointing(images, row)) == said


def test_without_a_position_angle_parallel_is_along_the_flow(sky_result):
    """The simulated jet lies to the west of the reference pixel."""
    assert abs(sky_result.position_angle - 270 * u.deg) < 3 * u.deg
    moving = sky_result.components[0]
    assert 0.9 * moving["pm"] < moving["pm_parallel"] <= moving["pm"]


def test_dates_have_times_where_epochs_share_a_day():
    hours = Time("2010-01-01") + [1.0, 9.5, 25.0] * u.h
    table = QTable({"first": hours[[0, 0]], "last": hours[1:], "n_epochs": [2, 3]})
    printed = paper_table(table)
    assert printed["first"].tolist() == ["2010-01-01T01:00:00"] * 2
    assert printed["last"].tolist() == ["2010-01-01T09:30:00", "2010-01-02T01:00:00"]
    assert paper_table(table[1:])["last"].tolist() == ["2010-01-02"]
    # As some of its epochs, which the table lacks, share a day.
    table.meta["first_epoch"] = "2010-01-01T01:00:00"
    assert paper_table(table[1:])["last"].tolist() == ["2010-01-02T01:00:00"]
    # None do, though means of dates are of one day.
    table.meta["first_epoch"] = "2010-01-01"
    assert paper_table(table)["last"].tolist() == ["2010-01-01", "2010-01-02"]


def test_what_a_notebook_and_a_terminal_show(sky_result, read_page):
    table = paper_table(sky_result.components)
    page = read_page(sky_result._repr_html_())
    assert len(page.all("td")) == len(table.colnames) * len(table)
    assert table["pm"][0] in page.text
    speed = table["pm"][0].replace("±", "+-")
    assert f": {speed} mas/yr moving, 8 epochs>" in repr(sky_result)
    # Text is escaped.
    cube = replace(sky_result.cube, meta={"object": "<script>alert(1)</script>"})
    result = replace(sky_result, decomposed=replace(sky_result.decomposed, cube=cube))
    assert "&lt;script&gt;" in result._repr_html_()
    empty = replace(sky_result, search=replace(sky_result.search, streams=()))
    assert "no stream, 8 epochs>" in repr(empty)
    assert "<table" not in empty._repr_html_()


@pytest.fixture(scope="module")
def path(sky_result, tmp_path_factory):
    path = tmp_path_factory.mktemp("result") / "jet.fits"
    sky_result.write(path)
    return path


def test_everything_comes_back_to_the_bit(path, sky_result, tmp_path):
    again = SCCResult.read(path)
    again.write(tmp_path / "again.fits")
    # The check sums hold the time of writing.
    how = {"ignore_keywords": ["CHECKSUM"], "ignore_comments": ["*"]}
    assert fits.FITSDiff(str(path), str(tmp_path / "again.fits"), **how).identical
    for name in ("streams", "spectrum", "features", "feature_positions", "ssps"):
        one, other = io.StringIO(), io.StringIO()
        for result, text in ((again, one), (sky_result, other)):
            getattr(result, name).write(text, format="ascii.ecsv")
        assert one.getvalue() == other.getvalue()
    assert repr(sky_result) == repr(again)


def refused(path, match):
    with pytest.raises(OSError, match=match) as caught:
        SCCResult.read(path)
    assert len(str(caught.value).splitlines()) == 1


def test_what_is_no_result_is_refused_in_one_line(path, sky_result, tmp_path):
    other = tmp_path / "other.fits"
    sky_result.cube.write(other)
    refused(other, "other.fits: cannot be read as astro_scc result.*not written as one")
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 1
    other.write_bytes(whole)
    refused(other, "hecksum")
    with pytest.raises(ValueError, match=r"is a whole result; give .*SCCResult"):
        EpochCube.read(path)
    with fits.open(path) as hdus:
        text = hdus["META"].data.tobytes().replace(b"choices:", b"options:")
        hdus["META"].data = np.frombuffer(text, np.uint8)
        hdus.writeto(other, checksum=True, overwrite=True)
    refused(other, "its SCCResult is of another version of astro_scc")
    # A frame of a user, without fields that could be written.
    flow = replace(sky_result.flow, frame=object())
    search = replace(sky_result.search, flow=flow)
    with pytest.raises(ValueError, match="frame: an object object cannot be"):
        replace(sky_result, search=search).write(tmp_path / "jet.fits")
    assert [p.name for p in tmp_path.iterdir()] == ["other.fits"]
