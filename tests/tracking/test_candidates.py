# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Candidates, against loops."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc import Beam
from astro_scc.correlation import Matches
from astro_scc.simulation import simulate_static
from astro_scc.tracking import candidates
from astro_scc.tracking.candidates import core_ssps, find_candidates


def random_matches(rng, ssps, n):
    source = rng.integers(0, len(ssps), n)
    landed = rng.integers(-1, len(ssps), n)
    target = np.where(landed >= 0, ssps.epoch[landed], rng.integers(0, 4, n))
    columns = (source, target, np.zeros(n), np.zeros(n), rng.random(n), np.ones(n),
               np.ones(n))  # fmt: skip
    return Matches.from_columns([columns], [(0, 1)], (5, 5), 0.0), landed


@pytest.fixture
def ssps(catalogue):
    rng = np.random.default_rng(2)
    epoch = np.repeat(np.arange(4), 3)
    return catalogue(np.column_stack([epoch, rng.uniform(5, 90, (12, 2)), epoch + 1.0]))


@pytest.mark.parametrize("max_gap", [0, 1, 5])
def test_candidates_are_those_of_loops(ssps, max_gap):
    matches, landed = random_matches(np.random.default_rng(3), ssps, 300)
    years = np.array([2000.0, 2000.3, 2000.3, 2001.0])
    found = find_candidates(matches, landed, ssps, years, max_gap=max_gap)
    best = {}
    for i, k, c in zip(matches.ssp, landed, matches.coefficient, strict=True):
        if k < 0:
            continue
        a, b = ssps.epoch[i], ssps.epoch[k]
        if 0 < b - a <= max_gap + 1 and years[b] > years[a]:
            best[i, k] = max(best.get((i, k), 0), c)
    assert list(zip(found.source, found.target, strict=True)) == sorted(best)
    assert found.coefficient == pytest.approx([best[p] for p in sorted(best)])
    for i, k, dy, dx, interval, gap in zip(
        found.source, found.target, found.dy, found.dx, found.interval, found.gap,
        strict=True,
    ):  # fmt: skip
        a, b = ssps.epoch[i], ssps.epoch[k]
        assert (dy, dx) == (ssps.y[k] - ssps.y[i], ssps.x[k] - ssps.x[i])
        assert interval == years[b] - years[a]
        assert gap == b - a - 1


def test_only_the_best_candidates_of_an_epoch_are_kept(monkeypatch, ssps):
    matches, landed = random_matches(np.random.default_rng(3), ssps, 500)
    every = find_candidates(matches, landed, ssps, np.arange(4.0))
    monkeypatch.setattr(candidates, "MAX_CANDIDATES", 1)
    one = find_candidates(matches, landed, ssps, np.arange(4.0))
    groups = {}
    for i, gap, c in zip(every.source, every.gap, every.coefficient, strict=True):
        groups.setdefault((i, gap), []).append(c)
    assert len(one) == len(groups) < len(every)
    for i, gap, c in zip(one.source, one.gap, one.coefficient, strict=True):
        assert c == max(groups[i, gap])


# -- the core ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def cube():
    """Six epochs with the reference pixel at (20, 64) and a beam of ten pixels."""
    return simulate_static(n_epochs=6, rng=1).cube


def rows_at(places):
    """A pattern an epoch, at (x, y) from the reference pixel."""
    return [
        [k, 64 + y, 20 + x, 1.0] for k, (x, y) in enumerate(places) if x is not None
    ]


def test_the_core_is_the_nearest_within_half_a_beam(catalogue, cube):
    near = rows_at([(0, 0), (4.9, 0), (0, -4.9), (5.1, 0), (-3, -3), (None, None)])
    beside = rows_at([(4, 0), (0, 0), (4.9, 0.5), (9, 9), (30, 0), (4, 4)])
    ssps = catalogue(near + beside)
    wanted = [k in (0, 2, 4, 6) for k in range(11)]
    assert core_ssps(ssps, cube).tolist() == wanted


def test_what_is_near_at_few_epochs_is_no_core(catalogue, cube):
    passing = rows_at([(-6, 0), (-2, 0), (2, 0), (6, 0), (10, 0), (14, 0)])
    standing = rows_at([(1, 0), (0, 1), (1, 1), (7, 0), (8, 0), (9, 0)])
    ssps = catalogue(passing + standing, scale=[1.0] * 6 + [2.0] * 6)
    assert core_ssps(ssps, cube).tolist() == [6 <= k < 9 for k in range(12)]
    assert len(core_ssps(ssps.empty(), cube)) == 0


def test_half_of_a_long_beam_reaches_farther_along_it(catalogue, cube):
    beam = Beam(2 * u.mas, 0.5 * u.mas, 0 * u.deg)
    cube = replace(cube, beams=(beam,) * 6)
    north, west = rows_at([(0, 9)] * 6), rows_at([(3, 0)] * 6)
    assert core_ssps(catalogue(north), cube).all()
    assert not core_ssps(catalogue(west), cube).any()
    # Without a beam twice the scale, 8 pixels on scale 2.
    plain = replace(cube, beams=None)
    assert core_ssps(catalogue(west, scale=2.0), plain).all()
    assert not core_ssps(catalogue(north, scale=2.0), plain).any()
