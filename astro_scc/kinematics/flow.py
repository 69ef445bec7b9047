# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What apparent speeds say of flows, with their errors, and of two-sided jets."""

import astropy.units as u
import numpy as np
from astropy import constants

from astro_scc.kinematics.cosmology import (
    beta_intrinsic,
    doppler_factor,
    lorentz_factor,
    maximum_viewing_angle,
    minimum_lorentz_factor,
)

__all__ = ["intrinsic_table", "two_sided_jet", "two_sided_ratio"]


def intrinsic_table(
    beta_app, error, *, viewing_angle=None, angle_error=None, n_trials=20000, rng=None
):
    r"""
    Lorentz factors, angles and Doppler factors of apparent speeds, with errors.

    The values are those of the apparent speeds as they are; their limits are
    the central 68% of trials with speeds, and the angle, drawn from normal
    distributions (`astropy.uncertainty`).

    Parameters
    ----------
    beta_app, error : array_like, shape (n,)
        In units of c.
    viewing_angle, angle_error : `~astropy.units.Quantity`, optional
        Angle between flow and line of sight; without it what needs it is
        not in the table.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `~astropy.table.QTable`
        ``beta_app``, ``beta_app_err``; ``gamma_min`` and ``angle_max``; with an
        angle ``gamma``, ``doppler`` and ``possible``, the share of trials in
        which there is a flow below c.  Each with ``_low`` and ``_high``; an
        impossible Lorentz factor is infinite, and its Doppler factor 0.

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
    from astropy import uncertainty
    from astropy.table import QTable

    beta = np.atleast_1d(np.asarray(beta_app, dtype=float))
    s = np.broadcast_to(np.asarray(error, dtype=float), beta.shape)
    if not (np.all(np.isfinite(beta) & (beta >= 0)) and np.all(np.isfinite(s))):
        raise ValueError("apparent speeds and errors must be finite and not negative")
    if np.any(s < 0):
        raise ValueError("apparent speeds and errors must be finite and not negative")
    rng = np.random.default_rng(rng)
    drawn = np.abs(rng.normal(beta[:, None], s[:, None], (len(beta), n_trials)))
    trials = uncertainty.Distribution(drawn)
    table = QTable({"beta_app": beta * u.one, "beta_app_err": s * u.one})
    _add(table, "gamma_min", minimum_lorentz_factor(beta),
         minimum_lorentz_factor(trials.distribution))  # fmt: skip
    _add(table, "angle_max", maximum_viewing_angle(beta),
         maximum_viewing_angle(trials.distribution))  # fmt: skip
    if viewing_angle is None:
        return table
    angle = u.Quantity(viewing_angle).to(u.deg)
    angles = np.full(n_trials, angle.value)
    if angle_error is not None:
        angles = angles + rng.normal(
            0, u.Quantity(angle_error).to_value(u.deg), n_trials
        )
    gamma, doppler = _at_angle(beta, angle)
    many = _at_angle(trials.distribution, angles * u.deg)
    _add(table, "gamma", gamma * u.one, many[0] * u.one)
    _add(table, "doppler", doppler * u.one, many[1] * u.one)
    table["possible"] = np.isfinite(many[0]).mean(axis=1)
    table.meta.update({"viewing_angle": angle, "angle_error": angle_error})
    return table


def _at_angle(beta_app, angle):
    beta = beta_intrinsic(beta_app, angle)
    gamma = lorentz_factor(beta).value
    doppler = doppler_factor(beta, angle).value
    # What is too fast for the angle is faster than anything, and unseen.
    impossible = ~np.isfinite(gamma)
    return np.where(impossible, np.inf, gamma), np.where(impossible, 0.0, doppler)


def _add(table, name, value, trials):
    low, high = np.quantile(trials, [0.16, 0.84], axis=-1, method="nearest")
    table[name], table[f"{name}_low"], table[f"{name}_high"] = value, low, high


def two_sided_jet(approaching, receding, distance=None, *, errors=(0.0, 0.0),
                  n_trials=20000, rng=None):  # fmt: skip
    r"""
    Speed and angle of two jets that are alike and flow apart.

    .. math:: \beta \cos\theta = \frac{\mu_a - \mu_r}{\mu_a + \mu_r}, \qquad
              \tan\theta = \frac{2 D}{c}\,\frac{\mu_a \mu_r}{\mu_a - \mu_r}

    (Mirabel & Rodriguez 1994, Nature 371, 46).

    Parameters
    ----------
    approaching, receding : `~astropy.units.Quantity`
        Proper motions away from the core.
    distance : `~astropy.units.Quantity`, optional
        Length; without it there is ``beta_cos`` only.  For a redshift, the
        angular diameter distance times 1 + z.
    errors : (`~astropy.units.Quantity`, `~astropy.units.Quantity`), optional
        Of the two proper motions.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    dict
        ``beta_cos`` and, with a distance, ``angle`` and ``beta``; each a tuple
        of the value and its standard error.  ``beta_max_distance`` is the
        largest distance at which the flow is slower than light.

    Raises
    ------
    ValueError
        If the receding motion is not positive, or not the smaller one.

    Examples
    --------
    GRS 1915+105 as Mirabel & Rodriguez saw it:

    >>> import astropy.units as u
    >>> from astro_scc.kinematics import two_sided_jet
    >>> day = u.mas / u.day
    >>> found = two_sided_jet(17.6 * day, 9.0 * day, 12.5 * u.kpc)
    >>> round(found["beta"][0], 2), found["angle"][0].round(0)
    (0.92, <Quantity 69. deg>)
    """
    a, r = (u.Quantity(v).to_value(u.rad / u.s) for v in (approaching, receding))
    if not 0 < r <= a:
        raise ValueError(
            "the receding motion must be positive and not larger than the approaching "
            f"one, got {receding} and {approaching}"
        )
    rng = np.random.default_rng(rng)
    trials = []
    for value, error in zip((a, r), errors, strict=True):
        # No error is 0, whatever its unit.
        s = error.to_value(u.rad / u.s) if hasattr(error, "unit") else 0.0
        trials.append(np.abs(rng.normal(value, s, n_trials)))
    found = {"beta_cos": _with_error(_beta_cos(a, r), _beta_cos(*trials))}
    speed = constants.c.to_value(u.m / u.s)
    # beta = 1 there: (beta cos)^2 + (beta sin)^2 = 1.
    farthest = speed / np.sqrt(a * r) * u.m
    found["beta_max_distance"] = farthest.to(u.kpc)
    if distance is not None:
        d = u.Quantity(distance).to_value(u.m) / speed
        value = _angle_and_beta(a, r, d)
        many = _angle_and_beta(*trials, d)
        angle, error = _with_error(value[0], many[0])
        found["angle"] = angle * u.deg, error * u.deg
        found["beta"] = _with_error(value[1], many[1])
    return found


def _beta_cos(a, r):
    return (a - r) / (a + r)


def _angle_and_beta(a, r, d):
    cos = _beta_cos(a, r)
    sin = 2 * d * a * r / (a + r)
    return np.degrees(np.arctan2(sin, cos)), np.hypot(cos, sin)


def _with_error(value, trials):
    return float(value), float(np.std(trials))


def two_sided_ratio(beta, viewing_angle, *, spectral_index=-0.7, blobs=True):
    r"""
    Ratio of brightness of the approaching to the receding jet.

    .. math:: R = \left(\frac{1 + \beta\cos\theta}{1 -
              \beta\cos\theta}\right)^{p - \alpha},

    p = 3 for blobs, seen at the same distance from the core, and p = 2 for
    a steady jet (Scheuer & Readhead 1979, Nature 277, 182).

    Parameters
    ----------
    beta : float
        Speed of the flow in units of c.
    viewing_angle : `~astropy.units.Quantity`
    spectral_index : float, optional
        :math:`S \propto \nu^\alpha`.
    blobs : bool, optional

    Returns
    -------
    float

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.kinematics import two_sided_ratio
    >>> round(two_sided_ratio(0.92, 70 * u.deg, spectral_index=-0.8), 1)
    11.9
    """
    cos = float(beta) * float(np.cos(u.Quantity(viewing_angle).to_value(u.rad)))
    return float(((1 + cos) / (1 - cos)) ** ((3 if blobs else 2) - spectral_index))
