# Licensed under a 3-clause BSD style license - see LICENSE.rst

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time

from astro_scc import EpochCube
from astro_scc.stacking.velocities import baseline_pairs
from astro_scc.visualization.epochs import plot_intervals


def cube_of(days):
    times = Time("2000-01-01") + np.asarray(days) * u.day
    return EpochCube.from_arrays(
        np.ones((len(days), 8, 8)), times, pixel_scale=0.1 * u.mas
    )


def bars(figure):
    found = [c for c in figure.axes[0].collections if c.get_gid() == "pairs"]
    return np.array(found[0].get_segments())


@pytest.mark.parametrize(
    ("days", "unit", "longest"),
    [
        ([0, 100, 900], "yr", 800 / 365.25),
        ([0, 10, 40], "d", 30),
        ([0, 0.1, 0.4], "h", 7.2),
        ([0, 0.01, 0.02], "min", 14.4),
    ],
)
def test_consecutive_epochs_are_bars_as_high_as_their_interval(days, unit, longest):
    cube = cube_of(days)
    figure = plot_intervals(cube)
    drawn = bars(figure)
    assert drawn.shape == (2, 2, 2)
    assert drawn[:, :, 1].max() == pytest.approx(longest)
    np.testing.assert_allclose(drawn[:, 0, 0], cube.times.plot_date[:-1])
    np.testing.assert_allclose(drawn[:, 1, 0], cube.times.plot_date[1:])
    assert figure.axes[0].get_ylabel() == f"Time between epochs ({unit})"
    figure.draw_without_rendering()


def test_any_pairs_are_drawn():
    cube = cube_of(np.arange(30) * 20)
    pairs = baseline_pairs(cube.years.value, 0.2, 0.8)
    assert len(pairs) > 60
    figure = plot_intervals(cube, pairs)
    assert len(bars(figure)) == len(pairs)
    figure.draw_without_rendering()


def test_one_epoch_has_no_pairs():
    figure = plot_intervals(cube_of([0]))
    assert len(bars(figure)) == 0
    figure.draw_without_rendering()
