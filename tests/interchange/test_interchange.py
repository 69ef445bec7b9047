# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Epochs in the formats and containers of other packages."""

import importlib.util
import sys
import types
import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.nddata import NDData
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc import Beam, EpochCube
from astro_scc.epochs.fits import is_casa_image, is_hdf5
from astro_scc.interchange import files, from_xarray, to_xarray
from astro_scc.interchange.files import read_casa_image

DATES = ["2000-01-01T03:04:05.678", "2000-06-01", "2001-01-01"]


def make_cube(**changes):
    data = np.random.default_rng(1).normal(size=(3, 8, 12))
    values = {
        "data": data,
        "times": DATES,
        "pixel_scale": 0.1 * u.mas,
        "unit": "Jy/beam",
        "position": SkyCoord(187.25 * u.deg, 2.05 * u.deg),
        "reference_pixel": (4, 3),
        "mask": data > 2,
        **changes,
    }
    return EpochCube.from_arrays(**values)


def full_cube():
    from dataclasses import replace

    turned = WCS(naxis=2)
    turned.wcs.ctype = ["RA---SIN", "DEC--SIN"]
    turned.wcs.crval = [187.25, 2.05]
    turned.wcs.crpix = [5, 4]
    turned.wcs.cd = np.array([[-0.8, 0.6], [0.6, 0.8]]) / 3.6e7
    turned.wcs.set()
    return replace(
        make_cube(),
        wcs=turned,
        beams=[Beam(k * u.mas, 0.5 * u.mas, 10 * k * u.deg) for k in (1, 2, 3)],
        noise=[1, 2, 3] * u.mJy / u.beam,
        labels=("a.fits", "b.fits", "c.fits"),
        epoch_wcs=[make_cube().wcs] * 3,
        epoch_meta=[{"object": "3C 273", "frequency": k * 1e9} for k in (1, 2, 3)],
        meta={"object": "3C 273", "history": ["one", "two"]},
    )


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


class TestXarray:
    @pytest.fixture(autouse=True)
    def _needs(self):
        self.xarray = pytest.importorskip("xarray")

    @pytest.mark.parametrize("make", [make_cube, full_cube])
    def test_there_and_back(self, make):
        cube = make()
        dataset = cube.to_xarray()
        assert dict(dataset.sizes) == {"time": 3, "y": 8, "x": 12}
        assert all(isinstance(value, str) for value in dataset.attrs.values())
        assert_same(cube, EpochCube.from_xarray(dataset))

    def test_offsets_on_the_sun_are_no_east(self):
        cube = make_cube()
        cube.wcs.wcs.ctype = "HPLN-TAN", "HPLT-TAN"
        dataset = cube.to_xarray()
        assert "east" not in dataset.coords
        assert dataset["lon_offset"].values[5] == pytest.approx(-0.1)
        assert_same(cube, EpochCube.from_xarray(dataset))

    def test_netcdf(self, tmp_path):
        pytest.importorskip("h5netcdf")
        cube = full_cube()
        cube.to_xarray().to_netcdf(tmp_path / "cube.nc", engine="h5netcdf")
        with self.xarray.open_dataset(tmp_path / "cube.nc", engine="h5netcdf") as read:
            assert_same(cube, from_xarray(read))

    def test_what_it_says(self):
        dataset = make_cube().to_xarray()
        assert dataset["brightness"].attrs["units"] == "Jy / beam"
        assert dataset["east"].values[4] == 0
        assert dataset["east"].values[5] == pytest.approx(-0.1)
        assert dataset["north"].values[2] == pytest.approx(-0.1)
        assert dataset["time"].values[0] == np.datetime64(DATES[0], "ns")
        assert full_cube().to_xarray()["east"].dims == ("y", "x")

    def test_selected_epochs_and_pixels(self):
        cube = full_cube()
        dataset = cube.to_xarray().isel(time=[0, 2], y=slice(2, 7), x=slice(1, 11))
        back = from_xarray(dataset.transpose("x", "y", "time"))
        expected = cube[[0, 2]].crop((slice(2, 7), slice(1, 11)))
        assert np.array_equal(back.data, expected.data)
        assert back.labels == ("a.fits", "c.fits")
        assert np.array_equal(back.wcs.wcs.crpix, expected.wcs.wcs.crpix)
        assert list(back.beams) == list(expected.beams)
        with pytest.raises(ValueError, match="pixels x .* not one after the other"):
            from_xarray(cube.to_xarray().isel(x=slice(None, None, 2)))
        with pytest.raises(ValueError, match="has its dates, pixels, unit, beams"):
            from_xarray(cube.to_xarray(), unit="K")

    def test_images_of_others(self):
        data = np.random.default_rng(2).normal(size=(12, 3, 8))
        east = {"units": "arcsec"}
        array = self.xarray.DataArray(
            data,
            dims=("ra", "t", "dec"),
            coords={
                "ra": ("ra", (5 - np.arange(12)) * 0.2, east),
                "dec": ("dec", (np.arange(8) - 3) * 0.2, east),
                "t": Time(DATES).to_value("datetime64"),
            },
            attrs={"units": "ct"},
        )
        cube = from_xarray(array)
        assert np.array_equal(cube.data, data.transpose(1, 2, 0))
        assert cube.unit == u.ct
        assert cube.reference_pixel == pytest.approx((5, 3))
        assert np.allclose(cube.pixel_matrix.value, [[-200, 0], [0, 200]])
        assert cube.times[0].isot == DATES[0]
        same = from_xarray(array.to_dataset(name="counts"))
        assert np.array_equal(same.data, cube.data)
        # A coordinate that runs to the east keeps its direction.
        turned = from_xarray(array.isel(ra=slice(None, None, -1)))
        assert np.allclose(turned.pixel_matrix.value, [[200, 0], [0, 200]])

    def test_plain_arrays(self):
        array = self.xarray.DataArray(np.ones((3, 8, 12)), dims=("time", "y", "x"))
        cube = from_xarray(array, times=DATES, pixel_scale=1 * u.arcsec, unit="DN")
        assert cube.reference_pixel == (5.5, 3.5)
        assert np.allclose(cube.pixel_matrix.value, [[-1000, 0], [0, 1000]])
        with pytest.raises(ValueError, match="axis time has no dates"):
            from_xarray(array, pixel_scale=1 * u.arcsec)
        with pytest.raises(ValueError, match="has no coordinate with an angle"):
            from_xarray(array, times=DATES)
        with pytest.raises(ValueError, match=r"rename\(\) the axes"):
            from_xarray(array.rename(x="column"), times=DATES)
        with pytest.raises(ValueError, match="one array of three axes"):
            from_xarray(self.xarray.Dataset({"a": array, "b": array}))
        uneven = array.assign_coords(
            x=("x", np.arange(12.0) ** 2, {"units": "mas"}),
            y=("y", np.arange(8.0), {"units": "mas"}),
        )
        with pytest.raises(ValueError, match="coordinate x is uneven"):
            from_xarray(uneven, times=DATES)
        long = uneven.assign_coords(x=("x", 2.0 * np.arange(12), {"units": "mas"}))
        with pytest.raises(ValueError, match="pixels are 2 by 1 mas"):
            from_xarray(long, times=DATES)

    def test_another_kind(self):
        with pytest.raises(TypeError, match="takes a Dataset or a DataArray"):
            from_xarray(np.ones((3, 8, 12)))


def test_xarray_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match=r"to_xarray needs xarray; .*scc\[xarray\]"):
        to_xarray(make_cube())


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


@pytest.fixture
def casa_image(tmp_path):
    folder = tmp_path / "a.image"
    folder.mkdir()
    (folder / "table.dat").write_bytes(b"\xbe\xbe\xbe\xbe")
    return folder


@pytest.fixture
def casatools(monkeypatch):
    """What of casatools is used, with an image of its own."""
    module = types.ModuleType("casatools")
    module.__spec__ = importlib.util.spec_from_loader("casatools", None)
    data = np.random.default_rng(1).normal(size=(1, 1, 16, 32))

    class image:
        def open(self, path):
            if "broken" in path:
                raise RuntimeError("table.f0 is missing\nand more")

        def tofits(self, outfile, **kwargs):
            header = make_cube().wcs.to_header()
            header.update({"DATE-OBS": DATES[0], "BMAJ": 1 / 3.6e6, "BMIN": 1e-7})
            fits.PrimaryHDU(data, header).writeto(outfile)

        def close(self):
            pass

    module.image = image
    module.data = data[0, 0]
    monkeypatch.setitem(sys.modules, "casatools", module)
    return module


def test_casa_image_by_casatools(casa_image, casatools):
    cube = EpochCube.read(casa_image)
    assert np.array_equal(cube.data[0], casatools.data)
    assert cube.beams[0].major.to_value(u.mas) == pytest.approx(1)
    assert cube.labels == ("a.image",)
    # A pattern finds folders that are images, and no others.
    (casa_image.parent / "b.image").mkdir()
    assert len(EpochCube.read(casa_image.parent / "*.image")) == 1


def test_broken_casa_image(casa_image, casatools):
    broken = casa_image.rename(casa_image.parent / "broken.image")
    with pytest.raises(OSError, match=r"image: casatools cannot .*: table\.f0 is miss"):
        read_casa_image(broken)


def test_casa_image_without_packages(casa_image, monkeypatch):
    monkeypatch.setattr(files, "find_spec", lambda name: None)
    with pytest.raises(OSError, match=r"a\.image: a CASA image; export it as FITS"):
        EpochCube.read(casa_image)


def test_casa_image_by_spectral_cube():
    spectral_cube = pytest.importorskip("spectral_cube")
    from pathlib import Path

    path = Path(spectral_cube.__file__).parent / "tests" / "data" / "basic.image"
    if not is_casa_image(path):
        pytest.skip("spectral-cube is installed without its test data")
    with pytest.raises(ValueError, match=r"basic\.image: has 3 planes on axis FREQ"):
        EpochCube.read(path, times=DATES[0])


@pytest.fixture
def movie(tmp_path):
    """Write a movie of four frames, an hour apart, and give its path."""
    h5py = pytest.importorskip("h5py")

    def make(name="m.hdf5", without=(), n_times=4, **changes):
        head = {
            "mjd": b"57850", "psize": b"9.69627362219072e-12", "source": b"SgrA",
            "ra": b"17.761122472222223", "dec": b"-28.992189444444445",
            "rf": b"230000000000.0", **changes,
        }  # fmt: skip
        frames = np.arange(4 * 6 * 8.0).reshape(4, 6, 8)
        with h5py.File(tmp_path / name, "w") as file:
            header = file.create_dataset("header", (0,), dtype="S10")
            for key, value in head.items():
                if key not in without:
                    header.attrs[key] = np.bytes_(value)
            if "I" not in without:
                file["I"] = frames
            file["times"] = np.arange(float(n_times))
        return tmp_path / name, frames

    return make


def test_movie(movie):
    path, frames = movie()
    assert is_hdf5(path)
    cube = EpochCube.read(path)
    # The first row of a frame is in the north.
    assert np.array_equal(cube.data, frames[:, ::-1])
    assert cube.unit == u.Jy / u.pix
    assert cube.pixel_scale.to_value(u.uas) == pytest.approx(2, rel=1e-3)
    assert cube.times[1].isot == "2017-04-07T01:00:00.000"
    assert cube.meta["object"] == "SgrA"
    assert cube.epochs["frequency"][0] == 230 * u.GHz
    assert cube.wcs.wcs.crval == pytest.approx([266.41683708, -28.99218944])
    assert cube.reference_pixel == (3.5, 2.5)
    blurred = EpochCube.read(path, beams=Beam(20 * u.uas, 20 * u.uas))
    assert len(blurred.beams) == 4
    assert EpochCube.read(movie(without=("rf", "source"))[0]).meta.get("object") is None
    with pytest.raises(ValueError, match="a movie; it has its dates"):
        EpochCube.read(path, times=DATES)


def test_broken_movies(movie, monkeypatch):
    for without in ("I", "psize", "ra"):
        with pytest.raises(OSError, match=r"m\.hdf5: is no movie of eht-imaging"):
            EpochCube.read(movie(without=(without,))[0])
    with pytest.raises(OSError, match="is no movie"):
        EpochCube.read(movie(mjd=b"soon")[0])
    with pytest.raises(OSError, match=r"frames have shape \(4, 6, 8\) for 3 times"):
        EpochCube.read(movie(n_times=3)[0])
    path, _ = movie()
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(OSError, match=r"m\.hdf5: reading an HDF5 movie needs h5py"):
        EpochCube.read(path)


def test_what_is_no_hdf5(tmp_path):
    (tmp_path / "a.txt").write_text("text")
    assert not is_hdf5(tmp_path / "a.txt")
    assert not is_hdf5(tmp_path / "missing")


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
