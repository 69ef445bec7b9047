# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Secure features as those of streams."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.features.diffusion import measure_diffusion, random_walk
from astro_scc.measurement import select_ssps
from astro_scc.measurement.axes import AxisProjection
from astro_scc.measurement.followed import FollowedFeatures
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
    wanted = {
        (i, j)
        for i, j in np.argwhere(d.epoch[:, None] < d.epoch).tolist()
        if np.hypot(*(d.place[j] - d.place[i])) <= np.hypot(1.5, 0.35) * d.major
        and not (core[i] or core[j])
    }
    assert (
        set(zip(pairs.ssp.tolist(), pairs.target_ssp.tolist(), strict=True)) == wanted
    )
    np.testing.assert_allclose(
        pairs.d1, along[pairs.target_ssp] - along[pairs.ssp], atol=1e-9
    )
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


def test_the_random_walk_is_that_which_was_simulated(matched, walks):
    step = variance_of_steps(walks.cube, 0.2, 30 / 365.25)
    # Tracks that follow are those that wander less, and their speeds those of all.
    assert 0.2 < random_walk(walks.features) / step < 1.2
    found = measure_diffusion(walks.features)
    assert found.is_walk
    assert found.variance / step == pytest.approx(1, rel=0.4)
    gap = np.median(np.diff(matched.cube.years.to_value(u.yr)))
    assert random_walk(matched.features) < variance_of_steps(matched.cube, 0.1, gap)
    assert not measure_diffusion(matched.features).is_walk


def test_all_features_that_diffuse_count(matched, walks):
    found, project = followed(walks)
    own, _ = found(0.0)
    assert found.diffuse
    assert len(own) > walks.features.secure.sum()
    assert {f.speed > 0 for f in own} == {True, False}
    assert min(f.error for f in own) > max(
        f.error for f in followed(matched)[0](0.0)[0]
    )
    speed, weight = np.array([(f.speed, f.error**-2) for f in own]).T
    assert abs(np.average(speed, weights=weight)) < 2 * weight.sum() ** -0.5


def test_few_features_show_no_diffusion(walks):
    features = walks.features
    few = replace(features, tracks=features.tracks[:12])
    found = measure_diffusion(few)
    assert found.step > 0
    assert not found.is_walk
