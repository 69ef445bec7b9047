# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure the paper's jet of two fluids, a slow sheath around a fast spine.

    python examples/two_fluid.py
"""

import astropy.units as u
from common import brief, run

from astro_scc import StackedCrossCorrelation
from astro_scc.kinematics import paper_cosmology
from astro_scc.simulation import simulate_two_fluid


def measure(n_trials=200):
    """Return the speeds of a jet with streams of 5 and 20 pixels an epoch."""
    jet = simulate_two_fluid(rng=1)
    scc = StackedCrossCorrelation(
        scales=[1, 2, 3], max_speed=36 * u.mas / u.yr, position_angle=270 * u.deg
    )
    result = scc(jet.cube, n_trials=n_trials, rng=1)
    table = result.components_in_c(redshift=0.033, cosmology=paper_cosmology())
    columns = "pm_parallel", "pm_parallel_err", "beta_app", "share", "p_global"
    table = brief(table, "kind", *columns, "n_features", digits=1, share=2)
    return table, result.plot("spectrum")


if __name__ == "__main__":
    run(measure, __doc__)
