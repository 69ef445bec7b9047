# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Models of speed against distance, and Lorentz factors from apparent speeds."""

from __future__ import annotations

from dataclasses import dataclass, field

import astropy.units as u
import numpy as np
from astropy.table import QTable
from numpy.typing import ArrayLike
from scipy.special import chdtrc

from astro_scc.kinematics import beta_intrinsic, lorentz_factor
from astro_scc.kinematics.relativistic import CENTRAL, in_units_of_c

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
    `ProfileFit`

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
    log = np.log(x / x0)
    start, _, _ = _linear([np.ones_like(x), log], np.log(y), s / y)
    values = np.array([np.exp(start[0]), start[1]])
    for _ in range(50):
        curve = values[0] * np.exp(values[1] * log)
        slopes = [curve / values[0], curve * log]
        step, covariance, _ = _linear(slopes, y - curve, s)
        values = values + step
        if np.all(np.abs(step) < 1e-10 * np.abs(values) + 1e-14):
            break
    return x0, values, covariance, _chi2(y - _model("power-law", x, x0, values), s)


@dataclass(frozen=True, eq=False)
class LorentzProfile:
    """Lorentz factors at distances, and a power law through them."""

    table: QTable
    a: float
    a_err: float
    k: float
    k_err: float
    possible: float


def lorentz_profile(
    distance: u.Quantity, beta_app: ArrayLike, error: ArrayLike,
    viewing_angle: u.Quantity, *, angle_error: u.Quantity | None = None,
    n_trials: int = 10000, rng: np.random.Generator | int | None = None,
) -> LorentzProfile:  # fmt: skip
    r"""
    Return Lorentz factors from apparent speeds at a viewing angle.

    At every distance, :math:`\beta = \beta_\mathrm{app} / (\sin\theta +
    \beta_\mathrm{app} \cos\theta)` and :math:`\Gamma = (1 - \beta^2)^{-1/2}`;
    :math:`\Gamma = a\, r^k` is fitted by least squares of the logarithms.
    Errors follow from trials with speeds and angle drawn from normal
    distributions.  The angle is the same for all distances of a trial.

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
    ``LorentzProfile``
        ``table`` with ``r``, ``gamma`` and the limits ``gamma_low`` and
        ``gamma_high`` of the central 68%, infinite where the apparent speed is
        not possible at the angle; ``a`` and ``k`` of ``Gamma = a (r / 1 mas)^k``
        with ``a_err`` and ``k_err``, half the central 68% of the trials; and
        ``possible``, the share of trials in which every speed was possible.

    Raises
    ------
    ValueError
        If there are fewer than two speeds, if a distance, speed or angle is
        not positive, or if no trial is possible because the angle is larger
        than ``angle_max`` of `~astro_scc.kinematics.intrinsic_table`.

    Examples
    --------
    The paper's speeds of 3C 120:

    >>> import astropy.units as u
    >>> from astro_scc.flow import lorentz_profile
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
    turn = rng.normal(angle.value, spread, (n_trials, 1)) if spread else angle.value
    trials = rng.normal(beta, s, (n_trials, len(beta)))
    gamma = lorentz_factor(beta_intrinsic(trials, turn * u.deg)).value
    whole = np.isfinite(gamma).all(axis=1)
    if not whole.any():
        raise ValueError(
            f"no flow shows {beta.max():.3g} c at {angle:.3g}: the angle is too large, "
            "see angle_max of intrinsic_table"
        )
    best = lorentz_factor(beta_intrinsic(beta, angle)).value
    log = np.log(gamma[whole])
    # Weights are inverse variances over the trials.
    variance = log.var(axis=0)
    weight = 1 / np.maximum(variance, 1e-6 * max(variance.max(), 1e-12))
    k, ln_a = _line(np.log(r), log, weight)
    k0, ln_a0 = np.median(k), np.median(ln_a)
    if np.isfinite(best).all():
        (k0,), (ln_a0,) = _line(np.log(r), np.log(best)[None], weight)
    # Speeds that are impossible at the angle have an infinite Lorentz factor.
    best, gamma = (np.where(np.isfinite(g), g, np.inf) for g in (best, gamma))
    low, high = np.quantile(gamma, CENTRAL, axis=0, method="nearest")
    table = QTable(
        [r * u.mas, best * u.one, low * u.one, high * u.one],
        names=["r", "gamma", "gamma_low", "gamma_high"],
        meta={"viewing_angle": angle, "angle_error": spread * u.deg},
    )
    return LorentzProfile(
        table=table,
        a=float(np.exp(ln_a0)),
        a_err=_half(np.exp(ln_a)),
        k=float(k0),
        k_err=_half(k),
        possible=float(whole.mean()),
    )


def _line(x, y, weight):
    """Return slopes and offsets of straight lines, one per row of y."""
    x0 = np.average(x, weights=weight)
    y0 = np.average(y, weights=weight, axis=1)
    slope = ((y - y0[:, None]) * (x - x0)) @ weight / ((x - x0) ** 2 @ weight)
    return slope, y0 - slope * x0


def _half(values):
    low, high = np.quantile(values, CENTRAL)
    return float(0.5 * (high - low))
