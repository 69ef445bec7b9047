# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Secure features as those of streams."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.measurement import select_ssps
from astro_scc.measurement.axes import AxisProjection
from astro_scc.measurement.followed import FollowedFeatures, random_walk
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
    return FollowedFeatures(matched, project, **how), project


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


def test_every_one_has_a_larger_error(matched):
    found, _ = followed(matched)
    every, _ = found(0.0, every=True)
    own, _ = found(0.0)
    assert len(every) >= len(own)
    known = {f.ssp[0]: f.error for f in own}
    assert all(f.error >= known.get(f.ssp[0], 0) for f in every)


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


def test_the_random_walk_is_that_which_was_simulated():
    """0.2 beams a step of thirty days, of 120 features in 20 epochs."""
    stream = Stream("walk", half_width=40.0, jitter=2.0, density=0.8)
    cube = JetSimulation(streams=[stream], n_epochs=20).run(rng=1).cube
    found = random_walk(SCC.match(cube).features)
    beam, step = 10 * cube.pixel_scale.to_value(u.mas), 30 / 365.25
    # Tracks that follow are those that wander less.
    assert 0.2 < found / (1.2 * (0.2 * beam) ** 2 / step) < 1.2
    steady = simulate_jet(n_epochs=12, dispersion=0.05, rng=1).cube
    walk = random_walk(SCC.match(steady).features)
    gap = np.median(np.diff(steady.years.to_value(u.yr)))
    fwhm = np.sqrt(steady.beams[0].major * steady.beams[0].minor).to_value(u.mas)
    assert walk < 1.2 * (0.1 * fwhm) ** 2 / gap
