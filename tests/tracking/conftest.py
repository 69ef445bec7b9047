# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Catalogues of SSPs as simple as they can be."""

import numpy as np
import pytest

from astro_scc.decomposition import SSPs


@pytest.fixture(scope="session")
def catalogue():
    """Make SSPs of (epoch, y, x, peak) with square patches of pixels."""

    def make(rows, *, scale=1.0, half=2, width=400):
        rows = np.asarray(rows, dtype=float).reshape(-1, 4)
        n = len(rows)
        scale = np.broadcast_to(np.asarray(scale, dtype=float), n)
        half = np.broadcast_to(half, n)
        parts, boxes = [], []
        for (_, y, x, _), h in zip(rows, half, strict=True):
            r, c = int(round(y)), int(round(x))
            yy, xx = np.mgrid[r - h : r + h + 1, c - h : c + h + 1]
            parts.append((yy * width + xx).ravel())
            boxes.append([r - h, c - h, r + h + 1, c + h + 1])
        counts = [len(p) for p in parts]
        return SSPs(
            scale=scale,
            y=rows[:, 1],
            x=rows[:, 2],
            y_centroid=rows[:, 1],
            x_centroid=rows[:, 2],
            peak=rows[:, 3],
            flux=10 * rows[:, 3],
            snr=100 * rows[:, 3],
            bbox=np.array(boxes, dtype=int).reshape(-1, 4),
            starts=np.concatenate([[0], np.cumsum(counts)]).astype(int),
            pixels=np.concatenate([np.empty(0, int), *parts]).astype(np.int32),
            epoch=rows[:, 0].astype(int),
        )

    return make
