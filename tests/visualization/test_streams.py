# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams of a result: velocity map, z-score, diagram and speeds of features."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc.flow import feature_profile
from astro_scc.units import PM_UNIT

#: Labels of the velocities, and of the displacement, by the kind of axes.
LABELS = {
    "jet": ("Proper motion parallel to the jet", "along the jet (mas)"),
    "sky": ("Proper motion to the east", "towards PA 2"),
    "radial": ("Radial proper motion", "outward ("),
}


def parts(figure, gid):
    return [artist for artist in figure.findobj() if artist.get_gid() == gid]


# -- the paper's map -----------------------------------------------------------------


@pytest.mark.parametrize("frame", LABELS)
def test_the_map_has_the_axes_of_the_frame_and_the_components(frame, jet_results):
    result, grid = jet_results[frame], jet_results[frame].grid
    ax = result.plot("velocity_map", unit="uas/yr", beta_per_pm=2.0).axes[0]
    assert ax.get_xlabel() == f"{LABELS[frame][0]} (uas/yr)"
    assert ax.xaxis_inverted() == (frame == "sky")
    for ellipse, stream in zip(parts(ax, "error"), result.search.streams, strict=True):
        size = ellipse.get_width(), ellipse.get_height()
        assert ellipse.get_center() == pytest.approx(1000 * stream.velocity, abs=1e-6)
        assert size == pytest.approx(2000 * np.sqrt(np.diag(stream.covariance)))
    # Points of the grid are at their velocities.
    np.testing.assert_array_equal(ax.images[0].get_array(), result.coefficient)
    left, right, bottom, top = np.divide(ax.images[0].get_extent(), 1000)
    n2, n1 = grid.shape
    assert left + (right - left) * 0.5 / n1 == pytest.approx(grid.v1[0])
    assert bottom + (top - bottom) * (n2 - 0.5) / n2 == pytest.approx(grid.v2[-1])


def test_the_slice_of_a_map_on_the_sky_is_along_the_position_angle(jet_results):
    sky, theta = jet_results["sky"], np.radians(33)
    along = sky.grid.v1 * np.sin(theta) + sky.grid.v2[:, None] * np.cos(theta)
    across = sky.grid.v1 * np.cos(theta) - sky.grid.v2[:, None] * np.sin(theta)
    velocities = replace(sky.search.velocities, z_score=along + 0.1 * across)
    search = replace(sky.search, velocities=velocities)
    turned = replace(sky, search=search, position_angle=33 * u.deg)
    # The arrow of the map points along it, and east is to the left.
    (arrow,) = parts(turned.plot("velocity_map").axes[0], "jet")
    x, y = np.subtract(arrow.xy, arrow.get_position())
    assert np.arctan2(-x, y) == pytest.approx(theta)
    ax = turned.plot("significance").axes[0]
    speed, z_score = ax.lines[2].get_data()
    known = np.isfinite(z_score)
    assert known.sum() >= len(speed) - 2
    np.testing.assert_allclose(z_score[known], speed[known], atol=1e-6)
    assert speed[-1] >= sky.grid.v1[-1] * 0.999
    assert "position angle 33 deg" in ax.get_xlabel()


# -- the diagram ---------------------------------------------------------------------


@pytest.mark.parametrize("frame", LABELS)
def test_the_ray_is_on_the_red_ridge(frame, jet_results):
    # Features that move to the west: down the jet, and towards PA 270 deg.
    figure = jet_results[frame].plot("diagram")
    ax = figure.axes[0]
    assert ax.get_ylabel().startswith(f"Displacement {LABELS[frame][1]}")
    speed = jet_results[frame].streams["pm"][0].to_value(PM_UNIT)
    assert parts(figure, "ray")[0].get_slope() == pytest.approx(speed, rel=0.02)
    (mesh,) = parts(figure, "excess")
    assert mesh.norm.vmin == -mesh.norm.vmax < 0
    coordinates, values = mesh.get_coordinates(), mesh.get_array()
    interval = coordinates[0, :-1, 0] + np.diff(coordinates[0, :, 0]) / 2
    middle = coordinates[:-1, 0, 1] + np.diff(coordinates[:, 0, 1]) / 2
    moved = speed * interval < 1.5
    assert moved.any()
    peaks = middle[values.argmax(axis=0)][moved]
    np.testing.assert_allclose(peaks, speed * interval[moved], atol=0.2)


# -- speeds of features --------------------------------------------------------------


def test_speeds_are_those_of_the_tables(result):
    table = result.features
    figure = result.plot("speeds", profile=feature_profile(result), beta_per_pm=4.5)
    bars = figure.axes[0].containers[: len(table)]
    shown = np.array([own.lines[0].get_xydata()[0] for own in bars])
    np.testing.assert_allclose(shown[:, 0], table["separation"].to_value(u.mas))
    np.testing.assert_allclose(shown[:, 1], table["pm_radial"].to_value(PM_UNIT))
    table = result.sensitivity
    ax = result.plot("sensitivity", beta_per_pm=4.5).axes[0]
    shown = np.concatenate([own.lines[0].get_xydata() for own in ax.containers])
    shown = shown[np.argsort(shown[:, 1])]
    np.testing.assert_allclose(shown[:, 0], table["pm"].value)
