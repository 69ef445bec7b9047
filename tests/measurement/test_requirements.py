# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What a measurement refuses before it begins."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

from astro_scc import StackedCrossCorrelation
from astro_scc.measurement.axes import alignment_errors
from astro_scc.simulation import simulate_two_fluid


@pytest.mark.parametrize(
    ("setting", "value", "message"),
    [
        ("outward", "perhaps", "outward = 'perhaps' must be true or false"),
        ("outward", 2, "outward = 2 must be true or false"),
        ("alignment_error", -1 * u.mas, "must be 0 or above"),
        ("alignment_error", [1, np.nan] * u.mas, "must be an angle or a list of them"),
        ("alignment_error", np.inf * u.mas, "must be an angle or a list of them"),
        ("alignment_error", np.ones((2, 2)) * u.mas, "must be an angle or a list"),
    ],
)
def test_settings_out_of_range(setting, value, message):
    with pytest.raises(ValueError, match=message):
        StackedCrossCorrelation(**{setting: value})


def test_units_of_settings():
    with pytest.raises(
        u.UnitConversionError, match="alignment_error = 1.0 s must be an angle or"
    ):
        StackedCrossCorrelation(alignment_error=1 * u.s)


def test_alignment_errors_of_epochs():
    cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    np.testing.assert_array_equal(alignment_errors(cube), np.zeros((3, 2)))
    one = alignment_errors(cube, 0.2e-3 * u.arcsec)
    np.testing.assert_allclose(one, np.full((3, 2), 0.2))
    each = alignment_errors(cube, [0.1, 0.0, 0.3] * u.mas)
    np.testing.assert_allclose(each, [[0.1, 0.1], [0, 0], [0.3, 0.3]])
    with pytest.raises(ValueError, match="must be one angle or 3, one an epoch, got 2"):
        alignment_errors(cube, [0.1, 0.2] * u.mas)
    for wrong in (-0.1, np.nan, np.inf):
        with pytest.raises(ValueError, match="alignment_error = .* must be"):
            StackedCrossCorrelation(alignment_error=wrong * u.mas)


def test_the_error_that_the_alignment_found_counts():
    cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    dates = [time.isot[:10] for time in cube.times]
    columns = {"east": [0, 0, 0], "north": [0, 0, 0]}
    columns |= {"east_err": [3, 1, 0], "north_err": [4, 1, 0]}
    table = QTable({"epoch": dates, **{k: v * u.uas for k, v in columns.items()}})
    aligned = cube.align("table", table=table)
    found = alignment_errors(aligned)
    np.testing.assert_allclose(found[:, 0], [np.sqrt(12.5e-6), 1e-3, 0], atol=1e-9)
    np.testing.assert_array_equal(alignment_errors(aligned[1:]), found[1:])
