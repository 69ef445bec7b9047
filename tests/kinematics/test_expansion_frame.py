# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.kinematics import ExpansionFrame, RadialFrame

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


def test_nothing_near_the_centre():
    frame = ExpansionFrame(CENTRE, RADIUS)
    assert np.isnan(frame.matrix(3e3, -2e3 + 3.9e3)).all()
    assert np.isfinite(frame.matrix(3e3, -2e3 + 4.1e3)).all()
    # But what leads across it has a displacement, far from any expansion.
    across = frame.displacement([[3e3, 3e3]], [[0.0, -10e3]])
    assert np.isfinite(across).all()


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
