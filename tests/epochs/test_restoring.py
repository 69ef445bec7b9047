# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images of components, and noise that the beam correlates."""

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.time import Time
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from astro_scc.epochs import Beam, ComponentList, read_components, restore
from astro_scc.epochs.restoring import add_gaussians, correlated_noise
from astro_scc.exceptions import EpochWarning

PIXEL = 0.1 * u.mas
BEAM = Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg)
FLIP = np.diag([-1, 1])
UNITS = u.mas, u.mas, u.deg
JY_BEAM = u.Jy / u.beam


THREE = ComponentList(
    times=Time(["2006-01-01", "2006-07-01"]), epoch=[0, 0, 1],
    flux=[1.0, 0.5, 0.8] * u.Jy, east=[0.0, 2.0, 0.4] * u.mas,
    north=[0.0, 1.0, 0.2] * u.mas, major=[0.0, 0.8, 0.3] * u.mas,
    minor=[0.0, 0.4, 0.3] * u.mas, pa=[0.0, 60.0, 0.0] * u.deg,
)  # fmt: skip


def one(**changes):
    """One component at the origin."""
    place = {"east": [0.0] * u.mas, "north": [0.0] * u.mas, "flux": [2.0] * u.Jy}
    return ComponentList(times=Time(["2006-01-01"]), epoch=[0], **place | changes)


def restored(source, **options):
    return restore(source, **{"beam": BEAM, "pixel_scale": PIXEL, **options})


def moments(image):
    y, x = np.indices(image.shape)
    weight = image / image.sum()
    mean = np.array([(weight * x).sum(), (weight * y).sum()])
    d = np.stack([x - mean[0], y - mean[1]])
    return mean, np.einsum("iyx,yx,jyx->ij", d, weight, d)


@settings(max_examples=40, deadline=None)
@given(n=st.integers(0, 4), seed=st.integers(0, 1000))
def test_boxes_equal_the_literal_sum(n, seed):
    rng = np.random.default_rng(seed)
    x, y, peak = rng.uniform(-30, 60, n), rng.uniform(-30, 50, n), rng.normal(size=n)
    angle, width = rng.uniform(0, np.pi, n), rng.uniform(0.3, 12, n)
    axes = width[:, None] * np.stack([np.ones(n), rng.uniform(0.02, 1, n)], axis=1)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    covariance = np.einsum("ain,na,ajn->nij", turn.swapaxes(0, 1), axes**2,
                           turn.swapaxes(0, 1))  # fmt: skip
    fast = add_gaussians(np.zeros((21, 34)), x, y, peak, covariance)
    slow, (yy, xx) = np.zeros((21, 34)), np.indices((21, 34))
    for x0, y0, p, c in zip(x, y, peak, covariance, strict=True):
        d = np.stack([xx - x0, yy - y0])
        slow += p * np.exp(-0.5 * np.einsum("iyx,ij,jyx->yx", d, np.linalg.inv(c), d))
    assert_allclose(fast, slow, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("axes", [(0, 0, 0), (0.9, 0.3, 40)])
def test_flux_is_kept_and_covariances_add(axes):
    names = ("major", "minor", "pa")
    sizes = {k: [v] * x for k, v, x in zip(names, axes, UNITS, strict=True)}
    cube = restored(one(**sizes))
    pixels_a_beam = (BEAM.area / PIXEL**2).to_value(u.one)
    assert cube.data[0].sum() / pixels_a_beam == pytest.approx(2.0, rel=1e-6)
    total = BEAM.covariance
    if axes[0]:
        total = total + Beam(*(v[0] for v in sizes.values())).covariance
    mean, covariance = moments(cube.data[0])
    assert_allclose(mean, cube.reference_pixel, atol=1e-6)
    expected = FLIP @ (total / PIXEL**2).to_value(u.one) @ FLIP
    assert_allclose(covariance, expected, rtol=1e-4, atol=1e-3)
    assert (cube.unit, cube.beams, cube.noise) == (JY_BEAM, (BEAM,), None)


def test_grids():
    cube = restored(THREE)
    (x, y), (ny, nx) = cube.reference_pixel, cube.shape[1:]
    assert min(x - 20, nx - 1 - x, y, ny - 1 - y - 10) >= 40
    edges = cube.data[:, [0, -1]].ravel(), cube.data[:, :, [0, -1]].ravel()
    assert np.abs(np.concatenate(edges)).max() < 1e-12
    assert restored(one(), shape=(65, 81)).reference_pixel == (40, 32)
    with pytest.warns(EpochWarning, match="1 of 3 components lie outside"):
        restored(THREE, shape=(40, 20), reference_pixel=(5, 20))


def test_bad_options():
    for options, message in [
        ({"beam": [BEAM]}, "2 epochs need 2 beams, got 1"),
        ({"beam": None}, "needs a beam; give one"),
        ({"noise": 1 * u.mas}, "noise must be a Quantity in Jy / beam"),
        ({"pixel_scale": 0 * u.mas}, "pixel_scale = .* must be finite and above 0"),
        ({"pixel_scale": 1 * u.mas}, "a pixel of 1 mas is larger than the beam of"),
        ({"pixel_scale": 1e-5 * u.mas}, "give larger pixels"),
        ({"reference_pixel": (3, 3)}, "reference_pixel needs a shape; give both"),
    ]:
        with pytest.raises((ValueError, TypeError), match=message):
            restored(THREE, **options)


def test_restores_what_aips_restored(shared_data):
    path = min((shared_data / "0506+056").glob("*.fits"))
    image, header = fits.getdata(path).squeeze(), fits.getheader(path)
    beam = Beam(*(header[k] * u.deg for k in ("BMAJ", "BMIN", "BPA")))
    place = {"reference_pixel": (header["CRPIX1"] - 1, header["CRPIX2"] - 1)}
    how = place | {"shape": image.shape, "pixel_scale": header["CDELT2"] * u.deg}
    cube = restore(read_components(path), beam=beam, **how)
    # What remains is the residual image: 0.14 mJy, and no source.
    residual = image - cube.data[0]
    assert residual.std() < 2e-4
    assert np.abs(residual).max() < 0.01 * image.max()


def noises(n, beam, shape=(60, 80), rms=1.0):
    rng = np.random.default_rng(5)
    options = {"rms": rms, "beam": beam, "pixel_scale": PIXEL, "rng": rng}
    return np.array([correlated_noise(shape, **options) for _ in range(n)])


@settings(max_examples=8)
@given(
    shape=st.tuples(st.integers(1, 60), st.integers(1, 60)),
    major=st.floats(0.05, 1.5), ratio=st.floats(0.2, 1), pa=st.floats(-180, 180),
)  # fmt: skip
def test_rms_is_the_theoretical_one_everywhere(shape, major, ratio, pa):
    beam = Beam(major * u.mas, major * ratio * u.mas, pa * u.deg)
    noise = noises(200, beam, shape, rms=2.0)
    assert noise.shape == (200, *shape)
    # Edges included.
    for part in (noise, noise[:, :3], noise[:, :, -3:]):
        assert np.sqrt(np.mean(part**2)) == pytest.approx(2.0, rel=0.3)
