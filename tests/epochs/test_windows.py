# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Parts of images, read without the rest of them."""

import tracemalloc
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.nddata import CCDData
from astropy.time import Time
from numpy.testing import assert_array_equal
from regions import CircleSkyRegion

from astro_scc.epochs import Beam, EpochCube, write_epochs
from astro_scc.exceptions import EpochWarning
from astro_scc.images.fits import read_plane

PART = slice(9, 30), slice(14, 50)


def make(n=3, shape=(40, 60), **fields):
    rng = np.random.default_rng(5)
    mask = rng.uniform(size=(n, *shape)) < 0.02
    options = {
        "times": Time("2001-01-01") + np.arange(n) * 30 * u.day,
        "pixel_scale": 0.1 * u.mas,
        "reference_pixel": (20, 15),
        "beams": [Beam((1 + 0.1 * i) * u.mas, 0.8 * u.mas) for i in range(n)],
        "mask": mask,
        "unit": u.Jy / u.beam,
    }
    return EpochCube.from_arrays(rng.normal(size=(n, *shape)), **{**options, **fields})


def same(one, other):
    assert_array_equal(one.mask, other.mask)
    assert_array_equal(
        np.where(one.mask, 0, one.data), np.where(other.mask, 0, other.data)
    )
    assert one.times.isot.tolist() == other.times.isot.tolist()
    assert (one.labels, one.unit, one.beams) == (other.labels, other.unit, other.beams)
    assert one.wcs.to_header_string() == other.wcs.to_header_string()
    assert one.wcs.array_shape == other.wcs.array_shape
    for own, its in zip(one.epoch_wcs or (), other.epoch_wcs or (), strict=True):
        assert own.to_header_string() == its.to_header_string()
    assert one.meta == other.meta
    assert one.epoch_meta == other.epoch_meta


@pytest.fixture
def paths(tmp_path):
    # The last epoch is the first of the files.
    return write_epochs(make(), tmp_path)[::-1]


@pytest.mark.parametrize("pad", [0, 3, 100])
def test_as_reading_all_and_cropping(paths, tmp_path, pad):
    whole = EpochCube.read(paths)
    circle = CircleSkyRegion(whole.wcs.pixel_to_world(30, 18), 0.75 * u.mas)
    inside = whole.region_mask(circle)
    for region in (PART, circle, inside, [circle]):
        part = EpochCube.read(paths, region=region, pad=pad)
        assert part.shape[1:] != whole.shape[1:] or pad == 100
        same(part, whole.crop(region, pad=pad))


def test_a_region_file_warns_who_reads(paths, tmp_path):
    path = tmp_path / "jet.reg"
    path.write_text("image\ncircle(21,21,8.5)\nblob(3,4)\n")
    whole = EpochCube.read(paths)
    for use in (whole.region_mask, whole.crop):
        with pytest.warns(EpochWarning, match="blob") as caught:
            use(path)
        assert caught[0].filename == __file__
    with pytest.warns(EpochWarning, match="blob") as caught:
        EpochCube.read(paths, region=path)
    assert caught[0].filename == __file__


@pytest.mark.parametrize("beams", [None, Beam(1 * u.mas, 1 * u.mas)])
def test_as_reading_a_cube_and_cropping(tmp_path, beams):
    cube = make(beams=beams)
    path = tmp_path / "cube.fits"
    cube.write(path)
    same(EpochCube.read(path, region=PART, pad=2), cube.crop(PART, pad=2))
    cube = replace(cube, epoch_wcs=[cube.wcs] * 3, noise=1 * cube.unit)
    cube.write(path, overwrite=True)
    part = EpochCube.read(path, region=PART)
    same(part, cube.crop(PART))
    assert_array_equal(part.noise, cube.noise)
    with pytest.raises(ValueError, match="hold no pixel of the 60 x 40 image"):
        EpochCube.read(path, region=(slice(50, 60), slice(0, 9)))
    with pytest.raises(TypeError, match="region must be"):
        EpochCube.read(path, region=7)


@pytest.mark.parametrize("frame", ["offset", "absolute"])
def test_images_that_lie_whole_pixels_aside(tmp_path, frame):
    cube = make(mask=None)
    folders = [tmp_path / str(k) for k in range(2)]
    # The second image has five rows and seven columns less.
    paths = [
        write_epochs(cube[[0]], folders[0])[0],
        write_epochs(cube[[1]].crop((slice(5, 40), slice(7, 60))), folders[1])[0],
    ]
    whole = EpochCube.read(paths, frame=frame)
    part = EpochCube.read(paths, frame=frame, region=PART)
    same(part, whole.crop(PART))
    assert not part.mask.any()
    # Beyond the edge of one of them.
    corner = slice(0, 20), slice(0, 20)
    same(EpochCube.read(paths, region=corner), EpochCube.read(paths).crop(corner))
    with pytest.raises(ValueError, match="nothing of the region lies in it; leave it"):
        EpochCube.read(paths, region=(slice(0, 4), slice(0, 20)))


def test_images_of_other_pixels(tmp_path):
    """They are resampled, which takes a little more of them than is asked for."""
    y, x = np.mgrid[:40, :60]
    paths = []
    for k, (scale, day) in enumerate(((1, "2001-01-01"), (0.8, "2001-03-01"))):
        # The same hill on the sky.
        r2 = ((x - 20) * scale - 15) ** 2 + ((y - 15) * scale - 3) ** 2
        cube = EpochCube.from_arrays(
            np.exp(-r2 / 60)[None],
            [day],
            pixel_scale=0.1 * scale * u.mas,
            reference_pixel=(20, 15),
        )
        paths += write_epochs(cube, tmp_path / str(k))
    with pytest.warns(match="on another grid than the finest"):
        part = EpochCube.read(paths, region=(slice(9, 28), slice(26, 45)))
    assert part.shape[1] < 40
    assert part.shape[2] < 60
    # A little less, since edges are extrapolated.
    inside = part.crop((slice(3, -3), slice(3, -3)))
    assert inside.shape[1] * 0.8 >= 18
    assert not inside.mask.any()
    np.testing.assert_allclose(*inside.data, atol=2e-3)


def test_what_a_part_has_not(paths):
    with fits.open(paths[1], mode="update") as hdus:
        hdus[0].data[9:30, 14:50] = np.nan
    with pytest.raises(ValueError, match="no valid pixel in this part, all are NaN"):
        EpochCube.read(paths, region=PART)
    with fits.open(paths[1], mode="update") as hdus:
        hdus[0].data[9:30, 14:50] = 3
    with pytest.raises(ValueError, match=r"than two different values in this region"):
        EpochCube.read(paths, region=PART)
    fits.delval(paths[1], "DATE-OBS")
    with pytest.raises(ValueError, match=f"{paths[1]}: no date of observation"):
        EpochCube.read(paths, region=PART)
    cube = EpochCube.read(paths, region=PART, times=["2001-03-01", "2001-02-01", None],
                          check=False)  # fmt: skip
    assert len(cube) == 3


def test_the_size_of_the_whole_image_tells_sources_apart(paths):
    """A part is smaller than the scatter of positions of VLBI."""
    there = fits.getval(paths[1], "CRVAL1")
    fits.setval(paths[1], "CRVAL1", value=there + 0.25 * u.mas.to(u.deg))
    part = slice(10, 13), slice(10, 13)
    same(EpochCube.read(paths, region=part), EpochCube.read(paths).crop(part))


def test_parts_of_scaled_and_weighted_images(paths):
    image = read_plane(paths[0])
    counts = np.rint(1000 * np.nan_to_num(image.data)).astype(np.int16)
    scaled = fits.PrimaryHDU(counts, fits.getheader(paths[0]))
    scaled.header["BSCALE"], scaled.header["BZERO"] = 0.001, 5.0
    weight = fits.ImageHDU(np.ones(image.shape), name="WHT")
    weight.data[20, 30] = 0
    fits.HDUList([scaled, weight]).writeto(paths[0], overwrite=True)
    whole = read_plane(paths[0])
    part = read_plane(paths[0], window=PART)
    assert_array_equal(part.data, whole.data[PART])
    assert_array_equal(part.mask, whole.mask[PART])
    assert part.mask.sum() == 1
    weight.data[PART] = 0
    fits.HDUList([scaled, weight]).writeto(paths[0], overwrite=True)
    with pytest.raises(ValueError, match="no valid pixel in this part by its"):
        read_plane(paths[0], window=PART)


def test_the_header_of_an_image_without_its_pixels(paths):
    plane = read_plane(paths[0], pixels=False)
    assert (plane.shape, plane.data) == ((40, 60), None)
    assert plane.time.isot.startswith("2001-03-02")
    assert plane.wcs.wcs.crpix.tolist() == [21, 16]
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_plane("nowhere.fits", pixels=False)


def test_more_than_the_machine_holds(paths, monkeypatch):
    memory = "astro_scc.epochs.reading.machine_memory"
    monkeypatch.setattr(memory, lambda: 3 * 40 * 60 * 9 - 1)
    with pytest.raises(MemoryError, match=r"3 images of 60 x 40 pixels are 6.48"):
        EpochCube.read(paths)
    assert len(EpochCube.read(paths, region=PART)) == 3


def test_images_of_two_types_are_stacked():
    options = {"unit": "Jy", "meta": {"DATE-OBS": "2001-01-01"}}
    wcs = make().wcs
    one = CCDData(np.ones((40, 60), np.float32), wcs=wcs, **options)
    other = CCDData(np.full((40, 60), 1 / 3), wcs=wcs, **options)
    with pytest.warns(match="image 1: is of .*, as is image 0; leave"):
        cube = EpochCube.from_ccddata([one, other])
    assert cube.data[1, 0, 0] == 1 / 3
    assert one.data.dtype == np.float32


@pytest.mark.slow
def test_only_the_part_is_in_memory(tmp_path):
    """Six images of 4 MB each, 8 as they are kept, of which a hundredth is wanted."""
    rng = np.random.default_rng(1)
    header = fits.getheader(write_epochs(make(n=1), tmp_path / "one")[0])
    paths = []
    for k in range(6):
        header["DATE-OBS"] = f"200{k}-01-01"
        paths.append(tmp_path / f"e{k}.fits")
        image = rng.normal(size=(1024, 1024)).astype(">f4")
        fits.PrimaryHDU(image, header).writeto(paths[-1])
    tracemalloc.start()
    try:
        cube = EpochCube.read(paths, region=(slice(400, 500), slice(450, 550)))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert cube.shape == (6, 100, 100)
    assert_array_equal(cube.data[5], fits.getdata(paths[5])[400:500, 450:550])
    assert peak < 6e6
