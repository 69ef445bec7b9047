# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams of a result: velocity map, z-score, diagram and speeds of features."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc.units import PM_UNIT

#: Labels of the velocities, and of the displacement, by the kind of axes.
LABELS = {
    "jet": ("Proper motion parallel to the jet", "along the jet (mas)"),
    "sky": ("Proper motion to the east", "towards PA 2"),
    "radial": ("Radial proper motion", "outward ("),
}


def parts(figure, gid):
    return [artist for artist in figure.findobj() if artist.get_gid() == gid]


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
