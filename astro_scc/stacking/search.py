# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The constants of the search for streams, in beams."""

from dataclasses import dataclass

__all__ = ["SearchSettings"]


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
