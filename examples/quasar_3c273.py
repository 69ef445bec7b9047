# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure small and large scales of 3C 273, restored from the features of MOJAVE.

    python examples/quasar_3c273.py ../shared/data
"""

import astropy.units as u
from common import brief, run

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.epochs import read_components, restore
from astro_scc.flow import measure_profile
from astro_scc.kinematics import paper_cosmology


def measure(data, before="2011-01-01", n_trials=200):
    """Return the speeds on small and on large scales 1 to 6 mas from the core."""
    components = read_components(data / "mojave_xviii" / "1226+023.ecsv")
    cube = restore(
        components.select(before=before),
        beam=Beam(1.0 * u.mas, 0.5 * u.mas, -7 * u.deg),
        pixel_scale=0.1 * u.mas,
        noise=0.3 * u.mJy / u.beam,
        rng=1,
    )
    scc = StackedCrossCorrelation(
        scales=[1, 2, 3, 4],
        max_speed=2 * u.mas / u.yr,
        position_angle=-138 * u.deg,
        baseline=[0.25, 1.2] * u.yr,
    )
    profile = measure_profile(
        scc, cube, [1, 6] * u.mas, scale_groups="1, 2; 3, 4", n_trials=n_trials, rng=1
    )
    table = profile.components_in_c(redshift=0.158, cosmology=paper_cosmology())
    columns = "pm_parallel", "pm_parallel_err", "beta_app", "beta_app_err", "p_global"
    table = brief(table, "scale_group", "kind", *columns)
    return table, profile.results["1, 2"][0].plot("spectrum")


if __name__ == "__main__":
    run(measure, __doc__, data=True)
