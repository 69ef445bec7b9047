# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The constants of the search for streams, in beams."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """
    Constants of the search for streams; lengths are in beams.

    They were chosen on simulated jets by ``benchmarks/calibration/design.py``,
    with seeds that the calibration does not use.

    Parameters
    ----------
    radius : float
        Largest displacement between any two epochs that is searched: with
        1.5, neighbours one spacing apart seldom match.
    nearest, farthest : float
        Range of displacements that count for a speed: below 0.2 a standing
        feature overlaps itself, beyond 1 chance matches prevail.
    blur : float
        Standard deviation of the densities of the diagram, so wide that
        speeds with a dispersion and features that wander share a ray.
    smoothing : float
        Scatter of the displacements of one feature.
    across : float
        Largest displacement across the flow, three times ``smoothing``.
    interval_step, speed_step : float
        Relative widths of the bins of the intervals and of the grid of
        speeds; finer ones change nothing.
    slowest : float
        Smallest motion of a speed within the time span: blends of standing
        features whose fluxes vary drift by up to about one beam.
    drift : float
        Motion within the time span up to which a speed counts less, by its root:
        standing features whose fluxes vary slowly blend and drift.
    n_axes : int
        Number of directions, over half a turn, that are searched if the
        direction is unknown.
    line : float
        Largest distance of an SSP from the line of its feature.
    position_error : float
        Error of an SSP's position beyond noise, due to blending.
    least_epochs : int
        Smallest number of epochs in which a feature is seen.
    far_motion : float
        Motion with which one epoch less is enough.
    least_share : float
        Smallest fraction of the epochs from its first to its last one in which
        a feature is seen.  The fraction is at least 0.7 for 95% of the features
        that are followed correctly; SSPs that lie on a line by chance miss
        most epochs.
    least_motion : float
        Smallest motion of a stream's features while they are seen, added in
        quadrature: three features that move one beam, or one that moves
        farther than blends of standing features drift.
    p_secure : float
        Share of static jets with a secure feature: up to 0.03, by their kind
        (``benchmarks/features.py simulated``).
    least_score : float
        Smallest expected number of true matches of an SSP with which a feature begins.
    first_dispersion : float
        Relative dispersion about the speed of a stream of the speeds with which its
        features begin.
    least_z : float
        Smallest significance of the speed of a stream's feature, in standard
        deviations of the permutations.
    max_turns : int
        Largest number of steps in which the axis is turned to the direction of
        the features; on simulated jets two are enough.
    rest_errors : float
        Smallest distance of a moving speed from rest, in errors: 95% of a
        normal distribution, one-sided.
    pull : float
        Distance within which a standing feature attracts or repels positions.
        On simulated jets, speeds at 2 to 3 beams are 7 +- 2% too small without such
        positions (``benchmarks/calibration/followed.py``).
    pulled_error : float
        Relative error of the speed of a feature that is seen nowhere else.  On
        simulated jets such speeds are 13% too small, and scatter by 14%
        (``benchmarks/calibration/followed.py``).
    apart : float
        Smallest difference of two streams, in standard deviations of the
        difference that a flow with ``lone_dispersion`` gives.
    followed_share : float
        Features that are followed from image to image stand for a flow if they are
        at least this share of the chains of matches of other emission.
    same_speed : float
        Largest relative difference from the tested speed of the features
        that count if the mean of all is not significant, and of the parts of
        a feature before and after a long interval from its speed.
    accelerated_epochs : int
        Fewest SSPs of a feature with an acceleration.
    prior_freedom : int
        Degrees of freedom that ``position_error`` counts as: a straight line
        through three SSPs has one of its own.
    same_feature : float
        Features closer than this to the line of a longer one are parts of it.
    error_inflation : float
        Ratio of the errors of features to those from their residuals, as
        blends move smoothly; measured on simulated jets.
    core_bias : float
        Relative error of a feature's speed from the remaining pull of the
        core, on simulated jets.
    lone_dispersion : float
        Standard deviation of the prior of the dispersion relative to the speed, which
        is 0.29 for the sources of MOJAVE XVIII with three features or more that moved
        by more than a beam (root mean square; ``benchmarks/streams.py``).
    fewest_of_two : int
        Fewest features with which two streams can be distinguished.
    one_dispersions, two_dispersions : tuple of float
        Dispersions, relative to the mean, that are tried for one stream and
        for each of two.
    least_std : float
        Standard deviations of the permutations are at least this fraction of
        the largest of any axis at the same speed, so that single matches
        across the flow are not significant.
    all_orders_of : int
        Up to this number of epochs all permutations are used: the variance of
        a small sample would be inaccurate.

    Examples
    --------
    >>> from astro_scc.streams import SearchSettings
    >>> SearchSettings().radius
    1.5
    """

    radius: float = 1.5
    nearest: float = 0.2
    farthest: float = 1.0
    blur: float = 0.2
    smoothing: float = 0.12
    across: float = 0.35
    interval_step: float = 0.08
    speed_step: float = 0.05
    slowest: float = 1.0
    drift: float = 3.0
    n_axes: int = 12
    line: float = 0.3
    position_error: float = 0.06
    least_epochs: int = 4
    far_motion: float = 1.5
    least_share: float = 0.6
    least_motion: float = 1.75
    p_secure: float = 0.03
    least_score: float = 0.7
    first_dispersion: float = 0.3
    least_z: float = 1.5
    max_turns: int = 4
    rest_errors: float = 1.645
    pull: float = 1.6
    pulled_error: float = 0.2
    apart: float = 1.75
    followed_share: float = 1 / 3
    same_speed: float = 0.35
    accelerated_epochs: int = 5
    prior_freedom: int = 3
    same_feature: float = 0.5
    error_inflation: float = 1.3
    core_bias: float = 0.02
    lone_dispersion: float = 0.3
    fewest_of_two: int = 4
    one_dispersions: tuple[float, ...] = (
        0.01, 0.03, 0.05, 0.08, 0.1, 0.13, 0.16, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6,
        0.7, 0.8, 1.0,
    )  # fmt: skip
    two_dispersions: tuple[float, ...] = (0.03, 0.06, 0.1, 0.15, 0.2, 0.25)
    least_std: float = 0.3
    all_orders_of: int = 6


#: Settings that are used if no others are given.
DEFAULT = SearchSettings()
