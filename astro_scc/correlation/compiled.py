# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Correlation coefficients summed pixel by pixel, compiled by numba.

SSPs are much smaller than the windows in which they are searched for, and a
segmented plane is mostly empty, so a compiled sum over the pixels of an SSP
is faster than transforms.  Importing this module requires numba.
"""

import numpy as np
from numba import njit

from astro_scc.correlation.zncc import VARIANCE_FLOOR

#: Sums of up to this times N log2(N) products are faster than transforms of N
#: pixels.
WORTH = 40.0
#: Options for short loops, which are compiled where they are called.
PART = {"error_model": "numpy", "inline": "always"}


def _kept(function):
    """Compile a function, and cache it for other processes if possible."""
    try:
        return njit(error_model="numpy", cache=True)(function)
    except RuntimeError:  # no folder is writable
        return njit(error_model="numpy")(function)


def worth_it(template):
    """Return whether summing is faster than transforms."""
    n = np.prod(template.fft_shape)
    return template.n_pixels * np.prod(template.result_shape) < WORTH * n * np.log2(n)


def compiled_coefficients(stack, targets, corner, template):
    """
    Return the coefficients of a template in some images of a stack.

    Except for rounding, they equal those of ``template.of_windows`` for windows that
    begin at ``corner`` and have no missing pixel.
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
        VARIANCE_FLOOR,
        result,
    )
    return result


def _runs(footprint):
    """Return a footprint's runs: row, first column, end column, and pixels before."""
    edges = np.diff(np.pad(footprint, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, first = np.nonzero(edges == 1)
    last = np.nonzero(edges == -1)[1]
    before = np.cumsum(last - first) - (last - first)
    return np.stack([row, first, last, before], axis=1)


@njit(**PART)
def _extent(line):
    """Return where the values that are not zero begin and end."""
    begin, end = 0, len(line)
    while begin < end and line[begin] == 0:
        begin += 1
    while end > begin and line[end - 1] == 0:
        end -= 1
    return begin, end


@njit(**PART)
def _accumulate(line, begin, end, sums, squares):
    """Write the sums of values, and of squares, to the left of each pixel."""
    sums[: begin + 1] = 0.0
    squares[: begin + 1] = 0.0
    total, square = 0.0, 0.0
    for x in range(begin, end):
        total += line[x]
        square += line[x] * line[x]
        sums[x + 1], squares[x + 1] = total, square
    sums[end + 1 :] = total
    squares[end + 1 :] = square


@njit(**PART)
def _normalise(covariance, total, square, share, floor, result):
    for x in range(len(result)):
        variance = square[x] - total[x] * total[x] * share
        # Without a branch the compiler can vectorise this.
        result[x] = covariance[x] / np.sqrt(variance if variance > floor else np.inf)


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
    # Four at a time, so that the result is read and written less often.
    for i in range(0, done, 4):
        a, b, c, d = values[i], values[i + 1], values[i + 2], values[i + 3]
        own = line[i : i + n + 3]
        for x in range(n):
            result[x] += a * own[x] + b * own[x + 1] + c * own[x + 2] + d * own[x + 3]
    for i in range(done, len(values)):
        own = line[i : i + n]
        for x in range(n):
            result[x] += values[i] * own[x]


@_kept
def _sum_up(stack, targets, corner, shape, runs, values, least, result):
    height, width = shape
    share = 1 / len(values)
    _, ny, nx = result.shape
    image = np.zeros((height, width))
    # Sums to the left of each pixel: one subtraction gives the sum over a run.
    sums, squares = np.zeros((height, width + 1)), np.zeros((height, width + 1))
    # Columns where the values of a row that are not zero begin and end.
    begin, end = np.zeros(height, np.int64), np.zeros(height, np.int64)
    covariance, total, square = np.zeros(nx), np.zeros(nx), np.zeros(nx)
    for t in range(len(targets)):
        energy = 0.0
        for y in range(height):
            line = stack[targets[t], corner[0] + y, corner[1] : corner[1] + width]
            begin[y], end[y] = _extent(line)
            if begin[y] == end[y]:
                continue
            image[y, :] = line
            _accumulate(image[y], begin[y], end[y], sums[y], squares[y])
            energy += squares[y, width]
        for dy in range(ny):
            covariance[:], total[:], square[:] = 0.0, 0.0, 0.0
            nothing = True
            for r in range(len(runs)):
                row, first, last, before = (
                    runs[r, 0], runs[r, 1], runs[r, 2], runs[r, 3],
                )  # fmt: skip
                y = row + dy
                low = max(0, begin[y] - last + 1)
                high = min(nx, end[y] - first)
                if low >= high:
                    continue
                nothing = False
                first, last, n = first + low, last + low, last - first
                _difference(sums[y], first, last, total[low:high])
                _difference(squares[y], first, last, square[low:high])
                _product(
                    image[y, first:], values[before : before + n], covariance[low:high]
                )
            if nothing:
                result[t, dy, :] = 0.0
            else:
                _normalise(
                    covariance, total, square, share, least * energy, result[t, dy]
                )
