# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Places that ordinary data do not come to."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from astro_scc.stacking import (
    ShuffledStacks,
    VelocityGrid,
    alignment_scatter,
    baseline_pairs,
    component_near,
    find_components,
    find_velocities,
    find_witnesses,
    stack,
)

search = sys.modules[find_velocities.__module__]


def test_an_epoch_without_matches_has_no_part_in_the_error(clump):
    grid = VelocityGrid.covering(3.0, 0.05)
    d = replace(clump(12, s=(0.3, 0.3)), n_ssps=np.array([12, 12, 0]))
    pairs = baseline_pairs([0.0, 0.5, 1.0], 0.0, 2.0)
    component = component_near(stack(d, pairs, grid), grid, (2.0, 2.0), 1.0, -0.5)
    assert component.fitted
    errors = np.array([[0.1, 0.05], [0.1, 0.05], [9.0, 9.0]])
    found = alignment_scatter(d, pairs, component, grid, errors)
    # Two epochs, half a year apart.
    np.testing.assert_allclose(
        np.sqrt(np.diag(found)), np.sqrt(2) * errors[0] / 0.5, rtol=1e-3
    )
    alone = alignment_scatter(d, pairs, component, grid, [[0, 0], [0, 0], [9, 9]])
    np.testing.assert_array_equal(alone, np.zeros((2, 2)))


def test_where_every_velocity_is_taken_nothing_is_searched(monkeypatch):
    from types import SimpleNamespace

    one = np.ones(5)
    witnesses = SimpleNamespace(
        v1=0.1 * np.arange(5), v2=0 * one, s1=0.2 * one, s2=0.2 * one, weight=one
    )

    class Five(SimpleNamespace):
        def __len__(self):
            return 5

    witnesses = Five(**vars(witnesses))
    monkeypatch.setattr(search, "find_witnesses", lambda sightings: witnesses)
    options = [None] * (search._scene.__code__.co_argcount - 5)
    limits = (0.3, 0.3)
    scene = search._scene(None, None, None, limits, [], *options)
    assert np.hypot(*scene.velocity) < 0.5
    assert search._scene(None, None, None, limits, [(0.0, 0.0)], *options) is None


def test_no_sightings_have_no_witnesses(random_displacements):
    from astro_scc.stacking import Sightings

    d = random_displacements(np.random.default_rng(1))
    years = np.array([0.0, 0.4, 1.0, 1.1])
    d = replace(d, position=np.zeros((len(d), 2)), motion=np.zeros((len(d), 2)))
    seen = Sightings.of(d, baseline_pairs(years, 0.0, 2.0), years, (4.0, 4.0))
    assert len(find_witnesses(seen)) > 0
    none = find_witnesses(seen.select(np.zeros(len(seen), bool)))
    assert len(none) == 0
    assert none.group.dtype == int


@pytest.mark.parametrize("height", [0.0, -1.0])
def test_a_stack_without_anything_has_no_component(height):
    grid = VelocityGrid.covering(2.0, 0.2)
    scc = np.full(grid.shape, height)
    found = component_near(scc, grid, (1.0, 1.0), 0.52, -0.38)
    assert not found.fitted
    assert (found.v1, found.v2) == (0.52, -0.38)
    assert found.coefficient == height
    assert grid.v1[found.column] == pytest.approx(0.6)
    assert grid.v2[found.row] == pytest.approx(-0.4)


@pytest.mark.parametrize("z", [-1.0, 0.7, 1.3, 2.2, 9.0])
def test_probability_of_a_z_score_anywhere(z):
    rng = np.random.default_rng(4)
    maxima = np.sort(rng.normal(1, 1, 99).round(1))
    flat = np.zeros((2, 3))
    trials = ShuffledStacks(mean=flat, std=flat, p_local=flat, maxima=maxima)
    assert trials.p_global(z) == (sum(m >= z for m in maxima) + 1) / 100


@pytest.mark.parametrize("aside", [(0.9, 0), (-0.9, 0), (0, 1.4), (0, -1.4)])
@pytest.mark.parametrize("times", [1.0, 1.2])
def test_a_fit_outside_the_box_is_none(aside, times, monkeypatch):
    module = sys.modules[find_components.__module__]
    grid = VelocityGrid.covering(4.0, 0.25)
    scc = np.exp(-(grid.v1**2 + grid.v2[:, None] ** 2) / 2)
    place = times * np.array(aside)
    fit = (*place, 1.0, 0.7, 0.8)
    monkeypatch.setattr(module, "fit_gaussian", lambda *args: fit)
    (found,) = find_components(scc, grid, (1.8, 2.8))
    assert found.fitted == (times == 1)
    expected = place if times == 1 else (0, 0)
    np.testing.assert_allclose((found.v1, found.v2), expected, atol=1e-6)
    assert np.isnan(found.width1) == (times > 1)
