# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What is compact is removed, and nothing else."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc import EpochCube
from astro_scc.expansion import remove_compact

WIDTH = 5 * u.arcsec


def gaussian(shape, x, y, fwhm):
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return np.exp(-4 * np.log(2) * ((columns - x) ** 2 + (rows - y) ** 2) / fwhm**2)


def cube_of(*images, **kwargs):
    times = [f"20{10 + k}-01-01" for k in range(len(images))]
    return EpochCube.from_arrays(
        np.array(images), times, pixel_scale=1 * u.arcsec, **kwargs
    )


@pytest.fixture(scope="module")
def parts():
    """A broad cloud, and small features on and beside it."""
    shape = 100, 110
    broad = 300 * gaussian(shape, 50, 45, 24) + 20
    small = sum(
        200 * gaussian(shape, x, y, fwhm)
        for x, y, fwhm in ((52, 47, 4), (64, 36, 4.5), (90, 80, 3))
    )
    noise = np.random.default_rng(1).normal(0, 4, shape)
    return broad, small, noise


def test_small_features_go(parts):
    broad, small, noise = parts
    smooth = remove_compact(cube_of(broad + small + noise), WIDTH)
    left = smooth.data[0] - broad
    near = small > 0.5
    # Of 200 units at the maxima little more than the noise is left ...
    assert np.abs(left[near]).max() < 25
    # ... and of their flux less than a tenth.
    assert abs((left - noise)[near].sum()) < 0.1 * small.sum()
    assert "replaced by what surrounds them" in smooth.meta["history"][-1]


@pytest.mark.parametrize(("amplitude", "noise"), [(1, 0.0), (1, 1e-3), (1e-9, 1e-12)])
def test_broad_features_stay(amplitude, noise):
    broad = gaussian((100, 100), 50, 45, 16)
    image = broad + np.random.default_rng(1).normal(0, 1e-3, broad.shape) * (noise > 0)
    cube = cube_of(image * amplitude)
    np.testing.assert_array_equal(remove_compact(cube, WIDTH).data, cube.data)


def test_the_scale_of_the_images_does_not_matter(parts):
    image = sum(parts)
    one, other = remove_compact(cube_of(image, 1e-9 * image), WIDTH).data
    np.testing.assert_allclose(other, 1e-9 * one, rtol=1e-6)


def test_masked_pixels(parts):
    broad, small, noise = parts
    image = broad + small + noise
    mask = np.zeros(image.shape, dtype=bool)
    mask[30:60, 70:72] = True
    holed = np.where(mask, np.nan, image)
    smooth = remove_compact(cube_of(holed, mask=mask[None]), WIDTH)
    np.testing.assert_array_equal(smooth.mask[0], mask)
    rest = (smooth.data[0] - broad)[~mask]
    assert np.all(np.isfinite(rest))
    assert np.abs(rest[(small > 0.5)[~mask]]).max() < 25


def test_a_feature_at_the_edge_is_filled_from_one_side():
    slope = np.add.outer(np.zeros(60), np.linspace(0, 50, 80))
    image = slope + 200 * gaussian(slope.shape, 1, 30, 4)
    smooth = remove_compact(cube_of(image), 4 * u.arcsec)
    assert np.abs(smooth.data[0] - slope).max() < 0.06 * 200


@pytest.mark.parametrize("width", [0 * u.arcsec, [4, 5] * u.arcsec, np.nan * u.arcsec])
def test_a_width_is_one_angle(width):
    with pytest.raises(ValueError, match="must be one positive angle"):
        remove_compact(cube_of(np.ones((60, 60))), width)


def test_a_width_is_small():
    cube = cube_of(np.ones((60, 60)))
    with pytest.raises(ValueError, match="give a smaller width"):
        remove_compact(cube, 7 * u.arcsec)
    with pytest.raises(u.UnitConversionError):
        remove_compact(cube, 3 * u.m)
