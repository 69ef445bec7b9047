# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What figures keep to, and what those of streams, features and images show."""

import re
from dataclasses import replace
from functools import partial
from io import BytesIO
from types import SimpleNamespace

import astropy.units as u
import matplotlib
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time
from matplotlib.colors import AsinhNorm, LogNorm
from matplotlib.figure import Figure

from astro_scc import EpochCube
from astro_scc.flow import fit_profile
from astro_scc.units import PM_UNIT, offset_unit, speed_unit
from astro_scc.units import PM_UNIT as PM
from astro_scc.visualization import FIGURES, speeds, style, tracks
from astro_scc.visualization.images import epoch_names, ticks_of
from astro_scc.visualization.speeds import plot_profile
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
    ("spectrum", {"ax": None}, "several axes: give figure=, not ax="),
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


def test_features_are_drawn_with_published_ones_or_none(result, monkeypatch):
    """One of them is not secure, one is accelerated, and all were ejected."""
    name = "astro_scc.visualization.tracks.ejections"
    monkeypatch.setattr(name, partial(ejections, earlier=20.0))
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


def small_cube(**kwargs):
    data = np.random.default_rng(1).standard_normal((3, 20, 30))
    data[:, 5, 7] = 100
    times = ["2000-01-01", "2000-07-01", "2001-01-01"]
    values = {"data": data, "times": times, "pixel_scale": 0.1 * u.mas, **kwargs}
    return EpochCube.from_arrays(**values)


def test_brightness_has_limits_unit_and_ticks_that_fit():
    mask = np.zeros((3, 20, 30), bool)
    mask[0, :5, :5] = True
    data = np.where(mask, 1e6, 1.0)
    ax = small_cube(data=data, mask=mask, unit="Jy / beam").plot(0).axes[0]
    (drawn,) = ax.images
    assert np.ma.getmaskarray(drawn.get_array()).sum() == 25
    assert drawn.norm.vmin < drawn.norm.vmax < 1e6
    for value in (0.0, -1.0):
        (drawn,) = small_cube(data=np.full(mask.shape, value)).plot(0).axes[0].images
        assert drawn.norm.vmin < drawn.norm.vmax
    ax = small_cube().plot(0, norm=LogNorm(vmin=0.5), colorbar=False).axes[0]
    assert ax.images[0].norm.vmax == 100
    with pytest.raises(TypeError, match="norm must be one of matplotlib.colors, got"):
        small_cube().plot(0, norm="log")
    assert ticks_of(AsinhNorm(0.004, vmin=-1e-3, vmax=3)) == [0, 0.01, 0.1, 1]
    assert ticks_of(AsinhNorm(0.4, vmin=-1, vmax=3)) is None


def test_the_sun_has_west_to_the_right(jet_results, with_cube):
    sky, wcs = jet_results["sky"], jet_results["sky"].cube.wcs.deepcopy()
    wcs.wcs.ctype = "HPLN-TAN", "HPLT-TAN"
    sun = with_cube(sky, replace(sky.cube, wcs=wcs))
    ssps = sun.ssps.copy()
    ssps["in_region"] = ssps["lat_offset"].value > 0
    assert not sun.cube.plot(0, ssps).axes[0].xaxis_inverted()
    ax, other = (result.plot("velocity_map").axes[0] for result in (sun, sky))
    assert (ax.xaxis_inverted(), other.xaxis_inverted()) == (False, True)
    assert list(sun.velocity_map().wcs.wcs.ctype) == ["LON", "LAT"]


def test_units_and_dates_are_easily_read():
    units = {1e-4: "uas", 0.1: "mas", 60: "arcsec", 2e4: "arcmin", 2e6: "deg"}
    assert {scale: offset_unit(20 * scale) for scale in units} == units
    for span, resolution, interval, unit in (
        (12 * u.yr, 2 * u.arcsec, 1 * u.yr, u.arcsec / u.yr),
        (11 * u.d, 30 * u.mas, 1 * u.d, u.mas / u.d),
        (8 * u.h, 20 * u.uas, 2 * u.min, u.mas / u.h),
    ):
        assert speed_unit(span, resolution, interval) == unit
    for days, names in (
        ([0, 0.25], ["2000-01-01 00:00:00", "2000-01-01 06:00:00"]),
        ([0, 0], ["2000-01-01 (0)", "2000-01-01 (1)"]),
    ):
        assert epoch_names(Time("2000-01-01", scale="utc") + days * u.day) == names


WEST = SimpleNamespace(
    at=lambda s: (-s, 0 * s), position_angle=lambda s: np.full(len(s), 270) * u.deg
)


def test_components_fits_and_others_have_names(jet_cube):
    middle = [0.5, 1.5, 2.5] * u.mas
    table = QTable({
        "r_min": middle - 0.5 * u.mas, "r_max": middle + 0.5 * u.mas, "r_mid": middle,
        "kind": ["moving", "not significant", "stationary"],
        "main": [True, False, True], "n_features": [3, 2, 1],
        "pm_parallel": [1.0, 1.2, 0.0] * PM, "pm_parallel_err": [0.1, 9.0, np.inf] * PM,
    })  # fmt: skip
    fit = fit_profile([1, 2, 4] * u.mas, [1.0, 1.2, 1.6] * PM, [0.1] * 3 * PM)
    assert re.match(r"linear: 0.2\d* ± 0.0\d+ 1/yr$", str(fit))
    _, ax = plot_profile(
        table, cube=replace(jet_cube, beams=None), line=WEST, fits=[fit],
        beta_per_pm=2.0, others=[("MOJAVE", [4] * u.mas, [1] * PM, [0.1] * PM)],
    ).axes  # fmt: skip
    wanted = {"moving", "not significant", "stationary", str(fit), "MOJAVE"}
    assert {text.get_text() for text in ax.get_legend().get_texts()} == wanted
    # The large error does not squeeze the rest.
    assert ax.get_ylim()[1] < 2
    plot_profile(table[:0]).draw_without_rendering()
    table["scale_group"] = ["1, 2", "3", "3"]
    plot_profile(table, markersize=9, fits={"3": [fit]}).draw_without_rendering()
    angles = {"a": [350, 360, 371] * u.deg, "b": [] * u.deg}
    speeds.plot_position_angles(angles).draw_without_rendering()


def test_the_features_of_many_sources():
    """Outward, inward, stationary and accelerated ones, and a doubtful one."""
    table = QTable({"source": list("aabbb"), "n_epochs": [5, 12, 12, 12, 5]})
    table["secure"] = [True, True, False, True, False]
    table["p_false"] = [0.1, 0.1, 0.2, 0.1, 0.9]
    table["pm"], table["pm_radial"] = [1, 2, 0.1, 3, 9] * PM, [1, -2, 0, 3, 9] * PM
    for name in ("acc_parallel", "acc_perpendicular"):
        table[name] = [np.nan, np.nan, np.nan, 0.4, 0.4] * PM / u.yr
    for name in ("pm", "pm_radial", "acc_parallel", "acc_perpendicular"):
        table[f"{name}_err"] = np.full(5, 0.1) * table[name].unit
    table["beta_app"] = 10 * table["pm"].value
    found = {k: [*np.flatnonzero(use)] for k, use in tracks.population(table).items()}
    assert found == {
        "moving": [0, 1, 3], "at rest": [2], "inward": [1], "judged": [1, 3],
        "accelerated": [3],
    }  # fmt: skip
    assert tracks.fastest_of(table, "pm").tolist() == [2.0, 3.0]
    tracks.plot_population(table)
    table["beta_app"] = np.nan
    tracks.plot_population(table)
