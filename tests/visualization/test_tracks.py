# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Figures of features: separations, paths, ejections and published ones."""

import itertools
from dataclasses import replace
from functools import partial

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time
from matplotlib.colors import to_hex
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure

from astro_scc import EpochCube
from astro_scc.visualization import style
from astro_scc.visualization.tracks import PALE, ejections, plot_separation, plot_tracks

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


def names(ax):
    return {text.get_text() for text in ax.texts} - {""}


def test_separations_fits_and_residuals(features):
    ax, lower = plot_separation(features, unit=u.uas, beta_per_pm=10.0).axes
    table, d = features.positions, features.detections
    time, distance = dots(ax)
    wanted = np.hypot(table["ra_offset"], table["dec_offset"]).to_value(u.uas)
    assert distance == pytest.approx(wanted)
    assert time == pytest.approx(table["date"].jyear)
    fits = [k for k in ax.lines if k.get_marker() == "None" and not k.get_gid()]
    pale = [PALE["alpha"] if k == 1 else 1.0 for k in range(len(features))]
    assert [line.get_alpha() for line in fits] == pale

    def separation(m, time):
        dt = (np.asarray(time) - m.date)[..., None]
        path = m.velocity * dt + np.nan_to_num(m.acceleration) * dt**2 / 2
        return 1000 * np.hypot(*np.moveaxis(m.place + path, -1, 0))

    left = []
    for line, track, m in zip(fits, features.tracks, features.motions, strict=True):
        own, (time, distance) = track.detection, line.get_data()
        assert distance[-1] == pytest.approx(separation(m, time[-1]))
        left.extend(1000 * np.hypot(*d.place[own].T) - separation(m, d.time[own]))
    assert dots(lower)[1] == pytest.approx(np.array(left), abs=1e-6)
    # Secure features have their speeds beside their numbers.
    facts = zip(features.number, features.motions, features.secure, strict=True)
    wanted = {f"{n} ({10 * m.speed:.0f} c)" if sure else f"{n}" for n, m, sure in facts}
    assert set() < names(ax) <= wanted
    assert plot_separation(features, ax=Figure().add_subplot()).axes[1:] == []


def test_paths_over_the_mean_image(features):
    (ax,) = plot_tracks(features, unit=u.mas).axes
    x, y = dots(ax)
    assert x == pytest.approx(features.positions["ra_offset"].value)
    assert y == pytest.approx(features.positions["dec_offset"].value)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert np.all((x < left) & (x > right) & (y > bottom) & (y < top))
    # Contours double from three times the noise of the mean on.
    (contours,) = (k for k in ax.collections if isinstance(k, QuadContourSet))
    cube = features.cube
    noise = np.median(cube.noise_rms().value) / np.sqrt(len(cube))
    assert contours.levels[0] == pytest.approx(3 * noise)
    assert contours.levels[1:] / contours.levels[:-1] == pytest.approx(2.0)


@pytest.mark.parametrize("plot", [plot_separation, plot_tracks])
def test_numbers_do_not_overlap_and_colours_are_of_the_components(plot, features):
    component = np.arange(len(features)) % 3
    ax = plot(features, stream=component).axes[0]
    frame = ax.get_window_extent()
    boxes = [text.get_window_extent() for text in ax.texts if text.get_text()]
    assert all(frame.x0 < box.x0 < box.x1 < frame.x1 for box in boxes)
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    said = [text.get_text() for text in ax.get_legend().get_texts()]
    assert said == ["stream 1", "stream 2", "no stream"]
    # Each as its secure features.
    assert {line.get_alpha() for line in ax.get_legend().get_lines()} <= {1.0, None}
    colors = style.BLACK, style.component_color(1), style.component_color(2)
    lines = [line for line in ax.lines if line.get_marker() == "o"]
    shown = [to_hex(line.get_color()).upper() for line in lines]
    assert shown == [colors[k] for k in component]
    nothing = features.detections.select(np.zeros(len(features.detections), bool))
    core = features.core.select(np.zeros(len(features.core), bool))
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


def test_published_features_are_grey_and_of_the_time_of_the_images(features):
    times = features.cube.times
    later = np.array([*times[:3].jyear, times[-1].jyear + 9])
    one = np.arange(1.0, 5.0) * u.mas
    published = QTable({
        "published": [7] * 4, "date": Time(later, format="jyear"), "separation": one,
        "ra_offset": -one, "dec_offset": 0 * one,
    })  # fmt: skip
    own = {"published": published, "unit": u.mas}
    ax = plot_separation(features, ax=Figure().add_subplot(), **own).axes[0]
    (line,) = lines_of(ax, "published 7")
    assert line.get_color() == style.GREY
    assert list(line.get_ydata()) == [1, 2, 3]
    assert line.get_xdata() == pytest.approx(later[:3])
    (line,) = lines_of(plot_tracks(features, **own).axes[0], "published 7")
    assert list(line.get_xdata()) == [-1, -2, -3]


@pytest.mark.parametrize(
    ("step", "label", "first"),
    [
        (0.2 * u.yr, "Year", 2020.0),
        (1 * u.d, "MJD", 58849.5),
        (2 * u.h, "Hours since 2020-01-01 00:00 UTC", 12.0),
    ],
)
def test_dates_have_the_unit_of_the_series(cube, step, label, first):
    times = Time("2020-01-01T12:00:00") + np.arange(4) * step
    how = {"pixel_scale": cube.pixel_scale, "beams": cube.beams[0]}
    ax = Figure().add_subplot()
    to_axis = style.date_axis(ax, EpochCube.from_arrays(cube.data[:4], times, **how))
    ends = to_axis(times.jyear[[0, -1]])
    assert ax.get_xlabel() == label
    assert ends == pytest.approx([first, first + 3 * step.value], abs=2e-3)
    low, high = ax.get_xlim()
    assert low < ends[0] < ends[1] < high
