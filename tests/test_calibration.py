# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Of static jets whose fluxes vary independently at most 5% give a false alarm."""

import astropy.units as u
import numpy as np
import pytest
from scipy.stats import binom

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import simulate_jet

ALPHA = 0.05
N_JETS = 80
#: False alarms that are allowed.  With 20% of false alarms 80 jets have more than 10 in
#: 94.3% of all cases (binomial distribution), with 5% in 0.2%.
MOST = 10


def measure(seed):
    """Both probabilities of the strongest row of a static jet, and if it is moving."""
    still = {"n_features": 0, "standing": 4, "memory": 0.0, "length": 8.0}
    jet = simulate_jet(**still, n_epochs=7, rng=seed)
    how = {"scales": [1, 2], "position_angle": 270 * u.deg, "alpha": ALPHA}
    scc = StackedCrossCorrelation(**how)
    table = scc(jet.cube, n_trials=39, rng=seed).components
    rows = table[table["kind"] != "stationary"]
    if len(rows) == 0:
        return 1.0, 1.0, False
    return rows["p_global"][0], rows["p_local"][0], "moving" in rows["kind"]


def test_the_limit_has_the_power_that_it_is_said_to_have():
    assert binom.sf(MOST, N_JETS, 0.2) > 0.94
    assert binom.sf(MOST, N_JETS, ALPHA) < 0.003


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::astro_scc.exceptions.MeasurementWarning")
def test_static_jets_give_few_false_alarms():
    found = zip(*map(measure, range(N_JETS)), strict=True)
    p_global, p_local, moving = map(np.array, found)
    assert np.sum(p_global <= ALPHA) <= MOST
    assert np.sum(moving) <= MOST
    # The guard would see a wrong null, such as that of one speed, which does not know
    # of the search among all of them.
    assert np.sum(p_local <= ALPHA) > MOST
