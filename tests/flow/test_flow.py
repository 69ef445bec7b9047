# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Bins, scales and cells of simulated flows, their covariance, and fits of profiles."""

from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.wcs import WCS
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.special import stdtr

from astro_scc import StackedCrossCorrelation
from astro_scc.flow import (
    compare_scales,
    fit_profile,
    measure_acceleration,
    measure_field,
    measure_profile,
)
from astro_scc.flow.models import slope_of
from astro_scc.flow.profile import bins_of, write_profile
from astro_scc.flow.speeds import distances_along, speeds_in_parts
from astro_scc.kinematics import ExpansionFrame, PositionAngleFrame, RidgeLine
from astro_scc.simulation import simulate_jet
from astro_scc.streams.decomposed import decompose_flow, fit_part

PM = u.mas / u.yr
SCC = StackedCrossCorrelation(position_angle=270 * u.deg)
WEST = PositionAngleFrame(270 * u.deg)
BINS = [1.6, 4.0, 6.4, 99, 120] * u.mas


def flow_of(cube):
    return decompose_flow(cube, WEST, beam=cube.resolution.to_value(u.mas))


@pytest.fixture(scope="module")
def jet():
    """Features that are three times as fast at the end of the jet."""
    how = {"n_epochs": 20, "n_features": 10, "dispersion": 0.05, "rng": 1}
    return simulate_jet(acceleration=3.0, **how)


@pytest.fixture(scope="module")
def half(jet):
    return SCC.decompose(jet.cube[::2])


@pytest.fixture(scope="module")
def result(jet):
    return SCC(jet.cube, n_trials=199, rng=1)


@pytest.fixture(scope="module")
def profile(result):
    return measure_profile(SCC, result.decomposed, BINS, n_trials=99, rng=1)


def test_a_bin_has_what_moves_in_it(profile, result, tmp_path):
    table = profile.components
    assert "4 bins from 1.6" in repr(profile)
    # An empty bin was searched too, and what stands still is not tested.
    assert profile.results["all"][3] is None
    moves = table["kind"] != "stationary"
    tested = [np.sum(moves & (table["r_min"] == low)) for low in profile.bins[:, 0]]
    assert table.meta["false_discovery"]["n_tests"] == np.maximum(tested, 1).sum()
    assert np.all(table["p_fdr"][moves] >= table["p_global"][moves])
    assert profile.main["kind"][:2].tolist() == ["moving"] * 2
    assert profile.main["pm"][0] < profile.main["pm"][1]
    windows = bins_of([2.0, 9.0] * u.mas, window=5 * u.mas)
    assert windows.value.tolist() == [[0, 4.5], [6.5, 11.5]]
    # Features belong to the bin of their mean place.
    distance = distances_along(profile.flow, result.decomposed.features.places)
    every = zip(profile.bins.value[:3], profile.results["all"], strict=False)
    for (low, high), found in every:
        own = [k for stream in found.search.streams for k in stream.members]
        assert np.all((distance[own] >= low) & (distance[own] < high))
    # Speeds from a scale without SSPs have no figure of their position angles.
    finest = replace(profile.flow.planes[0], scales=(0,))
    alone = replace(profile, flow=replace(profile.flow, planes=(finest,)))
    for found, n in ((profile, 4), (alone, 3)):
        assert len(write_profile(found, table, tmp_path)) == n


def test_the_acceleration_is_that_of_the_simulation(jet, result, profile):
    moving = jet.truth[jet.truth["group"] == "flow"]
    distance = -moving["east"].to_value(u.mas)
    speed = -moving["pm_east"].to_value(PM)
    known = np.isfinite(speed) & (distance > 1.6)
    true = np.polyfit(distance[known], speed[known], 1)[0]
    for found in (measure_acceleration(result), profile.acceleration):
        assert found.n_parts >= 3
        error = found.gradient_err.value
        assert abs(found.gradient.value - true) < 2.5 * error + 0.2 * true
        assert found.p_value < 0.05
        assert u.isclose(found.acceleration, found.gradient * found.speed)
        assert str(found).startswith("acceleration: 0.")
        rise = found.line(2 * found.centre) - found.speed
        assert u.isclose(rise, found.gradient * found.centre)
    with pytest.raises(ValueError, match="row must be from 0 to .*, got 9"):
        measure_acceleration(result, 9)
    # Speeds of which one bin alone moves have no slope.
    slow = replace(profile, results={"all": (profile.results["all"][0], *[None] * 3)})
    assert "significant in fewer than two of the bins" in str(slow.acceleration)
    assert np.isnan(slow.components.meta["acceleration"]["all"]["gradient"])


def test_along_a_ridge_line_and_in_windows(half):
    line = RidgeLine([0, -20] * u.mas, [0, 0] * u.mas)
    edges, how = [2.0, 6.0] * u.mas, {"n_trials": 9, "rng": 1}
    found = measure_profile(SCC, half, edges, ridge=line, **how)
    assert found.components.meta["along"] == "ridge"
    straight = measure_profile(SCC, half, edges, **how)
    # The same direction: the same speeds.
    pm = (own.speeds["all"][1][0] for own in (found, straight))
    assert_allclose(*pm, rtol=0.02)


@pytest.mark.slow
def test_the_covariance_is_that_of_repeated_jets():
    """Neighbouring halves of jets whose features have speeds of their own."""
    speeds, expected = [], []
    for seed in range(24):
        cube = simulate_jet(n_epochs=15, n_features=8, dispersion=0.2, rng=seed).cube
        flow = flow_of(cube)
        parts = [flow.between(*limits) for limits in ((1.6, 4.0), (4.0, 6.4))]
        fits = [fit_part(part) for part in parts]
        _, speed, covariance = speeds_in_parts(fits, [2.8, 5.2])
        speeds.append(speed)
        expected.append(covariance)
    scatter, expected = np.cov(np.transpose(speeds)), np.median(expected, axis=0)
    ratio = np.sqrt(np.diag(expected) / np.diag(scatter))
    assert np.all((ratio > 0.5) & (ratio < 2))
    # They share features.
    assert expected[0, 1] > 0


R, V = np.linspace(0.5, 10, 12) * u.mas, np.ones(12)


def test_straight_line_is_that_of_numpy():
    rng = np.random.default_rng(1)
    v, e = rng.normal(2, 0.3, 12), rng.uniform(0.1, 0.4, 12)
    fit = fit_profile(R, v * PM, e * PM)
    line, covariance = np.polyfit(R.value, v, 1, w=1 / e, cov="unscaled")
    assert_allclose(fit(R).value, np.polyval(line, R.value))
    assert fit.errors["gradient"].value == pytest.approx(np.sqrt(covariance[0, 0]))
    chi2 = (((v - np.polyval(line, R.value)) / e) ** 2).sum()
    assert (fit.chi2, fit.n_free) == (pytest.approx(chi2), 10)
    assert fit.aicc == pytest.approx(chi2 + 4 + 12 / 9)


@settings(max_examples=25)
@given(v0=st.floats(0.5, 5), k=st.floats(-0.8, 0.8))
@example(v0=2.5, k=1e-6)
def test_power_law_of_a_power_law(v0, k):
    v = v0 * R.value**k
    fit = fit_profile(R, v, 0.05 * v, model="power-law")
    assert_allclose(fit(R).value, v, rtol=1e-6)
    # With equal relative errors it is a straight line of logarithms.
    x = np.log(R.value)
    _, covariance = np.polyfit(x, k * x, 1, w=np.full(12, 20.0), cov="unscaled")
    error = fit.errors["index"].value
    assert error == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-3)


def test_broken_line_finds_the_break():
    v = 2 + 0.3 * np.minimum(R.value - 6, 0) - 0.2 * np.maximum(R.value - 6, 0)
    fit = fit_profile(R, v, np.full(12, 0.02), model="broken")
    found = [p.value for p in fit.parameters.values()]
    assert_allclose(found, [2, 0.3, -0.2, 6], rtol=1e-4)
    assert fit.aicc < fit_profile(R, v, np.full(12, 0.02)).aicc
    assert fit.p_constant < 1e-10
    assert 0 < fit.errors["r_break"].value < 0.5


@pytest.mark.parametrize("scale", [0.2, 3.0])
def test_the_p_of_a_line_is_that_of_its_acceleration(scale):
    """Student's, whether the speeds scatter by more or less than their errors."""
    error = 0.1 * scale * np.ones(12)
    v = np.random.default_rng(5).normal(2 + 0.03 * R.value, 0.1)
    found = slope_of(R.value, v, np.diag(error**2))
    fit = fit_profile(R, v, error)
    slope, slope_err = found[2:4]
    assert fit.p_constant == pytest.approx(2 * stdtr(10, -abs(slope / slope_err)))
    # Two speeds leave nothing that a line could be judged by.
    assert fit_profile(R[:2], v[:2], error[:2]).p_constant == 1


def test_groups_are_measured_by_themselves(half):
    how = {"scale_groups": "1; 2,3", "n_trials": 99, "rng": 1}
    by_scale = measure_profile(SCC, half, BINS[:3], **how)
    table = by_scale.components
    assert set(table["scale_group"]) == {"1", "2, 3"}
    assert "two streams" in replace(by_scale, pair=[(1, 0)]).streams["caution"][0]
    # Features have no scale.
    assert set(table["pm_from"]) == {"spectrum"}
    found = compare_scales(by_scale)
    assert len(found) == 2
    off = found["second_speed"] - found["first_speed"]
    assert u.allclose(found["difference"], off)
    # Both see the same features, so that a difference is known better.
    alone = np.hypot(found["first_speed_err"], found["second_speed_err"])
    assert np.all(found["difference_err"] < 1.5 * alone)
    assert np.all(found["p_value"] > 1e-3)


def test_cells_of_distance_and_offset(result):
    along, across = [1.6, 4.0, 6.4] * u.mas, [-0.5, 0.5, 9] * u.mas
    field = measure_field(result, along=along, across=across, n_trials=19, rng=1)
    table = field.table
    assert table["r_min"].value.tolist() == [1.6, 4.0, 1.6, 4.0]
    assert np.all(table["pm_parallel"][:2] > 3 * table["pm_parallel_err"][:2])
    assert np.all((table["p_fdr"] >= table["p_global"])[np.isfinite(table["p_global"])])
    assert table["p_global"][0] == 0.05
    with pytest.raises(ValueError, match="cells of one size: give even edges across"):
        field.to_fits()
    even = measure_field(result, along=along, across=across[:2], n_trials=9, rng=1)
    hdus = even.to_fits()
    assert [hdu.name for hdu in hdus] == ["SPEED", "ERROR", "P_FDR"]
    assert_allclose(hdus["SPEED"].data[0], even.table["pm_parallel"].value)
    wcs = WCS(hdus["ERROR"].header)
    assert_allclose(wcs.wcs_pix2world([[1, 0]], 0), [[5.2, 0.0]])


@pytest.mark.parametrize("turn", [0.0, 180.0])
def test_cells_of_radial_flows_turn_with_the_jet(turn):
    how = {"n_epochs": 10, "length": 8, "shape": (200, 200), "rng": 1}
    cube = simulate_jet(position_angle=turn * u.deg, **how).cube
    result = StackedCrossCorrelation(position_angle="radial")(cube, n_trials=99, rng=1)
    how = {"along": [1.6, 5] * u.mas, "n_trials": 19, "rng": 1}
    for edges in (np.array([-20, 0, 20]) + turn, [turn - 380, turn - 340]):
        table = measure_field(result, across=edges * u.deg, **how).table
        assert_allclose(table["pm_parallel"].value, [2.36, 1.91][: len(table)], 0.05)
    with pytest.raises(ValueError, match="must be two increasing position angles, in"):
        measure_field(result, across=[-1, 0, 1] * u.mas, **how)
    table = measure_field(result, **how).table
    assert_allclose(table["pm_parallel"].value, [np.nan, 2.28, np.nan], 0.02)


def test_speeds_beside_an_edge_are_those_of_the_whole_image():
    cube = simulate_jet(n_epochs=12, n_features=60, dispersion=0.05, rng=2).cube
    missing = cube.mask | (np.arange(cube.shape[2]) >= 114)
    cut = cube.crop(np.s_[:, :114]), replace(cube, mask=missing)
    whole, *cuts = map(flow_of, (cube, *cut))
    speed = fit_part(whole.between(3.8, 5)).fit.mean[0]
    for cut in cuts:
        assert fit_part(cut.between(3.8, 9)).fit.mean[0] == pytest.approx(speed, 0.03)
        assert fit_part(cut.between(4.2, 9)).fit is None


REFUSED = [
    (lambda *_: bins_of([1.0] * u.mas), "2 distance"),
    (lambda d, _: measure_profile(SCC, d, [80, 90] * u.mas), "nothing is seen in the"),
    (lambda d, _: measure_profile(SCC, d, BINS, scale_groups="1"), "two groups of"),
    (lambda d, _: measure_profile(SCC, d, BINS, scale_groups="1,2; 2"), "share scale"),
    (lambda d, _: flow_of(d.cube.crop(np.s_[:, 90:102])), "wavelets reach beyond"),
    (lambda *_: fit_profile(R, V, V, model="cubic"), "unknown model 'cubic'"),
    (lambda *_: fit_profile(R[:2], V[:2], V[:2], model="broken"), "at 4 distances or"),
    (lambda *_: fit_profile(R, -V, V, model="power-law"), "above 0"),
    (lambda _, r: compare_scales(r, {"a": [1]}), "two groups or more, got 1"),
    (lambda _, r: measure_field(r, across=[2, 1] * u.mas), "must be two increasing"),
    (lambda _, r: measure_field(r, along=[80, 90] * u.mas), "nothing is seen in any"),
]


@pytest.mark.parametrize(("call", "words"), REFUSED)
def test_what_makes_no_sense_is_refused(half, result, call, words):
    with pytest.raises(ValueError, match=words):
        call(half, result)


def test_distances_in_an_expansion_are_from_its_centre():
    frame = ExpansionFrame([3, 4] * u.mas, 10 * u.mas)
    flow = SimpleNamespace(grids=[SimpleNamespace(angle=np.nan)], frame=frame)
    assert distances_along(flow, np.array([[0.0, 0.0], [3.0, 2.0]])).tolist() == [5, 2]
