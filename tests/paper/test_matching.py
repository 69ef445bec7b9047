# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The largest displacement; displacements and errors against rotation by hand."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc import Beam, EpochCube, StackedCrossCorrelation
from astro_scc.decomposition import SSPs
from astro_scc.exceptions import MeasurementWarning
from astro_scc.kinematics import PositionAngleFrame, RadialFrame, SkyFrame
from astro_scc.paper import Matches
from astro_scc.paper.method import matched_displacements


def cube_of(days, shape=(40, 60), beam=1.0):
    """Epochs without anything in them, of pixels of 0.1 mas."""
    return EpochCube.from_arrays(
        np.zeros((len(days), *shape)), Time("2010-01-01") + np.array(days) * u.day,
        pixel_scale=0.1 * u.mas, beams=Beam(beam * u.mas, beam * u.mas),
    )  # fmt: skip


def plan_of(days, speed=None, shape=(40, 60), beam=1.0):
    cube = cube_of(days, shape, beam)
    speed = None if speed is None else speed * u.mas / u.yr
    return StackedCrossCorrelation(scales=[1], max_speed=speed).plan(cube)


YEAR = 365.25


def test_the_largest_displacement():
    """That of the largest speed in the longest interval, and a beam."""
    *_, max_speed, reach = plan_of((0, YEAR / 2, YEAR * 3 / 2), 0.45)
    assert (max_speed, reach) == (0.45, (15, 15))
    # Without a largest speed four beams in the longest interval.
    *_, max_speed, reach = plan_of(
        (0, YEAR / 2, YEAR * 3 / 2), beam=0.35, shape=(99, 99)
    )
    assert (max_speed, reach) == (pytest.approx(4 * 0.35), (18, 18))


def test_windows_end_with_the_image_and_warn():
    message = (
        "^max_speed moves 10 to 10 mas between two dates, more than half the image: "
        "give a smaller one, or a baseline that leaves out long intervals$"
    )
    with pytest.warns(MeasurementWarning, match=message):
        assert plan_of((0, YEAR), 10.0)[-1] == (39, 59)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plan_of((0, YEAR), 2.85)
        assert plan_of((0, YEAR), beam=2.0)[-1] == (39, 59)


@pytest.mark.filterwarnings("ignore:two images are of")
def test_dates_without_a_pair_are_refused():
    words = "^all 3 epochs are of one date .2010-01-01T00:00:00.000.: v"
    with pytest.raises(ValueError, match=words):
        plan_of((0, 0, 0))


def ssps_of(cube, east, north, epoch, scale=1.0):
    """SSPs at offsets from the reference pixel in mas, sorted by epoch."""
    x0, y0 = cube.wcs.wcs.crpix - 1
    n = len(epoch)
    x, y = x0 - np.asarray(east) / 0.1, y0 + np.asarray(north) / 0.1
    return replace(
        SSPs.empty(), scale=np.broadcast_to(scale, n).astype(float), x=x, y=y,
        x_centroid=x, y_centroid=y, peak=np.ones(n), flux=np.ones(n),
        snr=np.full(n, 20.0), bbox=np.zeros((n, 4), dtype=int),
        starts=np.arange(n + 1), pixels=np.arange(n), values=np.ones(n),
        epoch=np.asarray(epoch),
    )  # fmt: skip


def displacements_of(matches, ssps, cube, frame):
    select = np.ones(len(ssps), bool)
    of = SimpleNamespace(matches=matches, ssps=ssps, cube=cube, select=select)
    return matched_displacements(of, frame, min_error_beams=0.2)


AXES = (1.0, 0.5, 30), (0.8, 0.6, -70), (1.2, 0.4, 5)
BEAMS = [Beam(a * u.mas, b * u.mas, pa * u.deg) for a, b, pa in AXES]
GRIDS = {
    "usual": [[-0.1, 0.0], [0.0, 0.1]],
    "rotated": [[-0.1 * np.cos(0.5), 0.15 * np.sin(0.5)],
                [0.1 * np.sin(0.5), 0.15 * np.cos(0.5)]],
}  # fmt: skip


def make_cube(cd=GRIDS["usual"]):
    """With RA and Dec from 180 and 30 deg and the reference pixel at (20, 12)."""
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.cunit = ["RA---SIN", "DEC--SIN"], ["deg", "deg"]
    wcs.wcs.crval, wcs.wcs.crpix = [180.0, 30.0], [21.0, 13.0]
    wcs.wcs.cd = (np.array(cd) * u.mas).to_value(u.deg)
    times = ["2000-01-01", "2000-07-01", "2001-03-01"]
    return EpochCube(data=np.ones((3, 32, 48)), times=times, wcs=wcs, beams=BEAMS)


@pytest.fixture
def ssps():
    """Twelve SSPs of three epochs at random places."""
    rng = np.random.default_rng(0)
    east, north = rng.uniform(-2.4, 1.6, 12), rng.uniform(-0.8, 1.6, 12)
    epoch, scale = np.repeat([0, 1, 2], 4), np.tile([1.0, 2.0, 2.5], 4)
    made = ssps_of(make_cube(), east, north, epoch, scale)
    return replace(made, snr=rng.uniform(4, 50, 12))


@pytest.fixture
def matches(ssps):
    """Forty random ones between different epochs."""
    rng, n = np.random.default_rng(1), 40
    ssp = rng.integers(12, size=n)
    target = (ssps.epoch[ssp] + rng.integers(1, 3, n)) % 3
    motion, share = rng.uniform(-8, 8, (2, n)), rng.uniform(0.6, 1.0, (2, n))
    columns = ssp, target, *motion, *share, rng.uniform(3, 30, n)
    return Matches(*columns).select(np.lexsort((target, ssp)))


def sky_offsets(wcs, x, y):
    """Offsets (east, north) from the reference pixel by celestial coordinates."""
    centre = SkyCoord(180 * u.deg, 30 * u.deg)
    offsets = centre.spherical_offsets_to(wcs.pixel_to_world(x, y))
    return np.array([offset.to_value(u.mas) for offset in offsets])


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize(
    ("frame", "first", "turn"),
    [
        (SkyFrame(), lambda place: np.pi / 2 + 0 * place[0], -1),
        (PositionAngleFrame(40 * u.deg), lambda p: np.radians(40) + 0 * p[0], 1),
        (RadialFrame(), lambda place: np.arctan2(*place), 1),
    ],
)
def test_displacements_and_errors_by_hand(matches, ssps, name, frame, first, turn):
    """``first`` is the position angle of the first axis at a place."""
    cube, owner = make_cube(GRIDS[name]), matches.ssp
    found = displacements_of(matches, ssps, cube, frame)
    x, y = ssps.x[owner], ssps.y[owner]
    start = sky_offsets(cube.wcs, x, y)
    moved = sky_offsets(cube.wcs, x + matches.dx, y + matches.dy) - start
    for pa, d, s in (
        (first(start), found.d1, found.s1),
        (first(start) + turn * np.pi / 2, found.d2, found.s2),
    ):
        along = (np.stack([np.sin(pa), np.cos(pa)]) * moved).sum(axis=0)
        np.testing.assert_allclose(d, along, atol=2e-6)
        variance = 0.0
        for epoch, snr in (
            (ssps.epoch[owner], ssps.snr[owner]),
            (matches.target, matches.target_snr),
        ):
            beams = zip(epoch, pa, strict=True)
            beam = np.array([BEAMS[k].fwhm_along(a * u.rad).value for k, a in beams])
            variance += beam**2 * (0.5 / snr**2 + 0.5 * 0.2**2)
        np.testing.assert_allclose(s, np.sqrt(variance), rtol=1e-6)
    np.testing.assert_array_equal(found.ssp, owner)
    np.testing.assert_allclose(found.weight, matches.coefficient * matches.overlap)
    np.testing.assert_array_equal(found.n_ssps, np.bincount(ssps.epoch))


def test_at_the_origin_of_a_radial_frame_there_is_no_match(ssps, matches):
    """There neither axis is defined; the SSP counts as one without a match."""
    x, y = (np.insert(a[1:], 0, at) for a, at in ((ssps.x, 20.0), (ssps.y, 12.0)))
    core = replace(ssps, x=x, y=y)
    found = displacements_of(matches, core, make_cube(), RadialFrame())
    np.testing.assert_array_equal(found.ssp, matches.ssp[matches.ssp != 0])
    assert np.isfinite([found.d1, found.d2, found.s1, found.s2]).all()
    np.testing.assert_array_equal(found.n_ssps, np.bincount(ssps.epoch))
