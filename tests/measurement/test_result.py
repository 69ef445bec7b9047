# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Components, maps, diagram and members of a result, as shown and on disk."""

import io
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.time import Time

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.epochs import serialize
from astro_scc.exceptions import MeasurementWarning
from astro_scc.kinematics import PositionAngleFrame, RadialFrame, RidgeLine, SkyFrame
from astro_scc.measurement import SCCResult
from astro_scc.measurement.tables import paper_table, printed

PM = u.mas / u.yr


def test_without_a_position_angle_parallel_is_along_the_flow(sky_result):
    """The simulated jet lies to the west of the reference pixel."""
    assert abs(sky_result.position_angle - 270 * u.deg) < 3 * u.deg
    assert sky_result.frame == SkyFrame()
    moving = sky_result.components[0]
    assert 0.9 * moving["pm"] < moving["pm_parallel"] <= moving["pm"]
    assert sky_result.components.meta["jet_position_angle"] == sky_result.position_angle


def test_components_are_the_streams_in_their_order(sky_result):
    result, table = sky_result, sky_result.components
    every = result.search.streams, result.velocities, result.maxima, result.jitters
    for row, stream, velocity, peak, jitter in zip(table, *every, strict=True):
        assert (row["kind"], row["caution"]) == (stream.kind, stream.reason or "-")
        p = stream.p_global
        assert (row["p_local"], row["p_global"]) == (stream.p_local, p)
        assert row["p_global_err"] == pytest.approx(np.sqrt(p * (1 - p) / 40))
        assert row["p_smallest"] == pytest.approx(1 / 41)
        assert row["n_features"] == len(stream.features)
        found = row["pm_ra_cosdec"].value, row["pm_dec"].value
        np.testing.assert_array_equal(found, velocity.value)
        # The paper's error stands beside that of the features.
        along = velocity.value / np.hypot(*velocity.value)
        expected = pytest.approx((along @ jitter @ along) ** 0.5, nan_ok=True)
        assert row["pm_err_jitter"].value == expected
        # The maximum of the stack near it.
        away = np.subtract((peak.v1, peak.v2), velocity.value)
        assert np.abs(away).max() <= 0.5 / np.mean(result.pairs.interval)
        assert row["coefficient"] == result.coefficient[peak.row, peak.column]
        assert row["z_score"] == result.z_score[peak.row, peak.column]
    assert table["pm_err_jitter"][0] > 0 * PM


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda r: r.components_in_c(cosmology="Planck18"),
            "redshift|cosmology|distance",
        ),
        (lambda r: r.members(0), "no stream 0: there are"),
        (lambda r: r.members(len(r.components) + 1), "no stream .: there are"),
        (lambda r: r.velocity_map("p"), "unknown map 'p': use 'coefficient' or"),
    ],
)
def test_what_a_result_does_not_have(sky_result, call, words):
    with pytest.raises(ValueError, match=words):
        call(sky_result)


def test_members_are_the_matches_between_ssps_of_one_feature(sky_result):
    d = sky_result.displacements
    for number, stream in enumerate(sky_result.search.streams, start=1):
        each = [feature.ssp for feature in stream.features]
        together = {(a, b) for ssp in each for a in ssp for b in ssp}
        expected = [k for k in range(len(d)) if (d.ssp[k], d.target_ssp[k]) in together]
        assert len(expected) > 10
        table = sky_result.members(number)
        np.testing.assert_array_equal(table["match"], expected)
        np.testing.assert_array_equal(table["target_ssp"], d.target_ssp[expected])
        moved = table["displacement_east"], table["displacement_north"]
        motion = np.stack(moved, axis=1).to_value(u.mas)
        np.testing.assert_allclose(motion, d.motion[expected], atol=1e-9)
        days = (table["target_date"] - table["date"]).to(u.yr)
        np.testing.assert_allclose(table["interval"], days)
        row = sky_result.components[number - 1]
        assert row["n_ssp"] == len(set(d.ssp[expected]))
        pairs = {frozenset((d.reference[k], d.target[k])) for k in expected}
        assert row["n_pairs"] == len(pairs) <= 28


def test_without_features_members_are_the_matches_at_the_velocity(matched):
    """Two epochs: no feature is followed."""
    scc = StackedCrossCorrelation(scales=[1, 2], max_speed=30 * PM)
    with pytest.warns(MeasurementWarning, match="2 epochs allow no p_global"):
        result = scc(matched.cube[:2], n_trials=20, rng=1)
    (row,), d = result.components, result.displacements
    # What has no feature has no speed.
    speeds = [k for k in result.components.colnames if k.startswith("pm")]
    assert np.isnan([row[k].value for k in speeds]).all()
    interval = np.diff(result.cube.years.value)[0]
    v1, v2 = result.velocities[0].value * interval
    near = (np.abs(d.d1 - v1) <= 2 * d.s1) & (np.abs(d.d2 - v2) <= 2 * d.s2)
    expected = np.flatnonzero((d.target == d.reference + 1) & near)
    np.testing.assert_array_equal(result.members(1)["match"], expected)
    assert (row["n_features"], row["n_pairs"]) == (0, 1)


def test_the_velocity_map_has_velocity_coordinates(sky_result):
    found, grid = sky_result.velocity_map("z_score"), sky_result.grid
    np.testing.assert_array_equal(found.data, sky_result.z_score)
    v1, v2 = found.wcs.pixel_to_world(*np.indices(grid.shape[::-1]))
    np.testing.assert_allclose(v1[:, 0].to_value(PM), grid.v1, atol=1e-9)
    np.testing.assert_allclose(v2[0].to_value(PM), grid.v2, atol=1e-9)
    # It is spaced by half the narrowest kernel.
    d = sky_result.displacements
    ratio = (
        np.array(grid.step) * sky_result.pairs.interval.max() / [d.s1.min(), d.s2.min()]
    )
    assert np.all((ratio > 0.45) & (ratio <= 0.5))
    assert found.meta["axes"] == ("east", "north")


# The diagram ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def uneven(jet_cube):
    """Epochs at dates of which no two intervals are alike."""
    dates = Time("2001-03-01") + np.cumsum([0, 31, 43, 29, 90]) * u.d
    scc = StackedCrossCorrelation(
        scales=[2], max_speed=30 * PM, position_angle=270 * u.deg,
        baseline=(35, 110) * u.day,
    )  # fmt: skip
    return scc(replace(jet_cube[:5], times=dates), n_trials=20, rng=1)


def test_each_column_is_of_the_pairs_with_its_interval(uneven):
    image = uneven.diagram()
    n = image.data.shape[1]
    years = uneven.cube.years.to_value(u.yr)
    first, second = np.triu_indices(len(years), 1)
    interval = years[second] - years[first]
    interval = interval[(interval >= 35 / 365.25) & (interval <= 110 / 365.25)]
    # The first interval is the edge of the first column.
    columns = image.wcs.world_to_pixel_values(interval * (1 + 1e-9), 0 * interval)[0]
    count = np.bincount(np.rint(columns).astype(int), minlength=n)
    np.testing.assert_array_equal(count, image.meta["n_pairs"])
    blank = np.isnan(image.data)
    np.testing.assert_array_equal(blank.all(axis=0), count == 0)
    np.testing.assert_array_equal(blank.any(axis=0), count == 0)
    assert (count == 0).any()
    interval, _ = image.wcs.pixel_to_world(np.arange(n), np.zeros(n))
    # Bins are 8% wide.
    np.testing.assert_allclose(interval[1:] / interval[:-1], np.exp(0.08))
    ratio = (image.meta["interval"] / interval)[count > 0]
    np.testing.assert_allclose(ratio, 1, atol=0.041)


def test_values_are_the_excess_per_pattern_and_beam(uneven):
    result = uneven
    image, diagram = result.diagram(), result.search.diagram
    seen = image.meta["n_pairs"] > 0
    assert image.unit == 1 / u.beam
    # Two epochs have this number of patterns, and each match the area of a Gaussian.
    patterns = 2 * result.ssps["in_region"].sum() / len(result.cube)
    area = np.sqrt(2 * np.pi) * 0.2
    total = patterns * area * (image.data * image.meta["n_pairs"])[:, seen]
    np.testing.assert_allclose(total, diagram.excess.T, atol=1e-12)
    interval = image.meta["interval"][seen].to_value(u.yr)
    np.testing.assert_array_equal(interval, diagram.interval)
    # One beam is 1 mas, and the diagram is in beams.
    assert image.meta["beam"].to_value(u.mas) == pytest.approx(1)
    _, displacement = image.wcs.pixel_to_world(0, np.arange(len(image.data)))
    displacement = displacement.to_value(u.mas)
    np.testing.assert_allclose(displacement, diagram.displacement, rtol=1e-9, atol=1e-9)
    assert image.meta["axes"] == ("interval", "displacement")
    # The other end of the axis turns the diagram.
    other = replace(result, position_angle=result.position_angle + 180 * u.deg)
    turned = other.diagram()
    np.testing.assert_array_equal(turned.data, image.data[::-1])
    np.testing.assert_array_equal(turned.meta["direction"], -image.meta["direction"])
    away = turned.meta["position_angle"] - image.meta["position_angle"]
    assert abs(away.to_value(u.deg)) == pytest.approx(180)


# What is shown --------------------------------------------------------------------


def test_what_a_notebook_and_a_terminal_show(sky_result, read_page):
    table = paper_table(printed(sky_result.components))
    page = read_page(sky_result._repr_html_())
    assert len(page.all("td")) == len(table.colnames) * len(table)
    assert table["pm"][0] in page.text
    speed = table["pm"][0].replace("±", "+-")
    assert f": {speed} mas/yr moving, 8 epochs>" in repr(sky_result)
    # Text is escaped.
    cube = replace(sky_result.cube, meta={"object": "<script>alert(1)</script>"})
    result = replace(sky_result, matched=replace(sky_result.decomposed, cube=cube))
    assert "&lt;script&gt;" in result._repr_html_()
    labels = [f"<b>{k}</b>" for k in range(len(cube))]
    assert not read_page(replace(cube, labels=labels)._repr_html_()).all("b")
    empty = replace(sky_result, maxima=(), velocities=(), jitters=())
    assert "no stream, 8 epochs>" in repr(empty)
    assert "<table" not in empty._repr_html_()


# Files ----------------------------------------------------------------------------


def texts(result):
    """The tables as text."""
    names = "components", "features", "feature_positions", "ssps"
    found = {name: io.StringIO() for name in (*names, "members")}
    for name in names:
        getattr(result, name).write(found[name], format="ascii.ecsv")
    result.members(1).write(found["members"], format="ascii.ecsv")
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
    sky_result.decomposed.write(other, overwrite=True)
    refused(other, "not written as one")
    whole = path.read_bytes()
    spot = len(whole) // 2
    other.write_bytes(whole[:spot] + bytes([whole[spot] ^ 1]) + whole[spot + 1 :])
    refused(other, "hecksum")
    with pytest.raises(ValueError, match=r"is a whole result; give .*SCCResult"):
        EpochCube.read(path)
    with fits.open(path) as hdus:
        text = hdus["META"].data.tobytes().replace(b"jitters:", b"tremors:")
        hdus["META"].data = np.frombuffer(text, np.uint8)
        hdus.writeto(other, checksum=True, overwrite=True)
    refused(other, "its SCCResult is of another version of astro_scc")
    with pytest.raises(OSError, match=r"jet.fits: exists; pass overwrite=True"):
        sky_result.write(path)
    with pytest.raises(ValueError, match="frame: an object Axes cannot be"):
        replace(sky_result, frame=Axes()).write(tmp_path / "jet.fits")
    assert [p.name for p in tmp_path.iterdir()] == ["other.fits"]


@pytest.mark.parametrize(
    "array",
    [
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
