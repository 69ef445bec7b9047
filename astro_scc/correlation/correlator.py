# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Correlation of the SSPs of each epoch with the planes of other epochs."""

from collections import Counter, deque
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from astro_scc.correlation.blocks import PairBlock, Patterns, Targets, match_block
from astro_scc.correlation.canvas import BATCH, image_part, window_bounds
from astro_scc.correlation.matches import Matches
from astro_scc.correlation.workers import in_order
from astro_scc.decomposition import SSPs

__all__ = ["Correlator", "all_pairs"]

#: Pixels of windows that a block correlates, about half a second's work.
BLOCK_WORK = 2**24
#: Bytes of target planes that a block holds.
STACK_BYTES = 2**26
#: Fewer windows than these are done before the loops are compiled.
COMPILE_FROM = 100_000


def all_pairs(n_epochs):
    """
    Every ordered pair of different epochs.

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
    first, second = np.nonzero(~np.eye(n_epochs, dtype=bool))
    return np.stack([first, second], axis=1)


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
        Share of the SSP's pixels that must fall on existing pixels of the
        target image, for a displacement and for its eight neighbours.
    compiled : bool, optional
        Whether small SSPs are summed up by loops that `numba
        <https://numba.pydata.org>`_ compiles, rather than transformed.  By
        default that is so where numba is installed (the extra ``fast``) and
        there are more than 100 000 windows, as compiling takes some
        seconds the first time.  Coefficients differ by rounding only.

    Raises
    ------
    ValueError
        If a setting is out of its range.
    ImportError
        If ``compiled`` is asked for without numba.

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
    compiled: bool | None = None

    def __post_init__(self):
        if not 0 < self.kappa < 1:
            raise ValueError(f"kappa must be between 0 and 1, got {self.kappa}")
        if self.target not in ("segments", "plane"):
            raise ValueError(
                f"unknown target {self.target!r}: use 'segments' or 'plane'"
            )
        if not 0 < self.min_overlap <= 1:
            raise ValueError(
                f"min_overlap must be above 0 and at most 1, got {self.min_overlap}"
            )
        if self.compiled and not find_spec("numba"):
            raise ImportError(
                "compiled loops need the package numba: "
                "pip install 'astro_scc[fast]', or leave compiled at None"
            )

    def __call__(
        self,
        decompositions,
        pairs,
        reach,
        *,
        select=None,
        n_workers=1,
        progress=None,
        done=None,
    ):
        """
        Find the matches of SSPs for ordered pairs of epochs.

        Parameters
        ----------
        decompositions : sequence of `~astro_scc.decomposition.Decomposition`
            One an epoch, of images of one shape and with the same scales.
        pairs : array_like of int, shape (n_pairs, 2)
            Reference and target epoch.
        reach : int or tuple of int
            Largest displacement in pixels, of (y, x) if two.
        select : array_like of bool, optional
            Which SSPs of the catalogue of all epochs to correlate.
        n_workers : int, str or `dask.distributed.Client`, optional
            Number of processes, or a Dask scheduler, by its address or a
            client of it.  With more than one process, a script needs
            ``if __name__ == "__main__":`` where processes are spawned, see
            `multiprocessing`.
        progress : callable, optional
            Called with 1 for each reference epoch that is done.
        done : mutable mapping of int to tuple of `~numpy.ndarray`, optional
            What `match_block` found for `blocks` that were done before, by
            their number; what is found is added.

        Returns
        -------
        `~astro_scc.correlation.Matches`
            Its ``ssp`` counts in ``SSPs.of_epochs(decompositions)``.

        Raises
        ------
        ValueError
            If pairs name epochs that do not exist, decompositions differ
            in shape or scales, or ``reach``, ``select`` or ``n_workers`` is
            not as above.

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
        pairs = _pairs_of(pairs, decompositions)
        columns = {}
        references = Counter(np.unique(pairs, axis=0)[:, 0].tolist())
        begun = deque()

        def finish(number, part, epochs):
            columns[number] = part
            for epoch in epochs:
                references[epoch] -= 1
                if references[epoch] == 0 and progress is not None:
                    progress(1)

        def begin():
            blocks = self.blocks(decompositions, pairs, reach, select=select)
            for number, block in enumerate(blocks):
                epochs = block.pairs[:, 0].tolist()
                if done is not None and number in done:
                    finish(number, done[number], epochs)
                else:
                    begun.append((number, epochs))
                    yield block

        for part in in_order(match_block, begin(), n_workers):
            number, epochs = begun.popleft()
            if done is not None:
                done[number] = part
            finish(number, part, epochs)
        columns = [columns[number] for number in sorted(columns)]
        matches = Matches.from_columns(columns, pairs, _both_axes(reach), self.kappa)
        return matches.sorted()

    def blocks(self, decompositions, pairs, reach, *, select=None):
        """
        The pairs of epochs as pieces of work, for `match_block`.

        How they are cut depends on the epochs, pairs and reach alone, so
        that whoever works on them gets the same numbers.

        Parameters
        ----------
        decompositions, pairs, reach, select
            As for a call.

        Yields
        ------
        `~astro_scc.correlation.PairBlock`
            Those of one reference epoch one after the other.

        Raises
        ------
        ValueError
            As for a call.
        """
        pairs = np.unique(_pairs_of(pairs, decompositions), axis=0)
        reach = _both_axes(reach)
        ssps = SSPs.of_epochs(decompositions)
        chosen = np.ones(len(ssps), bool) if select is None else np.asarray(select)
        if chosen.shape != (len(ssps),) or chosen.dtype != bool:
            raise ValueError(
                f"select must be one bool for each of the {len(ssps)} SSPs, "
                f"got {chosen.dtype} of shape {chosen.shape}"
            )
        if len(pairs) == 0:
            return
        patterns = Patterns.of(decompositions, ssps, np.arange(len(ssps)))
        chosen = chosen & np.isin(ssps.epoch, pairs[:, 0])
        shape = decompositions[0].planes.shape
        ring = tuple(r + 1 for r in reach)
        part, work = (slice(0, 0),) * 2, np.zeros(len(decompositions))
        if chosen.any():
            own = ssps.bbox[chosen]
            part = image_part(shape[1:], *window_bounds(own, ring))
            pixels = np.prod(own[:, 2:] - own[:, :2] + 2 * np.array(ring), axis=1)
            work = np.bincount(ssps.epoch[chosen], pixels, len(decompositions))
        segments = self.target == "segments"
        dense = not segments or any(np.ndim(n) for d in decompositions for n in d.noise)
        plane_bytes = 4 * np.prod([max(p.stop - p.start, 1) for p in part])
        most = max(
            BATCH, int(STACK_BYTES // (plane_bytes * (shape[0] if dense else 1)))
        )
        every = np.unique(pairs[:, 1])
        every = np.array_split(every, -(-len(every) // most))
        groups = _groups(np.unique(pairs[:, 0]), work * len(every[0]), BLOCK_WORK)
        number = np.bincount(ssps.epoch[chosen], minlength=len(decompositions))
        compiled = self._compiles(number[pairs[:, 0]].sum())
        for references in groups:
            wanted = pairs[np.isin(pairs[:, 0], references)]
            own = patterns.select(
                np.flatnonzero(chosen & np.isin(ssps.epoch, references))
            )
            for some in every:
                here = wanted[np.isin(wanted[:, 1], some)]
                if len(here) == 0:
                    continue
                targets = Targets.of(
                    decompositions,
                    np.unique(here[:, 1]),
                    part,
                    patterns if segments else None,
                )
                yield PairBlock(
                    own, targets, here, reach, self.kappa, self.min_overlap, compiled
                )

    def _compiles(self, n_windows):
        if self.compiled is not None:
            return self.compiled
        return bool(n_windows > COMPILE_FROM) and find_spec("numba") is not None


def _pairs_of(pairs, decompositions):
    shapes = {(d.planes.shape, d.scales) for d in decompositions}
    if len(shapes) > 1:
        raise ValueError("all epochs must have one shape and the same scales")
    pairs = np.asarray(pairs, dtype=int).reshape(-1, 2)
    if pairs.size and not (0 <= pairs.min() and pairs.max() < len(decompositions)):
        raise ValueError(f"pairs name epochs outside 0 to {len(decompositions) - 1}")
    return pairs


def _both_axes(reach):
    reach = (reach, reach) if np.isscalar(reach) else tuple(reach)
    reach = tuple(int(r) for r in reach)
    if len(reach) != 2 or min(reach) < 0:
        raise ValueError(f"reach must be one or two numbers of pixels, got {reach}")
    return reach


def _groups(epochs, work, limit):
    """Consecutive epochs together, as long as their work is below a limit."""
    groups, sum_ = [[]], 0.0
    for epoch in epochs.tolist():
        if groups[-1] and sum_ + work[epoch] > limit:
            groups.append([])
            sum_ = 0.0
        groups[-1].append(epoch)
        sum_ += work[epoch]
    return groups
