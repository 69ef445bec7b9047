# Licensed under a 3-clause BSD style license - see LICENSE.rst
import matplotlib.pyplot as plt

from astro_scc.simulation import simulate_jet

cube = simulate_jet(n_epochs=4, rng=4, standing=1).cube
figure, axes = plt.subplots(1, 2, figsize=(8, 2.4), layout="constrained")
for ax, i in zip(axes, (0, 3)):
    cube.plot(i, ax=ax)
    ax.set_title(cube.labels[i], fontsize="small")
