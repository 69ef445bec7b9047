# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Models of speed against distance, and their fits."""

from __future__ import annotations

from dataclasses import dataclass

import astropy.units as u
import numpy as np
import scipy
from numpy.typing import ArrayLike

from astro_scc.quantities import with_error
from astro_scc.units import unit_name


def _straight(r, r0, v0, gradient=0.0):
    return v0 + gradient * (r - r0)


def _power_law(r, r0, v0, index):
    return v0 * (r / r0) ** index


def _broken(r, _, v0, inner_gradient, outer_gradient, r_break):
    return v0 + np.where(r < r_break, inner_gradient, outer_gradient) * (r - r_break)


#: Speeds of each model at distances r, and its parameters; v0 is the speed at r0.
MODELS = {
    "constant": (_straight, ("v0",)),
    "linear": (_straight, ("v0", "gradient")),
    "power-law": (_power_law, ("v0", "index")),
    "broken": (_broken, ("v0", "inner_gradient", "outer_gradient", "r_break")),
}


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
        Probability that chance improves as much on a constant speed, by Fisher's
        distribution (of a straight line, Student's), as the speeds scatter about the
        model, but no less than their errors; 1 for the constant itself.

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

    def __str__(self):
        name = next((k for k in self.parameters if k != "v0"), "v0")
        value, error = self.parameters[name], self.errors[name]
        text = f"{with_error(value.value, error.value)} {unit_name(value.unit)}".strip()
        which = "" if name == "gradient" else f"{name.replace('_', ' ')} "
        return f"{self.model}: {which}{text}"

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
        function, _ = MODELS[self.model]
        values = [p.value for p in self.parameters.values()]
        r = u.Quantity(distance).to_value(self.r0.unit)
        return function(r, self.r0.value, *values) * self.parameters["v0"].unit


def fit_profile(
    distance: u.Quantity, speed: ArrayLike, error: ArrayLike, *, model: str = "linear",
    covariance: ArrayLike | None = None,
) -> ProfileFit:  # fmt: skip
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
    covariance : `~astropy.units.Quantity` or array_like, shape (n, n), optional
        Of the speeds, such as `Profile.covariance`, instead of their errors; speeds
        without a finite variance are not used.

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
    The errors follow from those of the speeds, which are not rescaled.  Bins share
    what moves from one to the next: without a covariance, they are too small.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.flow import fit_profile
    >>> fit = fit_profile([1, 2, 4, 8] * u.mas, [3.0, 3.2, 3.6, 4.4], [0.1] * 4)
    >>> fit.parameters["gradient"].round(3), fit.p_constant < 0.01
    (<Quantity 0.2 1 / mas>, True)
    """
    if model not in MODELS:
        raise ValueError(f"unknown model {model!r}: use one of {', '.join(MODELS)}")
    r, v, e = (np.atleast_1d(u.Quantity(q)) for q in (distance, speed, error))
    x, y, square = _known(r, v, e, covariance)
    function, names = MODELS[model]
    n, k = len(x), len(names)
    if (places := len(np.unique(x))) < k:
        raise ValueError(
            f"a {model} profile needs speeds with errors at {k} distances or more, "
            f"got {places}"
        )
    factor = np.linalg.cholesky(square)
    ones = np.linalg.solve(factor, np.ones(n))
    mean = ones @ np.linalg.solve(factor, y) / (ones @ ones)
    x0, starts, limits = _starts(model, x, y, np.sqrt(np.diag(square)), mean)
    options = {"sigma": square, "absolute_sigma": True, "bounds": limits}
    options |= {"method": "trf", "x_scale": "jac"}

    def curve(r, *values):
        return function(r, x0, *values)

    def chi2(speeds):
        return float((np.linalg.solve(factor, y - speeds) ** 2).sum())

    fits = (scipy.optimize.curve_fit(curve, x, y, start, **options) for start in starts)
    values, errors = min(fits, key=lambda fit: chi2(curve(x, *fit[0])))
    least = chi2(curve(x, *values))
    units = {"v0": v.unit, "index": u.one, "r_break": r.unit}
    units = [units.get(name, v.unit / r.unit) for name in names]
    parameters, errors = (
        dict(zip(names, map(u.Quantity, numbers, units), strict=True))
        for numbers in (values, np.sqrt(np.diag(errors)))
    )
    corrected = 2 * k * (k + 1) / (n - k - 1) if n > k + 1 else np.inf
    return ProfileFit(
        model=model, r0=parameters.get("r_break", x0 * r.unit), parameters=parameters,
        errors=errors, chi2=least, n_free=n - k, aicc=least + 2 * k + corrected,
        p_constant=_p_constant(k, n - k, chi2(mean), least),
    )  # fmt: skip


def _known(r, v, e, covariance):
    """Return distances, speeds that are known, and their covariance, as numbers."""
    if covariance is None:
        square = np.diag(e.to_value(v.unit) ** 2)
    else:
        square = u.Quantity(covariance).to_value(v.unit**2)
    variance = np.diag(square)
    good = np.isfinite(v.value) & np.isfinite(variance) & (variance > 0)
    return r.value[good], v.value[good], square[np.ix_(good, good)]


def _p_constant(k, n_free, constant, least):
    """Return the probability of as small a chi-square beside that of a constant."""
    if k == 1 or n_free == 0:
        return 1.0
    ratio = max(constant - least, 0.0) / (k - 1) / max(least / n_free, 1.0)
    return float(scipy.special.fdtrc(k - 1, n_free, ratio))


def _starts(model, x, y, s, mean):
    """Return the distance of v0, and parameters to start from with their limits."""
    _, names = MODELS[model]
    starts, limits = [[mean, *[0.0] * (len(names) - 1)]], (-np.inf, np.inf)
    x0 = np.average(x, weights=1 / s**2)
    if model == "power-law":
        if not (np.all(x > 0) and np.all(y > 0)):
            raise ValueError("a power law needs distances and speeds above 0")
        x0 = np.exp(np.average(np.log(x), weights=(y / s) ** 2))
    elif model == "broken":
        # The best break may be near any of the distances.
        place = np.unique(x)
        starts = [[mean, 0.0, 0.0, at] for at in place[1:-1]]
        limits = np.transpose([(-np.inf, np.inf)] * 3 + [place[[1, -2]]])
    return x0, starts, limits
