# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Correlation of the SSPs of each epoch with the planes of other epochs."""

from dataclasses import dataclass

import numpy as np

from astro_scc.correlation.matches import Matches
from astro_scc.correlation.peaks import find_peaks
from astro_scc.correlation.zncc import Template
from astro_scc.decomposition import SSPs

__all__ = ["Correlator", "all_pairs"]

#: Windows transformed at once: more of them leave the cache.
BATCH = 10
#: Transforms of a batch are kept below this number of pixels.
BATCH_PIXELS = 2_000_000


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

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    kappa: float = 0.6
    target: str = "segments"
    min_overlap: float = 0.8

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

    def __call__(
        self,
        decompositions,
        pairs,
        reach,
        *,
        select=None,
        n_workers=1,
        progress=None,
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
        n_workers : int, optional
            Number of threads.
        progress : callable, optional
            Called with 1 for each reference epoch that is done.

        Returns
        -------
        `~astro_scc.correlation.Matches`
            Its ``ssp`` counts in ``SSPs.of_epochs(decompositions)``.

        Raises
        ------
        ValueError
            If pairs name epochs that do not exist, decompositions differ
            in shape or scales, or ``reach`` or ``select`` is not as above.

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
        shapes = {(d.planes.shape, d.scales) for d in decompositions}
        if len(shapes) > 1:
            raise ValueError("all epochs must have one shape and the same scales")
        pairs = np.asarray(pairs, dtype=int).reshape(-1, 2)
        if pairs.size and not (0 <= pairs.min() and pairs.max() < len(decompositions)):
            raise ValueError(
                f"pairs name epochs outside 0 to {len(decompositions) - 1}"
            )
        reach = (reach, reach) if np.isscalar(reach) else tuple(reach)
        reach = tuple(int(r) for r in reach)
        if len(reach) != 2 or min(reach) < 0:
            raise ValueError(f"reach must be one or two numbers of pixels, got {reach}")
        ssps = SSPs.of_epochs(decompositions)
        chosen = np.ones(len(ssps), bool) if select is None else np.asarray(select)
        if chosen.shape != (len(ssps),) or chosen.dtype != bool:
            raise ValueError(
                f"select must be one bool for each of the {len(ssps)} SSPs, "
                f"got {chosen.dtype} of shape {chosen.shape}"
            )
        targets = _Targets(decompositions, self.target)
        jobs = []
        for epoch in np.unique(pairs[:, 0]):
            wanted = pairs[pairs[:, 0] == epoch, 1]
            indices = np.flatnonzero(chosen & (ssps.epoch == epoch))
            jobs.append((decompositions[epoch], ssps, indices, wanted))

        def work(job):
            columns = self._match_epoch(*job, targets, reach)
            if progress is not None:
                progress(1)
            return columns

        if n_workers > 1:
            from concurrent.futures import ThreadPoolExecutor

            with ThreadPoolExecutor(n_workers) as pool:
                columns = list(pool.map(work, jobs))
        else:
            columns = [work(job) for job in jobs]
        columns = [part for epoch in columns for part in epoch]
        return Matches.from_columns(columns, pairs, reach, self.kappa)

    def _match_epoch(self, reference, ssps, indices, wanted, targets, reach):
        columns = []
        # One more ring makes maxima at the largest displacement genuine.
        ring = tuple(r + 1 for r in reach)
        for index in indices:
            level = reference.plane_index(ssps.scale[index])
            y0, x0, y1, x1 = ssps.bbox[index]
            footprint = np.zeros((y1 - y0, x1 - x0), dtype=bool)
            py, px = np.unravel_index(ssps.pixels_of(index), reference.planes.shape[1:])
            footprint[py - y0, px - x0] = True
            values = reference.planes[level, y0:y1, x0:x1].astype(float)
            template = Template(values, footprint, ring)
            if template.energy == 0:
                continue
            corner = (y0 - ring[0], x0 - ring[1])
            batch = int(np.clip(BATCH_PIXELS // np.prod(template.fft_shape), 1, BATCH))
            for start in range(0, len(wanted), batch):
                epochs = wanted[start : start + batch]
                windows, valid = targets.windows(
                    level, epochs, corner, template.window_shape
                )
                if valid is None:
                    coefficient = template.of_windows(windows)
                    overlap = None
                else:
                    coefficient, overlap = template.of_masked_windows(
                        windows, valid, self.min_overlap
                    )
                    # Beside a displacement that cannot be judged there is no
                    # maximum: the pattern may well have gone further.
                    coefficient[overlap < self.min_overlap] = np.nan
                which, y, x, value = find_peaks(coefficient, self.kappa)
                if len(which) == 0:
                    continue
                row, column = np.rint(y).astype(int), np.rint(x).astype(int)
                share = (
                    np.ones(len(which)) if overlap is None
                    else overlap[which, row, column]
                )  # fmt: skip
                dy, dx = y - ring[0], x - ring[1]
                snr = targets.snr(
                    level, epochs[which], ssps.y[index] + dy, ssps.x[index] + dx
                )
                columns.append(
                    (
                        np.full(len(which), index),
                        epochs[which],
                        dy,
                        dx,
                        value,
                        share,
                        snr,
                    )
                )
        return columns


class _Targets:
    """The target planes of all epochs, cut into windows."""

    def __init__(self, decompositions, target):
        self.planes = [
            np.stack([d.segmented_plane(scale) for scale in d.scales])
            if target == "segments"
            else d.planes
            for d in decompositions
        ]
        self.noise = [d.noise for d in decompositions]
        self.masks = [d.mask for d in decompositions]
        self.shape = decompositions[0].planes.shape[1:] if decompositions else (0, 0)

    def windows(self, level, epochs, corner, shape):
        """Windows (n, h, w) at a corner, and where they hold pixels or None."""
        ny, nx = self.shape
        y0, x0 = max(corner[0], 0), max(corner[1], 0)
        y1, x1 = min(corner[0] + shape[0], ny), min(corner[1] + shape[1], nx)
        inside = (slice(y0 - corner[0], y1 - corner[0]),
                  slice(x0 - corner[1], x1 - corner[1]))  # fmt: skip
        windows = np.zeros((len(epochs), *shape))
        whole = (y1 - y0, x1 - x0) == tuple(shape)
        if whole and all(self.masks[e] is None for e in epochs):
            valid = None
        else:
            valid = np.zeros(windows.shape, dtype=bool)
        for i, epoch in enumerate(epochs):
            windows[i][inside] = self.planes[epoch][level, y0:y1, x0:x1]
            if valid is not None:
                mask = self.masks[epoch]
                valid[i][inside] = True if mask is None else ~mask[y0:y1, x0:x1]
        if valid is not None and valid.all():
            valid = None
        return windows, valid

    def snr(self, level, epochs, y, x):
        """Largest value in 3 x 3 pixels around positions, over the noise."""
        ny, nx = self.shape
        y = np.clip(np.rint(y).astype(int), 0, ny - 1)
        x = np.clip(np.rint(x).astype(int), 0, nx - 1)
        result = np.empty(len(y))
        for i, epoch in enumerate(epochs):
            box = (slice(max(y[i] - 1, 0), y[i] + 2), slice(max(x[i] - 1, 0), x[i] + 2))
            noise = self.noise[epoch][level]
            sigma = noise if np.ndim(noise) == 0 else noise[y[i], x[i]]
            result[i] = max(self.planes[epoch][level][box].max(), 0.0) / sigma
        return result
