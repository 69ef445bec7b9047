# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure speed against distance in 3C 120, restored from the features of MOJAVE.

    python examples/galaxy_3c120.py ../shared/data
"""

import astropy.units as u
from common import brief, run

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.epochs import read_components, restore
from astro_scc.flow import measure_profile
from astro_scc.kinematics import apparent_speed, paper_cosmology
from astro_scc.visualization import plot_profile


def measure(data, before="2011-01-01", n_trials=200):
    """Return the main speeds of six rings about the core, and their figure."""
    components = read_components(data / "mojave_xviii" / "0430+052.ecsv")
    cube = restore(
        components.select(before=before),
        beam=Beam(1.2 * u.mas, 0.5 * u.mas, -5 * u.deg),
        pixel_scale=0.1 * u.mas,
        noise=0.3 * u.mJy / u.beam,
        rng=1,
    )
    scc = StackedCrossCorrelation(
        scales=[1, 2, 3, 4],
        max_speed=5 * u.mas / u.yr,
        position_angle=-112 * u.deg,
        baseline=[0.1, 0.6] * u.yr,
    )
    edges = [0.5, 1.5, 2.5, 3.5, 5.5, 7.5, 10.5] * u.mas
    profile = measure_profile(scc, cube, edges, n_trials=n_trials, rng=1)
    distance = {"redshift": 0.033, "cosmology": paper_cosmology()}
    table = profile.components_in_c(**distance)
    table = table[table["main"]]
    columns = "pm_parallel", "pm_parallel_err", "beta_app", "beta_app_err", "p_global"
    figure = plot_profile(
        profile.components,
        beta_per_pm=float(apparent_speed(1 * u.mas / u.yr, **distance)),
    )
    return brief(table, "r_min", "r_max", "kind", *columns, "n_features"), figure


if __name__ == "__main__":
    run(measure, __doc__, data=True)
