# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Correlation of the SSPs of each epoch with other epochs, and their matches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from astro_scc.decomposition import SSPs
from astro_scc.decomposition.segmentation import Decomposition
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.images.zncc import Template, find_peaks
from astro_scc.parallel import Workers, in_order
from astro_scc.settings import require

#: Fewest pixels of an SSP: with two pixels anything matches anything.
FEWEST_PIXELS = 3
#: Columns of matches, and their types.
COLUMNS = {"ssp": np.int32, "target": np.int16}
COLUMNS |= dict.fromkeys(("dy", "dx", "coefficient", "overlap", "target_snr"), "f4")


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

    Examples
    --------
    >>> from astro_scc.paper import Correlator
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> images = simulate_two_fluid(n_epochs=2, rng=1).cube.data
    >>> epochs = [Decomposer(scales=[2])(image) for image in images]
    >>> matches = Correlator()(epochs, [(0, 1), (1, 0)], (8, 25))
    >>> forward = matches.select(matches.target == 1)
    >>> 0 < len(forward) < len(matches)
    True
    """

    ssp: np.ndarray
    target: np.ndarray
    dy: np.ndarray
    dx: np.ndarray
    coefficient: np.ndarray
    overlap: np.ndarray
    target_snr: np.ndarray

    def __len__(self) -> int:
        return len(self.ssp)

    def __repr__(self):
        return f"<Matches: {len(self)} peaks>"

    def select(self, keep: ArrayLike) -> Matches:
        """
        Return the matches at some indices, or where ``keep`` is true.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or of int

        Returns
        -------
        `~astro_scc.paper.Matches`
        """
        return replace(self, **{name: getattr(self, name)[keep] for name in COLUMNS})


def target_ssps(matches: Matches, ssps: SSPs) -> np.ndarray:
    """
    Find the SSP of the target epoch that is nearest to each match.

    Parameters
    ----------
    matches : `~astro_scc.paper.Matches`
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
    >>> from astro_scc.paper import Correlator, all_pairs
    >>> from astro_scc.paper.correlate import target_ssps
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
    apart, owner = 2 * size.max(initial=0.0), matches.ssp
    there = ssps.y, ssps.x, apart * (level * n_epochs + ssps.epoch)
    y, x = ssps.y[owner] + matches.dy, ssps.x[owner] + matches.dx
    here = y, x, apart * (level[owner] * n_epochs + matches.target)
    tree = scipy.spatial.cKDTree(np.stack(there, axis=1))
    distance, nearest = tree.query(np.stack(here, axis=1), distance_upper_bound=apart)
    return np.where(distance <= size[level[owner]], nearest, -1)


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
    >>> from astro_scc.paper import all_pairs
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
    >>> from astro_scc.paper import Correlator
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
        for one in fields(self):
            require(one.name, getattr(self, one.name))

    def __call__(
        self, decompositions: Sequence[Decomposition], pairs: ArrayLike,
        search_radius: int | tuple[int, int], *, select: ArrayLike | None = None,
        n_workers: Workers = 1, progress: Callable[..., Any] | None = None,
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
        `~astro_scc.paper.Matches`
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
        >>> from astro_scc.paper import Correlator, all_pairs
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
        ssps, targets = SSPs.of_epochs(decompositions), list(decompositions)
        chosen = np.ones(len(ssps), dtype=bool) if select is None else select
        if self.target == "segments":
            # Planes are larger than all else, and SSPs have their values.
            targets = [replace(d, planes=d.planes[:0]) for d in decompositions]
        work = []
        for epoch in np.unique(pairs[:, 0]):
            of_epoch = chosen & (ssps.epoch == epoch)
            others = pairs[pairs[:, 0] == epoch, 1]
            rest = np.flatnonzero(of_epoch), others, [targets[k] for k in others]
            work.append((self, ssps.select(of_epoch), *rest, reach))
        parts = [tuple(np.empty(0) for _ in COLUMNS)]
        for found in in_order(match_epoch, work, n_workers):
            parts += found
            if progress is not None:
                progress(1)
        columns = zip(zip(*parts, strict=True), COLUMNS.values(), strict=True)
        found = Matches(*(np.concatenate(part).astype(kind) for part, kind in columns))
        return found.select(np.lexsort((found.target, found.ssp)))


def match_epoch(work):
    """
    Return the columns of the matches of an epoch's SSPs, scale by scale.

    ``work`` are the settings, the SSPs, their places in the catalogue of all epochs,
    the epochs with which they are correlated, the decompositions of these, without
    planes if only their SSPs count, and the largest displacement.
    """
    settings, ssps, index, epochs, targets, reach = work
    parts = []
    for scale in np.unique(ssps.scale):
        stack, found = TargetStack(settings, targets, reach, scale), []
        for i in np.flatnonzero(ssps.scale == scale):
            if ssps.n_pixels[i] >= FEWEST_PIXELS:
                found += stack.matches_of(ssps, i)
        if found:
            i, target, *place = map(np.concatenate, zip(*found, strict=True))
            snr = stack.snr(target, ssps.y[i] + place[0], ssps.x[i] + place[1])
            parts.append((index[i], epochs[target], *place, snr))
    return parts


class TargetStack:
    """
    The target planes on one scale, zero in a margin as wide as displacements.

    With ``segments`` they are zero outside their SSPs.  ``valid`` are the pixels that
    exist.  One displacement more than asked for, on every side, shows whether values at
    the largest one are maxima.
    """

    def __init__(self, settings, targets, reach, scale):
        self.settings, self.margin = settings, reach + 1
        self.shape = np.array(targets[0].planes.shape[1:])
        size = len(targets), *(self.shape + 2 * self.margin)
        self.values, self.noise = np.zeros(size, dtype=np.float32), []
        self.valid = np.zeros(size, dtype=bool)
        inside = tuple(map(slice, self.margin, self.margin + self.shape))
        for values, valid, d in zip(self.values, self.valid, targets, strict=True):
            level = d.scales.index(scale)
            self.noise.append(d.noise[level])
            valid[inside] = True if d.mask is None else ~d.mask
            if self.settings.target == "plane":
                values[inside] = d.planes[level]
                continue
            segments = d.ssps.select(d.ssps.scale == scale)
            y, x = np.divmod(segments.pixels, self.shape[1])
            values[y + self.margin[0], x + self.margin[1]] = segments.values

    def matches_of(self, ssps, i):
        """Yield columns of the matches of one SSP: all but the last, in places here."""
        box = ssps.bbox[i]
        rows, columns = np.divmod(ssps.pixels_of(i), self.shape[1])
        inside = rows - box[0], columns - box[1]
        values = np.zeros(box[2:] - box[:2])
        footprint = np.zeros(values.shape, dtype=bool)
        values[inside] = ssps.values[ssps.starts[i] : ssps.starts[i + 1]]
        footprint[inside] = True
        template = Template(values, footprint, self.margin)
        if template.energy == 0:
            return
        # The margin of the planes is that of the window around the SSP.
        start, (ny, nx) = box[:2], template.window_shape
        window = np.s_[start[0] : start[0] + ny, start[1] : start[1] + nx]
        for k in np.flatnonzero(self.values[:, *window].any(axis=(1, 2))):
            pixels, valid = self.values[k][window].astype(float), self.valid[k][window]
            coefficient, share = template.of_windows(
                pixels, None if valid.all() else valid, self.settings.min_overlap
            )
            _, y, x, value = find_peaks(coefficient[None], self.settings.kappa)
            share = share[np.rint(y).astype(int), np.rint(x).astype(int)]
            here = np.full((2, len(value)), [[i], [k]])
            yield *here, y - self.margin[0], x - self.margin[1], value, share

    def snr(self, target, y, x):
        """Return the largest value in 3 x 3 pixels around positions, over the noise."""
        y, x = (
            np.clip(np.rint(place).astype(int), 0, size - 1)
            for place, size in zip((y, x), self.shape, strict=True)
        )
        sigma = np.empty(len(y))
        for k in np.unique(target):
            here = target == k
            sigma[here] = np.broadcast_to(self.noise[k], self.shape)[y[here], x[here]]
        highest = scipy.ndimage.maximum_filter(self.values, (1, 3, 3))
        highest = highest[target, y + self.margin[0], x + self.margin[1]]
        return np.maximum(highest, 0) / sigma
