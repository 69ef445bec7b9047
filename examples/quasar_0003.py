# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure ten epochs of the quasar 0003+380, a jet with few features, of MOJAVE.

    python examples/quasar_0003.py apjac230ft4_mrt.txt
"""

import astropy.units as u
from common import brief, run

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.epochs import distance_mask, read_components, restore
from astro_scc.kinematics import paper_cosmology


def measure(table, n_trials=1000):
    """Return the speed of the jet 1 to 3 mas from the core, and its features."""
    cube = restore(
        read_components(table, source="0003+380"),
        beam=Beam(0.9 * u.mas, 0.6 * u.mas, -10 * u.deg),
        pixel_scale=0.1 * u.mas,
        noise=0.3 * u.mJy / u.beam,
        rng=1,
    )
    scc = StackedCrossCorrelation(
        max_speed=1 * u.mas / u.yr, position_angle=115 * u.deg
    )
    ring = distance_mask(cube, 1 * u.mas, 3 * u.mas)
    result = scc(cube, region=ring, n_trials=n_trials, rng=1)
    found = result.components_in_c(redshift=0.229, cosmology=paper_cosmology())
    columns = "pm_parallel", "pm_parallel_err", "beta_app", "beta_app_err", "p_global"
    return brief(found, "kind", *columns, "n_features"), result.plot("tracks")


if __name__ == "__main__":
    run(measure, __doc__, data=True)
