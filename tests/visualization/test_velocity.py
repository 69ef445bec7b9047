# Licensed under a 3-clause BSD style license - see LICENSE.rst

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable, vstack

from astro_scc.visualization.style import component_kinds
from astro_scc.visualization.tracks import plot_members
from astro_scc.visualization.velocity import (
    plot_map_and_significance,
    plot_significance,
    plot_velocity_map,
)

LABELS = {
    "jet": ("Proper motion parallel to the jet", "Transverse proper motion"),
    "sky": ("Proper motion to the east", "Proper motion to the north"),
    "radial": ("Radial proper motion", "Transverse proper motion"),
}


def ellipses(ax):
    return [p for p in ax.patches if p.get_gid() == "error"]


def numbers(ax):
    return [t.get_text() for t in ax.texts if t.get_text().isdigit()]


@pytest.mark.parametrize("frame", LABELS)
def test_the_axes_are_those_of_the_frame(frame, results):
    ax = plot_velocity_map(results[frame]).axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == tuple(
        f"{name} (mas/yr)" for name in LABELS[frame]
    )
    left, right = ax.get_xlim()
    assert (left > right) == (frame == "sky")
    assert np.diff(ax.get_ylim()) > 0


@pytest.mark.parametrize("frame", LABELS)
def test_each_component_has_an_ellipse_and_its_number(frame, results):
    result = results[frame]
    ax = plot_velocity_map(result).axes[0]
    table = result.components
    assert list(table["kind"][:1]) == ["moving"]
    assert numbers(ax) == [str(n) for n in table["component"]]
    for ellipse, velocity in zip(ellipses(ax), result.velocities, strict=True):
        err1, err2 = np.sqrt(np.diag(velocity.covariance))
        assert ellipse.get_center() == pytest.approx(velocity.value)
        assert ellipse.get_width() == pytest.approx(2 * err1)
        assert ellipse.get_height() == pytest.approx(2 * err2)


def test_the_grid_point_of_the_map_is_at_its_velocity(result):
    grid = result.grid
    ax = plot_velocity_map(result).axes[0]
    drawn = ax.images[0]
    left, right, bottom, top = drawn.get_extent()
    n2, n1 = grid.shape
    assert left + (right - left) * 0.5 / n1 == pytest.approx(grid.v1[0])
    assert bottom + (top - bottom) * (n2 - 0.5) / n2 == pytest.approx(grid.v2[-1])
    np.testing.assert_array_equal(drawn.get_array(), result.coefficient)
    z_map = plot_velocity_map(result, which="z_score").axes[0].images[0]
    np.testing.assert_array_equal(z_map.get_array(), result.z_score)


def test_speeds_in_c_are_on_a_second_axis(result):
    figure = plot_velocity_map(result, beta_per_pm=2.0)
    figure.draw_without_rendering()
    (second,) = (a for a in figure.axes[0].child_axes if a.get_xlabel())
    assert second.get_xlabel() == "Apparent speed (c)"
    np.testing.assert_allclose(second.get_xlim(), np.multiply(ax_limits(figure), 2.0))


def ax_limits(figure):
    return figure.axes[0].get_xlim()


def test_speeds_have_the_unit_that_was_asked_for(result):
    ax = plot_velocity_map(result, unit="uas/yr").axes[0]
    assert ax.get_xlabel().endswith("(uas/yr)")
    assert ellipses(ax)[0].get_center()[0] == pytest.approx(
        1e3 * result.velocities[0].value[0]
    )
    figure = plot_velocity_map(result, unit="uas/yr", beta_per_pm=2.0)
    figure.draw_without_rendering()
    (second,) = (a for a in figure.axes[0].child_axes if a.get_xlabel())
    np.testing.assert_allclose(second.get_xlim(), np.multiply(ax_limits(figure), 2e-3))


def test_nothing_in_the_map_is_drawn_without_warnings(empty):
    for value in (0.0, np.nan):
        nothing = replace(empty, coefficient=np.full(empty.grid.shape, value))
        assert plot_velocity_map(nothing).axes[0].images[0].norm.vmax == 1


def direction_of_the_arrow(figure):
    (arrow,) = (t for t in figure.axes[0].texts if getattr(t, "arrow_patch", None))
    return np.subtract(arrow.xy, arrow.get_position())


def test_the_arrow_points_along_the_jet(results):
    east = replace(results["sky"], position_angle=90 * u.deg)
    assert direction_of_the_arrow(plot_velocity_map(east))[0] < -0.1
    north_west = replace(results["sky"], position_angle=-45 * u.deg)
    step = direction_of_the_arrow(plot_velocity_map(north_west))
    assert step[0] == pytest.approx(step[1])
    assert step[0] > 0
    assert direction_of_the_arrow(plot_velocity_map(results["jet"]))[0] > 0.1


def test_kinds_are_those_of_the_table(result):
    table = result.components
    assert component_kinds(table) == ["moving", "stationary"]
    assert component_kinds(table[:0]) == []
    # A table of other origin has no such column.
    assert component_kinds(QTable({"component": [1, 2]})) == ["moving", "moving"]


def test_kinds_have_signs_of_their_own(result):
    table = result.components.copy()
    ax = plot_velocity_map(result, components=table).axes[0]
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == ["moving", "stationary"]
    assert [e.get_linestyle() for e in ellipses(ax)] == ["-", "-"]
    table = vstack([table, table[:1]])
    table["kind"] = ["moving", "stationary", "not significant"]
    ax = plot_velocity_map(result, components=table).axes[0]
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == ["moving", "stationary", "not significant"]
    assert [e.get_linestyle() for e in ellipses(ax)] == ["-", "-", ":"]


def test_the_slice_is_the_middle_row_of_the_map(result):
    ax = plot_significance(result).axes[0]
    (line,) = (x for x in ax.lines if x.get_label() == "at zero transverse speed")
    np.testing.assert_allclose(line.get_xdata(), result.grid.v1)
    middle = len(result.grid.v2) // 2
    np.testing.assert_allclose(line.get_ydata(), result.z_score[middle])
    (highest,) = (x for x in ax.lines if x.get_label().startswith("highest"))
    np.testing.assert_allclose(highest.get_ydata(), result.z_score.max(axis=0))
    assert ax.get_ylabel() == "z-score"


@pytest.mark.parametrize("angle", [0, 33, 90, 270, 200])
def test_the_slice_of_a_map_on_the_sky_is_along_the_position_angle(angle, results):
    sky = results["sky"]
    grid = sky.grid
    theta = np.radians(angle)
    along = grid.v1 * np.sin(theta) + grid.v2[:, None] * np.cos(theta)
    across = grid.v1 * np.cos(theta) - grid.v2[:, None] * np.sin(theta)
    turned = replace(
        sky, z_score=along + 0.1 * across, position_angle=angle * u.deg, maxima=(),
        velocities=(), jitters=(),
    )  # fmt: skip
    ax = plot_significance(turned).axes[0]
    (line,) = (x for x in ax.lines if x.get_label() == "at zero transverse speed")
    speed, z_score = line.get_xdata(), line.get_ydata()
    assert np.isfinite(z_score).sum() >= len(speed) - 2
    np.testing.assert_allclose(
        z_score[np.isfinite(z_score)], speed[np.isfinite(z_score)], atol=1e-6
    )
    assert speed[-1] >= grid.v_max[0] * 0.999
    assert f"position angle {angle} deg" in ax.get_xlabel()


def test_components_are_marked_at_their_significance(result):
    ax = plot_significance(result).axes[0]
    assert numbers(ax) == [str(n) for n in result.components["component"]]
    marks = [bar.lines[0] for bar in ax.containers]
    for mark, row in zip(marks, result.components, strict=True):
        assert mark.get_xdata()[0] == pytest.approx(row["pm_parallel"].value)
        assert mark.get_ydata()[0] == pytest.approx(row["z_score"])


def test_errors_that_are_unknown_are_not_drawn(result):
    table = result.components.copy()
    for name in ("pm_parallel_err", "pm_transverse_err"):
        table[name] = 1 * u.mas / u.yr
        table[name][0] = np.nan * u.mas / u.yr
    ax = plot_velocity_map(result, components=table).axes[0]
    assert len(ellipses(ax)) == len(table) - 1
    assert len(numbers(ax)) == len(table)
    plot_significance(result, components=table).draw_without_rendering()


def test_both_panels_of_the_paper(results):
    figure = plot_map_and_significance(results["sky"], beta_per_pm=3.0)
    upper, lower = (ax for ax in figure.axes if ax.get_label() != "<colorbar>")
    assert upper.images
    assert lower.get_ylabel() == "z-score"


def arrows_of(ax):
    return next(c for c in ax.collections if hasattr(c, "U"))


def test_members_are_arrows_from_ssps_to_their_matches(results):
    for result in results.values():
        figure = plot_members(result, max_panels=2)
        axes = [ax for ax in figure.axes if ax.images]
        assert len(axes) == min(2, len(result.components))
        arrows = arrows_of(axes[0])
        # Each SSP with a match in a later epoch, and the first of these.
        d, first = result.displacements, {}
        for k in result.members(1)["match"]:
            own = d.ssp[k]
            if d.target[k] > d.reference[k]:
                first.setdefault(own, []).append((d.target[k], k))
        member = [min(first[own])[1] for own in sorted(first)]
        assert len(arrows.U) == len(member)
        np.testing.assert_allclose(
            np.hypot(arrows.U, arrows.V), np.hypot(d.d1, d.d2)[member]
        )
        start = result.ssps["east"][d.ssp[member]].value
        np.testing.assert_allclose(arrows.X, start)
        # The jet flows to the west.
        assert np.all(arrows.U < 0)
        assert axes[0].get_xlim()[0] > axes[0].get_xlim()[1]
        assert axes[0].texts[0].get_text().startswith("1: ")


def test_arrows_are_the_same_on_all_axes(results):
    def motions(result):
        everything = replace(result)
        d = result.displacements
        columns = {"match": np.arange(len(d)), "ssp": d.ssp, "epoch": d.reference}
        table = QTable({**columns, "target_epoch": d.target})
        object.__setattr__(everything, "members", lambda n: table)
        arrows = arrows_of(plot_members(everything, max_panels=1).axes[0])
        return np.stack([arrows.U, arrows.V])

    sky = motions(results["sky"])
    np.testing.assert_allclose(motions(results["jet"]), sky, atol=1e-9)
    np.testing.assert_allclose(motions(results["radial"]), sky, atol=1e-9)


def test_components_that_were_found_come_first(result):
    table = result.components.copy()
    table["kind"] = ["not significant", "moving"]
    figure = plot_members(result, components=table)
    texts = [ax.texts[0].get_text() for ax in figure.axes if ax.texts]
    assert [text.split(":")[0] for text in texts] == ["2", "1"]
    figure = plot_members(result, components=table[:1])
    assert ", not significant, " in figure.axes[0].texts[0].get_text()


def test_no_component_shows_the_mean_image(empty):
    (ax,) = plot_members(empty).axes
    assert ax.get_title() == "no stream"
    assert ax.images


def test_arrow_and_legend_keep_to_corners_without_components(result):
    table = result.components[:1].copy()
    for v1, v2 in ((-30, -30), (30, 30)):
        table["pm_parallel"] = v1 * u.mas / u.yr
        table["pm_transverse"] = v2 * u.mas / u.yr
        figure = plot_velocity_map(result, components=table)
        ax = figure.axes[0]
        figure.draw_without_rendering()
        mark = ax.transData.transform((v1, v2))
        legend = ax.get_legend().get_window_extent()
        assert not legend.contains(*mark)
        (arrow,) = (t for t in ax.texts if t.get_gid() == "jet")
        assert not arrow.get_window_extent().expanded(2, 3).contains(*mark)
        assert not arrow.get_window_extent().overlaps(legend)
