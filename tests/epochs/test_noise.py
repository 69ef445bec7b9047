# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.components.restoring import correlated_noise
from astro_scc.epochs import Beam

PIXEL = 0.1 * u.mas
BEAM = Beam(1 * u.mas, 1 * u.mas)


def cubes(n, beam, shape=(60, 80), rms=1.0):
    rng = np.random.default_rng(5)
    return np.array(
        [
            correlated_noise(shape, rms=rms, beam=beam, pixel_scale=PIXEL, rng=rng)
            for _ in range(n)
        ]
    )


@pytest.mark.parametrize(
    "beam",
    [BEAM, Beam(1.5 * u.mas, 0.4 * u.mas, 30 * u.deg), Beam(PIXEL / 2, PIXEL / 2)],
    ids=["round", "elongated", "unresolved"],
)
def test_rms_is_the_theoretical_one_everywhere(beam):
    noise = cubes(400, beam, rms=2.0)
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(2.0, rel=0.02)
    # Edges included: nothing of the Fourier grid is seen.
    for part in (noise[:, :3], noise[:, :, -3:]):
        assert np.sqrt(np.mean(part**2)) == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("lag", [3, 6, 10])
def test_correlation_is_that_of_white_noise_seen_with_the_beam(lag):
    noise = cubes(300, BEAM)
    expected = np.exp(-4 * np.log(2) * lag**2 / (2 * 10**2))
    along_x = np.mean(noise[:, :, :-lag] * noise[:, :, lag:])
    along_y = np.mean(noise[:, :-lag] * noise[:, lag:])
    assert along_x == pytest.approx(expected, abs=0.03)
    assert along_y == pytest.approx(expected, abs=0.03)


def test_elongated_along_the_beam():
    # Towards north-east: up and to the left.
    noise = cubes(200, Beam(1.5 * u.mas, 0.4 * u.mas, 45 * u.deg))
    up_left = np.mean(noise[:, :-5, 5:] * noise[:, 5:, :-5])
    up_right = np.mean(noise[:, :-5, :-5] * noise[:, 5:, 5:])
    # Exponents d^2 / (2 * 2 sigma^2) of d^2 = 50 px^2.
    assert up_left == pytest.approx(
        np.exp(-50 / 4 / (15 / np.sqrt(8 * np.log(2))) ** 2), abs=0.05
    )
    assert up_right == pytest.approx(
        np.exp(-50 / 4 / (4 / np.sqrt(8 * np.log(2))) ** 2), abs=0.05
    )


def test_opposite_edges_are_independent():
    noise = cubes(600, BEAM, shape=(20, 20))
    assert abs(np.mean(noise[:, 0] * noise[:, -1])) < 0.06


def test_white_noise_without_a_beam():
    noise = correlated_noise((200, 200), rms=3.0, rng=1)
    assert noise.std() == pytest.approx(3.0, rel=0.02)
    assert abs(np.mean(noise[:, 1:] * noise[:, :-1])) < 0.1


def test_unit_and_seed():
    options = {"beam": BEAM, "pixel_scale": PIXEL}
    one = correlated_noise((8, 9), rms=2 * u.mJy, rng=3, **options)
    assert one.unit == u.mJy
    again = correlated_noise(
        (8, 9), rms=2 * u.mJy, rng=np.random.default_rng(3), **options
    )
    assert np.array_equal(one.value, again.value)
    arcsec = correlated_noise(
        (8, 9), rms=2 * u.mJy, rng=3, beam=BEAM, pixel_scale=1e-4 * u.arcsec
    )
    np.testing.assert_allclose(one.value, arcsec.value)


def test_no_noise():
    assert not correlated_noise((8, 9), rms=0, beam=BEAM, pixel_scale=PIXEL).any()


@pytest.mark.parametrize("rms", [-1.0, np.nan, np.inf, [1.0, 2.0]])
def test_bad_rms(rms):
    with pytest.raises(ValueError, match="rms must be"):
        correlated_noise((8, 9), rms=rms)


def test_beam_without_pixels():
    with pytest.raises(ValueError, match="needs pixel_scale"):
        correlated_noise((8, 9), rms=1, beam=BEAM)


@pytest.mark.parametrize("pixel", [0 * u.mas, -1 * u.mas, np.nan * u.mas])
def test_bad_pixels(pixel):
    with pytest.raises(ValueError, match="pixel_scale = .* must be finite and above 0"):
        correlated_noise((8, 9), rms=1, beam=BEAM, pixel_scale=pixel)


@settings(max_examples=30, deadline=None)
@given(
    ny=st.integers(1, 40),
    nx=st.integers(1, 40),
    major=st.floats(0.05, 3),
    ratio=st.floats(0.05, 1),
    pa=st.floats(-180, 180),
)
def test_always_of_the_right_shape_and_finite(ny, nx, major, ratio, pa):
    beam = Beam(major * u.mas, major * ratio * u.mas, pa * u.deg)
    noise = correlated_noise((ny, nx), rms=1, beam=beam, pixel_scale=PIXEL, rng=1)
    assert noise.shape == (ny, nx)
    assert np.all(np.isfinite(noise))
