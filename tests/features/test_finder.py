# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features of simulated images, and of images without any."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc.columns import columns_of
from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.epochs import Beam, EpochCube
from astro_scc.features import find_features
from astro_scc.simulation import simulate_jet, simulate_static

STATIC = {"n_epochs": 6, "shape": (64, 128), "extent": (16, 112), "axis": 32}
BEAM = Beam(0.8 * u.mas, 0.8 * u.mas)


@pytest.fixture(scope="module")
def ssps(known_jet):
    decompose = Decomposer(scales=[1, 2, 3])
    return SSPs.of_epochs([decompose(image) for image in known_jet.cube.data])


def cube_of(data, **fields):
    dates = [f"{2000 + k}-01-01" for k in range(len(data))]
    return EpochCube.from_arrays(
        data, dates, pixel_scale=0.1 * u.mas, reference_pixel=(20, 20),
        unit=u.Jy / u.beam, **{"beams": BEAM, **fields},
    )  # fmt: skip


def against_truth(jet, features):
    """Return the share of one true feature in each track, and deviations in errors."""
    truth, d = jet.truth, features.detections
    place = np.stack([truth[c].to_value(u.mas) for c in ("east", "north")], axis=1)
    purity, off = [], []
    for track, motion in zip(features.tracks, features.motions, strict=True):
        own = []
        for k in track.tolist():
            now = np.flatnonzero((truth["epoch"] == d.epoch[k]) & truth["visible"])
            near = np.hypot(*(place[now] - d.place[k]).T).argmin()
            own.append(truth["feature"][now[near]])
        names, counts = np.unique(own, return_counts=True)
        at = (truth["feature"] == names[counts.argmax()]) & np.isin(
            truth["epoch"], d.epoch[track]
        )
        time = d.years[truth["epoch"][at]]
        velocity = np.polyfit(time - time.mean(), place[at], 1)[0]
        purity.append(counts.max() / len(own))
        off.append(np.hypot(*(motion.velocity - velocity)) / motion.speed_err)
    return np.array(purity), np.array(off)


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))]
)
def test_speeds_of_a_jet_are_true_and_what_stands_is_not_secure(seed):
    jet = simulate_jet(n_epochs=10, dispersion=0.1, rng=seed)
    found = find_features(jet.cube)
    purity, off = against_truth(jet, found)
    assert found.secure.sum() >= 5
    assert purity[found.secure].mean() > 0.9
    assert (off[found.secure] < 3).mean() >= 0.8
    assert found.core_error < 0.05
    for still in (
        simulate_static(**STATIC, density=0.4, rng=seed),
        simulate_jet(n_epochs=8, n_features=0, standing=6, rng=seed),
    ):
        standing = find_features(still.cube)
        assert len(standing) > 0
        assert not standing.secure.any()


def test_misaligned_epochs_are_aligned_on_the_core():
    jet = simulate_jet(n_epochs=10, dispersion=0.1, alignment_error=0.2, rng=1)
    found = find_features(jet.cube)
    _, off = against_truth(jet, found)
    assert found.secure.sum() >= 5
    assert (off[found.secure] < 3).mean() >= 0.8
    assert np.abs(found.core.place).max() < 1e-12
    assert 0 < found.core_error < 0.1


@pytest.mark.parametrize("beams", ["given", "none"])
def test_ssps_instead_of_gaussians(known_jet, ssps, beams):
    cube = known_jet.cube if beams == "given" else replace(known_jet.cube, beams=None)
    found = find_features(cube, detections="ssp", ssps=ssps)
    purity, off = against_truth(known_jet, found)
    assert found.secure.sum() >= 4
    assert purity.mean() > 0.9
    assert (off[found.secure] < 3).mean() >= 0.75
    # A pattern is one detection, not one on each scale.
    assert len(found.detections) + len(found.core) < len(ssps)
    if beams == "none":
        again = find_features(cube, ssps=ssps)
        assert np.all(again.positions["flux"] == found.positions["flux"])


def test_missing_pixels_do_not_spread(known_jet, known_features):
    data, mask = known_jet.cube.data.copy(), np.zeros(known_jet.cube.shape, dtype=bool)
    mask[3, 5:30, 10:60] = mask[7, 100:, 200:] = True
    data[mask] = 1e3
    noise = known_jet.cube.noise_rms()
    cube = replace(known_jet.cube, data=data, mask=mask, noise=noise)
    found = find_features(cube, n_workers=2)
    assert len(found) == len(known_features)
    for a, b in zip(found.motions, known_features.motions, strict=True):
        assert np.hypot(*(a.velocity - b.velocity)) < 0.1 * b.speed_err


EMPTY = {
    "one epoch": lambda: simulate_jet(n_epochs=1, rng=1).cube,
    "noise": lambda: cube_of(np.random.default_rng(1).normal(0, 1e-3, (5, 40, 60))),
    "negative": lambda: cube_of(-simulate_jet(n_epochs=5, rng=1).cube.data),
    "constant": lambda: cube_of(np.ones((5, 40, 60))),
}


@pytest.mark.parametrize("name", EMPTY)
def test_nothing_is_a_table_with_all_columns(name):
    found = find_features(EMPTY[name]())
    assert len(found) == len(found.table) == len(found.positions) == 0
    assert found.positions.colnames == list(columns_of("positions"))
    assert found.table.colnames == list(columns_of("features"))
    assert not found.secure.any()
    assert found.p_false.shape == (0,)


@pytest.mark.parametrize(
    ("change", "how", "words"),
    [
        ({}, {"detections": "wavelets"}, "gaussians"),
        ({}, {"detections": "ssp"}, "need ssps, the SSPs of all epochs$"),
        ({"beams": None}, {}, "without beams no Gaussians"),
    ],
)
def test_choices_that_do_not_exist(known_jet, change, how, words):
    with pytest.raises(ValueError, match=words):
        find_features(replace(known_jet.cube, **change), **how)
