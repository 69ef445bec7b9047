# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The centre of a shell, and the rates of groups of patterns about it."""

from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np

from astro_scc.measurement.axes import alignment_errors
from astro_scc.shells.rates import refine_expansion
from astro_scc.stacking.expansion import Expansion, fit_expansion

__all__ = ["ShellFit", "fit_shell"]

#: Kinds of one scale, by signal-to-noise ratio, and sightings that each should have.
PARTS, ENOUGH = 4, 100
#: Sightings of a group that has a rate.
FEWEST = 10


@dataclass(frozen=True, eq=False)
class ShellFit:
    """
    Rates of expansion of groups of SSPs about one centre.

    Attributes
    ----------
    groups : tuple of str
    rate, rate_err : `~astropy.units.Quantity`, shape (n_groups,)
        In per cent a year.
    centre, centre_err : `~astropy.units.Quantity`, shape (2,)
        (east, north) from the reference pixel.
    radius : `~astropy.units.Quantity`
        Mean distance of the SSPs from the centre.
    fitted : `~astro_scc.stacking.expansion.Expansion`

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.shells import fit_shell
    >>> from astro_scc.simulation import simulate_shell
    >>> shell = simulate_shell(n_epochs=2, interval=10 * u.yr, n_clumps=0, n_knots=25,
    ...                        radius=50 * u.arcsec, size=160, rng=4)
    >>> scc = StackedCrossCorrelation(
    ...     scales=[1], max_speed=150 * u.mas / u.yr, kernel=0.1, detection=7,
    ...     segmentation=5)
    >>> matched = scc.match(shell.cube)
    >>> fit = fit_shell(scc, matched)
    >>> fit.groups, fit.rate.unit, fit.centre.unit
    (('all',), Unit("% / yr"), Unit("mas"))
    """

    groups: tuple
    rate: u.Quantity
    rate_err: u.Quantity
    centre: u.Quantity
    centre_err: u.Quantity
    radius: u.Quantity
    fitted: Expansion


def fit_shell(scc, matched, groups=None, *, centre=None):
    r"""
    Fit the centre of a shell and rates of expansion about it.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        The settings; its axes do not matter.
    matched : `~astro_scc.measurement.MatchedEpochs` or dict of it
        Of the same dates; of several, each is a group and its key the name.
    groups : dict of `~numpy.ndarray` of bool, shape (n_ssps,), optional
        Groups with a rate of their own, see
        `~astro_scc.stratification.scale_groups`; one of all by default.
    centre : `~astropy.units.Quantity`, shape (2,), optional
        (east, north) from the reference pixel, if it is known.

    Returns
    -------
    `ShellFit`

    Raises
    ------
    ValueError
        If a group has fewer than ten sightings, both several matches and
        groups are given, or their dates are not the same.

    Notes
    -----
    Many patterns are chance, so the fit is that of a mixture: a sighting
    moves as its group does, with a scatter that is fitted for each scale
    and quarter of the signal-to-noise ratios, or falls anywhere in what was
    searched.  It starts where a stack with the kernel of ``scc`` has its
    maximum.  Errors are those of a jackknife over 24 parts of the azimuth,
    each with all epochs of its features, and of the alignment of the epochs
    as `~astro_scc.measurement.axes.alignment_errors` knows it: epochs that drift
    by :math:`\delta` in the time T move the centre by
    :math:`\delta / (e\, T)`.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.shells import fit_shell
    >>> from astro_scc.simulation import simulate_shell
    >>> shell = simulate_shell(n_epochs=3, interval=10 * u.yr, n_knots=60, rng=1)
    >>> scc = StackedCrossCorrelation(scales=[1.5], max_speed=300 * u.mas / u.yr)
    >>> fit = fit_shell(scc, scc.match(shell.cube))
    >>> bool(abs(fit.rate[0] - 0.11 * u.percent / u.yr) < 0.02 * u.percent / u.yr)
    True
    """
    # East and north: a place has no other axes before its centre is known.
    sky = replace(scc, position_angle=None)
    names, parts = _parts(matched, groups)
    cube = parts[0].cube
    limit = scc.speed_limit(cube).to_value(u.mas / u.yr)
    seen = [_sightings(sky, part, limit) for part in parts]
    if not any(map(len, seen)):
        raise ValueError("no pattern has a match: there is nothing to fit a centre to")

    for name, own in zip(names, seen, strict=True):
        if len(own) < FEWEST:
            raise ValueError(
                f"an expansion needs ten sightings of each group or more, {name} has "
                f"{len(own)}"
            )

    def joined(of):
        return np.concatenate(
            [of(s, part) for s, part in zip(seen, parts, strict=True)]
        )

    x, v = joined(lambda s, _: s.middle), joined(lambda s, _: s.velocity)
    interval, sigma = (
        joined(lambda s, _: np.abs(s.interval)),
        joined(lambda s, _: s.sigma),
    )
    group = np.repeat(np.arange(len(seen)), list(map(len, seen)))
    distance = np.hypot(*(x - x.mean(axis=0)).T)
    given = None if centre is None else u.Quantity(centre).to_value(u.mas)
    start = fit_expansion(
        x, v, sigma / interval, joined(lambda s, _: s.weight), group,
        max_rate=limit / np.median(distance), centre=given,
    )  # fmt: skip
    kind = _kinds(
        group,
        joined(lambda s, part: part.ssps.scale[s.ssp]),
        joined(lambda s, part: part.ssps.snr[s.ssp]),
    )
    fitted, response, _, _ = refine_expansion(
        start, x, v, interval, sigma, group, kind,
        area=(2 * limit * interval) ** 2, fixed=given is not None,
    )  # fmt: skip
    errors = alignment_errors(cube, scc.alignment_error)
    if errors.any():
        years = cube.years.to_value(u.yr)
        first = joined(lambda s, _: np.minimum(s.reference, s.target))
        fitted = _with_alignment(fitted, response, first, interval, years, errors)
    away = np.hypot(*(x - fitted.centre).T)
    rate = u.percent / u.yr
    return ShellFit(
        groups=names,
        rate=100 * fitted.rate * rate,
        rate_err=100 * fitted.rate_err * rate,
        centre=fitted.centre * u.mas,
        centre_err=fitted.centre_err * u.mas,
        radius=float(np.mean(away)) * u.mas,
        fitted=fitted,
    )


def _parts(matched, groups):
    """Names of the groups, and what was matched of each."""
    if not hasattr(matched, "matches"):
        if groups is not None:
            raise ValueError("several matches are groups already: give no groups")
        parts = list(matched.values())
        dates = [part.cube.times.mjd for part in parts]
        if any(not np.array_equal(dates[0], other) for other in dates[1:]):
            raise ValueError("the matches of a shell must be of the same dates")
        return tuple(matched), parts
    if groups is None:
        return ("all",), [matched]
    return tuple(groups), [
        replace(matched, select=matched.select & chosen) for chosen in groups.values()
    ]


def _sightings(scc, part, limit):
    displacements, _ = scc.displacements(part)
    return displacements.within(scc.date_pairs(part.cube), (limit, limit))


def _kinds(group, scale, snr):
    """Numbers of what is alike: the scale, the signal-to-noise ratio."""
    kind = np.zeros(len(group), dtype=int)
    n = 0
    for g in np.unique(group):
        for j in np.unique(scale[group == g]):
            own = np.flatnonzero((group == g) & (scale == j))
            parts = min(PARTS, max(len(own) // ENOUGH, 1))
            limits = np.quantile(snr[own], np.arange(1, parts) / parts)
            kind[own] = n + np.searchsorted(limits, snr[own], side="right")
            n = kind.max() + 1
    return np.unique(kind, return_inverse=True)[1]


def _with_alignment(fitted, response, first, interval, years, errors):
    """With the covariance that shifts of whole epochs make."""
    second = np.abs(np.subtract.outer(years[first] + interval, years)).argmin(axis=1)
    covariance = np.array(fitted.covariance)
    for k in range(len(years)):
        moved = ((second == k) * 1.0 - (first == k)) / interval
        change = np.einsum("i,iaj->aj", moved, response) * errors[k][:, None]
        covariance += change.T @ change
    error = np.sqrt(np.diag(covariance))
    return replace(
        fitted,
        covariance=covariance,
        rate_err=error[:-2],
        centre_err=error[-2:],
    )
