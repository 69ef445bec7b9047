# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Headers as archives have them, made from what is public about them."""

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.time import Time

from astro_scc.epochs import Beam
from astro_scc.images.fits import read_plane

SHAPE = (24, 36)
PIXELS = np.random.default_rng(1).normal(size=SHAPE)
ARCSEC = 1 / 3600


def sky(projection="TAN", scale=0.05, **changes):
    return {
        "CTYPE1": f"RA---{projection}", "CTYPE2": f"DEC--{projection}",
        "CRVAL1": 83.0, "CRVAL2": 22.0, "CRPIX1": 18.0, "CRPIX2": 12.0,
        "CDELT1": -scale * ARCSEC, "CDELT2": scale * ARCSEC, **changes,
    }  # fmt: skip


def cd():
    own = sky()
    steps = own.pop("CDELT1"), own.pop("CDELT2")
    return own | {"CD1_1": steps[0], "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": steps[1]}


def sun(scale, **changes):
    own = {"CTYPE1": "HPLN-TAN", "CTYPE2": "HPLT-TAN", "CUNIT1": "arcsec",
           "CUNIT2": "arcsec", "CDELT1": scale, "CDELT2": scale, "CRVAL1": 0.0,
           "CRVAL2": 0.0}  # fmt: skip
    return sky() | own | changes


def image(cards, pixels=PIXELS, name=None):
    """An HDU; cards that are text stand as they are."""
    made = fits.ImageHDU(pixels) if name else fits.PrimaryHDU(pixels)
    for key, value in cards.items():
        if key in ("HISTORY", "COMMENT"):
            for line in value:
                made.header[key] = line
        else:
            made.header[key] = value
    if name:
        made.name = name
    return made


STOKES = {"CTYPE4": "STOKES", "CRVAL4": 1.0, "CDELT4": 1.0, "CRPIX4": 1.0}
FOUR = PIXELS[None, None]
BEAM = Beam(5 * u.arcsec, 4 * u.arcsec, 30 * u.deg)
AIPS = ["AIPS   IMNAME='3C273' IMCLASS='ICLN'",
        "AIPS   CLEAN BMAJ=  1.3889E-03 BMIN=  1.1111E-03 BPA=  30.00"]  # fmt: skip
SCI = PIXELS.astype("f4")
WEIGHT = np.where(PIXELS > 2, 0, 1).astype("f4")
FLAGS = np.where(PIXELS > 2, 4096, 0).astype("i2")
#: HDUs; and the date, unit, beam, filter, wavelength and bad pixels.
HEADERS = {
    "THINGS": (
        [image({"OBJECT": "NGC628", "TELESCOP": "VLA", "DATE-OBS": "1997-01-24",
                "BUNIT": "JY/B*M/S", "EPOCH": 2000.0, **sky("SIN", 1.5),
                "CTYPE3": "VELOCITY", "CRVAL3": 7e5, "CDELT3": 2.6e3, "CRPIX3": 1.0,
                **STOKES, "HISTORY": AIPS}, FOUR)],
        ("1997-01-24T00:00:00", u.one, BEAM, None, None, 0)),
    "HST flt": (
        [image({"TELESCOP": "HST", "INSTRUME": "WFC3", "TARGNAME": "HH1",
                "FILTER": "F164N", "DATE-OBS": "2016-04-05", "TIME-OBS": "06:07:08",
                "EXPSTART": 57483.25495370, "EXPEND": 57483.26189815,
                "EXPTIME": 600.0}, None),
         image({"BUNIT": "ELECTRONS/S", **cd()}, SCI, "SCI"),
         image({"BUNIT": "ELECTRONS/S"}, SCI * 0 + 0.1, "ERR"),
         image({}, FLAGS, "DQ"), image({}, FLAGS * 0 + 9, "SAMP"),
         image({}, SCI * 0 + 600, "TIME")],
        ("2016-04-05T06:12:08", u.electron / u.s, None, "F164N", None, 22)),
    "JWST i2d": (
        [image({"TELESCOP": "JWST", "INSTRUME": "NIRCAM", "TARGNAME": "HH 211",
                "FILTER": "F444W", "PUPIL": "F470N", "DATE-OBS": "2022-08-28",
                "TIME-OBS": "17:02:17.123", "DATE-BEG": "2022-08-28T17:02:17.123",
                "TIMESYS": "UTC", "EFFEXPTM": 600.0}, None),
         image({"BUNIT": "MJy/sr", "MJD-BEG": 59819.71, "MJD-AVG": 59819.713667,
                **sky(scale=0.063, PC1_1=1.0, PC2_2=1.0)}, SCI, "SCI"),
         image({"BUNIT": "MJy/sr"}, SCI * 0 + 0.1, "ERR"), image({}, FLAGS, "CON"),
         image({}, WEIGHT, "WHT"), image({}, WEIGHT, "VAR_POISSON"),
         image({}, WEIGHT, "VAR_RNOISE"), image({}, WEIGHT, "VAR_FLAT")],
        ("2022-08-28T17:07:40.829", u.MJy / u.sr, None, "F444W + F470N", None, 22)),
    "AIA": (
        [image({}, None),
         image({"TELESCOP": "SDO/AIA", "INSTRUME": "AIA_3", "WAVELNTH": 171,
                "WAVEUNIT": "angstrom", "DATE-OBS": "2011-06-07T06:33:00.34",
                "T_OBS": "2011-06-07T06:33:01.34Z", "EXPTIME": 1.999,
                "T_REC": "2011-06-07T06:33:02Z", **sun(0.6)}, None, "COMPRESSED")],
        ("2011-06-07T06:33:01.34", u.one, None, None, "171 angstrom", 0)),
    "HMI": (
        [image({"TELESCOP": "SDO/HMI", "DATE-OBS": "2014-01-01T00:00:07.30", "CONTENT":
                "MAGNETOGRAM", "T_OBS": "2014.01.01_00:00:42.50_TAI", "BUNIT": "Gauss",
                "T_REC": "2014.01.01_00:00:45_TAI", "WAVELNTH": 6173.0,
                **sun(0.504, CROTA2=0.0)})],
        ("2014-01-01T00:00:07.5", u.Gauss, None, None, "6173", 0)),
}  # fmt: skip
HEADERS["AIA"][0][1].data = PIXELS.astype("f4")


@pytest.mark.parametrize("name", HEADERS)
def test_headers_of_archives(tmp_path, name):
    hdus, expected = HEADERS[name]
    path = tmp_path / "a.fits"
    fits.HDUList(hdus).writeto(path, output_verify="ignore")
    plane = read_plane(path)
    date, unit, beam, *facts, bad = expected
    assert abs((plane.time - Time(date)).to_value(u.s)) < 2e-3
    assert (plane.unit, plane.beam is None) == (unit, beam is None)
    if beam is not None:
        assert u.isclose(plane.beam.major, beam.major, rtol=1e-4)
        assert u.isclose(plane.beam.minor, beam.minor, rtol=1e-4)
    assert [plane.facts.get(k) for k in ("filter", "wavelength")] == facts
    assert plane.mask.sum() == bad
    assert np.allclose(plane.data, PIXELS, atol=1e-6)
    assert ("unit" in "".join(plane.notes)) == (name == "THINGS")
