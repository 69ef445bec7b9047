# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Coefficients, their peaks and matches, against loops over displacements."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.images.zncc import correlate_windows, find_peaks
from astro_scc.paper import Correlator, Matches, all_pairs
from astro_scc.paper.correlate import COLUMNS, target_ssps
from astro_scc.simulation import simulate_two_fluid

NY, NX = 96, 128
SHAPE = (40, 52)


def zncc(a, b):
    """The zero-mean normalised cross-correlation; 0 without variance."""
    if any(np.ptp(v) <= 1e-14 * np.abs(v).max() for v in (a, b)):
        return 0.0
    a, b = a - a.mean(), b - b.mean()
    return np.sum(a * b) / np.sqrt(np.sum(a * a) * np.sum(b * b))


def double_loop(values, footprint, window, reach, valid, min_overlap):
    """The paper's equation, one displacement after the other."""
    height, width = footprint.shape
    coefficient, overlap = np.zeros((2, *(2 * r + 1 for r in reach)))
    for y, x in np.ndindex(coefficient.shape):
        box = (slice(y, y + height), slice(x, x + width))
        both = footprint & valid[box]
        overlap[y, x] = both.sum() / footprint.sum()
        if overlap[y, x] >= min_overlap and both.any():
            coefficient[y, x] = zncc(values[both], window[box][both])
    return coefficient, overlap


@settings(max_examples=80)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans(), st.floats(0.05, 1))
def test_coefficients_equal_the_double_loop(seed, sparse, own, min_overlap):
    """Of a pattern, which may be part of the window, and its footprint."""
    rng = np.random.default_rng(seed)
    height, width, *reach = rng.integers([1, 1, 0, 0], [8, 8, 6, 6]).tolist()
    footprint = rng.random((height, width)) < rng.uniform(0.3, 1)
    footprint[rng.integers(height), rng.integers(width)] = True
    shape = (height + 2 * reach[0], width + 2 * reach[1])
    # Rounded, so that no local variance is lost beside the window's energy.
    window = np.round(rng.normal(size=shape), 2)
    if sparse:
        # Zero almost everywhere, as a plane outside its SSPs.
        window[rng.random(shape) < 0.7] = 0
    values = rng.normal(size=footprint.shape)
    if own:
        values = window[reach[0] :, reach[1] :][:height, :width].copy()
    valid = rng.random(shape) >= rng.choice([0, 0.1, 0.5])
    expected = double_loop(values, footprint, window, reach, valid, min_overlap)
    # What stands in missing pixels is of no account.
    missing = np.where(valid, window, np.nan), None
    for given_, exists in ((window, valid), missing):
        how = {"valid": exists, "min_overlap": min_overlap}
        found = correlate_windows(values, footprint, given_, reach, **how)
        np.testing.assert_allclose(found[1], expected[1], atol=1e-12)
        np.testing.assert_allclose(found[0], expected[0], atol=1e-8)


def slow_peaks(maps, threshold):
    """Pixels that no neighbour exceeds, nor any later one equals."""
    for k, plane in enumerate(maps):
        for y in range(1, plane.shape[0] - 1):
            for x in range(1, plane.shape[1] - 1):
                around = plane[y - 1 : y + 2, x - 1 : x + 2].ravel()
                before, centre, after = around[:4], around[4], around[5:]
                kept = (centre >= before).all() and (centre > after).all()
                if centre >= threshold and kept:
                    yield k, y, x


@settings(max_examples=60)
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 14),
    st.integers(1, 14), st.floats(0, 3), st.floats(-0.2, 0.9), st.booleans(),
    st.floats(0, 0.2),
)  # fmt: skip
def test_peaks_equal_brute_force(seed, n, ny, nx, smooth, threshold, ties, missing):
    rng = np.random.default_rng(seed)
    maps = ndimage.gaussian_filter(
        rng.uniform(-1, 1, (n, ny, nx)), (0, smooth, smooth), mode="wrap"
    )
    if ties:
        maps = np.round(maps, 1)
    maps[rng.random(maps.shape) < missing] = np.nan
    index, y, x, value = find_peaks(maps, threshold)
    expected = list(slow_peaks(maps, threshold))
    assert len(index) == len(expected)
    for k, (map_, py, px) in enumerate(expected):
        assert index[k] == map_
        assert max(abs(y[k] - py), abs(x[k] - px)) <= 0.5
        assert maps[map_, py, px] <= value[k] <= max(1, maps[map_, py, px])


def gaussian(x0, y0, fwhm=10.0, height=1.0, shape=(NY, NX)):
    y, x = np.mgrid[: shape[0], : shape[1]]
    sigma2 = fwhm**2 / (8 * np.log(2))
    return height * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * sigma2))


def noise(seed=0, rms=1e-4, shape=(NY, NX)):
    return np.random.default_rng(seed).normal(scale=rms, size=shape)


def best_match(matches, ssp):
    own = matches.select(matches.ssp == ssp)
    return own.select(np.argsort(-own.coefficient)[:1])


@pytest.fixture(scope="module")
def masked():
    """Three epochs, two of them with holes, on two scales, up to the edges."""
    rng = np.random.default_rng(7)
    spots = [(4, 6), (20, 12), (33, 30), (12, 40), (37, 49)]
    epochs = []
    for k in range(3):
        image = noise(k, 1e-3, SHAPE)
        for y, x in spots:
            image += gaussian(x + 1.4 * k, y - 0.7 * k, 5.0, shape=SHAPE)
        mask = rng.random(SHAPE) < 0.03 if k else None
        epochs.append(Decomposer(scales=(1, 2))(image, mask=mask))
    return epochs


def slow_matches(epochs, reach, target, min_overlap):
    """The paper's equation: each SSP's own pixels, each displacement."""
    ssps, (ny, nx) = SSPs.of_epochs(epochs), SHAPE
    for index in range(len(ssps)):
        level = epochs[0].scales.index(ssps.scale[index])
        pixels = ssps.pixels_of(index)
        py, px = np.unravel_index(pixels, SHAPE)
        own = epochs[ssps.epoch[index]].planes[level].flat[pixels].astype(float)
        for second in {0, 1, 2} - {ssps.epoch[index]}:
            other = epochs[second]
            plane = other.planes[level].astype(float)
            if target == "segments":
                theirs = other.ssps.select(other.ssps.scale == ssps.scale[index]).pixels
                plane = np.zeros(SHAPE)
                plane.flat[theirs] = other.planes[level].flat[theirs]
            valid = np.ones(SHAPE, bool) if other.mask is None else ~other.mask
            gamma = np.full([2 * r + 3 for r in reach], np.nan)
            share = np.zeros(gamma.shape)
            for at in np.ndindex(gamma.shape):
                y, x = py + at[0] - reach[0] - 1, px + at[1] - reach[1] - 1
                on = (y >= 0) & (y < ny) & (x >= 0) & (x < nx)
                on[on] = valid[y[on], x[on]]
                share[at] = on.mean()
                if share[at] >= min_overlap:
                    gamma[at] = zncc(own[on], plane[y[on], x[on]])
            _, y, x, value = find_peaks(gamma[None], 0.6)
            for a, b, c in zip(y, x, value, strict=True):
                dy, dx = a - reach[0] - 1, b - reach[1] - 1
                y = int(np.clip(np.rint(ssps.y[index] + dy), 0, ny - 1))
                x = int(np.clip(np.rint(ssps.x[index] + dx), 0, nx - 1))
                top = plane[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].max()
                snr = max(top, 0) / np.broadcast_to(other.noise[level], SHAPE)[y, x]
                yield index, second, dy, dx, c, share[round(a), round(b)], snr


@pytest.mark.parametrize(("target", "maps"), [("segments", False), ("plane", True)])
def test_matches_equal_the_papers_equation(masked, target, maps):
    """Masked, at the edges, on two scales, with every pixel summed in a loop."""
    if maps:
        factor = np.random.default_rng(1).uniform(1, 2, SHAPE)
        masked = [replace(e, noise=tuple(n * factor for n in e.noise)) for e in masked]
    found = Correlator(target=target, min_overlap=0.6)(masked, all_pairs(3), (3, 5))
    found = found.select(np.lexsort((found.dx, found.dy, found.target, found.ssp)))
    expected = np.array(sorted(slow_matches(masked, (3, 5), target, 0.6))).T
    assert len(found) > 40
    assert (found.overlap < 1).sum() > 5
    for name, values in zip(COLUMNS, expected, strict=True):
        tolerance = 1e-3 if name == "target_snr" else 1e-4
        np.testing.assert_allclose(
            getattr(found, name), values, rtol=tolerance, atol=tolerance, err_msg=name
        )


@settings(max_examples=15)
@given(
    st.floats(-11, 11), st.floats(-11, 11), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5),
    st.sampled_from([1, 1.5, 2, 3]), st.sampled_from(["segments", "plane"]),
)  # fmt: skip
def test_shifted_gaussian_comes_back(dx, dy, x0, y0, scale, target):
    decompose = Decomposer(scales=[scale])
    first = decompose(gaussian(60 + x0, 48 + y0) + noise(1))
    second = decompose(gaussian(60 + x0 + dx, 48 + y0 + dy) + noise(2))
    matches = Correlator(target=target)([first, second], all_pairs(2), 14)
    forward = best_match(matches, int(np.argmax(first.ssps.snr)))
    assert (forward.dx[0], forward.dy[0]) == pytest.approx((dx, dy), abs=0.06)
    assert forward.coefficient[0] > 0.9
    assert forward.overlap[0] == 1
    # The roles reversed, the displacement is the opposite one.
    back = best_match(matches, len(first.ssps) + int(np.argmax(second.ssps.snr)))
    assert (back.dx[0], back.dy[0]) == pytest.approx((-dx, -dy), abs=0.06)


@pytest.mark.parametrize("target", ["segments", "plane"])
def test_processes_give_the_same_to_the_bit(masked, target):
    correlate, pairs, done = Correlator(target=target), all_pairs(3), []
    whole = correlate(masked, pairs, 6, progress=done.append)
    found = correlate(masked, pairs, 6, n_workers=2, progress=done.append)
    np.testing.assert_equal(vars(found), vars(whole))
    assert done == [1] * 6


@pytest.mark.parametrize("target", ["segments", "plane"])
def test_nothing_to_correlate(masked, target):
    decompose = Decomposer(scales=[2])
    empty = decompose(np.zeros((NY, NX)))
    pair = [decompose(gaussian(60, 48) + noise(1)), empty]
    correlate, none = Correlator(target=target), {"select": np.zeros(2, bool)}
    for matches in (
        *(correlate(masked, [], 5), correlate([], [], 5)),
        *(correlate([empty, empty], [(0, 1)], 5), correlate(pair, [(0, 1)], 9)),
        correlate(pair[:1] * 2, [(0, 1)], 9, **none),
    ):
        assert len(matches) == 0
        assert matches.dx.dtype == np.float32
    assert all_pairs(0).shape == all_pairs(1).shape == (0, 2)


def test_what_is_refused(masked):
    for own, call, message in [
        ({"min_overlap": 0}, {}, "min_overlap = 0 must be above 0, up to 1"),
        ({}, {"pairs": [(0, 3)]}, "outside 0 to 2"),
        ({}, {"search_radius": (5, -1)}, "search radius must be one or two numbers of"),
        ({}, {"other": ((1, 2), NY, NX)}, "one shape and the same scales"),
    ]:
        options = {"pairs": [(0, 1)], "search_radius": 5, **call}
        scales, *shape = options.pop("other", ((1, 2), *SHAPE))
        epochs = [*masked[:2], Decomposer(scales=scales)(np.zeros(shape))]
        with pytest.raises(ValueError, match=message):
            Correlator(**own)(epochs, **options)


def test_landing_is_on_the_nearest_pattern():
    cube = simulate_two_fluid(rng=3, n_epochs=3).cube
    epochs = [Decomposer(scales=(1, 1.5, 2))(image) for image in cube.data]
    matches, ssps = (
        Correlator(kappa=0.7)(epochs, all_pairs(3), (8, 25)), SSPs.of_epochs(epochs)
    )  # fmt: skip
    assert repr(matches.select([0, 2])) == "<Matches: 2 peaks>"
    landed = target_ssps(matches, ssps)
    assert 0.3 < np.mean(landed >= 0) < 1
    for k, own in enumerate(matches.ssp):
        alike = (ssps.epoch == matches.target[k]) & (ssps.scale == ssps.scale[own])
        there = np.flatnonzero(alike)
        dy = ssps.y[there] - ssps.y[own] - matches.dy[k]
        distance = np.hypot(dy, ssps.x[there] - ssps.x[own] - matches.dx[k])
        near = distance.min(initial=np.inf) <= scale_size(ssps.scale[own])
        assert landed[k] == (there[distance.argmin()] if near else -1)
    nowhere = Matches(np.arange(2), np.full(2, 3), *np.zeros((5, 2)))
    assert target_ssps(nowhere, ssps).tolist() == [-1, -1]
    assert target_ssps(nowhere.select([]), ssps).shape == (0,)
