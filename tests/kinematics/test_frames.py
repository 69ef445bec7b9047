# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.kinematics import PositionAngleFrame, RadialFrame, SkyFrame

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


@given(pa=angles)
def test_transverse_is_towards_larger_position_angles(pa):
    frame = PositionAngleFrame(pa * u.deg)
    step = np.radians([pa, pa + 0.01])
    d_east, d_north = np.diff(np.sin(step))[0], np.diff(np.cos(step))[0]
    parallel, transverse = frame.matrix() @ [d_east, d_north]
    assert transverse > 0
    assert abs(parallel) < 1e-3 * transverse


def test_signs_by_hand():
    # Position angle 0: parallel north, transverse east.
    matrix = PositionAngleFrame(0 * u.deg).matrix()
    np.testing.assert_allclose(matrix, [[0, 1], [1, 0]], atol=1e-15)
    assert PositionAngleFrame(0 * u.deg).axis_names == ("parallel", "transverse")


@given(pa=angles)
def test_the_transpose_leads_back_to_the_sky(pa):
    matrix = PositionAngleFrame(pa * u.deg).matrix()
    np.testing.assert_allclose(matrix.T @ matrix, np.eye(2), atol=1e-12)


def test_any_unit_of_angle():
    one = PositionAngleFrame(65 * u.deg)
    two = PositionAngleFrame(np.radians(65) * u.rad)
    np.testing.assert_allclose(one.matrix(), two.matrix())
    assert two.pa.unit == u.deg


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


def test_radial_of_many_positions():
    frame = RadialFrame([1, 0] * u.mas)
    assert RadialFrame([1e-3, 0] * u.arcsec).origin.unit == u.mas
    matrix = frame.matrix(np.array([2.0, 1.0, 1.0]), np.array([0.0, 3.0, 0.0]))
    assert matrix.shape == (3, 2, 2)
    # East of the origin: transverse is south.
    np.testing.assert_allclose(matrix[0], [[1, 0], [0, -1]], atol=1e-15)
    np.testing.assert_allclose(matrix[1], [[0, 1], [1, 0]], atol=1e-15)
    assert np.all(np.isnan(matrix[2]))
    assert frame.axis_names == ("radial", "transverse")


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


def test_a_position_angle_as_text():
    assert PositionAngleFrame("-112deg") == PositionAngleFrame(-112 * u.deg)


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
