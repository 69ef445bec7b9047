# Licensed under a 3-clause BSD style license - see LICENSE.rst
import numpy as np

from astro_scc.spectrum.planes import CLIP, flow_planes


def planes_of(images, noise=0.0, valid=None, mask=None, **how):
    valid = np.ones(images.shape, bool) if valid is None else valid
    mask = np.ones(images.shape[1:], bool) if mask is None else mask
    x, y = (np.arange(float(n)) for n in images.shape[1:])
    return flow_planes(
        images[None], valid, mask, np.array([noise]), along=x, across=y,
        years=np.arange(float(len(images))), scales=(1,), sizes=[1.0], **how,
    )  # fmt: skip


def test_what_stands_still_is_gone_and_no_unit_matters():
    rng = np.random.default_rng(1)
    images = rng.normal(size=(6, 30, 20))
    found = planes_of(images, 0.1)
    for other in (images + 5.0, 1e-9 * images, 1e6 * images):
        noise = 0.1 * np.abs(other - other.mean(0)).max()
        noise /= np.abs(images - images.mean(0)).max()
        assert np.allclose(planes_of(other, noise).values, found.values, atol=1e-4)
    assert np.abs(found.values.mean(axis=1)).max() < 0.05
    assert np.abs(found.values).max() <= CLIP


def test_noise_weighs_little():
    rng = np.random.default_rng(2)
    images = rng.normal(size=(8, 40, 20))
    images[:, :20] *= 50
    found = planes_of(images, 1.0).values[0]
    assert found[:, :10].std() > 0.9
    assert found[:, 30:].std() < 0.3


def test_missing_pixels_do_not_count():
    rng = np.random.default_rng(3)
    images = rng.normal(size=(6, 30, 20))
    valid = np.ones(images.shape, bool)
    valid[0, :5] = False
    valid[:4, 25:] = False
    found = planes_of(np.where(valid, images, 1e9), valid=valid)
    assert np.all(found.values[0, 0, :5] == 0)
    assert not found.mask[25:].any()
    assert np.abs(found.values[0, 1:, :5]).mean() > 0.5


def test_parts_have_no_mean():
    rng = np.random.default_rng(4)
    found = planes_of(rng.normal(size=(9, 20, 10)))
    part = found.of_epochs(slice(4))
    assert np.abs(part.values.mean(axis=1)).max() < 1e-6
    assert len(part.years) == 4
    assert np.abs(found.square_root.values.mean(axis=1)).max() < 1e-6
    assert found.of_scales([1]).values.shape == found.values.shape
    along = planes_of(rng.normal(size=(9, 20, 10)), normalise="along")
    assert along.values.std() > 0.5
