# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Cubes of NDData and NDCubes, and in files: to the bit, complete or not at all."""

import string
import sys

import astropy.nddata as ndd
import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.time import Time
from astropy.utils.masked import Masked
from astropy.wcs import WCS
from astropy.wcs.wcsapi import HighLevelWCSWrapper, SlicedLowLevelWCS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from astro_scc.epochs import Beam, EpochCube, inspect_epochs, serialize, write_epochs
from astro_scc.epochs.inspection import kind_of
from astro_scc.exceptions import EpochWarning
from astro_scc.images.positions import offset_wcs

DATES = ["2000-01-01", "2000-06-01", "2001-01-01"]
EXACT = ["2001-01-01T01:02:03.456789", "2000-01-01", "2000-06-01"]
SHAPE = (24, 36)
DATA = np.random.default_rng(1).normal(size=(3, *SHAPE))
JY_BEAM, MJY_BEAM = u.Jy / u.beam, u.mJy / u.beam


def celestial():
    wcs = offset_wcs(0.36 * u.mas, (9, 4), SkyCoord(10, 20, unit="deg"))
    wcs.wcs.set()
    return wcs


def image(i, **changes):
    values = {"unit": JY_BEAM, "wcs": celestial(), "meta": {"DATE-OBS": DATES[i]}}
    return ndd.CCDData(DATA[i], **values | changes)


def make_cube(**changes):
    values = {
        "unit": JY_BEAM, "noise": [1, 2, 3] * MJY_BEAM, "labels": ("a", "b", "c"),
        "beams": [Beam(k * u.mas, 0.5 * u.mas) for k in (1, 2, 3)], "mask": DATA > 2,
        "epoch_meta": [{"object": "J0000", "telescope": k} for k in "xyz"],
        "meta": {"object": "J0000", "history": ["made"]},
    }  # fmt: skip
    return EpochCube(DATA, DATES, celestial(), **values | changes)


def test_uncertainties_are_the_noise():
    for uncertainty, noise in [
        (ndd.StdDevUncertainty(np.full(SHAPE, 500), unit=MJY_BEAM), 0.5),
        (ndd.VarianceUncertainty(np.full(SHAPE, 9), unit=MJY_BEAM**2), 0.003),
        (ndd.InverseVariance(np.full(SHAPE, 16), unit=u.Jy**-2 * u.beam**2), 0.25),
    ]:
        cube = of(*(image(i, uncertainty=uncertainty) for i in range(3)))()
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
    variance = image(0, uncertainty=ndd.VarianceUncertainty(np.full(SHAPE, 9)))
    variance.write(tmp_path / "var.fits")
    part = EpochCube.read(tmp_path / "var.fits", region=(slice(2, 9), slice(3, 30)))
    assert part.noise.value.tolist() == [3]


def test_a_psf_that_is_an_image_is_no_beam():
    words = "image 0: its beam is taken as unknown: its psf is an image, of which no"
    with_psf, own = image(0, psf=np.ones((3, 3))), Beam(1 * u.mas, 1 * u.mas)
    with pytest.warns(EpochWarning, match=words):
        assert EpochCube.from_ccddata(with_psf).beams is None
    assert EpochCube.from_ccddata(with_psf, beams=own).beams == (own,)


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
    whole = ndd.NDDataRef(DATA[0], wcs=celestial(), meta={"DATE-OBS": DATES[0]})
    cube = EpochCube.from_ccddata([whole[3:20, 5:]])
    assert_array_equal(cube.data[0], DATA[0, 3:20, 5:])
    assert (cube.wcs.wcs.crpix.tolist(), cube.labels) == ([5, 2], (DATES[0],))


@pytest.fixture(scope="module")
def ndcube():
    return pytest.importorskip("ndcube")


@pytest.mark.parametrize(("unit", "step"), [("s", 3600), ("h", 1), ("d", 1 / 24)])
def test_an_ndcube_with_a_time_axis(ndcube, unit, step):
    wcs = WCS(naxis=3)
    wcs.wcs.ctype, wcs.wcs.crpix = ["TIME", "RA---TAN", "DEC--TAN"], [1] * 3
    wcs.wcs.cunit, wcs.wcs.cdelt = [unit, "deg", "deg"], [step, 1e-4, 1e-4]
    wcs.wcs.dateref, wcs.wcs.mjdref = "2014-06-01T00:00:00", (56809, 0)
    wcs.wcs.set()
    array = np.moveaxis(DATA, 0, 2)
    source = ndcube.NDCube(array, wcs=wcs, unit=u.ct, mask=array > 1)
    cube = EpochCube.from_ndcube(source)
    assert_array_equal(cube.data, DATA)
    assert_array_equal(cube.mask, DATA > 1)
    assert cube.years.to_value(u.hour) == pytest.approx([0, 1, 2])
    beam = Beam(0.5 * u.arcsec, 0.5 * u.arcsec)
    given = EpochCube.from_ndcube(source, times=DATES, beams=beam)
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


def test_ndcubes_that_are_refused(ndcube, monkeypatch):
    for make, options, words in [
        (lambda n: make_cube().to_ndcube().rebin((3, 1, 1)), {"times": DATES[1]},
         "were averaged, .* rebin its celestial axes alone"),
        (lambda n: n.NDCube(DATA, wcs=make_cube().to_ndcube().wcs, mask=DATA[0] > 1),
         {}, "mask and uncertainty of an"),
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
        maps.append(ndd.NDData(DATA[i], unit=u.DN, wcs=wcs, meta=meta))
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
UNFIT._uncertainty = ndd.StdDevUncertainty(np.ones(SHAPE), unit=u.K)


def of(*images):
    return lambda: EpochCube.from_ccddata(images)


def of_arrays(data=DATA, times=DATES, **fields):
    return lambda: EpochCube.from_arrays(data, times, pixel_scale=1 * u.mas, **fields)


def test_what_is_refused_in_one_line():
    for call, words in [
        *((of(image(0, uncertainty=own)), f"image 0: its uncertainty .*{words}")
          for own, words in [
            (ndd.UnknownUncertainty(np.ones(SHAPE)), "is of type Unknown.*; give it a"),
            (ndd.StdDevUncertainty(None), "has no values; remove it"),
            (ndd.StdDevUncertainty(np.full(SHAPE, -1.0)), "has negative values; cor"),
            (ndd.InverseVariance(np.zeros(SHAPE)), "finite at no valid pixel; rem")]),
        (of(UNFIT), "image 0: .* StdDevUncertainty is in K, which"),
        (of(ndd.NDData(PLANE, meta={"DATE-OBS": DATES[0]})), "image 0: it has no WCS"),
        (of(ndd.NDData(np.ones((2, 8, 9)), wcs=celestial())), r"has shape \(2, 8, 9\)"),
        (of(ndd.NDData(PLANE * np.nan, wcs=celestial())), "image 0: no valid pixel"),
        (of(PLANE), "image 0: is a .*; give NDData, such as"),
        (lambda: EpochCube([image(0), image(1)], DATES[:2], celestial()),
         "use EpochCube.from_ccddata or from_ndcube"),
        (lambda: EpochCube([DATA[0] * u.Jy, DATA[1] * u.K], DATES[:2], celestial()),
         "images of real numbers in one unit: "),
        (lambda: EpochCube(DATA, DATES, LINE), "lost a celestial axis by slicing"),
        (of_arrays(position="0h 1d"), "position must be a SkyCoord, got '0h 1d'"),
        (of_arrays(DATA * u.dex), "data: its unit is dex, a logarithm"),
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
    cube = of(ndd.NDData(padded, **made))()
    assert_array_equal(cube.mask[0], padded == 0)
    assert_array_equal(of_arrays([padded], DATES[:1])().mask, cube.mask)
    filled = np.where(padded == 0, -999.0, padded)
    with pytest.warns(EpochWarning, match="^its pixels of exactly -999 are taken"):
        assert_array_equal(of_arrays([filled], DATES[:1])().mask, cube.mask)


def exact_cube(**changes):
    data = np.random.default_rng(1).normal(size=(3, 8, 12))
    data[1, 2, 3] = np.nan
    position = SkyCoord(187.27791535123456 * u.deg, 2.0523885012345678 * u.deg)
    cube = EpochCube.from_arrays(
        data, Time(EXACT), pixel_scale=0.0123456789012345 * u.mas, mask=data > 2,
        beams=[Beam(k * 0.1234567890123 * u.mas, 0.1 * u.mas) for k in (1, 2, 3)],
        unit=u.Jy / u.beam, noise=[1, 2, 3] * u.mJy / u.beam, position=position,
        reference_pixel=(3.3, 4.4),
        epoch_meta=[{"frequency": 15.4e9 + k} for k in range(3)],
    )  # fmt: skip
    header = cube.wcs.to_header()
    del header["CDELT1"], header["CDELT2"]
    header.update({"CD1_1": -1.23456789e-9, "CD1_2": 3e-10})
    header.update({"CD2_1": 3e-10, "CD2_2": 1.23456789e-9})
    own = [cube.wcs.deepcopy(), cube.wcs.deepcopy(), WCS(header)]
    own[1].wcs.crval = own[1].wcs.crval + 1.23456789e-10
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


@pytest.mark.parametrize("name", ["cube.fits", "cube.fits.gz"])
def test_everything_comes_back_to_the_bit(tmp_path, name):
    cube, path = exact_cube(), tmp_path / name
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
        exact_cube().write(path)
    with pytest.raises(OSError, match="of layout 99; read it with the version that"):
        EpochCube.read(path)
    exact_cube().write(path, overwrite=True)
    with pytest.raises(ValueError, match="an EpochCube; it has its dates and beams"):
        EpochCube.read(path, times=["2000-01-01"])
    content = path.read_bytes()
    for keep in (3000, len(content) - 3000):
        path.write_bytes(content[:keep])
        with pytest.raises(OSError, match=r"^[^\n]*fits: cannot be read as .*EpochC"):
            EpochCube.read(path)


def test_other_programs_see_images_and_dates(tmp_path):
    cube = exact_cube()
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
