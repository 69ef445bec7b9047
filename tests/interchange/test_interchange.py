# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Epochs in the formats and containers of other packages."""

import sys
import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.nddata import NDData
from astropy.wcs import WCS

from astro_scc import EpochCube

DATES = ["2000-01-01T03:04:05.678", "2000-06-01", "2001-01-01"]


def make_cube():
    data = np.random.default_rng(1).normal(size=(3, 8, 12))
    values = {
        "data": data,
        "times": DATES,
        "pixel_scale": 0.1 * u.mas,
        "unit": "Jy/beam",
        "position": SkyCoord(187.25 * u.deg, 2.05 * u.deg),
        "reference_pixel": (4, 3),
        "mask": data > 2,
    }
    return EpochCube.from_arrays(**values)


def assert_same(one, other):
    assert np.array_equal(one.data[~one.mask], other.data[~other.mask])
    assert np.array_equal(one.mask, other.mask)
    assert one.unit == other.unit
    assert np.all(np.abs((one.times - other.times).to_value(u.ns)) < 2)
    assert one.times.scale == other.times.scale
    assert (one.beams is None) == (other.beams is None)
    assert one.beams is None or list(one.beams) == list(other.beams)
    assert (one.noise is None) == (other.noise is None)
    assert one.noise is None or u.allclose(one.noise, other.noise)
    assert one.labels == other.labels
    assert one.epoch_meta == other.epoch_meta
    assert one.meta == other.meta
    sky = [cube.wcs.all_pix2world([[2, 3], [7, 1]], 0) for cube in (one, other)]
    assert np.array_equal(*sky)
    assert np.array_equal(one.pixel_matrix, other.pixel_matrix)
    assert (one.epoch_wcs is None) == (other.epoch_wcs is None)


def test_ndcube_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "ndcube", None)
    with pytest.raises(ImportError, match=r"to_ndcube needs ndcube; .*scc\[ndcube\]"):
        make_cube().to_ndcube()


def test_spectral_cube_images():
    spectral_cube = pytest.importorskip("spectral_cube")
    header = make_cube().wcs.to_header()
    header.update(
        {"CTYPE3": "FREQ", "CRVAL3": 15e9, "CDELT3": 1e6, "CRPIX3": 1.0,
         "CUNIT3": "Hz", "BUNIT": "Jy/beam", "BMAJ": 3e-7, "BMIN": 2e-7, "BPA": 5.0}
    )  # fmt: skip
    data = make_cube().data[:2].astype(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cube = spectral_cube.SpectralCube.read(fits.PrimaryHDU(data, header))
        channels = [cube[0], cube[1]]
        made = EpochCube.from_ccddata(channels, times=DATES[:2])
        one = EpochCube.from_ccddata([cube[1:2]], times=DATES[:1])
    assert np.array_equal(made.data, data)
    assert np.array_equal(one.data[0], data[1])
    assert made.unit == u.Jy / u.beam
    assert made.beams[0].major.to_value(u.deg) == pytest.approx(3e-7)
    assert made.reference_pixel == (4, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ValueError, match="image 0: has 2 planes"):
            EpochCube.from_ccddata([cube], times=DATES[:1])


def test_images_of_another_kind():
    with pytest.raises(TypeError, match="image 0: is a ndarray; give NDData"):
        EpochCube.from_ccddata([np.ones((8, 8))], times=DATES[:1])


# Images without a beam: counts of a space telescope, and the Sun.

HST = {
    "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 187.70593, "CRVAL2": 12.39112,
    "CRPIX1": 16.0, "CRPIX2": 9.0, "CD1_1": -7e-6, "CD1_2": 0.0, "CD2_1": 0.0,
    "CD2_2": 7e-6, "BUNIT": "ELECTRONS/S",
}  # fmt: skip
SUN = {
    "CTYPE1": "HPLN-TAN", "CTYPE2": "HPLT-TAN", "CUNIT1": "arcsec", "CUNIT2": "arcsec",
    "CRVAL1": 0.0, "CRVAL2": 0.0, "CRPIX1": 16.5, "CRPIX2": 8.5, "CDELT1": 0.6,
    "CDELT2": 0.6, "CROTA2": 0.02, "BUNIT": "DN", "TELESCOP": "SDO/AIA",
}  # fmt: skip


def image_of(i):
    y, x = np.mgrid[:16, :32]
    noise = np.random.default_rng(i).normal(scale=0.01, size=(16, 32))
    return 5 * np.exp(-((x - 12 - i) ** 2 + (y - 8) ** 2) / 8) + noise


def test_hst_files(tmp_path):
    for i, date in enumerate(["1995-05-27", "1998-05-13", "2002-06-01"]):
        primary = fits.PrimaryHDU(
            header=fits.Header({"TELESCOP": "HST", "DATE-OBS": date, "TARGNAME": "M87"})
        )
        science = fits.ImageHDU(image_of(i), fits.Header(HST), name="SCI")
        weight = fits.ImageHDU(np.ones((16, 32)), fits.Header(HST), name="WHT")
        fits.HDUList([primary, science, weight]).writeto(tmp_path / f"{i}_drz.fits")
    cube = EpochCube.read(tmp_path / "*_drz.fits", frame="absolute")
    assert np.allclose(cube.data, [image_of(i) for i in range(3)])
    assert cube.unit == u.electron / u.s
    assert cube.beams is None
    assert cube.pixel_scale.to_value(u.arcsec) == pytest.approx(7e-6 * 3600)
    assert cube.times[0].isot[:10] == "1995-05-27"


def test_solar_files_and_maps(tmp_path):
    paths, maps = [], []
    for i in range(3):
        date = f"2013-11-16T20:59:{13 + 12 * i:02d}.390Z"
        header = fits.Header({**SUN, "DATE-OBS": date})
        paths.append(tmp_path / f"aia_{i}.fits")
        fits.PrimaryHDU(image_of(i).astype(np.float32), header).writeto(paths[-1])
        # As maps of SunPy are: NDData whose meta has keys in lower case.
        meta = {key.lower(): value for key, value in header.items()}
        maps.append(
            NDData(image_of(i), unit=u.DN, wcs=WCS(fits.Header(SUN)), meta=meta)
        )
    cube = EpochCube.read(paths)
    of_maps = EpochCube.from_ccddata(maps)
    assert np.allclose(of_maps.data, cube.data)
    assert np.all(of_maps.times == cube.times)
    assert np.allclose(of_maps.pixel_matrix, cube.pixel_matrix)
    assert cube.beams is None
    assert cube.unit == u.DN
    assert np.diff(cube.times.unix) == pytest.approx([12, 12])
    # The longitude of the Sun grows to the right: west is where its motion goes.
    assert cube.pixel_matrix[0, 0].to_value(u.arcsec) == pytest.approx(0.6)
    aligned = cube.align("wcs")
    assert np.allclose(aligned.data, cube.data)
    path = tmp_path / "cube.fits"
    cube.write(path)
    assert_same(cube, EpochCube.read(path))
