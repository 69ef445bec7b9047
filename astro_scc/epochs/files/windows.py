# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which part of each image to read, where a region of them all is wanted."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from astropy.time import Time
from astropy.wcs import WCS
from astropy.wcs.utils import pixel_to_pixel

from astro_scc.epochs.cutout import box
from astro_scc.epochs.files.gridding import offset_frame
from astro_scc.epochs.validation import as_times

__all__ = ["Grid", "windows_of"]

#: Steps between grids that are whole pixels to this part of one.
WHOLE = 0.01
#: Pixels around a part that is interpolated, as far as splines look.
MARGIN = 4


@dataclass(frozen=True)
class Grid:
    """
    The pixels of an image that is not read yet.

    Attributes
    ----------
    name : str
    wcs : `~astropy.wcs.WCS`
    shape : (int, int)
        (ny, nx).
    time : `~astropy.time.Time`
    """

    name: str
    wcs: WCS
    shape: tuple
    time: Time


def windows_of(grids, frame, region, pad=0):
    """
    The part of each image in which a region lies.

    Parameters
    ----------
    grids : sequence of `Grid`
    frame : {"offset", "absolute"}
        Whether reference pixels or celestial coordinates are laid on one
        another.
    region, pad
        See `~astro_scc.epochs.crop`.  The region is placed on the image of the
        earliest date.

    Returns
    -------
    first : (slice, slice)
        Rows and columns of the image of the earliest date.
    every : list of (slice, slice)
        Of each image, for the same part of the sky, or of the offsets.  It is a
        little more where images do not lie whole pixels aside.

    Raises
    ------
    ValueError
        If the region holds no pixel of one of the images, and as
        `~astro_scc.epochs.crop`.
    """
    times = as_times([grid.time for grid in grids], len(grids))
    first = grids[int(np.argmin((times - times[0]).jd))]
    cube = SimpleNamespace(shape=(1, *first.shape), wcs=first.wcs)
    window = box(cube, region, pad)
    steps = {id(grid): _step(window, first, grid, frame) for grid in grids}
    if any(step is None for step in steps.values()):
        # Something is interpolated, and edges are where that is worst.
        window = box(cube, region, pad + MARGIN)
    return window, [
        _moved(window, first, grid, frame, steps[id(grid)]) for grid in grids
    ]


def _corners(window, first, grid, frame):
    """Those of a part of the first image, (x, y), in it and in another one."""
    one, other = (
        offset_frame(g.wcs) if frame == "offset" else g.wcs for g in (first, grid)
    )
    (y0, y1), (x0, x1) = ((part.start, part.stop - 1) for part in window)
    corners = np.array([[x0, x1, x0, x1], [y0, y0, y1, y1]], dtype=float)
    return corners, np.array(pixel_to_pixel(one, other, *corners))


def _step(window, first, grid, frame):
    """Whole pixels (x, y) from one image to the other, None if they are not whole."""
    corners, moved = _corners(window, first, grid, frame)
    whole = np.rint((moved - corners)[:, :1])
    # NaN, beyond the horizon of a projection, is not whole either.
    return whole[:, 0] if np.all(np.abs(moved - corners - whole) < WHOLE) else None


def _moved(window, first, grid, frame, step):
    corners, moved = _corners(window, first, grid, frame)
    if step is None:
        low, high = np.floor(moved.min(axis=1)), np.ceil(moved.max(axis=1))
    else:
        low, high = (corners[:, k] + step for k in (0, 3))
    size = np.array(grid.shape[::-1])
    if not (np.all(low < size) and np.all(high >= 0)):
        raise ValueError(
            f"{grid.name}: nothing of the region lies in it; leave it out, or read all "
            "of the images"
        )
    (x0, y0), (x1, y1) = np.maximum(low, 0), np.minimum(high, size - 1)
    return slice(int(y0), int(y1) + 1), slice(int(x0), int(x1) + 1)
