# Licensed under a 3-clause BSD style license - see LICENSE.rst
import numpy as np
import pytest

from astro_scc.correlation import Correlator, Matches, all_pairs
from astro_scc.correlation.matches import target_ssps
from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.simulation import simulate_two_fluid


@pytest.fixture(scope="module")
def epochs():
    cube = simulate_two_fluid(rng=3, n_epochs=3).cube
    return [Decomposer(scales=(1, 1.5, 2))(image) for image in cube.data]


@pytest.fixture(scope="module")
def matches(epochs):
    return Correlator(kappa=0.7)(epochs, all_pairs(3), (8, 25))


def test_same_as_sees_any_difference(matches):
    assert not matches.same_as(matches.select(slice(1, None)))
    changed = matches.select(np.arange(len(matches)))
    assert changed.same_as(matches)
    changed.dx[0] += 1
    assert not changed.same_as(matches)
    other = Matches.from_columns([], matches.pairs, matches.search_radius, 0.8)
    nothing = Matches.from_columns([], matches.pairs, matches.search_radius, 0.7)
    assert not other.same_as(nothing)


def test_selections(matches, epochs):
    scale = SSPs.of_epochs(epochs).scale
    fine = matches.of_ssps(scale == 1)
    assert 0 < len(fine) < len(matches)
    assert (scale[fine.ssp] == 1).all()
    assert fine.pairs is matches.pairs
    first = matches.select([0, 2])
    np.testing.assert_array_equal(first.dx, matches.dx[[0, 2]])
    assert repr(first) == "<Matches: 2 peaks of 6 pairs of epochs>"


def test_sorted_by_ssp_and_then_by_target(matches):
    assert matches.sorted().same_as(matches)
    mixed = matches.select(np.random.default_rng(0).permutation(len(matches)))
    found = mixed.sorted()
    order = np.lexsort((mixed.target, mixed.ssp))
    assert found.same_as(mixed.select(order))
    np.testing.assert_array_equal(found.ssp, matches.ssp)
    np.testing.assert_array_equal(found.target, matches.target)


def test_landing_is_on_the_nearest_pattern(matches, epochs):
    ssps = SSPs.of_epochs(epochs)
    landed = target_ssps(matches, ssps)
    assert landed.shape == (len(matches),)
    assert 0.3 < np.mean(landed >= 0) < 1
    for k in range(len(matches)):
        own = matches.ssp[k]
        there = np.flatnonzero(
            (ssps.epoch == matches.target[k]) & (ssps.scale == ssps.scale[own])
        )
        distance = np.hypot(
            ssps.y[there] - ssps.y[own] - matches.dy[k],
            ssps.x[there] - ssps.x[own] - matches.dx[k],
        )
        if distance.size and distance.min() <= scale_size(ssps.scale[own]):
            assert landed[k] == there[distance.argmin()]
        else:
            assert landed[k] == -1


def test_landing_where_nothing_is(epochs):
    ssps = epochs[0].ssps
    columns = (np.arange(2), np.ones(2), *np.zeros((5, 2)))
    matches = Matches.from_columns([columns], [(0, 1)], (5, 5), 0.6)
    assert target_ssps(matches, ssps).tolist() == [-1, -1]
    nothing = matches.select(slice(0, 0))
    assert target_ssps(nothing, ssps).shape == (0,)
