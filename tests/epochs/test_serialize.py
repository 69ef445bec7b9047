# Licensed under a 3-clause BSD style license - see LICENSE.rst
import os
import string

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from astro_scc.components.tables import kind_of
from astro_scc.epochs import Beam, EpochCube, write_epochs
from astro_scc.images import serialize
from astro_scc.images.serialize import replace_when_complete

DATES = ["2001-01-01T01:02:03.456789", "2000-01-01", "2000-06-01"]


def make_cube(**changes):
    data = np.random.default_rng(1).normal(size=(3, 8, 12))
    data[1, 2, 3] = np.nan
    position = SkyCoord(187.27791535123456 * u.deg, 2.0523885012345678 * u.deg)
    cube = EpochCube.from_arrays(
        data,
        Time(DATES),
        pixel_scale=0.0123456789012345 * u.mas,
        unit=u.Jy / u.beam,
        beams=[Beam(k * 0.1234567890123 * u.mas, 0.1 * u.mas) for k in (1, 2, 3)],
        noise=[1, 2, 3] * u.mJy / u.beam,
        mask=data > 2,
        reference_pixel=(3.3, 4.4),
        position=position,
    )
    epoch_wcs = []
    for k in range(3):
        wcs = cube.wcs.deepcopy()
        wcs.wcs.crval = wcs.wcs.crval + k * 1.23456789e-10
        epoch_wcs.append(wcs)
    return cube.with_step(
        "tested",
        epoch_wcs=epoch_wcs,
        epoch_meta=[{"frequency": 15.4e9 + k} for k in range(3)],
    ).with_step("again", **changes)


def assert_same_wcs(one, other):
    assert list(one.wcs.ctype) == list(other.wcs.ctype)
    assert one.wcs.radesys == other.wcs.radesys
    assert np.array_equal(one.wcs.crval, other.wcs.crval)
    assert np.array_equal(one.wcs.crpix, other.wcs.crpix)
    assert np.array_equal(one.pixel_scale_matrix, other.pixel_scale_matrix)


def assert_same_cube(one, other):
    assert np.array_equal(one.data, other.data, equal_nan=True)
    assert np.array_equal(one.mask, other.mask)
    assert one.unit == other.unit
    assert np.array_equal(one.times.jd1, other.times.jd1)
    assert np.array_equal(one.times.jd2, other.times.jd2)
    assert one.times.scale == other.times.scale
    assert one.times.format == other.times.format
    assert (one.beams is None) == (other.beams is None)
    for a, b in zip(one.beams or (), other.beams or (), strict=True):
        assert (a.major, a.minor, a.pa) == (b.major, b.minor, b.pa)
    assert (one.noise is None) == (other.noise is None)
    if one.noise is not None:
        assert np.array_equal(one.noise, other.noise)
    assert one.labels == other.labels
    assert one.epoch_meta == other.epoch_meta
    assert one.meta == other.meta
    assert_same_wcs(one.wcs, other.wcs)
    assert (one.epoch_wcs is None) == (other.epoch_wcs is None)
    for a, b in zip(one.epoch_wcs or (), other.epoch_wcs or (), strict=True):
        assert_same_wcs(a, b)


def test_everything_comes_back_to_the_bit(tmp_path):
    cube = make_cube()
    cube.write(tmp_path / "cube.fits")
    again = EpochCube.read(tmp_path / "cube.fits")
    assert_same_cube(cube, again)
    assert again.meta["history"][-2:] == ["tested", "again"]
    again.write(tmp_path / "second.fits")
    assert_same_cube(cube, EpochCube.read(tmp_path / "second.fits"))


def test_the_least_cube(tmp_path):
    cube = EpochCube.from_arrays(
        np.zeros((1, 1, 1)),
        Time(51544.5, format="mjd", scale="tdb"),
        pixel_scale=1 * u.deg,
    )
    cube.write(str(tmp_path / "cube.fits"))
    assert_same_cube(cube, EpochCube.read(str(tmp_path / "cube.fits")))


def test_cubes_of_files_come_back(make_fits, tmp_path):
    paths = [
        make_fits("a.fits", CROTA2=30.0),
        make_fits("b.fits", DATE_OBS="2007-01-01", CROTA2=30.0),
    ]
    cube = EpochCube.read(paths)
    cube.write(tmp_path / "cube.fits")
    again = EpochCube.read(tmp_path / "cube.fits")
    assert np.allclose(again.pixel_matrix, cube.pixel_matrix, rtol=1e-14)
    assert again.labels == cube.labels
    assert again.epoch_meta == cube.epoch_meta
    assert (again.times == cube.times).all()


def test_wcs_with_a_cd_matrix(tmp_path):
    header = make_cube().wcs.to_header()
    del header["CDELT1"], header["CDELT2"]
    header.update({"CD1_1": -1.23456789e-9, "CD1_2": 3e-10})
    header.update({"CD2_1": 3e-10, "CD2_2": 1.23456789e-9})
    cube = make_cube(wcs=WCS(header), epoch_wcs=None)
    cube.write(tmp_path / "cube.fits")
    assert_same_cube(cube, EpochCube.read(tmp_path / "cube.fits"))


def test_meta_keeps_types_and_what_it_cannot_hold_becomes_text(tmp_path):
    meta = {
        "speed": 1.5 * u.mas / u.yr,
        "time": Time("2000-01-01"),
        "position": SkyCoord(1 * u.deg, 2 * u.deg),
        "shifts": np.array([[0.1, 0.2], [1e-17, -3]]),
        "nested": {"deep": [1, "two", None, np.float32(3)], "ünï": "çödé"},
        "pair": (1, 2),
        "thing": object,
        "history": [],
    }
    cube = make_cube(meta=meta)
    cube.write(tmp_path / "cube.fits")
    again = EpochCube.read(tmp_path / "cube.fits").meta
    assert again["speed"] == meta["speed"]
    assert again["time"] == meta["time"]
    assert again["position"].separation(meta["position"]) == 0
    assert np.array_equal(again["shifts"], meta["shifts"])
    assert again["nested"] == {"deep": [1, "two", None, 3.0], "ünï": "çödé"}
    assert again["pair"] == (1, 2)
    assert again["thing"] == str(object)


@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    data=arrays(float, (2, 3, 4), elements=st.floats(width=64)),
    days=st.lists(st.floats(-3e4, 2e4), min_size=2, max_size=2),
    labels=st.lists(st.text(max_size=12), min_size=2, max_size=2),
    pixel=st.floats(1e-6, 1e6),
    key=st.text(string.printable, min_size=1, max_size=8),
    value=st.one_of(st.text(max_size=8), st.floats(allow_nan=False), st.integers()),
)
def test_any_cube_comes_back(tmp_path, data, days, labels, pixel, key, value):
    data[:, 0, 0] = 1
    cube = EpochCube.from_arrays(
        data, Time(51544, days, format="mjd", scale="tai"), pixel_scale=pixel * u.mas
    )
    from dataclasses import replace

    cube = replace(cube, labels=labels, meta={key: value})
    cube.write(tmp_path / "cube.fits", overwrite=True)
    assert_same_cube(cube, EpochCube.read(tmp_path / "cube.fits"))


def test_files_are_not_replaced_unasked(tmp_path):
    path = tmp_path / "cube.fits"
    make_cube().write(path)
    before = path.read_bytes()
    with pytest.raises(OSError, match=r"cube.fits: exists; pass overwrite=True"):
        make_cube().write(path)
    assert path.read_bytes() == before
    make_cube()[1:].write(path, overwrite=True)
    assert len(EpochCube.read(path)) == 2


def test_a_failure_leaves_everything_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "cube.fits"
    path.write_text("precious")

    def fail(self, part, checksum):
        part.write_text("half")
        raise OSError("disk full")

    monkeypatch.setattr(fits.HDUList, "writeto", fail)
    with pytest.raises(OSError, match="disk full"):
        make_cube().write(path, overwrite=True)
    assert path.read_text() == "precious"
    assert os.listdir(tmp_path) == ["cube.fits"]


def test_places_where_nothing_can_be_written(tmp_path):
    with pytest.raises(OSError, match=r"a.fits: its folder .*nowhere does not exist"):
        make_cube().write(tmp_path / "nowhere" / "a.fits")
    with pytest.raises(OSError, match="is a directory; give the name of a file"):
        make_cube().write(tmp_path)


def test_a_complete_file_has_ordinary_permissions(tmp_path):
    with replace_when_complete(tmp_path / "a") as part:
        part.write_text("x")
    (tmp_path / "b").write_text("x")
    modes = {(tmp_path / name).stat().st_mode for name in "ab"}
    assert len(modes) == 1


def test_what_is_a_cube_file(tmp_path, make_fits):
    make_cube().write(tmp_path / "cube.fits.gz")
    assert kind_of(tmp_path / "cube.fits.gz") == "cube"
    assert len(EpochCube.read(tmp_path / "cube.fits.gz")) == 3
    assert kind_of(make_fits()) == "images"
    (tmp_path / "text").write_text("text")
    assert kind_of(tmp_path / "text") == "images"


def test_damaged_files(tmp_path):
    path = tmp_path / "cube.fits"
    make_cube().write(path)
    content = path.read_bytes()
    for keep in (3000, 9000, len(content) // 2, len(content) - 3000):
        path.write_bytes(content[:keep])
        with pytest.raises(
            OSError, match=r"cube.fits: is no complete.*EpochCube"
        ) as caught:
            EpochCube.read(path)
        assert "\n" not in str(caught.value)


def test_files_of_later_versions(tmp_path, monkeypatch):
    path = tmp_path / "cube.fits"
    with monkeypatch.context() as patch:
        patch.setattr(serialize, "LAYOUT", 99)
        make_cube().write(path)
    with pytest.raises(OSError, match="of layout 99; read it with the version that"):
        EpochCube.read(path)


def test_other_programs_see_images_and_dates(tmp_path):
    cube = make_cube()
    cube.write(tmp_path / "cube.fits")
    with fits.open(tmp_path / "cube.fits") as hdus:
        np.testing.assert_array_equal(hdus["DATA"].data, cube.data)
        np.testing.assert_array_equal(hdus["MASK"].data, cube.mask)
        assert hdus["DATA"].header["BUNIT"] == "Jy / beam"
        assert hdus["DATA"].header["CTYPE1"] == "RA---SIN"
        assert list(hdus["EPOCHS"].data["JD1"]) == list(cube.times.jd1)
        majors = [beam.major.value for beam in cube.beams]
        assert list(hdus["EPOCHS"].data["BMAJ"]) == majors


def test_units_that_the_fits_standard_does_not_have(tmp_path):
    cube = EpochCube.from_arrays(
        np.arange(40.0).reshape(2, 4, 5), DATES[:2], pixel_scale=1 * u.arcsec, unit="DN"
    )
    paths = write_epochs(cube, tmp_path)
    assert EpochCube.read(paths).unit == u.DN
