# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Errors of the alignment of the epochs."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time

from astro_scc import EpochCube
from astro_scc.plan import alignment_errors


def cube_of():
    """Three epochs without anything in them, with the core in the middle."""
    data, times = np.zeros((3, 81, 81)), Time("2010-01-01") + [0, 73, 292] * u.day
    return EpochCube.from_arrays(data, times, pixel_scale=0.1 * u.mas)


def test_errors_of_the_alignment_are_given_or_those_that_it_found():
    cube = cube_of()
    np.testing.assert_array_equal(alignment_errors(cube), np.zeros((3, 2)))
    one = alignment_errors(cube, 0.2e-3 * u.arcsec)
    np.testing.assert_allclose(one, np.full((3, 2), 0.2))
    each = alignment_errors(cube, [0.1, 0.0, 0.3] * u.mas)
    np.testing.assert_allclose(each, [[0.1, 0.1], [0, 0], [0.3, 0.3]])
    with pytest.raises(ValueError, match="must be 1 or 3 angles, got 2"):
        alignment_errors(cube, [0.1, 0.2] * u.mas)
    columns = {"east": [0, 0, 0], "north": [0, 0, 0]}
    columns |= {"east_err": [3, 1, 0], "north_err": [4, 1, 0]}
    table = QTable({name: values * u.uas for name, values in columns.items()})
    table["epoch"] = [time.isot[:10] for time in cube.times]
    aligned = cube.align("table", table=table)
    found = alignment_errors(aligned)
    np.testing.assert_allclose(found[:, 0], [np.sqrt(12.5e-6), 1e-3, 0], atol=1e-9)
    np.testing.assert_array_equal(alignment_errors(aligned[1:]), found[1:])
