# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Lorentz factors along a flow that is seen at one angle."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.kinematics import beta_intrinsic, lorentz_factor
from astro_scc.kinematics.flow import in_units_of_c

__all__ = ["LorentzProfile", "lorentz_profile"]


@dataclass(frozen=True, eq=False)
class LorentzProfile:
    """
    Lorentz factors at distances, and a power law through them.

    Attributes
    ----------
    table : `~astropy.table.QTable`
        ``r``, ``gamma`` and the limits ``gamma_low``, ``gamma_high`` of the
        central 68%; infinite where the apparent speed is not possible at
        the angle.
    a, k : float
        Of ``Gamma = a (r / 1 mas)^k``.
    a_err, k_err : float
        Half the central 68% of the trials.
    possible : float
        Share of the trials in which every speed was possible.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.profiles import lorentz_profile
    >>> found = lorentz_profile(
    ...     [1, 7] * u.mas, [4.0, 6.0], [0.2, 0.4], 15 * u.deg, rng=1)
    >>> found.table.colnames, round(found.k, 1)
    (['r', 'gamma', 'gamma_low', 'gamma_high'], 0.3)
    """

    table: QTable
    a: float
    a_err: float
    k: float
    k_err: float
    possible: float


def lorentz_profile(
    distance,
    beta_app,
    error,
    viewing_angle,
    *,
    angle_error=None,
    n_trials=10000,
    rng=None,
):
    r"""
    Lorentz factors from apparent speeds at a viewing angle.

    :math:`\beta = \beta_\mathrm{app} / (\sin\theta + \beta_\mathrm{app}
    \cos\theta)` and :math:`\Gamma = (1 - \beta^2)^{-1/2}` at every distance,
    and :math:`\Gamma = a\, r^k` by least squares of the logarithms, in
    trials with speeds and angle drawn from normal distributions.  The angle
    is the same for all distances of a trial.

    Parameters
    ----------
    distance : `~astropy.units.Quantity`, shape (n,)
        Projected distances; a constant angle changes a, not k.
    beta_app, error : array_like or `~astropy.units.Quantity`, shape (n,)
        In units of c.
    viewing_angle : `~astropy.units.Quantity`
    angle_error : `~astropy.units.Quantity`, optional
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `LorentzProfile`

    Raises
    ------
    ValueError
        If there are fewer than two speeds, a distance, speed or angle is not
        positive, or no trial is possible: a larger angle than
        `~astro_scc.kinematics.maximum_viewing_angle`.

    Examples
    --------
    The paper's speeds of 3C 120:

    >>> import astropy.units as u
    >>> from astro_scc.profiles import lorentz_profile
    >>> found = lorentz_profile(
    ...     [1, 7] * u.mas, [4.0, 6.0], [0.2, 0.4], 15 * u.deg, rng=1)
    >>> found.table["gamma"].round(2)
    <Quantity [4.13, 7.48]>
    >>> round(found.k, 2), round(found.k_err, 2)
    (0.3, 0.08)
    """
    r = np.atleast_1d(u.Quantity(distance)).to_value(u.mas)
    beta, s = (np.atleast_1d(in_units_of_c(v)) for v in (beta_app, error))
    angle = u.Quantity(viewing_angle).to(u.deg)
    if len(r) < 2:
        raise ValueError(f"a power law needs two speeds or more, got {len(r)}")
    if not (np.all(r > 0) and np.all(beta > 0) and 0 < angle.value < 180):
        raise ValueError("distances, speeds and the viewing angle must be above 0")
    if not np.all(np.isfinite(s) & (s >= 0)):
        raise ValueError("the errors of the speeds must be finite")
    rng = np.random.default_rng(rng)
    spread = 0.0 if angle_error is None else u.Quantity(angle_error).to_value(u.deg)
    angles = rng.normal(angle.value, spread, n_trials) if spread else angle.value
    angles = np.broadcast_to(angles, n_trials)[:, None] * u.deg
    trials = rng.normal(beta, s, (n_trials, len(beta)))
    gamma = lorentz_factor(beta_intrinsic(trials, angles)).value
    whole = np.isfinite(gamma).all(axis=1)
    if not whole.any():
        raise ValueError(
            f"no flow shows {beta.max():.3g} c at {angle:.3g}: the angle is too large, "
            "see maximum_viewing_angle"
        )
    best = lorentz_factor(beta_intrinsic(beta, angle)).value
    # What is too fast for the angle is faster than anything.
    filled = np.where(np.isfinite(gamma), gamma, np.inf)
    low, high = np.quantile(filled, [0.16, 0.84], axis=0, method="nearest")
    weight = _weight(gamma[whole])
    log = np.log(gamma[whole])
    k, ln_a = _line(np.log(r), log, weight)
    if np.isfinite(best).all():
        k0, ln_a0 = _line(np.log(r), np.log(best)[None], weight)
    else:
        k0, ln_a0 = np.median(k)[None], np.median(ln_a)[None]
    table = QTable(
        {
            "r": r * u.mas,
            "gamma": np.where(np.isfinite(best), best, np.inf) * u.one,
            "gamma_low": low * u.one,
            "gamma_high": high * u.one,
        },
        meta={"viewing_angle": angle, "angle_error": spread * u.deg},
    )
    return LorentzProfile(
        table=table,
        a=float(np.exp(ln_a0[0])),
        a_err=_half(np.exp(ln_a)),
        k=float(k0[0]),
        k_err=_half(k),
        possible=float(whole.mean()),
    )


def _weight(gamma):
    """Inverse variances of the logarithms over the trials."""
    variance = np.log(gamma).var(axis=0)
    return 1 / np.maximum(variance, 1e-6 * max(variance.max(), 1e-12))


def _line(x, y, weight):
    """Slopes and offsets of straight lines, one a row of y."""
    x0 = np.average(x, weights=weight)
    y0 = np.average(y, weights=weight, axis=1)
    slope = ((y - y0[:, None]) * (x - x0)) @ weight / ((x - x0) ** 2 @ weight)
    return slope, y0 - slope * x0


def _half(values):
    low, high = np.quantile(values, [0.16, 0.84])
    return float(0.5 * (high - low))
