# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Read, convolve, align and measure ten epochs of the quasar 0003+380.

    python examples/quasar_0003.py ../shared/data
"""

import astropy.units as u
from common import brief, run

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.epochs import distance_mask
from astro_scc.kinematics import paper_cosmology


def measure(data, n_trials=1000):
    """Return the speed of the jet 1 to 3 mas from the core, and its features."""
    folder = data / "0003+380"
    cube = EpochCube.read(f"{folder}/*.fits").to_common_beam()
    cube = cube.align("table", table=folder / "core_offsets.csv")
    scc = StackedCrossCorrelation(
        scales=[1, 2, 3], max_speed=1 * u.mas / u.yr, position_angle=115 * u.deg
    )
    ring = distance_mask(cube, 1 * u.mas, 3 * u.mas)
    result = scc(cube, region=ring, n_trials=n_trials, rng=1)
    table = result.components_in_c(redshift=0.229, cosmology=paper_cosmology())
    columns = "pm_parallel", "pm_parallel_err", "beta_app", "beta_app_err", "p_global"
    return brief(table, "kind", *columns, "n_features"), result.plot("tracks")


if __name__ == "__main__":
    run(measure, __doc__, data=True)
