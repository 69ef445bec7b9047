# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The diagram against the double loop of its definition."""

import numpy as np
import pytest

from astro_scc.spectrum.diagram import (
    FlowPlanes,
    correlate,
    correlate_aside,
    influences,
)


@pytest.fixture(name="flow", scope="module")
def fixture_flow():
    rng = np.random.default_rng(5)
    mask = rng.random((24, 6)) < 0.9
    values = rng.normal(size=(2, 4, 24, 6)).astype(np.float32) * mask
    along, across = 0.25 * np.arange(24), 0.25 * np.arange(6)
    return FlowPlanes(values, mask, along, across, np.arange(4.0), (1, 2), 2.0)


def brute(flow, a, b, lag, weight, aside=0):
    """Return the sum over all places whose middle has a weight."""
    total, n_x, n_y = 0.0, *flow.mask.shape
    for x in range(n_x):
        for y in range(n_y):
            if not (0 <= x + lag < n_x and 0 <= y + aside < n_y):
                continue
            at = (weight[x + lag // 2, y] + weight[x + (lag + 1) // 2, y]) / 2
            for plane in flow.values:
                total += at * plane[a, x, y] * plane[b, x + lag, y + aside]
    return total / (flow.mask * weight).sum() / len(flow.values)


@pytest.mark.parametrize("part", [False, True])
def test_sums_are_those_of_the_definition(flow, part):
    weight = np.ones(flow.mask.shape)
    if part:
        weight[:8] = 0
    diagram = correlate(flow, region=weight if part else None)
    at = diagram.zero
    assert diagram.displacement[at] == 0
    for a, b, lag in [(0, 0, 0), (0, 1, 3), (2, 1, 5), (3, 0, 8)]:
        assert diagram.sums[a, b, at + lag] == pytest.approx(
            brute(flow, a, b, lag, weight), abs=1e-5
        )
    assert np.allclose(diagram.sums[0, 1], diagram.sums[1, 0, ::-1], atol=1e-6)
    assert diagram.overlap[at] == pytest.approx(1)


def test_displacements_aside(flow):
    weight = np.ones(flow.mask.shape)
    below, middle, above = correlate_aside(flow, [2])
    at = middle.zero
    assert above.sums[1, 2, at + 3] == pytest.approx(
        brute(flow, 1, 2, 3, weight, 2), abs=1e-5
    )
    assert below.sums[1, 2, at - 3] == pytest.approx(above.sums[2, 1, at + 3])
    assert np.allclose(above.sums[0, 1], below.sums[1, 0, ::-1], atol=1e-6)


@pytest.mark.parametrize("part", [False, True])
def test_influences_add_up_to_the_function(flow, part):
    rng = np.random.default_rng(6)
    region = None
    if part:
        region = (np.arange(24) > 9)[:, None] * np.ones(6)
    diagram = correlate(flow, region=region)
    function = rng.normal(size=diagram.sums.shape)
    function += function.transpose(1, 0, 2)[:, :, ::-1]
    found, again = influences(flow, diagram, [function, function], region=region)
    assert np.array_equal(found, again)
    assert found.sum() == pytest.approx((function * diagram.means).sum(), rel=1e-4)
