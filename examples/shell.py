# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure the expansion rate and the centre of a shell.

    python examples/shell.py
"""

import astropy.units as u
from astropy.table import QTable
from common import brief, run

from astro_scc import StackedCrossCorrelation
from astro_scc.expansion import expansion_speed, fit_shell
from astro_scc.simulation import simulate_shell


def measure():
    """Return the rate of expansion, and the speed at 3.4 kpc."""
    shell = simulate_shell(
        n_epochs=3, interval=10 * u.yr, n_clumps=8, n_knots=40,
        radius=70 * u.arcsec, size=200, rng=4,
    )  # fmt: skip
    scc = StackedCrossCorrelation(
        scales=[1], max_speed=150 * u.mas / u.yr, baseline=[10, 20] * u.yr,
        min_error_beams=0.1, detection=7, segmentation=5,
    )  # fmt: skip
    matched = scc.match(shell.cube)
    fit = fit_shell(scc, matched)
    table = QTable({
        "rate": fit.rate,
        "rate_err": fit.rate_err,
        "speed": expansion_speed(fit.rate, 70 * u.arcsec, 3.4 * u.kpc),
        "centre_east": u.Quantity([fit.centre[0]]).to(u.arcsec),
        "centre_north": u.Quantity([fit.centre[1]]).to(u.arcsec),
    })  # fmt: skip
    figure = shell.cube.plot(0, matched.ssps, zoom=False)
    return brief(table, *table.colnames, digits=3, speed=0), figure


if __name__ == "__main__":
    run(measure, __doc__)
