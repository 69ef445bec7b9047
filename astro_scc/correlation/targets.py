# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A block of pairs of epochs: its patterns, and the target planes around them."""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from astro_scc.correlation.zncc import Template
from astro_scc.decomposition import SSPs

#: Pixels of windows transformed at once; more would not fit into the processor's cache.
BATCH_PIXELS = 150_000


@dataclass(frozen=True, eq=False, repr=False)
class Patterns:
    """SSPs, their indices in the catalogue of all epochs, and their pixel values."""

    ssps: SSPs
    index: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, decompositions):
        """Return all SSPs with their values from the decompositions."""
        values = [np.empty(0, np.float32)]
        for d in decompositions:
            plane = np.searchsorted(d.scales, d.ssps.scale)
            at = np.repeat(plane, d.ssps.n_pixels), d.ssps.pixels
            values.append(d.planes.reshape(len(d.scales), -1)[at])
        ssps = SSPs.of_epochs(decompositions)
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


class PairBlock:
    """
    Some pairs of epochs, with everything needed to correlate them.

    It can be pickled, and is all that `match_block` needs.  ``settings`` are a
    `Correlator`, ``patterns`` the SSPs of the reference epochs.  The targets are the
    planes of ``epochs`` on all ``scales`` in a window that may extend beyond the images
    of this ``shape``.  They are either ``segments``, SSPs outside of which the planes
    are zero, or ``planes``, their part in the window as it is, which is ``inside`` it.
    ``valid`` are the pixels of the window that are not missing, for each different
    mask, and ``mask`` numbers those of the targets.
    """

    def __init__(
        self, settings, pairs, reach, chosen, patterns, decompositions, origin, size
    ):
        self.settings, self.pairs, self.reach = settings, pairs, reach
        self.epochs, reference = np.unique(pairs[:, 1]), patterns.ssps.epoch
        own = [decompositions[epoch] for epoch in self.epochs]
        self.scales, self.noise = own[0].scales, [d.noise for d in own]
        self.shape, self.origin = own[0].planes.shape[1:], origin
        self.patterns = patterns.select(chosen & np.isin(reference, pairs[:, 0]))
        # The overlap of the images and the window, as slices of both.
        ends = np.clip([origin, origin + size], 0, self.shape)
        part, self.inside = (
            tuple(slice(*axis) for axis in axes.T.tolist())
            for axes in (ends, ends - origin)
        )
        self.segments = self.planes = None
        if settings.target == "segments":
            self.segments = patterns.select(np.isin(reference, self.epochs))
        else:
            self.planes = [d.planes[:, *part] for d in own]
        valid, number = np.zeros((len(own), *size), dtype=bool), {}
        for pixels, d in zip(valid, own, strict=True):
            pixels[self.inside] = True if d.mask is None else ~d.mask[part]
        mask = [number.setdefault(pixels.tobytes(), len(number)) for pixels in valid]
        self.mask, first = np.array(mask), np.unique(mask, return_index=True)[1]
        self.valid = valid[first]


class TargetStack:
    """The target planes of a block on one scale, from which windows are cut."""

    def __init__(self, block, scale):
        self.block, self.scale = block, block.scales.index(scale)
        n, (ny, nx) = len(block.epochs), block.valid.shape[1:]
        self.values = np.zeros((n, ny, nx), dtype=np.float32)
        # Boxes beyond which the planes of their owners are zero.
        if block.segments is None:
            self.boxes, self.owner = np.tile([0, 0, ny, nx], (n, 1)), np.arange(n)
            for own, planes in zip(self.values, block.planes, strict=True):
                own[block.inside] = planes[self.scale]
        else:
            segments = block.segments.select(block.segments.ssps.scale == scale)
            self.boxes = segments.ssps.bbox - np.tile(block.origin, 2)
            self.owner = np.searchsorted(block.epochs, segments.ssps.epoch)
            epoch = np.repeat(self.owner, segments.ssps.n_pixels)
            y, x = np.divmod(segments.ssps.pixels, block.shape[1])
            y, x = y - block.origin[0], x - block.origin[1]
            on = (y >= 0) & (y < ny) & (x >= 0) & (x < nx)
            self.values[epoch[on], y[on], x[on]] = segments.values[on]

    def displacements(self, box, search_radius):
        """
        Return the displacements at which an SSP may overlap a target SSP.

        They are given by their middle and half their range, which is None if there
        are none.  Coefficients are zero at all other displacements.  One more of
        these is included on every side, so that no maximum lies at the border.
        """
        box = box - np.tile(self.block.origin, 2)
        touch = self._touching(box[:2] - search_radius, box[2:] + search_radius)
        if not touch.any():
            return None, None
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
        owners = self.owner[self._touching(corner, corner + shape)]
        return np.bincount(owners, minlength=len(self.values)) > 0

    def coefficients(self, targets, corner, template):
        """
        Yield targets in batches, with their coefficients and `Overlap`.

        Those of a batch miss the same pixels; without an overlap they miss none.
        """
        (y, x), (h, w), (ny, nx) = corner, template.fft_shape, template.window_shape
        valid, number = self.block.valid, self.block.mask[targets]
        whole = valid[:, y : y + ny, x : x + nx].all(axis=(1, 2))[number]
        batch = max(BATCH_PIXELS // (h * w), 1)
        for k in (*np.unique(number[~whole]), None):
            alike, overlap = targets[whole], None
            if k is not None:
                alike, pixels = targets[number == k], valid[k, y : y + h, x : x + w]
                overlap = template.overlap(pixels, self.block.settings.min_overlap)
            for start in range(0, len(alike), batch):
                some = alike[start : start + batch]
                windows = self.values[some, y : y + h, x : x + w].astype(float)
                yield some, template.of_windows(windows, overlap), overlap

    def snr(self, target, y, x):
        """Return the largest value in 3 x 3 pixels around positions, over the noise."""
        block, (ny, nx) = self.block, self.block.shape
        y = np.clip(np.rint(y).astype(int), 0, ny - 1)
        x = np.clip(np.rint(x).astype(int), 0, nx - 1)
        sigma = np.empty(len(y))
        for k in np.unique(target):
            own, noise = target == k, block.noise[k][self.scale]
            sigma[own] = np.broadcast_to(noise, block.shape)[y[own], x[own]]
        y0, x0 = block.origin + 1
        around = sliding_window_view(self.values, (3, 3), axis=(1, 2))
        around = around[target, y - y0, x - x0]
        return np.maximum(around.max(axis=(1, 2)), 0) / sigma
