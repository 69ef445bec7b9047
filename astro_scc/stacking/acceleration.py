# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stack on a grid of speed and acceleration."""

from dataclasses import dataclass, field

import numpy as np

__all__ = ["Acceleration", "fit_acceleration", "flow_blocks", "flow_speed"]

#: Spacing of speeds, and of distances, in standard errors of a sighting.
STEP = 0.25
#: Sightings further across the flow than this many standard errors do not count.
ACROSS = 5.0
#: Length of the flow that is left out at once, in standard errors of a
#: displacement: two beams, as features of one beam are one.
BLOCK = 10.0
#: Width of the kernel in standard errors; of narrower ones the local maxima of few
#: features make a lottery, as simulated flows show.
WIDTH = 4.0
#: Steps to the maximum, at most.
ITERATIONS = 60
#: Speeds below this part of that at the centre do not weigh more.
SLOWEST = 0.2
#: Fewest blocks that give an error.
FEWEST = 4


@dataclass(frozen=True, eq=False)
class Acceleration:
    """
    The maximum of a stack in speed and acceleration.

    Attributes
    ----------
    speed, acceleration : float
        At the distance ``centre``.
    covariance : `~numpy.ndarray`, shape (2, 2)
        Of the two, by the jackknife over blocks of the flow; infinite where
        there are too few, or the maximum is at the edge of the grid.
    p_value : float
        Of an acceleration as far from zero, two-sided, if there is none.
    n_blocks : int
    centre : float
        Distance that the speed refers to.
    coefficient : float
        Of the maximum, in units of the largest without acceleration.
    speeds, accelerations : `~numpy.ndarray`
        The grid.
    stack : `~numpy.ndarray`, shape (len(accelerations), len(speeds))

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Sightings, fit_acceleration, flow_speed
    >>> rng = np.random.default_rng(1)
    >>> n = 600
    >>> x, time = rng.uniform(2, 10, n), rng.uniform(0, 10, n)
    >>> v = flow_speed(x, 2.0, 0.2, 6.0) + rng.normal(0, 0.1, n)
    >>> one, zero = np.ones(n), np.zeros((n, 2))
    >>> seen = Sightings(v1=v, v2=0 * one, s1=0.2 * one, s2=0.2 * one, weight=one,
    ...                  time=time, interval=one, middle=zero, velocity=zero,
    ...                  sigma=0.2 * one, first=time.astype(int), ssp=np.arange(n),
    ...                  match=np.arange(n))
    >>> found = fit_acceleration(seen, x, 4.0, centre=6.0)
    >>> found.stack.shape == (len(found.accelerations), len(found.speeds))
    True
    """

    speed: float
    acceleration: float
    covariance: np.ndarray
    p_value: float
    n_blocks: int
    centre: float
    coefficient: float
    speeds: np.ndarray = field(repr=False)
    accelerations: np.ndarray = field(repr=False)
    stack: np.ndarray = field(repr=False)


def flow_speed(distance, speed, acceleration, centre):
    r"""
    Speed of a flow whose matter has one acceleration.

    .. math:: v(x)^2 = v_0^2 + 2 a\, (x - x_0).

    Parameters
    ----------
    distance, speed, acceleration, centre : array_like

    Returns
    -------
    `~numpy.ndarray`
        Zero where the matter would have turned back.

    Examples
    --------
    >>> from astro_scc.stacking import flow_speed
    >>> float(flow_speed(4.0, 3.0, 2.0, 0.0))
    5.0
    """
    return np.sqrt(
        np.maximum(
            np.square(speed) + 2 * np.multiply(acceleration, distance - centre), 0
        )
    )


def fit_acceleration(sightings, distance, v_max, *, a_max=None, centre=None):
    r"""
    Stack sightings on a grid of speed and acceleration.

    Each sighting, of a pair of dates of whatever interval, is a mean speed
    over its interval.  With one acceleration a of the matter this is the
    speed at the mean date, so

    .. math:: C(v_0, a) = \frac{\sum_i w_i \Delta t_i^2\,
              g\bigl(v_i - v(x_i; v_0, a),\ 4 \sigma_i\bigr)\, g(u_i, \sigma_i)}
              {\sum_i w_i \Delta t_i^2},

    with the distance :math:`x_i` at the mean date, :math:`v(x)` of
    `flow_speed`, the speed :math:`u_i` across the flow, and g a Gaussian of
    unit height, wider than that of the stack because one flow is sought.

    Parameters
    ----------
    sightings : `~astro_scc.stacking.Sightings`
    distance : array_like, shape (n,)
        Distance along the flow of each sighting at its mean date.
    v_max : float
        Largest speed.
    a_max : float, optional
        Largest acceleration on either side, by default the one that takes
        the flow from rest to 0.7 ``v_max`` between the centre and the end.
    centre : float, optional
        Distance that speeds refer to, the mean one by default; there speed
        and acceleration hang together least.

    Returns
    -------
    `Acceleration`

    Raises
    ------
    ValueError
        If there are fewer than ten sightings, or all at one distance.

    Notes
    -----
    Errors are those of a jackknife over blocks: sightings carried at the
    mean speed to one date are cut into lengths of two beams.  What was
    ejected together is left out together, however far it moves; so features
    that keep speeds of their own make no acceleration, but a larger error.
    The probability is that of Student's t with ``n_blocks - 2`` degrees of
    freedom.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Sightings, fit_acceleration, flow_speed
    >>> rng = np.random.default_rng(1)
    >>> n = 600
    >>> x, time = rng.uniform(2, 10, n), rng.uniform(0, 10, n)
    >>> v = flow_speed(x, 2.0, 0.2, 6.0) + rng.normal(0, 0.1, n)
    >>> one, zero = np.ones(n), np.zeros((n, 2))
    >>> seen = Sightings(v1=v, v2=0 * one, s1=0.2 * one, s2=0.2 * one, weight=one,
    ...                  time=time, interval=one, middle=zero, velocity=zero,
    ...                  sigma=0.2 * one, first=one, ssp=np.arange(n), match=one)
    >>> found = fit_acceleration(seen, x, 4.0, centre=6.0)
    >>> round(found.speed, 1), round(found.acceleration, 1), found.p_value < 0.01
    (2.0, 0.2, True)
    """
    x = np.asarray(distance, dtype=float)
    if len(x) < 10 or np.ptp(x) <= 0:
        raise ValueError(
            f"an acceleration needs ten sightings at different distances, got {len(x)}"
        )
    s = sightings
    weight = s.weight * s.interval**2
    centre = float(np.average(x, weights=weight) if centre is None else centre)
    error = float(np.median(s.s1))
    reach = np.abs(x - centre).max()
    if a_max is None:
        a_max = v_max**2 / (4 * reach)
    speeds = np.linspace(0, v_max, int(np.ceil(v_max / (STEP * error))) + 1)
    # At the far end a step is one of speed, at half the largest speed.
    steps = int(np.ceil(a_max * reach / (STEP * error * 0.5 * v_max)))
    accelerations = a_max * np.linspace(-1, 1, 2 * max(steps, 10) + 1)
    total_weight = weight.sum()
    weight = weight * np.exp(-0.5 * (s.v2 / s.s2) ** 2)
    use = np.abs(s.v2) <= ACROSS * s.s2
    grid = _Grid(x, centre, speeds, accelerations, STEP * error * np.median(s.interval))
    everything = grid.stack(s.v1, WIDTH * s.s1, weight, use)
    row, column = np.unravel_index(everything.argmax(), everything.shape)
    seen = [column[use] for column in (x - centre, s.v1, WIDTH * s.s1, weight)]
    start = np.array([speeds[column], accelerations[row]])
    found = _climb(start, *seen)
    block = flow_blocks(s, x, found[0])
    others = []
    for k in np.unique(block[use]):
        out = block == k
        # A block without sightings near the maximum tells nothing of it.
        if _near(found, *(c[out[use]] for c in seen)) == 0:
            continue
        # Without a block another maximum may be the highest.
        rest = everything - grid.stack(s.v1, WIDTH * s.s1, weight, use & out)
        i, j = np.unravel_index(rest.argmax(), rest.shape)
        start = np.array([speeds[j], accelerations[i]])
        others.append(_climb(start, *(c[~out[use]] for c in seen)))
    others = np.array(others).reshape(-1, 2)
    speed, acceleration = found
    at_edge = row in (0, len(accelerations) - 1)
    n = len(others)
    covariance = np.full((2, 2), np.inf)
    p_value = 1.0
    if n >= FEWEST and not at_edge:
        from scipy.stats import t

        apart = others - others.mean(axis=0)
        covariance = (n - 1) / n * apart.T @ apart
        sigma = np.sqrt(covariance[1, 1])
        p_value = float(2 * t.sf(abs(acceleration) / sigma, n - 2)) if sigma else 0.0
    still = everything[np.abs(accelerations).argmin()].max()
    return Acceleration(
        speed=float(speed),
        acceleration=float(acceleration),
        covariance=covariance,
        p_value=p_value,
        n_blocks=n,
        centre=centre,
        coefficient=float(everything.max() / still) if still > 0 else np.inf,
        speeds=speeds,
        accelerations=accelerations,
        stack=everything / total_weight,
    )


class _Grid:
    """Where each distance looks up its speed, for every point of the grid."""

    def __init__(self, x, centre, speeds, accelerations, step):
        n = int(np.clip(np.ceil(np.ptp(x) / step), 1, 400))
        edges = np.linspace(x.min(), x.max(), n + 1)
        self.bin = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, n - 1)
        middle = 0.5 * (edges[1:] + edges[:-1])
        self.shape = len(accelerations), len(speeds)
        self.speeds = np.concatenate(
            [speeds, speeds[-1] + speeds[1] * np.arange(1, 400)]
        )
        model = flow_speed(
            middle[:, None, None], speeds, accelerations[:, None], centre
        )
        self.column = np.clip(model / speeds[1], 0, len(self.speeds) - 1.001)
        self.n = n
        self.accelerations = accelerations
        self.reach = np.abs(middle - centre).max()

    def stack(self, v, s, weight, use):
        """The sum of the Gaussians of some sightings at every point."""
        profile = np.zeros((self.n, len(self.speeds)))
        for k in np.unique(self.bin[use]):
            i = use & (self.bin == k)
            z = (self.speeds - v[i, None]) / s[i, None]
            profile[k] = weight[i] @ np.exp(-0.5 * z**2)
        total = np.zeros(self.shape)
        whole = self.column.astype(int)
        part = self.column - whole
        for k in np.flatnonzero(profile.any(axis=1)):
            row = profile[k]
            total += (1 - part[k]) * row[whole[k]] + part[k] * row[whole[k] + 1]
        return total


def flow_blocks(sightings, x, speed):
    """
    The lengths of the flow that sightings belong to.

    Parameters
    ----------
    sightings : `~astro_scc.stacking.Sightings`
    x : `~numpy.ndarray`, shape (n,)
        Distance along the flow at the mean date.
    speed : float
        By which sightings are carried to one date.

    Returns
    -------
    `~numpy.ndarray` of int, shape (n,)

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import Sightings
    >>> from astro_scc.stacking import flow_blocks
    >>> rng = np.random.default_rng(1)
    >>> years, n, one = np.array([0.0, 1.0, 2.0]), 40, np.ones(40)
    >>> first = np.repeat([0, 1], 20)
    >>> d = Displacements(
    ...     d1=3 + rng.normal(0, 0.2, n), d2=rng.normal(0, 0.2, n), s1=0.3 * one,
    ...     s2=0.3 * one, weight=0.8 * one, reference=first, target=first + 1,
    ...     ssp=np.arange(n), target_ssp=np.full(n, -1), n_ssps=np.full(3, 20),
    ...     position=rng.uniform(0, 50, (n, 2)), motion=np.tile([3.0, 0.0], (n, 1)))
    >>> pairs = consecutive_pairs(years)
    >>> seen = Sightings.of(d, pairs, years, (9.0, 9.0))
    >>> blocks = flow_blocks(seen, seen.middle[:, 0], 3.0)
    >>> blocks.shape == seen.v1.shape
    True
    """
    length = BLOCK * np.median(sightings.sigma)
    start = x - speed * (sightings.time - sightings.time.mean())
    return np.floor((start - start.min()) / length).astype(int)


def _climb(place, x, v, s, weight):
    """
    The maximum of the stack that is uphill of a speed and an acceleration.

    Where the gradient of a sum of Gaussians vanishes, the model fits in the
    sense of least squares with the Gaussians as weights.
    """
    for _ in range(ITERATIONS):
        model = flow_speed(x, *place, 0.0)
        w = weight * np.exp(-0.5 * ((v - model) / s) ** 2) / s**2
        # Of v^2 = v0^2 + 2 a x; what stands still turns with neither.
        slow = np.maximum(model, SLOWEST * place[0])
        slope = np.stack([place[0] / slow, x / slow], axis=1) * (model > 0)[:, None]
        normal = slope.T @ (w[:, None] * slope)
        step = np.linalg.pinv(normal) @ (slope.T @ (w * (v - model)))
        place = np.array([max(place[0] + step[0], 0.1 * place[0]), place[1] + step[1]])
        if np.all(np.abs(step) <= 1e-6 * (np.abs(place) + 1e-9)):
            break
    return place


def _near(place, x, v, s, weight):
    """How many sightings are within two kernels of a model."""
    z = (v - flow_speed(x, *place, 0.0)) / s
    return np.count_nonzero((np.abs(z) < 2) & (weight > 0))
