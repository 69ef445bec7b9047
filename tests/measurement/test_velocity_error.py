# Licensed under a 3-clause BSD style license - see LICENSE.rst
import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.exceptions import MeasurementWarning
from astro_scc.measurement import VelocityError
from astro_scc.measurement.velocity_error import sampling_error
from astro_scc.simulation import simulate_static

DAYS, PIXEL = 30.0, 0.1


def shifted(step):
    """Five images of three features, each moved by a step (x, y) in pixels."""
    y, x = np.mgrid[:72, :90]
    places = [(20.2, 20.7, 1.0), (36.6, 48.1, 0.8), (52.9, 26.4, 0.6)]
    data = [
        sum(
            peak
            * np.exp(-((x - x0 - i * step[0]) ** 2 + (y - y0 - i * step[1]) ** 2) / 9)
            for y0, x0, peak in places
        )
        + np.random.default_rng(i).normal(scale=1e-3, size=x.shape)
        for i in range(5)
    ]
    times = Time(2451910.5 + DAYS * np.arange(5), format="jd", scale="tai")
    return EpochCube.from_arrays(np.array(data), times=times, pixel_scale=PIXEL * u.mas)


@settings(deadline=None, max_examples=8)
@given(step=st.tuples(st.floats(-2, 2), st.floats(-2, 2)))
def test_any_shift_comes_back_within_its_error(step):
    scc = StackedCrossCorrelation(scales=[1, 2], max_speed=6 * u.mas / u.yr)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeasurementWarning)
        row = scc(shifted(step), n_trials=2, rng=1).components[0]
    to_pixels = DAYS / 365.25 / PIXEL
    for name, true in (("pm_ra_cosdec", -step[0]), ("pm_dec", step[1])):
        found, error = (row[n].value * to_pixels for n in (name, f"{name}_err"))
        assert abs(found - true) < 2.5 * error
        assert error < 0.1


def test_the_parts_add_up():
    one = np.eye(2)
    error = VelocityError(one, 2 * one, 50 * one, 4 * one)
    np.testing.assert_array_equal(error.total, 7 * one)
    np.testing.assert_array_equal(VelocityError(one, one, one).total, 2 * one)


def test_sampling_error_falls_with_the_resolution_in_pixels():
    cube = simulate_static(n_epochs=2, rng=1).cube
    pixel = cube.pixel_scale.to_value(u.mas)
    assert sampling_error(cube, 5 * pixel) == pytest.approx(0.03 * pixel)
    assert sampling_error(cube, 10 * pixel) == pytest.approx(0.015 * pixel)
