# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What every figure keeps to: no global state, no pyplot, results of any size."""

import io
import subprocess
import sys

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from astro_scc.visualization.results import FIGURES

OF_RESULTS = [
    FIGURES[kind] for kind in ("velocity_map", "significance", "paper", "members")
]
OF_CUBES = [
    lambda result, **kw: result.cube.plot(0, result.ssps, **kw),
    lambda result, **kw: result.cube[:3].plot(ssps=result.ssps, **kw),
    FIGURES["intervals"],
]


def draw(figure):
    """Render, and return the picture as an array."""
    file = io.BytesIO()
    figure.savefig(file, format="rgba", dpi=50)
    return np.frombuffer(file.getvalue(), dtype=np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plot", "frame"),
    [
        *((plot, frame) for plot in OF_RESULTS for frame in ("sky", "radial")),
        *((plot, "jet") for plot in OF_CUBES),
    ],
)
def test_figures_are_drawn_and_change_no_global_state(plot, frame, results):
    from matplotlib import _pylab_helpers

    before = dict(matplotlib.rcParams)
    managers = list(_pylab_helpers.Gcf.figs)
    figure = plot(results[frame])
    assert isinstance(figure, Figure)
    assert figure.get_figwidth() <= 6
    assert figure.get_figheight() <= 9.6
    assert len(np.unique(draw(figure))) > 20
    assert dict(matplotlib.rcParams) == before
    assert list(_pylab_helpers.Gcf.figs) == managers


@pytest.mark.slow
@pytest.mark.parametrize("plot", OF_RESULTS)
def test_no_component_is_no_reason_to_fail(plot, empty):
    plot(empty).draw_without_rendering()


@pytest.mark.parametrize("plot", OF_RESULTS + OF_CUBES)
def test_nor_are_no_ssps_and_no_beam(plot, bare):
    assert len(bare.ssps) == 0
    assert len(bare.components) == 0
    assert bare.cube.beams is None
    plot(bare).draw_without_rendering()


@pytest.mark.parametrize("plot", [OF_RESULTS[0], OF_RESULTS[1], OF_CUBES[0]])
def test_figures_draw_on_axes_that_are_given(plot, result):
    figure = Figure()
    upper, lower = figure.subplots(2, 1)
    assert plot(result, ax=lower) is figure
    assert lower.get_xlabel()
    assert not upper.get_xlabel()


@pytest.mark.parametrize("plot", [OF_RESULTS[2], OF_RESULTS[3], OF_CUBES[1]])
def test_figures_draw_on_a_figure_that_is_given(plot, result):
    figure = Figure()
    assert plot(result, figure=figure) is figure
    assert figure.axes


@pytest.mark.parametrize("kind", ["diagram", "speeds", "separation"])
def test_kinds_of_figures_of_a_result(kind, result):
    assert result.plot(kind).axes[0].get_ylabel()


def test_figures_of_features_have_the_colours_of_their_streams(result):
    streams = {f"stream {k}" for k in result.features["component"] if k}
    legend = result.plot("tracks").axes[0].get_legend()
    assert streams <= {text.get_text() for text in legend.get_texts()}


#: Figures of a result by their kind, and of its images by their number.
REFUSED = [
    ("map", {}, "unknown figure 'map': use one of velocity"),
    ("diagram", {"unit": "yr"}, "unit must be an angle"),
    ("separation", {"unit": "s"}, "unit must be an angle"),
    ("tracks", {"unit": "s"}, "unit must be an angle"),
    ("velocity_map", {"unit": "mas"}, "unit must be an angle over a time"),
    ("velocity_map", {"which": "p"}, "unknown map 'p': use 'coefficient'"),
    ("velocity_map", {"beta_per_pm": -1}, "beta_per_pm must be positive, got -1"),
    ("members", {"max_panels": 0}, "max_panels must be at least 1"),
    (None, {"max_panels": 0}, "max_panels must be at least 1"),
    (0, {"unit": "Jy"}, "unit must be an angle"),
    (0, {"stretch": "sqrt"}, "unknown stretch 'sqrt': use 'asinh'"),
    (8, {}, "epoch 8 of a cube with 8 epochs"),
    (0.5, {}, "cannot be interpreted as an integer"),
]


@pytest.mark.parametrize(("what", "options", "words"), REFUSED)
def test_what_is_refused(result, what, options, words):
    plot = result.plot if isinstance(what, str) else result.cube.plot
    with pytest.raises((ValueError, IndexError, TypeError), match=words):
        plot(what, **options)


@pytest.mark.slow
def test_matplotlib_is_imported_when_something_is_drawn():
    code = (
        "import sys, astro_scc.visualization, astro_scc.report;"
        "sys.exit('matplotlib' in sys.modules or 'jinja2' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
