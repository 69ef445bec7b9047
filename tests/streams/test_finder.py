# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams of simulated jets, and means of features."""

import re
from copy import copy
from dataclasses import replace
from functools import cache

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time

from astro_scc import Beam, EpochCube, StackedCrossCorrelation, kinematics
from astro_scc.epochs import ComponentList, restore
from astro_scc.explain import explain_feature
from astro_scc.flow import compare_scales, measure_acceleration, measure_profile
from astro_scc.measurement import false_discovery_rate
from astro_scc.plan import searched_speeds
from astro_scc.report.answer import headline, scale_lines, trust_lines
from astro_scc.simulation import simulate_jet, simulate_resolved_jet, simulate_two_fluid
from astro_scc.streams.finder import _as_tested, _judged
from astro_scc.streams.members import (
    _beside_standing,
    mean_speed,
    separation,
    standing_streams,
)


def measured(epochs, **settings):
    """Return the result of a cube, or of epochs whose features may be known already."""
    scc = StackedCrossCorrelation(**settings)
    call = scc if isinstance(epochs, EpochCube) else scc.measure
    return call(epochs, n_trials=119, rng=1)


@pytest.fixture(name="two", scope="module")
def fixture_two():
    cube = simulate_two_fluid(rng=3).cube.crop(np.s_[40:88, :])
    return measured(cube, position_angle=270 * u.deg)


def test_both_streams_of_the_paper_are_found(two):
    streams = two.streams[two.streams["kind"] == "moving"]
    assert streams["pm"].value == pytest.approx([6.09, 24.35], rel=0.12)
    off = np.abs(streams["pm"].value - [6.09, 24.35])
    assert np.all(off < 2.5 * streams["pm_err"].value)
    assert np.all(streams["p_distinct"] <= 0.01)
    assert streams["share"].sum() == pytest.approx(1.0)
    assert streams["pm_pa"].value == pytest.approx([270, 270], abs=8)
    assert streams["stream"].tolist() == [1, 2]
    # What astro-scc inspect says before is what is searched.
    limits = [streams.meta[name].value for name in ("slowest", "fastest")]
    assert searched_speeds(two.cube).value == pytest.approx(limits)


def test_scales_of_two_streams_are_compared_stream_by_stream(two):
    whole = compare_scales(two)
    scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    groups = {"scale_groups": "1; 2", "n_trials": 119, "rng": 1}
    bins = compare_scales(measure_profile(scc, two.decomposed, "2 10 18 mas", **groups))
    for found in (whole, bins):
        known = found[np.isfinite(found["p_value"])]
        slow = known["stream"] == 1
        assert 0 < slow.sum() < len(known)
        for k in ("first_speed", "second_speed"):
            assert np.all((known[k].value < 12) == slow)
        assert np.all(known["p_value"] > 1e-3)
    assert whole["first_share"].sum() == pytest.approx(1)
    assert "stream 2: 24" in scale_lines(whole)[1]


@pytest.mark.slow
def test_a_direction_that_is_not_known_is_found(two):
    found = measured(two.decomposed)
    moving = found.streams["kind"] == "moving"
    assert found.streams["pm"][moving].value == pytest.approx([6.09, 24.35], rel=0.12)
    assert found.streams["pm_pa"][moving].value == pytest.approx([270, 270], abs=10)


@pytest.mark.parametrize("seed", [5, pytest.param(6, marks=pytest.mark.slow)])
def test_a_static_jet_does_not_move(seed):
    cube = simulate_jet(n_features=0, standing=8, memory=5.0, rng=seed).cube
    found = measured(cube, position_angle=270 * u.deg)
    kinds = found.streams["kind"].tolist()
    assert "moving" not in kinds
    assert kinds[0] == "not significant"
    assert "were searched" in found.streams["caution"][0]
    assert not len(found.sensitivity)
    features, search = found.tracked_features, found.search
    alone = replace(search.streams[0], kind="moving", members=np.zeros(0, int))
    doubted, _ = _beside_standing([alone, search.streams[-1]], features)
    assert doubted.kind == "not confirmed"
    assert "stand still" in doubted.reason
    # What is too slow in each feature is seen in their mean.
    errors = [m.speed_err for m in features.motions]
    moved = [
        replace(m, velocity=np.array([2.4 * m.speed_err, 0.0]))
        for m in features.motions
    ]
    drift = copy(features)
    vars(drift)["motions"] = moved
    for known, kind in ((False, "stationary"), (True, "not confirmed")):
        shift = np.eye(2) * (0 if known else max(errors) ** 2)
        (row,) = standing_streams(drift, search.flow, [], None, shift)
        assert row.kind == kind
        assert ("move together by" in row.reason) == known
    only = np.arange(len(errors)) == 0
    (row,) = standing_streams(features, search.flow, [], only, np.zeros((2, 2)))
    assert np.sqrt(np.diag(row.covariance)) == pytest.approx(errors[0], rel=0.01)
    found = replace(found, search=replace(search, streams=(search.streams[0], row)))
    assert found.streams["pm_limit"][1] > found.streams["pm"][1]
    assert np.any(found.features["stream"] == 2)
    assert headline(found.streams).startswith("Nothing moves significantly: p_global")
    assert np.isnan(measure_acceleration(found, 1).p_value)
    assert false_discovery_rate([found.streams])[0]["p_fdr"][0] > 0.01


def test_one_stream_is_that_of_its_features(known_jet, monkeypatch):
    found = measured(known_jet.cube, position_angle=270 * u.deg)
    row = found.streams[0]
    assert (row["kind"], row["pm_from"]) == ("moving", "features")
    assert row["pm_min"] <= row["pm"] <= row["pm_max"]
    assert np.sum(found.streams["kind"] == "moving") == 1
    fitted = 90 * u.deg, 1 * u.deg
    monkeypatch.setattr(kinematics, "fit_position_angle", lambda _: fitted)
    for angle, which in ((-270 * u.deg, "given"), ("fit", "fitted")):
        row = measured(found.decomposed, position_angle=angle).streams[0]
        words = f"on the other side of the core than the {which} position angle"
        assert words in row["caution"]
        assert row["pm_pa"].value == pytest.approx(270, abs=10)


def test_one_feature_of_seven_is_no_second_stream():
    jet = simulate_jet(distribution="lognormal", dispersion=0.8, rng=6036)
    found = measured(jet.cube, position_angle=270 * u.deg).streams
    assert np.sum(found["kind"] == "moving") == 1


YEARS = np.cumsum([0.0, 0.37, 0.38, 0.28, 0.2, 0.13, 0.24, 0.24, 0.12, 0.13])


def knots(angles, speeds=(1.0,), n=8, bend=0.0, years=YEARS, behind=0.0):
    """Images of knots in turn; a core behind a bright one at the reference position."""
    epoch, knot = np.indices((len(years), n)).reshape(2, -1)
    turn, speed = np.radians(np.resize(angles, n))[knot], np.resize(speeds, n)[knot]
    r = 8.8 / n * knot - 3.1 + speed * years[epoch]
    r[knot == 0] = 0
    use = (knot < 1 + (behind > 0)) | ((r > 0.4) & (r < 7))
    # The chord of an arc that turns by so many radians in a milliarcsecond.
    half = bend * r / 2
    r, turn = r * np.sinc(half / np.pi), turn + half
    flux = np.where(knot, 0.4 * np.exp(-r / 6), 1.0)
    if behind:
        flux[knot == 0], flux[knot == 1], r[knot == 1] = 0.4, 1.5, behind
    east, north = (
        np.array([r * np.sin(turn), r * np.cos(turn) - behind])[:, use] * u.mas
    )
    flux = flux[use] * u.Jy
    dates, beam = Time(2004 + years, format="jyear"), Beam(1 * u.mas, 0.5 * u.mas)
    table = ComponentList(dates, epoch[use], flux=flux, east=east, north=north)
    noise = 0.3 * u.mJy / u.beam
    return restore(table, beam=beam, pixel_scale=0.1 * u.mas, noise=noise, rng=1)


@cache
def behind_another(distance):
    """Decomposed images of knots in a row, the core behind a bright one."""
    return StackedCrossCorrelation().decompose(knots((0,), n=12, behind=distance))


@pytest.mark.parametrize("angles", [(-12, 12), (20, 20)])
def test_long_beams_do_not_mistake_motion_off_the_axis_for_speed(angles):
    found = measured(knots(angles), position_angle=0 * u.deg)
    assert found.streams["pm_spectrum"][0].value == pytest.approx(1.0, abs=0.08)
    compared = compare_scales(found)[0]
    both = compared["first_speed"].value, compared["second_speed"].value
    assert both == pytest.approx([1.0, 1.0], abs=0.06)
    assert found.flow.grids[0].lines is not None


def test_a_jet_that_bends_does_not_accelerate():
    found = measured(knots((-15,), bend=0.1), position_angle=5 * u.deg)
    assert found.flow.grids[0].bends
    assert found.streams["pm"][0].value == pytest.approx(1.0, abs=0.02)
    assert found.streams["pm_spectrum"][0].value == pytest.approx(1.0, abs=0.05)
    parts = measure_acceleration(found)
    assert abs(parts.gradient) < 2.5 * parts.gradient_err


def test_the_counter_jet_moves_to_its_own_side():
    found = measured(knots((40, 220), (1.8, 0.7), 16), position_angle="40 deg").streams
    row = found[np.abs(found["pm"].value - 0.7).argmin()]
    assert row["pm_pa"].value == pytest.approx(220, abs=2)
    assert row["caution"].startswith("it is of the counter-jet")
    assert "towards the core" not in row["caution"]
    assert found["n_features"].min() > 0


def test_a_stream_of_both_sides_has_the_direction_of_one():
    cube = knots((0, 180), n=14)
    row = measured(cube, position_angle=0 * u.deg).streams[0]
    assert "it moves on both sides of the core" in row["caution"]
    north = cube.offsets()[1] > 0 * u.mas
    row = StackedCrossCorrelation()(cube, region=north, n_trials=119, rng=1).streams[0]
    assert row["pm_pa"].value == pytest.approx(0, abs=5)
    assert row["caution"] == "it is of the counter-jet"


@pytest.mark.parametrize(
    ("behind", "way"), [(0, "away from the core"), (4, "towards PA 180 deg")]
)
def test_what_outward_leaves_out_is_said(behind, way):
    cube = knots((0,))
    # In reverse, towards the core.
    epochs = behind_another(4) if behind else replace(cube, data=cube.data[::-1])
    row = measured(epochs, position_angle="fit", outward=True).streams[0]
    assert row["kind"] == "not significant"
    assert f"'outward' searches only motion {way}" in row["caution"]


@pytest.mark.parametrize(
    ("behind", "angle"), [(2.2, "180 deg"), (4, None), (4, "radial")]
)
def test_a_bright_knot_at_the_reference_position_is_no_core(behind, angle):
    row = measured(behind_another(behind), position_angle=angle).streams[0]
    assert row["kind"] == "moving"
    assert row["pm"].value == pytest.approx(1.0, abs=0.02)
    words = "emission lies upstream of the reference position, to .* at PA 180 deg, and"
    assert re.match(words, row["caution"])
    assert "counter" not in row["caution"]
    assert "towards" not in row["caution"]


@pytest.mark.parametrize(("angles", "words"), [
    ((-35, 35), "directions of secure features scatter"),
    ((75, 85), "features move at 80 deg to its direction"),
])  # fmt: skip
def test_one_direction_does_not_speak_for_others(angles, words):
    found = measured(knots(angles), position_angle=0 * u.deg)
    assert words in found.streams["caution"][0]


@pytest.mark.parametrize(("centre", "turn", "angle", "said"), [
    ((0, 0), 0, "any", "for the emission: .* deg, try --position-angle radial"),
    ((-3, 2), 0, "any", r"they move away from \((-3|-2.9.?), (2|2.0.?|1.9.?)\) mas"),
    ((0, 0), np.pi / 2, "any", "for the emission: .* deg, give a region for each"),
    ((0, 0), np.pi / 2, "radial", "features move at 7. deg to its direction, along wh"),
])  # fmt: skip
def test_motion_to_all_sides_is_said(centre, turn, angle, said):
    """Twelve knots that move away from a place, or about it."""
    n, years = 12, np.arange(8) * 0.4
    a = 2 * np.pi * np.arange(n) / n
    way, side = (np.array([np.sin(b), np.cos(b)]) for b in (a, a + turn))
    place = np.array(centre)[:, None, None] + 5 * way[:, None]
    east, north = place + years[:, None] * side[:, None]
    table = ComponentList(
        Time(2004 + years, format="jyear"), np.repeat(np.arange(8), n),
        flux=np.tile(0.3 + 0.02 * np.arange(n), 8) * u.Jy, east=east.ravel() * u.mas,
        north=north.ravel() * u.mas,
    )  # fmt: skip
    noise = {"noise": 0.3 * u.mJy / u.beam, "rng": 1}
    cube = restore(
        table, beam=Beam(0.8 * u.mas, 0.8 * u.mas), pixel_scale=0.25 * u.mas, **noise
    )
    assert re.search(said, measured(cube, position_angle=angle).streams["caution"][0])


def test_an_image_that_is_there_twice_is_refused():
    with pytest.raises(ValueError, match="are the same image of one date: leave one"):
        StackedCrossCorrelation()(knots((0,))[[0, 0, 1, 2, 3, 4]])


def test_speeds_of_a_jet_and_its_counter_jet_are_told_apart():
    found = measured(knots((0, 180), (1.8, 0.7), 5), position_angle=0 * u.deg).streams
    row = found[found["kind"] == "moving"][0]
    words = r"the mean of the jet, 1\.\d+ mas/yr, and the counter-jet, 0\.7\d* mas/yr: "
    assert re.search(words, row["caution"])


def test_knots_that_leave_at_equal_intervals_have_their_speed():
    """Each looks like the next after 0.88 years."""
    years = np.append(YEARS, YEARS[-1] + np.cumsum([0.44, 0.32, 0.35, 0.25, 0.45]))
    cube = knots((0,), n=10, years=years)
    row = measured(cube, position_angle=0 * u.deg).streams[0]
    assert row["pm_spectrum"].value == pytest.approx(1.0, abs=0.1)
    assert row["share"] == 1


def test_speed_towards_the_core_has_its_sign(two):
    found = measured(two.decomposed, position_angle=90 * u.deg)
    row = found.streams[found.streams["kind"] == "moving"][0]
    assert row["pm_parallel"] < 0
    assert "towards the core" in row["caution"]
    assert row["pm_pa"].value == pytest.approx(270, abs=10)


@pytest.mark.slow
@pytest.mark.parametrize(("days", "expected"), [(8, [1.14, 8.5]), (5, [8.5])])
def test_layers_that_overlap_have_no_speed_between_them(days, expected):
    interval = days * u.day
    jet = simulate_resolved_jet(n_epochs=3 * days, interval=interval, rng=5001)
    found = measured(jet.cube, position_angle=288 * u.deg)
    speeds = found.streams["pm"][found.streams["kind"] == "moving"]
    assert speeds.to_value("mas/yr") == pytest.approx(expected, rel=0.15)


def test_few_epochs_cannot_show_motion(jet_cube):
    with pytest.warns(UserWarning, match="6 epochs or more"):
        found = measured(jet_cube[:5], position_angle=270 * u.deg)
    assert found.streams["kind"][0] == "not significant"
    with pytest.raises(ValueError, match="at least 3 epochs"):
        measured(jet_cube[:2], position_angle=270 * u.deg)


@pytest.mark.parametrize(("alone", "sure", "kind"), [
    (True, 0.0, "not confirmed"), (True, 1.0, "moving"), (False, 0.0, "moving"),
])  # fmt: skip
def test_a_speed_of_no_feature_needs_three_errors_or_a_smaller_p(
    two, alone, sure, kind
):
    slow = two.search.streams[0]
    error = np.hypot(*slow.velocity) / 2.5
    members = np.zeros(0, int) if alone else slow.members
    slow = replace(slow, covariance=np.eye(2) * error**2, members=members)
    found = _judged(slow, two.search, diffusing=False, sure=sure)
    assert found.kind == kind
    assert ("at most 0, which so few epochs" in found.reason) == (kind != "moving")


@pytest.mark.parametrize(("factor", "than"), [(3.0, "faster"), (0.01, "slower")])
def test_a_speed_that_was_not_searched_is_not_confirmed(two, factor, than):
    search = two.search
    far = replace(search.streams[1], velocity=factor * search.streams[1].velocity)
    far = _judged(replace(far, covariance=np.eye(2) * 1e-4), search, diffusing=False)
    assert far.kind == "not confirmed"
    assert far.reason == f"it is {than} than what was searched"
    # Where the test finds nothing, the row has a speed that it searched.
    other = np.hypot(*far.velocity)
    one = _as_tested(replace(far, spectrum=(other, 1.0)), search)
    assert search.tested(np.hypot(*one.velocity))
    one = replace(one, kind="not significant")
    row = replace(two, search=replace(search, streams=(one,))).streams[0]
    said = f"the spectrum has {other:.3g} mas/yr, which was not searched"
    assert said in row["caution"]
    assert ("give a larger max_speed" in row["caution"].split("; ")[2]) == (factor > 1)


def test_features_that_the_flow_passes_between_images_are_not_secure():
    jet = simulate_jet(n_epochs=48, rng=2)
    result = measured(jet.cube[::4], position_angle=270 * u.deg)
    row, features = result.streams[0], result.tracked_features
    ((reason, numbers),) = features.doubts.items()
    passed = replace(features, doubts={}).secure
    assert features.number[passed].tolist() == numbers != []
    assert np.all(np.hypot(*features.velocities[passed].T) < 1)
    assert row["pm"].value == pytest.approx(2.37, abs=2 * row["pm_err"].value)
    assert reason in trust_lines(result.features)[-1]
    assert reason in explain_feature(features, feature=numbers[0])[-1]


def test_means_of_features():
    """Many show their scatter, one scatters by .3, and long ones weigh more."""
    speed = np.random.default_rng(1).normal(1.0, 0.1, 400)
    mean, error, dispersion, _ = mean_speed(speed, np.full(400, 0.02), np.ones(400))
    assert mean == pytest.approx(1.0, abs=0.02)
    assert error == pytest.approx(0.1 / 20, rel=0.15)
    assert dispersion == pytest.approx(0.1, rel=0.15)
    _, error, *_ = mean_speed([2.0], [0.1], [7])
    assert error == pytest.approx(np.hypot(0.1, 0.6))
    assert mean_speed([1.0, 2.0], [0.1, 0.1], [3, 1])[0] == pytest.approx(1.25)


def test_separation_of_known_distributions():
    rng = np.random.default_rng(2)
    for draw, wanted in ((rng.normal, 2 / np.pi), (rng.uniform, 0.75)):
        found = separation(np.exp(draw(size=4000)))
        assert found == pytest.approx(wanted, abs=0.03)
    assert separation([1.0, 1.01, 3.0, 3.02]) > 0.99
    assert separation([1.0, 1.0]) == 0.0
