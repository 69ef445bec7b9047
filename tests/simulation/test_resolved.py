# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Simulated jets that are resolved across."""

import astropy.units as u
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from astro_scc.simulation import Layer, m87_layers, simulate_resolved_jet

ANGLE = 288 * u.deg
DISTANCE, SPEED = [0.5, 2.0, 6.0], [1.0, 8.0, 10.0]
TABLE = {
    "distance": DISTANCE * u.mas,
    "speed": SPEED * u.mas / u.yr,
    "half_width": [0.2, 0.4, 0.6] * u.mas,
    "brightness": [20, 10, 5] * u.mJy / u.beam,
}
BARE = {"core": 0.0, "flux_variation": 0.0, "noise": 0.0}


def layer(**changes):
    return Layer("layer", **TABLE | changes)


def along_and_across(truth):
    """Distances along and across the axis in mas."""
    east, north = truth["east"].to_value(u.mas), truth["north"].to_value(u.mas)
    sine, cosine = np.sin(ANGLE).value, np.cos(ANGLE).value
    return east * sine + north * cosine, east * cosine - north * sine


def lone_clump(**changes):
    """A jet whose one clump is visible at all epochs."""
    for seed in range(50):
        own = layer(n_clumps=1, life=0.6 * u.yr, **changes)
        settings = {"layers": [own], "n_epochs": 6, "interval": 10 * u.day, **BARE}
        jet = simulate_resolved_jet(**settings, rng=seed)
        if len(jet.truth) == 6 and jet.truth["visible"].all():
            return jet
    raise AssertionError("no seed has one clump")


def test_the_centroid_of_a_clump_moves_by_its_speed_at_each_distance():
    jet = lone_clump()
    r, across = along_and_across(jet.truth)
    years = (jet.cube.times - jet.cube.times[0]).to_value(u.yr)
    way = solve_ivp(lambda t, r: np.interp(r, DISTANCE, SPEED), years[[0, -1]], r[:1],
                    t_eval=years, rtol=1e-8)  # fmt: skip
    assert np.ptp(r) > 0.5
    assert_allclose(r, way.y[0], atol=1e-3)
    # It keeps its place in the jet, which widens.
    assert_allclose(across / np.interp(r, DISTANCE, [0.2, 0.4, 0.6]), across[0] / (
        np.interp(r[0], DISTANCE, [0.2, 0.4, 0.6])))  # fmt: skip
    y, x = np.indices(jet.cube.shape[1:])
    for image, row in zip(jet.cube.data, jet.truth, strict=True):
        assert np.sum(x * image) / image.sum() == pytest.approx(row["x"].value)
        assert np.sum(y * image) / image.sum() == pytest.approx(row["y"].value)


def test_layers_of_m87():
    slow, fast = m87_layers(length=20 * u.mas)
    assert_allclose(slow.speed.to_value(u.mas / u.yr) * 0.264, 0.3)
    at = np.interp([0.5, 2, 20], fast.distance.value, fast.speed.value) * 0.264
    assert_allclose(at, [0.3, 2.3, 2.7], rtol=0.01)
    assert slow.across == (-1, 1)
    with pytest.raises(ValueError, match="layers: give a sequence of Layer, at least"):
        simulate_resolved_jet(layers=[])
    with pytest.raises(ValueError, match=r"length must be above 0.5 mas, got 0.2 mas"):
        m87_layers(length=0.2 * u.mas)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scatter": -1}, "layer 'layer': scatter must be zero or positive, got -1"),
        ({"speed": [0, 1, 1] * u.mas / u.yr}, "speed must be positive, or zero every"),
        ({"speed": [1, 1] * u.mas / u.yr}, "half_width, brightness must have one len"),
        ({"distance": [1, 1, 2] * u.mas}, "distance must increase, got"),
        ({"size": (2, 1) * u.mas}, "size must be two limits, got"),
        ({"life": np.inf * u.yr}, "life must be positive, and finite for a layer that"),
    ],
)
def test_what_a_layer_refuses(changes, message):
    with pytest.raises(ValueError, match=message):
        layer(**changes)
