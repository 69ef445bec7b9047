# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams, spectrum, maps and diagram of a result, as shown and on disk."""

import io
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits

from astro_scc import EpochCube
from astro_scc.measurement import SCCResult
from astro_scc.measurement.tables import paper_table


def test_without_a_position_angle_parallel_is_along_the_flow(sky_result):
    """The simulated jet lies to the west of the reference pixel."""
    assert abs(sky_result.position_angle - 270 * u.deg) < 3 * u.deg
    moving = sky_result.components[0]
    assert 0.9 * moving["pm"] < moving["pm_parallel"] <= moving["pm"]


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
    # A frame of a user, without fields that could be written.
    flow = replace(sky_result.flow, frame=object())
    search = replace(sky_result.search, flow=flow)
    with pytest.raises(ValueError, match="frame: an object object cannot be"):
        replace(sky_result, search=search).write(tmp_path / "jet.fits")
    assert [p.name for p in tmp_path.iterdir()] == ["other.fits"]
