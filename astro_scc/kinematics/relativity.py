# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Relativistic flows: what speed, direction and Lorentz factor show a motion."""

from __future__ import annotations

import astropy.units as u
import numpy as np
from numpy.typing import ArrayLike


def in_units_of_c(value):
    """Return speeds as plain numbers in units of c."""
    speed = u.Quantity(value, dtype=float)
    if not speed.unit.is_equivalent(u.one):
        raise u.UnitConversionError(
            f"speeds must be in units of c, got {speed.unit}: divide them by "
            "astropy.constants.c"
        )
    return speed.to_value(u.one)


def beta_intrinsic(beta_app: ArrayLike, viewing_angle: u.Quantity) -> u.Quantity:
    """
    Return the speed of a flow from its apparent speed, in units of c.

    It is ``beta = beta_app / (sin t + beta_app cos t)``, the inverse of
    ``beta_app = beta sin t / (1 - beta cos t)``.

    Parameters
    ----------
    beta_app : array_like or `~astropy.units.Quantity`
        Apparent speeds in units of c, not negative.
    viewing_angle : `~astropy.units.Quantity`
        Angle between the flow and the line of sight.

    Returns
    -------
    `~astropy.units.Quantity`
        Dimensionless; NaN where no speed below c gives ``beta_app``.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.kinematics import beta_intrinsic
    >>> beta_intrinsic([4, 10], 15 * u.deg).round(4)
    <Quantity [0.9703,    nan]>
    """
    beta_app = in_units_of_c(beta_app)
    angle = u.Quantity(viewing_angle).to_value(u.rad)
    with np.errstate(divide="ignore", invalid="ignore"):
        beta = beta_app / (np.sin(angle) + beta_app * np.cos(angle))
    possible = (beta >= 0) & (beta < 1)
    return np.where(possible, beta, np.nan) * u.one


def lorentz_factor(beta: ArrayLike) -> u.Quantity:
    """
    Return the Lorentz factor ``1 / sqrt(1 - beta^2)`` of a speed.

    Parameters
    ----------
    beta : array_like or `~astropy.units.Quantity`
        Speeds in units of c.

    Returns
    -------
    `~astropy.units.Quantity`
        Dimensionless; NaN where ``abs(beta) >= 1``.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.kinematics import beta_intrinsic, lorentz_factor
    >>> lorentz_factor(beta_intrinsic([4, 6], 15 * u.deg)).round(2)
    <Quantity [4.13, 7.48]>
    """
    beta = in_units_of_c(beta)
    with np.errstate(divide="ignore", invalid="ignore"):
        gamma = 1 / np.sqrt(1 - beta**2)
    return np.where(np.abs(beta) < 1, gamma, np.nan) * u.one


def minimum_lorentz_factor(beta_app: ArrayLike) -> u.Quantity:
    """
    Return the smallest Lorentz factor that can show an apparent speed.

    It is ``Gamma_min = sqrt(1 + beta_app^2)``, at the viewing angle with
    ``cos t = beta``.  Conversely, a Lorentz factor shows at most ``sqrt(Gamma^2 - 1)``,
    5.92 c for a Lorentz factor of 6.  Mertens & Lobanov (2016) explain a change from
    4 c to 6 c at that Lorentz factor by a change of viewing angle, which is not
    possible: 6 c needs at least 6.08, and 7.48 at 15 degrees.

    Parameters
    ----------
    beta_app : array_like or `~astropy.units.Quantity`
        Apparent speeds in units of c.

    Returns
    -------
    `~astropy.units.Quantity`
        Dimensionless.

    Examples
    --------
    >>> from astro_scc.kinematics import minimum_lorentz_factor
    >>> minimum_lorentz_factor(6).round(2)
    <Quantity 6.08>
    """
    return np.sqrt(1 + in_units_of_c(beta_app) ** 2) * u.one


def doppler_factor(beta: ArrayLike, viewing_angle: u.Quantity) -> u.Quantity:
    """
    Return the Doppler factor ``1 / (Gamma (1 - beta cos t))`` of a flow.

    Parameters
    ----------
    beta : array_like or `~astropy.units.Quantity`
        Speeds of the flow in units of c.
    viewing_angle : `~astropy.units.Quantity`
        Angle between the flow and the line of sight.

    Returns
    -------
    `~astropy.units.Quantity`
        Dimensionless; NaN where ``abs(beta) >= 1``.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.kinematics import doppler_factor
    >>> doppler_factor(0.9, 10 * u.deg).round(2)
    <Quantity 3.83>
    """
    angle = u.Quantity(viewing_angle).to_value(u.rad)
    beta = in_units_of_c(beta)
    return 1 / (lorentz_factor(beta) * (1 - beta * np.cos(angle)))


def maximum_viewing_angle(beta_app: ArrayLike) -> u.Quantity:
    """
    Return the largest angle to the line of sight that allows an apparent speed.

    It is ``t_max = 2 atan(1 / beta_app)``, which is approached as the flow's speed
    approaches c; 180 deg for no apparent speed.

    Parameters
    ----------
    beta_app : array_like or `~astropy.units.Quantity`
        Apparent speeds in units of c.

    Returns
    -------
    `~astropy.units.Quantity`

    Examples
    --------
    >>> from astro_scc.kinematics import maximum_viewing_angle
    >>> maximum_viewing_angle(6).round(2)
    <Quantity 18.92 deg>
    """
    return np.degrees(2 * np.arctan2(1, in_units_of_c(beta_app))) * u.deg


def viewing_angle(beta_app: ArrayLike, doppler: ArrayLike) -> u.Quantity:
    """
    Return the angle to the line of sight from apparent speed and Doppler factor.

    It follows from ``tan t = 2 beta_app / (beta_app^2 + delta^2 - 1)``.

    Parameters
    ----------
    beta_app : array_like or `~astropy.units.Quantity`
        Apparent speeds in units of c, not negative.
    doppler : array_like or `~astropy.units.Quantity`
        Doppler factors.

    Returns
    -------
    `~astropy.units.Quantity`
        Angles between 0 and 180 deg.

    Examples
    --------
    >>> from astro_scc.kinematics import viewing_angle
    >>> viewing_angle(5, 10).round(1)
    <Quantity 4.6 deg>
    """
    beta_app, doppler = in_units_of_c(beta_app), in_units_of_c(doppler)
    angle = np.arctan2(2 * beta_app, beta_app**2 + doppler**2 - 1)
    return np.degrees(angle) * u.deg
