# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest

from astro_scc.components.restoring import correlated_noise
from astro_scc.decomposition import Decomposer
from astro_scc.decomposition.noise import local_noise, plane_noise, propagated_noise
from astro_scc.decomposition.wavelet import wavelet_planes
from astro_scc.epochs import Beam
from astro_scc.simulation import simulate_two_fluid

SCALES = (1, 2, 3, 4)
RMS = 0.002
BEAM = Beam(1 * u.mas, 1 * u.mas)  # full width of 10 pixels of 0.1 mas
COVARIANCE = np.eye(2) * (10 / np.sqrt(8 * np.log(2))) ** 2


def beam_noise(seed, shape=(128, 256), beam=BEAM, rms=RMS):
    return correlated_noise(
        shape, rms=rms, beam=beam, pixel_scale=0.1 * u.mas, rng=seed
    )


@pytest.mark.parametrize("kernel", ["b1", "b3"])
def test_propagated_white_noise_equals_measured(kernel):
    images = np.random.default_rng(1).normal(size=(4, 256, 256))
    planes = np.stack([wavelet_planes(i, SCALES, kernel=kernel) for i in images])
    measured = np.sqrt((planes**2).mean(axis=(0, 2, 3)))
    expected = propagated_noise(1.0, SCALES, kernel=kernel)
    assert (np.abs(measured / expected - 1) < [0.01, 0.02, 0.03, 0.06]).all()


def test_propagated_noise_equals_the_textbook():
    """Factors of the cubic spline (Starck & Murtagh 2006, Table 2.1)."""
    np.testing.assert_allclose(
        propagated_noise(1.0, [0, 1, 2, 3, 4], kernel="b3"),
        [0.890, 0.201, 0.086, 0.042, 0.021],
        atol=0.002,
    )


@pytest.mark.parametrize("kernel", ["b1", "b3"])
@pytest.mark.parametrize(
    "beam", [BEAM, Beam(1.2 * u.mas, 0.5 * u.mas, 30 * u.deg)], ids=["round", "long"]
)
def test_propagated_beam_noise_equals_measured(kernel, beam):
    images = [beam_noise(seed, (256, 256), beam) for seed in range(12)]
    planes = np.stack([wavelet_planes(i, SCALES, kernel=kernel) for i in images])
    # Away from the edges, where the slopes of the mirrored noise add power.
    planes = planes[..., 16:-16, 16:-16]
    measured = np.sqrt((planes**2).mean(axis=(0, 2, 3)))
    flip = np.diag([-1.0, 1.0])
    covariance = flip @ beam.covariance.to_value(u.mas**2) @ flip / 0.1**2
    expected = propagated_noise(RMS, SCALES, beam_covariance=covariance, kernel=kernel)
    assert (np.abs(measured / expected - 1) < [0.02, 0.02, 0.04, 0.08]).all()


def test_propagated_noise_between_whole_scales():
    sigma = propagated_noise(1.0, [1, 1.5, 2, 2.5, 3])
    assert (sigma > 0).all()
    white = np.random.default_rng(1).normal(size=(256, 256))
    measured = wavelet_planes(white, [1.5, 2.5]).std(axis=(1, 2))
    np.testing.assert_allclose(measured, sigma[[1, 3]], rtol=0.05)


def ratios(images, *, mask=None):
    """Measured over true noise of beam-correlated noise, (image, scale)."""
    expected = propagated_noise(RMS, SCALES, beam_covariance=COVARIANCE)
    return np.array(
        [
            [
                plane_noise(plane, scale, mask=mask)
                for plane, scale in zip(
                    wavelet_planes(image, SCALES, mask=mask), SCALES, strict=True
                )
            ]
            / expected
            for image in images
        ]
    )


def test_plane_noise_without_source():
    ratio = ratios([beam_noise(seed) for seed in range(12)])
    np.testing.assert_allclose(ratio.mean(axis=0), 1, atol=0.06)
    np.testing.assert_allclose(ratio, 1, atol=0.2)


@pytest.fixture(scope="module")
def jets():
    """Jets whose peak is about 2000 times their noise."""
    return np.concatenate(
        [simulate_two_fluid(rng=seed, n_epochs=2).cube.data for seed in range(10)]
    )


@pytest.mark.slow
def test_plane_noise_beside_a_bright_jet(jets):
    """
    The noise of a plane whose median coefficient is the jet's.

    On scale 4 the wavelets of the jet leave a tenth of 256 x 128 px, some
    ten independent patches of noise.
    """
    ratio = ratios(jets)
    assert (np.abs(ratio.mean(axis=0) - 1) < [0.06, 0.06, 0.08, 0.12]).all()
    assert (ratio.std(axis=0) < [0.08, 0.08, 0.08, 0.3]).all()


def test_plane_noise_where_the_source_fills_most_of_the_image():
    """More than half of the pixels are source: the median alone would be it."""
    rng = np.random.default_rng(2)
    plane = rng.normal(size=(128, 128))
    plane[:, :80] += 1e4 * rng.normal(size=(128, 80))
    assert 1.4826 * np.median(np.abs(plane)) > 1000
    assert plane_noise(plane, 1) == pytest.approx(1, abs=0.1)


def test_plane_noise_without_any_sky_is_that_of_all_pixels():
    """Every pixel is within a scale of some source."""
    plane = np.random.default_rng(0).normal(size=(64, 64))
    plane[::8, ::8] = 1e3
    assert plane_noise(plane, 4) == pytest.approx(
        1.4826 * np.median(np.abs(plane)), rel=1e-4
    )


def test_blanked_pixels_do_not_count():
    """CLEAN maps are exactly zero outside the field: their MAD is 0."""
    plane = np.zeros((128, 128))
    plane[:60, :60] = np.random.default_rng(0).normal(size=(60, 60))
    assert np.median(np.abs(plane)) == 0
    assert plane_noise(plane, 1) == pytest.approx(1, abs=0.05)
    assert plane_noise(np.zeros((32, 32)), 1) == 0
    assert (local_noise(np.zeros((32, 32)), 1) == 0).all()


def test_masked_pixels_do_not_count():
    image = beam_noise(3)
    mask = np.zeros(image.shape, dtype=bool)
    mask[20:60, 30:200] = True
    # The transform is undisturbed by what the mask covers.
    np.testing.assert_array_equal(
        ratios([np.where(mask, 1e9, image)], mask=mask), ratios([image], mask=mask)
    )
    np.testing.assert_allclose(ratios([image], mask=mask), 1, atol=0.25)
    plane = np.random.default_rng(0).normal(size=(64, 64))
    plane[:, 32:] *= 1000
    mask = np.zeros(plane.shape, dtype=bool)
    mask[:, 32:] = True
    assert plane_noise(plane, 1, mask=mask) == pytest.approx(1, abs=0.1)
    assert plane_noise(plane, 1, mask=np.ones(plane.shape, bool)) == 0


@pytest.mark.parametrize(("scale", "tolerance"), [(1, 0.15), (2, 0.15), (3, 0.25)])
@pytest.mark.parametrize("beam", [None, BEAM], ids=["white", "beam"])
def test_local_noise_follows_a_gradient(scale, tolerance, beam):
    gradient = np.linspace(1, 4, 256)
    shape = (256, 256)
    covariance = None if beam is None else COVARIANCE
    (true,) = propagated_noise(1.0, [scale], beam_covariance=covariance)
    found = []
    for seed in range(3):
        image = correlated_noise(
            shape, rms=1.0, beam=beam, pixel_scale=0.1 * u.mas, rng=seed
        )
        (plane,) = wavelet_planes(image * gradient, [scale])
        found.append(local_noise(plane, scale))
    ratio = (np.mean(found, axis=0) / (true * gradient)).mean(axis=0)
    quarters = ratio.reshape(4, -1).mean(axis=1)
    np.testing.assert_allclose(quarters, 1, atol=tolerance)


def test_local_noise_of_scattered_pixels_is_constant():
    """Boxes with hardly a pixel tell nothing of a place."""
    rng = np.random.default_rng(0)
    plane, mask = rng.normal(size=(128, 128)), rng.random((128, 128)) < 0.95
    noise = local_noise(plane, 1, mask=mask)
    assert np.ptp(noise) == 0
    assert noise[0, 0] == plane_noise(plane, 1, mask=mask)
    assert noise[0, 0] == pytest.approx(1, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["plane", "local", "propagated"])
def test_false_positives_are_rare(noise):
    """Above 4 sigma, about one pattern in two images of pure noise."""
    decompose = Decomposer(noise=noise)
    images = [beam_noise(seed) for seed in range(5)]
    counts = [
        len(decompose(image, rms=RMS, beam_covariance=COVARIANCE).ssps)
        for image in images
    ]
    assert np.mean(counts) < 1.5
    brighter = Decomposer(noise=noise, detection=6, segmentation=5)
    assert (
        sum(
            len(brighter(image, rms=RMS, beam_covariance=COVARIANCE).ssps)
            for image in images
        )
        == 0
    )
