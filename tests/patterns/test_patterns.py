# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Decomposed epochs: noise and structure."""

import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from scipy import ndimage

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.decomposition import Decomposer
from astro_scc.decomposition.wavelet import propagated_noise
from astro_scc.epochs import Beam
from astro_scc.epochs.restoring import correlated_noise
from astro_scc.exceptions import MeasurementWarning
from astro_scc.patterns import allow_for_structure

BEAM = Beam(0.8 * u.mas, 0.8 * u.mas)
SCALES = (1, 2, 3, 4)


def cube_of(images):
    """Epochs 0.2 yr apart, with pixels of 0.1 mas."""
    dates = Time(2000 + 0.2 * np.arange(len(images)), format="jyear")
    return EpochCube.from_arrays(np.array(images), dates, pixel_scale=0.1 * u.mas)


def textured(slope, *, noise=0.1, n_epochs=5, shape=(128, 128)):
    """Gaussian fields that move by 2.3 px along x, smooth or of power k^-slope."""
    rng = np.random.default_rng(0)
    field = rng.normal(size=shape)
    if slope is None:
        field = ndimage.gaussian_filter(field, 2, mode="wrap")
    else:
        k = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
        k[0, 0] = np.inf
        spectrum = k ** (-slope / 2) * np.exp(-2 * (np.pi * 1.3 * k) ** 2)
        field = np.fft.irfft2(np.fft.rfft2(field) * spectrum, s=shape)
    field /= field.std()
    how = {"order": 3, "mode": "grid-wrap"}
    moved = (ndimage.shift(field, (0, 2.3 * k), **how) for k in range(n_epochs))
    return cube_of([image + rng.normal(0, noise, shape) for image in moved])


def noise_of(kind, n_epochs=4, shape=(128, 128)):
    rng = np.random.default_rng(3)
    if kind == "white":
        return cube_of(rng.normal(size=(n_epochs, *shape)))
    how = {"rms": 1, "beam": BEAM, "pixel_scale": 0.1 * u.mas, "rng": rng}
    return cube_of([correlated_noise(shape, **how) for _ in range(n_epochs)])


def quiet(cube, decomposer):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return allow_for_structure(cube, decomposer) is decomposer


@pytest.mark.parametrize("kind", ["white", "beam that nobody knows"])
def test_noise_is_noise(kind):
    assert quiet(noise_of(kind), Decomposer(scales=SCALES))
    # What is not measured in the planes, or has no other epoch, is as it was.
    cube = textured(None)
    assert quiet(cube, Decomposer(scales=[1, 2], noise="propagated"))
    assert quiet(cube[:1], Decomposer(scales=[1, 2]))


@pytest.mark.parametrize(("kind", "noise"), [(None, "local"), (3, "plane")])
def test_the_noise_of_a_texture_is_what_its_epochs_do_not_share(kind, noise):
    cube = textured(kind, noise=0.3)
    words = r"^the images are full of structure on scale (1, )?2, 3: \d\d% or more of"
    with pytest.warns(MeasurementWarning, match=words):
        allowed = allow_for_structure(cube, Decomposer(scales=[1, 2, 3], noise=noise))
    found = allowed(cube.data[0])
    # Somewhat more at the edges, where one has what the other has not.
    ratio = [np.mean(own) for own in found.noise] / propagated_noise(0.3, [1, 2, 3])
    assert np.all((ratio > 0.9) & (ratio < 3))
    assert len(found.ssps) > 20 * len(Decomposer(scales=[1, 2, 3])(cube.data[0]).ssps)


@pytest.mark.slow
def test_a_texture_is_measured_and_said():
    cube = textured(3, shape=(64, 96), n_epochs=6)
    cube = replace(cube, noise=np.full(6, 0.1) * cube.unit)
    scc = StackedCrossCorrelation(scales=[1, 2], max_speed=3 * u.mas / u.yr)
    with pytest.warns(MeasurementWarning, match="full of structure on scale 1, 2"):
        decomposed = scc.decompose(cube)
    assert len(decomposed.ssps) > 80
    row = scc.measure(decomposed, n_trials=119, rng=1).streams[0]
    assert row["kind"] == "moving"
    # 2.3 px of 0.1 mas in 0.2 yr to the right, which is west.
    assert abs(row["pm_ra_cosdec"].value + 1.15) < 3 * row["pm_err"].value < 0.2
