# Licensed under a 3-clause BSD style license - see LICENSE.rst
from matplotlib import pyplot as plt

from astro_scc.features import find_features
from astro_scc.simulation import simulate_jet
from astro_scc.visualization.tracks import plot_separation, plot_tracks

features = find_features(simulate_jet(n_epochs=12, dispersion=0.1, rng=1).cube)
plot_separation(features, ax=plt.figure(figsize=(6, 4)).add_subplot())
plot_tracks(features, figure=plt.figure(figsize=(6, 3), layout="compressed"))
