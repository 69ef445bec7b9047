# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams fitted together to matches of which at most one of each SSP is true."""

from dataclasses import replace

import numpy as np
import pytest

from astro_scc.streams import SearchSettings
from astro_scc.streams.diagram import Rays, fit_mixture

YEARS = np.cumsum([0.0, 0.7, 0.5, 1.1, 0.7, 0.4, 1.2, 0.6])
RAYS = Rays.of(YEARS, 1.5, SearchSettings())


@pytest.fixture
def two(jet):
    streams = [(10, 0.3, 0.02), (6, 1.0, 0.05)]
    return jet(np.random.default_rng(0), YEARS, streams, length=16.0, chance=3)


def test_one_line_has_its_speed_and_its_matches(lines, axis_matches):
    d = axis_matches(*lines([0.5], [0.0], YEARS), YEARS)
    speed, match, membership, _ = fit_mixture(d, [0.6], RAYS)
    assert speed == pytest.approx([0.5], rel=1e-3)
    assert np.all(membership > 0.5)
    # Intervals after which it has left the search radius tell nothing.
    known = np.abs(0.6 * d.interval) <= 1.5
    np.testing.assert_array_equal(match, np.flatnonzero(known))


def test_speeds_are_unbiased_and_at_most_one_match_is_true(two):
    speed, match, membership, _ = fit_mixture(two, [0.3, 1.0], RAYS)
    assert speed == pytest.approx([0.3, 1.0], rel=0.05)
    # Of an SSP in an image.
    source = two.ssp[match] * len(YEARS) + two.target[match]
    assert np.bincount(source, membership.sum(axis=0)).max() <= 1
    assert np.all(membership >= 0)


def test_what_stands_still_is_of_no_stream(lines, axis_matches):
    d = axis_matches(*lines([0.0] * 6, 4.0 * np.arange(6), YEARS), YEARS)
    _, _, membership, _ = fit_mixture(d, [0.5], RAYS)
    assert membership.max() < 0.5


def test_without_matches_the_speeds_are_those_of_the_start(two):
    none = two.select(np.zeros(len(two), dtype=bool))
    speed, _, membership, _ = fit_mixture(none, [0.3, 1.0], RAYS)
    assert speed.tolist() == [0.3, 1.0]
    assert membership.shape == (2, 0)


def test_years_or_days_and_the_other_direction(two):
    found, *_ = fit_mixture(two, [0.3, 1.0], RAYS)
    days = replace(two, years=365.25 * two.years)
    rays = Rays.of(days.years, 1.5, SearchSettings())
    other, *_ = fit_mixture(days, np.array([0.3, 1.0]) / 365.25, rays)
    assert other * 365.25 == pytest.approx(found, rel=1e-6)
    back, *_ = fit_mixture(replace(two, d1=-two.d1), [-0.3, -1.0], RAYS)
    assert back == pytest.approx(-found, rel=1e-6)
