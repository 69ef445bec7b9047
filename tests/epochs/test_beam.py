# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest

from astro_scc.epochs import Beam


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ((np.nan, 1.0, 0.0), "finite axes and position angle"),
        ((1.0, np.inf, 0.0), "finite axes and position angle"),
        ((1.0, 1.0, np.nan), "finite axes and position angle"),
        ((1.0, 0.0, 0.0), "axes must be positive"),
        ((-1.0, -2.0, 0.0), "axes must be positive"),
        ((1.0, 2.0, 0.0), "larger than its major axis"),
    ],
)
def test_no_beam(axes, message):
    major, minor, pa = axes
    with pytest.raises(ValueError, match=message):
        Beam(major * u.mas, minor * u.mas, pa * u.deg)


def test_beams_compare_with_beams():
    beam = Beam(2 * u.mas, 1 * u.mas, 30 * u.deg)
    assert beam == Beam(2e-3 * u.arcsec, 1e-3 * u.arcsec, 210 * u.deg)
    assert beam != Beam(2 * u.mas, 1 * u.mas, 31 * u.deg)
    assert beam != "beam"
