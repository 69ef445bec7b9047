# Licensed under a 3-clause BSD style license - see LICENSE.rst
import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from scipy import ndimage

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.components.restoring import correlated_noise
from astro_scc.decomposition import Decomposer
from astro_scc.decomposition.noise import plane_noise, propagated_noise, shared_variance
from astro_scc.decomposition.wavelet import wavelet_planes
from astro_scc.epochs import Beam
from astro_scc.exceptions import MeasurementWarning
from astro_scc.measurement.matched import allow_for_structure, decompose_epochs

# -- images without empty sky ------------------------------------------------------

BEAM = Beam(0.8 * u.mas, 0.8 * u.mas)
SCALES = (1, 2, 3, 4)


def cube_of(images, **facts):
    """Epochs 0.2 yr apart, with pixels of 0.1 mas."""
    dates = Time(2000 + 0.2 * np.arange(len(images)), format="jyear")
    return EpochCube.from_arrays(
        np.array(images), dates,
        pixel_scale=0.1 * u.mas, **facts,
    )  # fmt: skip


def power_law(slope, shape, rng):
    """A Gaussian field, unit variance, power falling as k^-slope, of a beam of 3 px."""
    k = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1]))
    k[0, 0] = np.inf
    spectrum = k ** (-slope / 2) * np.exp(-2 * (np.pi * 1.3 * k) ** 2)
    field = np.fft.irfft2(np.fft.rfft2(rng.normal(size=shape)) * spectrum, s=shape)
    return field / field.std()


def textured(kind, *, noise=0.1, step=2.3, n_epochs=5, shape=(128, 128), **facts):
    """A texture that fills the images and moves along x, with noise of its own."""
    rng = np.random.default_rng(0)
    if kind == "smooth":
        field = ndimage.gaussian_filter(rng.normal(size=shape), 2, mode="wrap")
        field /= field.std()
    else:
        field = power_law(kind, shape, rng)
    return cube_of(
        [
            ndimage.shift(field, (0, step * k), order=3, mode="grid-wrap")
            + rng.normal(0, noise, shape)
            for k in range(n_epochs)
        ],
        **facts,
    )


def noise_of(kind, n_epochs=4, shape=(128, 128)):
    rng = np.random.default_rng(3)
    if kind == "white":
        return cube_of(rng.normal(size=(n_epochs, *shape)))
    images = [
        correlated_noise(shape, rms=1, beam=BEAM, pixel_scale=0.1 * u.mas, rng=rng)
        for _ in range(n_epochs)
    ]
    return cube_of(images, beams=BEAM if kind == "beam" else None)


def quiet(cube, decomposer):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return allow_for_structure(cube, decomposer) is decomposer


@pytest.mark.parametrize("kind", ["white", "beam", "beam that nobody knows"])
def test_noise_is_noise(kind):
    assert quiet(noise_of(kind), Decomposer(scales=SCALES))


def test_what_is_not_measured_in_the_planes_is_as_it_was():
    cube = textured("smooth")
    assert quiet(cube, Decomposer(scales=[1, 2], noise="propagated"))
    assert quiet(cube[:1], Decomposer(scales=[1, 2]))


@pytest.mark.parametrize("kind", ["smooth", 2, 3])
@pytest.mark.parametrize("noise", ["plane", "local"])
def test_the_noise_of_a_texture_is_what_its_epochs_do_not_share(kind, noise):
    cube = textured(kind, noise=0.3)
    with pytest.warns(
        MeasurementWarning,
        match=r"^the images are full of structure on scale (1, )?2, 3: \d\d% or more "
        "of what looks like noise in one epoch is in others too and is not taken for "
        "noise; noise='propagated' takes the noise that the epochs are given instead$",
    ):
        allowed = allow_for_structure(cube, Decomposer(scales=[1, 2, 3], noise=noise))
    found = allowed(cube.data[0])
    # Somewhat more at the edges, where one has what the other has not.
    ratio = [np.mean(own) for own in found.noise] / propagated_noise(0.3, [1, 2, 3])
    assert np.all((ratio > 0.9) & (ratio < 3))
    assert len(found.ssps) > 20 * len(Decomposer(scales=[1, 2, 3])(cube.data[0]).ssps)


def test_only_scales_that_are_full_of_structure_are_changed():
    """A wide texture below noise that hides its finer parts."""
    wide = textured(3, noise=5.0, shape=(256, 256))
    with pytest.warns(MeasurementWarning, match="full of structure on scale 4: "):
        allowed = allow_for_structure(wide, Decomposer(scales=SCALES))
    assert allowed.noise_factors[:3] == (1, 1, 1)
    assert 0.3 < allowed.noise_factors[3] < 0.8


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["smooth", 3])
def test_a_texture_is_measured_and_said(kind, tmp_path):
    cube = textured(kind, shape=(64, 96), n_epochs=5)
    scc = StackedCrossCorrelation(scales=[2], max_speed=3 * u.mas / u.yr)
    for _ in "ab":
        # The second time from the file.
        with pytest.warns(MeasurementWarning, match="full of structure on scale 2: "):
            matched = scc.match(cube, cache=tmp_path / "m.fits")
    assert len(matched.ssps) > 80
    again = decompose_epochs(cube, matched.decomposer)[0]
    assert matched.decompositions[0].noise == again.noise
    assert np.sum(matched.ssps.epoch == 0) == len(again.ssps)
    row = scc.stack(matched, n_trials=40, rng=1).components[0]
    assert row["kind"] == "moving"
    # 2.3 px of 0.1 mas in 0.2 yr to the right, which is west.
    assert abs(row["pm_ra_cosdec"].value + 1.15) < 3 * row["pm_err"].value < 0.2


@pytest.mark.parametrize("zero", [0, 1])
def test_planes_of_nothing_share_nothing(zero):
    planes = np.random.default_rng(0).normal(size=(2, 32, 32))
    planes[zero] = 0
    assert shared_variance(planes, 1) == (0.0, np.inf)


@pytest.mark.parametrize("factors", [(1.0,), (0.5, 1.1), (-0.1, 1.0), (np.nan, 1.0)])
def test_factors_that_make_no_sense_are_refused(factors):
    with pytest.raises(ValueError, match="noise_factors must be a number from 0 to 1"):
        Decomposer(scales=[1, 2], noise_factors=factors)


def test_factors_are_of_the_noise_of_their_scale():
    image = np.random.default_rng(0).normal(size=(64, 64))
    plain = [plane_noise(w, j) for j, w in enumerate(wavelet_planes(image, (1, 2)), 1)]
    found = Decomposer(scales=[1, 2], noise_factors=[0.5, 1])(image)
    assert found.noise == pytest.approx([0.5 * plain[0], plain[1]], rel=1e-6)
