# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Straight, broken and power-law profiles fitted to speeds at distances."""

from dataclasses import dataclass, field

import astropy.units as u
import numpy as np

__all__ = ["MODELS", "ProfileFit", "fit_profile"]

#: Parameters of each model; v0 is the speed at the mean distance.
MODELS = {
    "constant": ("v0",),
    "linear": ("v0", "gradient"),
    "power-law": ("v0", "index"),
    "broken": ("v0", "inner_gradient", "outer_gradient", "r_break"),
}
#: Breaks that are tried between the second and the last but one distance.
BREAKS = 200


@dataclass(frozen=True, eq=False)
class ProfileFit:
    """
    A model of speed against distance.

    Attributes
    ----------
    model : str
    r0 : `~astropy.units.Quantity`
        Distance that ``v0`` refers to; of a broken line the break.
    parameters : dict of `~astropy.units.Quantity`
    errors : dict of `~astropy.units.Quantity`
    chi2 : float
    n_free : int
        Degrees of freedom.
    aicc : float
        Akaike's criterion for small samples; the smallest is the best.
    p_constant : float
        Probability of as much improvement over a constant speed by chance,
        of the difference in chi-square; 1 for the constant itself.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.profiles import fit_profile
    >>> r = [1, 2, 4, 6] * u.mas
    >>> v = [1.0, 1.1, 1.3, 1.5] * u.mas / u.yr
    >>> fit = fit_profile(r, v, [0.05] * 4 * u.mas / u.yr)
    >>> fit.model, fit(3 * u.mas).round(2)
    ('linear', <Quantity 1.2 mas / yr>)
    """

    model: str
    r0: u.Quantity
    parameters: dict
    errors: dict
    chi2: float
    n_free: int
    aicc: float
    p_constant: float
    unit: u.UnitBase = field(repr=False)

    def __call__(self, distance):
        """
        The speed of the model.

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


def fit_profile(distance, speed, error, *, model="linear"):
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
        Those without a finite, positive error do not count.
    model : str, optional

    Returns
    -------
    `ProfileFit`

    Raises
    ------
    ValueError
        If the model is unknown, fewer speeds than parameters can be used, or
        a power law is fitted to distances or speeds that are not positive.

    Notes
    -----
    Errors follow from those of the speeds, as they are.  Speeds of bins that
    share features are not independent; `measure_acceleration
    <astro_scc.profiles.measure_acceleration>` needs no bins.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.profiles import fit_profile
    >>> fit = fit_profile([1, 2, 4, 8] * u.mas, [3.0, 3.2, 3.6, 4.4], [0.1] * 4)
    >>> fit.parameters["gradient"].round(3), fit.p_constant < 1e-6
    (<Quantity 0.2 1 / mas>, True)
    """
    if model not in MODELS:
        raise ValueError(f"unknown model {model!r}: use one of {', '.join(MODELS)}")
    r = np.atleast_1d(u.Quantity(distance))
    v = np.atleast_1d(u.Quantity(speed))
    e = np.atleast_1d(u.Quantity(error)).to(v.unit)
    good = np.isfinite(v) & np.isfinite(e) & (e > 0)
    x, y, s = r.value[good], v.value[good], e.value[good]
    names = MODELS[model]
    if len(np.unique(x)) < len(names):
        raise ValueError(
            f"a {model} profile needs speeds with errors at {len(names)} distances or "
            f"more, got {len(np.unique(x))}"
        )
    if model == "power-law" and not (np.all(x > 0) and np.all(y > 0)):
        raise ValueError("a power law needs distances and speeds above 0")
    x0 = float(np.average(x, weights=1 / s**2))
    if model == "power-law":
        x0 = float(np.exp(np.average(np.log(x), weights=(y / s) ** 2)))
    x0, values, covariance, chi2 = _solve(model, x, y, s, x0)
    flat = np.average(y, weights=1 / s**2)
    chi2_flat = float((((y - flat) / s) ** 2).sum())
    n, k = len(x), len(names)
    from scipy.stats import chi2 as distribution

    p = 1.0
    if k > 1:
        p = float(distribution.sf(max(chi2_flat - chi2, 0.0), k - 1))
    rate = v.unit / r.unit
    units = {"v0": v.unit, "index": u.one, "r_break": r.unit}
    units = [units.get(name, rate) for name in names]
    errors = np.sqrt(np.diag(covariance))
    return ProfileFit(
        model=model,
        r0=x0 * r.unit,
        parameters={m: a * b for m, a, b in zip(names, values, units, strict=True)},
        errors={m: a * b for m, a, b in zip(names, errors, units, strict=True)},
        chi2=chi2,
        n_free=n - k,
        aicc=chi2 + 2 * k + (2 * k * (k + 1) / (n - k - 1) if n > k + 1 else np.inf),
        p_constant=p,
        unit=v.unit,
    )


def _model(model, r, r0, values):
    r = np.asarray(r, dtype=float)
    if model == "constant":
        return np.full(r.shape, values[0])
    if model == "linear":
        return values[0] + values[1] * (r - r0)
    if model == "power-law":
        return values[0] * (r / r0) ** values[1]
    inner, outer = np.minimum(r - values[3], 0), np.maximum(r - values[3], 0)
    return values[0] + values[1] * inner + values[2] * outer


def _solve(model, x, y, s, x0):
    if model == "broken":
        return _solve_broken(x, y, s)
    if model == "power-law":
        return _solve_power_law(x, y, s, x0)
    columns = [np.ones_like(x), x - x0][: len(MODELS[model])]
    values, covariance, chi2 = _linear(np.stack(columns, axis=1), y, s)
    return x0, values, covariance, chi2


def _linear(design, y, s):
    weighted = design / s[:, None]
    covariance = np.linalg.pinv(weighted.T @ weighted)
    values = covariance @ weighted.T @ (y / s)
    return values, covariance, float((((y - design @ values) / s) ** 2).sum())


def _solve_power_law(x, y, s, x0):
    log = np.log(x / x0)
    start, _, _ = _linear(np.stack([np.ones_like(x), log], axis=1), np.log(y), s / y)
    values = np.array([np.exp(start[0]), start[1]])
    for _ in range(50):
        curve = values[0] * np.exp(values[1] * log)
        slope = np.stack([curve / values[0], curve * log], axis=1)
        step, covariance, _ = _linear(slope, y - curve, s)
        values = values + step
        if np.all(np.abs(step) < 1e-10 * np.abs(values) + 1e-14):
            break
    chi2 = float((((y - _model("power-law", x, x0, values)) / s) ** 2).sum())
    return x0, values, covariance, chi2


def _solve_broken(x, y, s):
    place = np.unique(x)
    best = None
    for at in np.linspace(place[1], place[-2], BREAKS):
        design = np.stack(
            [np.ones_like(x), np.minimum(x - at, 0), np.maximum(x - at, 0)], axis=1
        )
        values, _, chi2 = _linear(design, y, s)
        if best is None or chi2 < best[2]:
            best = at, values, chi2
    at, values, chi2 = best
    # The break as a fourth parameter, its slope that of the side it is seen from.
    turn = np.where(x < at, -values[1], -values[2])
    design = np.stack(
        [np.ones_like(x), np.minimum(x - at, 0), np.maximum(x - at, 0), turn], axis=1
    )
    _, covariance, _ = _linear(design, y, s)
    return at, np.array([*values, at]), covariance, chi2
