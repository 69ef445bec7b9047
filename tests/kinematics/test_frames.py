# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Axes of frames, against their definitions."""

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from astro_scc.kinematics import (
    ExpansionFrame,
    PositionAngleFrame,
    RadialFrame,
    SkyFrame,
)

OFFSET = st.floats(-50, 50)
CENTRE, RADIUS = [3.0, -2.0] * u.arcsec, 20 * u.arcsec


def test_sky_and_what_frames_are_called():
    assert_array_equal(SkyFrame().matrix(), np.eye(2))
    assert SkyFrame().matrix(np.zeros((3, 4)), 0.0).shape == (3, 4, 2, 2)
    frame = ExpansionFrame(CENTRE, RADIUS)
    assert (frame.axis_names, frame.uniform) == (("expansion", "rotation"), False)
    rate = frame.rate(0.02 * u.arcsec / u.yr)
    assert rate.to_value(u.percent / u.yr) == pytest.approx(0.1)
    assert RadialFrame() == RadialFrame([0, 0] * u.arcsec)
    assert RadialFrame() != RadialFrame([1, 0] * u.mas)
    assert RadialFrame() != SkyFrame()


@settings(max_examples=40)
@given(pa=st.floats(-400, 400), length=st.floats(0.1, 10))
def test_parallel_is_along_the_position_angle(pa, length):
    frame, angle = PositionAngleFrame(pa * u.deg), np.radians(pa)
    along = length * np.array([np.sin(angle), np.cos(angle)])
    assert_allclose(frame.matrix() @ along, [length, 0], atol=1e-9)


@settings(max_examples=40)
@given(x=OFFSET, y=OFFSET, x0=OFFSET, y0=OFFSET)
def test_radial_is_away_from_the_origin(x, y, x0, y0):
    matrix = RadialFrame([x0, y0] * u.mas).matrix(x, y)
    away = np.array([x - x0, y - y0])
    distance = np.hypot(*away)
    if distance == 0:
        assert np.all(np.isnan(matrix))
        return
    assert_allclose(matrix @ away, [distance, 0], atol=1e-9 * max(distance, 1))
    angle = np.arctan2(*away) * u.rad
    assert_allclose(matrix, PositionAngleFrame(angle).matrix(), atol=1e-9)


@settings(max_examples=40)
@given(angle=st.floats(0, 6.28), r=st.floats(5e3, 5e4), rate=st.floats(-0.1, 0.1))
def test_one_rate_is_one_velocity(angle, r, rate):
    place = r * np.array([np.sin(angle), np.cos(angle)])
    frame = ExpansionFrame(CENTRE, RADIUS)
    position = place + CENTRE.to_value(u.mas)
    # The motion that is midway at the place is in proportion to it.
    motion = rate * place
    moved = frame.displacement((position - 0.5 * motion)[None], motion[None])
    assert_allclose(moved, [[rate * 2e4, 0]], atol=1e-6)
    matrix = frame.matrix(*position) * r / 2e4
    assert_allclose(matrix, RadialFrame(CENTRE).matrix(*position), atol=1e-12)


@pytest.mark.parametrize(
    ("frame", "values", "message"),
    [
        (PositionAngleFrame, [[1, 2] * u.deg], "pa = .* an angle with a unit, such as"),
        (PositionAngleFrame, [np.nan * u.deg], "pa = nan deg must be finite"),
        (PositionAngleFrame, ["65"], "pa = '65' has no unit at its end; it must be an"),
        (PositionAngleFrame, ["1 12 deg"], "pa = '1 12 deg' must be an angle with"),
        (PositionAngleFrame, [1 * u.Jy], "pa = 1.0 Jy must be an angle"),
        (PositionAngleFrame, [65], "pa = 65 must be an angle with a"),
        *((RadialFrame, [origin], r"origin = .* must be \(east, north\)")
          for origin in (1 * u.mas, [1, np.nan] * u.mas, [1, 2, 3] * u.mas,
                         [1, 2] * u.Jy)),
        (ExpansionFrame, [[1.0] * u.mas, RADIUS], "two finite angles"),
        (ExpansionFrame, [CENTRE, [1, 2] * u.mas], "radius = .* must be an angle with"),
        *((ExpansionFrame, [CENTRE, r * u.mas], "radius = .* must be finite and above")
          for r in (-1, 0, np.inf, np.nan)),
    ],
)  # fmt: skip
def test_no_frame(frame, values, message):
    with pytest.raises(ValueError, match=message):
        frame(*values)
