# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams of a result: velocity map, z-score, diagram, matches and features' speeds."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable, vstack

from astro_scc.flow import feature_profile
from astro_scc.units import PM_UNIT

LABELS = {
    "jet": ("Proper motion parallel to the jet", "Transverse proper motion"),
    "sky": ("Proper motion to the east", "Proper motion to the north"),
    "radial": ("Radial proper motion", "Transverse proper motion"),
}


def parts(figure, gid):
    return [artist for artist in figure.findobj() if artist.get_gid() == gid]


def numbers(ax):
    return [text.get_text() for text in ax.texts if text.get_text().isdigit()]


def legend(figure):
    return [text.get_text() for text in figure.axes[0].get_legend().get_texts()]


def second_axis(figure):
    figure.draw_without_rendering()
    (axis,) = (ax for ax in figure.axes[0].child_axes if ax.get_xlabel())
    return axis


# -- the paper's map -----------------------------------------------------------------


@pytest.mark.parametrize("frame", LABELS)
def test_the_map_has_the_axes_of_the_frame_and_the_components(frame, jet_results):
    result = jet_results[frame]
    ax = result.plot().axes[0]
    assert (ax.get_xlabel(), ax.get_ylabel()) == tuple(
        f"{name} (mas/yr)" for name in LABELS[frame]
    )
    left, right = ax.get_xlim()
    assert (left > right) == (frame == "sky")
    assert numbers(ax) == [str(n) for n in result.components["component"]]
    assert legend(ax.figure) == result.components["kind"].tolist()
    for ellipse, velocity in zip(parts(ax, "error"), result.velocities, strict=True):
        errors = np.sqrt(np.diag(velocity.covariance))
        assert ellipse.get_center() == pytest.approx(velocity.value)
        size = (ellipse.get_width(), ellipse.get_height())
        assert size == pytest.approx(2 * errors)


def test_grid_points_are_at_their_velocities(result, empty):
    grid, drawn = result.grid, result.plot().axes[0].images[0]
    left, right, bottom, top = drawn.get_extent()
    n2, n1 = grid.shape
    assert left + (right - left) * 0.5 / n1 == pytest.approx(grid.v1[0])
    assert bottom + (top - bottom) * (n2 - 0.5) / n2 == pytest.approx(grid.v2[-1])
    np.testing.assert_array_equal(drawn.get_array(), result.coefficient)
    z_map = result.plot(which="z_score").axes[0].images[0]
    np.testing.assert_array_equal(z_map.get_array(), result.z_score)
    for value in (0.0, np.nan):
        nothing = replace(empty, coefficient=np.full(grid.shape, value))
        assert nothing.plot().axes[0].images[0].norm.vmax == 1


@pytest.mark.parametrize(("unit", "factor"), [("mas/yr", 1), ("uas/yr", 1000)])
def test_units_of_the_axes_and_speeds_in_c(unit, factor, result):
    figure = result.plot(unit=unit, beta_per_pm=2.0)
    assert figure.axes[0].get_xlabel().endswith(f"({unit})")
    center = parts(figure, "error")[0].get_center()
    assert center[0] == pytest.approx(factor * result.velocities[0].value[0])
    axis = second_axis(figure)
    assert axis.get_xlabel() == "Apparent speed (c)"
    limits = np.multiply(figure.axes[0].get_xlim(), 2.0 / factor)
    np.testing.assert_allclose(axis.get_xlim(), limits)


def test_the_arrow_points_along_the_jet(jet_results):
    def direction(result):
        (arrow,) = parts(result.plot().axes[0], "jet")
        return np.subtract(arrow.xy, arrow.get_position())

    assert direction(replace(jet_results["sky"], position_angle=90 * u.deg))[0] < -0.1
    x, y = direction(replace(jet_results["sky"], position_angle=-45 * u.deg))
    assert x == pytest.approx(y)
    assert x > 0
    assert direction(jet_results["jet"])[0] > 0.1


def test_kinds_that_are_not_significant_and_errors_that_are_unknown(result):
    table = vstack([result.components, result.components[:1]])
    table["kind"] = ["moving", "stationary", "not significant"]
    figure = result.plot(components=table)
    assert legend(figure) == ["moving", "stationary", "not significant"]
    assert [e.get_linestyle() for e in parts(figure, "error")] == ["-", "-", ":"]
    for name in ("pm_parallel_err", "pm_transverse_err"):
        table[name][0] = np.nan * PM_UNIT
    figure = result.plot("paper", components=table)
    assert len(parts(figure.axes[0], "error")) == len(numbers(figure.axes[0])) - 1


def test_the_slice_is_the_middle_row_of_the_map(result):
    ax = result.plot("significance").axes[0]
    _, highest, middle, *_ = ax.lines
    np.testing.assert_allclose(middle.get_xdata(), result.grid.v1)
    row = result.z_score[len(result.grid.v2) // 2]
    np.testing.assert_allclose(middle.get_ydata(), row)
    np.testing.assert_allclose(highest.get_ydata(), result.z_score.max(axis=0))
    assert ax.get_ylabel() == "z-score"
    assert numbers(ax) == [str(n) for n in result.components["component"]]
    for bar, row in zip(ax.containers, result.components, strict=True):
        (place,) = bar.lines[0].get_xydata()
        assert place == pytest.approx([row["pm_parallel"].value, row["z_score"]])


@pytest.mark.parametrize("angle", [0, 33, 90, 200])
def test_the_slice_of_a_map_on_the_sky_is_along_the_position_angle(angle, jet_results):
    sky = jet_results["sky"]
    theta = np.radians(angle)
    along = sky.grid.v1 * np.sin(theta) + sky.grid.v2[:, None] * np.cos(theta)
    across = sky.grid.v1 * np.cos(theta) - sky.grid.v2[:, None] * np.sin(theta)
    turned = replace(
        sky, z_score=along + 0.1 * across, position_angle=angle * u.deg, maxima=(),
        velocities=(), jitters=(),
    )  # fmt: skip
    ax = turned.plot("significance").axes[0]
    speed, z_score = ax.lines[2].get_data()
    known = np.isfinite(z_score)
    assert known.sum() >= len(speed) - 2
    np.testing.assert_allclose(z_score[known], speed[known], atol=1e-6)
    assert speed[-1] >= sky.grid.v_max[0] * 0.999
    assert f"position angle {angle} deg" in ax.get_xlabel()


# -- matches of components -----------------------------------------------------------


def arrows_of(figure):
    return next(c for c in figure.axes[0].collections if hasattr(c, "U"))


def test_members_are_arrows_from_ssps_to_their_next_match(jet_results):
    for result in jet_results.values():
        figure = result.plot("members", max_panels=2)
        n_panels = sum(bool(ax.images) for ax in figure.axes)
        assert n_panels == len(result.components)
        d, first = result.displacements, {}
        for k in result.members(1)["match"]:
            if d.target[k] > d.reference[k]:
                first.setdefault(d.ssp[k], []).append((d.target[k], k))
        member = [min(first[own])[1] for own in sorted(first)]
        arrows = arrows_of(figure)
        lengths = np.hypot(d.d1, d.d2)[member]
        np.testing.assert_allclose(np.hypot(arrows.U, arrows.V), lengths)
        start = result.ssps["east"][d.ssp[member]].value
        np.testing.assert_allclose(arrows.X, start)
        # The jet flows to the west.
        assert np.all(arrows.U < 0)


def test_arrows_are_the_same_on_all_axes(jet_results):
    motions = {}
    for name, result in jet_results.items():
        everything, d = replace(result), result.displacements
        columns = {"match": np.arange(len(d)), "ssp": d.ssp, "epoch": d.reference}
        table = QTable({**columns, "target_epoch": d.target})
        object.__setattr__(everything, "members", lambda n, table=table: table)
        arrows = arrows_of(everything.plot("members", max_panels=1))
        motions[name] = np.stack([arrows.U, arrows.V])
    np.testing.assert_allclose(motions["jet"], motions["sky"], atol=1e-9)
    np.testing.assert_allclose(motions["radial"], motions["sky"], atol=1e-9)


def test_components_that_were_found_come_first(result, empty):
    table = result.components.copy()
    table["kind"] = ["not significant", "moving"]
    figure = result.plot("members", components=table)
    texts = [ax.texts[0].get_text() for ax in figure.axes if ax.texts]
    assert [text.split(":")[0] for text in texts] == ["2", "1"]
    assert ", not significant, " in texts[1]
    (ax,) = empty.plot("members").axes
    assert (ax.get_title(), len(ax.images)) == ("no stream", 1)


# -- the diagram ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def drawn(result):
    """Draw some velocities along the jet as components of some kinds."""

    def draw(*streams, **settings):
        values = np.zeros((len(streams), 3)) * PM_UNIT
        for own, (_, *given) in zip(values.value, streams, strict=True):
            own[: len(given)] = given
        along, across, dispersion = values.T
        rows = result.components[[0] * len(streams)]
        rows["component"] = np.arange(1, len(streams) + 1)
        rows["kind"] = [kind for kind, *_ in streams]
        # The axes are orthogonal, so their transpose leads back to the sky.
        sky = result.frame.matrix().T @ values[:, :2].T
        rows["pm_ra_cosdec"], rows["pm_dec"] = sky
        rows["pm"], rows["dispersion"] = np.hypot(along, across), dispersion
        rows["pm_err"] = 0.1 * PM_UNIT
        return result.plot("diagram", components=rows, **settings)

    return draw


@pytest.mark.parametrize(
    ("name", "label"),
    [("jet", "along the jet (mas)"), ("sky", "towards PA 2"), ("radial", "outward (")],
)
def test_the_ray_is_on_the_red_ridge(name, label, jet_results):
    # Features that move to the west: down the jet, and towards PA 270 deg.
    figure = jet_results[name].plot("diagram")
    ax = figure.axes[0]
    assert ax.get_ylabel().startswith(f"Displacement {label}")
    assert ax.get_xlabel() == "Interval between epochs (yr)"
    (beams,) = [a for a in ax.child_axes if a.get_ylabel() == "Displacement (beams)"]
    figure.draw_without_rendering()
    # The beam is 1 mas.
    np.testing.assert_allclose(beams.get_ylim(), ax.get_ylim(), rtol=0.01)
    ray = parts(figure, "ray")[0]
    speed = jet_results[name].components["pm"][0].to_value(PM_UNIT)
    assert ray.get_slope() == pytest.approx(speed, rel=0.02)
    (mesh,) = parts(figure, "excess")
    assert mesh.norm.vmin == -mesh.norm.vmax < 0
    coordinates, values = mesh.get_coordinates(), mesh.get_array()
    interval = coordinates[0, :-1, 0] + np.diff(coordinates[0, :, 0]) / 2
    middle = coordinates[:-1, 0, 1] + np.diff(coordinates[:, 0, 1]) / 2
    moved = speed * interval < 1.5
    assert moved.any()
    peaks = middle[values.argmax(axis=0)][moved]
    np.testing.assert_allclose(peaks, speed * interval[moved], atol=0.2)
    slope = parts(jet_results[name].plot("diagram", unit="uas"), "ray")[0].get_slope()
    assert slope == pytest.approx(1000 * ray.get_slope())


def test_rays_have_the_slopes_and_lines_of_their_kinds(drawn):
    figure = drawn(("moving", 6.0, 4.0), ("not significant", -3.0), ("stationary", 0.1))
    rays = parts(figure, "ray")
    assert [ray.get_linestyle() for ray in rays] == ["-", ":", "--"]
    np.testing.assert_allclose([ray.get_slope() for ray in rays], [6, -3, 0])
    assert legend(figure) == [
        "1: 7.21 ± 0.10 mas/yr",
        "2: 3.00 ± 0.10 mas/yr,\nnot significant",
        "3: stationary",
    ]
    assert [text.get_text() for text in parts(figure, "number")] == ["1", "2", "3"]


def test_the_band_is_one_dispersion_wide(drawn):
    band = parts(drawn(("moving", 6.0, 0.0, 1.5)), "dispersion")
    np.testing.assert_allclose([line.get_slope() for line in band], [4.5, 7.5])
    for own in (("moving", 6.0, 0.0, np.nan), ("stationary", 0.1, 0.0, 0.2)):
        assert not parts(drawn(own), "dispersion")


@pytest.mark.parametrize(
    ("streams", "end"),
    [
        ([("moving", 9.0), ("moving", 24.0), ("not significant", 0.1)], None),
        # Never fewer than four intervals, or more than there are.
        ([("moving", 1e3)], 4.5),
        ([], 7.5),
        ([("stationary", 0.0)], 7.5),
        ([("moving", -1e-3)], 7.5),
    ],
)
def test_intervals_are_shown_until_the_slowest_stream_has_left(drawn, streams, end):
    ax = drawn(*streams, colorbar=False).axes[0]
    (low, high), (_, reach) = ax.get_xlim(), ax.get_ylim()
    end = 1.3 * reach / 9 if end is None else end * 30 / 365.25
    assert (low, high) == pytest.approx((0, end), rel=0.01)


def test_a_speed_without_an_error_and_a_diagram_of_nothing(result, bare):
    rows = result.components[:1].copy()
    rows["pm_err"], rows["kind"] = np.nan * PM_UNIT, "not significant"
    figure = result.plot("diagram", components=rows)
    speed = rows["pm"][0].to_value(PM_UNIT)
    assert legend(figure) == [f"1: {speed:.3g} mas/yr,\nnot significant"]
    figure = bare.plot("diagram")
    assert not parts(figure, "ray")
    assert not np.any(parts(figure, "excess")[0].get_array())


# -- speeds of features --------------------------------------------------------------


def test_speeds_of_features_are_radial(result, bare):
    table = result.features
    figure = result.plot("speeds", profile=feature_profile(result), beta_per_pm=4.5)
    bars = figure.axes[0].containers[: len(table)]
    shown = np.array([own.lines[0].get_xydata()[0] for own in bars])
    np.testing.assert_allclose(shown[:, 0], table["separation"].to_value(u.mas))
    np.testing.assert_allclose(shown[:, 1], table["pm_radial"].to_value(PM_UNIT))
    assert legend(figure)[0] == "mean of bin"
    assert len(bare.plot("speeds").axes[0].containers) == 0


def test_speeds_with_other_choices(result):
    table = result.sensitivity
    ax = result.plot("sensitivity", beta_per_pm=4.5).axes[0]
    shown = np.concatenate([own.lines[0].get_xdata() for own in ax.containers])
    wanted = np.concatenate(
        [table["pm"].value[table["significant"] == k] for k in (0, 1)]
    )
    np.testing.assert_allclose(shown, wanted)
    assert [text.get_text() for text in ax.get_yticklabels()][0] == table["choice"][0]
