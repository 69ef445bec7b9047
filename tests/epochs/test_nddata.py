# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Units, masks, errors, beams and coordinates of NDData are used or refused."""

import sys

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
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
from astropy.utils.masked import Masked
from astropy.wcs import WCS
from astropy.wcs.wcsapi import HighLevelWCSWrapper, SlicedLowLevelWCS
from numpy.testing import assert_allclose, assert_array_equal

from astro_scc.epochs import Beam, EpochCube, inspect_epochs
from astro_scc.exceptions import EpochWarning
from astro_scc.images.positions import offset_wcs

DATES = ["2000-01-01", "2000-06-01", "2001-01-01"]
SHAPE = (24, 36)
DATA = np.random.default_rng(1).normal(size=(3, *SHAPE))
JY_BEAM, MJY_BEAM = u.Jy / u.beam, u.mJy / u.beam


def celestial():
    wcs = offset_wcs(0.36 * u.mas, (9, 4), SkyCoord(10, 20, unit="deg"))
    wcs.wcs.set()
    return wcs


def image(i, **changes):
    values = {"unit": JY_BEAM, "wcs": celestial(), "meta": {"DATE-OBS": DATES[i]}}
    return CCDData(DATA[i], **values | changes)


def make_cube(**changes):
    values = {
        "unit": JY_BEAM, "noise": [1, 2, 3] * MJY_BEAM, "labels": ("a", "b", "c"),
        "beams": [Beam(k * u.mas, 0.5 * u.mas) for k in (1, 2, 3)], "mask": DATA > 2,
        "epoch_meta": [{"object": "J0000", "telescope": k} for k in "xyz"],
        "meta": {"object": "J0000", "history": ["made"]},
    }  # fmt: skip
    return EpochCube(DATA, DATES, celestial(), **values | changes)


@pytest.mark.parametrize(
    ("uncertainty", "noise"),
    [
        (StdDevUncertainty(np.full(SHAPE, 500), unit=MJY_BEAM), 0.5),
        (VarianceUncertainty(np.full(SHAPE, 9), unit=MJY_BEAM**2), 0.003),
        (InverseVariance(np.full(SHAPE, 16), unit=u.Jy**-2 * u.beam**2), 0.25),
    ],
)
def test_uncertainties_are_the_noise(uncertainty, noise):
    images = [image(i, uncertainty=uncertainty) for i in range(3)]
    cube = EpochCube.from_ccddata(images)
    assert cube.noise.unit == JY_BEAM
    assert_allclose(cube.noise.value, noise, rtol=1e-12)
    assert not cube.mask.any()


def same(one, other):
    """Cubes with the same images, dates, beams, noise and names."""
    assert_array_equal(one.data, other.data)
    assert_array_equal(one.mask, other.mask)
    assert_allclose(one.noise, other.noise)
    assert np.all(one.times == other.times)
    for name in ("unit", "beams", "labels", "reference_pixel"):
        assert getattr(one, name) == getattr(other, name)


def test_images_of_a_cube_and_their_files_keep_mask_and_uncertainty(tmp_path):
    assert make_cube(noise=None)[1].uncertainty is None
    same(EpochCube.from_ccddata(list(make_cube())), make_cube())
    for i, part in enumerate(make_cube()):
        part.write(tmp_path / f"{i}.fits")
    cube = EpochCube.read(tmp_path / "*.fits")
    assert_array_equal(cube.mask, DATA > 2)
    assert_allclose(cube.noise.to_value(MJY_BEAM), [1, 2, 3])
    make_cube(noise=None)[1].write(tmp_path / "bare.fits")
    table = inspect_epochs([tmp_path / "0.fits", tmp_path / "bare.fits"])
    assert table["problem"].tolist() == ["", "no noise where other epochs have one"]
    variance = image(0, uncertainty=VarianceUncertainty(np.full(SHAPE, 9)))
    variance.write(tmp_path / "var.fits")
    part = EpochCube.read(tmp_path / "var.fits", region=(slice(2, 9), slice(3, 30)))
    assert part.noise.value.tolist() == [3]


def test_beams_of_the_meta():
    wrong = {"DATE-OBS": DATES[0], "BMAJ": 1.0, "BMIN": -1.0}
    for changes, words in (
        ({"psf": np.ones((3, 3))}, "its psf is an image, of which no beam is made"),
        ({"meta": wrong}, "BPA is missing or no number"),
    ):
        words = f"image 0: its beam is taken as unknown: {words}"
        with pytest.warns(EpochWarning, match=words):
            assert EpochCube.from_ccddata(image(0, **changes)).beams is None
        own = Beam(1 * u.mas, 1 * u.mas)
        assert EpochCube.from_ccddata(image(0, **changes), beams=own).beams == (own,)


def test_quantities_masked_arrays_and_slices_keep_unit_mask_and_coordinates():
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
    whole = NDDataRef(DATA[0], wcs=celestial(), meta={"DATE-OBS": DATES[0]})
    cube = EpochCube.from_ccddata([whole[3:20, 5:]])
    assert_array_equal(cube.data[0], DATA[0, 3:20, 5:])
    assert (cube.wcs.wcs.crpix.tolist(), cube.labels) == ([5, 2], (DATES[0],))


@pytest.fixture(scope="module")
def ndcube():
    return pytest.importorskip("ndcube")


def test_an_ndcube_with_a_time_axis(ndcube):
    wcs = WCS(naxis=3)
    wcs.wcs.ctype, wcs.wcs.crpix = ["TIME", "RA---TAN", "DEC--TAN"], [1] * 3
    wcs.wcs.cunit, wcs.wcs.cdelt = ["s", "deg", "deg"], [3600, 1e-4, 1e-4]
    wcs.wcs.dateref, wcs.wcs.mjdref = "2014-06-01T00:00:00", (56809, 0)
    wcs.wcs.set()
    array = np.moveaxis(DATA, 0, 2)
    source = ndcube.NDCube(array, wcs=wcs, unit=u.ct, mask=array > 1)
    cube = EpochCube.from_ndcube(source)
    assert_array_equal(cube.data, DATA)
    assert_array_equal(cube.mask, DATA > 1)
    assert cube.years.to_value(u.hour) == pytest.approx([0, 1, 2])
    given = EpochCube.from_ndcube(source, times=DATES, beams=Beam(1 * u.mas, 1 * u.mas))
    assert (given.times[0].isot[:10], len(given.beams)) == ("2000-01-01", 3)


def test_ndcube_there_and_back(ndcube):
    cube = make_cube()
    back = EpochCube.from_ndcube(cube.to_ndcube())
    same(back, cube)
    assert back.epoch_meta == cube.epoch_meta
    assert back.meta == {"object": "J0000", "history": ["made", "from an NDCube"]}
    assert EpochCube.from_ndcube(cube.to_ndcube()[1, 2:]).shape == (1, 22, 36)
    assert make_cube(noise=None).to_ndcube().uncertainty is None
    sequence = ndcube.NDCubeSequence([ndcube.NDCube(d, wcs=celestial()) for d in DATA])
    assert_array_equal(EpochCube.from_ndcube(sequence, times=DATES).data, DATA)


def test_sliced_and_rebinned_ndcubes(ndcube):
    whole = make_cube(mask=None)
    source = whole.to_ndcube()[1:, 4:][:, :12].rebin((1, 2, 3))[:, 1:, 2:]
    expected = DATA[1:, 4:16].reshape(2, 6, 2, 12, 3).mean(axis=(2, 4))[:, 1:, 2:]
    cube = EpochCube.from_ndcube(source)
    assert_allclose(cube.data, expected, atol=1e-12)
    # Every pixel is where the public interface of the WCS of the NDCube says.
    y, x = np.indices(cube.shape[1:])
    there = source.wcs.low_level_wcs.pixel_to_world_values(x, y, np.zeros(x.shape))
    here = cube.wcs.pixel_to_world_values(x, y)
    assert_allclose(here, there[:2], rtol=0, atol=1e-12)
    assert np.all(cube.times == whole.times[1:])
    for name in ("beams", "labels", "epoch_meta"):
        assert getattr(cube, name) == getattr(whole, name)[1:]


def of_others(ndcube, **changes):
    wcs = make_cube().to_ndcube().wcs
    wcs.wcs.ctype = "RA---SIN", "DEC--SIN", "STEP"
    meta = {"OBJECT": "M87", "BMAJ": 1e-7, "BMIN": 1e-7, "BPA": 0.0}
    variance = VarianceUncertainty(np.full(DATA.shape, 4.0))
    fields = {"wcs": wcs, "unit": JY_BEAM, "uncertainty": variance, "meta": meta}
    return ndcube.NDCube(DATA, **fields | changes)


def test_ndcubes_that_are_refused(ndcube, monkeypatch):
    for make, options, words in [
        (lambda n: make_cube().to_ndcube().rebin((3, 1, 1)), {"times": DATES[1]},
         "were averaged, .* rebin its celestial axes alone"),
        (lambda n: of_others(n, uncertainty=UnknownUncertainty(DATA)),
         {"times": DATES}, "image 0: its uncertainty is of type Unknown"),
        (lambda n: of_others(n, mask=DATA[0] > 1), {}, "mask and uncertainty of an"),
        (lambda n: n.NDCube(DATA, wcs=WCS(naxis=3)), {}, "have two celestial axes"),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match=words):
            EpochCube.from_ndcube(make(ndcube), **options)
    monkeypatch.setitem(sys.modules, "ndcube", None)
    with pytest.raises(ImportError, match="to_ndcube needs ndcube; pip install ndcube"):
        make_cube().to_ndcube()


SUN = {
    "CTYPE1": "HPLN-TAN", "CTYPE2": "HPLT-TAN", "CUNIT1": "arcsec", "CUNIT2": "arcsec",
    "CRVAL1": 0.0, "CRVAL2": 0.0, "CRPIX1": 16.5, "CRPIX2": 8.5, "CDELT1": 0.6,
    "CDELT2": 0.6, "CROTA2": 0.02, "BUNIT": "DN", "TELESCOP": "SDO/AIA",
}  # fmt: skip


def test_solar_files_and_maps(tmp_path):
    paths, maps = [], []
    for i in range(3):
        date = f"2013-11-16T20:59:{13 + 12 * i:02d}.390Z"
        header = fits.Header({**SUN, "DATE-OBS": date})
        paths.append(tmp_path / f"aia_{i}.fits")
        fits.PrimaryHDU(DATA[i].astype(np.float32), header).writeto(paths[-1])
        # As maps of SunPy are: NDData whose meta has keys in lower case.
        meta, wcs = {k.lower(): v for k, v in header.items()}, WCS(fits.Header(SUN))
        maps.append(NDData(DATA[i], unit=u.DN, wcs=wcs, meta=meta))
    cube, of_maps = EpochCube.read(paths), EpochCube.from_ccddata(maps)
    assert_allclose(of_maps.data, cube.data, rtol=1e-6)
    assert np.all(of_maps.times == cube.times)
    assert_allclose(of_maps.pixel_matrix, cube.pixel_matrix)
    assert np.diff(cube.times.unix) == pytest.approx([12, 12])
    # The longitude of the Sun grows to the right: west is where its motion goes.
    assert cube.pixel_matrix[0, 0].to_value(u.arcsec) == pytest.approx(0.6)
    assert_allclose(cube.align("wcs").data, cube.data)


PLANE = np.ones((8, 9))
LINE = HighLevelWCSWrapper(SlicedLowLevelWCS(celestial(), (3, slice(None))))
#: Of a unit that astropy refuses in images that have one.
UNFIT = image(0)
UNFIT._uncertainty = StdDevUncertainty(np.ones(SHAPE), unit=u.K)


def of(*images):
    return lambda: EpochCube.from_ccddata(images)


def of_arrays(data=DATA, times=DATES, **fields):
    return lambda: EpochCube.from_arrays(data, times, pixel_scale=1 * u.mas, **fields)


def test_what_is_refused_in_one_line():
    for call, words in [
        *((of(image(0, uncertainty=own)), f"image 0: its uncertainty .*{words}")
          for own, words in [
            (UnknownUncertainty(np.ones(SHAPE)), "is of type UnknownUnc.*; give it as"),
            (StdDevUncertainty(None), "has no values; remove it"),
            (StdDevUncertainty(np.full(SHAPE, -1.0)), "has negative values; correct"),
            (InverseVariance(np.zeros(SHAPE)), "finite at no valid pixel; remove it")]),
        (of(UNFIT), "image 0: .* StdDevUncertainty is in K, which"),
        (of(NDData(PLANE, meta={"DATE-OBS": DATES[0]})), "image 0: it has no WCS"),
        (of(NDData(np.ones((2, 8, 9)), wcs=celestial())), r"0: has shape \(2, 8, 9\)"),
        (of(NDData(PLANE * np.nan, wcs=celestial())), "image 0: no valid pixel"),
        (of(PLANE), "image 0: is a .*; give NDData, such as"),
        (lambda: EpochCube([image(0), image(1)], DATES[:2], celestial()),
         "use EpochCube.from_ccddata or from_ndcube"),
        (lambda: EpochCube([DATA[0] * u.Jy, DATA[1] * u.K], DATES[:2], celestial()),
         "images of real numbers in one unit: "),
        (lambda: EpochCube(DATA, DATES, LINE), "lost a celestial axis by slicing"),
        (of_arrays(position="0h 1d"), "position must be a SkyCoord, got '0h 1d'"),
        (of_arrays(DATA * u.dex), "data: its unit is dex, a logarithm"),
        (of_arrays(beams=0.5 * u.mas), "a beam has major, minor and pa, got"),
        (of_arrays(reference_pixel=("a", "b")), r"must be two numbers \(x, y\)"),
        (of(image(0, unit=u.mag)), "image 0: its unit is mag, a logarithm"),
        (lambda: EpochCube.from_ndcube(DATA), "a ndarray is no NDCube"),
    ]:  # fmt: skip
        with pytest.raises((TypeError, ValueError), match=words) as caught:
            call()
        assert "\n" not in str(caught.value)
        assert "truth value" not in str(caught.value)


def test_zeros_that_pad_are_missing_at_each_door():
    padded = np.pad(DATA[0], 20)
    made = {"wcs": celestial(), "meta": {"DATE-OBS": DATES[0]}}
    cube = of(NDData(padded, **made))()
    assert_array_equal(cube.mask[0], padded == 0)
    assert_array_equal(of_arrays([padded], DATES[:1])().mask, cube.mask)
    filled = np.where(padded == 0, -999.0, padded)
    with pytest.warns(EpochWarning, match="^its pixels of exactly -999 are taken"):
        assert_array_equal(of_arrays([filled], DATES[:1])().mask, cube.mask)
