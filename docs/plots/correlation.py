# Licensed under a 3-clause BSD style license - see LICENSE.rst
import matplotlib.pyplot as plt
import numpy as np

from astro_scc.decomposition import Decomposer
from astro_scc.images.zncc import correlate_windows
from astro_scc.paper import Correlator
from astro_scc.simulation import simulate_two_fluid

cube = simulate_two_fluid(n_epochs=2, rng=1).cube
epochs = [Decomposer(scales=[1, 2, 3])(image) for image in cube.data]
radius = (8, 25)
matches = Correlator(kappa=0.7)(epochs, [(0, 1)], radius)
ssps = epochs[0].ssps
ssp = ssps.snr.argmax()
scale, (y0, x0, y1, x1) = ssps.scale[ssp], ssps.bbox[ssp]
number = epochs[0].scales.index(scale)
own, target = np.zeros(cube.data.shape[1:], bool), np.zeros(cube.data.shape[1:])
own.flat[ssps.pixels_of(ssp)] = True
inside = epochs[1].ssps.select(epochs[1].ssps.scale == scale).pixels
target.flat[inside] = epochs[1].planes[number].flat[inside]
dy, dx = radius
window = (slice(y0 - dy, y1 + dy), slice(x0 - dx, x1 + dx))
extent = np.array([x0 - dx, x1 + dx, y0 - dy, y1 + dy]) - 0.5
coefficient, _ = correlate_windows(
    epochs[0].planes[number, y0:y1, x0:x1], own[y0:y1, x0:x1], target[window], radius
)
figure, axes = plt.subplots(3, 1, figsize=(6, 7), layout="constrained")
look = {"origin": "lower", "cmap": "magma", "vmin": 0, "vmax": target[window].max()}
first = np.where(own, epochs[0].planes[number], 0)[window]
for ax, plane, title in (
    (axes[0], first, "SSP of the first epoch"),
    (axes[1], target[window], "the second epoch: its plane inside its SSPs"),
):
    ax.imshow(plane, extent=extent, **look)
    ax.set_title(title, fontsize="small")
    ax.set(xlabel="x (px)", ylabel="y (px)")
mapped = axes[2].imshow(
    coefficient,
    origin="lower",
    cmap="RdBu_r",
    vmin=-1,
    vmax=1,
    extent=(-dx - 0.5, dx + 0.5, -dy - 0.5, dy + 0.5),
)
peaks = matches.select(matches.ssp == ssp)
axes[2].plot(peaks.dx, peaks.dy, "k+", markersize=9)
axes[2].set_title("coefficient of each displacement, and its peaks", fontsize="small")
axes[2].set(xlabel="dx (px)", ylabel="dy (px)")
figure.colorbar(mapped, ax=axes[2])
