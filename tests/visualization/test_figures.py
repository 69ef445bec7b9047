# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What every figure keeps to: no global state, no pyplot, results of any size."""

import subprocess
import sys
from io import BytesIO

import matplotlib
import pytest
from matplotlib.figure import Figure

from astro_scc.visualization import FIGURES, style

ON_FIGURES = ["spectrum", "paper", "epochs", "tracks"]


@pytest.mark.parametrize("kind", FIGURES)
def test_figures_draw_on_what_is_given_and_change_no_global_state(kind, jet_results):
    from matplotlib import _pylab_helpers

    before, given = dict(matplotlib.rcParams), Figure()
    if kind in ON_FIGURES:
        own = {"figure": given}
    else:
        own = {"ax": given.subplots(2, 1)[1]}
    assert jet_results["radial"].plot(kind, **own) is given
    labels = [ax.get_xlabel() or ax.get_ylabel() for ax in given.axes]
    assert kind in ON_FIGURES or [bool(label) for label in labels] == [False, True]
    given.savefig(BytesIO(), format="rgba", dpi=30)
    assert dict(matplotlib.rcParams) == before
    assert not _pylab_helpers.Gcf.figs


@pytest.mark.parametrize("kind", sorted({*FIGURES} - {"sensitivity"}))
def test_no_component_no_ssps_and_no_beam_are_no_reason_to_fail(kind, bare):
    assert len(bare.ssps) == len(bare.features) == 0
    figure = bare.plot(kind)
    assert figure.axes
    assert figure.get_figwidth() <= 6
    assert figure.get_figheight() <= 9.6


#: Figures of a result by their kind, and of its images by their number.
REFUSED = [
    ("map", {}, "unknown figure 'map': use one of spectrum"),
    ("diagram", {"unit": "yr"}, "unit must be an angle"),
    ("spectrum", {"unit": "mas"}, "unit must be an angle over a time"),
    ("velocity_map", {"which": "p"}, "unknown map 'p': use 'coefficient'"),
    ("velocity_map", {"beta_per_pm": -1}, "beta_per_pm must be positive, got -1"),
    (None, {"max_panels": 0}, "max_panels must be at least 1"),
    ("tracks", {"cmap": "magma"}, "unknown option 'cmap' .* matplotlib's Line2D"),
    (8, {}, "epoch 8 of a cube with 8 epochs"),
    (0.5, {}, "cannot be interpreted as an integer"),
    ("diagram", {"ax": "of a WCS"}, "ax is a WCSAxes, .* without projection="),
]


@pytest.mark.parametrize(("what", "options", "words"), REFUSED)
def test_what_is_refused(result, bare, what, options, words):
    plot = result.plot if isinstance(what, str) else result.cube.plot
    if "ax" in options:
        options = {"ax": Figure().add_subplot(projection=result.cube.wcs)}
    with pytest.raises((ValueError, IndexError, TypeError), match=words):
        plot(what, **options)
    with pytest.raises(ValueError, match="no rows: nothing moves significantly"):
        bare.plot("sensitivity")


#: Keywords of matplotlib by the kind of figure, and the artist that has them.
KEYWORDS = [
    ("velocity_map", {"cmap": "magma"}, lambda ax: ax.images[0].get_cmap().name),
    ("distance", {"cmap": "Blues"}, lambda ax: ax.collections[0].get_cmap().name),
    ("spectrum", {"lw": 3.0}, lambda ax: ax.lines[0].get_linewidth()),
    ("significance", {"color": "red"}, lambda ax: ax.lines[2].get_color()),
    ("tracks", {"lw": 2.5}, lambda ax: ax.lines[0].get_linewidth()),
]


@pytest.mark.parametrize(("kind", "look", "seen"), KEYWORDS)
def test_keywords_of_matplotlib_pass_through(result, kind, look, seen):
    assert [seen(result.plot(kind, **look).axes[0])] == [*look.values()]


def test_files_have_fonts_that_journals_take(result, monkeypatch):
    monkeypatch.setattr(style, "DPI", 20)
    before = dict(matplotlib.rcParams)
    files = style.figure_files(("significance",), result.plot, pdf=True)
    assert list(files) == ["significance.png", "significance.pdf"]
    assert b"/Type3" not in files["significance.pdf"]
    assert b"/FontFile2" in files["significance.pdf"]
    assert dict(matplotlib.rcParams) == before


@pytest.mark.slow
def test_matplotlib_is_imported_when_something_is_drawn():
    code = (
        "import sys, astro_scc.visualization, astro_scc.report;"
        "sys.exit('matplotlib' in sys.modules or 'jinja2' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
