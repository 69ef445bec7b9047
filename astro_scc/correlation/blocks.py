# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Blocks of pairs of epochs: the unit of work of a correlation."""

from dataclasses import dataclass

import numpy as np

from astro_scc.correlation.peaks import find_peaks
from astro_scc.correlation.zncc import Template, fft_shape

__all__ = ["PairBlock", "Patterns", "Targets", "match_block"]

#: Windows transformed at once: more of them leave the cache.
BATCH = 10
#: Transforms of a batch are kept below this number of pixels.
BATCH_PIXELS = 2_000_000


@dataclass(frozen=True, eq=False, repr=False)
class Patterns:
    """
    SSPs of some epochs with the values of their planes.

    Attributes
    ----------
    index : `~numpy.ndarray` of int, shape (n,)
        Index in the catalogue of all epochs.
    epoch, level : `~numpy.ndarray` of int, shape (n,)
        Epoch, and number of the plane.
    y, x : `~numpy.ndarray`, shape (n,)
        Maximum.
    bbox : `~numpy.ndarray` of int, shape (n, 4)
    starts : `~numpy.ndarray` of int, shape (n + 1,)
    rows, columns, values : `~numpy.ndarray`, shape (starts[-1],)
        Pixels of all SSPs.
    """

    index: np.ndarray
    epoch: np.ndarray
    level: np.ndarray
    y: np.ndarray
    x: np.ndarray
    bbox: np.ndarray
    starts: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray

    def __len__(self):
        return len(self.index)

    @classmethod
    def of(cls, decompositions, ssps, indices):
        """
        Take SSPs out of the catalogue of all epochs.

        Parameters
        ----------
        decompositions : sequence of `~astro_scc.decomposition.Decomposition`
        ssps : `~astro_scc.decomposition.SSPs`
        indices : array_like of int

        Returns
        -------
        `Patterns`
        """
        scales = decompositions[0].scales if decompositions else ()
        shape = decompositions[0].planes.shape[1:] if decompositions else (1, 1)
        level = np.array([scales.index(s) for s in ssps.scale[indices]], dtype=int)
        flat = [ssps.pixels_of(i) for i in indices]
        values = [
            decompositions[ssps.epoch[i]].planes[k].ravel()[pixels]
            for i, k, pixels in zip(indices, level, flat, strict=True)
        ]
        rows, columns = np.unravel_index(_joined(flat, np.int64), shape)
        return cls(
            index=np.asarray(indices, dtype=int),
            epoch=ssps.epoch[indices].astype(int),
            level=level,
            y=ssps.y[indices],
            x=ssps.x[indices],
            bbox=ssps.bbox[indices],
            starts=np.concatenate([[0], np.cumsum([len(f) for f in flat])]).astype(int),
            rows=rows.astype(np.int32),
            columns=columns.astype(np.int32),
            values=_joined(values, np.float32),
        )

    def select(self, keep):
        """
        A selection of the SSPs.

        Parameters
        ----------
        keep : array_like of int

        Returns
        -------
        `Patterns`
        """
        keep = np.asarray(keep, dtype=int)
        count = np.diff(self.starts)[keep]
        starts = np.concatenate([[0], np.cumsum(count)])
        pixels = np.arange(starts[-1]) + np.repeat(
            self.starts[keep] - starts[:-1], count
        )
        return Patterns(
            *(
                getattr(self, name)[keep]
                for name in ("index", "epoch", "level", "y", "x", "bbox")
            ),
            starts,
            self.rows[pixels],
            self.columns[pixels],
            self.values[pixels],
        )

    def template(self, i, ring):
        """
        One SSP as a template.

        Parameters
        ----------
        i : int
        ring : tuple of int
            Largest displacement.

        Returns
        -------
        `~astro_scc.correlation.Template`
        """
        y0, x0, y1, x1 = self.bbox[i]
        own = slice(self.starts[i], self.starts[i + 1])
        inside = self.rows[own] - y0, self.columns[own] - x0
        footprint = np.zeros((y1 - y0, x1 - x0), dtype=bool)
        footprint[inside] = True
        values = np.zeros(footprint.shape)
        values[inside] = self.values[own]
        return Template(values, footprint, ring)


def _joined(parts, dtype):
    return np.concatenate([np.empty(0, dtype), *parts]).astype(dtype)


@dataclass(frozen=True, eq=False, repr=False)
class Targets:
    """
    What the images of some epochs hold on all scales.

    Attributes
    ----------
    epochs : `~numpy.ndarray` of int, shape (n,)
    shape : tuple of int
        Of the images.
    patterns : `Patterns` or None
        Their SSPs, nothing else counts; or
    planes : sequence of `~numpy.ndarray`, shape (n_scales, h, w), or None
        the planes as they are.
    part : tuple of slice
        The part of the images that ``planes`` hold.
    noise : sequence of tuple
        Noise of the planes of each epoch, numbers or maps.
    masks : sequence of `~numpy.ndarray` of bool
        The different masks.
    mask : `~numpy.ndarray` of int, shape (n,)
        Mask of each epoch, -1 for none.
    """

    epochs: np.ndarray
    shape: tuple
    patterns: Patterns | None
    planes: tuple | None
    part: tuple
    noise: tuple
    masks: tuple
    mask: np.ndarray

    @classmethod
    def of(cls, decompositions, epochs, part, patterns=None):
        """
        Take epochs out of the decompositions.

        Parameters
        ----------
        decompositions : sequence of `~astro_scc.decomposition.Decomposition`
        epochs : array_like of int
        part : tuple of slice
            The part of the images that is needed.
        patterns : `Patterns`, optional
            Of all epochs; the planes are the target without them.

        Returns
        -------
        `Targets`
        """
        epochs = np.asarray(epochs, dtype=int)
        masks, mask = [], []
        for epoch in epochs:
            own = decompositions[epoch].mask
            if own is None:
                mask.append(-1)
                continue
            same = [
                k for k, m in enumerate(masks) if m is own or np.array_equal(m, own)
            ]
            if not same:
                masks.append(own)
            mask.append(same[0] if same else len(masks) - 1)
        planes = None
        if patterns is None:
            planes = tuple(decompositions[e].planes[:, *part] for e in epochs)
        else:
            patterns = patterns.select(np.flatnonzero(np.isin(patterns.epoch, epochs)))
        return cls(
            epochs=epochs,
            shape=decompositions[0].planes.shape[1:],
            patterns=patterns,
            planes=planes,
            part=part,
            noise=tuple(decompositions[e].noise for e in epochs),
            masks=tuple(masks),
            mask=np.array(mask, dtype=int),
        )


@dataclass(frozen=True, eq=False, repr=False)
class PairBlock:
    """
    Some pairs of epochs, with all that correlating them takes.

    It can be pickled, and `match_block` needs nothing else.

    Attributes
    ----------
    patterns : `Patterns`
        SSPs of the reference epochs.
    targets : `Targets`
    pairs : `~numpy.ndarray` of int, shape (n_pairs, 2)
        Reference and target epochs.
    reach : tuple of int
        Largest displacement in pixels, of (y, x).
    kappa, min_overlap : float
        See `~astro_scc.correlation.Correlator`.
    """

    patterns: Patterns
    targets: Targets
    pairs: np.ndarray
    reach: tuple
    kappa: float
    min_overlap: float

    def __repr__(self):
        return f"<PairBlock: {len(self.patterns)} SSPs, {len(self.pairs)} pairs>"


def match_block(block):
    """
    Correlate the pairs of epochs of a block.

    Parameters
    ----------
    block : `PairBlock`

    Returns
    -------
    tuple of `~numpy.ndarray`, shape (n_matches,)
        Columns of `~astro_scc.correlation.Matches`, by SSP and then by
        target.
    """
    n = len(block.targets.epochs)
    place = {epoch: k for k, epoch in enumerate(block.targets.epochs.tolist())}
    wanted = {}
    for reference, target in block.pairs.tolist():
        wanted.setdefault(reference, np.zeros(n, bool))[place[target]] = True
    columns = []
    for level in np.unique(block.patterns.level):
        at = np.flatnonzero(block.patterns.level == level)
        columns += _match_level(block, block.patterns.select(at), level, wanted)
    parts = (np.concatenate([c[k] for c in columns]) for k in range(7))
    joined = [
        part.astype(kind) for part, kind in zip(parts, KINDS, strict=True)
    ] if columns else [np.empty(0, kind) for kind in KINDS]  # fmt: skip
    order = np.lexsort((joined[1], joined[0]))
    return tuple(column[order] for column in joined)


KINDS = (np.int32, np.int16, *(np.float32,) * 5)


def _match_level(block, patterns, level, wanted):
    # One more ring makes maxima at the largest displacement genuine.
    ring = tuple(r + 1 for r in block.reach)
    corners = patterns.bbox[:, :2] - ring
    canvas = _Canvas(block.targets, level, *window_bounds(patterns.bbox, ring))
    columns = []
    for i, corner in enumerate(corners):
        use = wanted.get(int(patterns.epoch[i]))
        template = patterns.template(i, ring)
        if use is None or template.energy == 0:
            continue
        use = use & canvas.not_empty(corner, template.fft_shape)
        batch = int(np.clip(BATCH_PIXELS // np.prod(template.fft_shape), 1, BATCH))
        for some, valid in canvas.alike(np.flatnonzero(use), corner, template):
            overlap = None
            if valid is not None:
                overlap = template.overlap(valid, block.min_overlap)
            for start in range(0, len(some), batch):
                targets = some[start : start + batch]
                windows = canvas.windows(targets, corner, template.fft_shape)
                coefficient = template.of_windows(windows, overlap)
                which, y, x, value = find_peaks(coefficient, block.kappa)
                if len(which) == 0:
                    continue
                share = np.ones(len(which))
                if overlap is not None:
                    share = overlap.share[
                        np.rint(y).astype(int), np.rint(x).astype(int)
                    ]
                columns.append(
                    (
                        np.full(len(which), i),
                        targets[which],
                        y - ring[0],
                        x - ring[1],
                        value,
                        share,
                    )
                )
    if not columns:
        return []
    i, target, dy, dx, value, share = map(np.concatenate, zip(*columns, strict=True))
    snr = canvas.snr(target, patterns.y[i] + dy, patterns.x[i] + dx)
    epoch = block.targets.epochs[target]
    return [(patterns.index[i], epoch, dy, dx, value, share, snr)]


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


class _Canvas:
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

    def windows(self, targets, corner, shape):
        """Windows at a corner in double precision, shape (n, h, w)."""
        window = self._window(corner, shape)
        result = np.empty((len(targets), *shape))
        for own, target in zip(result, targets, strict=True):
            own[:] = self.stack[target][window]
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
