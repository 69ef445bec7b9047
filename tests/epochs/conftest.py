# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""FITS files as AIPS, difmap and others write them."""

import numpy as np
import pytest
from astropy.io import fits

MAS = 1 / 3.6e6

AIPS = {
    "OBJECT": "3C273",
    "TELESCOP": "VLBA",
    "DATE-OBS": "2006-03-09",
    "BUNIT": "JY/BEAM",
    "EPOCH": 2000.0,
    "CTYPE1": "RA---SIN",
    "CRVAL1": 187.25,
    "CRPIX1": 16.0,
    "CDELT1": -0.1 * MAS,
    "CROTA1": 0.0,
    "CTYPE2": "DEC--SIN",
    "CRVAL2": 2.05,
    "CRPIX2": 9.0,
    "CDELT2": 0.1 * MAS,
    "CROTA2": 0.0,
    "CTYPE3": "FREQ",
    "CRVAL3": 15.4e9,
    "CRPIX3": 1.0,
    "CDELT3": 64e6,
    "CTYPE4": "STOKES",
    "CRVAL4": 1.0,
    "CRPIX4": 1.0,
    "CDELT4": 1.0,
    "BMAJ": 1.0 * MAS,
    "BMIN": 0.5 * MAS,
    "BPA": -7.0,
}


@pytest.fixture
def aips_header():
    """Header of a VLBI image; None as a value removes a keyword."""

    def make(**changes):
        header = fits.Header(AIPS)
        for keyword, value in changes.items():
            keyword = keyword.replace("_", "-") if "DATE" in keyword else keyword
            if value is None:
                header.remove(keyword, ignore_missing=True)
            else:
                header[keyword] = value
        return header

    return make


@pytest.fixture
def make_fits(tmp_path, aips_header):
    """Write a VLBI image of 32 x 16 pixels, 4-D and big-endian, and give its path."""

    def make(name="a.fits", data=None, **changes):
        header = aips_header(**changes)
        if data is None:
            data = np.random.default_rng(1).normal(size=(1, 1, 16, 32))
        path = tmp_path / name
        data = np.asarray(data)
        kind = data.dtype.newbyteorder(">")
        fits.PrimaryHDU(data.astype(kind), header).writeto(path, overwrite=True)
        return path

    return make
