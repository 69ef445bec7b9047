# Licensed under a 3-clause BSD style license - see LICENSE.rst

import itertools
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from matplotlib.figure import Figure

from astro_scc.features import find_features
from astro_scc.simulation import simulate_jet
from astro_scc.visualization import plot_separation, plot_tracks


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
    lines = [line for line in ax.lines if line.get_marker() != "o"]
    alpha = [line.get_alpha() for line in lines]
    assert alpha == [0.5 if k == 1 else 1.0 for k in range(len(features))]
    assert [line.get_linestyle() for line in lines].count(":") == 1
    figure.draw_without_rendering()


def test_lines_are_the_fitted_motions(features):
    ax = plot_separation(features, unit=u.mas).axes[0]
    lines = [line for line in ax.lines if line.get_marker() != "o"]
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


@pytest.mark.parametrize("plot", [plot_separation, plot_tracks])
def test_nothing_is_drawn_of_nothing(features, plot):
    nothing = features.detections.select(np.zeros(len(features.detections), bool))
    core = features.core.select(np.zeros(len(features.core), bool))
    empty = replace(features, detections=nothing, core=core, tracks=())
    plot(empty).draw_without_rendering()


@pytest.mark.parametrize("plot", [plot_separation, plot_tracks])
def test_units_must_be_angles(features, plot):
    with pytest.raises(ValueError, match="unit must be an angle"):
        plot(features, unit="s")
