# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The target planes of a scale, and the windows that are cut from them."""

import numpy as np

from astro_scc.correlation.peaks import find_peaks
from astro_scc.correlation.zncc import fft_shape

__all__ = ["BATCH", "Canvas", "image_part", "window_bounds"]

#: Windows transformed at once: more of them leave the cache.
BATCH = 10
#: Transforms of a batch are kept below this number of pixels.
BATCH_PIXELS = 2_000_000
#: Windows that are summed up directly at once.
DIRECT_BATCH = 64


def window_bounds(bbox, ring):
    """
    The pixels that the windows of some SSPs take in.

    Parameters
    ----------
    bbox : `~numpy.ndarray` of int, shape (n, 4)
        Of the SSPs, at least one.
    ring : tuple of int
        Largest displacement.

    Returns
    -------
    origin : `~numpy.ndarray` of int, shape (2,)
        May be outside the image.
    size : tuple of int
    """
    corners = bbox[:, :2] - ring
    sizes = np.unique(bbox[:, 2:] - bbox[:, :2], axis=0)
    shapes = {tuple(box): fft_shape(box, ring) for box in sizes.tolist()}
    shape = np.array(
        [shapes[tuple(box)] for box in (bbox[:, 2:] - bbox[:, :2]).tolist()]
    )
    # Beside the outermost displacement values are looked up as well.
    origin = corners.min(axis=0) - 2
    return origin, tuple(int(n) for n in (corners + shape).max(axis=0) + 2 - origin)


def image_part(shape, origin, size):
    """
    The part of an image that a box holds.

    Parameters
    ----------
    shape : tuple of int
        Of the image.
    origin, size : sequence of int
        Of the box.

    Returns
    -------
    tuple of slice
    """
    low = np.clip(origin, 0, shape)
    high = np.clip(np.add(origin, size), 0, shape)
    return tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))


def _moved(part, origin):
    """Slices counted from another origin."""
    return tuple(
        slice(int(p.start - o), int(p.stop - o))
        for p, o in zip(part, origin, strict=True)
    )


class Canvas:
    """The target planes of one scale side by side, padded, to cut windows from."""

    def __init__(self, targets, level, origin, size):
        self.targets, self.level, self.origin = targets, level, origin
        ny, nx = targets.shape
        self.image = image_part((ny, nx), origin, size)
        self.inside = _moved(self.image, origin)
        self.stack = np.zeros((len(targets.epochs), *size), dtype=np.float32)
        self.boxes = self.owner = None
        if targets.patterns is None:
            part = _moved(self.image, [p.start for p in targets.part])
            for own, planes in zip(self.stack, targets.planes, strict=True):
                own[self.inside] = planes[level][part]
        else:
            self._draw(targets.patterns)
        for own, kind in zip(self.stack, targets.mask, strict=True):
            if kind >= 0:
                own[self.inside][targets.masks[kind][self.image]] = 0
        self.exists = {}

    def _draw(self, patterns):
        own = patterns.select(np.flatnonzero(patterns.level == self.level))
        self.boxes = own.bbox - np.tile(self.origin, 2)
        self.owner = np.searchsorted(self.targets.epochs, own.epoch)
        epoch = np.repeat(self.owner, np.diff(own.starts))
        y, x = own.rows - self.origin[0], own.columns - self.origin[1]
        _, ny, nx = self.stack.shape
        on = (y >= 0) & (y < ny) & (x >= 0) & (x < nx)
        self.stack[epoch[on], y[on], x[on]] = own.values[on]

    def _window(self, corner, shape):
        y, x = corner - self.origin
        return slice(y, y + shape[0]), slice(x, x + shape[1])

    def displacements(self, box, ring):
        """
        Displacements at which an SSP may fall on anything.

        Coefficients are zero at all others, of which one more on every side
        is taken in, so that no maximum lies at the border.

        Parameters
        ----------
        box : `~numpy.ndarray` of int, shape (4,)
            Of the SSP.
        ring : tuple of int
            Largest displacement.

        Returns
        -------
        middle : `~numpy.ndarray` of int, shape (2,)
        reach : `~numpy.ndarray` of int, shape (2,), or None
            To both sides of the middle; None if there are none.
        """
        ring = np.array(ring)
        if self.boxes is None:
            return np.zeros(2, int), ring
        box = box - np.tile(self.origin, 2)
        touch = (self.boxes[:, :2] < box[2:] + ring) & (
            self.boxes[:, 2:] > box[:2] - ring
        )
        touch = touch.all(axis=1)
        if not touch.any():
            return np.zeros(2, int), None
        low = np.maximum(self.boxes[touch, :2].min(axis=0) - box[2:], -ring)
        high = np.minimum(self.boxes[touch, 2:].max(axis=0) - box[:2], ring)
        reach = (high - low + 1) // 2
        # An odd number of displacements: one more, but not beyond the ring.
        return np.minimum(low + reach, ring - reach), reach

    def not_empty(self, corner, shape):
        """Which targets have anything in a window."""
        result = np.ones(len(self.stack), dtype=bool)
        if self.boxes is not None:
            rows, columns = self._window(corner, shape)
            touch = (self.boxes[:, 0] < rows.stop) & (self.boxes[:, 2] > rows.start)
            touch &= (self.boxes[:, 1] < columns.stop) & (
                self.boxes[:, 3] > columns.start
            )
            result[:] = False
            result[self.owner[touch]] = True
        return result

    def alike(self, targets, corner, template):
        """Groups of targets that miss the same pixels of a window, and which."""
        window = self._window(corner, template.fft_shape)
        h, w = template.window_shape
        mask = self.targets.mask[targets]
        whole, groups = [], []
        for kind in np.unique(mask):
            valid = self._valid(kind)[window]
            if valid[:h, :w].all():
                whole.append(targets[mask == kind])
            else:
                groups.append((targets[mask == kind], valid))
        if whole:
            groups.append((np.sort(np.concatenate(whole)), None))
        return groups

    def _valid(self, kind):
        if kind not in self.exists:
            valid = np.zeros(self.stack.shape[1:], dtype=bool)
            valid[self.inside] = kind < 0 or ~self.targets.masks[kind][self.image]
            self.exists[kind] = valid
        return self.exists[kind]

    def peaks(self, targets, corner, template, threshold, overlap, compiled):
        """Maxima of the coefficients, some targets at a time, and which targets."""
        if compiled and overlap is None:
            from astro_scc.correlation import direct

            if direct.worth_it(template):
                corner = corner - self.origin
                for some in _batches(targets, DIRECT_BATCH):
                    coefficient = direct.direct_coefficients(
                        self.stack, some, corner, template
                    )
                    yield some, direct.direct_peaks(coefficient, threshold)
                return
        shape = template.fft_shape
        batch = int(np.clip(BATCH_PIXELS // np.prod(shape), 1, BATCH))
        for some in _batches(targets, batch):
            coefficient = template.of_windows(
                self._windows(some, corner, shape), overlap
            )
            yield some, find_peaks(coefficient, threshold)

    def _windows(self, targets, corner, shape):
        """Windows at a corner in double precision, shape (n, h, w)."""
        window = self._window(corner, shape)
        result = np.zeros((len(targets), *shape))
        for own, target in zip(result, targets, strict=True):
            part = self.stack[target][window]
            own[: part.shape[0], : part.shape[1]] = part
        return result

    def snr(self, target, y, x):
        """Largest value in 3 x 3 pixels around positions, over the noise."""
        ny, nx = self.targets.shape
        y = np.clip(np.rint(y).astype(int), 0, ny - 1)
        x = np.clip(np.rint(x).astype(int), 0, nx - 1)
        sigma = np.empty(len(y))
        for k in np.unique(target):
            own = target == k
            noise = self.targets.noise[k][self.level]
            sigma[own] = noise if np.ndim(noise) == 0 else noise[y[own], x[own]]
        row, column = y - self.origin[0], x - self.origin[1]
        largest = np.zeros(len(y), dtype=np.float32)
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                np.maximum(
                    largest, self.stack[target, row + dy, column + dx], out=largest
                )
        return largest / sigma


def _batches(items, size):
    return (items[start : start + size] for start in range(0, len(items), size))
