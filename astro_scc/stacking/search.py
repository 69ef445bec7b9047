# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The constants of the search for streams, in beams."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """
    Constants of the search for streams; lengths are in beams.

    They were chosen on simulated jets by ``benchmarks/calibration/design.py``,
    with seeds that are not used for the calibration.

    Parameters
    ----------
    radius : float
        Largest displacement between any two epochs that is searched: with
        1.5, neighbours one spacing apart seldom match.
    nearest, farthest : float
        Displacements that count for a speed: below 0.2 a standing feature
        overlaps itself, beyond 1 chance matches prevail.
    blur : float
        Standard deviation of the densities of the diagram: speeds that
        differ and features that wander are to share a ray.
    smoothing : float
        Scatter of the displacements of one feature.
    across : float
        Largest displacement across the flow, three times ``smoothing``.
    interval_step, speed_step : float
        Relative widths of the bins of the intervals and of the grid of
        speeds; finer ones change nothing.
    slowest : float
        Beams that a speed must move within the time span: blends of standing
        features whose fluxes vary drift by up to about one beam.
    n_axes : int
        Directions that are searched if none is known, over half a turn.
    line : float
        Largest distance of an SSP from the line of its feature.
    position_error : float
        Error of an SSP's position beyond noise, by blending.
    least_epochs : int
        Epochs in which a feature is seen.
    least_share : float
        Share of the epochs from its first to its last one in which it is
        seen: of 95% of the features that are followed rightly it is 0.7 or
        more, SSPs that lie on a line by chance leave most epochs out.
    least_motion : float
        Beams that the features of a stream move while they are seen, added in
        squares: three that move one beam, or one that moves farther than the
        blends of standing features drift.
    least_score : float
        Smallest excess of matches over chance with which a feature begins.
    full_prior : float
        Significance, in standard deviations of the permutations, from which
        on a speed counts fully for single features.
    least_prior : float
        Weight of a speed for single features that no permutation test
        supports: features of any speed are followed, but never first.
    least_z : float
        Speeds less significant than this, in standard deviations of the
        permutations, are not those of a feature of the stream.
    max_turns : int
        The direction is that of the features after so many steps at most;
        on simulated jets it stays after two.
    rest_errors : float
        Errors that a speed is from rest: 95% of a normal distribution, one-sided.
    pull : float
        Positions this near to a standing feature are drawn to it or pushed away:
        of a line through them speeds are 7% too small at 2 to 2.5 beams on simulated
        jets, without them 0.1%.
    apart : float
        Two streams differ by so many standard deviations of what a flow
        with ``lone_dispersion`` scatters.
    same_speed : float
        Largest relative difference from the tested speed of the features
        that count where the mean of all is not significant.
    feature_speed_step : float
        Relative step of the speeds that single SSPs are given.
    accelerated_epochs : int
        Fewest SSPs of a feature of which an acceleration is known.
    prior_freedom : int
        Degrees of freedom that ``position_error`` counts as: a straight line
        through three SSPs has one of its own.
    same_feature : float
        Features closer than this to the line of a longer one are parts of it.
    error_inflation : float
        Errors of features are larger than their residuals say by this
        factor, as blends move smoothly; measured on simulated jets.
    core_bias : float
        Relative error of a feature's speed that is left of the pull of the
        core on simulated jets.
    lone_dispersion : float
        Dispersion, relative to the speed, that is assumed of a stream of
        which one feature is seen: that of the flows of blazars is 10 to 30%.
    fewest_of_two : int
        Fewest features of which two streams can be distinguished.
    one_dispersions, two_dispersions : tuple of float
        Dispersions, relative to the mean, that are tried for one stream and
        for each of two.
    least_std : float
        Standard deviations of the permutations are at least this share of the
        largest of any axis at the same speed: single matches across the flow
        are no surprise.
    all_orders_of : int
        Up to so many epochs all permutations are taken: a sample of few has a
        poor variance.

    Examples
    --------
    >>> from astro_scc.stacking import SearchSettings
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
    n_axes: int = 12
    line: float = 0.3
    position_error: float = 0.06
    least_epochs: int = 4
    least_share: float = 0.6
    least_motion: float = 1.75
    least_score: float = 1.5
    full_prior: float = 6.0
    least_prior: float = 0.15
    least_z: float = 1.5
    max_turns: int = 4
    rest_errors: float = 1.645
    pull: float = 1.6
    apart: float = 3.0
    same_speed: float = 0.35
    feature_speed_step: float = 0.06
    accelerated_epochs: int = 5
    prior_freedom: int = 3
    same_feature: float = 0.5
    error_inflation: float = 1.3
    core_bias: float = 0.02
    lone_dispersion: float = 0.15
    fewest_of_two: int = 4
    one_dispersions: tuple = (
        0.01, 0.03, 0.05, 0.08, 0.1, 0.13, 0.16, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6,
        0.7, 0.8, 1.0,
    )  # fmt: skip
    two_dispersions: tuple = (0.03, 0.06, 0.1, 0.15, 0.2, 0.25)
    least_std: float = 0.3
    all_orders_of: int = 6


#: What is used where no other settings are given.
DEFAULT = SearchSettings()
