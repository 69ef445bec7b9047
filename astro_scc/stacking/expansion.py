# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Rates of expansion about a centre, and the centre."""

from dataclasses import dataclass

import numpy as np

from astro_scc.stacking.errors import jackknife_covariance

#: Width of the kernel in standard errors of a velocity sample, from wide to narrow.
WIDTHS = (4.0, 2.0, 1.0)
#: Rates that are tried first, on each side.
TRIED = 60
#: Steps of the fit, at most, for each width.
ITERATIONS = 40
#: Parts of the azimuth that are left out in turn for the errors.
BLOCKS = 24


@dataclass(frozen=True, eq=False)
class Expansion:
    """
    Rates of expansion of groups about one centre.

    Attributes
    ----------
    rate, rate_err : `~numpy.ndarray`, shape (n_groups,)
        Per year.
    centre, centre_err : `~numpy.ndarray`, shape (2,)
        In the unit of the positions.
    covariance : `~numpy.ndarray`, shape (n_groups + 2, n_groups + 2)
        Of the rates and the centre.
    n_used : `~numpy.ndarray` of int, shape (n_groups,)
        Velocity samples within two kernels of the model.
    """

    rate: np.ndarray
    rate_err: np.ndarray
    centre: np.ndarray
    centre_err: np.ndarray
    covariance: np.ndarray
    n_used: np.ndarray


def fit_expansion(
    position, velocity, error, weight, group, *, max_rate, centre=None, start=None
):
    r"""
    Fit rates of expansion of groups of velocity samples, and their centre.

    The maximum of

    .. math:: C(e, c) = \sum_i w_i \exp\left(-\frac{|v_i - e_{g(i)}\,
              (x_i - c)|^2}{2\,\sigma_i^2}\right)

    over the rates :math:`e_g` of all groups and the centre c: from the rates
    at which a wide kernel has its largest sum, uphill by weighted least
    squares.  Errors are those of a jackknife over 24 parts of the azimuth.

    Parameters
    ----------
    position, velocity : array_like, shape (n, 2)
        At the mean date of each velocity sample.
    error : array_like, shape (n,)
        Standard error of the velocity.
    weight : array_like, shape (n,)
    group : array_like of int, shape (n,)
        From 0.
    max_rate : float
        Largest rate on either side.
    centre : array_like, shape (2,), optional
        Fitted without it.
    start : array_like, shape (2,), optional
        Where the search for the centre starts; the mean position without it.

    Returns
    -------
    `Expansion`

    Raises
    ------
    ValueError
        If there are fewer velocity samples than ten in a group.
    """
    x, v = np.asarray(position, dtype=float), np.asarray(velocity, dtype=float)
    s, w = np.asarray(error, dtype=float), np.asarray(weight, dtype=float)
    group = np.asarray(group)
    n_groups = int(group.max(initial=-1)) + 1
    counts = np.bincount(group, minlength=max(n_groups, 1))
    if counts.min() < 10:
        raise ValueError(
            "an expansion needs ten velocity samples of each group or more, got "
            f"{counts.min()}"
        )
    given = centre is not None
    if given:
        start = centre
    start = np.average(x, axis=0, weights=w) if start is None else start
    start = np.asarray(start, dtype=float)
    rates = np.linspace(-max_rate, max_rate, 2 * TRIED + 1)
    first = []
    for g in range(n_groups):
        own = group == g
        away = x[own] - start
        sums = [
            w[own] @ np.exp(-0.5 * _square(v[own] - e * away, WIDTHS[0] * s[own]))
            for e in rates
        ]
        first.append(rates[int(np.argmax(sums))])
    place = np.array([*first, *start])
    data = x, v, s, w, group
    for width in WIDTHS:
        place = _climb(place, n_groups, *data, width=width, fixed=given)
    middle = place[-2:]
    azimuth = np.arctan2(*(x - middle).T)
    block = np.floor((azimuth + np.pi) / (2 * np.pi) * BLOCKS).astype(int) % BLOCKS
    others = []
    for k in np.unique(block):
        keep = block != k
        if np.all(np.bincount(group[keep], minlength=n_groups) > 3):
            part = tuple(column[keep] for column in data)
            others.append(_climb(place, n_groups, *part, width=WIDTHS[-1], fixed=given))
    covariance = (
        jackknife_covariance(others) if others else np.full((len(place),) * 2, np.inf)
    )
    errors = np.sqrt(np.diag(covariance))
    rest = _square(v - place[group][:, None] * (x - middle), WIDTHS[-1] * s)
    return Expansion(
        rate=place[:n_groups],
        rate_err=errors[:n_groups],
        centre=middle,
        centre_err=errors[-2:],
        covariance=covariance,
        n_used=np.bincount(group[rest < 4], minlength=n_groups),
    )


def _square(rest, s):
    return (rest**2).sum(axis=-1) / s**2


def _climb(place, n_groups, x, v, s, w, group, *, width, fixed):
    """Rates and centre of the maximum uphill of a place."""
    rows = np.arange(len(x))
    for _ in range(ITERATIONS):
        centre = place[-2:]
        away = x - centre
        rate = place[group]
        rest = v - rate[:, None] * away
        weight = w * np.exp(-0.5 * _square(rest, width * s)) / s**2
        design = np.zeros((len(x), 2, n_groups + 2))
        design[rows, :, group] = away
        if not fixed:
            design[:, 0, -2] = design[:, 1, -1] = -rate
        flat = design.reshape(-1, n_groups + 2)
        both = np.repeat(weight, 2)
        normal = flat.T @ (both[:, None] * flat)
        # Rates and lengths have units of their own.
        unit = 1 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
        unit[np.diag(normal) == 0] = 0.0
        solve = np.linalg.pinv(normal * np.outer(unit, unit), hermitian=True)
        step = unit * (solve @ (unit * (flat.T @ (both * rest.reshape(-1)))))
        place = place + step
        if np.all(np.abs(step) <= 1e-7 * np.abs(place) + 1e-12):
            break
    return place
