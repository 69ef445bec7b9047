# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What counts as found, case by case on results made by hand."""

from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

from astro_scc.kinematics import PositionAngleFrame, RadialFrame, SkyFrame
from astro_scc.recovery.injection import (
    FeaturePaths,
    moving_components,
    recovered,
    velocity_along,
)

#: One feature that stays at (50, 20) in both epochs.
PATHS = FeaturePaths(
    np.full((1, 2), 50.0), np.full((1, 2), 20.0), np.ones((1, 2), bool)
)
RULE = {"tolerance": 1.0, "level": 0.05, "paths": PATHS, "fwhm": 1.0}


def result(*components):
    """Of components (kind, p, v1, v2, share of ten SSPs that lie on the feature)."""
    kinds, p, v1, v2, shares = zip(*components, strict=True) if components else [()] * 5
    n = len(kinds)
    x = [50.0 + 4 if k < round(10 * s) else 50.0 + 6 for s in shares for k in range(10)]
    return SimpleNamespace(
        components=QTable(
            {
                "component": np.arange(1, n + 1),
                "kind": np.array(kinds, dtype="U15"),
                "p_global": np.array(p, dtype=float),
            }
        ),
        velocities=[
            SimpleNamespace(value=np.array(v)) for v in zip(v1, v2, strict=True)
        ],
        members=lambda number: {"ssp": np.arange(10 * (number - 1), 10 * number)},
        matched=SimpleNamespace(
            ssps=SimpleNamespace(
                x=np.array(x), y=np.full(10 * n, 20.0), epoch=np.arange(10 * n) % 2
            )
        ),
        cube=SimpleNamespace(pixel_matrix=np.diag([-0.1, 0.1]) * u.mas),
    )


def test_a_moving_component_of_the_features_is_found():
    assert recovered(result(("moving", 0.01, 5.2, 0.3, 0.9)), [], (5, 0), **RULE) == 1


@pytest.mark.parametrize(
    "component",
    [
        ("not significant", 0.2, 5.0, 0.0, 1.0),
        ("stationary", 0.01, 5.0, 0.0, 1.0),
        ("moving", 0.06, 5.0, 0.0, 1.0),
        ("moving", 0.01, 5.8, 0.7, 1.0),
        ("moving", 0.01, 5.0, 0.0, 0.5),
    ],
)
def test_anything_else_is_not(component):
    assert recovered(result(component), [], (5, 0), **RULE) is None


def test_nothing_is_found_where_nothing_is():
    assert moving_components(result(), 0.05) == []
    assert recovered(result(), [(5, 0)], (5, 0), **RULE) is None


def test_what_the_epochs_have_already_is_not_found():
    blend = result(("moving", 0.01, 5.0, 0.0, 1.0))
    assert recovered(blend, [(4.5, 0.0)], (5, 0), **RULE) is None
    # Of two, the one that is left.
    both = result(("moving", 0.01, 4.6, 0.0, 1.0), ("moving", 0.01, 5.4, 0.0, 1.0))
    assert recovered(both, [(4.5, 0.0)], (5, 0), **RULE) == 2
    # Another component takes nothing from it, and one takes one only.
    assert recovered(both, [(9.0, 0.0)], (5, 0), **RULE) in (1, 2)
    assert recovered(both, [(4.5, 0.0), (5.5, 0.0)], (5, 0), **RULE) is None


def test_the_nearest_of_the_features_counts():
    three = result(
        ("moving", 0.01, 5.1, 0.0, 0.2),
        ("moving", 0.01, 5.6, 0.0, 0.9),
        ("moving", 0.01, 4.7, 0.0, 0.9),
    )
    assert recovered(three, [], (5, 0), **RULE) == 3


def test_a_component_without_ssps_is_not_of_the_features():
    bare = result(("moving", 0.01, 5.0, 0.0, 1.0))
    bare.members = lambda number: {"ssp": np.empty(0, dtype=int)}
    assert recovered(bare, [], (5, 0), **RULE) is None


def test_the_direction_on_the_axes_of_frames():
    angle = 30 * u.deg
    np.testing.assert_allclose(velocity_along(SkyFrame(), angle), [0.5, 0.75**0.5])
    along = velocity_along(PositionAngleFrame(30 * u.deg), angle)
    np.testing.assert_allclose(along, [1, 0], atol=1e-12)
    np.testing.assert_array_equal(velocity_along(RadialFrame(), "radial"), [1, 0])
