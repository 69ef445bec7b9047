# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Blocks of pairs of epochs: the unit of work of a correlation."""

from dataclasses import dataclass

import numpy as np

from astro_scc.correlation.canvas import Canvas, window_bounds
from astro_scc.correlation.zncc import Template

__all__ = ["PairBlock", "Patterns", "Targets", "match_block"]

#: Of the columns of matches.
KINDS = (np.int32, np.int16, *(np.float32,) * 5)
#: With fewer pixels than these, two of them, anything matches anything.
FEWEST_PIXELS = 3


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
    compiled : bool
        Whether windows may be summed up by compiled loops.

    Examples
    --------
    >>> from astro_scc.correlation import Correlator
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> images = simulate_two_fluid(n_epochs=2, rng=1).cube.data
    >>> epochs = [Decomposer(scales=[2])(image) for image in images]
    >>> blocks = list(Correlator().blocks(epochs, [(0, 1), (1, 0)], (8, 25)))
    >>> sum(len(block.pairs) for block in blocks)
    2
    """

    patterns: Patterns
    targets: Targets
    pairs: np.ndarray
    reach: tuple
    kappa: float
    min_overlap: float
    compiled: bool = False

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

    Examples
    --------
    >>> from astro_scc.correlation import Correlator, match_block
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> images = simulate_two_fluid(n_epochs=2, rng=1).cube.data
    >>> epochs = [Decomposer(scales=[2])(image) for image in images]
    >>> block = next(iter(Correlator().blocks(epochs, [(0, 1)], (8, 25))))
    >>> ssp, target, *others = match_block(block)
    >>> set(target.tolist())
    {1}
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


def _match_level(block, patterns, level, wanted):
    # One more ring makes maxima at the largest displacement genuine.
    ring = tuple(r + 1 for r in block.reach)
    canvas = Canvas(block.targets, level, *window_bounds(patterns.bbox, ring))
    columns = []
    for i, box in enumerate(patterns.bbox):
        use = wanted.get(int(patterns.epoch[i]))
        middle, reach = canvas.displacements(box, ring)
        if use is None or reach is None:
            continue
        template = patterns.template(i, reach)
        if template.energy == 0 or template.n_pixels < FEWEST_PIXELS:
            continue
        corner = box[:2] + middle - reach
        use = use & canvas.not_empty(corner, template.window_shape)
        for some, valid in canvas.alike(np.flatnonzero(use), corner, template):
            overlap = None
            if valid is not None:
                overlap = template.overlap(valid, block.min_overlap)
            found = canvas.peaks(
                some, corner, template, block.kappa, overlap, block.compiled
            )
            for targets, (which, y, x, value) in found:
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
                        y + (middle[0] - reach[0]),
                        x + (middle[1] - reach[1]),
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
