# Licensed under a 3-clause BSD style license - see LICENSE.rst
import threading
import time

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import simulate_two_fluid
from astro_scc.stacking.threads import in_threads


@pytest.mark.parametrize("n_threads", [1, 3])
def test_results_are_in_the_order_of_the_pieces(n_threads):
    def late(k):
        time.sleep(0.01 * (3 - k))
        return k**2

    assert in_threads(late, iter(range(3)), n_threads) == [0, 1, 4]
    assert in_threads(late, [], n_threads) == []


def test_pieces_run_side_by_side():
    both = threading.Barrier(2, timeout=20)
    assert sorted(in_threads(lambda _: both.wait(), range(2), 2)) == [0, 1]


def test_an_error_comes_through():
    def fails(k):
        raise ValueError(f"piece {k}")

    with pytest.raises(ValueError, match="piece 0"):
        in_threads(fails, range(3), 2)


def test_threads_change_no_number():
    cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    scc = StackedCrossCorrelation(scales=[2], max_speed=30 * u.mas / u.yr)
    matched = scc.match(cube)
    one, other = (scc.stack(matched, n_trials=120, rng=3, n_workers=n) for n in (1, 3))
    assert len(one.components)
    for name in one.components.colnames:
        np.testing.assert_array_equal(one.components[name], other.components[name])
    np.testing.assert_array_equal(one.z_score, other.z_score)
