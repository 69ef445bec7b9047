# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Merges and splits: what is left without a partner of its own."""

import numpy as np

from astro_scc.tracking.assignment import assign

__all__ = ["company_gain", "shared_seats"]

#: Most SSPs that go into one, or come out of one.
MOST = 3
#: Neighbours are no farther apart than so many times their radii together.
NEAR = 1.2
#: Log-likelihood that a merge or split must bring more than it would by chance.
COST = 1.0


def company_gain(candidates, ssps, evidence):
    """
    What it helps a candidate to merge or to split together with neighbours.

    Neighbours of a source that may go to the same target, moving alike
    within three tolerances, are tried together with it: the nearest, the
    second nearest and both, three patterns at most.  If the sum of their
    fluxes explains the flux of the target better than the source's peak
    explains the target's, this is the difference in `Evidence.brightness`,
    less one.  Targets that may come out of one source the same way.

    Parameters
    ----------
    candidates : `Candidates`
        Of one scale.
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    evidence : `Evidence`

    Returns
    -------
    `~numpy.ndarray`, shape (n,)
        Not negative.

    Notes
    -----
    The work grows with the sum, over all SSPs, of the squares of the number
    of candidates for one epoch, not with the number of ways to share.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import Candidates, Evidence, company_gain
    >>> from astro_scc.tracking import FeatureTracker
    >>> cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    >>> decompositions = [Decomposer(scales=[2])(image) for image in cube.data]
    >>> tracker = FeatureTracker(max_speed=36 * u.mas / u.yr)
    >>> tracking = tracker(cube, decompositions)
    >>> links, ssps = tracking.links, tracking.ssps
    >>> candidates = Candidates(
    ...     source=links.source, target=links.target,
    ...     dy=ssps.y[links.target] - ssps.y[links.source],
    ...     dx=ssps.x[links.target] - ssps.x[links.source], interval=links.interval,
    ...     gap=links.gap, coefficient=links.coefficient)
    >>> bool((company_gain(candidates, ssps, Evidence()) >= 0).all())
    True
    """
    gain = np.zeros(len(candidates))
    motion = np.stack([candidates.dy, candidates.dx], axis=1)
    ratio = ssps.peak[candidates.target] / ssps.peak[candidates.source]
    alone = evidence.brightness(np.log(ratio))
    for own, common in (
        (candidates.source, candidates.target),
        (candidates.target, candidates.source),
    ):
        one, other = _meeting(common, candidates.gap)
        near = _neighbours(own[one], own[other], ssps)
        near &= _alike(motion[one] - motion[other], evidence)
        one, other = one[near], other[near]
        distance = np.hypot(
            ssps.y[own[one]] - ssps.y[own[other]], ssps.x[own[one]] - ssps.x[own[other]]
        )
        order = np.lexsort((distance, one))
        one, other = one[order], other[order]
        first = np.searchsorted(one, np.arange(len(gain)))
        count = np.searchsorted(one, np.arange(len(gain)), side="right") - first
        flux = np.zeros((2, len(gain)))
        for k in range(2):
            has = np.flatnonzero(count > k)
            flux[k, has] = ssps.flux[own[other[first[has] + k]]]
        for more in (flux[0], flux[1], flux[0] + flux[1]):
            has = np.flatnonzero(more > 0)
            total = ssps.flux[own[has]] + more[has]
            light = evidence.brightness(np.log(total / ssps.flux[common[has]]))
            gain[has] = np.maximum(gain[has], light - alone[has] - COST)
    return gain


def _meeting(common, gap):
    """All ordered pairs of different candidates with one common SSP and gap."""
    key = np.unique(np.stack([common, gap]), axis=1, return_inverse=True)[1].ravel()
    order = np.argsort(key, kind="stable")
    count = np.bincount(key, minlength=1)
    start = np.cumsum(count) - count
    one = np.repeat(np.arange(len(key)), count[key])
    first = np.repeat(np.cumsum(count[key]) - count[key], count[key])
    other = order[start[key[one]] + np.arange(len(one)) - first]
    different = one != other
    return one[different], other[different]


def _alike(away, evidence):
    return np.hypot(away[:, 0], away[:, 1]) <= 3 * evidence.tolerance


def shared_seats(candidates, chosen, ssps, evidence):
    """
    Give SSPs without a partner a seat beside a neighbour.

    A source that has no target may share that of a neighbour (a merge), a
    target that has no source that of a neighbour (a split), up to three
    together.  Its candidate must move as the neighbour's link does, within
    three tolerances, and the sum of their fluxes must explain the flux on
    the other side better than one of them alone: the worth of the seat is
    that of the candidate's correlation, and the gain in `Evidence.brightness`,
    less one.  The seats are given by `assign`, merges first.

    Parameters
    ----------
    candidates : `Candidates`
        Of one scale.
    chosen : array_like of bool, shape (n,)
        The links, one to one.
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    evidence : `Evidence`

    Returns
    -------
    kind : `~numpy.ndarray` of str, shape (n,)
        "link", "merge", "split", or "" for what is no link.
    gain : `~numpy.ndarray`, shape (n,)
        Worth of the seat, for merges and splits.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import Candidates, Evidence, shared_seats
    >>> from astro_scc.tracking import FeatureTracker
    >>> cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    >>> decompositions = [Decomposer(scales=[2])(image) for image in cube.data]
    >>> tracker = FeatureTracker(max_speed=36 * u.mas / u.yr)
    >>> tracking = tracker(cube, decompositions)
    >>> links, ssps = tracking.links, tracking.ssps
    >>> candidates = Candidates(
    ...     source=links.source, target=links.target,
    ...     dy=ssps.y[links.target] - ssps.y[links.source],
    ...     dx=ssps.x[links.target] - ssps.x[links.source], interval=links.interval,
    ...     gap=links.gap, coefficient=links.coefficient)
    >>> chosen = links.kind == "link"
    >>> kind, gain = shared_seats(candidates, chosen, ssps, Evidence())
    >>> bool((kind[chosen] == "link").all())
    True
    """
    kind = np.where(chosen, "link", "").astype("U5")
    gain = np.zeros(len(candidates))
    motion = np.stack([candidates.dy, candidates.dx], axis=1)
    sides = {
        "merge": (candidates.source, candidates.target),
        "split": (candidates.target, candidates.source),
    }
    for name, (free, shared) in sides.items():
        # The link that already sits there, of the same pair of epochs.
        sitting = np.full(len(ssps), -1)
        sitting[shared[chosen]] = np.flatnonzero(chosen)
        host = sitting[shared]
        busy = np.zeros(len(ssps), bool)
        busy[free[kind != ""]] = True
        own = np.flatnonzero((host >= 0) & ~busy[free])
        own = own[candidates.gap[own] == candidates.gap[host[own]]]
        beside, away = free[host[own]], motion[own] - motion[host[own]]
        own = own[_alike(away, evidence) & _neighbours(free[own], beside, ssps)]
        if len(own) == 0:
            continue
        beside, other = free[host[own]], shared[own]
        flux = ssps.flux
        together = np.log((flux[free[own]] + flux[beside]) / flux[other])
        alone = np.log(flux[beside] / flux[other])
        better = evidence.brightness(together) - evidence.brightness(alone)
        a, b = evidence.decorrelation, evidence.chance_decorrelation
        looks = np.log(b / a) - (1 - candidates.coefficient[own]) * (1 / a - 1 / b)
        value = better + np.minimum(looks, 0.0) - COST
        # Two more seats; to take the first is never worse.
        seats = np.concatenate([other, len(ssps) + other])
        values = np.concatenate([value, value - 1e-9])
        taken = assign(np.tile(free[own], 2), seats, values)
        taken = taken[: len(own)] | taken[len(own) :]
        kind[own[taken]] = name
        gain[own[taken]] = value[taken]
    return kind, gain


def _neighbours(one, other, ssps):
    """Whether SSPs about touch."""
    radius = np.sqrt(ssps.n_pixels / np.pi)
    distance = np.hypot(ssps.y[one] - ssps.y[other], ssps.x[one] - ssps.x[other])
    return (one != other) & (distance <= NEAR * (radius[one] + radius[other]))
