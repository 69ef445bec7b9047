# Licensed under a 3-clause BSD style license - see LICENSE.rst
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from astro_scc.correlation import Correlator, all_pairs
from astro_scc.correlation.correlate import TargetStack
from astro_scc.decomposition import Decomposer, SSPs


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
