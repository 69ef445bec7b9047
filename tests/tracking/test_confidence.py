# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Shares of linked SSPs, against counting."""

import numpy as np
import pytest

from astro_scc.tracking.linking import linked_shares


def test_the_error_is_that_of_resampled_epochs():
    rng = np.random.default_rng(2)
    total = np.full((1, 30), 20)
    linked = rng.binomial(20, 0.6, (1, 30))
    share = linked_shares(np.stack([linked, total]), [], [1.0], rng=3)[0]
    assert share.share == pytest.approx(linked.sum() / 600)
    assert share.share_err == pytest.approx(np.sqrt(0.24 / 600), rel=0.3)
    assert np.isnan(share.permuted)
    assert np.isnan(share.p_value)


def test_permutations_are_counted():
    counts = np.array([[[4, 4]], [[8, 8]]])
    trials = [np.array([[[n, n]], [[8, 8]]]) for n in (1, 2, 4)]
    every, one = linked_shares(counts, trials, [2.0], rng=1)
    assert every.scale is None
    assert one.scale == 2.0
    assert one.permuted == pytest.approx(7 / 24)
    assert one.p_value == pytest.approx(2 / 4)


def test_nothing_to_count():
    share = linked_shares(np.zeros((2, 1, 3), int), [], [1.0], rng=1)[0]
    assert (share.share, share.share_err, share.n_ssps) == (0.0, 0.0, 0)
