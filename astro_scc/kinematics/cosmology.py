# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""From proper motions to apparent speeds, Lorentz factors and viewing angles."""

import astropy.units as u
import numpy as np
from astropy import constants

__all__ = [
    "apparent_speed",
    "beta_intrinsic",
    "doppler_factor",
    "lorentz_factor",
    "maximum_viewing_angle",
    "minimum_lorentz_factor",
    "paper_cosmology",
    "viewing_angle",
]


def paper_cosmology():
    """
    The cosmology of Mertens & Lobanov (2016).

    Returns
    -------
    `~astropy.cosmology.FlatLambdaCDM`
        H0 = 71 km/s/Mpc, Om0 = 0.27.

    Examples
    --------
    >>> from astro_scc.kinematics import paper_cosmology
    >>> paper_cosmology().H0
    <Quantity 71. km / (Mpc s)>
    """
    from astropy.cosmology import FlatLambdaCDM

    return FlatLambdaCDM(H0=71, Om0=0.27)


def apparent_speed(proper_motion, *, redshift=None, cosmology=None, distance=None):
    """
    Apparent speed of a proper motion, in units of c.

    ``beta_app = mu D_M / c = mu D_A (1 + z) / c``, with the transverse
    comoving distance ``D_M`` of the redshift (in a flat universe the
    comoving distance), or ``mu D / c`` with the distance of a nearby
    source.  The (1 + z) accounts for the stretched intervals of time.

    Parameters
    ----------
    proper_motion : `~astropy.units.Quantity`
        Angle per time, of any shape.
    redshift : float, optional
        Needs ``cosmology``.
    cosmology : `~astropy.cosmology.FLRW`, optional
        There is no default: the result depends on it by several per cent.
    distance : `~astropy.units.Quantity`, optional
        Length, instead of a redshift and a cosmology.

    Returns
    -------
    `~astropy.units.Quantity`
        Dimensionless, in the shape of ``proper_motion``.

    Raises
    ------
    ValueError
        If there is neither a redshift nor a distance, or both; a redshift
        without a cosmology; or either is not positive.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.kinematics import apparent_speed, paper_cosmology
    >>> apparent_speed(
    ...     1 * u.mas / u.yr, redshift=0.158, cosmology=paper_cosmology()
    ... ).round(2)
    <Quantity 10.2>
    >>> apparent_speed(1 * u.mas / u.yr, distance=16.7 * u.Mpc).round(3)
    <Quantity 0.264>
    """
    if (redshift is None) == (distance is None):
        raise ValueError(
            "an apparent speed needs either a redshift with a cosmology, or a distance"
        )
    if distance is None:
        if cosmology is None:
            raise ValueError(
                "a redshift needs a cosmology, such as FlatLambdaCDM(H0=71, Om0=0.27)"
            )
        if not (np.all(np.isfinite(redshift)) and np.all(np.asarray(redshift) > 0)):
            raise ValueError(
                f"the redshift must be positive, got {redshift}; give the distance of "
                "a nearby source"
            )
        distance = cosmology.comoving_transverse_distance(redshift)
    elif cosmology is not None:
        raise ValueError("a distance needs no cosmology; leave it out")
    distance = u.Quantity(distance).to(u.Mpc)
    if not np.all(distance > 0):
        raise ValueError(f"the distance must be positive, got {distance}")
    motion = u.Quantity(proper_motion).to_value(u.rad / u.yr) / u.yr
    return (motion * distance / constants.c).to(u.dimensionless_unscaled)


def beta_intrinsic(beta_app, viewing_angle):
    """
    Speed of a flow from its apparent speed, in units of c.

    ``beta = beta_app / (sin t + beta_app cos t)``, the inverse of
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
    beta_app = _dimensionless(beta_app)
    angle = u.Quantity(viewing_angle).to_value(u.rad)
    with np.errstate(divide="ignore", invalid="ignore"):
        beta = beta_app / (np.sin(angle) + beta_app * np.cos(angle))
    possible = (beta >= 0) & (beta < 1)
    return np.where(possible, beta, np.nan) * u.one


def lorentz_factor(beta):
    """
    Lorentz factor ``1 / sqrt(1 - beta^2)`` of a speed.

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
    beta = _dimensionless(beta)
    with np.errstate(divide="ignore", invalid="ignore"):
        gamma = 1 / np.sqrt(1 - beta**2)
    return np.where(np.abs(beta) < 1, gamma, np.nan) * u.one


def minimum_lorentz_factor(beta_app):
    """
    Smallest Lorentz factor that can show an apparent speed.

    ``Gamma_min = sqrt(1 + beta_app^2)``, at the viewing angle with
    ``cos t = beta``.

    Parameters
    ----------
    beta_app : array_like or `~astropy.units.Quantity`
        Apparent speeds in units of c.

    Returns
    -------
    `~astropy.units.Quantity`
        Dimensionless.

    Notes
    -----
    Read the other way, a Lorentz factor shows at most ``sqrt(Gamma^2 - 1)``:
    5.92 c for a Lorentz factor of 6.  Mertens & Lobanov (2016) let a jet
    with that Lorentz factor go from 4 c to 6 c by a change of viewing angle,
    which is not possible; 6 c needs 6.08 at least, and 7.48 at 15 degrees.

    Examples
    --------
    >>> from astro_scc.kinematics import minimum_lorentz_factor
    >>> minimum_lorentz_factor(6).round(2)
    <Quantity 6.08>
    """
    return np.sqrt(1 + _dimensionless(beta_app) ** 2) * u.one


def doppler_factor(beta, viewing_angle):
    """
    Doppler factor ``1 / (Gamma (1 - beta cos t))`` of a flow.

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
    beta = _dimensionless(beta)
    return 1 / (lorentz_factor(beta) * (1 - beta * np.cos(angle)))


def maximum_viewing_angle(beta_app):
    """
    Largest angle to the line of sight that allows an apparent speed.

    ``t_max = 2 atan(1 / beta_app)``, reached as the flow's speed
    approaches c.

    Parameters
    ----------
    beta_app : array_like or `~astropy.units.Quantity`
        Apparent speeds in units of c, not negative.

    Returns
    -------
    `~astropy.units.Quantity`
        Angles; 180 deg for no apparent speed.

    Examples
    --------
    >>> from astro_scc.kinematics import maximum_viewing_angle
    >>> maximum_viewing_angle(6).round(1)
    <Quantity 18.9 deg>
    """
    return np.degrees(2 * np.arctan2(1, _dimensionless(beta_app))) * u.deg


def viewing_angle(beta_app, doppler):
    """
    Angle to the line of sight from apparent speed and Doppler factor.

    ``tan t = 2 beta_app / (beta_app^2 + delta^2 - 1)``.

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
    beta_app, doppler = _dimensionless(beta_app), _dimensionless(doppler)
    angle = np.arctan2(2 * beta_app, beta_app**2 + doppler**2 - 1)
    return np.degrees(angle) * u.deg


def _dimensionless(value):
    return u.Quantity(value).to_value(u.one)
