# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Whether patterns keep their speed, where they do and where they do not."""

import astropy.units as u
import numpy as np
import pytest
from scipy.stats import kstest

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import simulate_random_velocity
from astro_scc.stacking.velocities import VelocitySamples
from astro_scc.streams.permutations import persistence

N_EPOCHS, N_SSPS = 8, 20


def links(speeds):
    """Matches of each SSP with the next epoch and back, where it moves at its speed."""
    epoch = np.repeat(np.arange(N_EPOCHS), N_SSPS)
    first = np.arange(len(epoch) - N_SSPS)
    ssp, to = np.stack([[first, first + N_SSPS], [first + N_SSPS, first]], axis=1)
    ssp, to = ssp.ravel(), to.ravel()
    return VelocitySamples(
        d1=np.ravel(speeds)[np.minimum(ssp, to)] * np.sign(to - ssp), d2=0.0 * ssp,
        weight=1 + 0.0 * ssp, reference=epoch[ssp], target=epoch[to], ssp=ssp,
        target_ssp=to, epoch=epoch, scale=np.ones(len(epoch)),
        years=np.arange(1.0 * N_EPOCHS),
    )  # fmt: skip


def test_new_speeds_give_any_probability():
    rng = np.random.default_rng(1)
    found = [
        persistence(links(rng.uniform(-1.5, 1.5, (N_EPOCHS - 1, N_SSPS))), 0.5)
        for _ in range(150)
    ]
    assert kstest(found, "uniform").pvalue > 1e-3


def test_one_end_of_a_link_is_enough():
    speeds = np.random.default_rng(2).uniform(-1.5, 1.5, (N_EPOCHS - 1, N_SSPS))
    d = links(speeds)
    fewer = d.select((d.interval > 0) | (d.reference == N_EPOCHS - 1))
    assert persistence(fewer, 0.5) == persistence(d, 0.5)


def test_kept_speeds_give_a_small_one_where_it_can_be_shown():
    d = links(np.tile(np.linspace(-1, 1, N_SSPS), (N_EPOCHS - 1, 1)))
    assert persistence(d, 0.5) < 1e-6
    # No match, few SSPs, or most come at this speed.
    for use in (d.ssp < 0, d.ssp % N_SSPS < 3, d.d1 * d.interval > 0):
        assert np.isnan(persistence(d.select(use), 0.5))


@pytest.mark.slow
def test_a_jet_of_random_velocities_has_no_common_speed():
    scc = StackedCrossCorrelation(
        scales=[1, 2], max_speed=36 * u.mas / u.yr, position_angle=270 * u.deg
    )
    result = scc(simulate_random_velocity(rng=3).cube, n_trials=99, rng=1)
    (row,) = result.components[result.components["p_global"] <= 0.05]
    assert row["kind"] == "not confirmed"
    assert "its patterns do not keep this speed" in row["caution"]
