# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What matches say of the image they fall on, against loops over pixels."""

from dataclasses import replace

import numpy as np
import pytest

from astro_scc.correlation import Correlator, all_pairs
from astro_scc.decomposition import Decomposer, SSPs

SHAPE = (40, 52)


@pytest.fixture(scope="module")
def masked():
    """Three epochs, two of them with holes, on two scales, up to the edges."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    spots = [(4, 6), (20, 12), (33, 30), (12, 40), (37, 49)]
    epochs = []
    for k in range(3):
        image = rng.normal(scale=1e-3, size=SHAPE)
        for b, a in spots:
            image += np.exp(-((x - a - 1.4 * k) ** 2 + (y - b + 0.7 * k) ** 2) / 9)
        mask = rng.random(SHAPE) < 0.03 if k else None
        epochs.append(Decomposer(scales=(1, 2))(image, mask=mask))
    return epochs


def noise_maps(epochs):
    """The same with noise that differs from pixel to pixel."""
    rng = np.random.default_rng(1)
    return [
        replace(e, noise=tuple(n * rng.uniform(1, 2, SHAPE) for n in e.noise))
        for e in epochs
    ]


@pytest.mark.parametrize("target", ["segments", "plane"])
@pytest.mark.parametrize("maps", [False, True])
def test_overlap_and_snr(masked, target, maps):
    epochs = noise_maps(masked) if maps else masked
    ssps = SSPs.of_epochs(epochs)
    correlate = Correlator(target=target, min_overlap=0.6)
    matches = correlate(epochs, all_pairs(3), (5, 7))
    assert len(matches) > 40
    assert (matches.overlap < 1).sum() > 5
    for k in range(len(matches)):
        index, other = matches.ssp[k], epochs[matches.target[k]]
        scale = ssps.scale[index]
        level = other.plane_index(scale)
        plane = other.planes[level]
        if target == "segments":
            plane = other.segmented_plane(scale)
        exists = np.ones(SHAPE, bool) if other.mask is None else ~other.mask
        plane = np.where(exists, plane, 0)
        dy, dx = matches.dy[k], matches.dx[k]
        rows, columns = np.unravel_index(ssps.pixels_of(index), SHAPE)
        falls = [
            0 <= r < SHAPE[0] and 0 <= c < SHAPE[1] and exists[r, c]
            for r, c in zip(
                rows + round(float(dy)), columns + round(float(dx)), strict=True
            )
        ]
        assert matches.overlap[k] == pytest.approx(np.mean(falls), abs=1e-6)
        y = int(np.clip(np.rint(ssps.y[index] + dy), 0, SHAPE[0] - 1))
        x = int(np.clip(np.rint(ssps.x[index] + dx), 0, SHAPE[1] - 1))
        largest = plane[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].max()
        noise = other.noise[level]
        expected = max(largest, 0) / (noise[y, x] if maps else noise)
        assert matches.target_snr[k] == pytest.approx(expected, rel=1e-4, abs=1e-4)


def test_select_is_of_the_ssps_of_all_epochs(masked):
    everything = Correlator()(masked, all_pairs(3), 6)
    ssps = SSPs.of_epochs(masked)
    chosen = np.random.default_rng(2).random(len(ssps)) < 0.5
    some = Correlator()(masked, all_pairs(3), 6, select=chosen)
    assert 0 < len(some) < len(everything)
    assert some.same_as(everything.of_ssps(chosen))
    none = Correlator()(masked, all_pairs(3), 6, select=np.zeros(len(ssps), bool))
    assert len(none) == 0
    np.testing.assert_array_equal(none.pairs, everything.pairs)


def test_pairs_more_than_once_are_once(masked):
    twice = np.concatenate([all_pairs(3), all_pairs(3)[::-1]])
    done = []
    found = Correlator()(masked, twice, 6, progress=done.append)
    once = Correlator()(masked, all_pairs(3), 6)
    assert done == [1, 1, 1]
    for name in ("ssp", "target", "dy", "dx"):
        np.testing.assert_array_equal(getattr(found, name), getattr(once, name))
