# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Profiles of simulated jets, their fits, accelerations, and groups of patterns."""

from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import kstest, ttest_ind

from astro_scc import StackedCrossCorrelation
from astro_scc.flow import (
    compare_speeds,
    feature_profile,
    fit_profile,
    measure_acceleration,
    measure_profile,
    scale_groups,
)
from astro_scc.flow.profile import bins_of
from astro_scc.flow.speeds import BLENDS, _difference, _groups_of, _mean, fit_gradient
from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import RidgeLine, SkyFrame
from astro_scc.matching.matched import select_ssps, ssp_distances
from astro_scc.measurement.axes import projection_of
from astro_scc.measurement.tables import component_table
from astro_scc.simulation import JetSimulation, Stream, simulate_jet
from astro_scc.streams import SearchSettings
from astro_scc.streams.chains import Feature
from astro_scc.streams.dispersion import feature_speeds, random_effects, scattered_fit

PM = u.mas / u.yr


@pytest.fixture(scope="module")
def scc():
    return StackedCrossCorrelation(
        scales=[1, 2, 3], max_speed=30 * PM, position_angle=270 * u.deg
    )


def test_a_bin_is_a_stack_of_its_ssps(scc, matched):
    profile = measure_profile(scc, matched, [0, 9, 90, 99] * u.mas, n_trials=20, rng=1)
    inside = ssp_distances(matched).value
    for (low, high), result in zip(profile.bins.value, profile.results, strict=True):
        own = (inside >= low) & (inside < high)
        assert own.any() == (result is not None)
        if result is not None:
            np.testing.assert_array_equal(result.decomposed.select, own)
            # Nothing is correlated again.
            assert result.decomposed.matches is matched.matches
    table = profile.components
    assert table.colnames[:3] == ["r_min", "r_max", "r_mid"]
    assert set(component_table([]).colnames) < set(table.colnames)
    assert np.all(table["p_fdr"] >= table["p_global"])
    # An empty bin was searched too, and what stands still is not tested.
    moves = table["kind"] != "stationary"
    tested = [np.sum(moves & (table["r_min"] == low)) for low in profile.bins[:, 0]]
    assert table.meta["false_discovery"]["n_tests"] == np.maximum(tested, 1).sum()
    assert (table.meta["seed"], profile.results[2]) == (1, None)
    assert "3 bins from 0" in repr(profile)


R, V = np.linspace(0.5, 10, 12) * u.mas, np.ones(12)
REFUSED = [
    (lambda *_: bins_of([1.0] * u.mas), "2 distance"),
    (lambda *_: bins_of([2.0, 1.0] * u.mas), "bins = .* must be increasing distances"),
    (lambda *_: bins_of([1.0, 2.0] * u.mas, window=0 * u.mas), "window = 0.0 mas must"),
    (lambda *of: measure_profile(*of, [80, 90] * u.mas), "no SSP lies in the bins"),
    (lambda _, m: select_ssps(m, r_min=3 * u.mas, r_max=2 * u.mas), "must be below"),
    (lambda _, m: select_ssps(m, scales=[1, 4]), "scale 4 was not decomposed"),
    (lambda *_: fit_profile(R, V, V, model="cubic"), "unknown model 'cubic'"),
    (lambda *_: fit_profile(R[:2], V[:2], V[:2], model="broken"), "at 4 distances or"),
    (lambda *_: fit_profile(R, -V, V, model="power-law"), "above 0"),
    (lambda _, m: scale_groups(m, {"a": [1]}), "two groups or more, got 1"),
]


@pytest.mark.parametrize(("call", "words"), REFUSED)
def test_what_makes_no_sense_is_refused(scc, matched, call, words):
    with pytest.raises(ValueError, match=words):
        call(scc, matched)


def test_along_a_ridge_line_and_other_selections(scc, matched):
    # A line that begins at 5 mas: distances along it are smaller by as much.
    line = RidgeLine([-5, -25] * u.mas, [0, 0] * u.mas)
    s = ssp_distances(matched, ridge=line).value
    r = ssp_distances(matched, origin=[-5, 0] * u.mas).value
    far = (r > 5) & (s > 0)
    np.testing.assert_allclose(s[far], r[far], atol=1.0)
    bins = [3, 15] * u.mas
    found = measure_profile(scc, matched, bins, ridge=line, n_trials=20, rng=1)
    assert found.components.meta["along"] == "ridge"
    inner = select_ssps(matched, r_max=8 * u.mas, scales=[2])
    assert set(matched.ssps.scale[inner.select]) == {2.0}
    region = np.zeros(matched.cube.shape[1:], bool)
    region[:, :100] = True
    left = select_ssps(matched, region=region)
    assert matched.ssps.x_centroid[left.select].max() < 100
    by_angle = select_ssps(matched, scales=[0.4] * u.mas).select
    assert np.array_equal(by_angle, select_ssps(matched, scales=[2]).select)
    windows = bins_of([2.0, 9.0] * u.mas, window=5 * u.mas)
    assert windows.value.tolist() == [[0, 4.5], [6.5, 11.5]]


@pytest.fixture(scope="module")
def accelerated():
    """Features that are three times as fast at the end of the jet, and their truth."""
    jet = simulate_jet(n_epochs=12, acceleration=3.0, dispersion=0.05, rng=1)
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
    assert str(found).startswith("acceleration: 0.")
    assert found.centre > 2 * u.mas
    (row,) = np.flatnonzero(result.components["kind"] == "stationary")
    still = measure_acceleration(result, row)
    assert np.isnan(still.p_value)
    assert "unknown, as four features are needed" in str(still)
    with pytest.raises(ValueError, match=f"row must be from 0 to {row}, got 9"):
        measure_acceleration(result, 9)


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


# -- fits of profiles, against numpy and against what was put in ------------------


def test_straight_line_is_that_of_numpy():
    rng = np.random.default_rng(1)
    v, e = rng.normal(2, 0.3, 12), rng.uniform(0.1, 0.4, 12)
    fit = fit_profile(R, v * PM, e * PM)
    line, covariance = np.polyfit(R.value, v, 1, w=1 / e, cov="unscaled")
    np.testing.assert_allclose(fit(R).value, np.polyval(line, R.value))
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
    np.testing.assert_allclose(fit(R).value, v, rtol=1e-6)
    # With equal relative errors it is a straight line of logarithms.
    x = np.log(R.value)
    _, covariance = np.polyfit(x, k * x, 1, w=np.full(12, 20.0), cov="unscaled")
    error = fit.errors["index"].value
    assert error == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-3)


def test_broken_line_finds_the_break():
    v = 2 + 0.3 * np.minimum(R.value - 6, 0) - 0.2 * np.maximum(R.value - 6, 0)
    fit = fit_profile(R, v, np.full(12, 0.02), model="broken")
    found = [p.value for p in fit.parameters.values()]
    np.testing.assert_allclose(found, [2, 0.3, -0.2, 6], rtol=1e-4)
    assert fit.aicc < fit_profile(R, v, np.full(12, 0.02)).aicc
    assert fit.p_constant < 1e-10
    assert 0 < fit.errors["r_break"].value < 0.5


def test_a_fit_does_not_depend_on_the_units():
    # A zigzag, which no broken line is.
    r = np.linspace(1, 10, 24)
    v, errors = 1 + 2 * np.abs((r % 5) - 2.5), np.full(24, 0.02)
    fits = [
        fit_profile((r * u.mas).to(unit), v, errors, model="broken")
        for unit in (u.mas, u.arcsec, u.deg)
    ]
    chi2 = [fit.chi2 for fit in fits]
    np.testing.assert_allclose(chi2, chi2[0], rtol=1e-6)


def test_constant_has_uniform_probabilities():
    speeds = np.random.default_rng(4).normal(2, 0.1, (300, 12))
    p = np.array([fit_profile(R, v, np.full(12, 0.1)).p_constant for v in speeds])
    assert np.mean(p < 0.05) < 0.09
    assert fit_profile(R, V, V, model="constant").p_constant == 1


# -- features that speed up, that slow down, and that do neither ------------------


YEARS, BEAM = np.arange(8.0), 1 * u.mas


def feature(start, gradient, *, speed=0.5, noise=0.0, years=YEARS, rng=None, way=1):
    """``dx/dt = speed + gradient (x - 6)``, from a place where it begins."""
    if gradient:
        ratio = speed / gradient
        along = (start - 6 + ratio) * np.exp(gradient * years) - ratio + 6
    else:
        along = start + speed * years
    place = np.stack([way * along, np.zeros(len(years))], axis=1)
    if noise:
        place += noise * rng.normal(size=place.shape)
    settings = SearchSettings(position_error=max(noise, 0.01))
    return Feature.through(*[np.arange(len(years))] * 2, years, place, settings)


def flow(gradient, **options):
    return [feature(start, gradient, **options) for start in (2.5, 4.0, 5.5, 7.0, 8.5)]


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("gradient", [0.06, -0.06])
def test_the_gradient_of_a_flow(gradient, way):
    found = fit_gradient(flow(gradient, way=way), BEAM)
    assert found.p_value < 0.01
    # Parabolas and mean speeds of exponentials: to a tenth.
    assert found.gradient.value == pytest.approx(gradient, rel=0.1)
    assert found.speed > 0
    assert found.centre > 0
    assert found.n_features == 5
    # Blends leave so much.
    assert (found.gradient_err / found.speed).value >= BLENDS * (1 - 1e-9)


@pytest.mark.slow
def test_p_values_are_at_most_even():
    """Features of 15% dispersion without acceleration."""
    rng, p = np.random.default_rng(3), []
    for _ in range(200):
        speeds, starts = rng.normal(0.5, 0.08, 6), rng.uniform(2.5, 9, 6)
        how, starts = {"noise": 0.05, "rng": rng}, zip(starts, speeds, strict=True)
        features = [feature(x, 0.0, speed=v, **how) for x, v in starts]
        p.append(fit_gradient(features, BEAM).p_value)
    # Less than even only by what is left to blends.
    assert kstest(p, "uniform", alternative="greater").pvalue > 1e-3


@pytest.mark.parametrize(
    ("features", "known"),
    [
        ([], False),
        (flow(0.05)[:1], False),
        # The bends of two, over eight epochs.
        (flow(0.05)[:2], True),
        # Too short to be bent, and three speeds only.
        (flow(0.05, years=YEARS[:4])[:3], False),
        (flow(0.05, years=YEARS[:4])[:4], True),
    ],
)
def test_what_few_features_tell(features, known):
    # Those within two beams are the core's: the mean place is 1.875.
    found = fit_gradient([feature(1.7, 0.0, speed=0.05), *features], BEAM)
    assert np.isfinite(found.p_value) == known
    assert found.n_features == len(features)


def test_the_acceleration_of_a_feature():
    place = np.stack([0.5 * YEARS + 0.03 * YEARS**2, 0 * YEARS], axis=1)
    found = Feature.through(*[np.arange(8)] * 2, YEARS, place)
    assert found.acceleration == pytest.approx(0.06)
    # As polyfit says of residuals of 0.06, of which the prior is three of eight.
    _, covariance = np.polyfit(YEARS, place[:, 0], 2, cov="unscaled")
    expected = 2 * np.sqrt(covariance[0, 0]) * 0.06 * np.sqrt(3 / 8)
    assert found.acceleration_error == pytest.approx(expected)
    short = Feature.through(*[np.arange(4)] * 2, YEARS[:4], place[:4])
    assert np.isnan(short.acceleration)


def test_a_line_through_values_that_scatter():
    """The scatter makes the sum of squares what is expected of it."""
    rng = np.random.default_rng(4)
    x, error = np.arange(9.0), np.full(9, 0.05)
    y = 2 + 0.3 * x + 0.4 * rng.normal(size=9)
    design = np.stack([np.ones(9), x], axis=1)
    found, covariance, tau, weight = scattered_fit(design, y, error)
    # Equal errors: least squares.
    slope, offset = np.polyfit(x, y, 1)
    assert_allclose(found, [offset, slope])
    _, expected = np.polyfit(x, y, 1, cov=True)
    assert_allclose(covariance[1, 1], expected[0, 0])
    left = y - design @ found
    assert (left**2 / (tau**2 + error**2)).sum() == pytest.approx(7)
    assert_allclose(weight, 1 / (tau**2 + error**2))


# -- groups of SSPs by scale and by side of a jet ---------------------------------


PER_PIXEL = 0.1 / 30 * 365.25
SCC = StackedCrossCorrelation(
    scales=[1, 2], max_speed=20 * PM, position_angle=270 * u.deg
)


@pytest.fixture(scope="module")
def sheared():
    """A jet that is faster on its northern side, by 4 pixels an epoch."""
    flow = Stream(
        "flow", dx=lambda x, y: np.where(y > 64, 8.0, 4.0), half_width=25.0, density=1.5
    )
    jet = JetSimulation([flow], n_epochs=7, shape=(128, 150), extent=(20.0, 130.0))
    return SCC.match(jet.run(rng=2).cube)


@pytest.mark.slow
def test_sides_have_their_speeds(sheared):
    result = SCC.stack(sheared, n_trials=20, rng=1)
    _, north = ssp_offsets(sheared.ssps, sheared.cube, centroid=True)
    sides = {"south": north < -0.5, "north": north > 0.5}
    (row,) = compare_speeds(result, sides)
    assert row["p_value"] < 0.05
    error = row["difference_err"].value
    assert abs(row["difference"].value - 4 * PER_PIXEL) < 3 * error
    assert abs(row["first_speed"].value - 4 * PER_PIXEL) < 1
    assert row["first_n_ssp"] == sides["south"].sum()
    number = sum(len(s.features) for s in result.search.streams if s.kind == "moving")
    assert row["first_n_features"] + row["second_n_features"] == number
    every = sides["north"] | sides["south"]
    (row,) = compare_speeds(result, {"all": every, "none": ~every & False})
    assert row["second_n_features"] == 0
    assert np.isnan([row["second_speed"].value, row["p_value"]]).all()
    with pytest.raises(ValueError, match="'a' and 'b' share SSPs"):
        compare_speeds(result, {"a": sheared.select, "b": sheared.select})
    with pytest.raises(ValueError, match="direction of the flow is needed"):
        compare_speeds(replace(result, frame=SkyFrame()), sides)


def test_the_difference_is_that_of_welch():
    """Errors that are small beside the scatter: the test of samples."""
    rng = np.random.default_rng(2)
    samples = rng.normal(1.0, 0.1, 6), rng.normal(1.3, 0.2, 9)
    known = {"error": 1e-9, "pulled": False}
    features = [[SimpleNamespace(speed=v, **known) for v in own] for own in samples]
    # Errors of features hold two per cent of their speeds.
    found = _difference(*(_mean(own, 1) for own in features))
    expected = ttest_ind(*samples, equal_var=False)
    assert found[0] == pytest.approx(samples[1].mean() - samples[0].mean(), rel=0.02)
    assert found[2] == pytest.approx(expected.pvalue, rel=0.3)


def test_features_are_divided_where_their_shares_leave_a_gap():
    """Three large features among eight small ones, and one on the fine scale only."""
    ratio = np.array([0.3, 0.25, 0.2, 0.9, 1.0, 0.95, 1.05, 1.1, 0.92, 1.0, 0.98])
    peak = np.column_stack([ratio, np.ones(11)]).ravel()
    place = np.repeat(5.0 * np.arange(12), 2)[:23]
    position = np.column_stack([place, 0 * place])
    d = SimpleNamespace(epoch=np.zeros(23, dtype=int), position=position)
    features = [SimpleNamespace(ssp=[2 * k]) for k in range(12)]
    fine = np.arange(23) % 2 == 0
    ssps = SimpleNamespace(peak=np.append(peak, 2.0))
    belongs = _groups_of(features, d, ssps, [fine, ~fine])
    assert belongs.tolist() == [1, 1, 1, *[0] * 9]
