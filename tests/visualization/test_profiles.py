# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speed against distance, and what lies beside it."""

from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

from astro_scc.stacking.velocities import VelocityGrid
from astro_scc.visualization.profiles import (
    plot_position_angles,
    plot_profile,
    plot_scale_maps,
)
from astro_scc.visualization.style import BLUE

PM = u.mas / u.yr
WEST = SimpleNamespace(
    at=lambda s: (-s, 0 * s), position_angle=lambda s: np.full(len(s), 270) * u.deg
)


@pytest.fixture
def table():
    return QTable(
        {
            "r_min": [0, 1, 2] * u.mas,
            "r_max": [1, 2, 3] * u.mas,
            "r_mid": [0.5, 1.5, 2.5] * u.mas,
            "kind": ["moving", "not significant", "stationary"],
            "main": [True, False, True],
            "pm_parallel": [1.0, 1.2, 0.0] * PM,
            "pm_parallel_err": [0.1, 9.0, np.inf] * PM,
        }
    )


def test_components_fits_and_others_have_names(table, cube):
    def fit(r):
        return np.full(len(r), 1.0) * PM

    fit.model = "constant"
    figure = plot_profile(
        table, cube=cube, line=WEST, fits=[fit], beta_per_pm=2.0,
        others=[("MOJAVE", [4] * u.mas, [1] * PM, [0.1] * PM)],
    )  # fmt: skip
    figure.draw_without_rendering()
    strip, ax = figure.axes
    assert strip.images
    labels = {text.get_text() for text in ax.get_legend().get_texts()}
    wanted = {"moving", "not significant", "stationary", "constant", "MOJAVE"}
    assert labels == wanted
    # The farthest is that of others; the large error does not squeeze the rest.
    assert ax.get_xlim()[1] == pytest.approx(1.02 * 4)
    assert ax.get_ylim()[1] < 2
    plot_profile(table[:0]).draw_without_rendering()


def test_only_what_is_not_significant_has_open_symbols(table):
    table["kind"][1] = "moving"
    (ax,) = plot_profile(table).axes
    dots = [line for line in ax.lines if line.get_marker() == "o"]
    assert [line.get_markerfacecolor() for line in dots] == 2 * [BLUE]
    # Those that do not represent their bin are smaller.
    assert [line.get_markersize() for line in dots] == [5, 3]
    assert {line.get_alpha() for line in dots} == {None}


def test_without_features_there_is_no_speed(table):
    table["n_features"] = [0, 2, 1]
    (ax,) = plot_profile(table).axes
    labels = {text.get_text() for text in ax.get_legend().get_texts()}
    assert labels == {"not significant", "stationary"}


def test_images_without_beams_have_a_strip(table, cube):
    plain = replace(cube, beams=None)
    assert plot_profile(table, cube=plain, line=WEST).axes[0].images


def test_maps_have_their_peaks():
    grid = VelocityGrid.covering(2.0, 0.5)
    values = np.zeros(grid.shape)
    values[1, 2] = 1.0
    figure = plot_scale_maps({"a": values, "b": values, "c": 0 * values}, grid)
    lines = [line for ax in figure.axes for line in ax.lines]
    marks = [line for line in lines if line.get_marker() == "+"]
    assert len(marks) == 2
    assert marks[0].get_xydata()[0] == pytest.approx([grid.v1[2], grid.v2[1]])
    assert not figure.axes[3].axison
    with pytest.raises(ValueError, match="maps must hold one map or more"):
        plot_scale_maps({}, grid)


def test_histograms_are_shares_of_each_group():
    figure = plot_position_angles({"a": [240, 250, 251] * u.deg, "b": [] * u.deg})
    (ax,) = figure.axes
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["a: 3 SSPs", "b: 0 SSPs"]
    plot_position_angles({}).draw_without_rendering()
