# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Correlation of the SSPs of each epoch with other epochs, and their matches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from astro_scc.correlation.zncc import Template, fft_shape, find_peaks
from astro_scc.decomposition import SSPs
from astro_scc.decomposition.segmentation import Decomposition
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.parallel import in_order
from astro_scc.quantities import CORRELATION, named

COLUMNS = {
    "ssp": np.int32,
    "target": np.int16,
    "dy": np.float32,
    "dx": np.float32,
    "coefficient": np.float32,
    "overlap": np.float32,
    "target_snr": np.float32,
}


@dataclass(frozen=True, eq=False, repr=False)
class Matches:
    """
    Correlation peaks of SSPs with the images of other epochs.

    Displacements are in pixels and do not depend on dates: the matches stay
    the same whatever dates the epochs have or are given in a trial.

    Attributes
    ----------
    ssp : `~numpy.ndarray` of int, shape (n,)
        Index in the catalogue of the SSPs of all epochs.
    target : `~numpy.ndarray` of int, shape (n,)
        Epoch of the image that the SSP was correlated with.
    dy, dx : `~numpy.ndarray`, shape (n,)
        Displacement in pixels from the SSP to its match, sub-pixel.
    coefficient : `~numpy.ndarray`, shape (n,)
        Zero-mean normalised cross-correlation of the peak.
    overlap : `~numpy.ndarray`, shape (n,)
        Fraction of the SSP's pixels that fall on valid pixels.
    target_snr : `~numpy.ndarray`, shape (n,)
        Largest value of the target plane in 3 x 3 pixels around the matched
        position, in units of that plane's noise.
    pairs : `~numpy.ndarray` of int, shape (n_pairs, 2)
        The ordered pairs of epochs that were correlated.

    Examples
    --------
    >>> from astro_scc.correlation import Correlator
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> images = simulate_two_fluid(n_epochs=2, rng=1).cube.data
    >>> epochs = [Decomposer(scales=[2])(image) for image in images]
    >>> matches = Correlator()(epochs, [(0, 1), (1, 0)], (8, 25))
    >>> forward = matches.select(matches.target == 1)
    >>> len(forward) < len(matches), matches.pairs.tolist()
    (True, [[0, 1], [1, 0]])
    """

    ssp: np.ndarray
    target: np.ndarray
    dy: np.ndarray
    dx: np.ndarray
    coefficient: np.ndarray
    overlap: np.ndarray
    target_snr: np.ndarray
    pairs: np.ndarray

    def __len__(self) -> int:
        return len(self.ssp)

    def __repr__(self):
        return f"<Matches: {len(self)} peaks of {len(self.pairs)} pairs of epochs>"

    @classmethod
    def from_columns(
        cls, parts: Sequence[tuple[np.ndarray, ...]], pairs: ArrayLike
    ) -> Matches:
        """
        Join tuples of the columns ``ssp`` to ``target_snr``, and sort them.

        Parameters
        ----------
        parts : sequence of tuple of `~numpy.ndarray`
        pairs : array_like of int, shape (n_pairs, 2)

        Returns
        -------
        `~astro_scc.correlation.Matches`
            Sorted by SSP, then by target.
        """
        columns = zip(*parts, strict=True) if parts else [()] * len(COLUMNS)
        ssp, target, *others = (
            np.concatenate([np.empty(0, kind), *column], dtype=kind, casting="unsafe")
            for kind, column in zip(COLUMNS.values(), columns, strict=True)
        )
        found = cls(ssp, target, *others, np.asarray(pairs, dtype=int).reshape(-1, 2))
        return found.select(np.lexsort((target, ssp)))

    def select(self, keep: ArrayLike) -> Matches:
        """
        Return the matches at some indices, or where ``keep`` is true.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or of int

        Returns
        -------
        `~astro_scc.correlation.Matches`
        """
        return replace(self, **{name: getattr(self, name)[keep] for name in COLUMNS})


def target_ssps(matches: Matches, ssps: SSPs) -> np.ndarray:
    """
    Find the SSP of the target epoch that is nearest to each match.

    Parameters
    ----------
    matches : `~astro_scc.correlation.Matches`
    ssps : `~astro_scc.decomposition.SSPs`
        The SSPs of all epochs.

    Returns
    -------
    `~numpy.ndarray` of int, shape (n_matches,)
        Index in ``ssps`` of the SSP of the same scale whose maximum is
        nearest to the maximum of the matched SSP plus the displacement, if
        they are within one scale; otherwise -1.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.correlation import Correlator, all_pairs
    >>> from astro_scc.correlation.correlate import target_ssps
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> y, x = np.mgrid[:64, :96]
    >>> def image(x0):
    ...     return np.exp(-((x - x0) ** 2 + (y - 32) ** 2) / 30)
    >>> decompose = Decomposer(scales=[2])
    >>> epochs = [decompose(image(x0)) for x0 in (40, 46.5)]
    >>> matches = Correlator()(epochs, all_pairs(2), 12)
    >>> target_ssps(matches, SSPs.of_epochs(epochs)).tolist()
    [1, 0]
    """
    scales, level = np.unique(ssps.scale, return_inverse=True)
    size = np.array([scale_size(scale) for scale in scales])
    n_epochs = 1 + max(ssps.epoch.max(initial=0), matches.target.max(initial=0))
    # On a third axis, SSPs of other scales and epochs are farther than any match.
    apart, own = 2 * size.max(initial=0.0), matches.ssp
    there = ssps.y, ssps.x, apart * (level * n_epochs + ssps.epoch)
    y, x = ssps.y[own] + matches.dy, ssps.x[own] + matches.dx
    here = y, x, apart * (level[own] * n_epochs + matches.target)
    tree = cKDTree(np.stack(there, axis=1))
    distance, nearest = tree.query(np.stack(here, axis=1), distance_upper_bound=apart)
    return np.where(distance <= size[level[own]], nearest, -1)


if TYPE_CHECKING:
    from distributed import Client

#: Pixels of windows that a block correlates, about half a second of work.
BLOCK_WORK = 2**24
#: Bytes of target planes that a block holds.
STACK_BYTES = 2**26
#: Fewest target epochs of a block, if there are so many.
FEWEST_TARGETS = 10
#: Pixels of windows transformed at once; more would not fit into the processor's cache.
BATCH_PIXELS = 150_000
#: Fewest pixels of an SSP: with two pixels anything matches anything.
FEWEST_PIXELS = 3


def all_pairs(n_epochs: int) -> np.ndarray:
    """
    Return every ordered pair of different epochs.

    Parameters
    ----------
    n_epochs : int

    Returns
    -------
    `~numpy.ndarray` of int, shape (n_epochs * (n_epochs - 1), 2)

    Examples
    --------
    >>> from astro_scc.correlation import all_pairs
    >>> all_pairs(3).tolist()
    [[0, 1], [0, 2], [1, 0], [1, 2], [2, 0], [2, 1]]
    """
    return np.argwhere(~np.eye(n_epochs, dtype=bool))


@dataclass(frozen=True)
class Correlator:
    """
    Settings of the correlation of SSPs with the images of other epochs.

    Parameters
    ----------
    kappa : float
        Smallest coefficient of a peak that is kept, 0.6 to 0.8 in the
        paper.
    target : {"segments", "plane"}
        Whether the target is the plane with everything outside its SSPs
        set to zero, or the plane as it is (the paper's equation).
    min_overlap : float
        Fraction of the SSP's pixels that must fall on valid pixels of the
        target image, for a displacement and for its eight neighbours.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    Examples
    --------
    >>> from astro_scc.correlation import Correlator
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> images = simulate_two_fluid(n_epochs=2, rng=1).cube.data
    >>> epochs = [Decomposer(scales=[2])(image) for image in images]
    >>> matches = Correlator(kappa=0.7)(epochs, [(0, 1)], (8, 25))
    >>> bool((matches.coefficient >= 0.7).all())
    True
    """

    kappa: float = 0.6
    target: str = "segments"
    min_overlap: float = 0.8

    def __post_init__(self):
        for name, (check, *limits) in CORRELATION.items():
            value = named(name, check, getattr(self, name), *limits)
            object.__setattr__(self, name, value)

    def __call__(
        self, decompositions: Sequence[Decomposition], pairs: ArrayLike,
        search_radius: int | tuple[int, int], *, select: ArrayLike | None = None,
        n_workers: int | str | Client = 1, progress: Callable[..., Any] | None = None,
    ) -> Matches:  # fmt: skip
        """
        Find the matches of SSPs for ordered pairs of epochs.

        Parameters
        ----------
        decompositions : sequence of ``Decomposition``
            One for each epoch, with images of one shape and the same scales.
        pairs : array_like of int, shape (n_pairs, 2)
            Reference and target epoch.
        search_radius : int or tuple of int
            Largest displacement in pixels; two numbers are for (y, x).
        select : array_like of bool, optional
            Which SSPs of the catalogue of all epochs to correlate.
        n_workers : int, str or `dask.distributed.Client`, optional
            Number of processes, or a Dask scheduler, given by its address or
            a client.  With more than one process, a script needs
            ``if __name__ == "__main__":`` where processes are spawned, see
            `multiprocessing`.
        progress : callable, optional
            Called with 1 for each reference epoch that is done.

        Returns
        -------
        `~astro_scc.correlation.Matches`
            Its ``ssp`` are indices into ``SSPs.of_epochs(decompositions)``.

        Raises
        ------
        ValueError
            If pairs name epochs that do not exist, decompositions differ
            in shape or scales, or the search radius or ``n_workers`` is not as
            described.

        Examples
        --------
        >>> import numpy as np
        >>> from astro_scc.correlation import Correlator, all_pairs
        >>> from astro_scc.decomposition import Decomposer
        >>> y, x = np.mgrid[:64, :96]
        >>> def image(x0):
        ...     return np.exp(-((x - x0) ** 2 + (y - 32) ** 2) / 30)
        >>> decompose = Decomposer(scales=[2])
        >>> epochs = [decompose(image(x0)) for x0 in (40, 46.5)]
        >>> matches = Correlator()(epochs, all_pairs(2), 12)
        >>> matches.dx.round(1)
        array([ 6.5, -6.5], dtype=float32)
        """
        if len({(d.planes.shape, d.scales) for d in decompositions}) > 1:
            raise ValueError("all epochs must have one shape and the same scales")
        pairs = np.unique(np.asarray(pairs, dtype=int).reshape(-1, 2), axis=0)
        if not np.all((pairs >= 0) & (pairs < len(decompositions))):
            last = len(decompositions) - 1
            raise ValueError(f"pairs name epochs outside 0 to {last}")
        reach = np.ravel(search_radius)
        if len(reach) not in (1, 2) or not np.all(reach >= 0):
            wanted = "one or two numbers of pixels, 0 or more"
            raise ValueError(f"search radius must be {wanted}, got {search_radius}")
        reach = np.broadcast_to(reach.astype(int), 2)
        left, parts = Counter(pairs[:, 0].tolist()), []
        blocks = self._blocks(decompositions, pairs, reach, select)
        for references, found in in_order(match_block, blocks, n_workers):
            parts += found
            left.subtract(references)
            for epoch in set(references):
                if left[epoch] == 0 and progress is not None:
                    progress(1)
        return Matches.from_columns(parts, pairs)

    def _blocks(self, decompositions, pairs, reach, select):
        """
        Divide the pairs of epochs into blocks of work, by reference epoch.

        The division depends only on the epochs, pairs and search radius, so that
        any number of workers gives the same numbers.
        """
        ssps, n = SSPs.of_epochs(decompositions), len(decompositions)
        chosen = np.isin(ssps.epoch, pairs[:, 0])
        if select is not None:
            chosen &= select
        if not chosen.any():
            return
        # The area that the windows of all SSPs cover; values beside the outermost
        # displacement are needed as well.
        boxes, beyond = ssps.bbox[chosen], reach + 1
        sides, which = np.unique(
            boxes[:, 2:] - boxes[:, :2], axis=0, return_inverse=True
        )
        shapes = np.array([fft_shape(side, beyond) for side in sides])[which.ravel()]
        corners = boxes[:, :2] - beyond
        origin = corners.min(axis=0) - 2
        size = tuple((corners + shapes - origin).max(axis=0) + 2)
        scales = decompositions[0].scales
        maps = any(np.ndim(noise) for d in decompositions for noise in d.noise)
        dense = len(scales) if maps or self.target == "plane" else 1
        most = STACK_BYTES // (4 * np.prod(size) * dense)
        targets, most = np.unique(pairs[:, 1]), max(FEWEST_TARGETS, int(most))
        targets = np.array_split(targets, -(-len(targets) // most))
        # Consecutive reference epochs, divided where their work reaches a limit.
        pixels = np.prod(boxes[:, 2:] - boxes[:, :2] + 2 * beyond, axis=1)
        work = np.cumsum(np.bincount(ssps.epoch[chosen], pixels, n)) * len(targets[0])
        group = work[pairs[:, 0]] // BLOCK_WORK
        for number in np.unique(group):
            for some in targets:
                here = pairs[(group == number) & np.isin(pairs[:, 1], some)]
                if len(here):
                    of_all = chosen, ssps, decompositions, origin, size
                    yield PairBlock(self, here, reach, *of_all)


def match_block(block):
    """Return the reference epochs of the pairs of a block, and parts of matches."""
    wanted = np.zeros((block.pairs.max() + 1, len(block.epochs)), dtype=bool)
    wanted[block.pairs[:, 0], np.searchsorted(block.epochs, block.pairs[:, 1])] = True
    ssps, parts = block.ssps, []
    for scale in np.unique(ssps.scale):
        stack, columns = TargetStack(block, scale), []
        for i in np.flatnonzero(ssps.scale == scale):
            # One displacement more shows whether values at the largest one are maxima.
            middle, half = stack.displacements(ssps.bbox[i], block.reach + 1)
            if half is None or ssps.n_pixels[i] < FEWEST_PIXELS:
                continue
            template = _template(ssps, i, block.shape[1], half)
            if template.energy == 0:
                continue
            corner = ssps.bbox[i, :2] + middle - half - block.origin
            use = wanted[ssps.epoch[i]] & stack.not_empty(corner, template.window_shape)
            found = stack.coefficients(np.flatnonzero(use), corner, template)
            for targets, coefficient, overlap in found:
                which, y, x, value = find_peaks(coefficient, block.settings.kappa)
                share = np.ones(len(which))
                if overlap is not None:
                    at = np.rint(y).astype(int), np.rint(x).astype(int)
                    share = overlap.share[at]
                index = np.full(len(which), i)
                dy, dx = y + (middle[0] - half[0]), x + (middle[1] - half[1])
                columns.append((index, targets[which], dy, dx, value, share))
        if columns:
            i, target, *place = map(np.concatenate, zip(*columns, strict=True))
            snr = stack.snr(target, ssps.y[i] + place[0], ssps.x[i] + place[1])
            parts.append((block.index[i], block.epochs[target], *place, snr))
    return block.pairs[:, 0].tolist(), parts


def _template(ssps, i, width, search_radius):
    """Return one SSP of images of a width as a `Template`."""
    y0, x0, y1, x1 = ssps.bbox[i]
    rows, columns = np.divmod(ssps.pixels_of(i), width)
    inside = rows - y0, columns - x0
    footprint = np.zeros((y1 - y0, x1 - x0), dtype=bool)
    footprint[inside] = True
    values = np.zeros(footprint.shape)
    values[inside] = ssps.values[ssps.starts[i] : ssps.starts[i + 1]]
    return Template(values, footprint, search_radius)


class PairBlock:
    """
    Some pairs of epochs, with everything needed to correlate them.

    It can be pickled, and is all that `match_block` needs.  ``settings`` are a
    `Correlator`, ``ssps`` those of the reference epochs, and ``index`` their places in
    the catalogue of all epochs.  The targets are the planes of ``epochs`` on all
    ``scales`` in a window that may extend beyond the images of this ``shape``.  They
    are either ``segments``, SSPs outside of which the planes are zero, or ``planes``,
    their part in the window as it is, which is ``inside`` it.  ``valid`` are the pixels
    of the window that are not missing, for each different mask, and ``mask`` numbers
    those of the targets.
    """

    def __init__(
        self, settings, pairs, reach, chosen, ssps, decompositions, origin, size
    ):
        self.settings, self.pairs, self.reach = settings, pairs, reach
        own = chosen & np.isin(ssps.epoch, pairs[:, 0])
        self.ssps, self.index = ssps.select(own), np.flatnonzero(own)
        self.epochs = np.unique(pairs[:, 1])
        own = [decompositions[epoch] for epoch in self.epochs]
        self.scales, self.noise = own[0].scales, [d.noise for d in own]
        self.shape, self.origin = own[0].planes.shape[1:], origin
        # The overlap of the images and the window, as slices of both.
        ends = np.clip([origin, origin + size], 0, self.shape)
        part, self.inside = (
            tuple(slice(*axis) for axis in axes.T.tolist())
            for axes in (ends, ends - origin)
        )
        self.segments = self.planes = None
        if settings.target == "segments":
            self.segments = ssps.select(np.isin(ssps.epoch, self.epochs))
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
            segments = block.segments.select(block.segments.scale == scale)
            self.boxes = segments.bbox - np.tile(block.origin, 2)
            self.owner = np.searchsorted(block.epochs, segments.epoch)
            epoch = np.repeat(self.owner, segments.n_pixels)
            y, x = np.divmod(segments.pixels, block.shape[1])
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
