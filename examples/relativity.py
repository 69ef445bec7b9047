# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Errors of what relativistic flows are derived to be: functions to copy and to call.

    >>> import astropy.units as u
    >>> from relativity import intrinsic_table, two_sided_jet
    >>> table = intrinsic_table([4.0, 6.0], [0.2, 0.4], viewing_angle=15 * u.deg, rng=1)
    >>> table["gamma"].round(2), table["gamma_high"].round(1)
    (<Quantity [4.13, 7.48]>, <Quantity [4.3, 8.9]>)

GRS 1915+105 as observed by Mirabel & Rodriguez (1994, Nature 371, 46):

    >>> day = u.mas / u.day
    >>> found = two_sided_jet(17.6 * day, 9.0 * day, 12.5 * u.kpc)
    >>> round(found["beta"][0], 2), found["angle"][0].round(0)
    (0.92, <Quantity 69. deg>)
"""

import astropy.units as u
import numpy as np
from astropy import constants
from astropy.table import QTable

from astro_scc.kinematics import (
    beta_intrinsic,
    doppler_factor,
    lorentz_factor,
    maximum_viewing_angle,
    minimum_lorentz_factor,
)


def intrinsic_table(
    beta_app, error, *, viewing_angle=None, angle_error=0 * u.deg, n_trials=20000,
    rng=None,
):  # fmt: skip
    """
    Return Lorentz factors, angles and Doppler factors with errors.

    Parameters
    ----------
    beta_app, error : array_like, shape (n,)
        Apparent speeds and their standard errors, in units of c.
    viewing_angle, angle_error : `~astropy.units.Quantity`, optional
        Angle between flow and line of sight, and its standard error.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `~astropy.table.QTable`
        ``gamma_min`` and ``angle_max``; with an angle also ``gamma``, ``doppler`` and
        ``possible``, the fraction of trials in which a flow below c exists.  The limits
        ``_low`` and ``_high`` are the central 68% of trials with normal errors.  If no
        such flow exists, the Lorentz factor is infinite and the Doppler factor 0.
    """
    rng = np.random.default_rng(rng)
    beta, error = np.broadcast_arrays(np.atleast_1d(beta_app), error)
    if not (np.all(np.isfinite(beta) & (beta >= 0)) and np.all(error >= 0)):
        raise ValueError("apparent speeds and errors must be finite and not negative")
    trials = np.abs(rng.normal(beta[:, None], error[:, None], (len(beta), n_trials)))
    # The first of the trials is the value itself.
    trials = np.column_stack([beta, trials])
    columns = {
        "gamma_min": minimum_lorentz_factor(trials),
        "angle_max": maximum_viewing_angle(trials),
    }
    table = QTable({"beta_app": beta * u.one, "beta_app_err": error * u.one})
    if viewing_angle is not None:
        angles = viewing_angle + angle_error * np.append(0, rng.normal(size=n_trials))
        flow = beta_intrinsic(trials, angles)
        gamma, doppler = lorentz_factor(flow), doppler_factor(flow, angles)
        # Speeds that are impossible at this angle must not be missing from quantiles.
        impossible = ~np.isfinite(gamma)
        gamma[impossible], doppler[impossible] = np.inf, 0.0
        columns |= {"gamma": gamma, "doppler": doppler}
        table["possible"] = 1 - impossible[:, 1:].mean(axis=1)
    for name, values in columns.items():
        low, high = np.quantile(values[:, 1:], [0.16, 0.84], axis=-1, method="nearest")
        table[name], table[f"{name}_low"] = values[:, 0], low
        table[f"{name}_high"] = high
    return table


def two_sided_jet(
    approaching, receding, distance, *, errors=(0, 0) * u.mas / u.yr, n_trials=20000,
    rng=None,
):  # fmt: skip
    """
    Return the speed and angle of two equal jets in opposite directions.

    ``beta cos t = (a - r) / (a + r)`` and ``tan t = (2 D / c) a r / (a - r)``.

    Parameters
    ----------
    approaching, receding : `~astropy.units.Quantity`
        Proper motions away from the core.
    distance : `~astropy.units.Quantity`
        For a redshift, the angular diameter distance times 1 + z.
    errors : `~astropy.units.Quantity`, shape (2,), optional
        Standard errors of the two proper motions.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    dict
        ``beta_cos``, ``angle`` and ``beta``, each as a tuple of the value and its
        standard error, and ``beta_max_distance``, up to which ``beta`` is below 1.
    """
    if not 0 < receding <= approaching:
        raise ValueError(
            "the receding motion must be positive and not larger than the approaching "
            f"one, got {receding} and {approaching}"
        )
    rng = np.random.default_rng(rng)
    motions = u.Quantity([approaching, receding]).to_value(u.rad / u.s)
    sigma = errors.to_value(u.rad / u.s)
    # The first of the trials is the value itself.
    trials = np.abs(motions + sigma * rng.normal(size=(n_trials, 2)))
    a, r = np.vstack([motions, trials]).T
    light = (distance / constants.c).to_value(u.s)
    along, across = (a - r) / (a + r), 2 * light * a * r / (a + r)
    farthest = constants.c / np.sqrt(a[0] * r[0]) * u.s
    found = {"beta_max_distance": farthest.to(u.kpc)}
    for name, values, unit in (
        ("beta_cos", along, 1),
        ("angle", np.degrees(np.arctan2(across, along)), u.deg),
        ("beta", np.hypot(along, across), 1),
    ):
        found[name] = float(values[0]) * unit, float(np.std(values[1:])) * unit
    return found
