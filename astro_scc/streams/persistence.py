# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Whether what moves keeps its speed from one interval to the next."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from astro_scc.stacking.velocities import VelocitySamples
from astro_scc.streams.search_settings import DEFAULT, SearchSettings


def persistence(
    samples: VelocitySamples, speed: float, settings: SearchSettings = DEFAULT
) -> float:
    r"""
    Return the probability that SSPs seem to keep a speed by chance alone.

    Where features have a new speed at every epoch, many of them move at any one speed
    between two epochs, which permuted epochs do not show, but it does not depend on
    how an SSP came whether it goes on.  Of N SSPs of an epoch and a scale, a come at the
    speed from the epoch before, b leave at it for the next, and m do both.  The sum
    over all epochs and scales is compared with that of independent SSPs,

    .. math:: z = \frac{\sum (m - ab / N)}{\sqrt{\sum a b (N - a) (N - b) / N^2 (N - 1)}}

    (Mantel & Haenszel 1959, J. Natl. Cancer Inst. 22, 719).

    Parameters
    ----------
    samples : ``VelocitySamples``
        Along the direction of the flow, in beams.
    speed : float
        In beams/yr.
    settings : `~astro_scc.streams.SearchSettings`, optional

    Returns
    -------
    float
        NaN if no SSP can show it.

    Examples
    --------
    Two features that move, and two SSPs that are matched with nothing of theirs:

    >>> import numpy as np
    >>> from astro_scc.stacking.velocities import VelocitySamples
    >>> from astro_scc.streams.persistence import persistence
    >>> epoch, feature = (k.ravel() for k in np.indices((6, 4)))
    >>> same = (feature[:, None] == feature) & (abs(epoch[:, None] - epoch) == 1)
    >>> ssp, to = np.nonzero(same)
    >>> d = VelocitySamples(
    ...     d1=np.where(feature[ssp] < 2, 0.5, 0) * (epoch[to] - epoch[ssp]),
    ...     d2=0.0 * ssp, weight=0.0 * ssp, reference=epoch[ssp], target=epoch[to],
    ...     ssp=ssp, target_ssp=to, epoch=epoch, scale=np.ones(24), years=np.arange(6.0))
    >>> round(persistence(d, 0.5), 4)
    0.0003
    """
    step = samples.target - samples.reference
    near = np.abs(samples.d1 - speed * samples.interval) <= settings.line
    near &= np.abs(samples.d2) <= settings.across
    n = len(samples.epoch)
    matched, comes, leaves = np.zeros((3, n), dtype=bool)
    matched[samples.ssp] = True
    for ssp, sense in ((samples.ssp, 1), (samples.target_ssp, -1)):
        leaves[ssp[near & (ssp >= 0) & (step == sense)]] = True
        comes[ssp[near & (ssp >= 0) & (step == -sense)]] = True
    middle = (samples.epoch > 0) & (samples.epoch < len(samples.years) - 1) & matched
    kind = np.stack([samples.epoch, samples.scale])[:, middle]
    group = np.unique(kind, axis=1, return_inverse=True)[1].ravel()
    of = (matched, comes, leaves, comes & leaves)
    number, a, b, both = (np.bincount(group, some[middle]) for some in of)
    variance = a * b * (number - a) * (number - b)
    variance /= np.maximum(number**2 * (number - 1), 1)
    if not variance.sum() > 0:
        return np.nan
    return float(ndtr(-(both - a * b / number).sum() / np.sqrt(variance.sum())))
