# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Cubes in one file: to the bit, complete or not at all."""

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

from astro_scc.epochs import Beam, EpochCube, serialize, write_epochs
from astro_scc.epochs.inspection import kind_of

DATES = ["2001-01-01T01:02:03.456789", "2000-01-01", "2000-06-01"]


def make_cube(**changes):
    data = np.random.default_rng(1).normal(size=(3, 8, 12))
    data[1, 2, 3] = np.nan
    position = SkyCoord(187.27791535123456 * u.deg, 2.0523885012345678 * u.deg)
    cube = EpochCube.from_arrays(
        data, Time(DATES), pixel_scale=0.0123456789012345 * u.mas, mask=data > 2,
        beams=[Beam(k * 0.1234567890123 * u.mas, 0.1 * u.mas) for k in (1, 2, 3)],
        unit=u.Jy / u.beam, noise=[1, 2, 3] * u.mJy / u.beam, position=position,
        reference_pixel=(3.3, 4.4),
        epoch_meta=[{"frequency": 15.4e9 + k} for k in range(3)],
    )  # fmt: skip
    own = [cube.wcs.deepcopy() for _ in range(3)]
    for k, wcs in enumerate(own):
        wcs.wcs.crval = wcs.wcs.crval + k * 1.23456789e-10
    return cube.with_step("tested", epoch_wcs=own).with_step("again", **changes)


def parts(cube):
    """All that is in a cube, to be compared to the bit."""
    grids = [cube.wcs, *(cube.epoch_wcs or ())]
    return {
        "data": np.nan_to_num(cube.data).tolist(),
        "mask": cube.mask.tolist(),
        "times": [cube.times.jd1.tolist(), cube.times.jd2.tolist()],
        "scale": [cube.times.scale, cube.times.format],
        "beams": cube.beams and [(b.major, b.minor, b.pa) for b in cube.beams],
        "noise": None if cube.noise is None else [*cube.noise],
        "wcs": [(*w.wcs.ctype, w.wcs.radesys, *w.wcs.crval, *w.wcs.crpix,
                 *w.pixel_scale_matrix.flat) for w in grids],
        **{k: getattr(cube, k) for k in ("unit", "labels", "epoch_meta", "meta")},
    }  # fmt: skip


def turned():
    header = make_cube().wcs.to_header()
    del header["CDELT1"], header["CDELT2"]
    header.update({"CD1_1": -1.23456789e-9, "CD1_2": 3e-10})
    header.update({"CD2_1": 3e-10, "CD2_2": 1.23456789e-9})
    return make_cube(wcs=WCS(header), epoch_wcs=None)


@pytest.mark.parametrize("make", [make_cube, turned])
def test_everything_comes_back_to_the_bit(tmp_path, make):
    cube = make()
    path = tmp_path / ("cube.fits.gz" if make is turned else "cube.fits")
    cube.write(path)
    again = EpochCube.read(path)
    again.write(path, overwrite=True)
    assert parts(cube) == parts(again) == parts(EpochCube.read(path))
    assert kind_of(path) == "cube"


@pytest.mark.filterwarnings("ignore:two images are of")
@settings(max_examples=3, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    data=arrays(float, (2, 1, 2), elements=st.floats(width=64)),
    days=st.lists(st.floats(-3e4, 2e4), min_size=2, max_size=2),
    labels=st.lists(st.text(max_size=12), min_size=2, max_size=2),
    pixel=st.floats(1e-6, 1e6),
    key=st.text(string.printable, min_size=1, max_size=8),
    value=st.one_of(st.text(max_size=8), st.floats(allow_nan=False), st.integers()),
)
def test_any_cube_comes_back(tmp_path, data, days, labels, pixel, key, value):
    data[:, 0, 0] = 1
    times = Time(51544, days, format="mjd", scale="tai")
    fields = {"labels": labels, "meta": {key: value}}
    cube = EpochCube.from_arrays(data, times, pixel_scale=pixel * u.mas, **fields)
    cube.write(tmp_path / "cube.fits", overwrite=True)
    again = EpochCube.read(tmp_path / "cube.fits")
    assert np.array_equal(again.data, cube.data, equal_nan=True)
    assert parts(again) == parts(cube)


def test_damaged_files_and_those_of_later_versions(tmp_path, monkeypatch):
    path = tmp_path / "cube.fits"
    with monkeypatch.context() as patch:
        patch.setattr(serialize, "LAYOUT", 99)
        make_cube().write(path)
    with pytest.raises(OSError, match="of layout 99; read it with the version that"):
        EpochCube.read(path)
    make_cube().write(path, overwrite=True)
    content = path.read_bytes()
    for keep in (3000, len(content) - 3000):
        path.write_bytes(content[:keep])
        with pytest.raises(OSError, match=r"^[^\n]*fits: cannot be read as .*EpochC"):
            EpochCube.read(path)


def test_other_programs_see_images_and_dates(tmp_path):
    cube = make_cube()
    cube.write(tmp_path / "cube.fits")
    with fits.open(tmp_path / "cube.fits") as hdus:
        np.testing.assert_array_equal(hdus["DATA"].data, cube.data)
        np.testing.assert_array_equal(hdus["MASK"].data, cube.mask)
        assert hdus["DATA"].header["BUNIT"] == "JY/BEAM"
    # A unit that the FITS standard does not have.
    solar = {"pixel_scale": 1 * u.arcsec, "unit": "DN"}
    cube = EpochCube.from_arrays(np.arange(40.0).reshape(2, 4, 5), DATES[:2], **solar)
    assert EpochCube.read(write_epochs(cube, tmp_path / "e")).unit == u.DN
    with pytest.raises(OSError, match="fits: exists; choose another folder, or overwr"):
        write_epochs(cube, tmp_path / "e")
