# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The velocity spectrum, and speeds against distance."""

import numpy as np
import pytest


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
