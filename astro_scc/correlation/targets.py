# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The patterns and the target planes of a block of pairs of epochs."""

from dataclasses import dataclass

import numpy as np

from astro_scc.correlation.zncc import Template
from astro_scc.decomposition import SSPs

#: Windows transformed at once; more would not fit into the processor's cache.
BATCH = 10
#: Largest number of pixels in the transforms of a batch.
BATCH_PIXELS = 2_000_000
#: Windows that compiled loops process at once.
COMPILED_BATCH = 64


def image_part(shape, origin, size):
    """Return the slices of a box, clipped to an image of a shape."""
    low = np.clip(origin, 0, shape).tolist()
    high = np.clip(np.add(origin, size), 0, shape).tolist()
    return tuple(map(slice, low, high))


def _moved(part, origin):
    """Return slices relative to another origin."""
    return tuple(
        slice(int(p.start - o), int(p.stop - o))
        for p, o in zip(part, origin, strict=True)
    )


@dataclass(frozen=True, eq=False, repr=False)
class Patterns:
    """SSPs, their indices in the catalogue of all epochs, and their pixel values."""

    ssps: SSPs
    index: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, decompositions, ssps):
        """Return all SSPs with their values from the decompositions."""
        values = [np.empty(0, np.float32)]
        for i, (epoch, scale) in enumerate(zip(ssps.epoch, ssps.scale, strict=True)):
            own = decompositions[epoch]
            values.append(own.planes[own.plane_index(scale)].flat[ssps.pixels_of(i)])
        return cls(ssps, np.arange(len(ssps)), np.concatenate(values, dtype=np.float32))

    def select(self, keep):
        """Return the patterns for which ``keep`` is true."""
        values = self.values[np.repeat(keep, self.ssps.n_pixels)]
        return Patterns(self.ssps.select(keep), self.index[keep], values)

    def template(self, i, width, search_radius):
        """Return one SSP as a `Template`; ``width`` is that of the images."""
        y0, x0, y1, x1 = self.ssps.bbox[i]
        rows, columns = np.divmod(self.ssps.pixels_of(i), width)
        inside = rows - y0, columns - x0
        footprint = np.zeros((y1 - y0, x1 - x0), dtype=bool)
        footprint[inside] = True
        values = np.zeros(footprint.shape)
        values[inside] = self.values[self.ssps.starts[i] : self.ssps.starts[i + 1]]
        return Template(values, footprint, search_radius)


@dataclass(frozen=True, eq=False, repr=False)
class Targets:
    """
    The target planes of some epochs on all scales.

    They are either ``patterns``, SSPs outside of which the planes are zero, or
    ``planes``, a ``part`` of the planes as they are.  Equal ``masks`` are one object.
    """

    epochs: np.ndarray
    scales: tuple
    shape: tuple
    part: tuple
    patterns: Patterns | None
    planes: tuple | None
    noise: tuple
    masks: tuple

    @classmethod
    def of(cls, decompositions, epochs, part, patterns):
        """Return the targets of some epochs, with planes if there are no patterns."""
        own, masks = [decompositions[epoch] for epoch in epochs], []
        for mask in (d.mask for d in own):
            masks.append(next((m for m in masks if np.array_equal(m, mask)), mask))
        planes = None
        if patterns is None:
            planes = tuple(d.planes[:, *part] for d in own)
        else:
            patterns = patterns.select(np.isin(patterns.ssps.epoch, epochs))
        noise, shape = tuple(d.noise for d in own), own[0].planes.shape[1:]
        scales = own[0].scales
        return cls(epochs, scales, shape, part, patterns, planes, noise, tuple(masks))


class TargetStack:
    """The padded target planes of one scale, from which windows are cut."""

    def __init__(self, targets, scale, origin, size):
        self.origin, self.shape = origin, targets.shape
        image = image_part(targets.shape, origin, size)
        inside = _moved(image, origin)
        plane = targets.scales.index(scale)
        self.noise = [noise[plane] for noise in targets.noise]
        self.values = np.zeros((len(targets.epochs), *size), dtype=np.float32)
        self.boxes = self.owner = None
        if targets.patterns is None:
            part = _moved(image, [p.start for p in targets.part])
            for own, planes in zip(self.values, targets.planes, strict=True):
                own[inside] = planes[plane][part]
        else:
            self._draw(targets, scale)
        # Valid pixels for each different mask, and the index of each target's mask.
        self.valid, numbers = [], {}
        for mask in targets.masks:
            if id(mask) not in numbers:
                numbers[id(mask)] = len(self.valid)
                self.valid.append(np.zeros(size, dtype=bool))
                self.valid[-1][inside] = True if mask is None else ~mask[image]
        self.number = np.array([numbers[id(mask)] for mask in targets.masks])
        for own, number in zip(self.values, self.number, strict=True):
            own[~self.valid[number]] = 0

    def _draw(self, targets, scale):
        patterns = targets.patterns.select(targets.patterns.ssps.scale == scale)
        self.boxes = patterns.ssps.bbox - np.tile(self.origin, 2)
        self.owner = np.searchsorted(targets.epochs, patterns.ssps.epoch)
        epoch = np.repeat(self.owner, patterns.ssps.n_pixels)
        y, x = np.divmod(patterns.ssps.pixels, self.shape[1])
        y, x = y - self.origin[0], x - self.origin[1]
        _, ny, nx = self.values.shape
        on = (y >= 0) & (y < ny) & (x >= 0) & (x < nx)
        self.values[epoch[on], y[on], x[on]] = patterns.values[on]

    def displacements(self, box, search_radius):
        """
        Return the displacements at which an SSP may overlap a target SSP.

        They are given by their middle and half their range, which is None if there
        are none.  Coefficients are zero at all other displacements.  One more of
        these is included on every side, so that no maximum lies at the border.
        """
        middle = np.zeros(2, int)
        if self.boxes is None:
            return middle, search_radius
        box = box - np.tile(self.origin, 2)
        touch = self._touching(box[:2] - search_radius, box[2:] + search_radius)
        if not touch.any():
            return middle, None
        low = self.boxes[touch, :2].min(axis=0) - box[2:]
        high = self.boxes[touch, 2:].max(axis=0) - box[:2]
        low, high = np.maximum(low, -search_radius), np.minimum(high, search_radius)
        half = (high - low + 1) // 2
        # If their number is even, one more is added, but not beyond the radius.
        return np.minimum(low + half, search_radius - half), half

    def _touching(self, low, high):
        return ((self.boxes[:, :2] < high) & (self.boxes[:, 2:] > low)).all(axis=1)

    def not_empty(self, corner, shape):
        """Return which targets may have values in a window."""
        if self.boxes is None:
            return np.ones(len(self.values), dtype=bool)
        owners = self.owner[self._touching(corner, corner + shape)]
        return np.bincount(owners, minlength=len(self.values)) > 0

    def alike(self, targets, corner, template, min_overlap):
        """Return groups of targets that miss the same pixels, with their `Overlap`."""
        (y, x), (h, w) = corner, template.fft_shape
        number, whole, groups = self.number[targets], [], []
        for k in np.unique(number):
            own, valid = targets[number == k], self.valid[k][y : y + h, x : x + w]
            ny, nx = template.window_shape
            if valid[:ny, :nx].all():
                whole.append(own)
            else:
                groups.append((own, template.overlap(valid, min_overlap)))
        if whole:
            groups.append((np.sort(np.concatenate(whole)), None))
        return groups

    def coefficients(self, targets, corner, template, overlap, compiled):
        """Yield the targets in batches, with their coefficients."""
        shape = template.fft_shape
        batch = int(np.clip(BATCH_PIXELS // np.prod(shape), 1, BATCH))
        if compiled:
            from astro_scc.correlation.compiled import compiled_coefficients, worth_it

            compiled = worth_it(template)
            batch = COMPILED_BATCH if compiled else batch
        for start in range(0, len(targets), batch):
            some = targets[start : start + batch]
            if compiled:
                yield some, compiled_coefficients(self.values, some, corner, template)
            else:
                (y, x), (h, w) = corner, shape
                part = self.values[some, y : y + h, x : x + w]
                windows = np.zeros((len(some), *shape))
                windows[:, : part.shape[1], : part.shape[2]] = part
                yield some, template.of_windows(windows, overlap)

    def snr(self, target, y, x):
        """Return the largest value in 3 x 3 pixels around positions, over the noise."""
        ny, nx = self.shape
        y = np.clip(np.rint(y).astype(int), 0, ny - 1)
        x = np.clip(np.rint(x).astype(int), 0, nx - 1)
        sigma = np.empty(len(y))
        for k in np.unique(target):
            own = target == k
            sigma[own] = np.broadcast_to(self.noise[k], self.shape)[y[own], x[own]]
        step = np.arange(-1, 2)
        rows = (y - self.origin[0])[:, None, None] + step[:, None]
        columns = (x - self.origin[1])[:, None, None] + step
        around = self.values[target[:, None, None], rows, columns]
        return np.maximum(around.max(axis=(1, 2)), 0) / sigma
