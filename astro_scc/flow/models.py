# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speed against distance: models and their fits, and the acceleration of a flow."""

from __future__ import annotations

from dataclasses import dataclass

import astropy.units as u
import numpy as np
import scipy
from numpy.typing import ArrayLike

from astro_scc.flow.speeds import place_of, speeds_in_parts
from astro_scc.kinematics import RadialFrame
from astro_scc.measurement import SCCResult
from astro_scc.quantities import with_error
from astro_scc.streams.decomposed import fit_part, weight_of
from astro_scc.units import PM_UNIT, offset_unit, unit_name


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


# -- acceleration ------------------------------------------------------------------

#: Distance from the core below which speeds are not used, and length of a part, in
#: beams.
CORE, LENGTH = 2.0, 2.0
#: Fewest and most parts.
FEWEST, MOST = 3, 10


@dataclass(frozen=True)
class FlowAcceleration:
    """
    Acceleration of a flow, from its speeds in parts along it.

    Attributes
    ----------
    speed : `~astropy.units.Quantity`
        Speed at the centre, in mas/yr.
    centre : `~astropy.units.Quantity`
        Mean distance of the parts along the flow, in mas.
    gradient, gradient_err : `~astropy.units.Quantity`
        Change of the speed with distance, in 1/yr.
    acceleration, acceleration_err : `~astropy.units.Quantity`
        Acceleration of the matter in a steady flow, the gradient times the speed, in
        mas/yr^2.
    p_value : float
        Probability of as large an acceleration of either sign if there is none, by
        Student's distribution, as the parts scatter about a line.
    n_parts : int
        Parts whose speed is known.  With fewer than three the other numbers are NaN,
        as they are where motion is significant in fewer than two bins of a profile.
    radial : bool
        Whether it flows to all sides of a point.  Then none of these is measured:
        matter of one explosion is faster farther out without an acceleration.
    """

    speed: u.Quantity
    centre: u.Quantity
    gradient: u.Quantity
    gradient_err: u.Quantity
    acceleration: u.Quantity
    acceleration_err: u.Quantity
    p_value: float
    n_parts: int
    radial: bool = False

    def __str__(self):
        if self.radial:
            return (
                "acceleration: not measured in a radial flow, whose speeds grow with "
                "distance without one if all started at one time (measure_expansion)"
            )
        if np.isnan(self.p_value):
            why = "motion is significant in fewer than two of the bins"
            if self.n_parts < FEWEST:
                why = (
                    "speeds are needed in three parts of the flow, of two beams each, "
                    f"and there are {self.n_parts}"
                )
            return f"acceleration: unknown, as {why}"
        length, time = self.speed.unit.bases
        both = self.acceleration, self.acceleration_err
        value = with_error(*(a.to_value(length / time**2) for a in both), "+-")
        far = offset_unit(self.centre.to_value(u.mas))
        return (
            f"acceleration: {value} {length}/{time}^2 at "
            f"{self.centre.to_value(far):.3g} {far}, p {self.p_value:.2g}, "
            f"{self.n_parts} parts of the flow"
        )

    @property
    def line(self) -> ProfileFit:
        """Its straight line; chi-square and AICc are NaN, as it is not their least."""
        length, _ = self.speed.unit.bases
        values = {"v0": self.speed, "gradient": self.gradient}
        errors = {"v0": np.nan * self.speed.unit, "gradient": self.gradient_err}
        return ProfileFit(
            "linear", self.centre.to(length), values, errors, chi2=np.nan,
            n_free=self.n_parts - 2, aicc=np.nan, p_constant=self.p_value,
        )  # fmt: skip


def acceleration_of(parts, flow, unit=PM_UNIT, *, moves=True):
    """
    Return the acceleration from speeds in parts of a flow.

    Parameters
    ----------
    parts : tuple of `~numpy.ndarray`
        See `speeds_in_parts`.
    flow : ``DecomposedFlow``
    unit : `~astropy.units.Unit`, optional
        Of speeds.
    moves : bool, optional
        Whether they are of motion.  If not, their slope is none.

    Returns
    -------
    `FlowAcceleration`
    """
    beam, radial = flow.beam, isinstance(flow.frame, RadialFrame)
    centre, speed, slope, error, number = slope_of(*parts)
    if radial or not moves:
        centre = speed = slope = error = np.nan
    length, time = unit.bases
    speed = (speed * beam * PM_UNIT).to(unit)
    gradients = [u.Quantity(x, 1 / u.yr).to(1 / time) for x in (slope, error)]
    return FlowAcceleration(
        speed, centre * beam * u.mas, *gradients,
        *((gradient * speed).to(length / time**2) for gradient in gradients),
        p_value=2 * float(scipy.special.stdtr(number - 2, -abs(slope / error))),
        n_parts=number, radial=radial,
    )  # fmt: skip


def measure_acceleration(result: SCCResult, row: int = 0) -> FlowAcceleration:
    """
    Measure the acceleration of a flow.

    The flow beyond two beams from the core is divided into three to ten parts with
    equal amounts of emission, of about two beams.  The speed of the stream is fitted in
    each, and a straight line to these speeds with their covariance, as neighbouring
    parts see the same patterns.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    row : int, optional
        Row in the table of streams.

    Returns
    -------
    ``FlowAcceleration``
        ``speed`` in the unit of proper motions at the mean distance ``centre``;
        ``gradient`` of the speed with distance in 1/yr and ``acceleration`` in
        mas/yr^2, each with ``_err``; ``p_value`` and ``n_parts``.  It prints
        as one line.

    Raises
    ------
    ValueError
        If there is no such row.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import measure_acceleration
    >>> from astro_scc.simulation import simulate_jet
    >>> jet = simulate_jet(n_epochs=30, n_features=10, acceleration=3.0,
    ...                    dispersion=0.05, rng=1)
    >>> scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    >>> found = measure_acceleration(scc(jet.cube, n_trials=199, rng=1))
    >>> bool(found.acceleration > 0 * u.mas / u.yr**2), found.p_value < 0.05
    (True, True)
    """
    n = len(result.search.streams)
    if not 0 <= row < n:
        raise ValueError(f"row must be from 0 to {n - 1}, got {row}")
    return accelerations(result, [row])[0]


def accelerations(result, rows):
    """Return the acceleration of each of some rows; the parts are fitted once."""
    search = result.search
    flow, fit, known = search.flow, search.fit, []
    # Features that are not tested have no speed of the spectrum.
    streams = [search.streams[row] for row in rows]
    moving = [np.isfinite(s.p_global) and s.kind != "not significant" for s in streams]
    if any(moving) and fit is not None:
        known = [flow.between(low, high) for low, high in parts_along(flow)]
    sign = 1 if fit is None else np.sign(fit.mean[0])
    fits = [fit_part(part, sign=sign, start=search.pair) for part in known]
    places = [place_of(part) for part in known]
    found = []
    for row, moves in zip(rows, moving, strict=True):
        of_row = slice(None if moves else 0)
        speeds = speeds_in_parts(fits[of_row], places[of_row], stream=row)
        found.append(acceleration_of(speeds, flow, result.cube.speed_unit))
    return found


def parts_along(flow):
    """Return limits of parts with equal amounts of emission, in mas, shape (n, 2)."""
    along = flow.grids[0].distance
    power = (flow.planes[0].values ** 2).sum(axis=(0, 1)) * weight_of(flow)
    power = power.sum(axis=1) * (along > (CORE if flow.outward else 0))
    order = np.argsort(along, kind="stable")
    total = np.cumsum(power[order])
    if not total[-1] > 0:
        return np.empty((0, 2))
    seen = along[order][power[order] > 0]
    length = np.ptp(seen)
    if length < FEWEST * LENGTH / 2:
        return np.empty((0, 2))
    n = int(np.clip(length / LENGTH, FEWEST, MOST))
    inner = np.interp(np.arange(1, n) / n * total[-1], total, along[order])
    edges = np.concatenate([[seen[0]], inner, [seen[-1] * (1 + 1e-9)]])
    return np.stack([edges[:-1], edges[1:]], axis=1) * flow.beam


def slope_of(place, speed, covariance):
    """
    Return the slope of speeds with distance by weighted least squares.

    Weights are the inverse variances; the error follows from the whole covariance,
    which is not inverted, as it has few clusters.  Speeds that scatter by more than
    their errors about the line, as where two streams are seen as one, enlarge it.

    Parameters
    ----------
    place, speed, covariance : `~numpy.ndarray`
        See `speeds_in_parts`.

    Returns
    -------
    centre, speed, slope, error : float
        Mean distance and the speed there; NaN with fewer than three speeds.
    number : int
        Speeds that are known.
    """
    use = np.isfinite(speed) & np.isfinite(np.diag(covariance))
    number = int(use.sum())
    if number < 3:
        return np.nan, np.nan, np.nan, np.nan, number
    square = covariance[np.ix_(use, use)]
    x, y, weight = place[use], speed[use], 1 / np.diag(square)
    centre = float(np.average(x, weights=weight))
    design = np.stack([np.ones(number), x - centre], axis=1)
    gain = np.linalg.solve(design.T @ (weight[:, None] * design), design.T * weight)
    speed, slope = gain @ y
    rest = np.eye(number) - design @ gain
    scatter = weight @ (rest @ y) ** 2 / (weight @ np.diag(rest @ square @ rest.T))
    error = np.sqrt(max(scatter, 1.0) * (gain @ square @ gain.T)[1, 1])
    return centre, float(speed), float(slope), float(error), number
