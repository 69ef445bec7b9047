# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""FITS images of many programs, and files that are damaged."""

import bz2
import gzip
import lzma
import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.nddata import CCDData
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from astro_scc.epochs import EpochCube
from astro_scc.exceptions import EpochWarning
from astro_scc.images.fits import looks_like_mask, read_plane, read_vlbi_fits

PIXELS = np.random.default_rng(1).normal(size=(1, 1, 16, 32))


def test_degenerate_axes_and_byte_order(make_fits, tmp_path):
    path = make_fits()
    image = CCDData.read(path, format="vlbi-fits")
    assert isinstance(image, CCDData)
    assert (image.unit, image.mask, image.wcs.naxis) == (u.Jy / u.beam, None, 2)
    assert image.data.dtype == np.float64
    assert image.data.dtype.isnative
    assert np.array_equal(image.data, PIXELS[0, 0])
    assert (image.meta["FREQ"], image.meta["STOKES"]) == (15.4e9, "I")
    assert image.meta["BMAJ"] == pytest.approx(1 / 3.6e6)
    assert not {"CTYPE3", "NAXIS4", "BUNIT", "EPOCH"} & set(image.meta)
    image.write(tmp_path / "b.fits")
    again = read_vlbi_fits(tmp_path / "b.fits")
    assert np.array_equal(again.data, image.data)
    assert (again.unit, again.meta["BMAJ"]) == (image.unit, image.meta["BMAJ"])
    assert np.allclose(again.wcs.wcs.crval, image.wcs.wcs.crval)
    # Other files of CCDData are not hijacked.
    CCDData(np.ones((4, 4)), unit="adu").write(tmp_path / "ccd.fits")
    assert CCDData.read(tmp_path / "ccd.fits").unit == u.adu


@pytest.mark.parametrize("kind", ["i2", "i4", "u1", "f4"])
def test_pixel_types(make_fits, kind):
    data = np.arange(16 * 32, dtype=">f8").reshape(16, 32) % 100
    image = read_vlbi_fits(make_fits(data=data.astype(kind)))
    assert np.array_equal(image.data, data)


def test_scaled_blank_and_not_finite_pixels(tmp_path, aips_header, make_fits):
    path = tmp_path / "s.fits"
    stored = np.arange(16 * 32).reshape(16, 32).astype("i2")
    fits.PrimaryHDU(stored, aips_header()).writeto(path)
    with fits.open(path, mode="update", do_not_scale_image_data=True) as hdus:
        hdus[0].header.update({"BSCALE": 0.5, "BZERO": 10.0, "BLANK": 3})
    expected = np.where(stored == 3, np.nan, 10 + stored / 2)
    assert np.array_equal(read_vlbi_fits(path).data, expected, equal_nan=True)
    data = PIXELS.copy()
    data[0, 0, :, 0] = 0
    data[0, 0, :3, 0] = np.nan, np.inf, -np.inf
    image = read_vlbi_fits(make_fits(data=data))
    assert image.mask.sum() == 3
    assert image.mask[:3, 0].all()


def test_stokes_i_is_taken_from_several_planes(make_fits):
    data = np.concatenate([PIXELS + k for k in range(4)])
    for plane, changes in ((0, {}), (3, {"CRVAL4": 4.0, "CDELT4": -1.0})):
        image = read_vlbi_fits(make_fits(data=data, **changes))
        assert np.array_equal(image.data, data[plane, 0])


@pytest.mark.parametrize(
    ("shape", "changes", "message"),
    [
        ((4, 1, 16, 32), {"CRVAL4": -4.0}, "4 planes .* STOKES and none of them is I"),
        ((4, 1, 16, 32), {"CRVAL4": None}, "STOKES and none of them is I"),
        ((1, 3, 16, 32), {}, "3 planes on axis FREQ"),
        ((5, 16, 32), {"CTYPE3": None}, "5 planes on axis 3 of the file"),
    ],
)
def test_several_planes_are_refused(make_fits, shape, changes, message):
    path = make_fits(data=np.broadcast_to(PIXELS[0, 0], shape), **changes)
    with pytest.raises(ValueError, match=message) as caught:
        read_vlbi_fits(path)
    assert str(caught.value).startswith(f"{path}: has ")


def test_history_tables_and_extensions(tmp_path, aips_header):
    header = aips_header(BMAJ=None, BMIN=None, BPA=None)
    for k in range(500):
        header.add_history(f"AIPS   line {k}")
    columns = [
        fits.Column(name, "1E", unit="DEGREES", array=[value])
        for name, value in (("BMAJ", 3e-7), ("BMIN", 1.5e-7), ("BPA", 5.0))
    ]
    table = fits.BinTableHDU.from_columns(columns, name="AIPS CG")
    path = tmp_path / "a.fits"
    fits.HDUList([fits.PrimaryHDU(PIXELS, header), table]).writeto(path)
    image = read_vlbi_fits(path)
    assert image.meta["BMAJ"] == pytest.approx(3e-7)
    assert len(image.meta["HISTORY"]) == 500
    with pytest.raises(OSError, match="holds no image of real numbers"):
        read_vlbi_fits(path, hdu="AIPS CG")
    # An image in an extension, with the date in the primary header.
    primary = fits.PrimaryHDU()
    primary.header.update({"DATE-OBS": "1995-04-01", "TIME-OBS": "12:00:00"})
    header = aips_header(DATE_OBS=None, BUNIT="ELECTRONS/S", BMAJ=None)
    parts = {"SCI": PIXELS[0, 0], "WHT": PIXELS[0, 0] * 0 + 5}
    hdus = [fits.ImageHDU(data, header, name=name) for name, data in parts.items()]
    path = tmp_path / "hst.fits"
    fits.HDUList([primary, *hdus]).writeto(path)
    image = read_vlbi_fits(path)
    assert image.unit == u.electron / u.s
    assert np.array_equal(image.data, PIXELS[0, 0])
    assert EpochCube.read(path).times[0].isot == "1995-04-01T12:00:00.000"
    for hdu in ("WHT", 2):
        assert np.all(read_vlbi_fits(path, hdu=hdu).data == 5)
    with pytest.raises(OSError, match=r"has no extension 'ERR'"):
        read_vlbi_fits(path, hdu="ERR")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"BUNIT": "FURLONGS"}, "unit 'FURLONGS' is not known and taken as dimensionl"),
        ({"BMAJ": -1e-7}, "unknown: .* is not positive; write BMAJ, BMIN and BPA in"),
        ({"BMAJ": 1.0, "BMIN": 0.5}, "larger than the image; write BMAJ, BMIN and BPA"),
    ],
)
def test_what_is_not_understood_is_said_and_left_out(make_fits, changes, message):
    path = make_fits(**changes)
    with pytest.warns(EpochWarning, match=message):
        image = read_vlbi_fits(path)
    assert ("BMAJ" in image.meta) == ("BUNIT" in changes)
    assert len(read_plane(path).notes) == 1


def drizzled(path, weight, **changes):
    """An image as the pipelines of HST write it: date in one header, WCS in another."""
    scale = 0.025 / 3600
    primary = {"TELESCOP": "HST", "TARGNAME": "HH 1", "EXPSTART": 51544.5,
               "FILTER1": "CLEAR1L", "FILTER2": "F658N", "D001SCAL": 0.025,
               "DATE": "2024-01-01", **changes}  # fmt: skip
    celestial = {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 84.1,
                 "CRVAL2": -6.8, "CRPIX1": 16.0, "CRPIX2": 9.0, "CD1_1": -scale,
                 "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": scale, "ORIENTAT": 0.0,
                 "BUNIT": "ELECTRONS/S"}  # fmt: skip
    image = np.random.default_rng(1).poisson(5.0, (16, 32)).astype(np.float32)
    hdus = [
        fits.PrimaryHDU(header=fits.Header(primary)),
        fits.ImageHDU(image, fits.Header(celestial), name="SCI"),
        fits.ImageHDU(weight.astype(np.float32), name="WHT"),
    ]
    fits.HDUList(hdus).writeto(path)


def test_drizzled_images_of_hst(tmp_path):
    weight = np.ones((16, 32))
    weight[:3] = 0
    drizzled(tmp_path / "a.fits", weight)
    drizzled(tmp_path / "b.fits", weight[:8], EXPSTART=52544.5)
    cube = EpochCube.read(tmp_path / "*.fits", frame="absolute")
    assert cube.times.mjd.tolist() == [51544.5, 52544.5]
    assert (cube.unit, cube.beams) == (u.electron / u.s, None)
    assert np.array_equal(cube.mask[0], weight == 0)
    assert not cube.mask[1].any()
    drizzled(tmp_path / "c.fits", weight * 0, EXPSTART=53544.5, FILTER2="F814W")
    with pytest.raises(ValueError, match="no valid pixel by its extension WHT; leave"):
        read_vlbi_fits(tmp_path / "c.fits")


# -- what is no image ------------------------------------------------------------


def refused(path, words, error=OSError):
    """The file is refused in one line that names it."""
    with pytest.raises(error, match=words) as caught:
        read_vlbi_fits(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


def test_what_is_no_image_is_an_os_error_of_one_line(tmp_path, make_fits):
    (tmp_path / "text.fits").write_text("not FITS\nat all")
    (tmp_path / "empty.fits").touch()
    fits.PrimaryHDU().writeto(tmp_path / "nothing.fits")
    fits.PrimaryHDU(np.ones(8)).writeto(tmp_path / "spectrum.fits")
    for path in (*tmp_path.iterdir(), tmp_path / "missing.fits", tmp_path):
        refused(path, str(path))
    with pytest.raises(TypeError):
        read_vlbi_fits(3)
    sip = {"CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "A_ORDER": 2,
           "B_ORDER": 2, "A_2_0": 1e-4, "B_0_2": 1e-4}  # fmt: skip
    names = ("CTYPE", "CRVAL", "CRPIX", "CDELT")
    others = [f"{name}{k}" for name in names for k in (3, 4)]
    path = make_fits(data=PIXELS[0, 0], **sip, **dict.fromkeys(others))
    refused(path, "are distorted", ValueError)
    assert not looks_like_mask(np.full((2, 2), np.nan))


@pytest.mark.parametrize("keep", [1, 80, 2880, 2881, 5000, 6000, -3000])
def test_truncated_files(make_fits, keep):
    path = make_fits()
    path.write_bytes(path.read_bytes()[:keep])
    refused(path, r"truncated|broken|no image")


@pytest.mark.parametrize(
    "kind", ["GZIP_1", "GZIP_2", "RICE_1", "PLIO_1", "HCOMPRESS_1", "NOCOMPRESS"]
)
def test_tile_compressed_images(make_fits, kind):
    y, x = np.mgrid[:256, :256]
    image = 1000 * np.exp(-((x - 125) ** 2 + (y - 130) ** 2) / 50)
    image = image + np.random.default_rng(1).normal(10, size=image.shape)
    exact = kind == "PLIO_1"
    image = np.rint(image.clip(0)).astype("int32") if exact else image.astype("f4")
    plain = make_fits(data=image)
    path = plain.with_suffix(".fits.fz")
    # Without a seed, the rounding is random.
    options = {"compression_type": kind, "dither_seed": 7}
    with fits.open(plain) as hdus:
        fits.CompImageHDU(hdus[0].data, hdus[0].header, **options).writeto(path)
    if kind != "NOCOMPRESS":
        # Smaller than its pixels are, which it is not for being truncated.
        assert path.stat().st_size < 0.7 * plain.stat().st_size
    one, other = read_vlbi_fits(plain), read_vlbi_fits(path)
    # Floats are rounded to a sixteenth of the noise.
    assert np.abs(one.data - other.data).max() <= (0 if exact else 1 / 16)
    assert (other.unit, other.wcs.wcs) == (one.unit, one.wcs.wcs)
    for name in ("BMAJ", "BMIN", "BPA", "DATE-OBS", "OBJECT", "FREQ"):
        assert other.meta.get(name) == one.meta.get(name)
    window = read_plane(path, window=(slice(125, 135), slice(120, 150)))
    assert np.array_equal(window.data, other.data[125:135, 120:150])
    content = path.read_bytes()
    end = len(content.rstrip(b"\0"))
    for keep in (3000, len(content) // 2, len(content) - 2881, end - 1):
        path.write_bytes(content[:keep])
        refused(path, r"truncated|broken|no image")
    path.write_bytes(content[: end + 8])
    assert np.array_equal(read_vlbi_fits(path).data, other.data)


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lzma.compress])
def test_truncated_compressed_files(make_fits, pack):
    """Whatever their suffix."""
    path = make_fits()
    content = path.read_bytes()
    # Missing padding is no loss.
    path.write_bytes(content.rstrip(b"\0"))
    assert np.array_equal(read_vlbi_fits(path).data, PIXELS[0, 0])
    content = pack(content)
    path.write_bytes(content)
    assert np.array_equal(read_vlbi_fits(path).data, PIXELS[0, 0])
    for keep in (10, len(content) // 2, len(content) - 100):
        path.write_bytes(content[:keep])
        refused(path, "broken")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"NAXIS1  =                   32", b"NAXIS1  =                99999", "trunc"),
        (b"NAXIS1  =                   32", b"NAXIS1  =         999999999999", "trunc"),
        (b"NAXIS   =                    4", b"NAXIS   =          99999999999",
         "is broken, it claims 99999999999 axes"),
    ],
)  # fmt: skip
def test_headers_that_claim_too_much(make_fits, old, new, words):
    path = make_fits()
    path.write_bytes(path.read_bytes().replace(old, new))
    refused(path, f"{words}|broken")


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2879), st.binary(min_size=1, max_size=20))
def test_a_damaged_header_is_read_or_refused_in_one_line(make_fits, start, damage):
    path = make_fits()
    content = bytearray(path.read_bytes())
    content[start : start + len(damage)] = damage
    path.write_bytes(content)
    with warnings.catch_warnings(action="error"):
        warnings.simplefilter("ignore", EpochWarning)
        try:
            read_vlbi_fits(path)
        except (OSError, ValueError) as error:
            if "\n" in str(error) or not str(error).startswith(f"{path}: "):
                raise


def test_files_of_the_survey_and_with_quirks(shared_data):
    path = min((shared_data / "0506+056").glob("*.fits"))
    image = read_vlbi_fits(path)
    assert (image.shape, image.unit) == ((512, 512), u.Jy / u.beam)
    assert 3.9e-7 < image.meta["BMAJ"] < 4.2e-7
    assert image.meta["FREQ"] == 15357490000.0
    assert len(image.meta["HISTORY"]) > 1500
    quirks = shared_data / "quirks"
    askap = read_vlbi_fits(quirks / "3C293_askap_mid_4amin.fits")
    assert askap.meta["BMAJ"] == pytest.approx(28.6 / 3600)
    dashes = read_vlbi_fits(quirks / "sampling_mean.fits")
    assert dashes.unit == u.Jy / u.pix
    assert dashes.wcs.pixel_scale_matrix[0, 0] > 0
    with pytest.raises(ValueError, match=r"sampling_mean.fits: no date of observation"):
        EpochCube.read(quirks / "sampling_mean.fits")
    stacked = read_vlbi_fits(quirks / "map_stacked.fits")
    assert stacked.meta["OBJECT"] == "J0738+17"
