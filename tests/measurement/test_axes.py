# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Displacements along axes of frames, in beams, against rotation by hand."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc import Beam, EpochCube
from astro_scc.correlation import Matches
from astro_scc.decomposition import SSPs
from astro_scc.kinematics import (
    ExpansionFrame,
    PositionAngleFrame,
    RadialFrame,
    RidgeLine,
    SkyFrame,
)
from astro_scc.measurement.axes import AxisProjection, angular_displacements

DAYS = np.array([0, 73, 292])
BEAM = Beam(1.0 * u.mas, 0.4 * u.mas, 25 * u.deg)


def cube_of(beams=BEAM):
    """Three epochs without anything in them, with the core in the middle."""
    dates = np.datetime64("2010-01-01T00:00:00") + 86400 * DAYS.astype("timedelta64[s]")
    return EpochCube.from_arrays(
        np.zeros((3, 81, 81)), [str(d) for d in dates], pixel_scale=0.1 * u.mas,
        beams=beams,
    )  # fmt: skip


def ssps_of(cube, east, north, epoch, scale=1.0):
    """SSPs at offsets from the reference pixel in mas, sorted by epoch."""
    x0, y0 = cube.wcs.wcs.crpix - 1
    n = len(epoch)
    x, y = x0 - np.asarray(east) / 0.1, y0 + np.asarray(north) / 0.1
    return replace(
        SSPs.empty(), scale=np.broadcast_to(scale, n).astype(float), x=x, y=y,
        x_centroid=x, y_centroid=y, peak=np.ones(n), flux=np.ones(n),
        snr=np.full(n, 20.0), bbox=np.zeros((n, 4), dtype=int),
        starts=np.arange(n + 1), pixels=np.arange(n), epoch=np.asarray(epoch),
    )  # fmt: skip


def matches_of(ssps, pairs):
    """Matches that lead exactly from one SSP to another."""
    here, there = np.transpose(pairs)
    one = np.ones(len(here))
    columns = (
        here, ssps.epoch[there], ssps.y[there] - ssps.y[here],
        ssps.x[there] - ssps.x[here], 0.8 * one, one, 20 * one,
    )  # fmt: skip
    return Matches.from_columns([columns], [[0, 1], [1, 2]], (99, 99), 0.6)


def projected(cube, ssps, pairs, frame):
    matches = matches_of(ssps, pairs)
    d = angular_displacements(matches, ssps, cube, frame, 0.2)
    return AxisProjection(d, cube, frame)


EAST = np.array([0.5, -1.0, 1.5, 0.7, -0.6, 1.4])
NORTH = np.array([2.0, 1.5, -1.0, 2.3, 1.1, -1.7])
EPOCH = np.array([0, 0, 0, 1, 1, 2])
PAIRS = [(0, 3), (1, 4), (2, 5), (3, 0)]


def direction(pa):
    """(east, north) of a position angle."""
    return np.array([np.sin(pa), np.cos(pa)])


# First axis, and the way in which its second one turns: north through east.
UNIFORM = {
    "sky": (SkyFrame(), np.pi / 2, -1),
    "position angle": (PositionAngleFrame(200 * u.deg), np.radians(200), 1),
}


@pytest.mark.parametrize("name", UNIFORM)
@pytest.mark.parametrize("angle", [-2.5, -0.4, 0.0, 0.7, np.pi / 2])
def test_axes_that_are_the_same_everywhere(name, angle):
    frame, first, sense = UNIFORM[name]
    cube = cube_of()
    project = projected(cube, ssps_of(cube, EAST, NORTH, EPOCH), PAIRS, frame)
    d = project(angle)
    along = first + sense * angle
    across = along + sense * np.pi / 2
    for values, pa, part in ((d.d1, along, 0), (d.d2, across, 1)):
        width = BEAM.fwhm_along(pa * u.rad).to_value(u.mas)
        assert project.beam(angle)[part] == pytest.approx(width)
        place = np.stack([EAST, NORTH], axis=1) @ direction(pa) / width
        here, there = np.transpose(PAIRS)
        np.testing.assert_allclose(values, (place[there] - place[here]), atol=1e-6)
        np.testing.assert_allclose(d.position[:, part], place, atol=1e-6)


def test_what_goes_with_the_displacements():
    cube = cube_of()
    ssps = ssps_of(cube, EAST, NORTH, EPOCH, scale=[1, 1, 2, 1, 1, 2])
    d = projected(cube, ssps, PAIRS, SkyFrame())(0.3)
    np.testing.assert_array_equal(d.ssp, [0, 1, 2, 3])
    np.testing.assert_array_equal(d.target_ssp, [3, 4, 5, 0])
    np.testing.assert_array_equal(d.reference, [0, 0, 0, 1])
    np.testing.assert_array_equal(d.target, [1, 1, 2, 0])
    np.testing.assert_array_equal(d.epoch, EPOCH)
    np.testing.assert_array_equal(d.scale, ssps.scale)
    np.testing.assert_allclose(d.weight, 0.8)
    np.testing.assert_allclose(d.interval, [0.2, 0.2, 0.8, -0.2], rtol=1e-3)


def test_half_a_turn_is_the_same_axis_backwards():
    cube = cube_of()
    project = projected(cube, ssps_of(cube, EAST, NORTH, EPOCH), PAIRS, SkyFrame())
    one, other = project(0.4), project(0.4 + np.pi)
    np.testing.assert_allclose(one.d1, -other.d1, atol=1e-12)
    np.testing.assert_allclose(one.d2, -other.d2, atol=1e-12)
    np.testing.assert_allclose(one.position, -other.position, atol=1e-12)


def test_beams_of_epochs_and_scales_are_averaged_over_ssps():
    beams = [Beam(b * u.mas, b * u.mas) for b in (0.5, 0.8, 1.1)]
    cube = cube_of(beams)
    ssps = ssps_of(cube, EAST, NORTH, EPOCH)
    project = projected(cube, ssps, PAIRS, SkyFrame())
    np.testing.assert_allclose(project.beam(1.0), (3 * 0.5 + 2 * 0.8 + 1.1) / 6)
    # Without beams, twice the scale: 4 and 8 pixels.
    cube = cube_of(None)
    ssps = ssps_of(cube, EAST, NORTH, EPOCH, scale=[1, 1, 2, 1, 1, 2])
    project = projected(cube, ssps, PAIRS, SkyFrame())
    np.testing.assert_allclose(project.beam(1.0), (4 * 0.4 + 2 * 0.8) / 6)


@pytest.mark.parametrize("pa", [0.0, 77.0, 180.0, 291.0])
def test_away_from_a_point_what_moves_outward_keeps_its_direction(pa):
    """Three features that move by 0.5 and 1 mas, in any direction, also south."""
    cube = cube_of(Beam(0.5 * u.mas, 0.5 * u.mas))
    angle = np.radians(pa + np.array([-20, 0.5, 10]))
    r = np.concatenate([[1.0, 2.0, 1.5] + 0.5 * k for k in np.arange(3)])
    east, north = r * direction(np.tile(angle, 3))
    ssps = ssps_of(cube, east, north, np.repeat([0, 1, 2], 3))
    pairs = [(k, k + 3) for k in range(6)]
    project = projected(cube, ssps, pairs, RadialFrame())
    np.testing.assert_allclose(project.beam(0.0), 0.5)
    d = project(0.0)
    np.testing.assert_allclose(d.d1, 1.0)
    np.testing.assert_allclose(d.d2, 0.0, atol=1e-6)
    place = d.position.reshape(3, 3, 2)
    np.testing.assert_allclose(place[..., 0], r.reshape(3, 3) / 0.5)
    # Each keeps its place around the point, as far apart as at the mean distance.
    np.testing.assert_allclose(place[1:, :, 1], place[:-1, :, 1], atol=1e-6)
    apart = np.diff(angle) * r.mean() / 0.5
    np.testing.assert_allclose(np.diff(place[0, :, 1]), apart)


def test_at_the_point_itself_there_is_no_axis():
    cube = cube_of(Beam(0.5 * u.mas, 0.5 * u.mas))
    ssps = ssps_of(cube, [0.0, 1.0], [0.0, 0.0], [0, 1])
    matches = matches_of(ssps, [(0, 1), (1, 0)])
    d = angular_displacements(matches, ssps, cube, RadialFrame(), 0.2)
    project = AxisProjection(d, cube, RadialFrame())
    np.testing.assert_allclose(project.beam(0.0), 0.5)
    found = project(0.0)
    np.testing.assert_array_equal(found.ssp, [1])
    assert np.isfinite(found.position).all()


def test_along_a_straight_ridge_line_it_is_along_its_position_angle():
    cube = cube_of()
    ssps = ssps_of(cube, EAST, NORTH, EPOCH)
    pa = 40 * u.deg
    line = RidgeLine(*([0, 1, 2, 3] * u.mas * direction(pa.to_value(u.rad))[:, None]))
    bent, straight = (
        projected(cube, ssps, PAIRS, frame)(0.0)
        for frame in (line, PositionAngleFrame(pa))
    )
    np.testing.assert_allclose(bent.d1, straight.d1, atol=1e-6)
    np.testing.assert_allclose(bent.d2, straight.d2, atol=1e-6)
    np.testing.assert_allclose(bent.position, straight.position, atol=1e-6)


def test_around_a_bend_it_is_the_way_along_the_line():
    """A quarter of a circle of 2 mas; features 30 deg of it apart."""
    cube = cube_of(Beam(0.5 * u.mas, 0.5 * u.mas))
    turn = np.linspace(0, np.pi / 2, 60)
    line = RidgeLine(-2 * np.sin(turn) * u.mas, 2 * (1 - np.cos(turn)) * u.mas)
    at = np.radians([15, 45, 75])
    ssps = ssps_of(cube, -2 * np.sin(at), 2 * (1 - np.cos(at)), [0, 1, 2])
    d = projected(cube, ssps, [(0, 1), (1, 2)], line)(0.0)
    arc = 2 * np.radians(30) / 0.5
    np.testing.assert_allclose(d.d1, arc, rtol=1e-3)
    np.testing.assert_allclose(d.d2, 0.0, atol=2e-3)
    np.testing.assert_allclose(np.diff(d.position[:, 0]), arc, rtol=1e-3)


def test_in_homologous_expansion_all_features_move_alike():
    """Distances grow by a tenth in each step, whatever they are."""
    cube = cube_of(None)
    centre, radius, rate = [0.2, -0.1] * u.mas, 2 * u.mas, 0.1
    r0, angle = np.array([1.0, 1.5, 2.2]), np.radians([200, 20, 110])
    r = np.outer(np.exp(rate * np.arange(3)), r0)
    east, north = r * direction(angle)[:, None] + centre.value[:, None, None]
    ssps = ssps_of(cube, east.ravel(), north.ravel(), np.repeat([0, 1, 2], 3))
    frame = ExpansionFrame(centre, radius)
    pairs = [(k, k + 3) for k in range(6)]
    project = projected(cube, ssps, pairs, frame)
    d = project(0.0)
    # The resolution, 0.4 mas, as it is at the radius.
    assert project.beam(0.0)[0] == pytest.approx(0.4 * np.mean(2.0 / r))
    step = rate * 2.0 / project.beam(0.0)[0]
    # Midway between two places, in place of the exponential.
    np.testing.assert_allclose(d.d1, step, rtol=1e-3)
    np.testing.assert_allclose(d.d2, 0.0, atol=1e-6)
    place = d.position.reshape(3, 3, 2)
    np.testing.assert_allclose(np.diff(place[..., 0], axis=0), step)
    np.testing.assert_allclose(np.diff(place[..., 1], axis=0), 0.0, atol=1e-6)


@pytest.mark.parametrize(
    "frame",
    [SkyFrame(), RadialFrame(), ExpansionFrame([0, 0] * u.mas, 1 * u.mas)],
    ids=repr,
)
@pytest.mark.parametrize("beams", [BEAM, None])
def test_no_ssps_no_displacements(frame, beams):
    cube = cube_of(beams)
    matches = Matches.from_columns([], [[0, 1]], (3, 3), 0.6)
    d = angular_displacements(matches, SSPs.empty(), cube, frame, 0.2)
    project = AxisProjection(d, cube, frame)
    assert len(project(0.3)) == 0
    np.testing.assert_array_equal(project.beam(0.3), 1.0)
