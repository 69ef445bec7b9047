# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The figures of features show the tables: positions, fits, speeds and looks."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from matplotlib.colors import to_hex

from astro_scc.flow import feature_profile
from astro_scc.units import PM_UNIT
from astro_scc.visualization import (
    plot_feature_paths,
    plot_feature_separations,
    plot_feature_speeds,
)
from astro_scc.visualization.features import PALE


@pytest.fixture
def result(results):
    """Of features of which two are not secure."""
    result = replace(results["jet"])
    table = result.features.copy()
    table["secure"] = True
    table["secure"][[1, 3]] = False
    object.__setattr__(result, "features", table)
    return result


@pytest.fixture
def positions(result):
    """Tables of the positions of each feature."""
    return list(result.feature_positions.group_by("feature").groups)


def numbers_of(ax):
    return [text.get_text() for text in ax.texts if text.get_text().isdigit()]


def test_paths_are_the_positions(result, positions):
    ax = plot_feature_paths(result, unit=u.uas).axes[0]
    dots, lines = (
        [line for line in ax.lines if (line.get_marker() == "o") == is_dots]
        for is_dots in (True, False)
    )
    assert len(dots) == len(lines) == len(positions)
    for line, own in zip(dots, positions, strict=True):
        offsets = [own[name].to_value(u.uas) for name in ("ra_offset", "dec_offset")]
        np.testing.assert_allclose(line.get_data(), offsets)
    for line, motion in zip(lines, result.tracked_features.motions, strict=True):
        if not motion.accelerated:
            slope = np.ptp(line.get_data(), axis=1)
            assert slope[0] * abs(motion.velocity[1]) == pytest.approx(
                slope[1] * abs(motion.velocity[0]), rel=1e-6
            )
    pale = [to_hex(line.get_color()) == PALE.lower() for line in lines]
    assert np.flatnonzero(pale).tolist() == [1, 3]
    assert numbers_of(ax) == [str(n) for n in result.features["feature"]]
    # East is to the left.
    assert np.diff(ax.get_xlim()) < 0


def test_separations_are_those_of_the_positions(result, positions):
    ax = plot_feature_separations(result).axes[0]
    lines = [line for line in ax.lines if line.get_linestyle() == "-"]
    points = [bars.lines[0].get_data() for bars in ax.containers]
    assert len(lines) == len(positions)
    for k, own in enumerate(positions):
        separation = np.hypot(own["ra_offset"].value, own["dec_offset"].value)
        # Positions that were used, and the others.
        shown = np.concatenate(points[2 * k : 2 * k + 2], axis=1)
        order = np.argsort(shown[0])
        np.testing.assert_allclose(shown[0][order], own["date"].jyear, atol=0.003)
        np.testing.assert_allclose(shown[1][order], separation)
        assert len(points[2 * k][0]) == np.sum(own["used"])
        motion = result.tracked_features.motions[k]
        fit = separation - lines[k].get_ydata()
        assert np.abs(fit).max() <= np.hypot(*motion.residual.T).max() + 1e-9
    assert numbers_of(ax) == [str(n) for n in result.features["feature"]]
    assert ax.get_ylabel() == "Core separation (mas)"


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
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert len(set(labels)) == len(labels)
    assert labels[-1] == "mean of bin"
    assert "1: moving" in labels


def test_of_many_features_the_secure_ones_have_numbers(result, monkeypatch):
    monkeypatch.setattr("astro_scc.visualization.features.CROWDED", 3)
    table = result.features
    secure = [str(n) for n in table["feature"][table["secure"]]]
    assert 3 < len(secure) < len(table)
    for plot in (plot_feature_paths, plot_feature_separations):
        assert numbers_of(plot(result).axes[0]) == secure


def test_figures_without_features(bare):
    for plot in (plot_feature_paths, plot_feature_separations, plot_feature_speeds):
        assert numbers_of(plot(bare).axes[0]) == []
