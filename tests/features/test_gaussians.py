# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Gaussian models of images, the core, and shifts of whole epochs."""

import numpy as np
import pytest

from astro_scc.features.gaussians import _joined, _Samples, fit_gaussians

SHAPE = (80, 90)
BEAM = np.array([[25.0, 3.0], [3.0, 6.0]])  # elliptical and rotated


def sky(*components, beam=BEAM, shape=SHAPE):
    """Return the image of components: convolved peak, y, x, variance."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    image = np.zeros(shape)
    for peak, y0, x0, variance in components:
        inverse = np.linalg.inv(beam + variance * np.eye(2))
        offset = np.stack([y - y0, x - x0])
        square = np.einsum("iyx,ij,jyx->yx", offset, inverse, offset)
        image += peak * np.exp(-0.5 * square)
    return image


def beam_noise(rng, size=128):
    """Return noise of unit variance that is correlated as the beam."""
    ky, kx = np.meshgrid(*2 * [np.fft.fftfreq(size)], indexing="ij")
    k = np.stack([ky, kx])
    response = np.exp(-2 * np.pi**2 * np.einsum("iyx,ij,jyx->yx", k, BEAM, k))
    white = np.fft.fft2(rng.normal(size=(size, size)))
    noise = np.fft.ifft2(white * response).real / np.sqrt((response**2).mean())
    return noise[: SHAPE[0], : SHAPE[1]]


ONE = [(1.0, 30.3, 40.2, 4.0)]
TWO = [(1.0, 30.3, 40.2, 0.0), (0.3, 52.4, 60.7, 9.0)]
THREE = [*TWO, (0.1, 60.2, 25.8, 2.0)]


@pytest.mark.parametrize(
    ("components", "beam"), [(ONE, np.diag([9.0, 9.0])), (THREE, BEAM)]
)
def test_noiseless(components, beam):
    found = fit_gaussians(sky(*components, beam=beam), beam, 1e-3)
    peak, y, x, variance = np.array(components).T
    assert len(found) == len(components)
    np.testing.assert_allclose(found["y"], y, atol=1e-3)
    np.testing.assert_allclose(found["x"], x, atol=1e-3)
    np.testing.assert_allclose(found["peak"], peak, rtol=1e-3)
    size = np.sqrt(8 * np.log(2) * variance)
    np.testing.assert_allclose(found["size"], size, atol=0.05)
    wider = [np.linalg.det(beam + v * np.eye(2)) for v in variance]
    flux = peak * np.sqrt(wider / np.linalg.det(beam))
    np.testing.assert_allclose(found["flux"], flux, rtol=2e-3)


@pytest.mark.parametrize("variance", [0.0, 6.0])
def test_errors_of_positions(variance):
    rng = np.random.default_rng(2)
    image = sky((30.0, 40.3, 45.2, variance))
    pulls = []
    for _ in range(60):
        found = fit_gaussians(image + beam_noise(rng), BEAM, 1.0)
        k = np.argmax(found["peak"])
        pulls.append((found["y"][k] - 40.3) / found["y_err"][k])
        pulls.append((found["x"][k] - 45.2) / found["x_err"][k])
    # 120 pulls have a standard deviation within 7% of its true value.
    assert 0.8 < np.std(pulls) < 1.2
    assert abs(np.mean(pulls)) < 0.3


@pytest.mark.parametrize("noise", [1e-30, 1e-9])
def test_images_without_noise(noise):
    """Simulations, and components that are restored without noise."""
    found = fit_gaussians(sky(*THREE), BEAM, noise)
    with_some = fit_gaussians(sky(*THREE), BEAM, 1e-3)
    np.testing.assert_allclose(found["y"][:3], with_some["y"], atol=0.01)
    assert np.all(found["peak"][3:] < 1e-3)


@pytest.mark.parametrize("bad", [np.nan, -1e6])
def test_missing_pixels_do_not_spread(bad):
    image = sky(*TWO)
    mask = np.zeros(SHAPE, dtype=bool)
    mask[28:31, 43:46] = mask[70:, :10] = True
    image[mask] = bad
    found = fit_gaussians(image, BEAM, 1e-3, mask=mask & np.isfinite(bad))
    assert len(found) == 2
    np.testing.assert_allclose(found["y"], [30.3, 52.4], atol=1e-3)
    np.testing.assert_allclose(found["x"], [40.2, 60.7], atol=1e-3)


def test_noise_alone_has_no_components_and_a_spike_few():
    rng = np.random.default_rng(5)
    found = [len(fit_gaussians(beam_noise(rng), BEAM, 1.0)) for _ in range(20)]
    assert sum(found) == 0
    # Narrower than the beam, and a tiny image: no failure.
    image = np.zeros(SHAPE)
    image[5, 5] = 1.0
    assert len(fit_gaussians(image, BEAM, 1e-3)) <= 20
    # Components without flux have no moments.
    none = np.array([[0.0, 30, 40, 0, 0, 0], [0.0, 31, 41, 0, 0, 0]])
    samples = _Samples(100 * sky(*ONE), np.ones(SHAPE, dtype=bool), BEAM)
    assert len(_joined(none, samples, 1.0)[0]) == 2
    assert len(fit_gaussians(np.ones((2, 3)), BEAM, 1e-3)) <= 6


def test_the_core_is_the_nearest_of_each_epoch(series):
    d = series([(0, 0.2, 0), (0, 0.1, 0), (1, 0.3, 0), (2, 3, 0), (2, 0.0, -0.25)])
    assert d.core(0.25).tolist() == [False, True, False, False, True]
    assert d.core(0.0).tolist() == [False] * 5
    empty = d.select(np.zeros(5, dtype=bool))
    assert empty.core(0.25).shape == (0,)
    assert len(empty.aligned()) == 0


def test_distances_are_in_widths_of_a_turned_beam(series):
    angle = np.radians(30)
    long, short = (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))
    turn = np.array([long, short])
    beam = turn.T @ np.diag([4.0, 0.25]) @ turn / (8 * np.log(2))
    d = series([(0, *long), (0, *short), (0, 1, 0)], beam=beam)
    distance = np.hypot(*d.in_beams.T)
    assert distance[:2] == pytest.approx([0.5, 2])
    assert distance[2] == pytest.approx(np.hypot(np.cos(angle) / 2, np.sin(angle) * 2))
    assert d.fwhm == pytest.approx(1)
    assert d.major == pytest.approx(2)
    # The core is the nearest in beams, not in mas.
    near = series([(0, 0.6 * long[0], 0.6 * long[1]), (0, *np.multiply(0.4, short))],
                  beam=beam)  # fmt: skip
    assert near.core(1.0).tolist() == [True, False]


def test_common_shifts_are_removed(series):
    """Of a core and a feature at 3 mas, so small that the core stays nearest."""
    shift = np.random.default_rng(1).normal(0, 0.2, (20, 2)).clip(-0.45, 0.45)
    places = [((0, 0), (3 + 0.1 * t, 0)) + own for t, own in enumerate(shift)]
    d = series([(t, *row) for t in range(20) for row in places[t]]).aligned()
    np.testing.assert_allclose(d.place[::2], 0, atol=1e-12)
    np.testing.assert_allclose(d.place[1::2, 0], 3 + 0.1 * np.arange(20))
    np.testing.assert_allclose(d.place[1::2, 1], 0, atol=1e-12)
    assert d.aligned() is d
