# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The centre of a shell, and the rates of groups of patterns about it."""

from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np

from astro_scc.stacking import Expansion, Sightings, fit_expansion

__all__ = ["ShellFit", "fit_shell"]


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
    fitted : `~astro_scc.stacking.Expansion`

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
    """
    Fit the centre of a shell and rates of expansion about it.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        The settings; its axes do not matter.
    matched : `~astro_scc.measurement.MatchedEpochs`
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
        If a group has fewer than ten sightings.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.shells import fit_shell
    >>> from astro_scc.simulation import simulate_shell
    >>> shell = simulate_shell(n_epochs=3, interval=10 * u.yr, n_knots=60, rng=1)
    >>> scc = StackedCrossCorrelation(scales=[1], max_speed=300 * u.mas / u.yr)
    >>> fit = fit_shell(scc, scc.match(shell.cube))
    >>> bool(abs(fit.rate[0] - 0.11 * u.percent / u.yr) < 0.02 * u.percent / u.yr)
    True
    """
    names = ("all",) if groups is None else tuple(groups)
    chosen = [matched.select] if groups is None else list(groups.values())
    select = matched.select & np.any(chosen, axis=0)
    # East and north: a place has no other axes before its centre is known.
    sky = replace(scc, position_angle=None)
    displacements, _ = sky.displacements(replace(matched, select=select))
    limit = scc.speed_limit(matched.cube).to_value(u.mas / u.yr)
    seen = Sightings.of(
        displacements,
        scc.date_pairs(matched.cube),
        matched.cube.years.to_value(u.yr),
        (limit, limit),
    )
    if len(seen) == 0:
        raise ValueError("no pattern has a match: there is nothing to fit a centre to")
    group = np.argmax(np.stack([c[seen.ssp] for c in chosen]), axis=0)
    error = seen.sigma / seen.interval
    distance = np.hypot(*(seen.middle - seen.middle.mean(axis=0)).T)
    fitted = fit_expansion(
        seen.middle,
        seen.velocity,
        error,
        seen.weight * seen.interval**2,
        group,
        max_rate=limit / np.median(distance),
        centre=None if centre is None else u.Quantity(centre).to_value(u.mas),
    )
    away = np.hypot(*(seen.middle - fitted.centre).T)
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
