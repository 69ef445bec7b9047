# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Displacements and errors in angle against the WCS and against the formulas."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.wcs import WCS

from astro_scc.correlation import Matches
from astro_scc.decomposition import SSPs
from astro_scc.epochs import Beam, EpochCube
from astro_scc.epochs.positions import beam_fwhm, position_errors, ssp_offsets
from astro_scc.kinematics import PositionAngleFrame, RadialFrame, SkyFrame
from astro_scc.measurement.axes import angular_displacements

BEAMS = (
    Beam(1.0 * u.mas, 0.5 * u.mas, 30 * u.deg),
    Beam(0.8 * u.mas, 0.6 * u.mas, -70 * u.deg),
    Beam(1.2 * u.mas, 0.4 * u.mas, 5 * u.deg),
)
GRIDS = {
    "usual": [[-0.1, 0.0], [0.0, 0.1]],
    "east to the right": [[0.1, 0.0], [0.0, 0.1]],
    "not square": [[-0.05, 0.0], [0.0, 0.2]],
    "rotated": [[-0.1 * np.cos(0.5), 0.15 * np.sin(0.5)],
                [0.1 * np.sin(0.5), 0.15 * np.cos(0.5)]],
}  # fmt: skip


def celestial(cd=GRIDS["usual"]):
    """With RA and Dec from 180 and 30 deg and the reference pixel at (20, 12)."""
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---SIN", "DEC--SIN"]
    wcs.wcs.cunit = ["deg", "deg"]
    wcs.wcs.crval = [180.0, 30.0]
    wcs.wcs.crpix = [21.0, 13.0]
    wcs.wcs.cd = (np.array(cd) * u.mas).to_value(u.deg)
    wcs.wcs.set()
    return wcs


def make_cube(cd=GRIDS["usual"], beams=BEAMS):
    times = ["2000-01-01", "2000-07-01", "2001-03-01"]
    return EpochCube(
        data=np.ones((3, 32, 48)), times=times, wcs=celestial(cd), beams=beams
    )


def make_ssps(rng, n=12):
    x, y = rng.uniform(4, 44, n), rng.uniform(4, 28, n)
    return replace(
        SSPs.empty(),
        scale=np.tile([1.0, 2.0, 2.5], n)[:n],
        y=y,
        x=x,
        y_centroid=y + 0.3,
        x_centroid=x - 0.2,
        peak=np.ones(n),
        flux=np.ones(n),
        snr=rng.uniform(4, 50, n),
        bbox=np.zeros((n, 4), dtype=int),
        starts=np.arange(n + 1),
        pixels=np.arange(n),
        epoch=np.sort(np.arange(n) % 3),
    )


def make_matches(rng, ssps, n=40):
    ssp = rng.integers(len(ssps), size=n)
    columns = (
        ssp,
        (ssps.epoch[ssp] + rng.integers(1, 3, n)) % 3,
        rng.uniform(-8, 8, n),
        rng.uniform(-8, 8, n),
        rng.uniform(0.6, 1.0, n),
        rng.uniform(0.8, 1.0, n),
        rng.uniform(3, 30, n),
    )
    return Matches.from_columns([columns], [[0, 1], [1, 0]], (8, 8), 0.6)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def ssps(rng):
    return make_ssps(rng)


@pytest.fixture
def matches(rng, ssps):
    return make_matches(rng, ssps)


def sky_offsets(wcs, x, y):
    """Offsets of pixels from the reference pixel by way of celestial coordinates."""
    centre = SkyCoord(180 * u.deg, 30 * u.deg)
    east, north = centre.spherical_offsets_to(wcs.pixel_to_world(x, y))
    return east.to_value(u.mas), north.to_value(u.mas)


# Positions and their errors ------------------------------------------------------


@pytest.mark.parametrize("name", GRIDS)
def test_offsets_are_those_of_the_wcs(ssps, name):
    cube = make_cube(GRIDS[name])
    found = ssp_offsets(ssps, cube)
    # Right ascensions have no more digits than this.
    np.testing.assert_allclose(found, sky_offsets(cube.wcs, ssps.x, ssps.y), atol=1e-6)
    np.testing.assert_allclose(
        ssp_offsets(ssps, cube, centroid=True),
        sky_offsets(cube.wcs, ssps.x_centroid, ssps.y_centroid),
        atol=1e-6,
    )


def test_an_ssp_on_the_reference_pixel_has_no_offset(ssps):
    here = replace(ssps, x=np.full(12, 20.0), y=np.full(12, 12.0))
    np.testing.assert_array_equal(ssp_offsets(here, make_cube()), 0.0)


def test_position_errors_are_those_of_fomalont():
    fwhm = np.array([[1.0, 0.5], [2.0, 1.0], [1.0, 1.0]])
    snr = np.array([5.0, 10.0, 100.0])
    expected = fwhm / (np.sqrt(2) * snr[:, None])
    np.testing.assert_allclose(position_errors(snr, fwhm, 0.0), expected)


def test_the_floor_of_two_positions_is_the_fraction_of_the_beam():
    fwhm = np.array([[1.0, 0.5]])
    both = np.sqrt(2 * position_errors([np.inf], fwhm, 0.2) ** 2)
    np.testing.assert_allclose(both, 0.2 * fwhm)
    snr = np.array([7.0])
    np.testing.assert_allclose(
        position_errors(snr, fwhm, 0.2) ** 2,
        position_errors(snr, fwhm, 0.0) ** 2 + 0.5 * (0.2 * fwhm) ** 2,
    )


def test_below_the_noise_an_error_is_not_larger_than_the_beam():
    fwhm = np.ones((3, 2))
    found = position_errors([0.0, 0.5, 1.0], fwhm, 0.0)
    np.testing.assert_allclose(found, 1 / np.sqrt(2))


# The beam along the axes ---------------------------------------------------------


def test_a_beam_along_its_own_axes_has_its_own_widths():
    beam = Beam(1.0 * u.mas, 0.4 * u.mas, 35 * u.deg)
    axes = PositionAngleFrame(35 * u.deg).matrix()
    found = beam_fwhm(make_cube(beams=beam), [0], [1], axes)
    np.testing.assert_allclose(found, [[1.0, 0.4]])


def test_on_east_and_north_it_is_projected():
    beam = Beam(1.0 * u.mas, 0.4 * u.mas, 30 * u.deg)
    found = beam_fwhm(make_cube(beams=beam), [0], [1], np.eye(2))
    sin, cos = 0.5, np.sqrt(0.75)
    expected = [[np.hypot(sin, 0.4 * cos), np.hypot(cos, 0.4 * sin)]]
    np.testing.assert_allclose(found, expected)


def test_each_epoch_has_its_own_beam_and_each_row_its_own_axes():
    angles = np.array([10.0, 60.0, -40.0, 100.0])
    axes = np.stack([PositionAngleFrame(a * u.deg).matrix() for a in angles])
    epoch = np.array([0, 2, 1, 2])
    found = beam_fwhm(make_cube(), epoch, np.ones(4), axes)
    expected = [
        [BEAMS[e].fwhm_along(p * u.deg).value for p in (a, a + 90)]
        for e, a in zip(epoch, angles, strict=True)
    ]
    np.testing.assert_allclose(found, expected)


def test_without_beams_the_resolution_is_twice_the_scale():
    cube = make_cube(GRIDS["not square"], beams=None)
    found = beam_fwhm(cube, [0, 1, 2], [1, 2, 2.5], np.eye(2))
    # The pixel is 0.05 x 0.2 mas, 0.1 mas in the mean.
    np.testing.assert_allclose(found, [[0.4] * 2, [0.8] * 2, [1.2] * 2])
    assert beam_fwhm(cube, [], [], np.eye(2)).shape == (0, 2)


# Displacements -------------------------------------------------------------------


def unit_vectors(frame, east, north):
    """The two axes as (east, north), from the definition of the frames."""
    if isinstance(frame, SkyFrame):
        return (1.0, 0.0), (0.0, 1.0)
    if isinstance(frame, RadialFrame):
        pa = np.arctan2(east, north)
    else:
        pa = frame.pa.to_value(u.rad)
    return (np.sin(pa), np.cos(pa)), (np.cos(pa), -np.sin(pa))


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize(
    "frame", [SkyFrame(), PositionAngleFrame(40 * u.deg), RadialFrame()], ids=repr
)
def test_displacements_and_errors_by_hand(matches, ssps, name, frame):
    cube = make_cube(GRIDS[name])
    found = angular_displacements(matches, ssps, cube, frame, 0.2)
    assert len(found) == len(matches)
    owner = matches.ssp
    x, y = ssps.x[owner], ssps.y[owner]
    start = np.array(sky_offsets(cube.wcs, x, y))
    end = np.array(sky_offsets(cube.wcs, x + matches.dx, y + matches.dy))
    for k in range(len(matches)):
        axes = unit_vectors(frame, *start[:, k])
        for axis, d, s in zip(
            axes, (found.d1[k], found.d2[k]), (found.s1[k], found.s2[k]), strict=True
        ):
            assert d == pytest.approx(np.dot(axis, end[:, k] - start[:, k]), abs=2e-6)
            variance = 0.0
            for epoch, snr in (
                (ssps.epoch[owner[k]], ssps.snr[owner[k]]),
                (matches.target[k], matches.target_snr[k]),
            ):
                pa = np.arctan2(*axis) * u.rad
                beam = BEAMS[epoch].fwhm_along(pa).value
                variance += beam**2 * (0.5 / snr**2 + 0.5 * 0.2**2)
            assert s == pytest.approx(np.sqrt(variance), rel=1e-6)
    np.testing.assert_array_equal(found.reference, ssps.epoch[owner])
    np.testing.assert_array_equal(found.target, matches.target)
    np.testing.assert_array_equal(found.ssp, owner)
    np.testing.assert_allclose(found.weight, matches.coefficient * matches.overlap)
    np.testing.assert_array_equal(found.n_ssps, np.bincount(ssps.epoch))


def test_a_jet_to_the_west_moves_along_its_position_angle(ssps, matches):
    east = replace(matches, dx=np.full(40, 5.0), dy=np.zeros(40))
    found = angular_displacements(
        east, ssps, make_cube(), PositionAngleFrame(270 * u.deg), 0.2
    )
    np.testing.assert_allclose(found.d1, 0.5)
    np.testing.assert_allclose(found.d2, 0.0, atol=1e-12)


def test_expansion_about_the_reference_pixel_is_radial(ssps, matches):
    factor = 0.2
    owner = matches.ssp
    outwards = replace(
        matches, dx=factor * (ssps.x[owner] - 20), dy=factor * (ssps.y[owner] - 12)
    )
    found = angular_displacements(outwards, ssps, make_cube(), RadialFrame(), 0.2)
    np.testing.assert_allclose(
        found.d1, factor * np.hypot(*ssp_offsets(ssps, make_cube()))[owner]
    )
    np.testing.assert_allclose(found.d2, 0.0, atol=1e-12)


def test_a_selection_leaves_out_matches_and_ssps(ssps, matches):
    keep = np.arange(12) % 2 == 0
    found = angular_displacements(
        matches, ssps, make_cube(), SkyFrame(), 0.2, select=keep
    )
    np.testing.assert_array_equal(found.ssp, matches.ssp[keep[matches.ssp]])
    np.testing.assert_array_equal(found.n_ssps, np.bincount(ssps.epoch[keep]))
    none = angular_displacements(
        matches, ssps, make_cube(), SkyFrame(), 0.2, select=np.zeros(12, bool)
    )
    assert len(none) == 0
    assert none.n_ssps.tolist() == [0, 0, 0]


def test_at_the_origin_of_a_radial_frame_there_is_no_match(ssps, matches):
    """There neither axis is defined; the SSP counts as one without a match."""
    x, y = ssps.x.copy(), ssps.y.copy()
    x[0], y[0] = 20.0, 12.0
    core = replace(ssps, x=x, y=y)
    found = angular_displacements(matches, core, make_cube(), RadialFrame(), 0.2)
    assert 0 in matches.ssp
    np.testing.assert_array_equal(found.ssp, matches.ssp[matches.ssp != 0])
    for values in (found.d1, found.d2, found.s1, found.s2):
        assert np.isfinite(values).all()
    np.testing.assert_array_equal(found.n_ssps, np.bincount(ssps.epoch))
    on_sky = angular_displacements(matches, core, make_cube(), SkyFrame(), 0.2)
    assert len(on_sky) == len(matches)


def test_the_ssp_that_a_match_falls_on(ssps):
    """The nearest of the same scale in the target epoch, within one scale."""
    # From SSP 0 of scale 1 to 6, and from 1 of scale 2 to 4 and 7.
    x, y = np.full(12, 40.0), np.full(12, 20.0)
    x[[0, 1]], x[[4, 6, 7]] = 10.0, (15.0, 14.5, 13.0)
    y[[0, 1, 4, 6, 7]] = 20.0
    scale = ssps.scale.copy()
    epoch = ssps.epoch.copy()
    assert scale[[0, 6]].tolist() == [1.0, 1.0]
    assert scale[[1, 4, 7]].tolist() == [2.0, 2.0, 2.0]
    assert epoch[[0, 1, 4, 6, 7]].tolist() == [0, 0, 1, 1, 1]
    placed = replace(ssps, x=x, y=y)
    columns = (
        np.array([0, 0, 1, 1]),
        np.array([1, 1, 1, 1]),
        np.zeros(4),
        np.array([5.0, 7.0, 4.2, -9.0]),
        *np.ones((3, 4)),
    )
    matches = Matches.from_columns([columns], [[0, 1]], (9, 9), 0.6)
    found = angular_displacements(matches, placed, make_cube(), SkyFrame(), 0.2)
    # 0.5 and 2.5 px from SSP 6, whose scale is 2 px; 0.8 px from SSP 4; far from all.
    assert found.target_ssp.tolist() == [6, -1, 4, -1]


def test_no_ssps_no_displacements():
    matches = Matches.from_columns([], [[0, 1]], (3, 3), 0.6)
    for frame in (SkyFrame(), PositionAngleFrame(10 * u.deg), RadialFrame()):
        for beams in (BEAMS, None):
            found = angular_displacements(
                matches, SSPs.empty(), make_cube(beams=beams), frame, 0.2
            )
            assert len(found) == 0
            assert found.s1.shape == (0,)
            assert found.n_ssps.tolist() == [0, 0, 0]
