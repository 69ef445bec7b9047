# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Coefficients summed pixel by pixel, compiled by numba.

Patterns are much smaller than the windows they are looked for in, and a
segmented plane is mostly empty, so that a compiled sum over the pixels of a
pattern takes a third of the time of transforms.  Importing this module takes
the package numba.
"""

import numpy as np
from numba import njit

from astro_scc.correlation.zncc import VARIANCE_FLOOR

__all__ = ["direct_coefficients", "worth_it"]

#: Sums are quicker than transforms of N pixels up to this times N log2(N)
#: products; the two are equal at 12 to 50 times it.
WORTH = 12.0
#: Loops of a few lines are compiled where they are called.
PART = {"error_model": "numpy", "inline": "always"}


def worth_it(template):
    """
    Whether summing is quicker than transforms.

    Parameters
    ----------
    template : `~astro_scc.correlation.Template`

    Returns
    -------
    bool
    """
    n = np.prod(template.fft_shape)
    return template.n_pixels * np.prod(template.result_shape) < WORTH * n * np.log2(n)


def direct_coefficients(stack, targets, corner, template):
    """
    Coefficients of a template at every displacement in some images.

    The same as ``template.of_windows`` of windows that miss no pixel, but
    for rounding.

    Parameters
    ----------
    stack : `~numpy.ndarray`, shape (n, ny, nx)
        Images in single precision.
    targets : `~numpy.ndarray` of int, shape (k,)
        Those that are looked at.
    corner : sequence of int
        Where the window begins, (y, x).
    template : `~astro_scc.correlation.Template`

    Returns
    -------
    `~numpy.ndarray`, shape (k, 2 ry + 1, 2 rx + 1)
    """
    result = np.empty((len(targets), *template.result_shape))
    footprint = template.footprint > 0
    _sum_up(
        stack,
        np.asarray(targets, dtype=np.int64),
        (int(corner[0]), int(corner[1])),
        template.window_shape,
        _runs(footprint),
        template.values[footprint],
        result,
    )
    return result


def _runs(footprint):
    """Rows of a footprint: row, first and last column, and pixels before."""
    edges = np.diff(np.pad(footprint, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, first = np.nonzero(edges == 1)
    last = np.nonzero(edges == -1)[1]
    before = np.cumsum(last - first) - (last - first)
    return np.stack([row, first, last, before], axis=1)


@njit(**PART)
def _difference(sums, first, last, result):
    n = len(result)
    low, high = sums[first : first + n], sums[last : last + n]
    for x in range(n):
        result[x] += high[x] - low[x]


@njit(**PART)
def _product(line, values, result):
    n = len(result)
    done = len(values) // 4 * 4
    # Four at a time: the result is read and written less often.
    for i in range(0, done, 4):
        a, b, c, d = values[i], values[i + 1], values[i + 2], values[i + 3]
        own = line[i : i + n + 3]
        for x in range(n):
            result[x] += a * own[x] + b * own[x + 1] + c * own[x + 2] + d * own[x + 3]
    for i in range(done, len(values)):
        own = line[i : i + n]
        for x in range(n):
            result[x] += values[i] * own[x]


@njit(error_model="numpy")
def _sum_up(stack, targets, corner, shape, runs, values, result):
    height, width = shape
    share = 1 / len(values)
    _, ny, nx = result.shape
    image = np.zeros((height, width))
    # Sums of all pixels to the left: one subtraction sums up a run.
    sums, squares = np.zeros((height, width + 1)), np.zeros((height, width + 1))
    empty = np.zeros(height, np.bool_)
    covariance, total, square = np.zeros(nx), np.zeros(nx), np.zeros(nx)
    for t in range(len(targets)):
        energy = 0.0
        for y in range(height):
            line = stack[targets[t], corner[0] + y]
            for x in range(width):
                value = np.float64(line[corner[1] + x])
                image[y, x] = value
                sums[y, x + 1] = sums[y, x] + value
                squares[y, x + 1] = squares[y, x] + value * value
            empty[y] = squares[y, width] == 0.0
            energy += squares[y, width]
        for dy in range(ny):
            covariance[:], total[:], square[:] = 0.0, 0.0, 0.0
            for r in range(len(runs)):
                row, first, last, before = (
                    runs[r, 0], runs[r, 1], runs[r, 2], runs[r, 3],
                )  # fmt: skip
                if empty[row + dy]:
                    continue
                _difference(sums[row + dy], first, last, total)
                _difference(squares[row + dy], first, last, square)
                _product(
                    image[row + dy, first:],
                    values[before : before + last - first],
                    covariance,
                )
            for x in range(nx):
                variance = square[x] - total[x] * total[x] * share
                if variance > VARIANCE_FLOOR * energy:
                    result[t, dy, x] = covariance[x] / np.sqrt(variance)
                else:
                    result[t, dy, x] = 0.0
