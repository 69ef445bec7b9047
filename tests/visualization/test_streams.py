# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams of a result: velocity map, z-score, diagram and speeds of features."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import vstack

from astro_scc.flow import feature_profile
from astro_scc.units import PM_UNIT

#: Labels of the velocities, and of the displacement, by the kind of axes.
LABELS = {
    "jet": ("Proper motion parallel to the jet", "Transverse proper motion",
            "along the jet (mas)"),
    "sky": ("Proper motion to the east", "Proper motion to the north", "towards PA 2"),
    "radial": ("Radial proper motion", "Transverse proper motion", "outward ("),
}  # fmt: skip
KINDS = ["moving", "stationary", "not significant"]


def parts(figure, gid):
    return [artist for artist in figure.findobj() if artist.get_gid() == gid]


def numbers(ax):
    return [text.get_text() for text in ax.texts if text.get_text().isdigit()]


def legend(figure):
    return [text.get_text() for text in figure.axes[0].get_legend().get_texts()]


# -- the paper's map -----------------------------------------------------------------


@pytest.mark.parametrize("frame", LABELS)
def test_the_map_has_the_axes_of_the_frame_and_the_components(frame, jet_results):
    result, grid = jet_results[frame], jet_results[frame].grid
    ax = result.plot("velocity_map", unit="uas/yr", beta_per_pm=2.0).axes[0]
    labels = [
        label.removesuffix(" (uas/yr)") for label in (ax.get_xlabel(), ax.get_ylabel())
    ]
    assert labels == [*LABELS[frame][:2]]
    assert ax.xaxis_inverted() == (frame == "sky")
    assert numbers(ax) == [str(n) for n in result.streams["stream"]]
    assert legend(ax.figure) == ["one standard error", *result.streams["kind"]]
    for ellipse, stream in zip(parts(ax, "error"), result.search.streams, strict=True):
        size = ellipse.get_width(), ellipse.get_height()
        assert ellipse.get_center() == pytest.approx(1000 * stream.velocity, abs=1e-6)
        assert size == pytest.approx(2000 * np.sqrt(np.diag(stream.covariance)))
    (axis,) = (own for own in ax.child_axes if own.get_xlabel())
    assert axis.get_xlabel() == "Apparent speed (c)"
    ax.figure.draw_without_rendering()
    np.testing.assert_allclose(axis.get_xlim(), np.multiply(ax.get_xlim(), 0.002))
    # Points of the grid are at their velocities.
    np.testing.assert_array_equal(ax.images[0].get_array(), result.coefficient)
    left, right, bottom, top = np.divide(ax.images[0].get_extent(), 1000)
    n2, n1 = grid.shape
    assert left + (right - left) * 0.5 / n1 == pytest.approx(grid.v1[0])
    assert bottom + (top - bottom) * (n2 - 0.5) / n2 == pytest.approx(grid.v2[-1])


def of_kinds(result, kinds=KINDS):
    rows = vstack([result.streams[:1]] * len(kinds), metadata_conflicts="silent")
    rows["stream"], rows["kind"] = np.arange(len(kinds)) + 1, kinds
    return rows


def test_kinds_that_are_not_significant_and_what_is_unknown(result):
    table = of_kinds(result)
    figure = result.plot("velocity_map", components=table)
    assert legend(figure) == ["one standard error", *KINDS]
    assert [e.get_linestyle() for e in parts(figure, "error")] == ["-", "-", ":"]
    table["pm_parallel_err"][0] = np.nan * PM_UNIT
    figure = result.plot("paper", components=table)
    assert len(parts(figure.axes[0], "error")) == len(numbers(figure.axes[0])) - 1


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
    assert ax.get_ylabel().startswith(f"Displacement {LABELS[frame][2]}")
    assert ax.get_xlabel() == "Interval between epochs (yr)"
    (beams,) = [a for a in ax.child_axes if a.get_ylabel() == "Displacement (beams)"]
    figure.draw_without_rendering()
    # The beam is 1 mas.
    np.testing.assert_allclose(beams.get_ylim(), ax.get_ylim(), rtol=0.01)
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


def test_rays_have_the_slopes_and_lines_of_their_kinds(result):
    rows = of_kinds(result, [*KINDS, "not confirmed"])
    # The last one has no speed.
    velocities = [[6.0, 4.0], [0.1, 0.0], [-3.0, 0.0], [np.nan] * 2] * PM_UNIT
    # The axes are orthogonal, so their transpose leads back to the sky.
    rows["pm_ra_cosdec"], rows["pm_dec"] = result.frame.matrix().T @ velocities.T
    rows["pm"] = np.hypot(*velocities.T)
    rows["pm_err"] = [0.1, 0.1, np.nan, np.nan] * PM_UNIT
    rows["dispersion"] = [1.5, 0.2, np.nan, np.nan] * PM_UNIT
    figure = result.plot("diagram", components=rows, colorbar=False, unit="uas")
    rays = parts(figure, "ray")
    assert [ray.get_linestyle() for ray in rays] == ["-", "--", ":"]
    np.testing.assert_allclose([ray.get_slope() for ray in rays], [6000, 0, -3000])
    said = ["1: 7.21 ± 0.10 mas/yr", "2: stationary", "3: 3 mas/yr,\nnot significant"]
    assert legend(figure) == said
    assert [text.get_text() for text in parts(figure, "number")] == ["1", "2", "3"]
    # The band is one dispersion wide.
    band = [line.get_slope() for line in parts(figure, "dispersion")]
    np.testing.assert_allclose(band, [4500, 7500])


# -- speeds of features --------------------------------------------------------------


def test_speeds_are_those_of_the_tables(result):
    table = result.features
    figure = result.plot("speeds", profile=feature_profile(result), beta_per_pm=4.5)
    bars = figure.axes[0].containers[: len(table)]
    shown = np.array([own.lines[0].get_xydata()[0] for own in bars])
    np.testing.assert_allclose(shown[:, 0], table["separation"].to_value(u.mas))
    np.testing.assert_allclose(shown[:, 1], table["pm_radial"].to_value(PM_UNIT))
    assert legend(figure)[0] == "mean of bin"
    table = result.sensitivity
    ax = result.plot("sensitivity", beta_per_pm=4.5).axes[0]
    shown = np.concatenate([own.lines[0].get_xydata() for own in ax.containers])
    shown = shown[np.argsort(shown[:, 1])]
    np.testing.assert_allclose(shown[:, 0], table["pm"].value)
    assert [text.get_text() for text in ax.get_yticklabels()][0] == table["choice"][0]
