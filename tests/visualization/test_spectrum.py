# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The velocity spectrum, and speeds against distance."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc.visualization.spectrum import spectra_of_bins


def parts(figure, gid):
    return [artist for artist in figure.findobj() if artist.get_gid() == gid]


@pytest.mark.parametrize("frame", ["jet", "sky"])
def test_the_spectrum_is_that_of_the_tables(frame, jet_results):
    result = jet_results[frame]
    figure = result.plot(unit="uas/yr", beta_per_pm=2.0)
    upper, lower = figure.axes
    table = result.spectrum
    outward = table[table["pm_parallel"] > 0]
    speed, share = upper.lines[0].get_data()
    np.testing.assert_allclose(speed, outward["pm_parallel"].to_value("uas/yr"))
    np.testing.assert_allclose(share, outward["share"])
    # The peak is at the stream, and above the level of permutations.
    along = result.streams["pm"][0].to_value("uas/yr")
    assert speed[share.argmax()] == pytest.approx(along, rel=0.15)
    v, z = lower.lines[0].get_data()
    (level, *_) = {line.get_ydata()[0] for line in parts(figure, "level")} - {0}
    assert z.max() > abs(level) == result.search.test.level
    assert v[z.argmax()] == pytest.approx(along, rel=0.3)
    figure.draw_without_rendering()
    (axis,) = (own for own in upper.child_axes if own.get_xlabel())
    np.testing.assert_allclose(axis.get_xlim(), np.multiply(upper.get_xlim(), 0.002))


@pytest.mark.parametrize("frame", ["jet", "sky", "radial"])
def test_bins_of_distance_have_the_speed_of_the_jet(frame, jet_results):
    result = jet_results[frame]
    edges, speed, share = spectra_of_bins(result.search)
    assert share.shape == (len(speed), len(edges) - 1)
    np.testing.assert_allclose(share.sum(axis=0)[share.any(axis=0)], 1)
    main = result.streams["pm"][0].value
    # Outward, beyond what is close to the core.
    outward = np.where((speed > 0)[:, None], share, 0)
    alike = np.abs(speed[outward.argmax(axis=0)] / main - 1) < 0.3
    assert alike[1:].mean() >= 0.75
    ax = result.plot("distance", unit="uas/yr").axes[0]
    features = result.features
    points = np.array([own.lines[0].get_xydata()[0] for own in ax.containers])
    np.testing.assert_allclose(points[:, 0], features["separation"].to_value(u.mas))
