# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Search for motion in M 87, restored from the features of MOJAVE.

    python examples/galaxy_m87.py apjac230ft4_mrt.txt
"""

import astropy.units as u
from common import brief, run

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.epochs import read_components, restore
from astro_scc.flow import measure_profile
from astro_scc.kinematics import apparent_speed
from astro_scc.visualization import plot_profile


def measure(table, before=None, n_trials=1000):
    """Return the speeds that are tested in four rings about the core."""
    components = read_components(table, source="1228+126")
    cube = restore(
        components.select(before=before),
        beam=Beam(1.2 * u.mas, 0.6 * u.mas, 0 * u.deg),
        pixel_scale=0.1 * u.mas,
        noise=0.3 * u.mJy / u.beam,
        rng=1,
    )
    scc = StackedCrossCorrelation(
        scales=[1, 2, 3, 4],
        max_speed=0.6 * u.mas / u.yr,
        position_angle=288 * u.deg,
        baseline=[1, 4] * u.yr,
    )
    edges = [0.5, 2, 4, 8, 16] * u.mas
    profile = measure_profile(scc, cube, edges, n_trials=n_trials, rng=1)
    found = profile.components_in_c(distance=16.7 * u.Mpc)
    columns = "pm_parallel", "pm_parallel_err", "p_global", "p_fdr"
    figure = plot_profile(
        profile.components,
        beta_per_pm=float(apparent_speed(1 * u.mas / u.yr, distance=16.7 * u.Mpc)),
    )
    found = brief(found, "r_min", "r_max", "kind", *columns, "n_features", digits=3)
    return found, figure


if __name__ == "__main__":
    run(measure, __doc__, data=True)
