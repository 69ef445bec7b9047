# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The likelihood of links, against the densities that it is the ratio of."""

import numpy as np
import pytest
from scipy import stats

from astro_scc.tracking.candidates import Candidates
from astro_scc.tracking.likelihood import LinkLikelihood, chance_density, coarser_ssps


def candidates_of(ssps, pairs, coefficient=1.0):
    source, target = np.array(pairs, dtype=int).reshape(-1, 2).T
    step = ssps.epoch[target] - ssps.epoch[source]
    dy, dx = (v[target] - v[source] for v in (ssps.y, ssps.x))
    return Candidates(
        source, target, dy, dx,
        step.astype(float), step - 1, np.broadcast_to(coefficient, len(source)),
    )  # fmt: skip


def test_similarities_are_ratios_of_densities(catalogue):
    # On one scale a core, a hundred times the others; what is on another is no matter.
    peak = np.array([100.0, 1.0, 1.3, 0.9, 110.0, 2.0])
    rows = np.column_stack([[0, 0, 1, 3, 3, 3], np.full(6, 10), 9 * np.arange(6), peak])
    ssps = catalogue(rows, scale=[1, 1, 1, 1, 1, 2])
    pairs = [(0, 4), (0, 2), (1, 2), (2, 3)]
    found = LinkLikelihood().similarity(candidates_of(ssps, pairs, 0.8), ssps)
    same = stats.cauchy(scale=0.15)
    of_scale = np.log(peak[:5])
    shape = stats.expon.logpdf(0.2, scale=0.06) - stats.expon.logpdf(0.2, scale=0.15)
    for (i, k), value in zip(pairs, found, strict=True):
        ratio = np.log(peak[k] / peak[i])
        chance = same.pdf(ratio - (of_scale[:, None] - of_scale)).mean()
        gap = ssps.epoch[k] - ssps.epoch[i] - 1
        wanted = shape + same.logpdf(ratio) - np.log(chance) - 2.0 * gap
        # The ratios are counted in bins of a quarter of the half width.
        assert value == pytest.approx(wanted, abs=0.1)


def test_steady_motion_knows_the_error_of_a_mean_velocity():
    # Of many tracks of uneven intervals the next displacement is as far from the
    # weighted mean as the variance says.
    rng, interval = np.random.default_rng(1), np.array([0.3, 1.0, 0.5, 2.0])
    steps = rng.normal(0, 1.5, (4000, 4, 2))
    weight = np.sum(interval[:3] ** 2)
    mean = np.einsum("nki,k->ni", steps[:, :3], interval[:3]) / weight
    away = steps[:, 3] - interval[3] * mean
    variance = 1.5**2 * (1 + interval[3] ** 2 / weight)
    assert np.var(away) == pytest.approx(variance, rel=0.05)
    value = LinkLikelihood(tolerance=1.5).steady_motion(
        steps[:1, 3], interval[3:], mean[:1], np.array([weight]), np.ones(1)
    )
    normal = stats.multivariate_normal(np.zeros(2), variance)
    assert value == pytest.approx(normal.logpdf(away[0]))


def test_the_coarser_scale_helps_where_it_agrees_and_never_forbids(catalogue):
    # A small pattern that lies in a large one, which moves by eight pixels.
    ssps = catalogue(
        [[0, 50, 50, 1], [1, 50, 58, 1], [1, 50, 108, 1],
         [0, 50, 50, 2], [1, 50, 58, 2]],
        scale=[1, 1, 1, 2, 2],
    )  # fmt: skip
    parent = np.array([3, 4, -1, -1, -1])
    near, far = LinkLikelihood(follow=0.5).coarse_to_fine(
        candidates_of(ssps, [(0, 1), (0, 2)]), candidates_of(ssps, [(3, 4)]),
        parent, 4.0, np.full(5, 0.001),
    )  # fmt: skip
    assert near == pytest.approx(np.log(0.5 + 0.5 / (2 * np.pi * 16 * 0.001)))
    assert far == pytest.approx(np.log(0.5))


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"tolerance": 0}, "tolerance must be above 0"),
        ({"variability": -1}, "variability must be above 0"),
        ({"follow": 1.0}, "follow must be 0 or more, below 1"),
        ({"missing": -1}, "missing must be 0 or more"),
    ],
)
def test_what_makes_no_sense_is_refused(setting, message):
    with pytest.raises(ValueError, match=message):
        LinkLikelihood(**setting)


def test_density_of_a_lattice(catalogue):
    y, x = (10 * v.ravel() + 10 for v in np.mgrid[:6, :6])
    ssps = catalogue(np.column_stack([np.zeros(36), y, x, np.ones(36)]))
    # Inside, the third neighbour is one step away.
    assert chance_density(ssps) == pytest.approx(np.full(36, 3 / (np.pi * 100)))
    alone = catalogue([[0, 10, 10, 1.0]])
    assert chance_density(alone) == pytest.approx([1 / (np.pi * 400)])


def test_coarser_ssps_are_those_of_loops(catalogue):
    rng = np.random.default_rng(4)
    rows = np.column_stack(
        [rng.integers(0, 2, 60), rng.uniform(10, 90, (60, 2)), np.ones(60)]
    )
    scale = rng.integers(1, 4, 60)
    ssps = catalogue(rows, scale=scale, half=3 * scale)
    found = coarser_ssps(ssps, 400)
    for i, parent in enumerate(found):
        at = int(np.rint(ssps.y[i])) * 400 + int(np.rint(ssps.x[i]))
        holders = [
            k
            for k in np.flatnonzero(
                (ssps.scale == ssps.scale[i] + 1) & (ssps.epoch == ssps.epoch[i])
            )
            if at in ssps.pixels_of(k)
        ]
        assert parent in holders if holders else parent == -1
