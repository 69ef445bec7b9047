# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Detections of features whose motions are known, in beams of one mas."""

import numpy as np
import pytest

from astro_scc.features.detections import Detections, rank_in_group

#: Covariance of a round beam of 1 mas.
ROUND = np.eye(2) / (8 * np.log(2))


@pytest.fixture(scope="session")
def series():
    """Make detections of (epoch, x, y) or (epoch, x, y, flux), ordered by epoch."""

    def make(rows, *, n_epochs=None, years=None, error=0.01, beam=ROUND):
        rows = np.array([(*row, 1.0)[:4] for row in rows], dtype=float).reshape(-1, 4)
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        epoch = rows[:, 0].astype(int)
        if years is None:
            n = int(epoch.max(initial=-1)) + 1 if n_epochs is None else n_epochs
            years = 2000.0 + np.arange(n)
        return Detections(
            epoch=epoch, place=rows[:, 1:3], flux=rows[:, 3], beam=beam,
            place_error=np.full((len(rows), 2), error), size=np.zeros(len(rows)),
            years=np.asarray(years, dtype=float), number=rank_in_group(epoch),
            group=np.zeros(len(rows), dtype=int),
        )  # fmt: skip

    return make


@pytest.fixture(scope="session")
def separated(series):
    """Four features some beams apart that move alike, with noise; 8 epochs."""
    rng = np.random.default_rng(3)
    return series(
        [
            (t, 3 * k + 0.3 * t + dx, 2.0 + dy, (1.0, 0.3, 2.0, 0.6)[k])
            for t in range(8)
            for k, (dx, dy) in enumerate(rng.normal(0, 0.03, (4, 2)))
        ]
    )
