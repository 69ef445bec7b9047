# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Where patterns are on the sky, how well that is known, and names of columns."""

from types import SimpleNamespace

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.wcs import WCS
from numpy.testing import assert_allclose

from astro_scc.decomposition.wavelet import scale_size
from astro_scc.epochs import Beam, EpochCube
from astro_scc.images.positions import (
    axis_words,
    beam_fwhm,
    name_by_frame,
    position_errors,
    sky_columns,
)


def make_cube(**fields):
    place = {"pixel_scale": 0.1 * u.mas, "reference_pixel": (2, 3)}
    return EpochCube.from_arrays(np.ones((1, 8, 8)), ["2000-01-01"], **place, **fields)


def in_frame(*ctype):
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ctype
    return SimpleNamespace(wcs=wcs)


def test_the_resolution_is_that_of_the_beam_or_of_the_scale():
    beam = Beam(1 * u.mas, 0.5 * u.mas)
    for axes, widths in ((np.eye(2), [0.5, 1]), (np.eye(2)[::-1], [1, 0.5])):
        assert_allclose(beam_fwhm(make_cube(beams=beam), [0], [1], axes), [widths])
    plain = beam_fwhm(make_cube(), [0, 0], [1, 2], np.eye(2))
    assert_allclose(plain[:, 0], [0.2 * scale_size(1), 0.2 * scale_size(2)])
    assert u.allclose(beam.fwhm_along([0, 90, 180] * u.deg), [1, 0.5, 1] * u.mas)
    errors = position_errors([0.1, 1, 1e9], np.full((3, 2), 2.0), 0.2)
    assert_allclose(errors[:, 0], [2 * np.sqrt(0.52)] * 2 + [0.2 * 2 / np.sqrt(2)])


def test_words_of_the_axes_and_columns_named_by_them():
    expected = {
        ("RA---SIN", "DEC--SIN"): ("east", "north", True),
        ("HPLN-TAN", "HPLT-TAN"): ("solar west", "solar north", False),
        ("GLON-CAR", "GLAT-CAR"): ("galactic east", "galactic north", True),
        ("XLON-CAR", "XLAT-CAR"): ("larger longitude", "larger latitude", True),
    }
    assert {ctype: axis_words(in_frame(*ctype)) for ctype in expected} == expected
    table = QTable({"pm_ra_cosdec": [1.0], "pm_dec_err": [0.1], "east": [2.0]})
    table["east"].info.description = "offset to the east"
    assert name_by_frame(table, in_frame("RA---SIN", "DEC--SIN")) is table
    assert sky_columns(table) == ("pm_ra_cosdec", "pm_dec")
    name_by_frame(table, in_frame("HPLN-TAN", "HPLT-TAN"))
    assert table.colnames == ["pm_lon_coslat", "pm_lat_err", "lon_offset"]
    assert table["lon_offset"].info.description == "offset to solar west"
    assert sky_columns(table) == ("pm_lon_coslat", "pm_lat")
