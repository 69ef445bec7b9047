# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What every figure keeps to, and what those of streams and of features show."""

import itertools
import subprocess
import sys
from dataclasses import replace
from functools import partial
from io import BytesIO

import astropy.units as u
import matplotlib
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from astro_scc.units import PM_UNIT
from astro_scc.visualization import FIGURES, style
from astro_scc.visualization.tracks import ejections, plot_separation, plot_tracks

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


NORM = Normalize(-1, 2)
#: Keywords of matplotlib by the kind of figure, and the artist that has them.
KEYWORDS = [
    ("velocity_map", {"cmap": "magma"}, lambda ax: ax.images[0].get_cmap().name),
    ("distance", {"cmap": "Blues"}, lambda ax: ax.collections[0].get_cmap().name),
    ("spectrum", {"lw": 3.0}, lambda ax: ax.lines[0].get_linewidth()),
    ("significance", {"color": "red"}, lambda ax: ax.lines[2].get_color()),
    ("paper", {"norm": NORM}, lambda ax: ax.images[0].norm),
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


#: Labels of the velocities, and of the displacement, by the kind of axes.
LABELS = {
    "jet": ("Proper motion parallel to the jet", "along the jet (mas)"),
    "sky": ("Proper motion to the east", "towards PA 2"),
    "radial": ("Radial proper motion", "outward ("),
}


def parts(figure, gid):
    return [artist for artist in figure.findobj() if artist.get_gid() == gid]


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


MODULE = "astro_scc.visualization.tracks"


@pytest.fixture(scope="module")
def features(result):
    """Features of which one is not secure, and one is accelerated."""
    found = replace(result.tracked_features)
    vars(found)["secure"] = np.arange(len(found)) != 1
    first, *others = result.tracked_features.motions
    bent = replace(first, acceleration=np.array([1.0, 0.0]))
    vars(found)["motions"] = (bent, *others)
    return found


def dots(ax):
    """Positions that are drawn, shape (2, n)."""
    own = [line for line in ax.lines if line.get_marker() == "o"]
    return np.concatenate([line.get_xydata() for line in own]).T


def lines_of(ax, gid):
    return [line for line in ax.lines if line.get_gid() == gid]


def test_paths_over_the_mean_image_and_published_ones(features):
    cube = features.cube
    (ax,) = plot_tracks(features, unit=u.mas).axes
    x, y = dots(ax)
    assert x == pytest.approx(features.positions["ra_offset"].value)
    assert y == pytest.approx(features.positions["dec_offset"].value)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert np.all((x < left) & (x > right) & (y > bottom) & (y < top))
    later = Time([*cube.times[:3].jyear, cube.times[-1].jyear + 9], format="jyear")
    published = QTable({"published": [7] * 4, "date": later})
    for name in ("separation", "ra_offset", "dec_offset"):
        published[name] = np.arange(1.0, 5.0) * u.mas
    # Of the time of the images.
    ax = plot_tracks(features, published=published, unit=u.mas).axes[0]
    assert list(lines_of(ax, "published 7")[0].get_xdata()) == [1, 2, 3]
    plot_separation(features, published=published)
    nothing = features.detections.select(np.zeros(len(features.detections), bool))
    core = features.core.select(np.zeros(len(features.core), bool))
    for plot in (plot_separation, plot_tracks):
        plot(replace(features, detections=nothing, core=core, tracks=()))


def test_dashes_lead_to_the_ejections(features, monkeypatch):
    all_of_them = partial(ejections, earlier=20.0)
    monkeypatch.setattr(f"{MODULE}.ejections", all_of_them)
    upper, _ = plot_separation(features).axes
    years, fwhm = features.cube.times.jyear, features.detections.fwhm
    secure = itertools.compress(features.motions, features.secure)
    known = sorted(m.ejection(features.core_error, fwhm)[0] for m in secure)
    known = [date for date in known if date >= years[0] - 20 * np.ptp(years)]
    drawn = [line.get_data() for line in lines_of(upper, "ejection")]
    assert sorted(x[0] for x, _ in drawn) == pytest.approx(known)
    assert all(y[0] == 0 for _, y in drawn)
    assert drawn


def test_streams_of_no_known_speed_or_error_are_drawn(result):
    rows = result.streams[:1].copy()
    for name in ("pm_parallel_err", "pm_ra_cosdec", "pm_dec"):
        rows[name] = np.nan * rows[name].unit
    for kind in ("diagram", "velocity_map", "paper"):
        result.plot(kind, components=rows).draw_without_rendering()
