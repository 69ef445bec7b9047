# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Rates of expansion and a centre from patterns of which many are chance."""

from dataclasses import dataclass

import numpy as np

from astro_scc.stacking.expansion import Expansion

__all__ = ["refine_expansion"]

#: Steps at most, and the part of an error at which they end.
ITERATIONS, SMALL = 100, 0.02
#: Bounds of the scatter in standard errors of a sighting as they are given, and of the
#: share of those that expand.
SCATTER, SHARE = (0.02, 1.0), (0.02, 0.98)
#: Parts of the azimuth that are left out in turn for the errors.
BLOCKS = 24


@dataclass(frozen=True, eq=False)
class _Data:
    """Sightings as columns; ``kind`` numbers those of one scatter."""

    x: np.ndarray
    v: np.ndarray
    interval: np.ndarray
    area: np.ndarray
    group: np.ndarray
    kind: np.ndarray
    widest: np.ndarray

    def select(self, keep):
        columns = (c[keep] for c in (self.x, self.v, self.interval, self.area,
                                     self.group, self.kind))  # fmt: skip
        return _Data(*columns, self.widest)


def refine_expansion(
    start, position, velocity, interval, error, group, kind, *, area, fixed=False
):
    r"""
    Rates and centre of the most likely mixture of what expands and chance.

    A sighting i, displaced by :math:`d_i` over the interval :math:`t_i`,
    is one of what expands, or falls anywhere in the area :math:`A_i` that
    was searched:

    .. math:: p_i = \frac{f_k}{2\pi\sigma_k^2} \exp\left(-\frac{|d_i - e_g t_i\,
              (x_i - c)|^2}{2\,\sigma_k^2}\right) + \frac{1 - f_k}{A_i}

    The scatter :math:`\sigma_k` and the share :math:`f_k` of each kind of
    sightings are as unknown as the rates and the centre.  The likelihood is
    climbed by expectation and maximisation (Dempster, Laird & Rubin 1977,
    J. R. Stat. Soc. B 39, 1).

    Parameters
    ----------
    start : `~astro_scc.stacking.expansion.Expansion`
    position, velocity : `~numpy.ndarray`, shape (n, 2)
        At the mean date of each sighting.
    interval : `~numpy.ndarray`, shape (n,)
    error : `~numpy.ndarray`, shape (n,)
        Standard error of the displacement, that no scatter is above.
    group, kind : `~numpy.ndarray` of int, shape (n,)
        What has a rate, and what a scatter, of its own; from 0.
    area : `~numpy.ndarray`, shape (n,)
    fixed : bool, optional
        Leave the centre where it is.

    Returns
    -------
    expansion : `~astro_scc.stacking.expansion.Expansion`
        Errors are those of a jackknife over 24 parts of the azimuth, each
        with all epochs of its features.
    response : `~numpy.ndarray`, shape (n, 2, n_groups + 2)
        What the rates and the centre change by with each velocity.
    scatter, share : `~numpy.ndarray`, shape (n_kinds,)

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.shells.rates import refine_expansion
    >>> from astro_scc.stacking.expansion import fit_expansion
    >>> rng = np.random.default_rng(1)
    >>> x = rng.uniform(-100, 100, (900, 2))
    >>> v = 0.02 * x + rng.normal(0, 0.1, (900, 2))
    >>> v[300:] = rng.uniform(-5, 5, (600, 2))
    >>> one, same = np.ones(900), np.zeros(900, int)
    >>> start = fit_expansion(x, v, 0.4 * one, one, same, max_rate=0.1)
    >>> fit, *_, scatter, share = refine_expansion(
    ...     start, x, v, one, 0.4 * one, same, same, area=100 * one)
    >>> fit.rate.round(3), scatter.round(1), share.round(2)
    (array([0.02]), array([0.1]), array([0.34]))
    """
    n_groups = len(start.rate)
    n_kinds = int(kind.max()) + 1
    widest = np.array([np.median(error[kind == k]) for k in range(n_kinds)])
    data = _Data(position, velocity, interval, area, group, kind, widest)
    place = np.array([*start.rate, *start.centre])
    first = 0.5 * widest, np.full(n_kinds, 0.5)
    place, scatter, share, normal, p = _climb(data, place, *first, n_groups, fixed)
    centre = place[-2:]
    azimuth = np.arctan2(*(position - centre).T)
    block = np.floor((azimuth + np.pi) / (2 * np.pi) * BLOCKS).astype(int) % BLOCKS
    others = []
    for k in np.unique(block):
        keep = block != k
        if np.all(np.bincount(group[keep], minlength=n_groups) > 3):
            part = data.select(keep)
            others.append(_climb(part, place, scatter, share, n_groups, fixed)[0])
    covariance = np.full((len(place),) * 2, np.inf)
    n = len(others)
    if n >= 4:
        apart = np.array(others) - np.mean(others, axis=0)
        covariance = (n - 1) / n * apart.T @ apart
    errors = np.sqrt(np.diag(covariance))
    expansion = Expansion(
        rate=place[:n_groups],
        rate_err=errors[:n_groups],
        centre=centre,
        centre_err=errors[-2:],
        covariance=covariance,
        n_used=np.bincount(group[p > 0.5], minlength=n_groups),
    )
    response = _response(data, place, scatter, normal, p, fixed)
    return expansion, response, scatter, share


def _climb(data, place, scatter, share, n_groups, fixed):
    """The maximum uphill of a place, and what the last step was made of."""
    normal = errors = None
    for _ in range(ITERATIONS):
        rest = data.v - _model(data, place)
        square = (rest**2).sum(axis=1) * data.interval**2
        width = scatter[data.kind]
        f = share[data.kind]
        near = f * np.exp(-0.5 * square / width**2) / (2 * np.pi * width**2)
        p = near / (near + (1 - f) / data.area)
        scatter, share = _spread(data, p, square)
        weight = p * data.interval**2 / scatter[data.kind] ** 2
        normal, right = _equations(data, place, weight, rest, n_groups)
        if fixed:
            normal[-2:, :] = normal[:, -2:] = right[-2:] = 0
        step = _solve(normal, right)
        place = place + step
        errors = np.sqrt(np.abs(np.diag(_inverse(normal))))
        if np.all(np.abs(step) <= SMALL * errors):
            break
    return place, scatter, share, normal, p


def _model(data, place):
    return place[data.group][:, None] * (data.x - place[-2:])


def _spread(data, p, square):
    n = len(data.widest)
    total = np.bincount(data.kind, p, n)
    number = np.bincount(data.kind, minlength=n)
    mean = np.bincount(data.kind, p * square, n) / np.maximum(2 * total, 1e-12)
    scatter = np.clip(np.sqrt(mean), *np.multiply.outer(SCATTER, data.widest))
    return scatter, np.clip(total / np.maximum(number, 1), *SHARE)


def _equations(data, place, weight, rest, n_groups):
    """Normal equations of the rates and the centre."""
    away = data.x - place[-2:]
    rate = place[data.group]
    normal = np.zeros((n_groups + 2,) * 2)
    right = np.zeros(n_groups + 2)

    def sums(values):
        return np.bincount(data.group, weight * values, n_groups)

    for axis in (0, 1):
        own = slice(0, n_groups), n_groups + axis
        cross = -sums(rate * away[:, axis])
        normal[own] = normal[own[::-1]] = cross
        normal[own[1], own[1]] = (weight * rate**2).sum()
        right[own[1]] = -(weight * rate * rest[:, axis]).sum()
    normal[range(n_groups), range(n_groups)] = sums((away**2).sum(axis=1))
    right[:n_groups] = sums((away * rest).sum(axis=1))
    return normal, right


def _inverse(normal):
    # Rates and lengths have units of their own.
    unit = 1 / np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    unit[np.diag(normal) == 0] = 0.0
    outer = np.outer(unit, unit)
    return outer * np.linalg.pinv(normal * outer, hermitian=True)


def _solve(normal, right):
    return _inverse(normal) @ right


def _response(data, place, scatter, normal, p, fixed):
    """Derivatives of the rates and the centre by the velocities."""
    n_groups = len(place) - 2
    design = np.zeros((len(p), 2, len(place)))
    design[np.arange(len(p)), :, data.group] = data.x - place[-2:]
    if not fixed:
        design[:, 0, n_groups] = design[:, 1, n_groups + 1] = -place[data.group]
    weight = p * data.interval**2 / scatter[data.kind] ** 2
    return weight[:, None, None] * design @ _inverse(normal)
