# Licensed under a 3-clause BSD style license - see LICENSE.rst

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from matplotlib.figure import Figure

from astro_scc.tracking import FeatureTracker
from astro_scc.visualization import plot_separation, plot_track_profile, plot_tracks

PM = u.mas / u.yr


@pytest.fixture(scope="module")
def tracking(matched):
    tracker = FeatureTracker(max_speed=30 * PM)
    return tracker(matched.cube, matched.decompositions)


@pytest.fixture(scope="module")
def nothing(matched):
    tracker = FeatureTracker(max_speed=30 * PM, max_interval=0.001 * u.yr)
    return tracker(matched.cube, matched.decompositions)


@pytest.mark.slow
@pytest.mark.parametrize("plot", [plot_separation, plot_tracks])
def test_a_panel_a_scale(tracking, plot):
    figure = plot(tracking)
    assert len(figure.axes) == 3
    for scale, ax in zip((1, 2, 3), figure.axes, strict=True):
        number = np.sum(tracking.tracks["scale"] == scale)
        text = ax.texts[-1].get_text()
        assert text.startswith(f"scale {scale} ")
        assert f" {number} track" in text
    figure.draw_without_rendering()


def test_distances_are_those_of_the_features(tracking):
    ax = plot_separation(tracking, unit=u.uas).axes[0]
    features = tracking.features[tracking.features["scale"] == 1]
    dots = [line for line in ax.lines if line.get_marker() == "o"]
    drawn = np.concatenate([line.get_ydata() for line in dots])
    assert np.sort(drawn) == pytest.approx(np.sort(features["r"].to_value(u.uas)))


def test_short_tracks_can_be_left_out(tracking):
    figure = plot_tracks(tracking, min_epochs=99)
    assert all("0 tracks" in ax.texts[-1].get_text() for ax in figure.axes)
    own = Figure()
    assert plot_separation(tracking, figure=own, min_epochs=4) is own


@pytest.mark.slow
@pytest.mark.parametrize("plot", [plot_separation, plot_tracks])
def test_nothing_is_drawn_of_nothing(nothing, plot):
    plot(nothing).draw_without_rendering()


@pytest.mark.parametrize("plot", [plot_separation, plot_tracks])
def test_units_must_be_angles(tracking, plot):
    with pytest.raises(ValueError, match="unit must be an angle"):
        plot(tracking, unit="s")


def test_the_profile_of_the_stack_lies_over_that_of_tracks(tracking):
    profile = tracking.profile([2, 4, 6, 8] * u.mas)
    stack = QTable(
        {"r_mid": [3, 5] * u.mas, "pm_parallel": [6, 7] * PM,
         "pm_parallel_err": [0.5, 0.5] * PM}
    )  # fmt: skip
    figure = plot_track_profile(profile, stack=stack, beta_per_pm=2.0)
    figure.draw_without_rendering()
    (second,) = figure.axes[0].child_axes
    assert second.get_ylabel() == "Apparent speed (c)"
    limits = np.multiply(figure.axes[0].get_ylim(), 2.0)
    np.testing.assert_allclose(second.get_ylim(), limits)
    with pytest.raises(ValueError, match="beta_per_pm must be positive, got 0"):
        plot_track_profile(profile, beta_per_pm=0)
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels == ["tracks", "stack"]
    stack["r_min"], stack["r_max"] = [2, 4] * u.mas, [4, 6] * u.mas
    plot_track_profile(profile, stack=stack).draw_without_rendering()
    del stack["r_mid"]
    with pytest.raises(ValueError, match="the profile of the stack has no r_mid"):
        plot_track_profile(profile, stack=stack)
