# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""How much of what is linked would be linked by chance."""

from dataclasses import dataclass

import numpy as np

__all__ = ["LinkedShare", "linked_counts", "linked_share", "shuffled_orders"]

#: Resamples of the epochs.
N_BOOTSTRAP = 1000


@dataclass(frozen=True)
class LinkedShare:
    """
    The share of SSPs that tracks link to a later one, and what chance gives.

    Attributes
    ----------
    scale : float or None
        None for all scales together.
    n_ssps, n_linked : int
        SSPs that have a later epoch, and those of them that are linked.
    share, share_err : float
        Their ratio, and its standard deviation over resampled epochs.
    shuffled, shuffled_err : float
        Mean of the share over shuffled orders, and its standard deviation;
        NaN without trials.
    p_value : float
        Share of the orders, the observed one included, that link as many;
        NaN without trials.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    >>> decompositions = [Decomposer(scales=[2])(image) for image in cube.data]
    >>> tracker = FeatureTracker(max_speed=36 * u.mas / u.yr)
    >>> tracking = tracker(cube, decompositions)
    >>> everything = tracking.shares[0]
    >>> everything.scale is None, 0 < everything.share <= 1
    (True, True)
    """

    scale: float | None
    n_ssps: int
    n_linked: int
    share: float
    share_err: float
    shuffled: float
    shuffled_err: float
    p_value: float


def shuffled_orders(n_epochs, n_trials, rng=None):
    """
    Random orders of the images.

    Parameters
    ----------
    n_epochs, n_trials : int
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `~numpy.ndarray` of int, shape (n_trials, n_epochs)
        Place in time of each image.

    Examples
    --------
    >>> from astro_scc.tracking import shuffled_orders
    >>> shuffled_orders(4, 2, rng=1).shape
    (2, 4)
    """
    rng = np.random.default_rng(rng)
    orders = [rng.permutation(n_epochs) for _ in range(n_trials)]
    return np.array(orders, dtype=int).reshape(n_trials, n_epochs)


def linked_counts(
    links, ssps, scales, n_epochs, *, track=None, select=None, place=None
):
    """
    SSPs of each scale and place in time, and those that are linked onwards.

    Parameters
    ----------
    links : `~astro_scc.tracking.Links`
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    scales : sequence of float
    n_epochs : int
    track : array_like of int, shape (n_ssps,), optional
        Of links within tracks alone, see `chain`, if given.
    select : array_like of bool, shape (n_ssps,), optional
        The SSPs that count.
    place : array_like of int, shape (n_epochs,), optional
        Place in time of each image.

    Returns
    -------
    `~numpy.ndarray` of int, shape (2, n_scales, n_epochs - 1)
        Linked ones, and all of them.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> from astro_scc.tracking import linked_counts
    >>> cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    >>> decompositions = [Decomposer(scales=[2])(image) for image in cube.data]
    >>> tracker = FeatureTracker(max_speed=36 * u.mas / u.yr)
    >>> tracking = tracker(cube, decompositions)
    >>> linked, of = linked_counts(tracking.links, tracking.ssps, [2], 3)
    >>> linked.shape, bool((linked <= of).all())
    ((1, 2), True)
    """
    place = np.arange(n_epochs) if place is None else np.asarray(place)
    select = np.ones(len(ssps), bool) if select is None else np.asarray(select, bool)
    linked = np.zeros(len(ssps), bool)
    linked[links.source] = True
    if track is not None:
        linked &= np.asarray(track) >= 0
    at = place[ssps.epoch]
    counts = np.zeros((2, len(scales), n_epochs), dtype=int)
    for k, scale in enumerate(scales):
        own = select & (ssps.scale == scale)
        counts[0, k] = np.bincount(at[own & linked], minlength=n_epochs)
        counts[1, k] = np.bincount(at[own], minlength=n_epochs)
    return counts[:, :, :-1]


def linked_share(counts, shuffled, scales, *, rng=None):
    """
    The share of SSPs that are linked, of each scale and of all.

    The error is the standard deviation of 1000 resamples of the epochs,
    with replacement (Efron & Tibshirani 1993).

    Parameters
    ----------
    counts : `~numpy.ndarray`, shape (2, n_scales, n)
        See `linked_counts`.
    shuffled : sequence of `~numpy.ndarray`, shape (2, n_scales, n)
        The same of shuffled orders, may be empty.
    scales : sequence of float
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    list of `LinkedShare`
        The first is that of all scales.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking import linked_share
    >>> counts = np.array([[[4, 2, 3]], [[5, 5, 5]]])
    >>> linked_share(counts, [], [1.0], rng=1)[0].share
    0.6
    """
    counts = np.asarray(counts)
    rng = np.random.default_rng(rng)
    n = counts.shape[2]
    again = rng.integers(0, max(n, 1), (N_BOOTSTRAP, n))
    found = []
    for k in (slice(None), *range(len(scales))):
        linked, total = (np.atleast_2d(c[k]).sum(axis=0) for c in counts)
        trials = [_ratio(*(np.sum(c[k]) for c in trial)) for trial in shuffled]
        share = _ratio(linked.sum(), total.sum())
        resampled = _ratio(linked[again].sum(axis=1), total[again].sum(axis=1))
        found.append(
            LinkedShare(
                scale=None if isinstance(k, slice) else float(scales[k]),
                n_ssps=int(total.sum()),
                n_linked=int(linked.sum()),
                share=float(share),
                share_err=float(np.std(resampled)) if n else 0.0,
                shuffled=float(np.mean(trials)) if trials else np.nan,
                shuffled_err=float(np.std(trials)) if trials else np.nan,
                p_value=(1 + np.sum(np.array(trials) >= share)) / (1 + len(trials))
                if trials
                else np.nan,
            )
        )
    return found


def _ratio(part, whole):
    return np.divide(part, whole, out=np.zeros(np.shape(whole)), where=np.not_equal(
        whole, 0)) if np.ndim(whole) else (part / whole if whole else 0.0)  # fmt: skip
