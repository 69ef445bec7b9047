# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocities of streams in the axes of the frame, and their errors."""

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.stacking.dispersion import Population
from astro_scc.stacking.errors import StreamVelocity, velocity_of
from astro_scc.stacking.features import Feature
from astro_scc.stacking.significance import Stream

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


@pytest.mark.parametrize(("size", "angle"), [(2.0, 0.3), (2.5, 2.0), (4.0, 4.0)])
def test_any_shift_comes_back_within_its_error(size, angle):
    step = size * np.cos(angle), size * np.sin(angle)
    scc = StackedCrossCorrelation(scales=[1, 2], max_speed=6 * u.mas / u.yr)
    row = scc(shifted(step), n_trials=99, rng=1).components[0]
    assert row["kind"] == "moving"
    assert row["n_features"] == 3
    to_pixels = DAYS / 365.25 / PIXEL
    for name, true in (("pm_ra_cosdec", -step[0]), ("pm_dec", step[1])):
        found, error = (row[n].value * to_pixels for n in (name, f"{name}_err"))
        assert abs(found - true) < 2.5 * error + 0.005
        assert error < 0.08 * size


def test_the_parts_add_up():
    one = np.eye(2)
    velocity = StreamVelocity(np.zeros(2), one, 3 * one, 0.1, 0.01)
    np.testing.assert_array_equal(velocity.covariance, 4 * one)


YEARS = np.array([0.0, 1.0, 2.0])


def feature(ssp, speed, error):
    """SSPs of the three epochs on a line."""
    return Feature(
        ssp=np.array(ssp), speed=speed, error=error, across=0.0, across_error=error,
        place=0.0, motion=2 * speed, response=np.array([-0.5, 0.0, 0.5]),
    )  # fmt: skip


def stream_of(*features, angle=np.pi / 6, dispersion=0.0):
    return Stream(
        kind="moving", reason="", angle=angle,
        along=Population(2.0, 0.1, dispersion, 0.04),
        across=Population(0.5, 0.2, 0.0, 0.0), features=features,
    )  # fmt: skip


def test_a_velocity_on_the_axes_of_the_frame_by_hand():
    """2 beams of 0.5 mas along 30 deg and 0.5 of 0.25 mas across it."""
    found = velocity_of(stream_of(), [0.5, 0.25], np.zeros((3, 2)), np.arange(3))
    cos, sin = np.sqrt(0.75), 0.5
    np.testing.assert_allclose(
        found.value, [cos * 1.0 - sin * 0.125, sin * 1.0 + cos * 0.125]
    )
    # Errors of 0.05 mas/yr on both of its axes: a circle is one on any axes.
    np.testing.assert_allclose(found.features, 0.05**2 * np.eye(2), atol=1e-15)
    np.testing.assert_array_equal(found.alignment, np.zeros((2, 2)))
    assert found.dispersion == 0.0
    assert found.dispersion_error == pytest.approx(0.04 * 0.5)


@given(
    st.floats(-np.pi / 2, np.pi / 2), st.floats(0.1, 3), st.floats(0.1, 3),
)  # fmt: skip
def test_its_covariance_turns_with_it(angle, major, minor):
    stream = stream_of(angle=angle)
    found = velocity_of(stream, [major, minor], np.zeros((3, 2)), np.arange(3))
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-np.sin(angle), np.cos(angle)])
    assert along @ found.features @ along == pytest.approx((0.1 * major) ** 2)
    assert across @ found.features @ across == pytest.approx((0.2 * minor) ** 2)
    assert along @ found.features @ across == pytest.approx(0, abs=1e-9)
    assert along @ found.value == pytest.approx(2.0 * major)
    assert across @ found.value == pytest.approx(0.5 * minor)


def test_epochs_that_are_misaligned_move_all_features_together():
    """A slope over 0, 1 and 2 yr is half the last position less the first."""
    epoch = np.array([0, 1, 2, 0, 1, 2])
    misaligned = np.array([[0.1, 0.2], [5.0, 5.0], [0.3, 0.2]])
    expected = np.diag([0.25 * (0.1**2 + 0.3**2), 0.25 * (0.2**2 + 0.2**2)])
    one = stream_of(feature([0, 1, 2], 2.0, 0.1))
    two = stream_of(feature([0, 1, 2], 2.0, 0.1), feature([3, 4, 5], 2.1, 0.4))
    for stream in (one, two):
        found = velocity_of(stream, [0.5, 0.25], misaligned, epoch)
        # Averages over features do not make it smaller.
        np.testing.assert_allclose(found.alignment, expected)
        np.testing.assert_allclose(found.covariance, found.features + expected)


def test_a_stream_without_features_has_a_speed_and_no_error():
    unknown = Population(0.0, *[np.nan] * 3)
    stream = Stream("not significant", "", 0.0, Population(1.0, *[np.nan] * 3), unknown)
    found = velocity_of(stream, [0.5, 0.5], np.ones((3, 2)), np.arange(3))
    np.testing.assert_array_equal(found.value, [0.5, 0.0])
    assert np.isnan(found.covariance).all()
    assert np.isnan(found.dispersion)
