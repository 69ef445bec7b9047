# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Probabilities and thresholds of tracks that differ in one respect."""

from dataclasses import replace

import numpy as np
import pytest

from astro_scc.features.motion import fit_motion
from astro_scc.features.tracks import Track
from astro_scc.features.trust import (
    COEFFICIENTS,
    CONSTANT,
    FAR,
    false_probability,
    is_secure,
    properties,
)


@pytest.fixture(scope="module")
def track_of(series):
    """Make a track of the first detection of each epoch, and its motion."""

    def make(rows, **options):
        d = series(rows, **options)
        own = np.flatnonzero(d.number == 0)
        args = (part[own] for part in (d.time, d.place, d.place_error))
        track = Track(own, np.ones(len(own) - 1), 1.0, True)
        return d, track, fit_motion(*args, d.fwhm)

    return make


def straight(n, *, speed=0.5, start=2.0, others=(), flux=(1.0, 1.0), step=1):
    """A feature that moves out, and others beside it."""
    rows = []
    for t in range(n):
        x = start + speed * t
        rows.append((step * t, x, 0.0, flux[t % 2]))
        rows += [(step * t, x, y) for y in others]
    return rows


def test_properties(track_of):
    rows = straight(6, others=[0.7], step=2, flux=(1.0, np.e))
    d, track, motion = track_of(rows)
    found = properties(d, track, motion)
    # It moves by 2.5 mas and is at 3.25 mas in the middle.
    expected = [np.log(6), np.log(2.5), np.log(3.55), 1.0, 6 / 11, 0.7]
    assert found[:6] == pytest.approx(expected)
    assert found[6] == pytest.approx(np.std([1, -1, 1, -1, 1]))
    assert found[7] == pytest.approx(0, abs=1e-9)
    p = 1 / (1 + np.exp(CONSTANT + COEFFICIENTS @ found))
    assert false_probability(d, track, motion) == pytest.approx(p)


def test_a_feature_alone_has_no_neighbour_in_reach(track_of):
    d, track, motion = track_of(straight(6))
    assert properties(d, track, motion)[5] == FAR
    d, track, motion = track_of(straight(6, others=[50.0]))
    assert properties(d, track, motion)[5] == FAR


def test_motion_is_in_beams_along_it(track_of):
    d, track, motion = track_of(straight(6, step=2))
    for beam, moved in (([1, 1], 2.5), ([4, 4], 1.25), ([4, 1], 1.25), ([1, 4], 2.5)):
        other = replace(d, beam=np.diag(beam) @ d.beam)
        assert properties(other, track, motion)[1] == pytest.approx(np.log(moved))


def test_what_is_vouched_for(track_of):
    _, track, motion = track_of(straight(8))
    assert is_secure(0.3, 1.0, track, motion)
    assert not is_secure(0.301, 1.0, track, motion)
    assert not is_secure(0.3, 0.999, track, motion)
    assert is_secure(0.3, 1.0, replace(track, same_speed=0.5), motion)
    assert not is_secure(0.3, 1.0, replace(track, same_speed=0.499), motion)
    short = replace(track, detection=track.detection[:3])
    assert not is_secure(0.0, 9.0, short, motion)
    assert is_secure(0.0, 9.0, replace(short, detection=track.detection[:4]), motion)
    for error, secure in ((motion.speed / 3.01, True), (motion.speed / 2.99, False)):
        other = replace(motion, velocity_err=np.full(2, error))
        assert is_secure(0.0, 9.0, track, other) is secure
