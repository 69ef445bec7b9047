# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What must not change a velocity, or change it in a known way."""

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from astro_scc import EpochCube, StackedCrossCorrelation

# Every example is a measurement of its own.
few = settings(max_examples=2, phases=(Phase.explicit, Phase.generate))
SHAPE = (40, 48)
STEP = (1.6, -0.7)
TIMES = Time(2451910.5 + 30.0 * np.arange(6), format="jd", scale="tai")


def images(step=STEP, *, corner=(0, 0)):
    """A jet whose features all move by ``step`` (x, y) pixels an epoch, with noise."""
    # One field of noise an epoch, from which every window is cut.
    y, x = np.mgrid[-60:100, -60:110]
    found = []
    for i in range(6):
        data = np.random.default_rng(i).normal(0, 1e-3, x.shape)
        for north, west, peak, width in ((22, 14, 1, 1.8), (16, 26, 0.6, 1.6)):
            r2 = (x - west - step[0] * i) ** 2 + (y - north - step[1] * i) ** 2
            data += peak * np.exp(-r2 / 2 / width**2)
        top, left = corner[0] + 60, corner[1] + 60
        found.append(data[top : top + SHAPE[0], left : left + SHAPE[1]])
    return np.array(found)


def velocity(data, times=TIMES):
    """Of the strongest component: east, north and error, in mas/yr."""
    cube = EpochCube.from_arrays(data, times=times, pixel_scale=0.1 * u.mas)
    how = {"max_speed": 5 * u.mas / u.yr, "baseline": [0, 1] * u.yr}
    scc = StackedCrossCorrelation(scales=[1, 2], **how)
    row = scc(cube, n_trials=119, rng=1).components[0]
    assert row["n_features"] > 0
    unit = u.mas / u.yr
    error = np.hypot(row["pm_ra_cosdec_err"], row["pm_dec_err"]).to_value(unit)
    return np.array([row[k].to_value(unit) for k in ("pm_ra_cosdec", "pm_dec")]), error


@pytest.fixture(scope="module")
def usual():
    return velocity(images())


@few
@given(st.floats(-9, 9), st.floats(-1e3, 1e3), st.permutations(range(6)))
def test_intensities_are_scaled_and_offset_and_epochs_sorted(
    usual, exponent, offset, order
):
    data = (images() + offset) * 10**exponent
    found, _ = velocity(data[list(order)], TIMES[list(order)])
    assert found == pytest.approx(usual[0], abs=1e-3)


@pytest.mark.slow
@few
@given(st.integers(-6, 6), st.integers(-8, 8))
def test_a_common_shift_moves_nothing(usual, down, left):
    found, error = velocity(images(corner=(down, left)))
    assert np.hypot(*(found - usual[0])) < 3 * np.hypot(error, usual[1])


@pytest.mark.slow
@few
@given(st.integers(1, 3))
def test_turning_all_epochs_turns_velocities(usual, quarters):
    data = np.rot90(images(), quarters, axes=(1, 2))
    east, north = usual[0]
    for _ in range(quarters):
        # rot90 turns rows, which are counted upwards, clockwise.
        east, north = -north, east
    assert velocity(data)[0] == pytest.approx([east, north], abs=1e-3)


@pytest.mark.slow
@few
@given(st.tuples(*[st.integers(0, 9)] * 4), st.sampled_from([0.0, np.nan]))
def test_empty_margins_change_nothing(usual, widths, value):
    below, above, left, right = widths
    data = np.pad(
        images(), ((0, 0), (below, above), (left, right)), constant_values=value
    )
    found, error = velocity(data)
    assert np.hypot(*(found - usual[0])) < 3 * np.hypot(error, usual[1])
