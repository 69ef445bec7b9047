# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

from astro_scc import StackedCrossCorrelation
from astro_scc.recovery import completeness
from astro_scc.simulation import JetSimulation, Stream

sheath = Stream("sheath", dx=5.0, density=0.5, half_width=10.0, jitter=1.0)
jet = JetSimulation(
    [sheath], n_epochs=6, shape=(64, 160), extent=(10, 150), axis=32.0, noise=0.01
)
scc = StackedCrossCorrelation(
    scales=[2], max_speed=36 * u.mas / u.yr, position_angle=270 * u.deg
)
table = completeness(
    jet.run(rng=1).cube,
    scc,
    speeds=20 * u.mas / u.yr,
    fluxes=[0.5, 5, 20, 100],
    n_features=10,
    n_injections=4,
    n_trials=100,
    rng=1,
)
fraction = np.asarray(table["fraction"], dtype=float)
low, high = (
    np.asarray(table[name], dtype=float) for name in ("fraction_low", "fraction_high")
)
figure, ax = plt.subplots(figsize=(6, 3), layout="constrained")
ax.errorbar(
    np.asarray(table["snr"], dtype=float),
    fraction,
    yerr=[fraction - low, high - fraction],
    fmt="o-",
    color="black",
    capsize=3,
)
ax.set(
    xscale="log",
    ylim=(-0.05, 1.05),
    xlabel="peak of the features over the noise",
    ylabel="fraction found",
)
