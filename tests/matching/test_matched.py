# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches: decomposed epochs, noise and structure, SSPs of a part, and files."""

import warnings
from dataclasses import fields, replace

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from scipy import ndimage

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.components.restoring import correlated_noise
from astro_scc.correlation.correlate import match_block
from astro_scc.decomposition import Decomposer
from astro_scc.decomposition.wavelet import propagated_noise
from astro_scc.epochs import Beam
from astro_scc.exceptions import MeasurementWarning
from astro_scc.matching import MatchedEpochs, select_ssps
from astro_scc.matching.matched import (
    allow_for_structure,
    centroids_inside,
)
from astro_scc.simulation import simulate_two_fluid

SCC = StackedCrossCorrelation(scales=[1, 2], max_speed=30 * u.mas / u.yr)

# -- images without empty sky ------------------------------------------------------

BEAM = Beam(0.8 * u.mas, 0.8 * u.mas)
SCALES = (1, 2, 3, 4)


def cube_of(images):
    """Epochs 0.2 yr apart, with pixels of 0.1 mas."""
    dates = Time(2000 + 0.2 * np.arange(len(images)), format="jyear")
    return EpochCube.from_arrays(np.array(images), dates, pixel_scale=0.1 * u.mas)


def textured(slope, *, noise=0.1, n_epochs=5, shape=(128, 128)):
    """
    A texture that fills the images and moves by 2.3 px along x, with noise of its own.

    It is a Gaussian field of unit variance; its power is smooth, or falls as k^-slope
    up to a beam of 3 px.
    """
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
    # On scales as large as the image, epochs share more than half of it by chance.
    small = cube_of(np.random.default_rng(1).normal(size=(2, 48, 48)))
    assert quiet(small, Decomposer(scales=(2, 3, 4)))
    # What is not measured in the planes, or has no other epoch, is as it was.
    cube = textured(None)
    assert quiet(cube, Decomposer(scales=[1, 2], noise="propagated"))
    assert quiet(cube[:1], Decomposer(scales=[1, 2]))


@pytest.mark.parametrize(("kind", "noise"), [(None, "local"), (3, "plane")])
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
def test_a_texture_is_measured_and_said(tmp_path):
    cube = textured(3, shape=(64, 96), n_epochs=6)
    cube = replace(cube, noise=np.full(6, 0.1) * cube.unit)
    scc = StackedCrossCorrelation(scales=[1, 2], max_speed=3 * u.mas / u.yr)
    for _ in "ab":
        # The second time from the file.
        with pytest.warns(MeasurementWarning, match="full of structure on scale 1, 2"):
            matched = scc.match(cube, cache=tmp_path / "m.fits")
    assert len(matched.ssps) > 80
    assert np.sum(matched.ssps.epoch == 0) == len(matched.decompositions[0].ssps)
    row = scc.measure(matched, n_trials=119, rng=1).streams[0]
    assert row["kind"] == "moving"
    # 2.3 px of 0.1 mas in 0.2 yr to the right, which is west.
    assert abs(row["pm_ra_cosdec"].value + 1.15) < 3 * row["pm_err"].value < 0.2


# -- decomposition and choice -------------------------------------------------------


def test_ssps_are_inside_if_their_centroid_is(matched):
    ssps, cube = matched.ssps, matched.cube
    assert centroids_inside(ssps, cube, None).all()
    region = np.zeros(cube.shape[1:], bool)
    region[:, 60:160] = True
    inside = centroids_inside(ssps, cube, region)
    x = np.rint(ssps.x_centroid)
    np.testing.assert_array_equal(inside, (x >= 60) & (x < 160))
    assert 0 < inside.sum() < len(ssps)


# -- files -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cube():
    return simulate_two_fluid(
        n_epochs=3, rng=3, shape=(48, 120), axis=24.0, extent=(10.0, 110.0)
    ).cube


@pytest.fixture(scope="module")
def made(cube):
    return SCC.match(cube)


@pytest.fixture
def counted(monkeypatch):
    """How many blocks were correlated."""
    blocks = []

    def count(block):
        blocks.append(block)
        return match_block(block)

    monkeypatch.setattr("astro_scc.correlation.correlate.match_block", count)
    # A block for each epoch.
    monkeypatch.setattr("astro_scc.correlation.correlate.BLOCK_WORK", 1)
    return blocks


def same(one, other):
    np.testing.assert_equal(vars(one.matches), vars(other.matches))
    for own in fields(one.ssps):
        a, b = getattr(one.ssps, own.name), getattr(other.ssps, own.name)
        np.testing.assert_array_equal(a, b)
        assert a.dtype == b.dtype, own.name
    np.testing.assert_array_equal(one.select, other.select)
    assert one.scales == other.scales


def test_round_trip(made, cube, tmp_path):
    made.write(tmp_path / "m.fits")
    read = MatchedEpochs.read(tmp_path / "m.fits", cube)
    same(made, read)
    with pytest.raises(FileExistsError):
        made.write(tmp_path / "m.fits")
    made.write(tmp_path / "m.fits", overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["m.fits"]


def test_dates_do_not_matter_but_images_and_versions_do(
    made, cube, tmp_path, monkeypatch
):
    """Each of those alone is in ``tests/robustness/test_stale.py``."""
    path = tmp_path / "m.fits"
    made.write(path)
    later = replace(cube, times=cube.times + 1 * u.yr)
    assert MatchedEpochs.read(path, later).cube.times[0] == later.times[0]
    with pytest.raises(ValueError, match="m.fits: is of other images, masks;"):
        MatchedEpochs.read(path, cube[:2])
    other = "astro_scc.matching.matched.versions", lambda: {"astro_scc": "0"}
    monkeypatch.setattr(*other)
    with pytest.raises(ValueError, match="is of other versions; match the epochs"):
        MatchedEpochs.read(path, cube)


def test_a_cache_is_used_when_only_the_stack_changes(cube, made, counted, tmp_path):
    path = tmp_path / "folder"
    same(made, SCC.match(cube, cache=path))
    assert len(counted) == len(cube)
    again = replace(SCC, alpha=0.5, position_angle=90 * u.deg)
    same(made, again.match(cube, cache=path))
    assert len(counted) == len(cube)
    (file,) = path.iterdir()
    # It is used by its own name, too.
    same(made, SCC.match(cube, cache=file))
    assert len(counted) == len(cube)
    # What cannot be read is made again.
    file.write_text("nothing")
    with pytest.warns(MeasurementWarning, match="cannot be read as astro_scc matches"):
        same(made, SCC.match(cube, cache=path))
    assert len(counted) == 2 * len(cube)


@pytest.mark.slow
def test_a_part_that_was_chosen_later_is_no_cache(made, cube, tmp_path):
    path = tmp_path / "m.fits"
    part = select_ssps(made, scales=[1])
    part.write(path)
    same(part, MatchedEpochs.read(path, cube))
    with pytest.warns(MeasurementWarning, match="other region"):
        same(made, SCC.match(cube, cache=path))
