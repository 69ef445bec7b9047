# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images of other packages that have an HDU, as those of spectral-cube do."""

from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits

from astro_scc.epochs import EpochCube


def image_of(data, **header):
    hdu = fits.ImageHDU(data, fits.Header(header))
    return SimpleNamespace(hdu=hdu, meta={})


SKY = {
    "CTYPE1": "RA---SIN", "CTYPE2": "DEC--SIN", "CUNIT1": "deg", "CUNIT2": "deg",
    "CDELT1": -1e-8, "CDELT2": 1e-8, "CRPIX1": 4.0, "CRPIX2": 4.0, "BUNIT": "Jy/beam",
    "DATE-OBS": "2001-01-01",
}  # fmt: skip


def test_an_image_with_an_hdu():
    cube = EpochCube.from_ccddata([image_of(np.ones((8, 9)), **SKY)])
    assert cube.shape == (1, 8, 9)


@pytest.mark.parametrize(
    "image", [image_of(np.ones((3, 8, 9)), **SKY), image_of(np.ones((8, 9)))]
)
def test_what_is_no_image_is_named(image):
    with pytest.raises(ValueError, match=r"image 0: .*(plane|celestial)"):
        EpochCube.from_ccddata([image])


@pytest.mark.parametrize(
    "other", [np.ones((8, 9)), SimpleNamespace(hdu=fits.BinTableHDU())]
)
def test_other_kinds_are_refused(other):
    with pytest.raises(TypeError, match="give NDData, such as CCDData"):
        EpochCube.from_ccddata([other])
