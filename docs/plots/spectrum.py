# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The diagram and the velocity spectrum of the paper's two-fluid jet."""

import sys

import astropy.units as u

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import simulate_two_fluid

cube = simulate_two_fluid(rng=3).cube
scc = StackedCrossCorrelation(position_angle=270 * u.deg, max_speed=40 * u.mas / u.yr)
result = scc(cube, n_trials=500, rng=1)
figures = [result.plot(kind) for kind in ("diagram", "spectrum")]
if len(sys.argv) > 1:
    for figure, name in zip(figures, ("diagram", "spectrum"), strict=True):
        figure.savefig(f"{sys.argv[1]}/{name}.png")
