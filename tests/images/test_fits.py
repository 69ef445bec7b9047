# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""FITS images of many programs, and files that are damaged."""

import bz2
import gzip
import lzma

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits

from astro_scc.epochs import EpochCube
from astro_scc.images.fits import looks_like_mask, read_plane

PIXELS = np.random.default_rng(1).normal(size=(1, 1, 16, 32))


def test_stokes_i_is_taken_from_several_planes(make_fits):
    data = np.concatenate([PIXELS + k for k in range(4)])
    for plane, changes in ((0, {}), (3, {"CRVAL4": 4.0, "CDELT4": -1.0})):
        image = read_plane(make_fits(data=data, **changes))
        assert np.array_equal(image.data, data[plane, 0])


def refused(path, words, error=OSError):
    """The file is refused in one line that names it."""
    with pytest.raises(error, match=words) as caught:
        read_plane(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


def broadcast(*shape):
    return np.broadcast_to(PIXELS[0, 0], shape)


SIP = {"CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "A_ORDER": 2, "B_ORDER": 2,
       "A_2_0": 1e-4, "B_0_2": 1e-4} | dict.fromkeys(
       f"{name}{k}" for name in ("CTYPE", "CRVAL", "CRPIX", "CDELT") for k in (3, 4)
)  # fmt: skip


@pytest.mark.parametrize(
    ("data", "changes", "words"),
    [
        (broadcast(4, 1, 16, 32), {"CRVAL4": -4.0}, "4 planes .* STOKES and none of"),
        (broadcast(4, 1, 16, 32), {"CRVAL4": None}, "STOKES and none of them is I"),
        (broadcast(5, 16, 32), {"CTYPE3": None}, "has 5 planes on axis 3 of the file"),
        (PIXELS[0, 0], SIP, "has distortions .SIP.; resample"),
        (PIXELS * np.nan, {}, "no valid pixel, all are NaN"),
    ],
)
def test_images_that_cannot_be_used(make_fits, data, changes, words):
    refused(make_fits(data=data, **changes), words, ValueError)


def test_one_row_of_pixels_is_no_image(tmp_path):
    fits.PrimaryHDU(np.ones(8)).writeto(tmp_path / "spectrum.fits")
    refused(tmp_path / "spectrum.fits", "holds no image")
    assert not looks_like_mask(np.full((2, 2), np.nan))


def test_truncated_files_and_headers_that_claim_too_much(make_fits):
    path = make_fits()
    content = path.read_bytes()
    for keep in (1, 2880, 6000, -3000):
        path.write_bytes(content[:keep])
        refused(path, r"truncated|broken|no image")
    old = b"NAXIS1  =                   32"
    for new in (b"NAXIS1  =                99999", b"NAXIS1  =         999999999999"):
        path.write_bytes(content.replace(old, new))
        refused(path, "trunc|broken")
    old, new = (b"NAXIS   =" + text.rjust(21) for text in (b"4", b"99999999999"))
    path.write_bytes(content.replace(old, new))
    refused(path, "is broken, it claims 99999999999 axes")
    # Missing padding is no loss, and files may be packed, whatever their suffix.
    path.write_bytes(content.rstrip(b"\0"))
    assert np.array_equal(read_plane(path).data, PIXELS[0, 0])
    for pack in (gzip.compress, bz2.compress, lzma.compress):
        packed = pack(content)
        path.write_bytes(packed)
        assert np.array_equal(read_plane(path).data, PIXELS[0, 0])
        for keep in (10, len(packed) // 2, len(packed) - 100):
            path.write_bytes(packed[:keep])
            refused(path, "broken")


@pytest.mark.parametrize("kind", ["RICE_1", "PLIO_1"])
def test_tile_compressed_images(make_fits, kind):
    y, x = np.mgrid[:128, :128]
    image = 1000 * np.exp(-((x - 62) ** 2 + (y - 65) ** 2) / 50)
    image = image + np.random.default_rng(1).normal(10, size=image.shape)
    exact = kind == "PLIO_1"
    image = np.rint(image.clip(0)).astype("int32") if exact else image.astype("f4")
    plain = make_fits(data=image)
    path = plain.with_suffix(".fits.fz")
    # Without a seed, the rounding is random.
    options = {"compression_type": kind, "dither_seed": 7}
    with fits.open(plain) as hdus:
        fits.CompImageHDU(hdus[0].data, hdus[0].header, **options).writeto(path)
    # Smaller than its pixels are, which it is not for being truncated.
    assert path.stat().st_size < 0.7 * plain.stat().st_size
    one, other = read_plane(plain), read_plane(path)
    # Floats are rounded to a sixteenth of the noise.
    assert np.abs(one.data - other.data).max() <= (0 if exact else 1 / 16)
    assert (other.unit, other.wcs.wcs, other.beam) == (one.unit, one.wcs.wcs, one.beam)
    assert (other.time, other.facts) == (one.time, one.facts)
    content = path.read_bytes()
    end = len(content.rstrip(b"\0"))
    for keep in (3000, len(content) // 2, len(content) - 2881, end - 1):
        path.write_bytes(content[:keep])
        refused(path, r"truncated|broken|no image")
    path.write_bytes(content[: end + 8])
    assert np.array_equal(read_plane(path).data, other.data)


def test_files_of_the_survey_and_with_quirks(shared_data):
    image = read_plane(min((shared_data / "0506+056").glob("*.fits")))
    assert (image.shape, image.facts["frequency"]) == ((512, 512), 15357490000.0)
    quirks = shared_data / "quirks"
    askap = read_plane(quirks / "3C293_askap_mid_4amin.fits")
    assert askap.beam.major.to_value(u.arcsec) == pytest.approx(28.6)
    assert read_plane(quirks / "sampling_mean.fits").unit == u.Jy / u.pix
    with pytest.raises(ValueError, match=r"sampling_mean.fits: no date of observation"):
        EpochCube.read(quirks / "sampling_mean.fits")
    assert read_plane(quirks / "map_stacked.fits").facts["object"] == "J0738+17"
