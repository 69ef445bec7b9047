# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocity profile: streams in bins of core separation, their table and figures."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable
from numpy.typing import ArrayLike
from scipy.optimize import curve_fit
from scipy.special import chdtrc

from astro_scc.columns import describe
from astro_scc.epochs import EpochCube
from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import RidgeLine
from astro_scc.kinematics.cosmology import beta_per_pm
from astro_scc.matching import MatchedEpochs, select_ssps
from astro_scc.measurement import SCCResult, false_discovery_rate
from astro_scc.measurement.tables import Components, stack_tables, stream_table
from astro_scc.products.folder import write_files, write_tables
from astro_scc.quantities import random_generator
from astro_scc.scc import StackedCrossCorrelation, seeded
from astro_scc.settings import require
from astro_scc.stacking.stack import stack
from astro_scc.visualization import speeds, style


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
    function, names = MODELS[model]
    n, k, mean = len(x), len(names), np.average(y, weights=1 / s**2)
    place = np.unique(x)
    if len(place) < k:
        raise ValueError(
            f"a {model} profile needs speeds with errors at {k} distances or more, "
            f"got {len(place)}"
        )
    starts, limits = [[mean, *[0.0] * (k - 1)]], (-np.inf, np.inf)
    x0 = np.average(x, weights=1 / s**2)
    if model == "power-law":
        if not (np.all(x > 0) and np.all(y > 0)):
            raise ValueError("a power law needs distances and speeds above 0")
        x0 = np.exp(np.average(np.log(x), weights=(y / s) ** 2))
    elif model == "broken":
        # The best break may be near any of the distances.
        starts = [[mean, 0.0, 0.0, at] for at in place[1:-1]]
        limits = np.transpose([(-np.inf, np.inf)] * 3 + [place[[1, -2]]])

    def curve(r, *values):
        return function(r, x0, *values)

    def chi2(speeds):
        return float((((y - speeds) / s) ** 2).sum())

    how = {"sigma": s, "absolute_sigma": True, "bounds": limits, "method": "trf"}
    # Parameters in any units.
    how["x_scale"] = "jac"
    fits = [curve_fit(curve, x, y, start, **how) for start in starts]
    values, covariance = min(fits, key=lambda fit: chi2(curve(x, *fit[0])))
    least = chi2(curve(x, *values))
    units = {"v0": v.unit, "index": u.one, "r_break": r.unit}
    units = [units.get(name, v.unit / r.unit) for name in names]
    parameters, errors = (
        dict(zip(names, map(u.Quantity, of, units), strict=True))
        for of in (values, np.sqrt(np.diag(covariance)))
    )
    return ProfileFit(
        model=model,
        r0=parameters.get("r_break", x0 * r.unit),
        parameters=parameters,
        errors=errors,
        chi2=least,
        n_free=n - k,
        aicc=least + 2 * k + (2 * k * (k + 1) / (n - k - 1) if n > k + 1 else np.inf),
        p_constant=float(chdtrc(k - 1, max(chi2(mean) - least, 0.0))) if k > 1 else 1.0,
    )


def bins_of(edges, *, window=None):
    """
    Return the limits of bins of distance, shape (n, 2).

    Bins lie between increasing ``edges``.  With a ``window``, each edge is the middle
    of a bin of that width, and neighbours share features where they overlap.
    """
    edges = require("bins", edges).to(u.mas)
    if window is None:
        if len(edges) < 2:
            raise ValueError(f"bins need 2 distances or more, got {edges}")
        return np.stack([edges[:-1], edges[1:]], axis=1)
    window = require("window", window).to(u.mas)
    low = np.maximum(edges - window / 2, 0 * u.mas)
    return np.stack([low, edges + window / 2], axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class Profile(Components):
    """
    The measurement in each bin of distance.

    Attributes
    ----------
    bins : `~astropy.units.Quantity`, shape (n, 2)
        Limits of the bins.
    results : tuple of `~astro_scc.measurement.SCCResult` or None
        One per bin; None if the bin has no SSP.
    along : {"radius", "ridge"}
        Whether distances are measured from the core or along the ridge line.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import measure_profile
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> matched = scc.match(cube)
    >>> profile = measure_profile(
    ...     scc, matched, [2, 10, 18] * u.mas, n_trials=20, rng=1)
    >>> len(profile), profile.components.colnames[:3]
    (2, ['r_min', 'r_max', 'r_mid'])
    """

    bins: u.Quantity
    results: tuple[SCCResult | None, ...]
    along: str = "radius"

    def __len__(self) -> int:
        return len(self.bins)

    def __repr__(self):
        return (
            f"<Profile: {len(self)} bins from {self.bins.min():g} to "
            f"{self.bins.max():g}, {len(self.components)} streams>"
        )

    @cached_property
    def components(self) -> QTable:
        """
        The components of all bins, a `~astropy.table.QTable`.

        The columns are ``r_min``, ``r_max``, ``r_mid``, those of
        `SCCResult.components <astro_scc.measurement.SCCResult.components>`
        with ``p_fdr``, adjusted for all bins, and ``main``, which marks at most
        one component of each bin: of those whose speed exceeds its error, the
        moving one with the largest coefficient or, if none moves, the one with
        the largest coefficient that is not significant.
        """
        tables = [
            stream_table([]) if r is None else r.components for r in self.results
        ]
        adjusted = false_discovery_rate(tables)
        placed = list(map(_in_bin, adjusted, self.bins))
        meta = dict(next((table.meta for table in tables if table.meta), {}))
        if tested := adjusted[0].meta.get("false_discovery"):
            meta["false_discovery"] = tested
        bins = self.bins.to_value(u.mas).tolist()
        return stack_tables(placed, meta | {"bins": bins, "along": self.along})

    @property
    def main(self) -> QTable:
        """The rows of `components` that are ``main`` in their bin."""
        return self.components[self.components["main"]]


def _in_bin(table, limits):
    """Return a table of components with the limits of their bin in front."""
    low, high = limits.to_value(u.mas)
    values = {"r_min": low, "r_max": high, "r_mid": (low + high) / 2}
    columns = {name: np.full(len(table), r) * u.mas for name, r in values.items()}
    columns |= dict(table.items()) | {"main": _main(table)}
    return describe(QTable(columns, meta=table.meta), "profile")


def _main(table):
    """Return which row, if any, represents the bin."""
    chosen = np.zeros(len(table), dtype=bool)
    for wanted in ("moving", "not confirmed", "not significant"):
        moves = (table["kind"] == wanted) & (table["pm"] > table["pm_err"])
        if moves.any():
            chosen[np.where(moves, table["coefficient"], -np.inf).argmax()] = True
            break
    return chosen


def measure_profile(
    scc: StackedCrossCorrelation, matched: MatchedEpochs | EpochCube,
    edges: u.Quantity | str, *, window: u.Quantity | str | None = None,
    ridge: RidgeLine | None = None, n_trials: int = 1000,
    rng: np.random.Generator | int | None = None, progress_bar: bool = False,
) -> Profile:  # fmt: skip
    """
    Measure the velocity components in bins of distance.

    All epochs are matched once; for each bin, the matches of its SSPs are
    stacked.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        The settings.
    matched : `~astro_scc.matching.MatchedEpochs` or cube
        The result of ``scc.match(cube)``, or a cube, which is matched first.
    edges : `~astropy.units.Quantity` or str, shape (n + 1,)
        Limits of the bins: increasing angles, none negative.
    window : `~astropy.units.Quantity` or str, optional
        Width of windows that replace the bins between edges: each edge is the
        middle of a window, and neighbours share features where they overlap.
    ridge : `~astro_scc.kinematics.RidgeLine`, optional
        Measure distances along this line instead of from the reference pixel.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional
        The trials of each bin are independent.
    progress_bar : bool, optional

    Returns
    -------
    `Profile`

    Raises
    ------
    ValueError
        If the bins are invalid, or none of them has an SSP.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import measure_profile
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> scc = StackedCrossCorrelation(scales=[1, 2], max_speed=36 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> profile = measure_profile(scc, cube, [0, 10, 20] * u.mas, n_trials=50, rng=1)
    >>> profile.components.colnames[:4]
    ['r_min', 'r_max', 'r_mid', 'component']
    """
    bins = bins_of(edges, window=window)
    if not hasattr(matched, "matches"):
        matched = scc.match(matched, progress_bar=progress_bar)
    rng, seed = seeded(rng)
    results = [None] * len(bins)
    for k, own in enumerate(random_generator(rng).spawn(len(bins))):
        r_min, r_max = bins[k]
        part = select_ssps(matched, r_min=r_min, r_max=r_max, ridge=ridge)
        if part.select.any():
            how = {"n_trials": n_trials, "rng": own, "progress_bar": progress_bar}
            results[k] = scc.stack(part, **how)
            results[k].meta["seed"] = seed
    if not any(results):
        raise ValueError(
            f"no SSP lies in the bins, {bins.min():g} to {bins.max():g} from the core: "
            "choose others, or fainter thresholds"
        )
    return Profile(bins, tuple(results), "radius" if ridge is None else "ridge")


def write_profile(profile, components, directory, **settings):
    """
    Write the table and the figures of a profile into a folder that exists.

    ``components`` are `Profile.components`, or those in units of c; ``settings`` are
    passed to ``write_tables``.  Returns the paths.

    Examples
    --------
    >>> from pathlib import Path
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import measure_profile
    >>> from astro_scc.flow.profile import write_profile
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> profile = measure_profile(scc, cube, [2, 10, 18] * u.mas, n_trials=20, rng=1)
    >>> Path("out").mkdir()
    >>> [path.name for path in write_profile(profile, profile.components, "out")]
    ['profile.ecsv', 'profile.png', 'velocity_maps.png', 'position_angles.png']
    """
    of = {"profile": components}, directory, components.meta
    _, paths = write_tables(*of, **settings)
    files = style.figure_files(_figures(profile, components))
    write_files(files, Path(directory))
    return paths + [Path(directory, name) for name in files]


def _figures(profile, components):
    """Return functions that draw the figures of a profile by their names."""
    results = [result for result in profile.results if result is not None]
    first, (maps, angles, grid) = results[0], _of_scales(results)
    shown = {"line": _line_of(first, profile.bins.max()), "fits": _fits(profile.main)}
    shown |= {"cube": first.cube, "beta_per_pm": beta_per_pm(components)}
    axes = {"axis_names": tuple(first.frame.axis_names), "unit": first.cube.speed_unit}
    return {
        "profile": partial(speeds.plot_profile, components, **shown),
        "velocity_maps": partial(speeds.plot_scale_maps, maps, grid, **axes),
        "position_angles": partial(speeds.plot_position_angles, angles),
    }


def _of_scales(results):
    """Return stacks and position angles by the name of a scale, and their grid."""
    grid = max((r.grid for r in results), key=lambda g: g.shape[0] * g.shape[1])
    matched = results[0].matched
    select = np.any([r.matched.select for r in results], axis=0)
    angle = ssp_angles(matched, results[0].position_angle)
    maps, angles = {}, {}
    for scale in np.unique(matched.ssps.scale):
        own = matched.ssps.scale == scale
        stacks = (
            stack(d.select(own[d.ssp]), r.pairs, grid)
            for d, r in ((r.displacements, r) for r in results)
        )
        maps[f"scale {scale:g}"] = sum(stacks) / len(results)
        angles[f"scale {scale:g}"] = angle[select & own]
    return maps, angles, grid


def ssp_angles(matched, jet):
    """
    Return the position angles of the centroids of SSPs from the reference pixel.

    Parameters
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
    jet : `~astropy.units.Quantity`
        Direction of the jet.

    Returns
    -------
    `~astropy.units.Quantity`, shape (n_ssps,)
        Within half a turn of the jet's.
    """
    east, north = ssp_offsets(matched.ssps, matched.cube, centroid=True)
    angle, jet = np.degrees(np.arctan2(east, north)), jet.to_value(u.deg)
    return (jet + (angle - jet + 180) % 360 - 180) * u.deg


def _line_of(result, length):
    """Return the line along which the jet is drawn."""
    if isinstance(result.frame, RidgeLine):
        return result.frame
    angle, s = result.position_angle, u.Quantity([0 * u.mas, length])
    return RidgeLine(s * np.sin(angle), s * np.cos(angle))


def _fits(main):
    """Return a straight line and a power law, if there are enough speeds."""
    speeds = main["r_mid"], main["pm_parallel"], main["pm_parallel_err"]
    fits = []
    for model in ("linear", "power-law"):
        with suppress(ValueError):
            fits.append(fit_profile(*speeds, model=model))
    return tuple(fits)
