# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams, and whether they move, stand still or are not significant."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from astro_scc.streams.chains import Feature
from astro_scc.streams.dispersion import Population

#: Largest share of static jets of any kind with a secure feature that moves by
#: ``least_motion`` or more (``benchmarks/features.py simulated``).
P_SECURE = 0.01
#: Fewest epochs of a feature that alone stands for a stream and was not followed from
#: image to image, as of the robust features of surveys (Lister et al. 2021, ApJ 923,
#: 30).
LONE_EPOCHS = 5
#: Smallest distance of a moving speed from rest, in errors: 95% of a normal
#: distribution, one-sided.
REST_ERRORS = 1.645
#: What needs more than so many times the epochs is out of reach.
MOST_EPOCHS = 10


@dataclass(frozen=True, eq=False)
class Stream:
    """
    A stream: features whose speeds scatter about one mean.

    Attributes
    ----------
    kind : {"moving", "not confirmed", "stationary", "not significant"}
        Not confirmed: ``p_global`` is at most alpha, but something holds it back.
    reason : str
        Why it is neither moving nor stationary, or what ``p_global`` rests on, or ''.
    angle : float
        Direction of the axis from the first axis of the frame, in radians.
    along, across : ``Population``
        Mean and dispersion of the speeds of its features, in beams/yr.
    z : float
        Excess along its ray in standard deviations of the permutations.
    p_local, p_global : float
        p-values of the permutation test at exactly this speed, see
        `EpochPermutations`.  Where ``p_global`` is above alpha, the evidence of the
        first stream's secure features is added.
    p_distinct : float
        Probability that one stream fewer gives features that separate as
        well; for the first stream its ``p_global``.
    features : tuple of ``Feature``

    Examples
    --------
    >>> from astro_scc.streams.dispersion import random_effects
    >>> from astro_scc.streams.classification import Stream
    >>> still = random_effects([0.01, -0.02], [0.02, 0.02])
    >>> Stream("stationary", "", 0.0, still, still).kind
    'stationary'
    """

    kind: str
    reason: str
    angle: float
    along: Population
    across: Population
    z: float = np.nan
    p_local: float = 1.0
    p_global: float = 1.0
    p_distinct: float = 1.0
    features: tuple[Feature, ...] = field(default=(), repr=False)


def classify(
    along, z, p_global, features, permutations, alpha, settings, *, p_keeps=np.nan,
    beside=False,
):  # fmt: skip
    """
    Return the kind of a stream; if it is not significant, why and what is needed.

    The matches of a stream grow in proportion to the number of epochs, and their
    scatter under permutations as its square root, so ``(z_alpha / z)^2`` times as
    many epochs give a significance ``z_alpha``.

    Parameters
    ----------
    along : ``Population``
    z, p_global : float
        Significance of the mean speed, and its probability.
    features : sequence of ``Feature``
    permutations : ``EpochPermutations``
    alpha : float
    settings : `~astro_scc.streams.SearchSettings`
    p_keeps : float
        See `persistence`; NaN if features diffuse.
    beside : bool
        Whether the stream is beside one that moves.

    Returns
    -------
    kind, reason : str
    """
    smallest_p = permutations.smallest_p
    moved = np.hypot.reduce([f.motion for f in features])
    followed = any(f.followed for f in features)
    lone = len(features) == 1 and not followed and not beside
    # Where features diffuse, their mean may have either sign.
    both = len({f.speed > 0 for f in features}) == 2
    rest = REST_ERRORS * (2 if both else 1)
    if smallest_p > alpha:
        reason = f"too few epochs or trials: no p_global below {smallest_p:.2g}"
    elif p_global > alpha:
        reason = f"permuted epochs give as strong a peak (p_global {p_global:.2g})"
        more = (np.quantile(permutations.maxima, 1 - alpha) / max(z, 1e-9)) ** 2
        if 1 < more <= MOST_EPOCHS:
            reason += f"; if it is real, {more:.1f} times as many epochs should show it"
    elif not features:
        reason = "no single feature is seen to move at this speed"
    elif moved < settings.least_motion and not followed:
        reason = (
            f"its features move {moved:.1f} beams (root of the sum of squares), not "
            f"{settings.least_motion:g}: blends of standing features drift as far; "
            f"followed {np.ceil(10 * settings.least_motion / moved) / 10:.1f} times as "
            "long, they would move enough"
        )
    elif lone and len(features[0]) < LONE_EPOCHS:
        reason = (
            f"it rests on a single feature in {len(features[0])} epochs, which was "
            "matched but not followed from image to image; one more feature, or "
            f"{LONE_EPOCHS} epochs of it, would confirm it"
        )
    elif p_keeps > alpha:
        reason = (
            "its patterns do not keep this speed from one interval to the next more "
            f"often than by chance (p {p_keeps:.2g})"
        )
    elif abs(along.mean) <= rest * along.error:
        reason = f"rest is within {rest:g} errors of the speed"
    else:
        return "moving", ""
    passes = max(p_global, smallest_p) <= alpha
    return "not confirmed" if passes else "not significant", reason


def with_secure(p_global, n_secure, alpha):
    """
    Return the p-value of permuted epochs and of secure features together.

    They are combined by Fisher's method (1925, Statistical Methods for Research
    Workers) where the permutations alone do not reject.

    Parameters
    ----------
    p_global : float
        Of the permutation test.
    n_secure : int
        Number of secure features that move with the stream, and far enough.
    alpha : float

    Returns
    -------
    p_global : float
    note : str
        What it rests on, if that is more than the permutation test.
    """
    if n_secure == 0 or p_global <= alpha:
        return p_global, ""
    # Minus twice the logarithm of the product has a chi-square of 4 degrees of freedom.
    product = p_global * P_SECURE
    both = float(product * (1 - np.log(product)))
    if both > alpha:
        return p_global, ""
    some = "a secure feature" if n_secure == 1 else f"{n_secure} secure features"
    note = f"permuted epochs alone give p_global {p_global:.2g}, but {some} moved"
    return both, note
