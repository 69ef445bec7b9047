# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Relativistic flows: what speed, direction and Lorentz factor show a motion."""

from __future__ import annotations

import astropy.units as u
import numpy as np
from astropy import constants
from astropy.table import QTable
from numpy.typing import ArrayLike

from astro_scc.kinematics.cosmology import to_distance
from astro_scc.quantities import named, random_generator, to_quantity

#: Quantiles that bound the central 68%.
CENTRAL = [0.16, 0.84]


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


def intrinsic_table(
    beta_app: ArrayLike, error: ArrayLike, *, viewing_angle: u.Quantity | None = None,
    angle_error: u.Quantity | None = None, n_trials: int = 20000,
    rng: np.random.Generator | int | None = None,
) -> QTable:  # fmt: skip
    r"""
    Return Lorentz factors, angles and Doppler factors with errors.

    The values are for the given apparent speeds.  Their limits are the central
    68% of trials in which the speeds, and the angle, are drawn from normal
    distributions.

    Parameters
    ----------
    beta_app, error : array_like, shape (n,)
        Apparent speeds and their standard errors, in units of c.
    viewing_angle, angle_error : `~astropy.units.Quantity`, optional
        Angle between flow and line of sight, and its standard error.  Without
        the angle the table has no columns that need it.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `~astropy.table.QTable`
        ``beta_app``, ``beta_app_err``, ``gamma_min`` and ``angle_max``; with an
        angle also ``gamma``, ``doppler`` and ``possible``, the fraction of trials
        in which a flow below c exists.  ``gamma_min``, ``angle_max``, ``gamma``
        and ``doppler`` have limits ``_low`` and ``_high``.  If no such flow
        exists, the Lorentz factor is infinite and the Doppler factor 0.

    Raises
    ------
    ValueError
        If a speed or error is negative or not finite.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.kinematics import intrinsic_table
    >>> table = intrinsic_table([4.0, 6.0], [0.2, 0.4], viewing_angle=15 * u.deg, rng=1)
    >>> table["gamma"].round(2), table["gamma_high"].round(1)
    (<Quantity [4.13, 7.48]>, <Quantity [4.3, 8.9]>)
    >>> table["angle_max"].round(1)
    <Quantity [28.1, 18.9] deg>
    """
    beta = np.atleast_1d(in_units_of_c(beta_app))
    s = np.broadcast_to(in_units_of_c(error), beta.shape)
    if not np.all(np.isfinite(beta) & np.isfinite(s) & (beta >= 0) & (s >= 0)):
        raise ValueError("apparent speeds and errors must be finite and not negative")
    rng = random_generator(rng)
    trials = np.abs(rng.normal(beta[:, None], s[:, None], (len(beta), n_trials)))
    # The first of the trials is the value itself.
    trials = np.column_stack([beta, trials])
    columns = {
        "gamma_min": minimum_lorentz_factor(trials),
        "angle_max": maximum_viewing_angle(trials),
    }
    table = QTable({"beta_app": beta * u.one, "beta_app_err": s * u.one})
    if viewing_angle is not None:
        angle = u.Quantity(viewing_angle).to(u.deg)
        angles = np.full(1 + n_trials, angle.value)
        if angle_error is not None:
            spread = u.Quantity(angle_error).to_value(u.deg)
            angles[1:] += rng.normal(0, spread, n_trials)
        flow = beta_intrinsic(trials, angles * u.deg)
        gamma, doppler = lorentz_factor(flow), doppler_factor(flow, angles * u.deg)
        # Speeds that are impossible at this angle must not be missing from quantiles.
        impossible = ~np.isfinite(gamma)
        gamma[impossible], doppler[impossible] = np.inf, 0.0
        columns["gamma"], columns["doppler"] = gamma, doppler
        table.meta = {"viewing_angle": angle, "angle_error": angle_error}
    for name, values in columns.items():
        low, high = np.quantile(values[:, 1:], CENTRAL, axis=-1, method="nearest")
        table[name], table[f"{name}_low"] = values[:, 0], low
        table[f"{name}_high"] = high
    if viewing_angle is not None:
        table["possible"] = np.isfinite(columns["gamma"][:, 1:]).mean(axis=1)
    return table


def two_sided_jet(
    approaching: u.Quantity, receding: u.Quantity, distance: u.Quantity | None = None,
    *, errors: tuple[u.Quantity | float, u.Quantity | float] = (0.0, 0.0),
    n_trials: int = 20000, rng: np.random.Generator | int | None = None,
) -> dict:  # fmt: skip
    r"""
    Return the speed and angle of two equal jets in opposite directions.

    .. math:: \beta \cos\theta = \frac{\mu_a - \mu_r}{\mu_a + \mu_r}, \qquad
              \tan\theta = \frac{2 D}{c}\,\frac{\mu_a \mu_r}{\mu_a - \mu_r}

    (Mirabel & Rodriguez 1994, Nature 371, 46).

    Parameters
    ----------
    approaching, receding : `~astropy.units.Quantity`
        Proper motions away from the core.
    distance : `~astropy.units.Quantity`, optional
        Distance as a length; without it there is ``beta_cos`` only.  For a
        redshift, give the angular diameter distance times 1 + z.
    errors : (`~astropy.units.Quantity`, `~astropy.units.Quantity`), optional
        Standard errors of the two proper motions.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    dict
        ``beta_cos`` and, with a distance, ``angle`` and ``beta``, each as a
        tuple of the value and its standard error.  ``beta_max_distance`` is the
        distance up to which the flow is slower than light.

    Raises
    ------
    ValueError
        If the receding motion is not positive or larger than the approaching
        one, or the distance is not positive.
    `~astropy.units.UnitConversionError`
        If a motion, an error other than 0 or the distance has another unit.

    Examples
    --------
    GRS 1915+105 as observed by Mirabel & Rodriguez:

    >>> import astropy.units as u
    >>> from astro_scc.kinematics import two_sided_jet
    >>> day = u.mas / u.day
    >>> found = two_sided_jet(17.6 * day, 9.0 * day, 12.5 * u.kpc)
    >>> round(found["beta"][0], 2), found["angle"][0].round(0)
    (0.92, <Quantity 69. deg>)
    """
    a, r = _motion("approaching", approaching), _motion("receding", receding)
    if not 0 < r <= a:
        raise ValueError(
            "the receding motion must be positive and not larger than the approaching "
            f"one, got {receding} and {approaching}"
        )
    speed = constants.c.to_value(u.m / u.s)
    # At this distance beta = 1: (beta cos)^2 + (beta sin)^2 = 1.
    farthest = (speed / np.sqrt(a * r) * u.m).to(u.kpc)
    rng = random_generator(rng)
    trials = []
    for value, error in zip((a, r), errors, strict=True):
        # An error of 0 needs no unit.
        none = isinstance(error, int | float) and error == 0
        s = 0.0 if none else _motion("errors", error)
        # The first of the trials is the value itself.
        trials.append(np.append(value, np.abs(rng.normal(value, s, n_trials))))
    a, r = trials

    def with_error(values, unit=1):
        return float(values[0]) * unit, float(np.std(values[1:])) * unit

    beta_cos = (a - r) / (a + r)
    found = {"beta_cos": with_error(beta_cos), "beta_max_distance": farthest}
    if distance is not None:
        d = named("distance", to_distance, distance).to_value(u.m) / speed
        beta_sin = 2 * d * a * r / (a + r)
        found["angle"] = with_error(np.degrees(np.arctan2(beta_sin, beta_cos)), u.deg)
        found["beta"] = with_error(np.hypot(beta_cos, beta_sin))
    return found


def _motion(name, value):
    wanted = "must be an angle per time with a unit, such as '9 mas/d'"
    return named(name, to_quantity, value, "rad/s", wanted).to_value(u.rad / u.s)
