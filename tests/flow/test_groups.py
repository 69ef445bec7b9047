# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Groups of SSPs by scale and by side of a simulated jet, and what must be refused."""

from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from scipy.stats import ttest_ind

from astro_scc import StackedCrossCorrelation
from astro_scc.flow import compare_speeds, scale_groups
from astro_scc.flow.speeds import _difference, _groups_of, _mean
from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import SkyFrame
from astro_scc.simulation import JetSimulation, Stream

PM = u.mas / u.yr
PER_PIXEL = 0.1 / 30 * 365.25


SCC = StackedCrossCorrelation(
    scales=[1, 2], max_speed=20 * PM, position_angle=270 * u.deg
)


@pytest.fixture(scope="module")
def matched():
    """A jet that is faster on its northern side, by 4 pixels an epoch."""
    flow = Stream(
        "flow", dx=lambda x, y: np.where(y > 64, 8.0, 4.0), half_width=25.0, density=1.5
    )
    jet = JetSimulation([flow], n_epochs=10, extent=(20.0, 240.0))
    return SCC.match(jet.run(rng=2).cube)


@pytest.fixture(scope="module")
def sides(matched):
    _, north = ssp_offsets(matched.ssps, matched.cube, centroid=True)
    return {"south": north < -0.5, "north": north > 0.5}


@pytest.fixture(scope="module")
def result(matched):
    return SCC.stack(matched, n_trials=20, rng=1)


def test_sides_have_their_speeds(sides, result):
    (row,) = compare_speeds(result, sides)
    assert row["p_value"] < 0.05
    error = row["difference_err"].value
    assert abs(row["difference"].value - 4 * PER_PIXEL) < 3 * error
    assert abs(row["first_speed"].value - 4 * PER_PIXEL) < 1
    assert abs(row["second_speed"].value - 8 * PER_PIXEL) < 1
    assert row["first_n_ssp"] == sides["south"].sum()
    # Welch's test, by scipy.
    features = [
        f for s in result.search.streams if s.kind == "moving" for f in s.features
    ]
    assert row["first_n_features"] + row["second_n_features"] == len(features)


def test_the_difference_is_that_of_welch():
    """Errors that are small beside the scatter: the test of samples."""
    rng = np.random.default_rng(2)
    samples = rng.normal(1.0, 0.1, 6), rng.normal(1.3, 0.2, 9)
    means = [
        _mean([SimpleNamespace(speed=v, error=1e-9, pulled=False) for v in sample], 1)
        for sample in samples
    ]
    # Errors of features hold two per cent of their speeds.
    found = _difference(*means)
    expected = ttest_ind(*samples, equal_var=False)
    assert found[0] == pytest.approx(samples[1].mean() - samples[0].mean(), rel=0.02)
    assert found[2] == pytest.approx(expected.pvalue, rel=0.3)


def test_what_is_not_seen_is_unknown(result, sides):
    every = sides["north"] | sides["south"]
    (row,) = compare_speeds(result, {"all": every, "none": ~every & False})
    assert row["second_n_features"] == 0
    assert np.isnan(row["second_speed"])
    assert np.isnan(row["p_value"])


def test_refused(matched, sides, result):
    everything = {"a": matched.select, "b": matched.select}
    with pytest.raises(ValueError, match="'a' and 'b' share SSPs"):
        compare_speeds(result, everything)
    with pytest.raises(ValueError, match="two groups or more, got 1"):
        scale_groups(matched, {"a": [1]})
    with pytest.raises(ValueError, match="direction of the flow is needed"):
        compare_speeds(replace(result, frame=SkyFrame()), sides)


def test_features_are_divided_where_their_shares_leave_a_gap():
    """Three large features among eight small ones, and one on the fine scale only."""
    ratio = np.array([0.3, 0.25, 0.2, 0.9, 1.0, 0.95, 1.05, 1.1, 0.92, 1.0, 0.98])
    peak = np.column_stack([ratio, np.ones(11)]).ravel()
    place = np.repeat(5.0 * np.arange(12), 2)[:23]
    d = SimpleNamespace(
        epoch=np.zeros(23, dtype=int), position=np.column_stack([place, 0 * place])
    )
    features = [SimpleNamespace(ssp=[2 * k]) for k in range(12)]
    fine = np.arange(23) % 2 == 0
    ssps = SimpleNamespace(peak=np.append(peak, 2.0))
    belongs = _groups_of(features, d, ssps, [fine, ~fine])
    assert belongs.tolist() == [1, 1, 1, *[0] * 9]
