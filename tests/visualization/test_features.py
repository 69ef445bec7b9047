# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Figures of the features of a result show the speeds and components of its table."""

import astropy.units as u
import numpy as np
import pytest
from matplotlib.colors import to_hex

from astro_scc.flow import feature_profile
from astro_scc.units import PM_UNIT
from astro_scc.visualization import style
from astro_scc.visualization.features import plot_feature_speeds
from astro_scc.visualization.tracks import plot_separation, plot_tracks


def labels_of(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_speeds_are_radial(result):
    table = result.features
    figure = plot_feature_speeds(
        result, profile=feature_profile(result), beta_per_pm=4.5
    )
    ax = figure.axes[0]
    bars = ax.containers[: len(table)]
    shown = np.array([own.lines[0].get_xydata()[0] for own in bars])
    np.testing.assert_allclose(shown[:, 0], table["separation"].to_value(u.mas))
    np.testing.assert_allclose(shown[:, 1], table["pm_radial"].to_value(PM_UNIT))
    labels = labels_of(ax)
    assert len(set(labels)) == len(labels)
    assert labels[0] == "mean of bin"


@pytest.mark.parametrize("plot", [plot_separation, plot_tracks])
def test_colours_are_of_the_components(plot, result, monkeypatch):
    tracked = result.tracked_features
    component = np.arange(len(tracked)) % 3
    ax = plot(tracked, component=component).axes[0]
    assert sorted(labels_of(ax)) == ["no stream", "stream 1", "stream 2"]
    colors = style.BLACK, style.component_color(1), style.component_color(2)
    lines = [line for line in ax.lines if line.get_marker() == "o"]
    shown = [to_hex(line.get_color()).upper() for line in lines]
    assert shown == [colors[k] for k in component]
    # Of many features only those that are secure have numbers.
    monkeypatch.setattr("astro_scc.visualization.tracks.CROWDED", 2)
    monkeypatch.setitem(vars(tracked), "secure", component == 1)
    ax = plot(tracked).axes[0]
    numbers = [text.get_text() for text in ax.texts if text.get_text()]
    assert set(numbers) == {str(k) for k in tracked.number[component == 1]}


def test_figures_without_features(bare):
    assert len(plot_feature_speeds(bare).axes[0].containers) == 0
