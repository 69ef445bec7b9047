# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np

from astro_scc.kinematics import beta_intrinsic, lorentz_factor, maximum_viewing_angle

figure, ax = plt.subplots(figsize=(6, 3.4), layout="constrained")
for beta_app, color in zip((2, 4, 6, 10), ("#0072B2", "#D55E00", "#009E73", "#CC79A7")):
    largest = maximum_viewing_angle(beta_app).value
    angle = np.linspace(0.3, largest - 0.01, 600)
    gamma = lorentz_factor(beta_intrinsic(beta_app, angle * u.deg))
    ax.plot(angle, gamma, color=color, label=f"{beta_app} c")
ax.set_yscale("log")
ax.set_yticks([2, 5, 10, 20, 50], labels=["2", "5", "10", "20", "50"])
ax.minorticks_off()
ax.set(
    ylim=(1.5, 60),
    xlim=(0, 60),
    xlabel="viewing angle (deg)",
    ylabel="Lorentz factor of the flow",
)
small = {"fontsize": "small", "title_fontsize": "small"}
ax.legend(title="apparent speed", loc="center left", bbox_to_anchor=(1, 0.5), **small)
