# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""SSPs as regions and as segmentation images."""

from dataclasses import replace

import numpy as np
import pytest
from regions import Regions

from astro_scc.decomposition import SSPs
from astro_scc.products import (
    ssp_regions,
    ssp_segmentation,
    write_epoch_regions,
    write_ssp_regions,
)
from astro_scc.simulation import simulate_static


def indices(ssps, epoch, scale):
    return np.flatnonzero((ssps.epoch == epoch) & (ssps.scale == scale))


def test_outlines_hold_the_pixels(matched, tmp_path):
    ssps, cube, path = matched.ssps, matched.cube, tmp_path / "ssps.reg"
    here = indices(ssps, 2, 1)
    assert write_ssp_regions(SSPs.empty(), cube, 2, path) == 0
    assert len(Regions.read(path, format="ds9")) == 0
    with pytest.raises(OSError, match=r"ssps\.reg: exists"):
        write_ssp_regions(ssps, cube, 2, path)
    how = {"scales": [1], "overwrite": True}
    assert write_ssp_regions(ssps, cube, 2, path, **how) == len(here) > 3
    read = Regions.read(path, format="ds9")
    for index, region in zip(here, read, strict=True):
        assert region.meta["text"] in (str(index), index)
        mask = region.to_pixel(cube.wcs).to_mask(mode="center")
        inside = np.flatnonzero(mask.to_image(cube.shape[1:]) > 0)
        assert np.array_equal(inside, np.sort(ssps.pixels_of(index)))


def test_segmentation(matched):
    image = ssp_segmentation(matched.ssps, matched.cube, -1, 2)
    here = indices(matched.ssps, len(matched.cube) - 1, 2)
    y, x = np.round([matched.ssps.y, matched.ssps.x])[:, here].astype(int)
    assert np.array_equal(image.data[y, x], here + 1)
    assert np.array_equal(image.labels, here + 1)
    assert ssp_segmentation(SSPs.empty(), matched.cube, 0, 1).n_labels == 0
    assert np.array_equal(image.areas, matched.ssps.n_pixels[here])


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda *of: ssp_regions(*of, 0, frame="sky"), ValueError, "frame must be"),
        (lambda *of: ssp_regions(*of, 0, frame="epoch"), ValueError, "was not read fr"),
        (lambda *of: ssp_regions(*of, 2), IndexError, "epoch 2 of a cube with 2"),
    ],
)
def test_what_is_refused(call, error, words):
    cube = simulate_static(n_epochs=2, rng=1).cube
    with pytest.raises(error, match=words):
        call(SSPs.empty(), cube)


def test_a_file_for_every_epoch(matched, tmp_path):
    ssps, cube = matched.ssps, matched.cube
    labels = ["jet.fits", "../../up.fits", "-", "a" * 99, *cube.labels[4:]]
    named = replace(cube, labels=labels)
    paths = write_epoch_regions(ssps, named, tmp_path, scales=[3])
    names = [path.name for path in paths[:4]]
    assert names == ["00_jet.reg", "01_up.reg", "02_-.reg", f"03_{'a' * 60}.reg"]
    assert sorted((tmp_path / "ssp_regions").iterdir()) == paths
    for i, path in enumerate(paths):
        read = Regions.read(path)
        assert [int(region.meta["text"]) for region in read] == [*indices(ssps, i, 3)]
