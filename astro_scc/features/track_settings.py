# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The constants with which detections are assigned to tracks."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class TrackSettings:
    """
    Constants of the assignment of detections to tracks; lengths are in beams.

    They were chosen on the development sources of ``benchmarks/features.py`` and on
    simulated jets.

    Parameters
    ----------
    scatter : float
        Scatter of a position about steady motion: 68% of the positions of the
        features of MOJAVE (Lister et al. 2021) are within 0.085.
    size_scatter, far_scatter : float
        The same per beam of a feature's size, and per beam of its distance from
        the core.
    far : float
        Distance from the core from which the scatter grows no more.
    wander : float
        Variance of the velocity per year, in beam^2/yr^3: features bend.
    speed : float
        Standard deviation of the prior of the speed, in beams per median interval.
    freedom : float
        Degrees of freedom of Student's t distribution of positions and fluxes.
    flux_step : float
        Scatter of the logarithm of the ratio of successive fluxes.
    detected : float
        Probability that a feature is detected in an epoch.
    density : float
        Other detections per square beam and epoch.
    most_missed : int
        Largest number of epochs in succession without a detection.
    gate : float
        Largest deviation of a detection from its prediction, in standard
        deviations.
    hypotheses, branches, kept : int
        Tracks that are kept from each first detection, ways in which each can
        continue, and tracks that are kept of each first and last detection.
    least_epochs : int
        Fewest epochs of a track.
    core : float
        Distance from the origin within which the nearest detection is the core.
    solutions : int
        Number of disturbed assignments.
    disturbance : float
        Standard deviation of the logarithmic likelihood of a link in them.
    agreed : float
        Share of the assignments that a link of a feature is part of.
    rounds : int
        Largest number of times that what is left is assigned again.

    Examples
    --------
    >>> from astro_scc.features import TrackSettings
    >>> TrackSettings().least_epochs
    4
    """

    scatter: float = 0.05
    size_scatter: float = 0.08
    far_scatter: float = 0.02
    far: float = 5.0
    wander: float = 0.0025
    speed: float = 0.6
    freedom: float = 4.0
    flux_step: float = 0.35
    detected: float = 0.75
    density: float = 0.2
    most_missed: int = 3
    gate: float = 5.0
    hypotheses: int = 12
    branches: int = 4
    kept: int = 8
    least_epochs: int = 4
    core: float = 0.25
    solutions: int = 16
    disturbance: float = 2.0
    agreed: float = 0.6
    rounds: int = 6
