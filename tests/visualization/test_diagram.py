# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The displacement-interval diagram: its colours, rays and letters."""

import io
from itertools import combinations

import astropy.units as u
import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from astro_scc.visualization.diagram import plot_diagram


def parts(figure, gid):
    return [artist for artist in figure.findobj() if artist.get_gid() == gid]


def legend(figure):
    (ax,) = figure.axes[:1]
    return [text.get_text() for text in ax.get_legend().get_texts()]


@pytest.fixture(scope="module")
def drawn(result):
    """Draw some velocities along the jet as components of some kinds."""

    def draw(*streams, **settings):
        kinds = [kind for kind, *_ in streams]
        values = np.zeros((len(streams), 3)) * u.mas / u.yr
        for own, (_, *given) in zip(values.value, streams, strict=True):
            own[: len(given)] = given
        along, across, dispersion = values.T
        rows = result.components[[0] * len(streams)]
        rows["component"] = np.arange(1, len(streams) + 1)
        rows["kind"] = kinds
        # The axes are orthogonal, so their transpose leads back to the sky.
        sky = result.frame.matrix().T @ values[:, :2].T
        rows["pm_ra_cosdec"], rows["pm_dec"] = sky
        rows["pm"], rows["dispersion"] = np.hypot(along, across), dispersion
        rows["pm_err"] = 0.1 * u.mas / u.yr
        return plot_diagram(result, components=rows, **settings)

    return draw


@pytest.mark.parametrize("name", ["jet", "sky", "radial"])
def test_the_ray_is_on_the_red_ridge(name, results):
    # Features that move to the west: down the jet, and towards PA 270 deg.
    figure = plot_diagram(results[name])
    ray = parts(figure, "ray")[0]
    speed = results[name].components["pm"][0].to_value(u.mas / u.yr)
    assert ray.get_slope() == pytest.approx(speed, rel=0.02)
    (mesh,) = parts(figure, "excess")
    coordinates, values = mesh.get_coordinates(), mesh.get_array()
    interval = coordinates[0, :-1, 0] + np.diff(coordinates[0, :, 0]) / 2
    middle = coordinates[:-1, 0, 1] + np.diff(coordinates[:, 0, 1]) / 2
    moved = speed * interval < 1.5
    assert moved.any()
    peaks = middle[values.argmax(axis=0)][moved]
    np.testing.assert_allclose(peaks, speed * interval[moved], atol=0.2)


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("jet", "Displacement along the jet (mas)"),
        ("sky", "Displacement towards PA 2"),
        ("radial", "Displacement outward (mas)"),
    ],
)
def test_axes_have_names_and_units(name, label, results):
    ax = plot_diagram(results[name]).axes[0]
    assert ax.get_ylabel().startswith(label)
    assert ax.get_xlabel() == "Interval between epochs (yr)"
    (beams,) = [a for a in ax.child_axes if a.get_ylabel() == "Displacement (beams)"]
    # The beam is 1 mas.
    beams.get_figure().draw_without_rendering()
    np.testing.assert_allclose(beams.get_ylim(), ax.get_ylim(), rtol=0.01)


def test_the_unit_that_was_asked_for(result):
    own, other = plot_diagram(result), plot_diagram(result, unit="uas")
    assert other.axes[0].get_ylabel() == "Displacement along the jet (uas)"
    slopes = [parts(figure, "ray")[0].get_slope() for figure in (own, other)]
    assert slopes[1] == pytest.approx(1000 * slopes[0])


def test_colours_are_centred_on_zero_and_safe(result):
    (mesh,) = parts(plot_diagram(result), "excess")
    assert mesh.norm.vmin == -mesh.norm.vmax < 0
    # Red and blue, which all colour visions tell apart, about a pale middle.
    assert mesh.get_cmap() == matplotlib.colormaps["RdBu_r"]
    assert min(mesh.get_cmap()(mesh.norm(0.0))[:3]) > 0.9
    highest = np.abs(result.diagram().data[:, result.diagram().meta["n_pairs"] > 0])
    assert 0.3 * highest.max() < mesh.norm.vmax <= highest.max()


def test_each_kind_has_a_line_of_its_own(drawn):
    figure = drawn(("moving", 6.0), ("not significant", 3.0), ("stationary", 0.01))
    rays = parts(figure, "ray")
    assert [ray.get_linestyle() for ray in rays] == ["-", ":", "--"]
    np.testing.assert_allclose([ray.get_slope() for ray in rays], [6, 3, 0])
    assert legend(figure) == [
        "1: 6.00 ± 0.10 mas/yr",
        "2: 3.00 ± 0.10 mas/yr,\nnot significant",
        "3: stationary",
    ]
    assert [text.get_text() for text in parts(figure, "number")] == ["1", "2", "3"]


def test_only_the_motion_along_the_displacement_is_a_slope(drawn):
    (ray,) = parts(drawn(("moving", 3.0, 4.0)), "ray")
    assert ray.get_slope() == pytest.approx(3)


@pytest.mark.slow
def test_the_band_is_one_dispersion_wide(drawn):
    band = parts(drawn(("moving", 6.0, 0.0, 1.5)), "dispersion")
    np.testing.assert_allclose([line.get_slope() for line in band], [4.5, 7.5])
    assert all(line.get_linewidth() < 1 for line in band)
    for unknown in (0.0, np.nan):
        assert not parts(drawn(("moving", 6.0, 0.0, unknown)), "dispersion")
    assert not parts(drawn(("stationary", 0.1, 0.0, 0.2)), "dispersion")


def test_intervals_are_shown_until_the_slowest_stream_has_left(drawn):
    def longest(*streams):
        ax = drawn(*streams).axes[0]
        assert ax.get_xlim()[0] == 0
        return ax.get_xlim()[1], ax.get_ylim()[1]

    end, reach = longest(("moving", 9.0), ("moving", 24.0), ("not significant", 0.1))
    assert end == pytest.approx(1.3 * reach / 9)
    # Never fewer than four intervals, or more than there are.
    assert longest(("moving", 1e3))[0] == pytest.approx(4.5 * 30 / 365.25, rel=0.01)
    whole = 7.5 * 30 / 365.25
    for streams in ([], [("stationary", 0.0)], [("moving", 1e-3)]):
        assert longest(*streams)[0] == pytest.approx(whole, rel=0.01)


def test_inward_motion_is_below(drawn):
    figure = drawn(("moving", -6.0))
    assert parts(figure, "ray")[0].get_slope() == -6
    (number,) = parts(figure, "number")
    assert number.get_position()[1] < 0
    figure.draw_without_rendering()
    box = figure.axes[0].get_legend().get_window_extent()
    assert box.y0 > figure.axes[0].get_window_extent().y1 / 2


def test_a_speed_without_an_error(drawn, result):
    rows = result.components[:1].copy()
    rows["pm_err"] = np.nan * u.mas / u.yr
    rows["kind"] = "not significant"
    figure = plot_diagram(result, components=rows)
    speed = rows["pm"][0].to_value(u.mas / u.yr)
    assert legend(figure) == [f"1: {speed:.3g} mas/yr,\nnot significant"]


@pytest.mark.slow
def test_no_component_and_no_match_are_drawn(empty, bare):
    for result in (empty, bare):
        figure = plot_diagram(result)
        assert not parts(figure, "ray")
        assert figure.axes[0].get_legend() is None
        figure.savefig(io.BytesIO(), format="png")
    (mesh,) = parts(plot_diagram(bare), "excess")
    assert not np.any(mesh.get_array())


def test_axes_that_are_given_and_no_bar(result):
    figure = Figure()
    upper, lower = figure.subplots(2, 1)
    assert plot_diagram(result, ax=lower, colorbar=False) is figure
    assert lower.get_xlabel()
    assert not upper.get_xlabel()
    assert not any(ax.get_xlabel().startswith("Matches") for ax in lower.child_axes)


def test_letters_do_not_overlap_in_one_column(drawn):
    figure = Figure(figsize=(3.46, 3.6), layout="compressed")
    drawn(
        ("moving", 6.0, 0.0, 1.0),
        ("not significant", 12.0),
        ("stationary", 0.0),
        ax=figure.add_subplot(),
    )
    figure.draw_without_rendering()
    ax = figure.axes[0]
    boxes = [ax.get_legend().get_window_extent()]
    boxes += [number.get_window_extent() for number in parts(figure, "number")]
    for axes in (ax, *ax.child_axes):
        for axis in (axes.xaxis, axes.yaxis):
            if not axis.get_label().get_text():
                continue
            boxes.append(axis.label.get_window_extent())
            low, high = sorted(axis.get_view_interval())
            boxes += [
                label.get_window_extent()
                for place, label in zip(
                    axis.get_ticklocs(), axis.get_ticklabels(), strict=True
                )
                if low <= place <= high
            ]
    assert len(boxes) > 20
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)
    for box in boxes:
        assert figure.bbox.x0 <= box.x0 <= box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 <= box.y1 <= figure.bbox.y1
