# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Motions of features: lines, parabolas or random walks, and which to trust."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass
from typing import Any

import numpy as np

from astro_scc.features.detections import Detections
from astro_scc.intervals import median_interval

#: Scatter of positions beyond noise in beams, and the number of positions that it
#: counts as: a straight line through four positions has few degrees of freedom.
SCATTER, PRIOR_FREEDOM = 0.06, 3.0
#: Degrees of freedom of Student's t distribution of the residuals.
FREEDOM = 4.0
#: Features do not keep to a straight line: between its first and its last date each is
#: off by about so many beams, whether that takes one year or twelve (development
#: sources of ``benchmarks/features.py``).
WANDER = 0.09
#: A parabola needs so many positions, and an acceleration of so many errors.
ACCELERATED_EPOCHS, ACCELERATED = 7, 3.0
#: Largest angle between motion and radius, plus two standard errors, in degrees
#: (Lister et al. 2019), and errors from which a speed is significant.
RADIAL, SIGNIFICANT = 15.0, 3.0
#: Fewest epochs of a secure feature.
LEAST_EPOCHS = 4


@dataclass(frozen=True, eq=False)
class Motion:
    """
    The motion of a feature on two axes.

    Attributes
    ----------
    date : float
        Date in years to which position and velocity refer: the mean, or, of a parabola,
        that at which it has its mean velocity.
    place, place_err, velocity, velocity_err : `~numpy.ndarray`, shape (2,)
        With their standard errors, in mas and mas/yr.
    acceleration, acceleration_err : `~numpy.ndarray`, shape (2,)
        In mas/yr^2; NaN unless a parabola is better than a line.
    span : float
        Time from the first to the last position in years.
    residual : `~numpy.ndarray`, shape (n, 2)
        Positions less the fit.
    used : `~numpy.ndarray` of bool, shape (n,)
        Positions that the fit did not set aside as outliers.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.features.motion import fit_motion
    >>> time = np.arange(2000.0, 2006.0)
    >>> place = np.stack([0.3 * (time - 2000), 2 - 0.1 * (time - 2000)], axis=1)
    >>> fit = fit_motion(time, place, np.full((6, 2), 0.01), 1.0)
    >>> fit.date, fit.place.round(2), fit.velocity.round(2)
    (2002.5, array([0.75, 1.75]), array([ 0.3, -0.1]))
    """

    date: float
    place: np.ndarray
    place_err: np.ndarray
    velocity: np.ndarray
    velocity_err: np.ndarray
    acceleration: np.ndarray
    acceleration_err: np.ndarray
    span: float
    residual: np.ndarray
    used: np.ndarray

    @property
    def speed(self) -> float:
        """Length of the velocity in mas/yr."""
        return float(np.hypot(*self.velocity))

    @property
    def speed_err(self) -> float:
        """Standard error of the speed."""
        return self.error_along(self.velocity)

    @property
    def moved(self) -> np.ndarray:
        """Motion from the first to the last position in mas, shape (2,)."""
        return self.velocity * self.span

    @property
    def accelerated(self) -> bool:
        """Whether a parabola is better than a straight line."""
        return bool(np.isfinite(self.acceleration).all())

    def at(self, years: np.ndarray) -> np.ndarray:
        """Return the places at dates in years, shape (n, 2) in mas."""
        dt = (years - self.date)[:, None]
        bend = np.nan_to_num(self.acceleration)
        return self.place + self.velocity * dt + bend * dt**2 / 2

    def error_along(self, direction: np.ndarray) -> float:
        """
        Return the standard error of the velocity along a direction.

        Parameters
        ----------
        direction : `~numpy.ndarray`, shape (2,)
            Of any length.

        Returns
        -------
        float
        """
        length = np.hypot(*direction)
        share = direction / length if length > 0 else np.full(2, np.sqrt(0.5))
        return float(np.hypot(*(share * self.velocity_err)))

    def ejection(self, core_error: float, beam: float) -> tuple[float, float]:
        r"""
        Return the date at which the feature was at the core.

        .. math:: t_\mathrm{ej} = t - \frac{\boldsymbol r \cdot \boldsymbol\mu}
                                           {|\boldsymbol\mu|^2}

        As in MOJAVE (Lister et al. 2019, ApJ 874, 43), only for a speed of three
        standard errors or more, without acceleration, at an angle to the radius
        that plus two standard errors is within 15 degrees; the line must also pass
        the core within one beam.

        Parameters
        ----------
        core_error : float
            Standard error of the position of the core, in mas.
        beam : float
            Full width at half maximum, in mas.

        Returns
        -------
        date, error : float
            In years; NaN if the criteria are not met.
        """
        r, v = self.place, self.velocity
        speed, distance = self.speed, np.hypot(*r)
        if self.accelerated or speed < SIGNIFICANT * self.speed_err or distance == 0:
            return np.nan, np.nan
        cross = abs(r[0] * v[1] - r[1] * v[0])
        turned = np.array([v[1], -v[0]]) / speed
        of_motion = self.error_along(turned) / speed
        of_radius = np.hypot(*(np.array([r[1], -r[0]]) * self.place_err)) / distance**2
        angle = np.degrees(np.arctan2(cross, r @ v))
        off = angle + 2 * np.degrees(np.hypot(of_motion, of_radius))
        if cross / speed > beam or off > RADIAL:
            return np.nan, np.nan
        by_v = (2 * (r @ v) * v / speed**2 - r) / speed**2
        parts = (v / speed**2 * self.place_err, by_v * self.velocity_err)
        error = np.hypot(np.linalg.norm(parts), core_error / speed)
        return float(self.date - r @ v / speed**2), float(error)


def fit_motion(
    time: np.ndarray, place: np.ndarray, error: np.ndarray, beam: float
) -> Motion:
    r"""
    Fit a straight line to positions, and a parabola where it is better.

    Residuals are distributed as Student's t with four degrees of freedom, so that
    outliers count less.  The variance of a velocity has two parts,

    .. math:: \frac{\sigma^2}{\sum w (t - \bar t)^2} + \left(\frac{0.09\,b}{T}\right)^2,

    that of the residuals, drawn towards 0.06 beams, and one for features that
    wander by about 0.09 beams b, however long the time span T is.  A parabola is
    better if it has seven positions or more, an acceleration of three standard
    errors, and a smaller Bayesian information criterion.

    Parameters
    ----------
    time : `~numpy.ndarray`, shape (n,)
        In years, at least two different ones.
    place, error : `~numpy.ndarray`, shape (n, 2)
        In mas.
    beam : float
        Full width at half maximum, in mas.

    Returns
    -------
    `Motion`

    Raises
    ------
    ValueError
        If all positions are of one date.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.features.motion import fit_motion
    >>> time = np.arange(2000.0, 2010.0)
    >>> dt = time - time.mean()
    >>> place = np.stack([3 + 0.3 * dt + 0.05 * dt**2, 0 * dt], axis=1)
    >>> fit_motion(time, place, np.full((10, 2), 0.01), 1.0).acceleration.round(2)
    array([0.1, 0. ])
    """
    span = np.ptp(time)
    if not span > 0:
        raise ValueError("a motion needs positions of at least two dates")
    scatter = np.sqrt((SCATTER * beam) ** 2 + (error**2).mean(axis=1))
    dt = time - time.mean()
    wander = WANDER * beam / span
    line = _robust(dt, place, scatter, 1)
    fit, bend, middle = line, np.full((2, 2), np.nan), 0.0
    if len(time) >= ACCELERATED_EPOCHS:
        curve = _robust(dt, place, scatter, 2)
        # White noise makes errors of slope and bend in this ratio.
        bend_err = np.hypot(curve.errors[2], np.sqrt(60) / span * wander)
        significance = np.linalg.norm(curve.coefficients[2] / bend_err)
        if significance >= ACCELERATED and line.cost - curve.cost > np.log(len(time)):
            fit, bend = curve, np.stack([curve.coefficients[2], bend_err])
            # At this date the parabola has the velocity of the line through it.
            w = curve.weight / scatter**2
            off = w * (dt - np.average(dt, weights=w))
            middle = (off @ dt**2) / (2 * off @ dt)
    powers = middle ** np.arange(3) / (1, 1, 2)
    n = len(fit.coefficients)
    return Motion(
        date=float(time.mean() + middle), place=powers[:n] @ fit.coefficients,
        place_err=np.hypot(fit.errors[0], middle * fit.errors[1]),
        velocity=powers[: n - 1] @ fit.coefficients[1:],
        velocity_err=np.hypot(line.errors[1], wander), acceleration=bend[0],
        acceleration_err=bend[1], span=float(span), residual=fit.residual,
        used=fit.weight > 0.3,
    )  # fmt: skip


#: A polynomial: coefficients and errors (degree + 1, 2), and its residuals.
_Fit = namedtuple("_Fit", "coefficients errors residual weight cost")


def _robust(dt, place, scatter, degree):
    """Fit a polynomial with residuals distributed as Student's t."""
    # Powers of the span, so that the matrix does not depend on the unit of time.
    span = np.ptp(dt) ** np.arange(degree + 1)
    powers = (dt[:, None] / span[1]) ** np.arange(degree + 1)
    design = powers / (1, 1, 2)[: degree + 1]
    weight = np.ones(len(dt))
    for _ in range(10):
        w = weight / scatter**2
        inverse = np.linalg.pinv(design.T @ (w[:, None] * design))
        solution = inverse @ design.T @ (w[:, None] * place)
        residual = place - design @ solution
        square = (residual**2).sum(axis=1) / scatter**2
        weight = (FREEDOM + 2) / (FREEDOM + square)
    weight = weight / weight.max()
    # Variances in units of the square of the scatter.
    free = max(weight.sum() - degree - 1, 0.0) + PRIOR_FREEDOM
    parts = weight[:, None] * (residual / scatter[:, None]) ** 2
    variance = (parts.sum(axis=0) + PRIOR_FREEDOM) / free
    w = weight / scatter**2
    inverse = np.linalg.pinv(design.T @ (w[:, None] * design))
    errors = np.sqrt(inverse.diagonal()[:, None] * variance)
    cost = (FREEDOM + 2) / 2 * np.log1p(square / FREEDOM).sum()
    span = span[:, None]
    return _Fit(solution / span, errors / span, residual, weight, float(cost))


# -- whether a track is one feature --------------------------------------------------

#: Logistic regression of what the survey's positions confirm, on the properties in
#: `properties`: constant, and coefficients (``benchmarks/features.py trust``).
CONSTANT = -5.88
COEFFICIENTS = np.array([1.41, -0.60, 0.88, 0.82, 2.32, 1.44, -0.62, -7.23])
#: Which of them is that of the angle between motion and radius.
COSINE = 3
#: A feature is secure if it is false with at most this probability, has the same
#: speed in such a share of the disturbed assignments, and moves so: of static jets at
#: most one in fifteen then has one (``benchmarks/features.py``).
MOST_FALSE, SAME_SPEED = 0.3, 0.5
#: Least motion in beams and in standard errors, and fewest epochs: far, or clearly.
MOTIONS = (1.0, SIGNIFICANT, LEAST_EPOCHS), (0.5, 5.0, 5)
#: Beyond so many beams, other detections do not matter.
FAR = 2.0


def properties(detections: Detections, track: np.ndarray, motion: Motion) -> np.ndarray:
    """
    Return the properties of a track from which its probability follows.

    Parameters
    ----------
    detections : ``Detections``
    track : `~numpy.ndarray` of int
        The detections of the track.
    motion : ``Motion``

    Returns
    -------
    `~numpy.ndarray`, shape (8,)
        Logarithms of the number of its epochs, of its motion and of its distance
        from the core in beams; cosine of the angle between motion and radius;
        share of the epochs from first to last in which it is seen; distance of the
        nearest other detection in beams; scatter of the logarithm of its flux
        from epoch to epoch; scatter of its positions in beams.
    """
    d = detections
    epoch, place = d.epoch[track], d.in_beams
    distance = np.hypot(*motion.place)
    length = distance * motion.speed
    cosine = motion.velocity @ motion.place / length if length > 0 else 0.0
    nearest = []
    for k in track.tolist():
        same = np.arange(*np.searchsorted(d.epoch, (d.epoch[k], d.epoch[k] + 1)))
        away = np.hypot(*(place[same[same != k]] - place[k]).T)
        nearest.append(away.min(initial=FAR))
    return np.array(
        [
            np.log(len(track)),
            np.log(max(np.hypot(*d.to_beams(motion.moved)), 0.05)),
            np.log(distance / d.fwhm + 0.3),
            cosine,
            len(track) / (epoch[-1] - epoch[0] + 1),
            np.median(nearest),
            np.diff(np.log(d.flux[track])).std(),
            np.sqrt((motion.residual**2).mean()) / d.fwhm,
        ]
    )


def p_false_of(known: np.ndarray, *, outward: bool = False) -> np.ndarray:
    """
    Return the probability of each track that it is no feature, or parts of several.

    Parameters
    ----------
    known : array_like, shape (n, 8)
        Their `properties`.
    outward : bool, optional
        Whether they count as moving outward, for want of a core.

    Returns
    -------
    `~numpy.ndarray`, shape (n,)
    """
    known = np.array(known).reshape(-1, len(COEFFICIENTS))
    if outward:
        known[:, COSINE] = 1.0
    return 1 / (1 + np.exp(CONSTANT + known @ COEFFICIENTS))


def are_secure(p_false, same_speed, moved, errors, n_epochs):
    """
    Return which tracks are one feature each, with a reliable speed.

    They have a ``p_false`` of at most ``MOST_FALSE``, the same speed in the share
    ``SAME_SPEED`` of the assignments, and `moves_enough`.

    Parameters
    ----------
    p_false, same_speed : `~numpy.ndarray`, shape (n,)
    moved, errors : `~numpy.ndarray`, shape (n,)
        Motion from the first to the last date, in beams along it, and speed in
        standard errors.
    n_epochs : `~numpy.ndarray` of int, shape (n,)

    Returns
    -------
    `~numpy.ndarray` of bool, shape (n,)
    """
    stable = (same_speed >= SAME_SPEED) & (p_false <= MOST_FALSE)
    return stable & moves_enough(moved, errors, n_epochs)


def moves_enough(moved, errors, n_epochs):
    """Return whether motions in beams and in standard errors are one of ``MOTIONS``."""
    enough = [
        (moved >= beams) & (errors >= sigma) & (n_epochs >= epochs)
        for beams, sigma, epochs in MOTIONS
    ]
    return np.logical_or.reduce(enough)


def motions_in_words():
    """Return ``MOTIONS`` in words."""
    return ", or ".join(
        f"{beams:g} beam{'s' * (beams != 1)} and {sigma:g} standard errors in "
        f"{epochs} epochs"
        for beams, sigma, epochs in MOTIONS
    )


# -- whether features diffuse -------------------------------------------------------

#: Variance of the slope of a straight line through a random walk, times its duration
#: over the variance of the walk in unit time.
SLOPE = 1.2
#: Epochs of a feature of which each half has a speed, and fewest such features: random
#: walks of 30 epochs have 29 or more, resolved jets in 11 images 5 to 12, whose layers
#: differ as halves of a walk do.
HALVES_OF, FEWEST = 6, 15
#: Smallest random step in the median interval, in beams, change of the speeds between
#: the halves, and isotropy: what random walks have, as far as they can be followed, and
#: neither simulated jets nor those of MOJAVE have together
#: (``benchmarks/calibration/diffusion.py``).
STEP, CHANGE, ISOTROPY = 0.085, 0.7, 0.7


def measure_diffusion(features: Any) -> dict[str, float]:
    """
    Compare the speeds of features in both halves of their epochs.

    Parameters
    ----------
    features : `~astro_scc.features.Features`

    Returns
    -------
    dict of float
        ``n_features`` that are seen in so many epochs that each half has a speed;
        ``step``, the random step on each axis in the median interval, in beams;
        ``change``, the variance of the difference of the speeds of the halves, over
        that of the speeds of features: 0 if each keeps its own speed, 4 in a random
        walk; ``isotropy``, the scatter of the speeds across their mean direction over
        that along it; and ``variance`` of the speeds on each axis, times years, in
        mas^2/yr.
    """
    found = {"step": 0.0, "change": 0.0, "isotropy": 0.0, "variance": 0.0}
    d = features.detections
    each = zip(features.tracks, features.motions, strict=True)
    long = [(track, motion) for track, motion in each if len(track) >= HALVES_OF]
    found["n_features"] = len(long)
    if len(long) < 2:
        return found
    span = np.array([motion.span for _, motion in long])
    speed = np.array([motion.velocity for _, motion in long])
    mean = np.average(speed, axis=0, weights=span)
    length = np.hypot(*mean)
    along = mean / length if length > 0 else np.array([1.0, 0.0])
    axes = np.stack([along, along[::-1] * (-1, 1)], axis=1)
    variance = span @ ((speed - mean) @ axes) ** 2
    if not np.all(variance > 0):
        return found
    difference = 0.0
    for years, (members, _) in zip(span, long, strict=True):
        half = len(members) // 2
        v, v_var = d.velocity(members[:half])
        w, w_var = d.velocity(members[-half:])
        difference += years * ((v - w) ** 2 - v_var - w_var).sum()
    walk = random_walk(features) * median_interval(d.time)
    return found | {
        "change": float(difference / variance.sum()),
        "step": float(np.sqrt(walk / SLOPE) / d.fwhm),
        "isotropy": float(np.sqrt(variance[1] / variance[0])),
        "variance": float(variance.sum() / 2 / (len(long) - 1)),
    }


def is_walk(found: dict[str, float]) -> bool:
    """
    Return whether features diffuse.

    Parameters
    ----------
    found : dict of float
        See `measure_diffusion`.

    Returns
    -------
    bool

    Examples
    --------
    >>> from astro_scc.features.motion import is_walk
    >>> is_walk({"n_features": 30, "step": 0.1, "change": 1.5, "isotropy": 1.0})
    True
    """
    enough = found["n_features"] >= FEWEST and found["step"] >= STEP
    return enough and found["change"] >= CHANGE and found["isotropy"] >= ISOTROPY


def random_walk(features: Any) -> float:
    """
    Return the variance of the speeds of features from their random walk, times years.

    The variance of a step about the motion is that of the walk plus twice that of a
    position, and neighbouring steps have minus the latter in common.  The slope of a
    straight line through a walk of variance q a year over T years has the variance
    ``SLOPE * q / T``.

    Parameters
    ----------
    features : `~astro_scc.features.Features`

    Returns
    -------
    float
        In mas^2/yr.
    """
    d, walk, years = features.detections, 0.0, 0.0
    for track, motion in zip(features.tracks, features.motions, strict=True):
        time, place = d.time[track], d.place[track]
        n = len(time) - 1
        if n < LEAST_EPOCHS - 1:
            continue
        step = np.diff(place, axis=0) - np.diff(time)[:, None] * motion.velocity
        square = (step**2).sum() + 2 * (step[1:] * step[:-1]).sum()
        # The straight line takes up one of the steps.
        walk += square / 2 * n / (n - 1)
        years += time[-1] - time[0]
    return SLOPE * max(walk, 0.0) / years if years else 0.0
