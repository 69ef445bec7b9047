# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features against the Gaussians and lines they are to be, and when they are found."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.epochs import Beam
from astro_scc.epochs.restoring import correlated_noise
from astro_scc.kinematics import RidgeLine
from astro_scc.recovery import completeness, draw_paths, inject

PM, WEST = u.mas / u.yr, 270 * u.deg
FAST = 10 * PM
QUICK = {"n_features": 8, "n_injections": 2, "n_trials": 199, "rng": 1}
#: Uneven, 20 to 45 days apart.
DATES = [f"2000-{k}" for k in "01-01 02-01 02-21 04-05 05-03 06-01 06-28".split()]
PIXEL = 0.1 * u.mas


@pytest.fixture(scope="module")
def sky():
    """Seven epochs of nothing but noise."""
    beam, rng = Beam(1 * u.mas, 1 * u.mas), np.random.default_rng(1)
    how = {"rms": 0.01, "beam": beam, "pixel_scale": PIXEL, "rng": rng}
    images = np.array([correlated_noise((48, 96), **how) for _ in DATES])
    fields = {"pixel_scale": PIXEL, "unit": u.Jy / u.beam, "beams": beam}
    return EpochCube.from_arrays(images, DATES, **fields)


@pytest.fixture(scope="module")
def settings():
    """One scale, along the jet to the west."""
    return StackedCrossCorrelation(scales=[2], max_speed=24 * PM, position_angle=WEST)


def test_a_strong_stream_is_found_and_one_below_the_noise_is_not(sky, settings):
    table = completeness(sky, settings, speeds=FAST, fluxes=[0.5, 100], **QUICK)
    assert table["n_found"].tolist() == [0, 2]
    assert table["fraction"].tolist() == [0.0, 1.0]


CORNER = np.add.outer(np.arange(48), np.arange(96)) < 20
RIDGE = RidgeLine([0, -5] * u.mas, [0, 0] * u.mas)
#: Changes of the cube, of the settings of the measurement and of the call, and words.
REFUSED = [
    ({}, {}, {"speeds": 0 * PM}, "speeds = 0.0 mas / yr must be .* positive"),
    ({}, {}, {"speeds": 30 * PM}, "speed 30 mas/yr is beyond .* 24 mas/yr: give"),
    ({}, {}, {"fluxes": 1 * u.K}, "fluxes = .* must be one or more positive numbers"),
    # Of 25 mas/yr, 23.5 are along the axis.
    ({}, {}, {"speeds": 25 * PM, "position_angle": 250 * u.deg, "n_injections": 0},
     "n_injections = 0 must be 1 or more"),
    ({}, {}, {"fwhm": 0 * u.mas}, "fwhm = 0.0 mas must be finite and above 0"),
    ({}, {}, {"n_workers": 0}, "n_workers = 0 must be 1 or more"),
    ({}, {}, {"scatter": -1}, "scatter must be zero or positive, got -1"),
    ({}, {}, {"n_trials": 98}, "98 trials allow no p_global below 0.01.*n_trials"),
    ({}, {}, {"tolerance": 1 * u.s}, "tolerance = 1.0 s must be"),
    ({}, {}, {"position_angle": "radial"}, "radial does not go with .*both 'radial'"),
    ({}, {"position_angle": None}, {}, "does not go with None of StackedC"),
    ({}, {"position_angle": RIDGE}, {}, "RidgeLine.*features move on straight"),
    ({"beams": None}, {}, {}, "has no beams: give fwhm"),
    ({"noise": np.zeros(7) * u.Jy / u.beam}, {}, {}, "noise need epochs with"),
    ({"mask": np.broadcast_to(CORNER, (7, 48, 96))}, {}, {"region": CORNER},
     "region holds masked pixels only"),
    ("four", {}, {}, "4 epochs allow no p_global below 0.17, .* epochs or more$"),
    ({"times": Time(2000 + np.arange(7) // 2 + np.arange(7) % 2 / 99, format="jyear")},
     {}, {}, "7 epochs of which some are close .* below 0.028, .* more epochs$"),
]  # fmt: skip


@pytest.mark.parametrize(("cube", "axes", "changes", "words"), REFUSED)
def test_what_cannot_be_meant_is_refused(sky, settings, cube, axes, changes, words):
    sky = sky[:4] if cube == "four" else replace(sky, **cube)
    how = {"speeds": FAST, "fluxes": 5.0, **QUICK, **changes}
    with pytest.raises(ValueError, match=words):
        completeness(sky, replace(settings, **axes), **how)


YEARS = np.array([0.0, 0.3, 1.0, 1.2, 2.5])
BOX = np.zeros((40, 60), dtype=bool)
BOX[10:30, 5:55] = True


def cube_of(data=0.0, angle=0.0, ratio=1.0, **options):
    """Uneven dates, pixels that may be turned and oblong."""
    data = np.broadcast_to(data, (5, 40, 60)).copy()
    dates = Time(2000 + YEARS, format="jyear")
    cube = EpochCube.from_arrays(data, dates, pixel_scale=PIXEL, **options)
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    cube.wcs.wcs.pc = [[c, -s * ratio], [s, c * ratio]]
    return cube


def test_features_are_gaussians_of_each_epochs_beam():
    beams = [Beam((1 + k / 10) * u.mas, 0.5 * u.mas, 25 * k * u.deg) for k in range(5)]
    cube = cube_of(angle=20, ratio=1.3, beams=beams)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 60, (3, 5)), rng.uniform(0, 40, (3, 5))
    full = inject(cube, (x, y), 0.7)
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


def test_the_epochs_stay_as_they_are_and_without_beams_a_width_is_needed():
    data = np.random.default_rng(2).normal(size=(5, 40, 60))
    data[:, :, 30:34] = np.nan
    cube = cube_of(data)
    x = np.full((1, 5), 29.0)
    x[0, 2] = np.nan
    paths = x, 0 * x + 20
    with pytest.raises(ValueError, match="has no beams: give fwhm, the full width"):
        inject(cube, paths, 1.0)
    full = inject(cube, paths, 5.0, fwhm=0.8 * u.mas)
    np.testing.assert_array_equal(full.mask, cube.mask)
    np.testing.assert_array_equal(full.data[2], cube.data[2])
    more = full.data[0, 20] - cube.data[0, 20]
    assert more[[29, 25]] == pytest.approx([5.0, 2.5])
    assert full.meta["history"][-1] == "1 simulated features added"


@examples(max_examples=10)
@given(
    angle=st.floats(0, 360), turn=st.floats(-90, 90), speed=st.floats(0.01, 3),
    seed=st.integers(0, 2**32),
)  # fmt: skip
def test_features_move_at_the_speed_in_the_direction(angle, turn, speed, seed):
    cube = cube_of(angle=turn, ratio=1.5)
    how = {"position_angle": angle * u.deg, "n_features": 5, "rng": seed}
    paths = draw_paths(cube, BOX, speed=speed * PM, **how)
    pixels = paths - paths[:, :, :1]
    sky = np.einsum("ij,jne->ine", cube.pixel_matrix.value, pixels)
    direction = np.array([np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle))])
    expected = speed * direction[:, None, None] * cube.years.value
    np.testing.assert_allclose(sky - expected, 0, atol=1e-6)
    # Five are in the box on average, to the last of them.
    inside = (abs(paths[0] - 29.5) < 25) & (abs(paths[1] - 19.5) < 10)
    assert inside.any(axis=1).all()
    assert 5 <= inside.sum(axis=0).mean() + 1e-6 < 6.01


def test_radial_features_leave_the_reference_pixel():
    cube = cube_of()
    how = {"speed": 2 * PM, "position_angle": "radial", "n_features": 200, "rng": 1}
    paths = draw_paths(cube, BOX, **how)
    with pytest.raises(ValueError, match="area for features holds no pixel"):
        draw_paths(cube, BOX & False, **how)
    x0, y0 = cube.reference_pixel
    distance = np.hypot(paths[0] - x0, paths[1] - y0) * 0.1
    gone = np.isnan(distance)
    # None before it was sent off, and none comes back.
    assert gone.any()
    assert not np.any(gone[:, 1:] & ~gone[:, :-1])
    rate = np.diff(distance, axis=1) / np.diff(cube.years.value)
    np.testing.assert_allclose(rate[np.isfinite(rate)], 2.0, rtol=1e-6)
