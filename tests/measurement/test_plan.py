# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What is measured: scales, pairs, windows, grids and regions, and what is refused."""

import re
import warnings
from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc import Beam, EpochCube
from astro_scc.decomposition import Decomposer
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.exceptions import MeasurementWarning
from astro_scc.measurement.matched import centroids_inside, decompose_epochs
from astro_scc.measurement.plan import (
    SearchPlan,
    flow_direction,
    map_grid,
    mean_fwhm,
    pairs_of_dates,
    scales_of_pixels,
    search_radius,
)

YEAR = 365.25
PIXEL = 0.1 * u.mas


def cube_of(days=(0, 30, 90), shape=(40, 60), beams=None, data=None):
    """Epochs without anything in them."""
    dates = np.datetime64("2010-01-01T00:00:00") + np.array(
        [int(86400 * d) for d in days], dtype="timedelta64[s]"
    )
    data = np.zeros((len(days), *shape)) if data is None else data
    return EpochCube.from_arrays(
        data, [str(d) for d in dates], pixel_scale=PIXEL, beams=beams
    )


# Scales.


@given(st.integers(1, 16), st.floats(0.84, 1.19))
def test_angles_name_the_scale_that_they_are_near(half, factor):
    number = half / 2
    size = factor * scale_size(number)
    (found,) = scales_of_pixels([size * 0.1] * u.mas, PIXEL)
    # Between two scales the nearer one.
    assert abs(np.log(scale_size(found) / size)) <= abs(np.log(factor)) + 1e-9
    if 0.9 < factor < 1.1:
        assert found == number


@pytest.mark.parametrize(
    ("angles", "angle", "pixels"),
    [
        ([0.4, 0.05] * u.mas, "0.05 mas", "0.5"),
        # Midway between 1 and 1.5 pixels.
        ([0.122, 0.4] * u.mas, "0.122 mas", "1.2"),
        ([2.0] * u.arcsec, "2.0 arcsec", "2e+04"),
    ],
)
def test_an_angle_that_is_no_scale(angles, angle, pixels):
    message = f"scale {angle} is {pixels} px, not near 2^j or 1.5 x 2^j px"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        scales_of_pixels(angles, PIXEL)


# Pairs.


def test_consecutive_dates_are_paired():
    pairs = pairs_of_dates(cube_of(), None)
    assert list(zip(pairs.first, pairs.second, strict=True)) == [(0, 1), (1, 2)]
    np.testing.assert_allclose(pairs.interval * YEAR, [30, 60])


def test_baselines_pair_all_dates_of_the_range():
    pairs = pairs_of_dates(cube_of(), [50, 100] * u.day)
    assert list(zip(pairs.first, pairs.second, strict=True)) == [(0, 2), (1, 2)]


def test_one_epoch_has_no_velocity():
    with pytest.raises(ValueError, match=r"^velocities need at least two epochs, the"):
        pairs_of_dates(cube_of((0,)), None)


def test_epochs_of_one_date_have_no_velocity():
    message = r"^all 3 epochs are of one date \(2010-01-01T00:00:00.000\): velocities"
    with pytest.raises(ValueError, match=message):
        pairs_of_dates(cube_of((0, 0, 0)), None)


@pytest.mark.parametrize("days", [(0, 30, 90), (0, 0, 0)])
def test_a_baseline_that_no_pair_has(days):
    message = (
        f"no two epochs are 1 to 2 yr apart: their separations go from "
        f"{min(np.diff(days)) / YEAR:.3g} to {max(days) / YEAR:.3g} yr; "
        "choose another baseline"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        pairs_of_dates(cube_of(days), [1, 2] * u.yr)


# Resolution, windows and grids.


def test_resolution_is_the_mean_over_epochs_and_axes():
    round_, long_ = (
        Beam(1 * u.mas, 1 * u.mas, 0 * u.deg),
        Beam(3 * u.mas, 1 * u.mas, 0 * u.deg),
    )
    cube = cube_of(beams=[round_, round_, long_])
    assert mean_fwhm(cube, 2) == pytest.approx((1 + 1 + 1 + 1 + 3 + 1) / 6)
    # However the beam is turned.
    turned = cube_of(beams=[Beam(3 * u.mas, 1 * u.mas, 90 * u.deg)] * 3)
    assert mean_fwhm(turned, 2) == pytest.approx(2.0)


def evenly(n_epochs, days=30):
    return cube_of(days * np.arange(n_epochs), shape=(8, 8))


def test_neighbouring_features_are_not_searched():
    """One and a half beams, where intervals are short enough for that."""
    month = 30 / YEAR
    assert search_radius(evenly(30), None, 1.0) == 1.5
    assert search_radius(evenly(30), 0.5 / month, 1.0) == 1.5
    # No two dates, no interval.
    assert search_radius(cube_of((0,)), None, 1.0) == 1.5


def test_the_largest_speed_is_reached_in_the_shorter_intervals():
    # And the scatter of displacements about it, three times 0.12 beam.
    month = 30 / YEAR
    cube = cube_of(np.cumsum([0, 30, 30, 90, 90, 90]), shape=(8, 8))
    for speed, fwhm in ((3.0, 1.0), (6.0, 2.0)):
        found = search_radius(cube, speed / month, fwhm)
        assert found == pytest.approx(3.0 + 0.36, rel=1e-6)


def test_short_series_are_searched_farther():
    """To four beams in the median interval, of up to 20 epochs."""
    assert search_radius(evenly(20), None, 1.0) == pytest.approx(4.36)
    assert search_radius(evenly(21), None, 1.0) == 1.5
    cube = cube_of(np.cumsum([0, 30, 30, 60, 60, 60]), shape=(8, 8))
    assert search_radius(cube, None, 1.0) == pytest.approx(2.36)


def reach(cube, pairs, radius, fwhm, max_speed):
    plan = SimpleNamespace(pairs=pairs, radius=radius, fwhm=fwhm, max_speed=max_speed)
    return SearchPlan.reach(plan, cube)


def test_windows_end_with_the_image_and_warn():
    cube = cube_of((0, YEAR), shape=(40, 60))
    pairs = pairs_of_dates(cube, None)
    message = (
        r"^max_speed moves 10 mas in the longest interval \(1 yr\), more than "
        "half the image: give a smaller one, or a baseline that leaves out long "
        "intervals$"
    )
    with pytest.warns(MeasurementWarning, match=message):
        assert reach(cube, pairs, 1.5, 1.0, 10.0) == (39, 59)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reach(cube, pairs, 1.5, 1.0, 2.85)
        assert reach(cube, pairs, 9.0, 1.0, None) == (39, 59)


def test_speeds_far_beyond_the_image_or_below_any_motion_are_refused():
    cube = cube_of((0, YEAR), shape=(40, 60))
    pairs = pairs_of_dates(cube, None)
    with pytest.raises(ValueError, match=r"max_speed moves 1e\+09 mas in the shortest"):
        reach(cube, pairs, 1.5, 1.0, 1e9)
    with pytest.raises(ValueError, match=r"1e-09 mas .* less than 0.01 of a pixel: gi"):
        reach(cube, pairs, 1.5, 1.0, 1e-9)


def test_the_grid_is_half_the_narrowest_kernel(matched, sky_result):
    d, pairs = sky_result.displacements, sky_result.pairs
    grid = map_grid(d, pairs, 30.0)
    assert grid.v_max == (30.0, 30.0)
    for step, s in zip(grid.step, (d.s1, d.s2), strict=True):
        narrowest = s.min() / pairs.interval.max()
        assert 0.45 * narrowest < step <= 0.5 * narrowest
    none = d.select(np.zeros(len(d), bool))
    assert map_grid(none, pairs, 30.0).shape == (41, 41)
    wide = replace(d, s1=100 * d.s1, s2=100 * d.s2)
    assert map_grid(wide, pairs, 30.0).shape == (3, 3)


# Decomposition, regions, direction.


def test_every_epoch_is_decomposed_with_its_mask_noise_and_beam(monkeypatch):
    rng = np.random.default_rng(0)
    data = rng.normal(size=(3, 40, 60))
    beams = [Beam(b * u.mas, 0.5 * u.mas, 0 * u.deg) for b in (0.8, 1.0, 1.2)]
    cube = cube_of(beams=beams, data=data)
    asked = []

    def record(self, image, **options):
        asked.append((image, options))

    monkeypatch.setattr(Decomposer, "__call__", record)
    decompose_epochs(cube, Decomposer(scales=(1,), noise="propagated"))
    for k, (image, options) in enumerate(asked):
        np.testing.assert_array_equal(image, data[k])
        np.testing.assert_array_equal(options["mask"], cube.mask[k])
        assert options["rms"] == pytest.approx(cube.noise_rms()[k].value)
        # In pixels: the long axis to the north.
        variance = np.diag(options["beam_covariance"]) * 8 * np.log(2)
        np.testing.assert_allclose(variance, [25, 100 * (0.8, 1.0, 1.2)[k] ** 2])
    asked.clear()
    decompose_epochs(cube, Decomposer(scales=(1,)))
    assert [options["rms"] for _, options in asked] == [None] * 3
    assert [options["beam_covariance"] for _, options in asked] == [None] * 3
    asked.clear()
    decompose_epochs(cube_of(data=data), Decomposer(scales=(1,), noise="propagated"))
    assert [options["beam_covariance"] for _, options in asked] == [None] * 3
    assert all(options["rms"] > 0 for _, options in asked)


def test_ssps_are_inside_if_their_centroid_is(matched):
    ssps, cube = matched.ssps, matched.cube
    everything = centroids_inside(ssps, cube, None)
    assert everything.all()
    assert len(everything) == len(ssps) > 0
    region = np.zeros(cube.shape[1:], bool)
    region[:, 60:160] = True
    inside = centroids_inside(ssps, cube, region)
    x = np.rint(ssps.x_centroid)
    np.testing.assert_array_equal(inside, (x >= 60) & (x < 160))
    assert 0 < inside.sum() < len(ssps)
    empty = np.zeros(cube.shape[1:], bool)
    empty[0, 0] = True
    assert not centroids_inside(ssps, cube, empty).any()


def ssps_at(cube, x, y, flux):
    ssps = SimpleNamespace(x=np.array(x), y=np.array(y), flux=np.array(flux))
    return SimpleNamespace(cube=cube, ssps=ssps, select=np.ones(len(ssps.x), bool))


@pytest.mark.parametrize(
    ("dx", "dy", "angle"), [(0, 5, 0), (-5, 0, 90), (-3, -3, 135), (5, 0, 270)]
)
def test_the_jet_flows_to_where_its_flux_is(dx, dy, angle):
    """North through east; east is to the left."""
    cube = cube_of()
    x0, y0 = cube.wcs.wcs.crpix - 1
    direction = flow_direction(ssps_at(cube, [x0 + dx], [y0 + dy], [1.0]))
    assert direction.to_value(u.deg) == pytest.approx(angle)
