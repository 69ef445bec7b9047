# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What every figure keeps to, and what those of streams and of features show."""

from dataclasses import replace
from io import BytesIO

import astropy.units as u
import matplotlib
import numpy as np
import pytest
from astropy.table import QTable
from matplotlib.figure import Figure

from astro_scc.units import PM_UNIT
from astro_scc.visualization import FIGURES, style
from astro_scc.visualization.tracks import plot_separation, plot_tracks

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


def test_files_have_fonts_that_journals_take(result, monkeypatch):
    monkeypatch.setattr(style, "DPI", 20)
    before = dict(matplotlib.rcParams)
    files = style.figure_files(("significance",), result.plot, pdf=True)
    assert list(files) == ["significance.png", "significance.pdf"]
    assert b"/Type3" not in files["significance.pdf"]
    assert b"/FontFile2" in files["significance.pdf"]
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("frame", ["jet", "sky", "radial"])
def test_the_red_ridge_is_that_of_the_stream(frame, jet_results):
    # Features that move to the west: down the jet, and towards PA 270 deg.
    figure = jet_results[frame].plot("diagram")
    speed = jet_results[frame].streams["pm"][0].to_value(PM_UNIT)
    (mesh,) = (part for part in figure.findobj() if part.get_gid() == "excess")
    coordinates, values = mesh.get_coordinates(), mesh.get_array()
    interval = coordinates[0, :-1, 0] + np.diff(coordinates[0, :, 0]) / 2
    middle = coordinates[:-1, 0, 1] + np.diff(coordinates[:, 0, 1]) / 2
    moved = speed * interval < 1.5
    assert moved.any()
    peaks = middle[values.argmax(axis=0)][moved]
    np.testing.assert_allclose(peaks, speed * interval[moved], atol=0.2)


def test_features_are_drawn_with_published_ones_and_if_there_are_none(result):
    """One of them is not secure, and one is accelerated."""
    features, cube = replace(result.tracked_features), result.cube
    first, *others = result.tracked_features.motions
    bent = replace(first, acceleration=np.array([1.0, 0.0]))
    secure = np.arange(len(features)) != 1
    vars(features).update({"secure": secure, "motions": (bent, *others)})
    published = QTable({"published": [7] * 3, "date": cube.times[:3] + 0 * u.d})
    for name in ("separation", "ra_offset", "dec_offset"):
        published[name] = np.arange(1.0, 4.0) * u.mas
    for plot in (plot_separation, plot_tracks):
        plot(features, published=published).draw_without_rendering()
    nothing = features.detections.select(np.zeros(len(features.detections), bool))
    core = features.core.select(np.zeros(len(features.core), bool))
    for plot in (plot_separation, plot_tracks):
        plot(replace(features, detections=nothing, core=core, tracks=()))


def test_streams_of_no_known_speed_or_error_are_drawn(result):
    rows = result.streams[:1].copy()
    for name in ("pm_parallel_err", "pm_ra_cosdec", "pm_dec"):
        rows[name] = np.nan * rows[name].unit
    for kind in ("diagram", "velocity_map", "paper"):
        result.plot(kind, components=rows).draw_without_rendering()
