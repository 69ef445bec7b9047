# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The constants of the search for streams, in beams."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """
    Constants of the search for streams that matter most; lengths are in beams.

    Others, which change little, stand where they are used.

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
    slowest : float
        Smallest motion of a speed within the time span: blends of standing
        features whose fluxes vary drift by up to about one beam.
    drift : float
        Motion within the time span up to which a speed counts less, by its root:
        standing features whose fluxes vary slowly blend and drift.
    line : float
        Largest distance of an SSP from the line of its feature.
    position_error : float
        Error of an SSP's position beyond noise, due to blending.
    least_epochs : int
        Smallest number of epochs in which a feature is seen.
    least_motion : float
        Smallest motion of a stream's features while they are seen, added in
        quadrature: three features that move one beam, or one that moves
        farther than blends of standing features drift.
    apart : float
        Smallest difference of two streams, in standard deviations of the
        difference that a flow with ``lone_dispersion`` gives.
    same_speed : float
        Largest relative difference from the tested speed of the features
        that count if the mean of all is not significant, and of the parts of
        a feature before and after a long interval from its speed.
    error_inflation : float
        Ratio of the errors of features to those from their residuals, as
        blends move smoothly; measured on simulated jets.
    lone_dispersion : float
        Standard deviation of the prior of the dispersion relative to the speed, which
        is 0.29 for the sources of MOJAVE XVIII with three features or more that moved
        by more than a beam (root mean square; ``benchmarks/streams.py``).

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
    slowest: float = 1.0
    drift: float = 3.0
    line: float = 0.3
    position_error: float = 0.06
    least_epochs: int = 4
    least_motion: float = 1.75
    apart: float = 1.75
    same_speed: float = 0.35
    error_inflation: float = 1.3
    lone_dispersion: float = 0.3


#: Settings that are used if no others are given.
DEFAULT = SearchSettings()
