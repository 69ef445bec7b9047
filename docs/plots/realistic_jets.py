# Licensed under a 3-clause BSD style license - see LICENSE.rst
import matplotlib.pyplot as plt

from astro_scc.simulation import simulate_jet

jet = simulate_jet(n_epochs=4, rng=4, standing=1)
cubes = {
    "features in the beam": jet.cube,
    "with ripples and bowls": simulate_jet(
        n_epochs=4, rng=4, standing=1, ripple=0.002, bowl=0.003
    ).cube,
}
figure, axes = plt.subplots(2, 2, figsize=(8, 4.4), layout="constrained")
for line, (name, cube) in zip(axes, cubes.items()):
    for ax, i in zip(line, (0, 3)):
        cube.plot(i, ax=ax)
        ax.set_title(f"{name}, {cube.labels[i]}", fontsize="small")
