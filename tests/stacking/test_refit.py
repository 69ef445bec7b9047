# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stack around one component, again and with parts left out."""

from dataclasses import replace

import numpy as np
import pytest

from astro_scc.stacking import (
    VelocityGrid,
    baseline_pairs,
    component_near,
    stack,
)
from astro_scc.stacking.refit import Refit
from astro_scc.stacking.stack import number_of_ssps, velocities

GRID = VelocityGrid.covering((4.0, 3.0), (0.08, 0.1))
YEARS = np.array([0.0, 0.8, 1.5, 2.6])
PAIRS = baseline_pairs(YEARS, 0.0, 3.0)
BOX = (1.6, 2.0)


@pytest.fixture
def scene(random_displacements):
    rng = np.random.default_rng(5)
    d = random_displacements(rng, n=400, s1=(0.3, 0.6))
    # Two in three go with the flow.
    interval = YEARS[d.target] - YEARS[d.reference]
    along = rng.random(len(d)) < 0.67
    d1 = np.where(along, interval * 1.1 + rng.normal(0, 0.3, len(d)), d.d1)
    d2 = np.where(along, interval * -0.6 + rng.normal(0, 0.3, len(d)), d.d2)
    d = replace(d, d1=d1, d2=d2)
    scc = stack(d, PAIRS, GRID)
    return d, scc, component_near(scc, GRID, BOX, 1.1, -0.6)


def test_the_box_is_a_part_of_the_whole_stack(scene):
    d, scc, component = scene
    near = Refit.of(d, PAIRS, component, GRID)
    columns, rows, used = component.points
    part = scc[np.ix_(rows, columns)] * number_of_ssps(d, PAIRS)
    # What is left out is beyond five standard errors of the box.
    lost = part - near.map()
    assert lost.min() > -1e-9
    assert lost.max() < len(d) * 3 * np.exp(-12.5)
    assert len(near.index) < len(d)
    index, x, y, sx, sy, _ = velocities(d, PAIRS)
    inside = [
        x[k] + 5 * sx[k] >= GRID.v1[columns[0]]
        and x[k] - 5 * sx[k] <= GRID.v1[columns[-1]]
        and y[k] + 5 * sy[k] >= GRID.v2[rows[0]]
        and y[k] - 5 * sy[k] <= GRID.v2[rows[-1]]
        for k in range(len(x))
    ]
    np.testing.assert_array_equal(near.index, index[inside])
    assert near.used is used
    half = np.arange(len(near.x)) % 2 == 0
    np.testing.assert_allclose(near.map(half) + near.map(~half), near.map())


def test_the_fit_is_that_of_the_component(scene):
    d, _, component = scene
    near = Refit.of(d, PAIRS, component, GRID)
    found = near.fit(near.map())
    np.testing.assert_allclose(found, [component.v1, component.v2], atol=1e-4)
    moved = near.moved(0.05, -0.03)
    shifted = moved.fit(moved.map())
    np.testing.assert_allclose(shifted - found, [0.05, -0.03], atol=0.02)
    assert near.fit(np.zeros_like(near.map())) is None


def test_a_maximum_outside_is_put_to_the_side(scene):
    d, _, component = scene
    near = Refit.of(d, PAIRS, component, GRID)
    x, y = near.v1, near.v2[:, None]
    for at1, at2 in ((9.0, 0.5), (-9.0, -9.0), (0.0, 9.0)):
        values = np.exp(-0.5 * (((x - at1) / 6) ** 2 + ((y - at2) / 6) ** 2))
        found = near.fit(values)
        expected = np.clip([at1, at2], [x[0], y[0, 0]], [x[-1], y[-1, 0]])
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_the_jackknife_is_one_by_hand(scene):
    d, _, component = scene
    near = Refit.of(d, PAIRS, component, GRID)
    part = np.arange(len(near.x)) % 7
    found = near.jackknife([part == k for k in range(7)])
    maxima = [near.fit(near.map(part != k)) for k in range(7)]
    np.testing.assert_allclose(found, 6 * np.cov(np.transpose(maxima), bias=True))


def test_a_part_without_which_there_is_no_maximum(scene):
    d, _, component = scene
    near = Refit.of(d, PAIRS, component, GRID)
    everything = np.ones(len(near.x), bool)
    half = 0.5 * np.array([np.ptp(near.v1), np.ptp(near.v2)])
    found = near.jackknife([everything, everything])
    np.testing.assert_allclose(found, np.diag(half**2))
    part = np.arange(len(near.x)) % 3
    parts = [part == 0, part == 1, everything]
    maxima = [near.fit(near.map(~own)) for own in parts[:2]]
    apart = maxima - np.mean(maxima, axis=0)
    expected = 2 / 3 * (apart.T @ apart + np.diag(half**2))
    np.testing.assert_allclose(near.jackknife(parts), expected)


def test_nothing_to_refit(scene):
    d, scc, _ = scene
    far = component_near(scc, GRID, (1e-3, 1e-3), 3.95, 2.95)
    assert not far.fitted
    assert Refit.of(d, PAIRS, far, GRID) is None
    none = d.select(np.zeros(len(d), bool))
    assert Refit.of(none, PAIRS, scene[2], GRID) is None
