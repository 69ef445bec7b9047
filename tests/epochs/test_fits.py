# Licensed under a 3-clause BSD style license - see LICENSE.rst
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
from astro_scc.images.fits import read_plane, read_vlbi_fits

PIXELS = np.random.default_rng(1).normal(size=(1, 1, 16, 32))


def test_registry_reads_the_same_image(make_fits):
    path = make_fits()
    image = CCDData.read(path, format="vlbi-fits")
    assert isinstance(image, CCDData)
    assert image.unit == u.Jy / u.beam
    assert np.array_equal(image.data, read_vlbi_fits(path).data)


def test_other_files_of_ccddata_are_not_hijacked(tmp_path):
    CCDData(np.ones((4, 4)), unit="adu").write(tmp_path / "ccd.fits")
    assert CCDData.read(tmp_path / "ccd.fits").unit == u.adu


def test_degenerate_axes_and_byte_order(make_fits):
    image = read_vlbi_fits(make_fits())
    assert image.shape == (16, 32)
    assert image.data.dtype == np.float64
    assert image.data.dtype.isnative
    assert np.array_equal(image.data, PIXELS[0, 0])
    assert image.mask is None
    assert image.wcs.naxis == 2
    assert image.meta["FREQ"] == 15.4e9
    assert image.meta["STOKES"] == "I"
    assert image.meta["BMAJ"] == pytest.approx(1 / 3.6e6)
    assert not {"CTYPE3", "NAXIS4", "BUNIT", "EPOCH"} & set(image.meta)


@pytest.mark.parametrize("kind", ["i2", "i4", "u1", "f4", "f8"])
def test_pixel_types(make_fits, kind):
    data = np.arange(16 * 32, dtype=">f8").reshape(16, 32) % 100
    image = read_vlbi_fits(make_fits(data=data.astype(kind)))
    assert np.array_equal(image.data, data)


def test_scaled_and_blank_integers(tmp_path, aips_header):
    header = aips_header()
    hdu = fits.PrimaryHDU(np.arange(16 * 32).reshape(16, 32).astype("i2"), header)
    hdu.header["BSCALE"] = 0.5
    hdu.header["BZERO"] = 10.0
    hdu.header["BLANK"] = 3
    hdu.writeto(tmp_path / "a.fits", output_verify="ignore")
    raw = fits.open(tmp_path / "a.fits", do_not_scale_image_data=True)
    stored = raw[0].data[0, :6].tolist()
    raw.close()
    image = read_vlbi_fits(tmp_path / "a.fits")
    expected = [np.nan if v == 3 else 10 + v / 2 for v in stored]
    assert np.array_equal(image.data[0, :6], expected, equal_nan=True)


def test_image_round_trips_through_ccddata(make_fits, tmp_path):
    image = read_vlbi_fits(make_fits())
    image.write(tmp_path / "b.fits")
    again = read_vlbi_fits(tmp_path / "b.fits")
    assert np.array_equal(again.data, image.data)
    assert again.unit == image.unit
    assert again.meta["BMAJ"] == image.meta["BMAJ"]
    assert np.allclose(again.wcs.wcs.crval, image.wcs.wcs.crval)


def test_pixels_that_are_not_finite_are_masked_and_zeros_are_not(make_fits):
    data = PIXELS.copy()
    data[0, 0, :3, 0] = np.nan, np.inf, -np.inf
    data[0, 0, 3:, 0] = 0
    image = read_vlbi_fits(make_fits(data=data))
    assert image.mask.sum() == 3
    assert image.mask[:3, 0].all()


def test_stokes_i_is_taken_from_several_planes(make_fits):
    data = np.concatenate([PIXELS + k for k in range(4)])
    image = read_vlbi_fits(make_fits(data=data))
    assert np.array_equal(image.data, data[0, 0])
    backwards = {"CRVAL4": 4.0, "CDELT4": -1.0}
    image = read_vlbi_fits(make_fits(data=data, **backwards))
    assert np.array_equal(image.data, data[3, 0])


@pytest.mark.parametrize(
    ("shape", "changes", "message"),
    [
        ((4, 1, 16, 32), {"CRVAL4": -4.0, "CDELT4": 1.0}, "STOKES and none of them is"),
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


def test_thousands_of_history_cards_and_clean_components(tmp_path, aips_header):
    header = aips_header(BMAJ=None, BMIN=None, BPA=None)
    for k in range(500):
        header.add_history(f"AIPS   line {k}")
    header.add_history("AIPS   CLEAN BMAJ=  3.0E-07 BMIN=  1.5E-07 BPA=  5.0")
    table = fits.BinTableHDU.from_columns(
        [fits.Column("FLUX", "1E", unit="JY", array=[1.0])], name="AIPS CC"
    )
    path = tmp_path / "a.fits"
    fits.HDUList([fits.PrimaryHDU(PIXELS, header), table]).writeto(path)
    image = read_vlbi_fits(path)
    assert image.meta["BMAJ"] == pytest.approx(3e-7)
    assert len(image.meta["HISTORY"]) == 501
    with pytest.raises(OSError, match="holds no image of real numbers"):
        read_vlbi_fits(path, hdu="AIPS CC")


def test_beam_of_an_aips_table(tmp_path, aips_header):
    columns = [
        fits.Column(name, "1E", unit="DEGREES", array=[value])
        for name, value in (("BMAJ", 3e-7), ("BMIN", 1.5e-7), ("BPA", 5.0))
    ]
    table = fits.BinTableHDU.from_columns(columns, name="AIPS CG")
    path = tmp_path / "a.fits"
    image = fits.PrimaryHDU(PIXELS, aips_header(BMAJ=None))
    fits.HDUList([image, table]).writeto(path)
    assert read_vlbi_fits(path).meta["BMAJ"] == pytest.approx(3e-7)


def test_image_in_an_extension_with_the_date_in_the_primary_header(
    tmp_path, aips_header
):
    primary = fits.PrimaryHDU()
    primary.header["DATE-OBS"] = "1995-04-01"
    primary.header["TIME-OBS"] = "12:00:00"
    header = aips_header(DATE_OBS=None, BUNIT="ELECTRONS/S", BMAJ=None)
    hdus = [
        primary,
        fits.ImageHDU(PIXELS[0, 0], header, name="SCI"),
        fits.ImageHDU(PIXELS[0, 0] * 0 + 5, header, name="WHT"),
    ]
    path = tmp_path / "hst.fits"
    fits.HDUList(hdus).writeto(path)
    image = read_vlbi_fits(path)
    assert image.unit == u.electron / u.s
    assert np.array_equal(image.data, PIXELS[0, 0])
    assert EpochCube.read(path).times[0].isot == "1995-04-01T12:00:00.000"
    assert np.all(read_vlbi_fits(path, hdu="WHT").data == 5)
    assert np.all(read_vlbi_fits(path, hdu=2).data == 5)
    with pytest.raises(OSError, match=r"has no extension 'ERR'"):
        read_vlbi_fits(path, hdu="ERR")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"BUNIT": "FURLONGS"}, "unit 'FURLONGS' is not known and taken as dimensionl"),
        ({"BMAJ": -1e-7}, "unknown: .* is not positive; write BMAJ, BMIN and BPA in"),
        ({"BMIN": 0.0}, "beam is taken as unknown"),
        ({"BMAJ": 1.0, "BMIN": 0.5}, "larger than the image; write BMAJ, BMIN and BPA"),
    ],
)
def test_what_is_not_understood_is_said_and_left_out(make_fits, changes, message):
    path = make_fits(**changes)
    with pytest.warns(EpochWarning, match=message):
        image = read_vlbi_fits(path)
    assert ("BMAJ" in image.meta) == ("BUNIT" in changes)
    assert len(read_plane(path).notes) == 1


def test_distorted_coordinates_are_refused(make_fits):
    sip = {"CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP"}
    orders = {"A_ORDER": 2, "B_ORDER": 2, "A_2_0": 1e-4, "B_0_2": 1e-4}
    others = [
        f"{name}{k}" for name in ("CTYPE", "CRVAL", "CRPIX", "CDELT") for k in (3, 4)
    ]
    path = make_fits(data=PIXELS[0, 0], **sip, **orders, **dict.fromkeys(others))
    with pytest.raises(ValueError, match="are distorted"):
        read_vlbi_fits(path)


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
    drizzled(tmp_path / "c.fits", weight, EXPSTART=53544.5, FILTER2="F814W")
    with pytest.raises(ValueError, match=r"c\.fits: is of the filter F814W, others"):
        EpochCube.read(tmp_path / "*.fits")


def test_an_image_without_exposure_is_refused(tmp_path):
    drizzled(tmp_path / "a.fits", np.zeros((16, 32)))
    with pytest.raises(ValueError, match="no valid pixel by its extension WHT; leave"):
        read_vlbi_fits(tmp_path / "a.fits")


def one_line_naming(error, path):
    return "\n" not in str(error) and str(error).startswith(f"{path}: ")


def test_what_is_no_image_is_an_os_error_of_one_line(tmp_path, make_fits):
    text = tmp_path / "text.fits"
    text.write_text("not FITS\nat all")
    empty = tmp_path / "empty.fits"
    empty.touch()
    nothing = tmp_path / "nothing.fits"
    fits.PrimaryHDU().writeto(nothing)
    spectrum = tmp_path / "spectrum.fits"
    fits.PrimaryHDU(np.ones(8)).writeto(spectrum)
    missing = tmp_path / "missing.fits"
    for path in (text, empty, nothing, spectrum, missing, tmp_path):
        with pytest.raises(OSError, match=str(path)) as caught:
            read_vlbi_fits(path)
        assert one_line_naming(caught.value, path)
    with pytest.raises(TypeError):
        read_vlbi_fits(3)


@pytest.mark.parametrize("keep", [1, 80, 2880, 2881, 2900, 5000, 6000, -3000])
def test_truncated_files(make_fits, keep):
    path = make_fits()
    content = path.read_bytes()
    path.write_bytes(content[:keep])
    with pytest.raises(OSError, match=r"truncated|broken|no image") as caught:
        read_vlbi_fits(path)
    assert one_line_naming(caught.value, path)


@pytest.fixture
def packed(make_fits):
    """An image of 512 x 512 pixels with noise of 10, plain and tile-compressed."""

    def pack(kind):
        y, x = np.mgrid[:512, :512]
        image = 1000 * np.exp(-((x - 250) ** 2 + (y - 260) ** 2) / 50)
        image = image + np.random.default_rng(1).normal(10, size=image.shape)
        if kind == "PLIO_1":
            image = np.rint(image.clip(0)).astype("int32")
        plain = make_fits(data=image.astype(image.dtype.str.replace("f8", "f4")))
        with fits.open(plain) as hdus:
            # Without a seed, the rounding is random.
            options = {"compression_type": kind, "dither_seed": 7}
            image = fits.CompImageHDU(hdus[0].data, hdus[0].header, **options)
            path = plain.with_suffix(".fits.fz")
            image.writeto(path, overwrite=True)
        return plain, path

    return pack


KINDS = ("GZIP_1", "GZIP_2", "RICE_1", "PLIO_1", "HCOMPRESS_1", "NOCOMPRESS")


@pytest.mark.parametrize("kind", KINDS)
def test_tile_compressed_images(packed, kind):
    plain, path = packed(kind)
    if kind != "NOCOMPRESS":
        # Smaller than its pixels are, which it is not for being truncated.
        assert path.stat().st_size < 0.7 * plain.stat().st_size
    one, other = read_vlbi_fits(plain), read_vlbi_fits(path)
    # Floats are rounded to a sixteenth of the noise.
    error = 0 if kind == "PLIO_1" else 10 / 16
    assert np.abs(one.data - other.data).max() <= error
    assert other.unit == one.unit
    assert other.wcs.wcs == one.wcs.wcs
    for name in ("BMAJ", "BMIN", "BPA", "DATE-OBS", "OBJECT", "FREQ"):
        assert other.meta.get(name) == one.meta.get(name)
    window = read_plane(path, window=(slice(250, 270), slice(240, 300)))
    assert np.array_equal(window.data, other.data[250:270, 240:300])


@pytest.mark.parametrize("kind", KINDS)
def test_truncated_tile_compressed_images(packed, kind):
    _, path = packed(kind)
    content = path.read_bytes()
    whole, end = read_vlbi_fits(path).data, len(content.rstrip(b"\0"))
    for keep in (3000, 9000, len(content) // 2, len(content) - 2881, end - 1):
        path.write_bytes(content[:keep])
        with pytest.raises(OSError, match=r"truncated|broken|no image") as caught:
            read_vlbi_fits(path)
        assert one_line_naming(caught.value, path)
    path.write_bytes(content[: end + 8])
    assert np.array_equal(read_vlbi_fits(path).data, whole)


def test_missing_padding_is_no_loss(make_fits):
    path = make_fits()
    content = path.read_bytes()
    path.write_bytes(content.rstrip(b"\0"))
    assert np.array_equal(read_vlbi_fits(path).data, PIXELS[0, 0])


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lzma.compress])
def test_truncated_compressed_files(make_fits, pack):
    """Whatever their suffix."""
    path = make_fits()
    whole, content = read_vlbi_fits(path).data, pack(path.read_bytes())
    path.write_bytes(content)
    assert np.array_equal(read_vlbi_fits(path).data, whole)
    for keep in (10, len(content) // 2, len(content) - 100):
        path.write_bytes(content[:keep])
        with pytest.raises(OSError, match="broken") as caught:
            read_vlbi_fits(path)
        assert one_line_naming(caught.value, path)


@pytest.mark.parametrize("claim", [b"         99999", b"  999999999999"])
def test_header_that_claims_a_huge_image(make_fits, claim):
    path = make_fits()
    old, new = (b"NAXIS1  =       " + n for n in (b"            32", claim))
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(OSError, match="is truncated|broken"):
        read_vlbi_fits(path)


def test_header_that_claims_many_axes(make_fits):
    path = make_fits()
    old, new = (b"NAXIS   =          " + n for n in (b"          4", b"99999999999"))
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(OSError, match="is broken, it claims 99999999999 axes"):
        read_vlbi_fits(path)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2879), st.binary(min_size=1, max_size=20))
def test_a_damaged_header_is_read_or_refused_in_one_line(make_fits, start, damage):
    path = make_fits()
    content = bytearray(path.read_bytes())
    content[start : start + len(damage)] = damage
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", EpochWarning)
        try:
            read_vlbi_fits(path)
        except (OSError, ValueError) as error:
            if not one_line_naming(error, path):
                raise


def test_files_of_the_survey(shared_data):
    for path in sorted((shared_data / "0506+056").glob("*.fits")):
        image = read_vlbi_fits(path)
        assert image.shape == (512, 512)
        assert image.unit == u.Jy / u.beam
        assert 3.9e-7 < image.meta["BMAJ"] < 4.2e-7
        assert image.meta["FREQ"] == 15357490000.0
        assert len(image.meta["HISTORY"]) > 1500


def test_files_with_quirks(shared_data):
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
