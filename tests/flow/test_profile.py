# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Profiles of simulated jets, from stacks of their SSPs and from their features."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

from astro_scc import StackedCrossCorrelation
from astro_scc.flow import feature_profile, measure_acceleration, measure_profile
from astro_scc.flow.profile import bins_of, write_profile
from astro_scc.kinematics import RidgeLine, paper_cosmology
from astro_scc.measurement.axes import projection_of
from astro_scc.measurement.matched import select_ssps, ssp_distances
from astro_scc.measurement.tables import component_table
from astro_scc.simulation import simulate_jet
from astro_scc.streams.dispersion import feature_speeds, random_effects

PM = u.mas / u.yr


@pytest.fixture(scope="module")
def profile(scc, matched):
    return measure_profile(scc, matched, [0, 7, 14, 90, 99] * u.mas, n_trials=20, rng=1)


def test_a_bin_is_a_stack_of_its_ssps(scc, matched, profile):
    inside = ssp_distances(matched).value
    for (low, high), result in zip(profile.bins.value, profile.results, strict=True):
        own = (inside >= low) & (inside < high)
        if result is None:
            assert not own.any()
            continue
        np.testing.assert_array_equal(result.matched.select, own)
        # Nothing is correlated again.
        assert result.matched.matches is matched.matches


def test_columns_and_adjusted_probabilities(profile):
    table = profile.components
    names = table.colnames
    assert names[:3] == ["r_min", "r_max", "r_mid"]
    assert [n for n in component_table([]).colnames if n not in names] == []
    assert np.all(table["p_fdr"] >= table["p_global"])
    assert table["r_mid"].unit == u.mas
    # An empty bin was searched too, and what stands still is not tested.
    moves = table["kind"] != "stationary"
    tested = [np.sum(moves & (table["r_min"] == low)) for low in profile.bins[:, 0]]
    assert table.meta["false_discovery"]["n_tests"] == np.maximum(tested, 1).sum()
    assert table.meta["seed"] == 1
    assert profile.results[3] is None
    assert "4 bins from 0" in repr(profile)


REFUSED = [
    (lambda *_: bins_of([1.0] * u.mas), "2 distance"),
    (lambda *_: bins_of([2.0, 1.0] * u.mas), "bins = .* must be increasing distances"),
    (lambda *_: bins_of([1.0, 2.0] * u.mas, window=0 * u.mas), "window = 0.0 mas must"),
    (lambda *of: measure_profile(*of, [80, 90] * u.mas), "no SSP lies in the bins"),
    (lambda _, m: select_ssps(m, r_min=3 * u.mas, r_max=2 * u.mas), "must be below"),
    (lambda _, m: select_ssps(m, scales=[1, 4]), "scale 4 was not decomposed"),
]


@pytest.mark.parametrize(("call", "words"), REFUSED)
def test_what_makes_no_sense_is_refused(scc, matched, call, words):
    with pytest.raises(ValueError, match=words):
        call(scc, matched)


def test_along_a_ridge_line(scc, matched):
    # A line that begins at 5 mas: distances along it are smaller by as much.
    line = RidgeLine([-5, -25] * u.mas, [0, 0] * u.mas)
    s = ssp_distances(matched, ridge=line).value
    r = ssp_distances(matched, origin=[-5, 0] * u.mas).value
    far = (r > 5) & (s > 0)
    np.testing.assert_allclose(s[far], r[far], atol=1.0)
    bins = [3, 15] * u.mas
    found = measure_profile(scc, matched, bins, ridge=line, n_trials=20, rng=1)
    assert found.components.meta["along"] == "ridge"


def test_selections(matched):
    inner = select_ssps(matched, r_max=8 * u.mas, scales=[2])
    assert set(matched.ssps.scale[inner.select]) == {2.0}
    region = np.zeros(matched.cube.shape[1:], bool)
    region[:, :100] = True
    left = select_ssps(matched, region=region)
    assert matched.ssps.x_centroid[left.select].max() < 100
    by_angle = select_ssps(matched, scales=[0.4] * u.mas)
    np.testing.assert_array_equal(
        by_angle.select, select_ssps(matched, scales=[2]).select
    )
    windows = bins_of([2.0, 9.0] * u.mas, window=5 * u.mas)
    assert windows.value.tolist() == [[0, 4.5], [6.5, 11.5]]


@pytest.fixture(scope="module")
def accelerated():
    """Features that are three times as fast at the end of the jet, and their truth."""
    jet = simulate_jet(n_epochs=20, acceleration=3.0, dispersion=0.05, rng=1)
    scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    return scc(jet.cube, n_trials=30, rng=1), jet.truth


def test_acceleration_is_that_of_the_features(accelerated):
    result, truth = accelerated
    found = measure_acceleration(result)
    moving = truth[truth["group"] == "flow"]
    distance = -moving["east"].to_value(u.mas)
    slope = np.polyfit(distance, -moving["pm_east"].to_value(PM), 1)[0]
    assert abs(found.gradient.value - slope) < 3 * found.gradient_err.value
    assert found.p_value < 0.05
    assert u.isclose(found.acceleration, found.gradient * found.speed)
    assert u.isclose(found.acceleration_err, found.gradient_err * found.speed)
    assert str(found).startswith("acceleration: ")
    assert found.centre > 2 * u.mas


def test_acceleration_of_what_is_not_there(accelerated):
    result, _ = accelerated
    (row,) = np.flatnonzero(result.components["kind"] == "stationary")
    still = measure_acceleration(result, row)
    assert np.isnan(still.p_value)
    assert "unknown, as four features are needed" in str(still)
    with pytest.raises(ValueError, match=f"row must be from 0 to {row}, got 9"):
        measure_acceleration(result, 9)


def test_products(profile, tmp_path):
    table = profile.components_in_c(redshift=0.1, cosmology=paper_cosmology())
    paths = write_profile(
        profile, table, tmp_path, configuration={"seed": 1}, text="seed = 1\n"
    )
    assert sorted(p.name for p in paths) == sorted(p.name for p in tmp_path.iterdir())
    again = QTable.read(tmp_path / "profile.ecsv", format="ascii.ecsv")
    assert again.colnames == table.colnames
    assert again.meta["configuration"] == {"seed": 1}
    assert again.meta["cosmology"]["Om0"] == 0.27
    np.testing.assert_array_equal(again["pm"], table["pm"])


def test_bins_hold_all_features_in_order_with_their_mean_speeds(accelerated):
    result, _ = accelerated
    profile, stream = feature_profile(result), result.search.streams[0]
    assert stream.kind == "moving"
    assert profile["n_features"].sum() == len(stream.features)
    assert np.all(profile["n_features"] >= 5)
    limits = np.stack([profile[k].value for k in ("r_min", "r_mid", "r_max")], axis=1)
    assert np.all(np.diff(limits.ravel()) >= 0)
    features = sorted(stream.features, key=lambda feature: abs(feature.place))
    mean = random_effects(*feature_speeds(features[: profile["n_features"][0]]))
    beam = projection_of(result).beam(stream.angle)[0]
    assert profile["pm_parallel"][0].value == pytest.approx(mean.mean * beam)
    assert profile["dispersion"][0].value == pytest.approx(mean.dispersion * beam)
