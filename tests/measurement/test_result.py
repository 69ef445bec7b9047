# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams, spectrum, maps and diagram of a result, as shown and on disk."""

import io
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.time import Time

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.epochs import serialize
from astro_scc.kinematics import PositionAngleFrame, RadialFrame, RidgeLine, SkyFrame
from astro_scc.measurement import SCCResult
from astro_scc.measurement.tables import paper_table

PM = u.mas / u.yr


def test_without_a_position_angle_parallel_is_along_the_flow(sky_result):
    """The simulated jet lies to the west of the reference pixel."""
    assert abs(sky_result.position_angle - 270 * u.deg) < 3 * u.deg
    assert sky_result.frame == SkyFrame()
    moving = sky_result.components[0]
    assert 0.9 * moving["pm"] < moving["pm_parallel"] <= moving["pm"]
    assert sky_result.components.meta["jet_position_angle"] == sky_result.position_angle


def test_streams_are_rows_in_their_order(sky_result):
    result, table = sky_result, sky_result.streams
    assert result.components is table
    for number, (row, stream) in enumerate(
        zip(table, result.search.streams, strict=True), start=1
    ):
        assert (row["stream"], row["kind"]) == (number, stream.kind)
        assert row["n_features"] == len(stream.members)
        found = row["pm_ra_cosdec"].value, row["pm_dec"].value
        np.testing.assert_allclose(found, stream.velocity)
        covariance = np.diag(stream.covariance)
        found = row["pm_ra_cosdec_err"].value, row["pm_dec_err"].value
        np.testing.assert_allclose(np.square(found), covariance)
        if row["kind"] == "moving":
            p = stream.p_global
            assert (row["p_local"], row["p_global"]) == (stream.p_local, p)
            assert row["p_global_err"] == pytest.approx(np.sqrt(p * (1 - p) / 200))
            assert row["pm_from"] == stream.source
            assert row["pm_features"].value == stream.features[0]
    assert table["p_smallest"][0] == pytest.approx(1 / 201)
    for name in ("slowest", "fastest", "unambiguous"):
        assert table.meta[name].to_value(PM) == getattr(result.search, name)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda r: r.components_in_c(cosmology="Planck18"),
            "redshift|cosmology|distance",
        ),
        (lambda r: r.velocity_map("p"), "unknown map 'p': use 'coefficient' or"),
    ],
)
def test_what_a_result_does_not_have(sky_result, call, words):
    with pytest.raises(ValueError, match=words):
        call(sky_result)


def test_the_velocity_map_has_velocity_coordinates(sky_result):
    found, grid = sky_result.velocity_map("z_score"), sky_result.grid
    np.testing.assert_array_equal(found.data, sky_result.z_score)
    v1, v2 = found.wcs.pixel_to_world(*np.indices(grid.shape[::-1]))
    np.testing.assert_allclose(v1[:, 0].to_value(PM), grid.v1, atol=1e-9)
    np.testing.assert_allclose(v2[0].to_value(PM), grid.v2, atol=1e-9)
    assert found.meta["axes"] == ("east", "north")


# The diagram ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def uneven(jet_cube):
    """Epochs at dates of which no two intervals are alike."""
    dates = Time("2001-03-01") + np.cumsum([0, 31, 43, 29, 90, 37]) * u.d
    scc = StackedCrossCorrelation(scales=[2], position_angle=270 * u.deg)
    return scc(replace(jet_cube[:6], times=dates), n_trials=119, rng=1)


def test_each_column_is_of_the_pairs_with_its_interval(uneven):
    image = uneven.diagram()
    n = image.data.shape[1]
    years = uneven.cube.years.to_value(u.yr)
    first, second = np.triu_indices(len(years), 1)
    interval = years[second] - years[first]
    # The first interval is the edge of the first column.
    columns = image.wcs.world_to_pixel_values(interval * (1 + 1e-9), 0 * interval)[0]
    count = np.bincount(np.rint(columns).astype(int), minlength=n)
    np.testing.assert_array_equal(count, image.meta["n_pairs"])
    np.testing.assert_array_equal(np.isnan(image.data).all(axis=0), count == 0)
    assert (count == 0).any()
    interval, _ = image.wcs.pixel_to_world(np.arange(n), np.zeros(n))
    ratio = (image.meta["interval"] / interval)[count > 0]
    np.testing.assert_allclose(ratio, 1, atol=0.062)


def test_values_are_correlations_less_their_mean(uneven):
    image, diagram = uneven.diagram(), uneven.search.diagram
    seen = image.meta["n_pairs"] > 0
    n, epochs = len(diagram.years), np.arange(len(diagram.years))
    top = diagram.sums[epochs, epochs, diagram.zero].mean()
    first, second = np.triu_indices(n, 1)
    apart = ~np.eye(n, dtype=bool)
    mean = (diagram.means / top)[apart].mean(axis=0)
    total = (diagram.means / top)[first, second].sum(axis=0) - len(first) * mean
    found = (image.data * image.meta["n_pairs"])[:, seen].sum(axis=1)
    np.testing.assert_allclose(found, total, atol=1e-5)
    _, displacement = image.wcs.pixel_to_world(0, np.arange(len(image.data)))
    beam = uneven.search.beam
    np.testing.assert_allclose(
        displacement.to_value(u.mas), diagram.displacement * beam, rtol=1e-9, atol=1e-9
    )
    assert image.meta["beam"].to_value(u.mas) == beam
    # The other end of the axis turns the diagram.
    other = replace(uneven, position_angle=uneven.position_angle + 180 * u.deg)
    turned = other.diagram()
    np.testing.assert_array_equal(turned.data, image.data[::-1])
    np.testing.assert_array_equal(turned.meta["direction"], -image.meta["direction"])
    away = turned.meta["position_angle"] - image.meta["position_angle"]
    assert abs(away.to_value(u.deg)) == pytest.approx(180)


# What is shown --------------------------------------------------------------------


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


# Files ----------------------------------------------------------------------------


def texts(result):
    """The tables as text."""
    names = "streams", "spectrum", "features", "feature_positions", "ssps"
    found = {name: io.StringIO() for name in names}
    for name in names:
        getattr(result, name).write(found[name], format="ascii.ecsv")
    return {name: text.getvalue() for name, text in found.items()}


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
    assert texts(again) == texts(sky_result)
    one, other = (r.diagram().data.tobytes() for r in (sky_result, again))
    assert one == other
    assert repr(sky_result) == repr(again)


def refused(path, match):
    with pytest.raises(OSError, match=match) as caught:
        SCCResult.read(path)
    assert len(str(caught.value).splitlines()) == 1


class Axes:
    """A frame of a user, without fields that could be written."""


def test_what_is_no_result_is_refused_in_one_line(path, sky_result, tmp_path):
    other = tmp_path / "other.fits"
    sky_result.cube.write(other)
    refused(other, "other.fits: cannot be read as astro_scc result.*not written as one")
    whole = path.read_bytes()
    spot = len(whole) // 2
    other.write_bytes(whole[:spot] + bytes([whole[spot] ^ 1]) + whole[spot + 1 :])
    refused(other, "hecksum")
    with pytest.raises(ValueError, match=r"is a whole result; give .*SCCResult"):
        EpochCube.read(path)
    with fits.open(path) as hdus:
        text = hdus["META"].data.tobytes().replace(b"choices:", b"options:")
        hdus["META"].data = np.frombuffer(text, np.uint8)
        hdus.writeto(other, checksum=True, overwrite=True)
    refused(other, "its SCCResult is of another version of astro_scc")
    with pytest.raises(OSError, match=r"jet.fits: exists; pass overwrite=True"):
        sky_result.write(path)
    flow = replace(sky_result.flow, frame=Axes())
    search = replace(sky_result.search, flow=flow)
    with pytest.raises(ValueError, match="frame: an object Axes cannot be"):
        replace(sky_result, search=search).write(tmp_path / "jet.fits")
    assert [p.name for p in tmp_path.iterdir()] == ["other.fits"]


@pytest.mark.parametrize(
    "array",
    [
        np.arange(600, dtype=">i4").reshape(20, 30).T,
        np.arange(200) % 3 == 0,
        np.array(2.5, dtype=np.float32),
        np.empty((0, 4)),
        np.array(["a", "bc"] * 100),
    ],
)
def test_arrays_of_all_kinds(array, tmp_path):
    serialize.write_object({"a": [array]}, tmp_path / "a.fits", creator="test")
    (again,) = serialize.read_object(tmp_path / "a.fits", creator="test")["a"]
    assert again.dtype == array.dtype.newbyteorder("=")
    np.testing.assert_array_equal(again, array)


def test_frames_come_back(tmp_path):
    ridge = RidgeLine([0, -5, -12] * u.mas, [0, 0.1, 0.3] * u.mas)
    frames = PositionAngleFrame(270 * u.deg), RadialFrame([1, 2] * u.mas), ridge
    serialize.write_object({"frames": frames}, tmp_path / "a.fits", creator="test")
    again = serialize.read_object(tmp_path / "a.fits", creator="test")["frames"]
    assert repr(again) == repr(frames)
    for one, other in zip(again, frames, strict=True):
        np.testing.assert_array_equal(one.matrix(3.0, 4.0), other.matrix(3.0, 4.0))
