# Licensed under a 3-clause BSD style license - see LICENSE.rst
import matplotlib.pyplot as plt

from astro_scc.simulation import simulate_random_velocity, simulate_two_fluid

figure, axes = plt.subplots(2, 1, figsize=(6, 5), layout="constrained")
for ax, simulate in zip(axes, (simulate_two_fluid, simulate_random_velocity)):
    jet = simulate(n_epochs=2, rng=1)
    jet.cube.plot(0, ax=ax)
    first = jet.truth[(jet.truth["epoch"] == 0) & jet.truth["visible"]]
    fast = first["group"] == "fast"
    for part, color in ((~fast, "white"), (fast, "#E69F00")):
        rows = first[part]
        ax.quiver(
            rows["east"].value,
            rows["north"].value,
            rows["pm_east"].value,
            rows["pm_north"].value,
            color=color,
            angles="xy",
            scale_units="xy",
            scale=12.2,
            width=0.004,
        )
    ax.set_title(jet.cube.meta["object"], fontsize="small")
