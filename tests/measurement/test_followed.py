# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Secure features as those of streams, and parts that are searched again."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astro_scc.measurement.search import (
    FollowedFeatures,
    largest_difference,
    with_choices,
)
from astro_scc.streams.dispersion import StreamVelocity

from astro_scc import StackedCrossCorrelation
from astro_scc.features.diffusion import measure_diffusion, random_walk
from astro_scc.matching import select_ssps
from astro_scc.measurement.axes import AxisProjection
from astro_scc.simulation import JetSimulation, Stream, simulate_jet

SCC = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)


@pytest.fixture(scope="module")
def matched():
    return SCC.match(simulate_jet(n_epochs=12, dispersion=0.05, rng=1).cube)


def followed(matched, **how):
    samples, frame = SCC.displacements(matched)
    if "epochs" in how:
        samples = samples.of_epochs(how["epochs"])
    project = AxisProjection(samples, matched.cube, frame)
    return FollowedFeatures(matched, project, 1.5, **how), project


def test_they_are_the_secure_features_in_beams(matched):
    found, project = followed(matched)
    own, taken = found(0.0)
    secure = matched.features.table[matched.features.secure]
    assert len(own) == len(secure) > 3
    beam = project.beam(0.0)[0]
    speeds = sorted(f.speed * beam for f in own)
    assert speeds == pytest.approx(sorted(-secure["pm_ra_cosdec"].value), rel=1e-3)
    assert all(f.followed and f.motion > 0 for f in own)
    assert taken[np.concatenate([f.ssp for f in own])].all()
    # Turned by half a turn they move against the axis.
    back, _ = found(np.pi)
    assert [f.speed for f in back] == pytest.approx([-f.speed for f in own])


def test_pairs_of_detections_are_samples_of_the_velocities(matched):
    found, project = followed(matched)
    d, beam = matched.features.detections, project.beam(0.0)
    # The axis points west.
    along, core = -d.place[:, 0] / beam[0], d.core(0.5)
    pairs = found.pairs(0.0)
    apart = np.hypot(*np.moveaxis(d.place[:, None] - d.place, -1, 0))
    near = (apart <= np.hypot(1.5, 0.35) * d.major) & ~core & ~core[:, None]
    wanted = np.argwhere(near & (d.epoch[:, None] < d.epoch)).tolist()
    found_pairs = np.stack([pairs.ssp, pairs.target_ssp], axis=1).tolist()
    assert sorted(found_pairs) == wanted
    moved = along[pairs.target_ssp] - along[pairs.ssp]
    np.testing.assert_allclose(pairs.d1, moved, atol=1e-9)
    np.testing.assert_array_equal(pairs.target, d.epoch[pairs.target_ssp])
    ratio = np.log(d.flux[pairs.ssp] / d.flux[pairs.target_ssp])
    np.testing.assert_allclose(pairs.weight, np.exp(-np.abs(ratio) / 0.7))
    # Those of a feature go with it, and those of its SSPs.
    (feature, *_), _ = found(0.0)
    rest = found.pairs(0.0, [feature])
    assert len(rest) < len(pairs)
    assert not np.isin(feature.detection, [rest.ssp, rest.target_ssp]).any()
    fine, _ = followed(select_ssps(matched, scales=[1]))
    assert len(fine.pairs(0.0)) == 0


def test_intervals_of_their_positions_give_their_speeds(matched):
    found, _ = followed(matched)
    short, _ = followed(matched, intervals=(0.0, 0.5))
    long, _ = followed(matched, intervals=(0.5, np.inf))
    whole, *parts = (one(0.0)[0] for one in (found, short, long))
    assert len(parts[0]) == len(parts[1]) == len(whole)
    for one, two, three in zip(whole, *parts, strict=True):
        assert one.speed != two.speed != three.speed != one.speed
        near = pytest.approx(one.speed, abs=4 * np.hypot(two.error, three.error))
        assert two.speed == near
        assert three.speed == near
    none, _ = followed(matched, intervals=(1e3, np.inf))
    assert none(0.0)[0] == []


def test_features_count_that_no_ssp_shows(matched):
    """Gaussian models see fainter emission than wavelets do."""
    found, project = followed(matched)
    (feature, *_), emission = found(0.0)
    samples = project.displacements
    position = samples.position.copy()
    position[emission] = 1e3
    project = AxisProjection(
        replace(samples, position=position), matched.cube, project.frame
    )
    (same, *_), taken = FollowedFeatures(matched, project, 1.5)(0.0)
    assert same.speed == pytest.approx(feature.speed)
    np.testing.assert_array_equal(same.epoch, feature.epoch)
    assert len(same.ssp) == 0
    assert not taken.any()


def test_parts_of_the_epochs_and_of_the_scales(matched):
    half, _ = followed(matched, epochs=slice(6, None))
    own, _ = half(0.0)
    whole, _ = followed(matched)
    assert 0 < len(own) <= len(whole(0.0)[0])
    # Numbers of SSPs are those of the part.
    n = np.sum(matched.ssps.epoch >= 6)
    assert max(f.ssp.max() for f in own) < n
    fine, _ = followed(select_ssps(matched, scales=[1]))
    assert fine(0.0)[0] == []


@pytest.fixture(scope="module")
def walks():
    """0.2 beams a step of thirty days, of 80 features in 14 epochs."""
    stream = Stream("walk", half_width=24.0, jitter=2.0, density=0.8)
    return SCC.match(JetSimulation(streams=[stream], n_epochs=14).run(rng=1).cube)


def variance_of_steps(cube, beams, years):
    beam = np.sqrt(cube.beams[0].major * cube.beams[0].minor).to_value(u.mas)
    return 1.2 * (beams * beam) ** 2 / years


@pytest.mark.slow
def test_the_random_walk_is_that_which_was_simulated_and_all_features_count(
    matched, walks
):
    step = variance_of_steps(walks.cube, 0.2, 30 / 365.25)
    # Tracks that follow are those that wander less, and their speeds those of all.
    assert 0.2 < random_walk(walks.features) / step < 1.2
    found = measure_diffusion(walks.features)
    assert found.is_walk
    assert found.variance / step == pytest.approx(1, rel=0.4)
    gap = np.median(np.diff(matched.cube.years.to_value(u.yr)))
    assert random_walk(matched.features) < variance_of_steps(matched.cube, 0.1, gap)
    assert not measure_diffusion(matched.features).is_walk
    # A few show no diffusion.
    few = replace(walks.features, tracks=walks.features.tracks[:12])
    assert measure_diffusion(few).step > 0
    assert not measure_diffusion(few).is_walk
    found, _ = followed(walks)
    own, _ = found(0.0)
    assert found.diffuse
    assert len(own) > walks.features.secure.sum()
    assert {f.speed > 0 for f in own} == {True, False}
    steady, _ = followed(matched)[0](0.0)
    assert min(f.error for f in own) > max(f.error for f in steady)
    speed, weight = np.array([(f.speed, f.error**-2) for f in own]).T
    assert abs(np.average(speed, weights=weight)) < 2 * weight.sum() ** -0.5


# -- parts of the data ------------------------------------------------------------


@pytest.fixture(scope="module")
def result(matched):
    return SCC.stack(matched, n_trials=99, rng=1)


NOTHING = np.nan, np.nan


def row(choice, pm, err, significant):
    numbers = dict.fromkeys(("change", "change_err", "change_sigma"), 0.0)
    numbers |= {"pm": pm, "pm_err": err, "p_value": 1.0, "n_features": 3}
    return {"choice": choice, "significant": significant, **numbers}


def test_every_part_of_a_steady_flow_has_its_speed(result):
    table = result.sensitivity
    assert list(table["choice"][:1]) == ["as measured"]
    assert len(table) == 9
    words = "intervals up", "intervals from", "epochs before", "epochs from", "inner"
    for choice, word in zip(table["choice"][1:], words, strict=False):
        assert choice.startswith(word)
    known = np.isfinite(table["pm"])
    assert known.sum() >= 6
    off = (table["pm"] - table["pm"][0])[known] / table["pm_err"][known]
    assert np.all(np.abs(off) < 3)
    assert not table["significant"].any()
    assert result.sensitivity_line == ""
    assert table["pm"][0] == result.components["pm"][0]


def test_both_parts_may_differ_from_the_whole():
    whole = row("as measured", 1.05, 0.1, False)
    fine, coarse = row("fine", 0.75, 0.07, False), row("coarse", 0.81, 0.1, False)
    off = largest_difference([fine, coarse, whole])
    assert off == pytest.approx(0.3 / np.hypot(0.07, 0.1))
    nothing = row("coarse", np.nan, np.nan, False)
    assert largest_difference([fine, nothing, whole]) == pytest.approx(off)
    assert np.isnan(largest_difference([nothing, nothing, whole]))


def test_parts_without_the_speed_are_said(result):
    rows = [row("as measured", 0.9, 0.1, False)]
    rows += [row("inner half", 0.1, 0.04, True), row("outer half", *NOTHING, True)]
    own = StreamVelocity(np.array([0.9, 0.0]), *np.zeros((2, 2, 2)), 0.0, 0.0)
    assert np.sqrt(with_choices(own, rows).covariance[0, 0]) == pytest.approx(0.4)
    assert with_choices(own, rows[:1]) is own
    rows += [row("fine scales", *NOTHING, False), row("coarse scales", *NOTHING, False)]
    assert replace(result, choices=rows).sensitivity_line == (
        "differs with the data: 0.100 +- 0.040 mas / yr (inner half); "
        "not found in 3 of 4 parts of the data"
    )


def test_halves_that_differ_are_in_the_error_along_the_velocity(result):
    """The first half of the dates has slow features, and the second has fast ones."""
    rows = [
        row("as measured", 0.3, 0.02, False),
        row("epochs before 2001-06-10", 0.29, 0.05, True),
        row("epochs from 2001-06-10 on", 0.06, 0.01, True),
        row("fine scales (1)", 0.3, 0.02, False),
        row("coarse scales (2)", 0.3, 0.02, False),
    ]
    line = replace(result, choices=rows).sensitivity_line
    assert line.count("mas / yr (epochs") == 2
    assert "scales" not in line
    axis, zero = np.array([np.cos(0.5), np.sin(0.5)]), np.zeros((2, 2))
    wider = with_choices(StreamVelocity(0.3 * axis, zero, zero, 0.0, 0.0), rows)
    assert np.sqrt(axis @ wider.covariance @ axis) == pytest.approx(0.12)
    assert [-axis[1], axis[0]] @ wider.covariance @ axis == pytest.approx(0)
