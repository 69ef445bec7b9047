# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The diagram and the velocity spectrum of the paper's two-fluid jet."""

import astropy.units as u
import matplotlib.pyplot as plt

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import simulate_two_fluid

cube = simulate_two_fluid(rng=3).cube
scc = StackedCrossCorrelation(position_angle=270 * u.deg, max_speed=40 * u.mas / u.yr)
result = scc(cube, n_trials=500, rng=1)
_, ax = plt.subplots(figsize=(6, 4.2), layout="compressed")
result.plot("diagram", ax=ax)
result.plot("spectrum", figure=plt.figure(figsize=(6, 4.8), layout="compressed"))
