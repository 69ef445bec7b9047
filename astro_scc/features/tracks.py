# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracks: detections of one feature at successive epochs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from astro_scc.features.detections import Detections
from astro_scc.features.hypotheses import Assignment, steady_hypotheses


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


#: A track of another assignment is the same if it has so many of its detections...
SAME_DETECTIONS = 0.5
#: ... and has the same velocity, if that differs relatively by at most so much.
SAME_VELOCITY = 0.2


@dataclass(frozen=True, eq=False)
class Track:
    """
    Detections of one feature, one per epoch.

    Attributes
    ----------
    detection : `~numpy.ndarray` of int, shape (n,)
        In the order of the epochs.
    same_speed : float
        Share of the disturbed assignments with a track of these detections, at the
        same dates, that has the same velocity.
    proven : bool
        Whether the assignment was solved to the end.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.features.tracks import Track
    >>> len(Track(np.array([0, 2, 3, 5]), 1.0, True))
    4
    """

    detection: np.ndarray
    same_speed: float
    proven: bool

    def __len__(self) -> int:
        return len(self.detection)


def find_tracks(
    detections: Detections, settings: TrackSettings | None = None, *, seed: int = 0
) -> list[Track]:
    """
    Assign detections to tracks, each to one track at most.

    All tracks of nearly steady motion compete for the detections, and the
    assignment with the largest likelihood is searched, together with others whose
    links have disturbed likelihoods.  Tracks are made of the links that most
    assignments agree upon.  What is left is assigned again, until nothing more is
    found.

    Parameters
    ----------
    detections : `Detections`
        Without the core.
    settings : `TrackSettings`, optional
    seed : int, optional
        Seed of the disturbances.

    Returns
    -------
    list of `Track`
        In the order of their first epochs.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.features.detections import Detections
    >>> from astro_scc.features.tracks import find_tracks
    >>> epoch = np.repeat(np.arange(6), 2)
    >>> place = np.stack([0.3 * epoch + [1, 4] * 6, 0.0 * epoch], axis=1)
    >>> d = Detections(
    ...     epoch=epoch, place=place, place_error=np.full((12, 2), 0.01),
    ...     flux=np.array([1.0, 0.2] * 6), size=np.zeros(12), beam=np.eye(2) / 5.545,
    ...     years=2000.0 + np.arange(6))
    >>> [track.detection.tolist() for track in find_tracks(d)]
    [[0, 2, 4, 6, 8, 10], [1, 3, 5, 7, 9, 11]]
    """
    settings = TrackSettings() if settings is None else settings
    free, found = np.ones(len(detections), dtype=bool), []
    for turn in range(settings.rounds):
        left = np.flatnonzero(free)
        new = _agreed(detections.select(left), settings, seed + turn)
        if not new:
            break
        for track in new:
            found.append(replace(track, detection=left[track.detection]))
            free[found[-1].detection] = False

    def order(track):
        first = track.detection[0]
        return detections.epoch[first], detections.number[first]

    return sorted(found, key=order)


def _agreed(d, settings, seed):
    """Return tracks of the links that most assignments agree upon."""
    paths, score = steady_hypotheses(d, settings)
    if not paths:
        return []
    assignment = Assignment(paths, len(d))
    chosen, proven = assignment.best(score)
    solutions = [chosen]
    one = np.concatenate([path[:-1] for path in paths])
    other = np.concatenate([path[1:] for path in paths])
    owner = np.repeat(np.arange(len(paths)), [len(path) - 1 for path in paths])
    links, which = np.unique(one * len(d) + other, return_inverse=True)
    for trial in range(settings.solutions):
        normal = _normal(d, *np.divmod(links, len(d)), seed, trial)
        noise = settings.disturbance * normal[which]
        disturbed = score + np.bincount(owner, noise, len(paths))
        solutions.append(assignment.good(disturbed))
    share = np.zeros(len(links))
    for chosen in solutions:
        used = np.bincount(which[np.isin(owner, chosen)], minlength=len(links))
        share += used / len(solutions)
    before, after = np.divmod(links[share > settings.agreed], len(d))
    follows = dict(zip(before.tolist(), after.tolist(), strict=True))
    tracks = []
    for chain in _chains(follows):
        if len(chain) < settings.least_epochs:
            continue
        detection = np.array(chain)
        same = _same_speed(d, detection, paths, solutions)
        tracks.append(Track(detection, same, proven))
    return tracks


def _chains(follows):
    """Yield chains of detections that follow each other."""
    for start in sorted(follows.keys() - set(follows.values())):
        chain = [start]
        while chain[-1] in follows:
            chain.append(follows[chain[-1]])
        yield chain


def _same_speed(d, detection, paths, solutions):
    """Return the share of the assignments in which a track has the same velocity."""
    time, place = d.time, d.place
    first, last = time[detection[[0, -1]]]
    own, velocity = set(detection.tolist()), _velocity(time, place, detection)
    n_same = 0
    for chosen in solutions:
        common, best = max(
            ((len(own.intersection(paths[k])), k) for k in chosen.tolist()),
            default=(0, 0),
        )
        if common < SAME_DETECTIONS * len(own):
            continue
        same = np.array(paths[best])
        same = same[(time[same] >= first) & (time[same] <= last)]
        if len(same) > 2:
            off = np.hypot(*(_velocity(time, place, same) - velocity))
            n_same += off <= SAME_VELOCITY * np.hypot(*velocity)
    return n_same / len(solutions)


def _velocity(time, place, detection):
    dt = time[detection] - time[detection].mean()
    return dt @ place[detection] / (dt @ dt)


def _normal(d, one, other, seed, trial):
    """
    Return a normally distributed number for each link.

    It depends on the epochs and numbers of the two detections alone, so that more
    epochs leave it as it is (mixing of bits: Steele, Lea & Flood 2014).
    """
    parts = d.epoch[one], d.number[one], d.epoch[other], d.number[other], seed, trial
    bits = np.zeros(len(one), dtype=np.uint64)
    for part in parts:
        bits += np.asarray(part).astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        bits ^= bits >> np.uint64(31)
    return ndtri((bits >> np.uint64(11)).astype(float) / 2.0**53 + 2.0**-54)
