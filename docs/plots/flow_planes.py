# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Flow planes of a simulated jet: what moves is a slanted line."""

import astropy.units as u
import matplotlib.pyplot as plt

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import simulate_jet

jet = simulate_jet(n_epochs=20, dispersion=0.15, rng=4)
scc = StackedCrossCorrelation(position_angle=270 * u.deg)
flow = scc.flow(scc.decompose(jet.cube))
planes, grid = flow.planes[0], flow.grids[0]
values = planes.values[-1].mean(axis=2)
distance = grid.along * grid.beam

figure, ax = plt.subplots(figsize=(7, 3.2), layout="constrained")
colours = {"cmap": "RdBu_r", "vmin": -0.8, "vmax": 0.8, "shading": "nearest"}
drawn = ax.pcolormesh(distance, planes.years, values, **colours)
ax.set(xlabel="distance along the jet (mas)", ylabel="years since the first epoch")
ax.set_xlim(0, distance[planes.mask.any(axis=1)].max())
figure.colorbar(drawn, label="change of the plane")
