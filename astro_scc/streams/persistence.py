# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Whether what moves keeps its speed from one interval to the next."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from astro_scc.stacking.velocities import VelocitySamples
from astro_scc.streams.search_settings import DEFAULT, SearchSettings

#: Mean number of SSPs of an epoch and a scale: dense flows have more than eight, the
#: sources of MOJAVE whose features are chains two or three.
LEAST_SSPS = 5


def persistence(
    samples: VelocitySamples, speed: float, settings: SearchSettings = DEFAULT
) -> float:
    r"""
    Return the probability that SSPs seem to keep a speed by chance alone.

    Where features have a new speed at every epoch, many of them move at any one speed
    between two epochs, which permuted epochs do not show, but it does not depend on
    how an SSP came whether it goes on.  SSP i has x links at this speed with earlier
    epochs and y with later ones, each a match of one of the two SSPs, at most twice
    ``blur`` from the line.  Their covariance within the N SSPs of an epoch and a scale,
    summed over all of these, is compared with that of y in random order,

    .. math:: z = \sum S_{xy} \left(\frac{n + 1}{2}
                  \sum \frac{S_{xx} S_{yy}}{N - 1}\right)^{-1/2}, \quad
              S_{xy} = \sum_i (x_i - \bar x)(y_i - \bar y)

    (Hoeffding 1951, Ann. Math. Stat. 22, 558).  The same feature has SSPs on several of
    the n scales, whose covariances have a correlation of about 0.5: without a common
    speed, z has a mean of 0.2 and a standard deviation of 1.0 to 1.1 over all speeds.

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
        NaN where fewer than five SSPs share an epoch and a scale, which seldom show it,
        or half of all come at this speed, which is then common.

    Examples
    --------
    Two features that move, and four that stand still:

    >>> import numpy as np
    >>> from astro_scc.stacking.velocities import VelocitySamples
    >>> from astro_scc.streams.persistence import persistence
    >>> epoch, feature = (k.ravel() for k in np.indices((6, 6)))
    >>> same = (feature[:, None] == feature) & (abs(epoch[:, None] - epoch) == 1)
    >>> ssp, to = np.nonzero(same)
    >>> d = VelocitySamples(
    ...     d1=np.where(feature[ssp] < 2, 0.5, 0) * (epoch[to] - epoch[ssp]),
    ...     d2=0.0 * ssp, weight=0.0 * ssp, reference=epoch[ssp], target=epoch[to],
    ...     ssp=ssp, target_ssp=to, epoch=epoch, scale=np.ones(36),
    ...     years=np.arange(6.0))
    >>> persistence(d, 0.5) < 1e-3
    True
    """
    epoch, scale = np.asarray(samples.epoch), np.asarray(samples.scale)
    off = samples.d1 - speed * samples.interval
    near = (np.abs(off) <= 2 * settings.blur) & (np.abs(samples.d2) <= settings.across)
    links = _links(samples.select(near))
    n = len(epoch)
    before, after = (
        np.bincount(links[0, links[2] == way], minlength=n) for way in (-1, 1)
    )
    # Those with an earlier and a later epoch.
    used = np.isin(np.arange(n), samples.ssp)
    ends = np.unique(epoch[used])[[0, -1]] if used.any() else (0, 0)
    used &= (epoch > ends[0]) & (epoch < ends[1])
    kind = np.stack([epoch, scale])[:, used]
    group = np.unique(kind, axis=1, return_inverse=True)[1].ravel()
    number = np.bincount(group)

    def moment(one, other):
        mean = np.bincount(group, one) / number
        return np.bincount(group, (one - mean[group]) * other)

    x, y = before[used], after[used]
    if len(x) < LEAST_SSPS * len(number) or np.count_nonzero(x) >= len(x) / 2:
        return np.nan
    variance = np.sum(moment(x, x) * moment(y, y) / np.maximum(number - 1, 1))
    variance *= (len(np.unique(kind[1])) + 1) / 2
    return float(ndtr(-moment(x, y).sum() / np.sqrt(variance))) if variance else np.nan


def _links(d):
    """Return SSP, what it is linked with, and 1 if that is later, -1 if earlier."""
    way = np.sign(d.interval).astype(int)
    # A match on no SSP is a link with the image.
    lone = d.target_ssp < 0
    links = np.stack([d.ssp, np.where(lone, -1 - d.target, d.target_ssp), way])
    turned = links[[1, 0, 2], :][:, ~lone] * [[1], [1], [-1]]
    return np.unique(np.concatenate([links, turned], axis=1), axis=1)
