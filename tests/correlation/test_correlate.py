# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches of patterns: their displacements, coefficients, overlap, and columns."""

import multiprocessing
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from astro_scc.correlation import Correlator, Matches, all_pairs
from astro_scc.correlation.correlate import (
    TargetStack,
    match_block,
    target_ssps,
)
from astro_scc.correlation.zncc import find_peaks
from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.simulation import simulate_two_fluid

NY, NX = 96, 128


def zncc(a, b):
    """The zero-mean normalised cross-correlation; 0 without variance."""
    flat = [np.ptp(v) <= 1e-14 * np.abs(v).max() for v in (a, b)]
    if any(flat):
        return 0.0
    a, b = a - a.mean(), b - b.mean()
    norm = np.sqrt(np.sum(a * a) * np.sum(b * b))
    return np.sum(a * b) / norm


def segmentation(decomposition, scale):
    """1 + the number of the SSP of each pixel on a scale, or 0."""
    ssps = decomposition.ssps
    labels = np.zeros(decomposition.planes.shape[1:], dtype=int)
    for index in np.flatnonzero(ssps.scale == scale):
        labels.flat[ssps.pixels_of(index)] = index + 1
    return labels


def segmented_plane(decomposition, scale):
    plane = decomposition.planes[decomposition.scales.index(scale)]
    return np.where(segmentation(decomposition, scale) > 0, plane, 0)


def gaussian(x0, y0, fwhm=10.0, height=1.0, shape=(NY, NX)):
    y, x = np.mgrid[: shape[0], : shape[1]]
    sigma2 = fwhm**2 / (8 * np.log(2))
    return height * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * sigma2))


def noise(seed=0, rms=1e-4, shape=(NY, NX)):
    return np.random.default_rng(seed).normal(scale=rms, size=shape)


def brightest(decomposition, scale):
    ssps = decomposition.ssps
    return int(np.argmax(np.where(ssps.scale == scale, ssps.snr, -1)))


def best_match(matches, ssp):
    own = matches.select(matches.ssp == ssp)
    return own.select(np.argsort(-own.coefficient)[:1])


@pytest.fixture(scope="module")
def jet():
    """Decompositions of four epochs of the two-fluid jet."""
    cube = simulate_two_fluid(rng=5, n_epochs=4).cube
    return [Decomposer(scales=(1, 2))(image) for image in cube.data]


def slow_matches(decompositions, pairs, reach, kappa, target, min_overlap):
    """The paper's equation: each SSP's own pixels, each displacement."""
    ssps = SSPs.of_epochs(decompositions)
    ny, nx = decompositions[0].planes.shape[1:]
    ry, rx = reach[0] + 1, reach[1] + 1
    rows = []
    for first, second in pairs:
        reference, other = decompositions[first], decompositions[second]
        for index in np.flatnonzero(ssps.epoch == first):
            scale = ssps.scale[index]
            level = reference.scales.index(scale)
            plane = other.planes[level].astype(float)
            if target == "segments":
                plane = segmented_plane(other, scale).astype(float)
            py, px = np.unravel_index(ssps.pixels_of(index), (ny, nx))
            own = reference.planes[level][py, px].astype(float)
            gamma = np.full((2 * ry + 1, 2 * rx + 1), np.nan)
            for dy in range(-ry, ry + 1):
                for dx in range(-rx, rx + 1):
                    y, x = py + dy, px + dx
                    on = (y >= 0) & (y < ny) & (x >= 0) & (x < nx)
                    if other.mask is not None:
                        on[on] = ~other.mask[y[on], x[on]]
                    if on.mean() >= min_overlap:
                        gamma[dy + ry, dx + rx] = zncc(own[on], plane[y[on], x[on]])
            _, y, x, value = find_peaks(gamma[None], kappa)
            rows += [
                (index, second, a - ry, b - rx, c)
                for a, b, c in zip(y, x, value, strict=True)
            ]
    return np.array(sorted(rows))


@pytest.mark.slow
@pytest.mark.parametrize("target", ["segments", "plane"])
def test_equals_the_papers_equation(target):
    """Masked, at the edges, on two scales, with every pixel summed in a loop."""
    rng = np.random.default_rng(2)
    shape = (44, 56)
    spots = [(10, 12), (30, 20), (44, 30), (50, 12)]
    decompositions = []
    for epoch in range(3):
        image = noise(epoch, shape=shape)
        for x, y in spots:
            image += gaussian(x + 1.7 * epoch, y - 0.8 * epoch, 7.0, shape=shape)
        mask = rng.random(shape) < (0.0, 0.02, 0.05)[epoch]
        decompositions.append(Decomposer(scales=(1, 2))(image, mask=mask))
    pairs = [(0, 1), (1, 2), (2, 0), (0, 2)]
    correlate = Correlator(target=target, min_overlap=0.7)
    found = correlate(decompositions, pairs, (6, 8))
    expected = slow_matches(decompositions, pairs, (6, 8), 0.6, target, 0.7)
    order = np.lexsort((found.dx, found.dy, found.target, found.ssp))
    found = found.select(order)
    assert len(found) == len(expected) > 20
    np.testing.assert_array_equal(found.ssp, expected[:, 0])
    np.testing.assert_array_equal(found.target, expected[:, 1])
    np.testing.assert_allclose(found.dy, expected[:, 2], atol=1e-4)
    np.testing.assert_allclose(found.dx, expected[:, 3], atol=1e-4)
    np.testing.assert_allclose(found.coefficient, expected[:, 4], atol=1e-6)


@settings(max_examples=20)
@given(
    st.floats(-11, 11),
    st.floats(-11, 11),
    st.floats(-0.5, 0.5),
    st.floats(-0.5, 0.5),
    st.sampled_from([1, 1.5, 2, 3]),
    st.sampled_from(["segments", "plane"]),
)
def test_shifted_gaussian_comes_back(dx, dy, x0, y0, scale, target):
    decompose = Decomposer(scales=[scale])
    first = decompose(gaussian(60 + x0, 48 + y0) + noise(1))
    second = decompose(gaussian(60 + x0 + dx, 48 + y0 + dy) + noise(2))
    matches = Correlator(target=target)([first, second], all_pairs(2), 14)
    forward = best_match(matches, brightest(first, scale))
    assert forward.dx[0] == pytest.approx(dx, abs=0.06)
    assert forward.dy[0] == pytest.approx(dy, abs=0.06)
    assert forward.coefficient[0] > 0.9
    assert forward.overlap[0] == 1
    # The roles reversed, the displacement is the opposite one.
    back = best_match(matches, len(first.ssps) + brightest(second, scale))
    assert back.dx[0] == pytest.approx(-forward.dx[0], abs=0.06)
    assert back.dy[0] == pytest.approx(-forward.dy[0], abs=0.06)


@pytest.mark.parametrize(
    ("fwhm", "scale", "largest"),
    [(3, 1, 0.15), (5, 1, 0.08), (10, 1, 0.03), (10, 2, 0.03), (10, 3, 0.02),
     (20, 2, 0.01), (20, 4, 0.01)],
)  # fmt: skip
def test_sub_pixel_error(fwhm, scale, largest):
    """Of single features without noise: a few hundredths of a pixel at most."""
    decompose = Decomposer(scales=[scale])
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(8):
        x0, y0, dx, dy = rng.uniform(-0.5, 0.5, 4) + [60, 48, 7, 3]
        pair = [
            decompose(gaussian(x0, y0, fwhm) + noise(1, 1e-6)),
            decompose(gaussian(x0 + dx, y0 + dy, fwhm) + noise(2, 1e-6)),
        ]
        matches = Correlator()(pair, [(0, 1)], 12)
        best = best_match(matches, brightest(pair[0], scale))
        errors += [best.dx[0] - dx, best.dy[0] - dy]
    assert np.abs(errors).max() < largest


def test_faint_feature_beside_a_core():
    """A knot is found beside a core a hundred thousand times brighter."""
    images = [
        gaussian(30, 48, 6, 1e5) + gaussian(60 + 4.4 * k, 48, 6, 1.0) for k in (0, 1)
    ]
    # Far from the core its wavelets are exactly zero: any noise would do.
    decompose = Decomposer(scales=[2], noise="propagated")
    pair = [decompose(image, rms=0.05) for image in images]
    knot = int(np.argmin(np.abs(pair[0].ssps.x - 60)))
    matches = Correlator()(pair, [(0, 1)], (8, 34))
    own = matches.select(matches.ssp == knot)
    errors = np.hypot(own.dx - 4.4, own.dy)
    assert errors.min() < 0.05


@pytest.mark.parametrize("edge", ["image", "mask"])
@pytest.mark.parametrize("target", ["segments", "plane"])
def test_feature_that_leaves(edge, target):
    """Near the edge its place is right; beyond it there is no match."""
    decompose = Decomposer(scales=[2])
    first = decompose(gaussian(90, 48) + noise(1))
    ssp = brightest(first, 2)
    end = NX if edge == "image" else 118
    mask = np.zeros((NY, NX), dtype=bool)
    mask[:, end:] = True
    for beyond, largest in ((-16, 0.05), (-10, 0.3), (-7, 1.0)):
        x = end + beyond + 0.3
        second = decompose(gaussian(x, 48) + noise(2), mask=mask)
        matches = Correlator(target=target)([first, second], [(0, 1)], 44)
        best = best_match(matches, ssp)
        assert best.dx[0] == pytest.approx(x - 90, abs=largest)
        assert best.dy[0] == pytest.approx(0, abs=0.05)
    for beyond in (-2, 0, 5):
        x = end + beyond + 0.3
        second = decompose(gaussian(x, 48) + noise(2), mask=mask)
        matches = Correlator(target=target)([first, second], [(0, 1)], 44)
        # Not on the brink of the smallest overlap either.
        own = matches.select((matches.ssp == ssp) & (np.abs(matches.dy) < 4))
        assert not (own.dx > end - 90 - 15).any()


def test_processes_give_the_same_to_the_bit(jet):
    pairs = all_pairs(len(jet))
    done = []
    one = Correlator()(jet, pairs, 12, n_workers=1, progress=done.append)
    two = Correlator()(jet, pairs, 12, n_workers=2, progress=done.append)
    np.testing.assert_equal(vars(one), vars(two))
    assert len(one) > 0
    assert done == [1] * (2 * len(jet))
    assert multiprocessing.active_children() == []


@pytest.mark.slow
@pytest.mark.parametrize("target", ["segments", "plane"])
def test_small_blocks_give_the_same(jet, target, monkeypatch):
    """However few epochs a block holds, and after a pickle of each."""
    correlate = Correlator(target=target)
    pairs = all_pairs(len(jet))
    whole = correlate(jet, pairs, 12)
    one_each = {"BLOCK_WORK": 1, "STACK_BYTES": 1, "FEWEST_TARGETS": 1}
    for name, value in one_each.items():
        monkeypatch.setitem(Correlator._blocks.__globals__, name, value)
    monkeypatch.setattr("astro_scc.correlation.targets.BATCH_PIXELS", 1)
    blocks = list(correlate._blocks(jet, pairs, (12, 12), None))
    assert [b.pairs.tolist() for b in blocks] == [[p] for p in pairs.tolist()]
    again = [match_block(pickle.loads(pickle.dumps(b)))[1] for b in blocks]
    found = Matches.from_columns(again, pairs, (12, 12), 0.6)
    np.testing.assert_equal(vars(found.sorted()), vars(whole))
    np.testing.assert_equal(vars(correlate(jet, pairs, 12)), vars(whole))


def test_only_the_pairs_asked_for(jet):
    every = Correlator()(jet, all_pairs(len(jet)), 12)
    pairs = [(2, 1), (0, 3), (2, 3), (2, 1)]
    found = Correlator()(jet, pairs, 12)
    epoch = SSPs.of_epochs(jet).epoch[every.ssp]
    wanted = [(a, b) in pairs for a, b in zip(epoch, every.target, strict=True)]
    for name in ("ssp", "target", "dy", "dx", "coefficient"):
        np.testing.assert_array_equal(
            getattr(found, name), getattr(every.select(wanted), name)
        )


@pytest.mark.parametrize("target", ["segments", "plane"])
def test_nothing_to_correlate(jet, target):
    decompose = Decomposer(scales=[2])
    empty = decompose(np.zeros((NY, NX)))
    pair = [decompose(gaussian(60, 48) + noise(1)), empty]
    correlate = Correlator(target=target)
    for matches in (
        correlate(jet, [], 5),
        correlate([], [], 5),
        correlate([empty, empty], [(0, 1)], 5),
        correlate(pair, [(0, 1)], 9),
    ):
        assert len(matches) == 0
        assert matches.dx.dtype == np.float32
        assert matches.pairs.shape[1] == 2
    assert all_pairs(0).shape == all_pairs(1).shape == (0, 2)


@pytest.mark.parametrize(
    ("settings_", "message"),
    [
        ({"kappa": 1}, "kappa = 1 must be between 0 and 1"),
        ({"target": "image"}, "target = 'image' must be one of segments, plane"),
        ({"min_overlap": 0}, "min_overlap = 0 must be above 0, up to 1"),
    ],
)
def test_settings_that_are_refused(settings_, message):
    with pytest.raises(ValueError, match=message):
        Correlator(**settings_)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ({"pairs": [(0, 4)]}, "outside 0 to 3"),
        ({"pairs": [(-1, 2)]}, "outside 0 to 3"),
        ({"search_radius": -1}, "search radius must be one or two"),
        ({"search_radius": (5, -1)}, "search radius must be one or two"),
        ({"search_radius": (1, 2, 3)}, "search radius must be one or two"),
        ({"select": np.ones(3, bool)}, "select must be one bool for each"),
        ({"select": np.arange(3)}, "select must be one bool for each"),
        ({"other": (Decomposer(scales=(1, 2)), (40, 40))}, "one shape and the same sc"),
        ({"other": (Decomposer(scales=(1, 3)), (128, 256))}, "one shape and the same"),
    ],
)
def test_calls_that_are_refused(jet, call, message):
    options = {"pairs": [(0, 1)], "search_radius": 5, **call}
    epochs = jet
    if "other" in call:
        decompose, shape = options.pop("other")
        epochs = [jet[0], decompose(np.zeros(shape))]
    with pytest.raises(ValueError, match=message):
        Correlator()(epochs, **options)


# -- images on which patterns fall ------------------------------------------------


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
        level = other.scales.index(scale)
        plane = other.planes[level]
        if target == "segments":
            plane = segmented_plane(other, scale)
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
    np.testing.assert_equal(vars(some), vars(everything.of_ssps(chosen)))
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


@pytest.fixture(scope="module")
def epochs():
    cube = simulate_two_fluid(rng=3, n_epochs=3).cube
    return [Decomposer(scales=(1, 1.5, 2))(image) for image in cube.data]


@pytest.fixture(scope="module")
def matches(epochs):
    return Correlator(kappa=0.7)(epochs, all_pairs(3), (8, 25))


def test_selections(matches, epochs):
    scale = SSPs.of_epochs(epochs).scale
    fine = matches.of_ssps(scale == 1)
    assert 0 < len(fine) < len(matches)
    assert (scale[fine.ssp] == 1).all()
    assert fine.pairs is matches.pairs
    first = matches.select([0, 2])
    np.testing.assert_array_equal(first.dx, matches.dx[[0, 2]])
    assert repr(first) == "<Matches: 2 peaks of 6 pairs of epochs>"


def test_sorted_by_ssp_and_then_by_target(matches):

    mixed = matches.select(np.random.default_rng(0).permutation(len(matches)))
    found = mixed.sorted()
    order = np.lexsort((mixed.target, mixed.ssp))
    np.testing.assert_equal(vars(found), vars(mixed.select(order)))
    np.testing.assert_array_equal(found.ssp, matches.ssp)
    np.testing.assert_array_equal(found.target, matches.target)


def test_landing_is_on_the_nearest_pattern(matches, epochs):
    ssps = SSPs.of_epochs(epochs)
    landed = target_ssps(matches, ssps)
    assert landed.shape == (len(matches),)
    assert 0.3 < np.mean(landed >= 0) < 1
    for k in range(len(matches)):
        own = matches.ssp[k]
        there = np.flatnonzero(
            (ssps.epoch == matches.target[k]) & (ssps.scale == ssps.scale[own])
        )
        distance = np.hypot(
            ssps.y[there] - ssps.y[own] - matches.dy[k],
            ssps.x[there] - ssps.x[own] - matches.dx[k],
        )
        if distance.size and distance.min() <= scale_size(ssps.scale[own]):
            assert landed[k] == there[distance.argmin()]
        else:
            assert landed[k] == -1


def test_landing_where_nothing_is(epochs):
    ssps = epochs[0].ssps
    columns = (np.arange(2), np.ones(2), *np.zeros((5, 2)))
    matches = Matches.from_columns([columns], [(0, 1)], (5, 5), 0.6)
    assert target_ssps(matches, ssps).tolist() == [-1, -1]
    nothing = matches.select(slice(0, 0))
    assert target_ssps(nothing, ssps).shape == (0,)
