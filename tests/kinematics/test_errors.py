# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Errors of what follows from speeds against small differences."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc.kinematics import (
    ExpansionFrame,
    PositionAngleFrame,
    RadialFrame,
    RidgeLine,
    SkyFrame,
    beta_intrinsic,
    intrinsic_table,
    lorentz_factor,
    two_sided_jet,
)

DAY = u.mas / u.day


def test_errors_of_a_two_sided_jet_are_those_of_small_changes():
    a, r, distance = 17.6, 9.0, 12.5 * u.kpc
    errors = 0.04, 0.03
    found = two_sided_jet(
        a * DAY, r * DAY, distance, errors=[e * DAY for e in errors], rng=1
    )
    for name in ("beta_cos", "angle", "beta"):
        changes = []
        for step in ((errors[0], 0), (0, errors[1])):
            up, down = (
                two_sided_jet(
                    (a + sign * step[0]) * DAY, (r + sign * step[1]) * DAY, distance
                )[name]
                for sign in (1, -1)
            )
            changes.append(0.5 * (u.Quantity(up[0]) - u.Quantity(down[0])).value)
            # Without errors of the motions there are none.
            assert u.Quantity(up[1]).value == pytest.approx(0, abs=1e-9)
        error = u.Quantity(found[name][1]).value
        assert error == pytest.approx(np.hypot(*changes), rel=0.03)
    assert found["angle"][1].unit == u.deg


def test_numbers_of_a_two_sided_jet():
    found = two_sided_jet(3 * DAY, 1 * DAY, 10 * u.kpc)
    assert found["beta_cos"][0] == pytest.approx(0.5)
    # beta sin = 2 D mu_a mu_r / (c (mu_a + mu_r)).
    sin = 1.5 * (DAY * 10 * u.kpc).to_value(u.rad * u.m / u.s) / 299792458
    assert found["beta"][0] == pytest.approx(np.hypot(0.5, sin))
    assert found["angle"][0].value == pytest.approx(np.degrees(np.arctan2(sin, 0.5)))
    at = two_sided_jet(3 * DAY, 1 * DAY, found["beta_max_distance"])
    assert at["beta"][0] == pytest.approx(1)
    same = two_sided_jet(2 * DAY, 2 * DAY)
    assert same["beta_cos"][0] == 0


def test_limits_are_the_central_68_per_cent():
    table = intrinsic_table([5.0, 9.0], [0.1, 0.3], n_trials=40000, rng=3)
    for row, (beta, error) in zip(table, [(5.0, 0.1), (9.0, 0.3)], strict=True):
        low, high = beta + np.array([-1, 1]) * 0.99446 * error
        assert row["gamma_min_low"].value == pytest.approx(np.hypot(1, low), rel=2e-3)
        assert row["gamma_min_high"].value == pytest.approx(np.hypot(1, high), rel=2e-3)
        assert row["angle_max_low"].to_value(u.deg) == pytest.approx(
            np.degrees(2 * np.arctan(1 / high)), rel=3e-3
        )
    assert table["beta_app_err"][1] == 0.3


def test_limits_with_an_angle_that_is_unsure():
    options = {"viewing_angle": 5 * u.deg, "angle_error": 0.2 * u.deg}
    table = intrinsic_table([5.0], [0.0], **options, rng=3)
    for name in ("gamma", "doppler"):
        ends = [
            intrinsic_table([5.0], [0.0], viewing_angle=angle * u.deg)[name][0].value
            for angle in (5 - 0.99446 * 0.2, 5 + 0.99446 * 0.2)
        ]
        assert table[f"{name}_low"][0].value == pytest.approx(min(ends), rel=5e-3)
        assert table[f"{name}_high"][0].value == pytest.approx(max(ends), rel=5e-3)
    assert {name: table.meta[name] for name in options} == options


@pytest.mark.parametrize("n", [2, 3, 4, 9])
def test_distances_of_points(n):
    t = np.linspace(0, 1.2, n)
    line = RidgeLine(-10 * np.sin(t) * u.mas, 10 * (1 - np.cos(t)) * u.mas)
    assert line.distances[0] == 0
    assert line.distances[-1] == line.length
    east, north = line.at(line.distances)
    np.testing.assert_allclose(east.value, line.east.value, atol=1e-9)
    np.testing.assert_allclose(north.value, line.north.value, atol=1e-9)
    table = line.to_table()
    np.testing.assert_array_equal(table["s"], line.distances)
    np.testing.assert_array_equal(table["pa"], line.position_angle(line.distances))


def test_uniform_is_what_has_the_same_axes_everywhere():
    line = RidgeLine([0, -5, -9, -11] * u.mas, [0, 1, 4, 8] * u.mas)
    frames = (
        SkyFrame(),
        PositionAngleFrame(40 * u.deg),
        RadialFrame([1, 2] * u.mas),
        ExpansionFrame([1, 2] * u.mas, 3 * u.mas),
        line,
    )
    east, north = np.array([[-1.0, -8.0, 3.0], [1.0, 6.0, 5.0]])
    for frame in frames:
        matrix = frame.matrix(east, north)
        assert matrix.shape == (3, 2, 2)
        assert frame.uniform == np.allclose(matrix, matrix[0])
    assert [frame.uniform for frame in frames] == [True, True, False, False, False]
    assert line.axis_names == ("parallel", "transverse")


def test_expansion_is_told_from_a_fifth_of_the_radius_on():
    frame = ExpansionFrame([0, 0] * u.mas, 20 * u.mas)
    assert np.isfinite(frame.matrix([0.0, -4.0], [4.0, 0.0])).all()
    assert np.isnan(frame.matrix([0.0, -3.99], [3.99, 0.0])).all()


def test_distances_of_any_shape():
    t = np.linspace(0, 1.2, 9)
    line = RidgeLine(-10 * np.sin(t) * u.mas, 10 * (1 - np.cos(t)) * u.mas)
    s = np.linspace(-2, 14, 24)
    flat, cube = s * u.mas, s.reshape(2, 3, 4) * u.mas
    angle = line.position_angle(flat)
    np.testing.assert_array_equal(line.position_angle(cube).ravel(), angle)
    assert line.position_angle(flat[7]) == angle[7]
    for one, other in zip(line.at(cube), line.at(flat), strict=True):
        np.testing.assert_array_equal(one.ravel(), other)
    places = line.at(cube)
    for one, other in zip(
        line.coordinates(*places), line.coordinates(*line.at(flat)), strict=True
    ):
        assert one.shape == (2, 3, 4)
        np.testing.assert_array_equal(one.ravel(), other)
    matrix = line.matrix(*(v.value for v in places))
    assert matrix.shape == (2, 3, 4, 2, 2)
    sin = np.sin(line.position_angle(cube))
    np.testing.assert_allclose(matrix[..., 0, 0], sin, atol=0.05)


@pytest.mark.parametrize(
    ("beta", "error"), [([1.0, 2.0], [0.1, -0.1]), ([1.0, -0.5], [0.1, 0.1]),
                        ([1.0, 2.0], [0.1, np.nan]), ([1.0, np.inf], [0.1, 0.1])]
)  # fmt: skip
def test_one_speed_that_cannot_be_among_others(beta, error):
    with pytest.raises(ValueError, match="finite and not negative"):
        intrinsic_table(beta, error)


def test_slow_flows_and_none():
    table = intrinsic_table([0.0, 0.4], [0.0, 0.0], viewing_angle=20 * u.deg)
    assert table["gamma"][0] == table["gamma_min"][0] == 1
    expected = lorentz_factor(beta_intrinsic(0.4, 20 * u.deg))
    assert table["gamma"][1].value == pytest.approx(expected.value)
    assert (table["possible"] == 1).all()


def test_nothing_over_nothing_is_no_speed():
    assert np.isnan(beta_intrinsic(0, 0 * u.deg))
    assert np.isnan(beta_intrinsic([-0.1, -0.5, -3.0], 15 * u.deg)).all()
    assert np.isnan(lorentz_factor([1.0, -1.0, 2.0])).all()
