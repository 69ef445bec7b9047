# Licensed under a 3-clause BSD style license - see LICENSE.rst

import itertools
import re
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure

from astro_scc import Beam, EpochCube
from astro_scc.features import find_features
from astro_scc.simulation import simulate_jet
from astro_scc.visualization import style
from astro_scc.visualization.epochs import plot_epochs
from astro_scc.visualization.tracks import plot_separation, plot_tracks


@pytest.fixture(scope="module")
def features():
    cube = simulate_jet(n_epochs=8, dispersion=0.1, rng=1).cube
    found = find_features(cube)
    # One of them is not secure, and one is accelerated.
    vars(found)["secure"] = np.arange(len(found)) != 1
    motion = found.motions[0]
    bent = replace(motion, acceleration=np.array([1.0, 0.0]))
    vars(found)["motions"] = (bent, *found.motions[1:])
    return found


def dots(ax):
    """Positions that are drawn."""
    own = [line for line in ax.lines if line.get_marker() == "o"]
    return np.concatenate([np.stack(line.get_data(), axis=1) for line in own])


def fits(ax):
    """Lines of the fitted motions."""
    return [k for k in ax.lines if k.get_marker() == "None" and not k.get_gid()]


def test_separations_are_those_of_the_positions(features):
    figure = plot_separation(features, unit=u.uas)
    ax = figure.axes[0]
    table = features.positions
    wanted = np.hypot(table["ra_offset"], table["dec_offset"]).to_value(u.uas)
    assert dots(ax)[:, 1] == pytest.approx(wanted)
    assert dots(ax)[:, 0] == pytest.approx(table["date"].jyear)
    assert {t.get_text() for t in ax.texts} <= {f"{k}" for k in features.number}
    boxes = [text.get_window_extent() for text in ax.texts]
    assert len(boxes) >= 3
    assert all(box.x1 <= ax.get_window_extent().x1 for box in boxes)
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
    lines = fits(ax)
    alpha = [line.get_alpha() for line in lines]
    assert alpha == [0.5 if k == 1 else 1.0 for k in range(len(features))]
    assert [line.get_linestyle() for line in lines].count(":") == 1
    figure.draw_without_rendering()


def test_lines_are_the_fitted_motions(features):
    ax = plot_separation(features, unit=u.mas).axes[0]
    lines = fits(ax)
    for line, motion in zip(lines, features.motions, strict=True):
        time, distance = line.get_data()
        dt = time[-1] - motion.date
        east, north = motion.place + motion.velocity * dt
        if motion.accelerated:
            east += dt**2 / 2
        assert distance[-1] == pytest.approx(np.hypot(east, north))


def test_paths_are_those_of_the_positions(features):
    own = Figure()
    assert plot_tracks(features, figure=own, unit=u.mas) is own
    (ax,) = own.axes
    table = features.positions
    assert dots(ax)[:, 0] == pytest.approx(table["ra_offset"].value)
    assert dots(ax)[:, 1] == pytest.approx(table["dec_offset"].value)
    left, right = ax.get_xlim()
    assert left > right
    own.draw_without_rendering()


def test_paths_and_numbers_are_within_the_frame(features):
    figure = plot_tracks(features, unit=u.mas)
    (ax,) = figure.axes
    figure.draw_without_rendering()
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    x, y = dots(ax).T
    assert np.all((x < left) & (x > right) & (y > bottom) & (y < top))
    frame = ax.get_window_extent()
    for text in (text for text in ax.texts if text.get_text()):
        box = text.get_window_extent()
        assert frame.x0 < box.x0 < box.x1 < frame.x1


@pytest.mark.parametrize("plot", [plot_separation, plot_tracks])
def test_of_many_features_those_of_most_epochs_have_numbers(
    features, monkeypatch, plot
):
    for name in ("CROWDED", "NAMED"):
        monkeypatch.setattr(f"astro_scc.visualization.tracks.{name}", 2)
    n = np.array([len(track) for track in features.tracks]) * features.secure
    longest = features.number[np.argsort(-n, kind="stable")[:2]]
    said = {text.get_text() for text in plot(features).axes[0].texts} - {""}
    assert said == {str(number) for number in longest}


def test_a_legend_has_each_stream_as_its_secure_features(features):
    component = np.where(np.arange(len(features)) < 2, 1, 0)
    legend = plot_tracks(features, component=component).axes[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == ["stream 1", "no stream"]
    # The second feature is pale.
    assert {line.get_alpha() for line in legend.get_lines()} == {1.0}


def test_a_narrow_figure_has_thin_lines(features):
    def sizes(figure):
        line = next(k for k in figure.axes[0].lines if k.get_marker() == "o")
        return np.array([line.get_markersize(), line.get_linewidth()])

    wide = sizes(plot_tracks(features))
    with style.for_journal():
        figure = plot_tracks(features)
        style.thin(figure)
    assert sizes(figure) == pytest.approx(wide * style.COLUMN / style.WIDTH)


@pytest.mark.parametrize("plot", [plot_separation, plot_tracks])
def test_nothing_is_drawn_of_nothing(features, plot):
    nothing = features.detections.select(np.zeros(len(features.detections), bool))
    core = features.core.select(np.zeros(len(features.core), bool))
    empty = replace(features, detections=nothing, core=core, tracks=())
    plot(empty).draw_without_rendering()


# -- for the literature ------------------------------------------------------------


def lines_of(ax, gid):
    return [line for line in ax.lines if line.get_gid() == gid]


def test_residuals_are_what_the_fits_leave(features):
    _, lower = plot_separation(features, unit=u.mas).axes
    d, wanted = features.detections, []
    for track, motion in zip(features.tracks, features.motions, strict=True):
        own = track.detection
        dt = (d.time[own] - motion.date)[:, None]
        bend = np.nan_to_num(motion.acceleration)
        place = motion.place + motion.velocity * dt + bend * dt**2 / 2
        wanted.extend(np.hypot(*d.place[own].T) - np.hypot(*place.T))
    assert dots(lower)[:, 1] == pytest.approx(np.array(wanted))


def test_dashes_lead_to_the_ejections(features, monkeypatch):
    monkeypatch.setattr("astro_scc.visualization.tracks.EARLIER", 20.0)
    upper, _ = plot_separation(features).axes
    t_ej = features.table["t_ej"].value
    first, last = features.cube.times.jyear[[0, -1]]
    known = features.secure & (t_ej >= first - 20.0 * (last - first))
    assert known.any()
    drawn = [line.get_data() for line in lines_of(upper, "ejection")]
    assert [x[0] for x, _ in drawn] == pytest.approx(t_ej[known])
    assert all(y[0] == 0 for _, y in drawn)
    assert upper.get_xlim()[0] < t_ej[known].min()


def test_speeds_stand_beside_the_numbers(features):
    upper, _ = plot_separation(features, beta_per_pm=10.0).axes
    texts = {text.get_text() for text in upper.texts}
    for number, motion, secure in zip(
        features.number, features.motions, features.secure, strict=True
    ):
        speed = f" ({10 * motion.speed:.2g} c)" if secure else ""
        assert texts & {f"{number}{speed}"}


def test_published_features_are_grey(features):
    times = features.cube.times
    later = np.array([*times[:3].jyear, times[-1].jyear + 9])
    published = QTable(
        {
            "published": [7, 7, 7, 7],
            "date": Time(later, format="jyear"),
            "separation": [1.0, 2.0, 3.0, 4.0] * u.mas,
            "ra_offset": [-1.0, -2.0, -3.0, -4.0] * u.mas,
            "dec_offset": [0.0, 0.0, 0.0, 0.0] * u.mas,
        }
    )
    upper, _ = plot_separation(features, published=published, unit=u.mas).axes
    (line,) = lines_of(upper, "published 7")
    assert line.get_color() == style.GREY
    # Only what is seen during the images.
    assert list(line.get_ydata()) == [1, 2, 3]
    assert line.get_xdata() == pytest.approx(later[:3])
    ax = plot_tracks(features, published=published, unit=u.mas).axes[0]
    (line,) = lines_of(ax, "published 7")
    assert list(line.get_xdata()) == [-1, -2, -3]


@pytest.mark.parametrize(
    ("step", "label", "first", "last"),
    [
        (0.2 * u.yr, "Year", 2020.0, 2020.6),
        (1 * u.d, "MJD", 58849.5, 58852.5),
        (2 * u.h, "Hours since 2020-01-01 00:00 UTC", 12.0, 18.0),
    ],
)
def test_dates_have_the_unit_of_the_series(features, step, label, first, last):
    times = Time("2020-01-01T12:00:00") + np.arange(4) * step
    cube = features.cube[:4]
    cube = EpochCube.from_arrays(
        cube.data, times, pixel_scale=cube.pixel_scale, beams=cube.beams
    )
    ax = Figure().add_subplot()
    on_axis = style.date_axis(ax, cube)
    assert ax.get_xlabel() == label
    assert on_axis(times.jyear[[0, -1]]) == pytest.approx([first, last], abs=2e-3)
    low, high = ax.get_xlim()
    assert low < on_axis(times.jyear[0]) < on_axis(times.jyear[-1]) < high


def test_contours_double_from_three_times_the_noise(features):
    ax = plot_tracks(features).axes[0]
    (contours,) = (k for k in ax.collections if isinstance(k, QuadContourSet))
    cube = features.cube
    noise = np.median(cube.noise_rms().value) / np.sqrt(len(cube))
    assert contours.levels[0] == pytest.approx(3 * noise)
    assert contours.levels[1:] / contours.levels[:-1] == pytest.approx(2.0)
    assert contours.levels[-1] <= np.nanmax(cube.mean_image().data)


def test_the_beam_and_the_date_lie_where_there_is_no_light():
    data = np.full((2, 40, 40), 1e-3)
    data[:, :9, :9] = data[:, -9:, -9:] = 1.0
    rng = np.random.default_rng(1)
    cube = EpochCube.from_arrays(
        data + rng.normal(0, 1e-4, data.shape), Time(["2000-01-01", "2001-01-01"]),
        pixel_scale=1 * u.mas, beams=Beam(2 * u.mas, 2 * u.mas),
    )  # fmt: skip
    for ax in plot_epochs(cube).axes[:2]:
        (beam,) = ax.patches
        x, y = ax.transAxes.inverted().transform(ax.transData.transform(beam.center))
        (text,) = ax.texts
        a, b = text.get_position()
        # East is to the left: light is in the lower left and the upper right.
        assert {(x > 0.5, y > 0.5), (a > 0.5, b > 0.5)} == {
            (True, False),
            (False, True),
        }


def test_figures_for_a_journal(features):
    import matplotlib

    before = dict(matplotlib.rcParams)
    figures = {
        "separation": lambda: plot_separation(features),
        "epochs": lambda: plot_epochs(features.cube),
    }
    files = style.figure_files(figures, pdf=True)
    assert set(files) == {f"{n}.{k}" for n in figures for k in ("png", "pdf")}
    assert dict(matplotlib.rcParams) == before
    for name, columns in (("separation", 1), ("epochs", 2)):
        pdf = files[f"{name}.pdf"]
        width = float(re.search(rb"/MediaBox \[ 0 0 ([\d.]+)", pdf)[1]) / 72
        assert width == pytest.approx(columns * style.COLUMN, abs=0.2)
        assert b"/Type3" not in pdf
        assert b"/FontFile2" in pdf
    with style.for_journal():
        assert plot_separation(features).axes[0].yaxis.label.get_fontsize() == 8
