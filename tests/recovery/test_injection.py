# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features against the Gaussians and lines they are to be, and when they are found."""

from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time
from astropy.wcs import WCS
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from astro_scc import EpochCube
from astro_scc.epochs import Beam
from astro_scc.kinematics import PositionAngleFrame, RadialFrame, SkyFrame
from astro_scc.recovery import draw_paths, inject
from astro_scc.recovery.injection import (
    FeaturePaths,
    moving_components,
    recovered,
    velocity_along,
)

YEARS = np.array([0.0, 0.3, 1.0, 1.2, 2.5])


def cube_of(shape=(40, 60), angle=0.0, sides=(0.1, 0.1), **options):
    """Uneven dates, pixels that may be turned and oblong."""
    turn = np.deg2rad(angle)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---SIN", "DEC--SIN"]
    wcs.wcs.crpix = [shape[1] / 2, shape[0] / 2]
    wcs.wcs.cunit = ["deg", "deg"]
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    wcs.wcs.cd = rotation @ np.diag([-sides[0], sides[1]]) * u.mas.to(u.deg)
    return EpochCube(
        data=np.zeros((len(YEARS), *shape)),
        times=Time(2000 + YEARS, format="jyear"),
        wcs=wcs,
        **options,
    )


def box(cube, rows=slice(10, 30), columns=slice(5, 55)):
    area = np.zeros(cube.shape[1:], dtype=bool)
    area[rows, columns] = True
    return area


def test_features_are_gaussians_of_each_epochs_beam():
    beams = [Beam((1 + k / 10) * u.mas, 0.5 * u.mas, 25 * k * u.deg) for k in range(5)]
    cube = cube_of(angle=20, sides=(0.1, 0.13), beams=beams)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 60, (3, 5)), rng.uniform(0, 40, (3, 5))
    full = inject(cube, FeaturePaths(x, y, x > 0), 0.7)
    column, row = np.meshgrid(np.arange(60), np.arange(40))
    for k, beam in enumerate(beams):
        expected = np.zeros((40, 60))
        inverse = np.linalg.inv(beam.covariance.value)
        for f in range(3):
            offset = np.stack([column - x[f, k], row - y[f, k]], axis=-1)
            offset = offset @ cube.pixel_matrix.value.T
            square = np.einsum("yxi,ij,yxj->yx", offset, inverse, offset)
            expected += 0.7 * np.exp(-square / 2)
        np.testing.assert_allclose(full.data[k], expected, atol=1e-9)


def test_the_epochs_stay_as_they_are():
    data = np.random.default_rng(2).normal(size=(5, 40, 60))
    data[:, :, 30:34] = np.nan
    cube = EpochCube.from_arrays(
        data, Time(2000 + YEARS, format="jyear"), pixel_scale=0.1 * u.mas
    )
    x = np.full((1, 5), 31.0)
    x[0, 2] = np.nan
    full = inject(cube, FeaturePaths(x, 0 * x + 20, x > 0), 5.0, fwhm=0.8 * u.mas)
    np.testing.assert_array_equal(full.mask, cube.mask)
    np.testing.assert_array_equal(full.data[2], cube.data[2])
    assert full.data[0, 20, 29] > cube.data[0, 20, 29] + 3
    assert full.times is cube.times or np.all(full.times == cube.times)
    assert full.meta["history"][-1] == "1 simulated features added"
    assert "simulated" not in str(cube.meta)


def test_a_cube_without_beams_needs_a_width():
    cube = cube_of()
    paths = FeaturePaths(
        np.full((1, 5), 9.0), np.full((1, 5), 9.0), np.ones((1, 5), bool)
    )
    with pytest.raises(ValueError, match="has no beams: give fwhm, the full width"):
        inject(cube, paths, 1.0)
    row = inject(cube, paths, 1.0, fwhm=0.8 * u.mas).data[0, 9]
    assert row[9] == pytest.approx(1.0)
    assert row[13] == pytest.approx(0.5)


@examples(max_examples=25, deadline=None)
@given(
    angle=st.floats(0, 360),
    turn=st.floats(-90, 90),
    speed=st.floats(0.01, 3),
    seed=st.integers(0, 2**32),
)
def test_features_move_at_the_speed_in_the_direction(angle, turn, speed, seed):
    cube = cube_of(angle=turn, sides=(0.1, 0.15))
    paths = draw_paths(
        cube, box(cube), speed=speed * u.mas / u.yr, position_angle=angle * u.deg,
        n_features=5, rng=seed,
    )  # fmt: skip
    pixels = np.stack([paths.x - paths.x[:, :1], paths.y - paths.y[:, :1]])
    sky = np.einsum("ij,jne->ine", cube.pixel_matrix.value, pixels)
    direction = np.array([np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle))])
    expected = speed * direction[:, None] * cube.years.value
    np.testing.assert_allclose(
        sky, np.broadcast_to(expected[:, None], sky.shape), atol=1e-6
    )
    assert paths.inside.any(axis=1).all()
    assert 5 <= paths.inside.sum(axis=0).mean() + 1e-6 < 6.01


def test_radial_features_leave_the_reference_pixel():
    cube = cube_of()
    paths = draw_paths(
        cube, box(cube), speed=2 * u.mas / u.yr, position_angle="radial",
        n_features=200, rng=1,
    )  # fmt: skip
    x0, y0 = cube.reference_pixel
    distance = np.hypot(paths.x - x0, paths.y - y0) * 0.1
    gone = np.isnan(distance)
    # None before it was sent off, and none comes back.
    assert gone.any()
    assert not np.any(gone[:, 1:] & ~gone[:, :-1])
    assert not np.any(gone & paths.inside)
    rate = np.diff(distance, axis=1) / np.diff(cube.years.value)
    np.testing.assert_allclose(rate[np.isfinite(rate)], 2.0, rtol=1e-6)


def test_an_area_without_pixels_holds_no_feature():
    cube = cube_of()
    with pytest.raises(ValueError, match="area for features holds no pixel"):
        draw_paths(
            cube, box(cube, slice(0, 0)), speed=1 * u.mas / u.yr,
            position_angle=0 * u.deg,
        )  # fmt: skip


#: One feature that stays at (50, 20) in both epochs.
PATHS = FeaturePaths(
    np.full((1, 2), 50.0), np.full((1, 2), 20.0), np.ones((1, 2), bool)
)
RULE = {"tolerance": 1.0, "level": 0.05, "paths": PATHS, "fwhm": 1.0}


def result(*components):
    """Of components (kind, p, v1, v2, share of ten SSPs that lie on the feature)."""
    kinds, p, v1, v2, shares = zip(*components, strict=True) if components else [()] * 5
    n = len(kinds)
    x = [50.0 + 4 if k < round(10 * s) else 50.0 + 6 for s in shares for k in range(10)]
    return SimpleNamespace(
        components=QTable(
            {
                "component": np.arange(1, n + 1),
                "kind": np.array(kinds, dtype="U15"),
                "p_global": np.array(p, dtype=float),
            }
        ),
        velocities=[
            SimpleNamespace(value=np.array(v)) for v in zip(v1, v2, strict=True)
        ],
        members=lambda number: {"ssp": np.arange(10 * (number - 1), 10 * number)},
        matched=SimpleNamespace(
            ssps=SimpleNamespace(
                x=np.array(x), y=np.full(10 * n, 20.0), epoch=np.arange(10 * n) % 2
            )
        ),
        cube=SimpleNamespace(pixel_matrix=np.diag([-0.1, 0.1]) * u.mas),
    )


def test_a_moving_component_of_the_features_is_found():
    assert recovered(result(("moving", 0.01, 5.2, 0.3, 0.9)), [], (5, 0), **RULE) == 1


@pytest.mark.parametrize(
    "component",
    [
        ("not significant", 0.2, 5.0, 0.0, 1.0),
        ("stationary", 0.01, 5.0, 0.0, 1.0),
        ("moving", 0.06, 5.0, 0.0, 1.0),
        ("moving", 0.01, 5.8, 0.7, 1.0),
        ("moving", 0.01, 5.0, 0.0, 0.5),
    ],
)
def test_anything_else_is_not(component):
    assert recovered(result(component), [], (5, 0), **RULE) is None


def test_nothing_is_found_where_nothing_is():
    assert moving_components(result(), 0.05) == []
    assert recovered(result(), [(5, 0)], (5, 0), **RULE) is None


def test_what_the_epochs_have_already_is_not_found():
    blend = result(("moving", 0.01, 5.0, 0.0, 1.0))
    assert recovered(blend, [(4.5, 0.0)], (5, 0), **RULE) is None
    # Of two, the one that is left.
    both = result(("moving", 0.01, 4.6, 0.0, 1.0), ("moving", 0.01, 5.4, 0.0, 1.0))
    assert recovered(both, [(4.5, 0.0)], (5, 0), **RULE) == 2
    # Another component takes nothing from it, and one takes one only.
    assert recovered(both, [(9.0, 0.0)], (5, 0), **RULE) in (1, 2)
    assert recovered(both, [(4.5, 0.0), (5.5, 0.0)], (5, 0), **RULE) is None


def test_the_nearest_of_the_features_counts():
    three = result(
        ("moving", 0.01, 5.1, 0.0, 0.2),
        ("moving", 0.01, 5.6, 0.0, 0.9),
        ("moving", 0.01, 4.7, 0.0, 0.9),
    )
    assert recovered(three, [], (5, 0), **RULE) == 3


def test_a_component_without_ssps_is_not_of_the_features():
    bare = result(("moving", 0.01, 5.0, 0.0, 1.0))
    bare.members = lambda number: {"ssp": np.empty(0, dtype=int)}
    assert recovered(bare, [], (5, 0), **RULE) is None


def test_the_direction_on_the_axes_of_frames():
    angle = 30 * u.deg
    np.testing.assert_allclose(velocity_along(SkyFrame(), angle), [0.5, 0.75**0.5])
    along = velocity_along(PositionAngleFrame(30 * u.deg), angle)
    np.testing.assert_allclose(along, [1, 0], atol=1e-12)
    np.testing.assert_array_equal(velocity_along(RadialFrame(), "radial"), [1, 0])
