# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Models of speed against distance."""

from __future__ import annotations

from dataclasses import dataclass, field

import astropy.units as u
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import curve_fit
from scipy.special import chdtrc

#: Parameters of each model; v0 is the speed at the mean distance.
MODELS = {
    "constant": ("v0",),
    "linear": ("v0", "gradient"),
    "power-law": ("v0", "index"),
    "broken": ("v0", "inner_gradient", "outer_gradient", "r_break"),
}
#: Number of breaks tried between the second and the last but one distance.
BREAKS = 200


@dataclass(frozen=True, eq=False)
class ProfileFit:
    """
    A model of speed against distance.

    Attributes
    ----------
    model : str
    r0 : `~astropy.units.Quantity`
        Distance at which the speed is ``v0``; the break of a broken line.
    parameters : dict of `~astropy.units.Quantity`
    errors : dict of `~astropy.units.Quantity`
    chi2 : float
    n_free : int
        Degrees of freedom.
    aicc : float
        Akaike's criterion for small samples; the smallest is the best.
    p_constant : float
        Probability that chance improves as much on a constant speed, from the
        difference in chi-square; 1 for the constant itself.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.flow import fit_profile
    >>> r = [1, 2, 4, 6] * u.mas
    >>> v = [1.0, 1.1, 1.3, 1.5] * u.mas / u.yr
    >>> fit = fit_profile(r, v, [0.05] * 4 * u.mas / u.yr)
    >>> fit.model, fit(3 * u.mas).round(2)
    ('linear', <Quantity 1.2 mas / yr>)
    """

    model: str
    r0: u.Quantity
    parameters: dict[str, u.Quantity]
    errors: dict[str, u.Quantity]
    chi2: float
    n_free: int
    aicc: float
    p_constant: float
    unit: u.UnitBase = field(repr=False)

    def __call__(self, distance: u.Quantity) -> u.Quantity:
        """
        Return the speed of the model.

        Parameters
        ----------
        distance : `~astropy.units.Quantity`

        Returns
        -------
        `~astropy.units.Quantity`
        """
        values = [p.value for p in self.parameters.values()]
        r = u.Quantity(distance).to_value(self.r0.unit)
        return _model(self.model, r, self.r0.value, values) * self.unit


def fit_profile(
    distance: u.Quantity, speed: ArrayLike, error: ArrayLike, *, model: str = "linear"
) -> ProfileFit:
    r"""
    Fit a model to speeds at distances, weighted by their errors.

    ====================  =====================================================
    ``"constant"``        :math:`v_0`
    ``"linear"``          :math:`v_0 + g\,(r - r_0)`
    ``"power-law"``       :math:`v_0\,(r / r_0)^k`
    ``"broken"``          two straight lines that meet at ``r_break``
    ====================  =====================================================

    Parameters
    ----------
    distance : `~astropy.units.Quantity`, shape (n,)
    speed, error : `~astropy.units.Quantity` or array_like, shape (n,)
        Speeds without a finite, positive error are not used.
    model : str, optional

    Returns
    -------
    `~astro_scc.flow.ProfileFit`

    Raises
    ------
    ValueError
        If the model is unknown, if there are fewer distances with usable
        speeds than parameters, or if a power law is fitted to distances or
        speeds that are not positive.

    Notes
    -----
    The errors follow from those of the speeds, which are not rescaled.  Speeds
    in bins that share features are not independent; `measure_acceleration
    <astro_scc.flow.measure_acceleration>` needs no bins.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.flow import fit_profile
    >>> fit = fit_profile([1, 2, 4, 8] * u.mas, [3.0, 3.2, 3.6, 4.4], [0.1] * 4)
    >>> fit.parameters["gradient"].round(3), fit.p_constant < 1e-6
    (<Quantity 0.2 1 / mas>, True)
    """
    if model not in MODELS:
        raise ValueError(f"unknown model {model!r}: use one of {', '.join(MODELS)}")
    r, v, e = (np.atleast_1d(u.Quantity(q)) for q in (distance, speed, error))
    e = e.to(v.unit)
    good = np.isfinite(v) & np.isfinite(e) & (e > 0)
    x, y, s = r.value[good], v.value[good], e.value[good]
    names = MODELS[model]
    n, k = len(x), len(names)
    n_different = len(np.unique(x))
    if n_different < k:
        raise ValueError(
            f"a {model} profile needs speeds with errors at {k} distances or more, "
            f"got {n_different}"
        )
    if model == "power-law" and not (np.all(x > 0) and np.all(y > 0)):
        raise ValueError("a power law needs distances and speeds above 0")
    x0, values, covariance, chi2 = _solve(model, x, y, s)
    better = _chi2(y - np.average(y, weights=1 / s**2), s) - chi2
    p = float(chdtrc(k - 1, max(better, 0.0))) if k > 1 else 1.0
    units = {"v0": v.unit, "index": u.one, "r_break": r.unit}

    def named(values):
        rate = v.unit / r.unit
        return {m: a * units.get(m, rate) for m, a in zip(names, values, strict=True)}

    return ProfileFit(
        model=model,
        r0=x0 * r.unit,
        parameters=named(values),
        errors=named(np.sqrt(np.diag(covariance))),
        chi2=chi2,
        n_free=n - k,
        aicc=chi2 + 2 * k + (2 * k * (k + 1) / (n - k - 1) if n > k + 1 else np.inf),
        p_constant=p,
        unit=v.unit,
    )


def _model(model, r, r0, values):
    """Return the speeds of a model at distances."""
    if model == "power-law":
        return values[0] * (np.asarray(r, dtype=float) / r0) ** values[1]
    columns = _columns(model, r, r0)
    return sum(v * column for v, column in zip(values, columns, strict=False))


def _columns(model, r, r0):
    """Return the columns of the design matrix of straight lines."""
    away = np.asarray(r, dtype=float) - r0
    if model == "broken":
        return [np.ones_like(away), np.minimum(away, 0), np.maximum(away, 0)]
    return [np.ones_like(away), away][: len(MODELS[model])]


def _chi2(rest, s):
    return float(((rest / s) ** 2).sum())


def _solve(model, x, y, s):
    """Return the distance of v0, and the parameters, covariance and chi-square."""
    if model == "power-law":
        return _solve_power_law(x, y, s)
    if model != "broken":
        x0 = float(np.average(x, weights=1 / s**2))
        return x0, *_linear(_columns(model, x, x0), y, s)
    place = np.unique(x)
    tried = np.linspace(place[1], place[-2], BREAKS)
    fits = [_linear(_columns(model, x, at), y, s) for at in tried]
    best = int(np.argmin([chi2 for *_, chi2 in fits]))
    at, (values, _, chi2) = tried[best], fits[best]
    # The break is a fourth parameter; its derivative differs between the two sides.
    turn = np.where(x < at, -values[1], -values[2])
    _, covariance, _ = _linear([*_columns(model, x, at), turn], y, s)
    return at, np.array([*values, at]), covariance, chi2


def _linear(columns, y, s):
    """Return parameters, covariance and chi-square of weighted least squares."""
    design = np.stack(columns, axis=1)
    weighted = design / s[:, None]
    covariance = np.linalg.pinv(weighted.T @ weighted)
    values = covariance @ weighted.T @ (y / s)
    return values, covariance, _chi2(y - design @ values, s)


def _solve_power_law(x, y, s):
    x0 = float(np.exp(np.average(np.log(x), weights=(y / s) ** 2)))

    def curve(r, *values):
        return _model("power-law", r, x0, values)

    # A difference quotient is too coarse where the index is near 0.
    def slopes(r, v0, index):
        power = _model("power-law", r, x0, (1.0, index))
        return np.stack([power, v0 * power * np.log(r / x0)], axis=1)

    how = {"p0": (np.average(y), 0.0), "sigma": s, "absolute_sigma": True}
    values, covariance = curve_fit(curve, x, y, jac=slopes, **how)
    return x0, values, covariance, _chi2(y - curve(x, *values), s)
