# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Candidates, their likelihood and links, against loops and densities."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.optimize import linear_sum_assignment

from astro_scc import Beam
from astro_scc.correlation import Matches
from astro_scc.decomposition import SSPs
from astro_scc.features.tracks import chains
from astro_scc.simulation import simulate_static
from astro_scc.tracking.linking import (
    Links,
    assign,
    chance_density,
    core_ssps,
    equal_pairs,
    find_candidates,
    link,
    path_gains,
    similarity,
    steady_motion,
)


def catalogue(rows, *, scale=1.0):
    """SSPs of (epoch, y, x, peak), each of one pixel."""
    epoch, y, x, peak = np.asarray(rows, dtype=float).reshape(-1, 4).T
    n = len(peak)
    return SSPs(
        scale=np.broadcast_to(np.asarray(scale, dtype=float), n), y=y, x=x,
        y_centroid=y, x_centroid=x, peak=peak, flux=10 * peak, snr=100 * peak,
        bbox=np.zeros((n, 4), int), starts=np.arange(n + 1), pixels=np.zeros(n, int),
        values=np.ones(n),
        epoch=epoch.astype(int),
    )  # fmt: skip


# -- candidates --------------------------------------------------------------------


@pytest.mark.parametrize("max_gap", [0, 5])
def test_candidates_are_the_highest_peaks_at_a_later_date(max_gap):
    # The second and the third epoch are of one date.
    ssps = catalogue([[t, 10 * t, 5 + t**2, 1.0] for t in (0, 1, 2, 3)])
    years = np.array([2000.0, 2000.3, 2000.3, 2001.0])
    # Sources, the SSPs on which their peaks fall, and the coefficients.
    peaks = [(2, 3, 0.5), (0, 1, 0.7), (0, 1, 0.9), (0, 1, 0.8), (0, -1, 0.9),
             (1, 0, 0.9), (1, 2, 0.9), (0, 3, 0.6)]  # fmt: skip
    source, landed, coefficient = np.array(peaks).T
    source, landed, zero = source.astype(int), landed.astype(int), np.zeros(8)
    target = np.where(landed < 0, 1, landed)
    columns = source, target, zero, zero, coefficient, zero, zero
    matches = Matches.from_columns([columns], [(0, 1)])
    # Matches are in the order of their SSPs and targets.
    landed = landed[np.lexsort((target, source))]
    found = find_candidates(matches, landed, ssps, years, max_gap)
    use = [True, max_gap == 5, True]
    for name, wanted in {
        "source": [0, 0, 2], "target": [1, 3, 3], "motion": [[10, 1], [30, 9], [10, 5]],
        "interval": [0.3, 1.0, 0.7], "gap": [0, 2, 0], "coefficient": [0.9, 0.6, 0.5],
    }.items():  # fmt: skip
        np.testing.assert_allclose(getattr(found, name), np.array(wanted)[use])


@pytest.fixture(scope="module")
def cube():
    """Six epochs with the reference pixel at (20, 64) and a beam of ten pixels."""
    return simulate_static(n_epochs=6, rng=1).cube


def rows_at(places):
    """A pattern an epoch, at (x, y) from the reference pixel."""
    return [
        [k, 64 + y, 20 + x, 1.0] for k, (x, y) in enumerate(places) if x is not None
    ]


def test_the_core_is_the_nearest_within_half_a_beam(cube):
    near = rows_at([(0, 0), (4.9, 0), (0, -4.9), (5.1, 0), (-3, -3), (None, None)])
    beside = rows_at([(4, 0), (0, 0), (4.9, 0.5), (9, 9), (30, 0), (4, 4)])
    # What passes by is near at few epochs, and on another scale no core.
    passing = rows_at([(-6, 0), (-2, 0), (2, 0), (8, 0), (10, 0), (14, 0)])
    ssps = catalogue(near + beside + passing, scale=[1.0] * 11 + [2.0] * 6)
    wanted = [k in (0, 2, 4, 6) for k in range(17)]
    assert core_ssps(ssps, cube).tolist() == wanted
    assert len(core_ssps(ssps.empty(), cube)) == 0


def test_half_of_a_long_beam_reaches_farther_along_it(cube):
    beam = Beam(2 * u.mas, 0.5 * u.mas, 0 * u.deg)
    north, west = (catalogue(rows_at([xy] * 6), scale=2.0) for xy in ((0, 9), (3, 0)))
    # Without a beam twice the scale, 8 pixels on scale 2.
    for beams, far, near in (((beam,) * 6, north, west), (None, west, north)):
        other = replace(cube, beams=beams)
        assert core_ssps(far, other).all()
        assert not core_ssps(near, other).any()


# -- likelihood --------------------------------------------------------------------


def candidates_of(ssps, pairs, coefficient=1.0):
    source, target = np.array(pairs, dtype=int).reshape(-1, 2).T
    step = ssps.epoch[target] - ssps.epoch[source]
    place = np.stack([ssps.y, ssps.x], axis=1)
    motion, same = place[target] - place[source], np.full(len(source), coefficient)
    return Links(source, target, motion, step.astype(float), step - 1, same)


def test_similarities_are_ratios_of_densities():
    # On one scale a core, a hundred times the others; what is on another is no matter.
    peak = np.array([100.0, 1.0, 1.3, 0.9, 110.0, 2.0])
    rows = np.column_stack([[0, 0, 1, 3, 3, 3], np.full(6, 10), 9 * np.arange(6), peak])
    ssps = catalogue(rows, scale=[1, 1, 1, 1, 1, 2])
    pairs = [(0, 4), (0, 2), (1, 2), (2, 3)]
    found = similarity(candidates_of(ssps, pairs, 0.8), ssps)
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
    value = steady_motion(
        steps[:1, 3], interval[3:], mean[:1], np.array([weight]), np.ones(1), 1.5
    )
    normal = stats.multivariate_normal(np.zeros(2), variance)
    assert value == pytest.approx(normal.logpdf(away[0]))


def test_density_of_a_lattice():
    y, x = (10 * v.ravel() + 10 for v in np.mgrid[:6, :6])
    ssps = catalogue(np.column_stack([np.zeros(36), y, x, np.ones(36)]))
    # Inside, the third neighbour is one step away.
    assert chance_density(ssps) == pytest.approx(np.full(36, 3 / (np.pi * 100)))
    alone = catalogue([[0, 10, 10, 1.0]])
    assert chance_density(alone) == pytest.approx([1 / (np.pi * 400)])


# -- links -------------------------------------------------------------------------


def everything(ssps, *, most=20.0, max_gap=1):
    """All pairs of later epochs within a distance, correlated perfectly."""
    step = ssps.epoch[None, :] - ssps.epoch[:, None]
    dy, dx = (v[None, :] - v[:, None] for v in (ssps.y, ssps.x))
    near = np.hypot(dy, dx) <= most * np.maximum(step, 1)
    return candidates_of(
        ssps, np.argwhere((step > 0) & (step <= max_gap + 1) & near), 0.97
    )


def streams(seed=1, n_epochs=6):
    """Two streams that pass through one another."""
    rng = np.random.default_rng(seed)
    rows, feature = [], []
    for k in range(12):
        speed, y = (3.0, 20 + 10 * k) if k < 6 else (15.0, 23 + 10 * (k - 6))
        x, peak = rng.uniform(40, 100), rng.uniform(0.5, 2)
        for t in range(n_epochs):
            jitter = rng.normal(0, 0.4, 2)
            rows.append([t, y + jitter[0], x + speed * t + jitter[1], peak])
            feature.append(k)
    return np.array(rows), np.array(feature)


@pytest.mark.parametrize("seed", range(2))
def test_streams_of_two_speeds_are_distinguished(seed):
    rows, feature = streams(seed)
    ssps = catalogue(rows)
    links = link(everything(ssps), ssps)
    assert len(links) == 12 * 5
    assert np.array_equal(feature[links.source], feature[links.target])
    assert np.all(links.gap == 0)


@pytest.mark.parametrize(("x", "linked"), [(124, True), (112, False)])
def test_a_track_predicts_more_than_its_last_step(x, linked):
    # Steady, but for a last step that is too short; then eight times the interval.
    # The mean velocity leads to 124, the last step to 112.
    rows = [[t, 50, 50 + 4.0 * t, 1] for t in range(12)]
    rows[11][2] -= 1.5
    ssps = catalogue([*rows, [12, 50, x, 1]])
    pairs = everything(ssps, most=60.0, max_gap=0)
    pairs = replace(pairs, interval=np.where(ssps.epoch[pairs.target] == 12, 8.0, 1.0))
    found = link(pairs, ssps, tolerance=1.0)
    assert list(found.source) == list(range(12 if linked else 11))


def test_a_feature_that_is_missing_at_a_date_is_taken_up_again():
    rows, feature = streams()
    gone = (feature == 3) & (rows[:, 0] == 2)
    ssps = catalogue(rows[~gone])
    links = link(everything(ssps), ssps)
    feature = feature[~gone]
    assert np.array_equal(feature[links.source], feature[links.target])
    own = feature[links.source] == 3
    assert sorted(links.gap[own]) == [0, 0, 0, 1]


def test_nothing_to_link():
    ssps = catalogue([[0, 10, 10, 1], [1, 300, 300, 1]])
    links = link(everything(ssps), ssps)
    assert len(links) == 0
    empty = catalogue([])
    assert len(link(everything(empty), empty)) == 0


# -- paths ---------------------------------------------------------------------------


def all_paths(source, target, use, start):
    """All paths of candidates that begin with one."""
    yield (start,)
    for k in np.flatnonzero((source == target[start]) & use):
        for rest in all_paths(source, target, use, k):
            yield (start, *rest)


def slow_gains(source, target, value, between, use):
    n = len(source)
    paths = [
        p for e in range(n) for p in all_paths(source, target, np.ones(n, bool), e)
    ]

    def worth(path):
        steps = zip(path[:-1], path[1:], strict=True)
        return value[list(path)].sum() + sum(between[pair] for pair in steps)

    gains = []
    for e in range(n):
        through = max(
            worth(p) for p in paths if e in p and all(use[k] or k == e for k in p)
        )
        used = [p for p in paths if all(use[k] for k in p)]
        ends = [worth(p) for p in used if target[p[-1]] == source[e]]
        begins = [worth(p) for p in used if source[p[0]] == target[e]]
        gains.append(through - max([0, *ends]) - max([0, *begins]))
    return gains


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_gains_are_those_of_all_paths(seed):
    rng = np.random.default_rng(seed)
    step = np.array([0, 0, 1, 1, 2, 2, 3])
    every = [(i, k) for i in range(7) for k in range(7) if 0 < step[k] - step[i] <= 2]
    pick = rng.permutation(len(every))[:8]
    source, target = np.array(every)[pick].T
    value = rng.normal(0.5, 1, len(pick))
    use = rng.random(len(pick)) < 0.7
    transitions = equal_pairs(target, source)
    values = rng.normal(0, 1, len(transitions[0]))
    pairs = zip(*(part.tolist() for part in transitions), strict=True)
    between = dict(zip(pairs, values, strict=True))
    gains = path_gains(
        Links(source, target, *4 * [np.zeros(len(pick))]), value,
        transitions, np.stack([values, values]), step, use=use,
    )  # fmt: skip
    assert gains == pytest.approx(slow_gains(source, target, value, between, use))


# -- tracks --------------------------------------------------------------------------


def test_chains_are_what_links_connect():
    """Two cross, one has a gap, and some are alone."""
    pairs = np.array([(0, 3), (3, 8), (8, 9), (1, 4), (4, 6), (2, 11)])
    found = [own.tolist() for own in chains(*pairs.T, 12)]
    assert found == [[0, 3, 8, 9], [1, 4, 6], [2, 11], [5], [7], [10]]


pairs = st.lists(
    st.tuples(st.integers(0, 4), st.integers(0, 4), st.integers(-3, 8)),
    max_size=9,
    unique_by=lambda pair: pair[:2],
)


@settings(max_examples=40, deadline=None)
@given(pairs)
def test_it_is_the_best_choice_and_one_to_one(found):
    row, column, weight = np.array(found, dtype=int).reshape(-1, 3).T
    chosen = assign(row, column, weight)
    assert len(set(row[chosen])) == len(set(column[chosen])) == chosen.sum()
    table = np.zeros((5, 5))
    np.maximum.at(table, (row, column), weight)
    best = table[linear_sum_assignment(table, maximize=True)].sum()
    assert weight[chosen].sum() == best
    assert np.all(weight[chosen] > 0)
