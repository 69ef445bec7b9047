# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Truths that a mistake once broke in silence, and the share of false alarms."""

import pickle

import astropy.units as u
import numpy as np
import pytest

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.simulation import simulate_jet
from astro_scc.units import PM_UNIT


@pytest.mark.parametrize("frame", ["jet", "sky", "radial"])
def test_no_emission_is_counted_twice(jet_results, frame):
    result = jet_results[frame]
    table = result.feature_positions
    places = zip(table["epoch"], table["ra_offset"], table["dec_offset"], strict=True)
    assert len({(k, x.value, y.value) for k, x, y in places}) == len(table) > 20
    members = np.concatenate([stream.members for stream in result.search.streams])
    assert len(set(members.tolist())) == len(members) > 0


def test_what_is_promised_is_searched(jet_results):
    result = jet_results["jet"]
    table, promised = result.spectrum, result.streams.meta
    tested = np.abs(table["pm_parallel"][np.isfinite(table["z"])].to_value(PM_UNIT))
    # The next speeds, below and above, are a twelfth off.
    low, high = (promised[k].to_value(PM_UNIT) for k in ("slowest", "fastest"))
    assert tested.min() == pytest.approx(low, rel=0.12)
    assert tested.max() == pytest.approx(high, rel=0.12)


def test_a_radial_frame_and_a_position_angle_give_the_same_features(jet_results):
    one, other = (jet_results[frame].features for frame in ("jet", "radial"))
    assert len(one) > 4
    for name in ("feature", "stream", "secure", "pm", "pm_err", "separation"):
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_a_direction_that_is_found_gives_the_same_flow_by_default_and_by_name(
    decomposed,
):
    flows = [
        StackedCrossCorrelation(position_angle=k).flow(decomposed)
        for k in (None, "fit", 270 * u.deg)
    ]
    assert [flow.given for flow in flows] == [False, False, True]
    np.testing.assert_array_equal(flows[0].planes[0].values, flows[1].planes[0].values)


def test_a_region_lacking_a_scale_loses_nothing(jet_cube, decomposed):
    """Patterns of the other scales are used, and the speed is the same."""
    ssps, region = decomposed.ssps, np.ones(jet_cube.shape[1:], dtype=bool)
    x, y = (np.rint(v).astype(int) for v in (ssps.x_centroid, ssps.y_centroid))
    region[y[ssps.scale == 3], x[ssps.scale == 3]] = False
    rows, used = [], []
    for scales in ([1, 2, 3], [1, 2]):
        scc = StackedCrossCorrelation(
            scales=scales, position_angle=270 * u.deg, max_speed=30 * PM_UNIT
        )
        part = scc.decompose(jet_cube, region=region)
        used.append(np.bincount(part.ssps.scale[part.select].astype(int)).tolist())
        rows.append(scc.measure(part, n_trials=99, rng=1).streams[0])
    assert used[0] == used[1]
    assert min(used[0][1:]) > 10
    assert rows[0]["kind"] == rows[1]["kind"] == "moving"
    assert abs(rows[0]["pm"] - rows[1]["pm"]) < 0.1 * rows[0]["pm_err"]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ((1000 * u.uas, 500 * u.uas), (1 * u.mas, 0.5 * u.mas)),
        ((1 * u.mas, 0.5 * u.mas, -7 * u.deg), (1 * u.mas, 0.5 * u.mas, 173 * u.deg)),
        ((1 * u.mas, 1 * u.mas), (1 * u.mas, 1 * u.mas, 30 * u.deg)),
        ((3 * u.mas, 1 * u.mas), (np.float32(3 / 3.6e6) * u.deg, 1 * u.mas)),
    ],
)
def test_equal_beams_are_equal_in_a_set(one, other):
    one, other = Beam(*one), Beam(*other)
    assert one == other
    assert len({one, other, pickle.loads(pickle.dumps(one))}) == 1
    wider = Beam(1.001 * one.major, one.minor, one.pa)
    assert len({one, other, wider}) == 2
    assert one not in (1, "beam", wider)


ALPHA = 0.05
N_JETS = 80
#: False alarms that are allowed.  With 20% of false alarms 80 jets have more than 10 in
#: 94.3% of all cases (binomial distribution), with 5% in 0.2%.
MOST = 10


def measure(seed):
    """Both probabilities of the strongest row of a static jet, and if it is moving."""
    still = {"n_features": 0, "standing": 4, "memory": 0.0, "length": 8.0}
    jet = simulate_jet(**still, n_epochs=7, rng=seed)
    how = {"scales": [1, 2], "position_angle": 270 * u.deg, "alpha": ALPHA}
    scc = StackedCrossCorrelation(**how)
    table = scc(jet.cube, n_trials=39, rng=seed).components
    rows = table[table["kind"] != "stationary"]
    if len(rows) == 0:
        return 1.0, 1.0, False
    return rows["p_global"][0], rows["p_local"][0], "moving" in rows["kind"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::astro_scc.exceptions.MeasurementWarning")
def test_static_jets_give_few_false_alarms():
    found = zip(*map(measure, range(N_JETS)), strict=True)
    p_global, p_local, moving = map(np.array, found)
    assert np.sum(p_global <= ALPHA) <= MOST
    assert np.sum(moving) <= MOST
    # The guard would see a wrong null, such as that of one speed, which does not know
    # of the search among all of them.
    assert np.sum(p_local <= ALPHA) > MOST
