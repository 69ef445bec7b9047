# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Units, masks, errors, beams and coordinates of NDData are used or refused."""

import sys
import warnings
from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.nddata import (
    CCDData,
    InverseVariance,
    NDData,
    NDDataRef,
    StdDevUncertainty,
    UnknownUncertainty,
    VarianceUncertainty,
)
from astropy.time import Time
from astropy.utils.masked import Masked
from astropy.wcs import WCS
from astropy.wcs.wcsapi import HighLevelWCSWrapper, SlicedLowLevelWCS
from numpy.testing import assert_allclose, assert_array_equal

from astro_scc.epochs import Beam, EpochCube
from astro_scc.exceptions import EpochWarning

DATES = ["2000-01-01", "2000-06-01", "2001-01-01"]
DATA = np.random.default_rng(1).normal(size=(3, 24, 36))
JY_BEAM = u.Jy / u.beam


def celestial(crota=None):
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = "RA---SIN", "DEC--SIN"
    wcs.wcs.cdelt = -1e-7, 1e-7
    wcs.wcs.crpix = 10, 5
    wcs.wcs.crval = 10, 20
    if crota is not None:
        wcs.wcs.crota = 0, crota
    wcs.wcs.set()
    return wcs


def image(i, **changes):
    values = {"unit": JY_BEAM, "wcs": celestial(), "meta": {"DATE-OBS": DATES[i]}}
    return CCDData(DATA[i], **values | changes)


def make_cube(**changes):
    values = {
        "unit": JY_BEAM,
        "noise": [1, 2, 3] * u.mJy / u.beam,
        "beams": [Beam(k * u.mas, 0.5 * u.mas) for k in (1, 2, 3)],
        "labels": ("a", "b", "c"),
        "epoch_meta": [{"object": "J0000", "telescope": k} for k in "xyz"],
        "meta": {"object": "J0000", "history": ["made"]},
        "mask": DATA > 2,
    }
    return EpochCube(DATA, DATES, celestial(), **values | changes)


# -- uncertainties ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("uncertainty", "noise"),
    [
        (StdDevUncertainty(np.full((24, 36), 0.5)), 0.5),
        (StdDevUncertainty(np.full((24, 36), 500), unit=u.mJy / u.beam), 0.5),
        (StdDevUncertainty(0.5), 0.5),
        (VarianceUncertainty(np.full((24, 36), 0.25)), 0.5),
        (VarianceUncertainty(np.full((24, 36), 9), unit=(u.mJy / u.beam) ** 2), 0.003),
        (InverseVariance(np.full((24, 36), 4)), 0.5),
        (InverseVariance(np.full((24, 36), 16), unit=u.Jy**-2 * u.beam**2), 0.25),
    ],
)
def test_uncertainties_are_the_noise(uncertainty, noise):
    images = [image(i, uncertainty=uncertainty) for i in range(3)]
    cube = EpochCube.from_ccddata(images)
    assert cube.noise.unit == JY_BEAM
    assert_allclose(cube.noise.value, noise, rtol=1e-12)
    assert not cube.mask.any()


def test_pixels_without_a_finite_uncertainty_are_bad():
    weight = np.full((24, 36), 4.0)
    weight[:3] = 0
    cube = EpochCube.from_ccddata([image(0, uncertainty=InverseVariance(weight))])
    assert cube.noise.value.tolist() == [0.5]
    assert_array_equal(cube.mask[0], weight == 0)


def test_uncertainties_that_differ_from_pixel_to_pixel():
    sigma = np.full((24, 36), 0.5)
    sigma[10:14, 10:14] = 2
    images = [image(i, uncertainty=StdDevUncertainty(sigma)) for i in range(2)]
    with pytest.warns(EpochWarning, match="image 0, image 1: its uncertainty differs"):
        cube = EpochCube.from_ccddata(images)
    assert cube.noise.value.tolist() == [0.5, 0.5]


def test_uncertainties_of_some_images_only():
    images = [image(0), image(1, uncertainty=StdDevUncertainty(np.ones((24, 36))))]
    with pytest.warns(EpochWarning, match="image 0: no noise where other epochs have"):
        cube = EpochCube.from_ccddata(images)
    assert cube.noise is None


@pytest.mark.parametrize(
    ("uncertainty", "message"),
    [
        (UnknownUncertainty(np.ones((24, 36))), "is a UnknownUncertainty; give it as"),
        (StdDevUncertainty(np.full((24, 36), -1.0)), "has negative values; correct or"),
        (StdDevUncertainty(np.full((24, 36), np.nan)), "finite at no valid pixel;"),
        (InverseVariance(np.zeros((24, 36))), "finite at no valid pixel; remove it"),
    ],
)
def test_uncertainties_that_cannot_be_used(uncertainty, message):
    with pytest.raises(ValueError, match=f"image 0: its uncertainty .*{message}"):
        EpochCube.from_ccddata([image(0, uncertainty=uncertainty)])


def test_an_uncertainty_in_another_unit():
    wrong = image(0)
    # astropy itself checks units of images that have one.
    wrong._uncertainty = StdDevUncertainty(np.ones((24, 36)), unit=u.K)
    with pytest.raises(ValueError, match="image 0: .* StdDevUncertainty in K, which"):
        EpochCube.from_ccddata([wrong])


def test_noise_follows_the_unit_and_ends_with_resampling():
    other = celestial()
    other.wcs.crpix = 10.5, 5
    milli = image(1, unit=u.mJy / u.beam, uncertainty=StdDevUncertainty(7.0))
    images = [image(0, uncertainty=StdDevUncertainty(0.5)), milli]
    assert_allclose(EpochCube.from_ccddata(images).noise.value, [0.5, 0.007])
    images[1].wcs = other
    with pytest.warns(EpochWarning, match="image 1: .*, and the noise of all is"):
        assert EpochCube.from_ccddata(images).noise is None


def test_images_of_a_cube_have_its_noise():
    cube = make_cube()
    assert isinstance(cube[1].uncertainty, StdDevUncertainty)
    again = EpochCube.from_ccddata(list(cube))
    assert_array_equal(again.data, cube.data)
    assert_array_equal(again.mask, cube.mask)
    assert_allclose(again.noise, cube.noise)
    assert (again.times == cube.times).all()
    assert (again.beams, again.labels) == (cube.beams, cube.labels)
    assert (again.unit, again.reference_pixel) == (cube.unit, cube.reference_pixel)
    assert replace(cube, noise=None)[1].uncertainty is None


def test_ccddata_files_keep_mask_and_uncertainty(tmp_path):
    for i, part in enumerate(make_cube()):
        part.write(tmp_path / f"{i}.fits")
    cube = EpochCube.read(tmp_path / "*.fits")
    assert_array_equal(cube.mask, DATA > 2)
    assert_allclose(cube.noise.to_value(u.mJy / u.beam), [1, 2, 3])
    variance = image(0, uncertainty=VarianceUncertainty(np.full((24, 36), 9)))
    variance.write(tmp_path / "var.fits")
    part = EpochCube.read(tmp_path / "var.fits", region=(slice(2, 9), slice(3, 30)))
    assert part.noise.value.tolist() == [3]
    with fits.open(tmp_path / "var.fits", mode="update") as hdus:
        hdus["UNCERT"].data = hdus["UNCERT"].data[1:]
    with pytest.raises(ValueError, match="var.fits: its extension UNCERT has shape"):
        EpochCube.read(tmp_path / "var.fits")


def test_a_psf_is_not_taken_for_a_beam():
    with_psf = image(0, psf=np.ones((3, 3)))
    with pytest.warns(EpochWarning, match="image 0: its psf is an image, of which no"):
        assert EpochCube.from_ccddata([with_psf]).beams is None
    given = EpochCube.from_ccddata([with_psf], beams=Beam(1 * u.mas, 1 * u.mas))
    assert given.beams is not None


def test_one_image_needs_no_list():
    assert EpochCube.from_ccddata(image(0)).shape == (1, 24, 36)


# -- what arrays carry -----------------------------------------------------------


@pytest.mark.parametrize("data", [[image(0), image(1)], image(0)])
def test_images_as_data_are_refused(data):
    with pytest.raises(TypeError, match=r"use EpochCube.from_ccddata or from_ndcube"):
        EpochCube(data, DATES[:2], celestial())
    with pytest.raises((TypeError, ValueError), match=r"from_ccddata|must have shape"):
        EpochCube.from_arrays(data, DATES[:2], pixel_scale=1 * u.mas)


def test_lists_of_quantities_and_masked_arrays_keep_unit_and_mask():
    cube = EpochCube([DATA[0] * u.Jy, DATA[1] * 1e3 * u.mJy], DATES[:2], celestial())
    assert cube.unit == u.Jy
    assert_allclose(cube.data, DATA[:2])
    bad = DATA[:2] > 1
    for data in (
        [np.ma.masked_array(d, m) for d, m in zip(DATA, bad, strict=False)],
        [Masked(d, m) for d, m in zip(DATA, bad, strict=False)],
        Masked(DATA[:2] * u.K, bad),
    ):
        cube = EpochCube(data, DATES[:2], celestial())
        assert_array_equal(cube.mask, bad)
    assert cube.unit == u.K
    with pytest.raises(TypeError, match="images of real numbers in one unit: "):
        EpochCube([DATA[0] * u.Jy, DATA[1] * u.K], DATES[:2], celestial())


# -- sliced coordinates ------------------------------------------------------------


def test_slices_of_nddata_keep_their_coordinates():
    whole = NDDataRef(DATA[0], wcs=celestial(), meta={"DATE-OBS": DATES[0]})
    part = whole[3:20, 5:]
    assert isinstance(part.wcs.low_level_wcs, SlicedLowLevelWCS)
    cube = EpochCube.from_ccddata([part])
    assert_array_equal(cube.data[0], DATA[0, 3:20, 5:])
    assert cube.wcs.wcs.crpix.tolist() == [5, 2]


def test_an_image_that_lost_an_axis_is_refused():
    line = HighLevelWCSWrapper(SlicedLowLevelWCS(celestial(), (3, slice(None))))
    with pytest.raises(ValueError, match="lost a celestial axis by slicing"):
        EpochCube(DATA, DATES, line)


# -- NDCube ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ndcube():
    return pytest.importorskip("ndcube")


def assert_same_sky(cube, source):
    """Every pixel is where the public interface of the WCS of the NDCube says."""
    y, x = np.indices(cube.shape[1:])
    low = source.wcs.low_level_wcs
    there = low.pixel_to_world_values(x, y, np.zeros(x.shape))
    here = cube.wcs.pixel_to_world_values(x, y)
    assert_allclose(here, there[:2], rtol=0, atol=1e-12)


def test_ndcube_there_and_back(ndcube):
    cube = make_cube()
    back = EpochCube.from_ndcube(cube.to_ndcube())
    assert_array_equal(back.data, cube.data)
    assert_array_equal(back.mask, cube.mask)
    assert np.all(back.times == cube.times)
    assert_allclose(back.noise, cube.noise)
    assert (back.unit, back.beams, back.labels) == (cube.unit, cube.beams, cube.labels)
    assert back.epoch_meta == cube.epoch_meta
    assert back.meta == {"object": "J0000", "history": ["made", "from an NDCube"]}
    assert back.wcs.wcs.crpix.tolist() == [10, 5]
    bare = make_cube(noise=None, beams=None).to_ndcube()
    back = EpochCube.from_ndcube(bare)
    assert (bare.uncertainty, back.noise, back.beams) == (None, None, None)


@pytest.mark.parametrize(
    ("select", "expected"),
    [
        (lambda n: n[1:], lambda d: d[1:]),
        (lambda n: n[:, 4:, 5:30], lambda d: d[:, 4:, 5:30]),
        (lambda n: n[1:, 4:][:, :12], lambda d: d[1:, 4:16]),
        (
            lambda n: n.rebin((1, 2, 3)),
            lambda d: d.reshape(3, 12, 2, 12, 3).mean(axis=(2, 4)),
        ),
        (
            lambda n: n[1:, 4:].rebin((1, 2, 3))[:, 1:, 2:],
            lambda d: d[1:, 4:].reshape(2, 10, 2, 12, 3).mean(axis=(2, 4))[:, 1:, 2:],
        ),
    ],
)
def test_sliced_and_rebinned_ndcubes(ndcube, select, expected):
    whole = make_cube(mask=None)
    source = select(whole.to_ndcube())
    cube = EpochCube.from_ndcube(source)
    assert_allclose(cube.data, expected(DATA), atol=1e-12)
    assert_same_sky(cube, source)
    first = 3 - len(cube)
    assert np.all(cube.times == whole.times[first:])
    assert cube.beams == whole.beams[first:]
    assert cube.labels == whole.labels[first:]
    assert cube.epoch_meta == whole.epoch_meta[first:]
    # A rebinned image has other noise, of which ndcube was told nothing.
    if source.uncertainty is not None:
        assert_allclose(cube.noise, whole.noise[first:])
    else:
        assert cube.noise is None


@pytest.mark.parametrize("kind", ["cdelt", "crota", "cd"])
def test_rebinned_coordinates_however_they_are_written(ndcube, kind):
    wcs = celestial(30.0 if kind == "crota" else None)
    if kind == "cd":
        wcs.wcs.cd = [[-1e-7, 2e-8], [3e-8, 2e-7]]
    source = ndcube.NDCube(DATA[0], wcs=wcs).rebin((2, 3))
    cube = EpochCube.from_ndcube(source, times="2000-01-01")
    x, y = np.mgrid[:12, :12]
    there = source.wcs.low_level_wcs.pixel_to_world_values(x, y)
    assert_allclose(cube.wcs.pixel_to_world_values(x, y), there, rtol=0, atol=1e-12)


def test_one_epoch_of_an_ndcube(ndcube):
    whole = make_cube()
    source = whole.to_ndcube()
    one = EpochCube.from_ndcube(source[1, 2:])
    assert one.shape == (1, 22, 36)
    assert one.times[0] == whole.times[1]
    assert one.beams == whole.beams[1:2]
    parts = EpochCube.from_ccddata([source[2], source[0]])
    assert_array_equal(parts.data, DATA[[0, 2]])
    assert_allclose(parts.noise, whole.noise[[0, 2]])
    assert parts.beams == (whole.beams[0], whole.beams[2])
    assert parts.wcs.wcs.crpix.tolist() == [10, 5]
    with pytest.raises(ValueError, match="image 0: is an NDCube of 3 epochs; give it"):
        EpochCube.from_ccddata([source])
    with pytest.raises(ValueError, match="two celestial axes"):
        EpochCube.from_ndcube(source[:, 3])


def test_averaged_epochs_of_an_ndcube(ndcube):
    source = make_cube().to_ndcube().rebin((3, 1, 1))
    with pytest.raises(ValueError, match="averaged, .* keeps the first date only;"):
        EpochCube.from_ndcube(source, beams=Beam(3 * u.mas, 1 * u.mas))
    with pytest.raises(ValueError, match="of which the beams differ; call"):
        EpochCube.from_ndcube(source, times="2000-06-01")
    one = make_cube(beams=Beam(3 * u.mas, 1 * u.mas), mask=None)
    mean = EpochCube.from_ndcube(one.to_ndcube().rebin((3, 1, 1)), times="2000-06-01")
    assert_allclose(mean.data[0], DATA.mean(axis=0))
    assert mean.beams == one.beams[:1]
    assert mean.labels == ("2000-06-01",)


def test_ndcubes_of_others_keep_noise_and_beam(ndcube):
    wcs = make_cube().to_ndcube().wcs
    wcs.wcs.ctype = "RA---SIN", "DEC--SIN", "STEP"
    source = ndcube.NDCube(
        DATA,
        wcs=wcs,
        unit=JY_BEAM,
        uncertainty=VarianceUncertainty(np.full(DATA.shape, 4.0)),
        meta={"OBJECT": "M87", "BMAJ": 1e-7, "BMIN": 1e-7, "BPA": 0.0},
    )
    with pytest.raises(ValueError, match="no coordinate of type Time; give times="):
        EpochCube.from_ndcube(source)
    source.extra_coords.add("time", (0,), Time(DATES))
    cube = EpochCube.from_ndcube(source)
    assert cube.noise.value.tolist() == [2, 2, 2]
    assert cube.beams[0] == Beam(1e-7 * u.deg, 1e-7 * u.deg)
    assert cube.epoch_meta[2] == {"object": "M87"}
    source.uncertainty.array[1, :5] = 100
    with pytest.warns(EpochWarning, match="the NDCube: its uncertainty differs from"):
        assert EpochCube.from_ndcube(source).noise.value.tolist() == [2, 2, 2]
    source.uncertainty = UnknownUncertainty(DATA)
    with pytest.raises(ValueError, match="the NDCube: its uncertainty is a Unknown"):
        EpochCube.from_ndcube(source)


def test_an_only_epoch_takes_the_date_of_its_header(ndcube):
    source = ndcube.NDCube(DATA[0], wcs=celestial(), meta={"DATE-OBS": DATES[1]})
    assert EpochCube.from_ndcube(source).times[0] == Time(DATES[1])
    source.meta = {}
    with pytest.raises(ValueError, match="no coordinate of type Time; give times="):
        EpochCube.from_ndcube(source)


# -- images of other packages ------------------------------------------------------


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
    assert made.reference_pixel == (9, 4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ValueError, match="image 0: has 2 planes"):
            EpochCube.from_ccddata([cube], times=DATES[:1])


SUN = {
    "CTYPE1": "HPLN-TAN", "CTYPE2": "HPLT-TAN", "CUNIT1": "arcsec", "CUNIT2": "arcsec",
    "CRVAL1": 0.0, "CRVAL2": 0.0, "CRPIX1": 16.5, "CRPIX2": 8.5, "CDELT1": 0.6,
    "CDELT2": 0.6, "CROTA2": 0.02, "BUNIT": "DN", "TELESCOP": "SDO/AIA",
}  # fmt: skip


def image_of(i):
    y, x = np.mgrid[:16, :32]
    noise = np.random.default_rng(i).normal(scale=0.01, size=(16, 32))
    return 5 * np.exp(-((x - 12 - i) ** 2 + (y - 8) ** 2) / 8) + noise


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


def with_hdu(data, **header):
    return SimpleNamespace(hdu=fits.ImageHDU(data, fits.Header(header)), meta={})


def test_an_image_with_an_hdu():
    header = {**SUN, "DATE-OBS": "2001-01-01"}
    cube = EpochCube.from_ccddata([with_hdu(np.ones((8, 9)), **header)])
    assert cube.shape == (1, 8, 9)
    for image in (with_hdu(np.ones((3, 8, 9)), **header), with_hdu(np.ones((8, 9)))):
        with pytest.raises(ValueError, match=r"image 0: .*(plane|celestial)"):
            EpochCube.from_ccddata([image])
    for other in (np.ones((8, 9)), SimpleNamespace(hdu=fits.BinTableHDU())):
        with pytest.raises(TypeError, match="image 0: is a .*; give NDData, such as"):
            EpochCube.from_ccddata([other])
