# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images on which patterns fall: columns of matches, and where none is possible."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from astro_scc.correlation import Correlator, all_pairs
from astro_scc.correlation.correlate import TargetStack
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


def sparse_epochs(seed, masked):
    """Three images of few blobs, far from one another and from the edges or not."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:70, :110]
    epochs = []
    for _ in range(3):
        image = rng.normal(scale=0.01, size=x.shape)
        for y0, x0 in rng.uniform([0, 0], [70, 110], size=(4, 2)):
            image += np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / 14)
        mask = (np.hypot(x - 60, y - 30) < 9) if masked else None
        epochs.append(Decomposer(scales=[1, 2])(image, mask=mask))
    return epochs


@settings(deadline=None, max_examples=5)
@given(
    seed=st.integers(0, 2**32 - 1),
    reach=st.tuples(st.integers(2, 40), st.integers(2, 40)),
    masked=st.booleans(),
)
@example(seed=296373, reach=(3, 32), masked=True)
def test_only_displacements_that_meet_nothing_are_left_out(seed, reach, masked):
    epochs = sparse_epochs(seed, masked)
    # A few pixels agree equally well with any one pixel: maxima that tie.
    select = SSPs.of_epochs(epochs).n_pixels > 8
    found = Correlator()(epochs, all_pairs(3), reach, select=select)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            TargetStack, "displacements", lambda *a: (np.zeros(2, int), np.array(a[2]))
        )
        whole = Correlator()(epochs, all_pairs(3), reach, select=select)
    assert len(found) == len(whole)
    for name in ("ssp", "target"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))
    for name in ("dy", "dx", "coefficient", "target_snr"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(whole, name), atol=2e-4, err_msg=name
        )
    # Of two pixels that tie, either may be the maximum, with an overlap of its own.
    tie = [np.abs(np.abs(v - np.rint(v)) - 0.5) < 1e-3 for v in (found.dy, found.dx)]
    limit = np.where(np.any(tie, axis=0), 0.1, 2e-4)
    assert np.all(np.abs(found.overlap - whole.overlap) <= limit)


@pytest.mark.parametrize(("number", "expected"), [(2, 0), (3, 1)])
def test_two_pixels_match_nothing(number, expected):
    # Their coefficient is one or minus one, wherever they fall.
    rng = np.random.default_rng(1)
    epochs = [Decomposer(scales=[1])(rng.normal(size=(30, 40))) for _ in range(2)]
    one = np.ones(1)
    ssps = SSPs(
        scale=one, y=12 * one, x=15 * one, y_centroid=12 * one, x_centroid=15 * one,
        peak=one, flux=one, snr=9 * one, bbox=np.array([[12, 14, 13, 14 + number]]),
        starts=np.array([0, number]), pixels=12 * 40 + 14 + np.arange(number),
        epoch=np.zeros(1, int),
    )  # fmt: skip
    epochs = [replace(epoch, ssps=ssps) for epoch in epochs]
    matches = Correlator(target="plane")(epochs, all_pairs(2), 8)
    assert (len(matches) > 0) == expected
