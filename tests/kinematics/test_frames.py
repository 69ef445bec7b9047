# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Axes of frames, against their definitions."""

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.kinematics import (
    ExpansionFrame,
    PositionAngleFrame,
    RadialFrame,
    SkyFrame,
)

angles = st.floats(-400, 400)
offsets = st.floats(-50, 50)


def test_sky():
    frame = SkyFrame()
    assert frame.axis_names == ("east", "north")
    np.testing.assert_array_equal(frame.matrix(), np.eye(2))
    assert frame.matrix(np.zeros((3, 4)), 0.0).shape == (3, 4, 2, 2)


@given(pa=angles, length=st.floats(0.1, 10))
def test_parallel_is_along_the_position_angle(pa, length):
    frame = PositionAngleFrame(pa * u.deg)
    east = length * np.sin(np.radians(pa))
    north = length * np.cos(np.radians(pa))
    np.testing.assert_allclose(frame.matrix() @ [east, north], [length, 0], atol=1e-9)


@given(x=offsets, y=offsets, x0=offsets, y0=offsets)
def test_radial_is_away_from_the_origin(x, y, x0, y0):
    frame = RadialFrame([x0, y0] * u.mas)
    matrix = frame.matrix(x, y)
    distance = np.hypot(x - x0, y - y0)
    if distance == 0:
        assert np.all(np.isnan(matrix))
        return
    np.testing.assert_allclose(
        matrix @ [x - x0, y - y0], [distance, 0], atol=1e-9 * max(distance, 1)
    )
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(2), atol=1e-9)
    angle = np.arctan2(x - x0, y - y0) * u.rad
    np.testing.assert_allclose(matrix, PositionAngleFrame(angle).matrix(), atol=1e-9)


def test_radial_frames_compare():
    assert RadialFrame() == RadialFrame([0, 0] * u.arcsec)
    assert RadialFrame() != RadialFrame([1, 0] * u.mas)
    assert RadialFrame() != SkyFrame()


@pytest.mark.parametrize(
    ("pa", "message"),
    [
        ([1, 2] * u.deg, "pa = .* must be an angle with a unit, such as '65 deg'"),
        (np.nan * u.deg, "pa = nan deg must be finite"),
        ("65", "pa = '65' has no unit at its end; it must be an angle"),
        ("1 12 deg", "pa = '1 12 deg' must be an angle with a unit"),
    ],
)
def test_bad_position_angle(pa, message):
    with pytest.raises(ValueError, match=message):
        PositionAngleFrame(pa)


@pytest.mark.parametrize("origin", [1 * u.mas, [1, np.nan] * u.mas, [1, 2, 3] * u.mas])
def test_bad_origin(origin):
    with pytest.raises(ValueError, match=r"origin = .* must be \(east, north\)"):
        RadialFrame(origin)


def test_wrong_units():
    with pytest.raises(u.UnitConversionError):
        PositionAngleFrame(1 * u.Jy)
    with pytest.raises(u.UnitConversionError, match="pa = 65 must be an angle with a"):
        PositionAngleFrame(65)
    with pytest.raises(u.UnitConversionError):
        RadialFrame([1, 2] * u.Jy)


CENTRE = [3.0, -2.0] * u.arcsec
RADIUS = 20 * u.arcsec


@given(angle=st.floats(0, 6.28), r=st.floats(5e3, 5e4), rate=st.floats(-0.1, 0.1))
def test_one_rate_is_one_velocity(angle, r, rate):
    place = r * np.array([np.sin(angle), np.cos(angle)])
    frame = ExpansionFrame(CENTRE, RADIUS)
    position = place + CENTRE.to_value(u.mas)
    # The motion that is midway at the place is in proportion to it.
    motion = rate * place
    start = position - 0.5 * motion
    moved = frame.displacement(start[None], motion[None])
    np.testing.assert_allclose(moved, [[rate * 2e4, 0]], atol=1e-6)
    matrix = frame.matrix(*position)
    np.testing.assert_allclose(
        matrix * r / 2e4, RadialFrame(CENTRE).matrix(*position), atol=1e-12
    )


def test_rate_and_axes():
    frame = ExpansionFrame(CENTRE, RADIUS)
    assert frame.rate(0.02 * u.arcsec / u.yr).to_value(
        u.percent / u.yr
    ) == pytest.approx(0.1)
    assert frame.axis_names == ("expansion", "rotation")
    assert frame.uniform is False


@pytest.mark.parametrize(
    ("centre", "radius", "message"),
    [
        ([1.0] * u.mas, RADIUS, "two finite angles"),
        (CENTRE, -1 * u.mas, "radius = .* must be finite and above 0"),
        (CENTRE, [1, 2] * u.mas, "radius = .* must be an angle with a unit"),
        (CENTRE, 0 * u.mas, "radius = .* must be finite and above 0"),
        (CENTRE, np.inf * u.mas, "radius = .* must be finite and above 0"),
        (CENTRE, np.nan * u.mas, "radius = .* must be finite and above 0"),
    ],
)
def test_no_frame(centre, radius, message):
    with pytest.raises(ValueError, match=message):
        ExpansionFrame(centre, radius)
