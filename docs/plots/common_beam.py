# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import matplotlib.pyplot as plt

from astro_scc.epochs import Beam
from astro_scc.simulation import simulate_two_fluid

beams = [
    Beam(size * u.mas, 0.5 * u.mas, angle * u.deg)
    for size, angle in [(1.4, 0), (1.2, -40)]
]
cube = simulate_two_fluid(n_epochs=2, beams=beams, core=3.0, rng=1).cube
smooth = cube.to_common_beam()
figure, axes = plt.subplots(2, 2, figsize=(6, 3.6), layout="constrained")
names = "each with its own beam", "the smallest common one"
for column, images, name in zip(axes.T, (cube, smooth), names):
    for i, ax in enumerate(column):
        images.plot(i, ax=ax)
        ax.set_title(name if i == 0 else "", fontsize="small")
        ax.set(xlabel="Relative R.A. (mas)", ylabel="Relative Decl. (mas)")
