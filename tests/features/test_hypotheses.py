# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracks that steady motion allows, for detections whose motions are known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from astro_scc.features import TrackSettings
from astro_scc.features.hypotheses import log_t, position_scatter, steady_hypotheses

SETTINGS = TrackSettings()


def random_series(series, seed, n_epochs=6, most=4):
    rng = np.random.default_rng(seed)
    return series(
        [
            (t, *rng.uniform(0, 2, 2), rng.lognormal())
            for t in range(n_epochs)
            for _ in range(rng.integers(0, most + 1))
        ],
        n_epochs=n_epochs,
    )


def reversed_in_time(d):
    """The same detections, last one first."""
    last = len(d.years) - 1
    each = ("place", "place_error", "flux", "size")
    turned = {name: getattr(d, name)[::-1] for name in each}
    return replace(
        d, epoch=(last - d.epoch)[::-1], years=-d.years[::-1], number=None, **turned
    )


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_time_may_run_backwards(series, seed):
    d = random_series(series, seed)
    paths, score = steady_hypotheses(d, SETTINGS)
    turned, other = steady_hypotheses(reversed_in_time(d), SETTINGS)
    back = {tuple(len(d) - 1 - k for k in path[::-1]): s
            for path, s in zip(turned, other, strict=True)}  # fmt: skip
    assert dict(zip(paths, score, strict=True)) == pytest.approx(back)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([1e-3, 7.0, 1000.0, 1e6]))
def test_units_of_length_and_the_first_date_are_free(series, seed, factor):
    d = random_series(series, seed)
    d = replace(d, size=np.linspace(0, 1, len(d)))
    paths, score = steady_hypotheses(d, SETTINGS)
    larger = replace(
        d, place=factor * d.place, place_error=factor * d.place_error,
        size=factor * d.size, beam=factor**2 * d.beam,
    )  # fmt: skip
    for other in (larger, replace(d, years=d.years + 64), replace(d, flux=3 * d.flux)):
        again, same = steady_hypotheses(other, SETTINGS)
        found = dict(zip(again, same, strict=True))
        assert dict(zip(paths, score, strict=True)) == pytest.approx(found)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_each_path_goes_forward_and_has_one_detection_per_epoch(series, seed):
    d = random_series(series, seed)
    paths, score = steady_hypotheses(d, SETTINGS)
    assert len(paths) == len(set(paths)) == len(score)
    for path in paths:
        step = np.diff(d.epoch[list(path)])
        assert len(path) >= SETTINGS.least_epochs
        assert step.min() >= 1
        assert step.max() <= SETTINGS.most_missed + 1


@pytest.mark.parametrize("most_missed", [1, 3])
@pytest.mark.parametrize("longer", [0, 1])
def test_gaps_up_to_a_length_are_bridged(series, most_missed, longer):
    n = most_missed + longer
    seen = [*range(5), *range(5 + n, 10 + n)]
    rows = [(t, 0.2 * t, 0.0) for t in seen]
    # Another feature far away is seen at all epochs.
    rows += [(t, 50.0, 50.0) for t in range(10 + n)]
    d = series(rows)
    own = np.flatnonzero(d.place[:, 1] == 0)
    paths, _ = steady_hypotheses(d, replace(SETTINGS, most_missed=most_missed))
    assert (tuple(own.tolist()) in paths) == (longer == 0)
    assert tuple(own[:5].tolist()) in paths or longer == 0


@pytest.mark.parametrize(("off", "linked"), [(0.0, True), (0.15, True), (1.5, False)])
def test_what_is_beyond_the_gate_is_not_linked(series, off, linked):
    d = series([(t, 0.2 * t, off if t == 9 else 0.0) for t in range(10)])
    paths, _ = steady_hypotheses(d, SETTINGS)
    assert (tuple(range(10)) in paths) == linked
    assert tuple(range(9)) in paths


def test_too_few_epochs_have_none(series):
    for n in range(SETTINGS.least_epochs):
        rows = [(t, 0.2 * t, 5.0 * k) for t in range(n) for k in range(2)]
        paths, score = steady_hypotheses(series(rows), SETTINGS)
        assert paths == []
        assert len(score) == 0
    rows = [(t, 40.0 * (-1) ** t, 40.0 * t) for t in range(6)]
    assert steady_hypotheses(series(rows), SETTINGS)[0] == []


def test_scatter_adds_its_parts(series):
    d = replace(series([(0, 3.0, 4.0)], error=0.3), size=np.array([2.0]))
    o = SETTINGS
    parts = o.scatter, 2 * o.size_scatter, 5 * o.far_scatter, 0.3
    assert position_scatter(d, o) == pytest.approx([np.linalg.norm(parts)])


@pytest.mark.parametrize("n_axes", [1, 2])
def test_students_density(n_axes):
    off = np.array([0.3, -2.0])[:n_axes]
    true = stats.multivariate_t(shape=0.7 * np.eye(n_axes), df=4).logpdf(off)
    assert log_t(off @ off, 0.7, 4.0, n_axes) == pytest.approx(true)
