# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features that speed up, that slow down, and that do neither."""

import astropy.units as u
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import kstest

from astro_scc.flow.speeds import BLENDS, fit_gradient
from astro_scc.streams import SearchSettings
from astro_scc.streams.dispersion import scattered_fit
from astro_scc.streams.features import Feature

YEARS, BEAM = np.arange(8.0), 1 * u.mas


def feature(start, gradient, *, speed=0.5, noise=0.0, years=YEARS, rng=None, way=1):
    """``dx/dt = speed + gradient (x - 6)``, from a place where it begins."""
    if gradient:
        ratio = speed / gradient
        along = (start - 6 + ratio) * np.exp(gradient * years) - ratio + 6
    else:
        along = start + speed * years
    place = np.stack([way * along, np.zeros(len(years))], axis=1)
    if noise:
        place += noise * rng.normal(size=place.shape)
    settings = SearchSettings(position_error=max(noise, 0.01))
    return Feature.through(*[np.arange(len(years))] * 2, years, place, settings)


def flow(gradient, **options):
    return [feature(start, gradient, **options) for start in (2.5, 4.0, 5.5, 7.0, 8.5)]


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("gradient", [0.06, -0.06])
def test_the_gradient_of_a_flow(gradient, way):
    found = fit_gradient(flow(gradient, way=way), BEAM)
    assert found.p_value < 0.01
    # Parabolas and mean speeds of exponentials: to a tenth.
    assert found.gradient.value == pytest.approx(gradient, rel=0.1)
    assert found.speed > 0
    assert found.centre > 0
    assert found.n_features == 5
    # Blends leave so much.
    assert (found.gradient_err / found.speed).value >= BLENDS * (1 - 1e-9)


@pytest.mark.slow
def test_p_values_are_at_most_even():
    """Features of 15% dispersion without acceleration."""
    rng, p = np.random.default_rng(3), []
    for _ in range(200):
        speeds = rng.normal(0.5, 0.08, 6)
        starts = rng.uniform(2.5, 9, 6)
        features = [
            feature(x, 0.0, speed=v, noise=0.05, rng=rng)
            for x, v in zip(starts, speeds, strict=True)
        ]
        p.append(fit_gradient(features, BEAM).p_value)
    # Less than even only by what is left to blends.
    assert kstest(p, "uniform", alternative="greater").pvalue > 1e-3


@pytest.mark.parametrize(
    ("features", "known"),
    [
        ([], False),
        (flow(0.05)[:1], False),
        # The bends of two, over eight epochs.
        (flow(0.05)[:2], True),
        # Too short to be bent, and three speeds only.
        (flow(0.05, years=YEARS[:4])[:3], False),
        (flow(0.05, years=YEARS[:4])[:4], True),
    ],
)
def test_what_few_features_tell(features, known):
    found = fit_gradient(features, BEAM)
    assert np.isfinite(found.p_value) == known
    assert found.n_features == len(features)


def test_features_within_two_beams_are_the_cores():
    two = [feature(start, 0.0, speed=0.05) for start in (1.7, 1.9)]
    # Their mean places are 1.875 and 2.075.
    assert fit_gradient(two, BEAM).n_features == 1


def test_the_acceleration_of_a_feature():
    place = np.stack([0.5 * YEARS + 0.03 * YEARS**2, 0 * YEARS], axis=1)
    found = Feature.through(*[np.arange(8)] * 2, YEARS, place)
    assert found.acceleration == pytest.approx(0.06)
    # As polyfit says of residuals of 0.06, of which the prior is three of eight.
    _, covariance = np.polyfit(YEARS, place[:, 0], 2, cov="unscaled")
    expected = 2 * np.sqrt(covariance[0, 0]) * 0.06 * np.sqrt(3 / 8)
    assert found.acceleration_error == pytest.approx(expected)
    short = Feature.through(*[np.arange(4)] * 2, YEARS[:4], place[:4])
    assert np.isnan(short.acceleration)


def test_a_line_through_values_that_scatter():
    """The scatter makes the sum of squares what is expected of it."""
    rng = np.random.default_rng(4)
    x, error = np.arange(9.0), np.full(9, 0.05)
    y = 2 + 0.3 * x + 0.4 * rng.normal(size=9)
    design = np.stack([np.ones(9), x], axis=1)
    found, covariance, tau, weight = scattered_fit(design, y, error)
    # Equal errors: least squares.
    slope, offset = np.polyfit(x, y, 1)
    assert_allclose(found, [offset, slope])
    _, expected = np.polyfit(x, y, 1, cov=True)
    assert_allclose(covariance[1, 1], expected[0, 0])
    left = y - design @ found
    assert (left**2 / (tau**2 + error**2)).sum() == pytest.approx(7)
    assert_allclose(weight, 1 / (tau**2 + error**2))
