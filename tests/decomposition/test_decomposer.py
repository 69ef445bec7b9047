# Licensed under a 3-clause BSD style license - see LICENSE.rst
import csv

import numpy as np
import pytest
from astropy.io import fits

from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.decomposition.noise import local_noise, plane_noise, propagated_noise
from astro_scc.decomposition.wavelet import wavelet_planes


def scene(seed=0, shape=(64, 96), n=6, noise=0.005):
    """A few Gaussians of 8 pixels with white noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    image = rng.normal(scale=noise, size=shape)
    for _ in range(n):
        py, px = rng.uniform(12, shape[0] - 12), rng.uniform(12, shape[1] - 12)
        image += rng.uniform(0.3, 1) * np.exp(
            -((x - px) ** 2 + (y - py) ** 2) / (2 * 3.4**2)
        )
    return image


@pytest.mark.parametrize("value", [0.0, 1.0, -2.5e9, 0.1])
@pytest.mark.parametrize("noise", ["plane", "local"])
def test_nothing_in_a_constant_image(value, noise):
    image = np.full((64, 64), value)
    decompose = Decomposer(noise=noise)
    assert len(decompose(image).ssps) == 0
    holes = np.random.default_rng(0).random(image.shape) < 0.3
    assert len(decompose(image, mask=holes).ssps) == 0
    assert len(decompose(np.where(holes, np.nan, image)).ssps) == 0


def test_planes_noise_and_segments():
    image = scene()
    decomposition = Decomposer(scales=(2, 1, 1.5, 1))(image)
    assert decomposition.scales == (1.0, 1.5, 2.0)
    assert decomposition.planes.dtype == np.float32
    planes = wavelet_planes(image, decomposition.scales)
    np.testing.assert_allclose(decomposition.planes, planes, atol=1e-6)
    for plane, scale, noise in zip(
        planes, decomposition.scales, decomposition.noise, strict=True
    ):
        assert noise == pytest.approx(plane_noise(plane, scale))
    assert repr(decomposition).startswith("<Decomposition of 96 x 64 px: <SSPs: ")
    assert decomposition.mask is None
    ssps = decomposition.ssps
    assert (np.diff(ssps.scale) >= 0).all()
    for scale in decomposition.scales:
        labels = decomposition.segmentation(scale)
        own = np.flatnonzero(ssps.scale == scale)
        assert set(np.unique(labels)) == {0, *(own + 1)}
        segmented = decomposition.segmented_plane(scale)
        plane = decomposition.planes[decomposition.plane_index(scale)]
        np.testing.assert_array_equal(segmented, np.where(labels > 0, plane, 0))
        assert segmented.dtype == np.float32
    assert not decomposition.segmentation(3).any()
    with pytest.raises(ValueError, match="not in tuple"):
        decomposition.plane_index(3)


def test_kinds_of_noise():
    image = scene()
    local = Decomposer(scales=(1, 2), noise="local")(image)
    planes = wavelet_planes(image, (1, 2))
    assert local.noise[0].shape == image.shape
    np.testing.assert_allclose(local.noise[1], local_noise(planes[1], 2), rtol=1e-6)
    covariance = [[9, 1], [1, 4]]
    propagated = Decomposer(scales=(1, 2), noise="propagated", kernel="b3")(
        image, rms=0.005, beam_covariance=covariance
    )
    np.testing.assert_allclose(
        propagated.noise,
        propagated_noise(0.005, (1, 2), beam_covariance=covariance, kernel="b3"),
    )


def test_masked_and_missing_pixels():
    image = scene()
    mask = np.zeros(image.shape, dtype=bool)
    mask[20:30, 40:60] = True
    nan = np.zeros(image.shape, dtype=bool)
    nan[50, 10] = nan[5, 80] = True
    decomposition = Decomposer(scales=(1, 2))(np.where(nan, np.nan, image), mask=mask)
    np.testing.assert_array_equal(decomposition.mask, mask | nan)
    assert np.isfinite(decomposition.planes).all()
    assert (decomposition.planes[:, mask | nan] == 0).all()
    assert len(decomposition.ssps)
    assert not (mask | nan).flat[decomposition.ssps.pixels].any()
    assert np.isfinite(decomposition.ssps.x).all()
    # Far from the mask nothing is different.
    far = Decomposer(scales=(1, 2))(image)
    np.testing.assert_allclose(
        decomposition.planes[:, :, 88:], far.planes[:, :, 88:], atol=1e-6
    )


IMAGE = np.zeros((16, 16))


@pytest.mark.parametrize(
    ("settings_", "image", "message"),
    [
        ({"scales": ()}, {}, "at least one wavelet scale"),
        ({"scales": (1.3,)}, {}, "not a number of the series"),
        ({"scales": (1.5,), "kernel": "b3"}, {}, "kernel 'b1' only"),
        ({"kernel": "db2"}, {}, "unknown wavelet kernel"),
        ({"noise": "mad"}, {}, "must be one of plane, local, propagated"),
        ({"detection": 2}, {}, "0 < segmentation <= detection"),
        ({"segmentation": 0}, {}, "0 < segmentation <= detection"),
        ({}, {"image": np.full((16, 16), np.nan)}, "no valid pixel"),
        ({}, {"mask": np.zeros((4, 4), bool)}, r"mask has shape \(4, 4\)"),
        ({}, {"image": np.zeros((2, 16, 16))}, "two dimensions, this has 3"),
        *(
            ({"noise": "propagated"}, {"rms": rms}, "needs the rms of the image")
            for rms in (None, 0.0, -1.0, np.nan, np.inf)
        ),
    ],
)
def test_what_is_refused(settings_, image, message):
    with pytest.raises(ValueError, match=message):
        Decomposer(**{"scales": (1,), **settings_})(**{"image": IMAGE, **image})


@pytest.mark.parametrize("name", ["two_fluid", "two_fluid_dense", "random"])
def test_as_many_patterns_as_the_authors_program(shared_data, name):
    folder = shared_data / "paper_test" / name
    with (folder / "wise_ssps.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["in_roi"] == "1"]
    theirs = [sum(row["scale_px"] == str(2**j) for row in rows) for j in (1, 2, 3)]
    decompose = Decomposer(scales=(1, 2, 3))
    files = sorted(folder.glob("*.fits"))
    ssps = SSPs.of_epochs([decompose(fits.getdata(file).squeeze()) for file in files])
    region = (ssps.x >= 60) & (ssps.x <= 160)
    ours = [np.sum(region & (ssps.scale == j)) for j in (1, 2, 3)]
    np.testing.assert_allclose(ours, theirs, rtol=0.15)
