# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speeds of features: gradient and bins of distance, and groups of scales."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass
from itertools import combinations

import astropy.units as u
import numpy as np
from astropy.table import QTable
from numpy.typing import ArrayLike
from scipy.special import stdtr

from astro_scc.kinematics import SkyFrame
from astro_scc.matching import MatchedEpochs, select_ssps
from astro_scc.measurement import SCCResult
from astro_scc.measurement.axes import projection_of
from astro_scc.quantities import with_error
from astro_scc.units import PM_UNIT, offset_unit

#: Distance in beams below which the core shifts features.
CORE = 2.0
#: Relative gradient of the speed, per beam, that blends may cause.  Its mean is below
#: 0.001 in jets without acceleration (``benchmarks/calibration/results/steady.csv``).
BLENDS = 0.009
#: Fewest features for a gradient of speeds, and for a mean of accelerations.
FEWEST_SPEEDS, FEWEST_BENDS = 4, 2
#: Features of a bin: with fewer a dispersion has an error of half its size.
LEAST = 5
#: Most bins.
MOST_BINS = 8
#: Columns of the bins: numbers, distances and speeds.
BINS = ("component", "n_features", "r_min", "r_max", "r_mid", "pm_parallel",
        "pm_parallel_err", "dispersion", "dispersion_err")  # fmt: skip
#: Fewest features of a group that are divided from others by their brightness.
FEWEST = 2
#: Logarithms of shares that differ by more from the median do not divide better.
CLEAR = 0.5
#: Columns of a comparison of speeds.
COMPARED = ("first", "first_n_ssp", "first_n_features", "first_speed",
            "first_speed_err", "second", "second_n_ssp", "second_n_features",
            "second_speed", "second_speed_err", "difference", "difference_err",
            "p_value")  # fmt: skip


@dataclass(frozen=True)
class FlowAcceleration:
    """
    Acceleration of a flow, from the speeds and the accelerations of its features.

    Attributes
    ----------
    speed : `~astropy.units.Quantity`
        Mean speed of the features, in mas/yr.
    centre : `~astropy.units.Quantity`
        Mean distance of the features along the flow, in mas.
    gradient, gradient_err : `~astropy.units.Quantity`
        Change of the speed with distance, in 1/yr.
    acceleration, acceleration_err : `~astropy.units.Quantity`
        Acceleration of the matter, the gradient times the speed, in mas/yr^2.
    p_value : float
        Probability of as large an acceleration of either sign if there is none.
    n_features : int
        Number of features beyond two beams from the origin.  If there are
        fewer than two, or fewer than four and these have only speeds, the
        other numbers are NaN.
    """

    speed: u.Quantity
    centre: u.Quantity
    gradient: u.Quantity
    gradient_err: u.Quantity
    acceleration: u.Quantity
    acceleration_err: u.Quantity
    p_value: float
    n_features: int

    def __str__(self):
        if np.isnan(self.p_value):
            return (
                "acceleration: unknown, as four features are needed beyond two beams, "
                f"or two over five epochs, and only {self.n_features} can be used"
            )
        length, time = self.speed.unit.bases
        both = self.acceleration, self.acceleration_err
        value = with_error(*(a.to_value(length / time**2) for a in both), "+-")
        far = offset_unit(self.centre.to_value(u.mas))
        return (
            f"acceleration: {value} {length}/{time}^2 at "
            f"{self.centre.to_value(far):.3g} {far}, p {self.p_value:.2g}, "
            f"{self.n_features} features"
        )


def measure_acceleration(result: SCCResult, row: int = 0) -> FlowAcceleration:
    """
    Measure the acceleration of a flow.

    Two estimates are combined, weighted by their errors: the slope of the
    features' speeds against distance, and the features' own accelerations a,
    since a flow with the speed v(x) has ``a = v dv/dx``.  Both estimates are
    random-effects models.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    row : int, optional
        Row in the table of components.

    Returns
    -------
    ``FlowAcceleration``
        ``speed`` in the unit of proper motions and ``centre`` in mas, the means of
        the features;
        ``gradient`` of the speed with distance in 1/yr and ``acceleration`` in
        mas/yr^2, each with ``_err``; ``p_value`` and ``n_features``.  It prints
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
    >>> jet = simulate_jet(n_epochs=20, acceleration=3.0, dispersion=0.05, rng=1)
    >>> scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    >>> found = measure_acceleration(scc(jet.cube, n_trials=99, rng=1))
    >>> bool(found.acceleration > 0 * u.mas / u.yr**2), found.p_value < 0.05
    (True, True)
    """
    streams = result.search.streams
    if not 0 <= row < len(streams):
        raise ValueError(f"row must be from 0 to {len(streams) - 1}, got {row}")
    stream = streams[row]
    beam = float(projection_of(result).beam(stream.angle)[0]) * u.mas
    return fit_gradient(stream.features, beam, result.cube.speed_unit)


def fit_gradient(features, beam, unit=PM_UNIT):
    """
    Fit the gradient of the speed along a flow to its features.

    Two estimates are combined: the slope of the features' speeds against distance,
    and the mean ratio of their own accelerations to their speeds.  Features within
    two beams of the origin, where the core shifts them, are not used.  All values are
    NaN if too few are left.
    """
    beyond = [f for f in features if f.place * np.sign(f.speed) > CORE]
    n, found = len(beyond), []
    place = np.array([f.place for f in beyond])
    v, error = feature_speeds(beyond)
    if n >= FEWEST_SPEEDS:
        design = np.stack([np.ones(n), place - place.mean()], axis=1)
        (_, slope), covariance, _, _ = scattered_fit(design, v, error)
        found.append((slope, covariance[1, 1], n - 2))
    bent = [f for f in beyond if np.isfinite(f.acceleration)]
    if len(bent) >= FEWEST_BENDS:
        own = np.array([f.acceleration / f.speed for f in bent])
        error = np.array([f.acceleration_error / abs(f.speed) for f in bent])
        error *= DEFAULT.error_inflation
        (mean,), covariance, _, _ = scattered_fit(np.ones((len(bent), 1)), own, error)
        found.append((mean, covariance[0, 0], len(bent) - 1))
    gradient = error = speed = centre = p_value = np.nan
    if found:
        values, variances, freedom = np.array(found).T
        # The gradient is relative to the mean speed, in 1/beam.
        weight, speed, centre = 1 / variances, abs(v.mean()), abs(place.mean())
        gradient = (weight * values).sum() / weight.sum() / speed
        error = np.hypot(1 / np.sqrt(weight.sum()) / speed, BLENDS)
        p_value = 2 * stdtr(freedom.sum(), -abs(gradient) / error)
    (length, time), speed = unit.bases, speed * beam / u.yr
    gradient, error = (
        u.Quantity(x / beam * speed, 1 / time) for x in (gradient, error)
    )
    return FlowAcceleration(
        speed=speed.to(unit),
        centre=centre * beam,
        gradient=gradient,
        gradient_err=error,
        acceleration=(gradient * speed).to(length / time**2),
        acceleration_err=(error * speed).to(length / time**2),
        p_value=float(p_value),
        n_features=n,
    )


def feature_profile(result: SCCResult) -> QTable:
    """
    Return the mean speeds of moving features in bins of distance.

    The features of each moving component are sorted by their distance and divided
    into bins of equal numbers, at least five in each; the mean and the dispersion are
    those of ``random_effects``.  Nothing is stacked again.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    `~astropy.table.QTable`
        One row per component and bin: ``component``, ``n_features``, ``r_min``,
        ``r_max`` and ``r_mid``, the smallest, the largest and the mean distance,
        ``pm_parallel`` with ``pm_parallel_err``, and ``dispersion`` with
        ``dispersion_err``.  Empty if no component has five features.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import feature_profile
    >>> from astro_scc.simulation import simulate_jet
    >>> scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    >>> profile = feature_profile(scc(simulate_jet(rng=1).cube, n_trials=99, rng=1))
    >>> profile["n_features"].tolist()
    [6, 6]
    """
    project = projection_of(result)
    rows = []
    for number, stream in enumerate(result.search.streams, 1):
        beam = project.beam(stream.angle)[0]
        features = sorted(stream.features, key=lambda feature: abs(feature.place))
        n_bins = min(len(features) // LEAST, MOST_BINS)
        if stream.kind != "moving" or n_bins == 0:
            continue
        for part in np.array_split(np.arange(len(features)), n_bins):
            own = [features[k] for k in part]
            place = np.abs([f.place for f in own]) * beam
            speed, error = feature_speeds(own)
            mean = random_effects(np.abs(speed) * beam, error * beam)
            limits = place.min(), place.max(), place.mean()
            rows.append((number, len(own), *limits, *astuple(mean)))
    units = dict.fromkeys(BINS[2:5], u.mas) | dict.fromkeys(BINS[5:], PM_UNIT)
    return QTable(rows=rows, names=BINS, dtype=[int] * 2 + [float] * 7, units=units)


# -- groups of scales --------------------------------------------------------------


def scale_groups(
    matched: MatchedEpochs, groups: Mapping[str, ArrayLike]
) -> dict[str, np.ndarray]:
    """
    Return groups of SSPs by their scale.

    Parameters
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
    groups : dict of sequence of float or `~astropy.units.Quantity`
        The scales of each group, by its name.

    Returns
    -------
    dict of `~numpy.ndarray` of bool, shape (n_ssps,)

    Raises
    ------
    ValueError
        If a scale was not decomposed, or belongs to two groups.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_static
    >>> from astro_scc.flow import scale_groups
    >>> matched = StackedCrossCorrelation(scales=[1, 2]).match(
    ...     simulate_static(n_epochs=3, rng=1).cube)
    >>> groups = scale_groups(matched, {"fine": [1], "coarse": [2]})
    >>> bool(np.all(groups["fine"] ^ groups["coarse"]))
    True
    """
    each = groups.items()
    chosen = {name: select_ssps(matched, scales=own).select for name, own in each}
    _check_groups(chosen)
    return chosen


def _check_groups(groups):
    """Refuse fewer than two groups, and groups that share SSPs."""
    if len(groups) < 2:
        raise ValueError(f"a comparison needs two groups or more, got {len(groups)}")
    for (a, first), (b, second) in combinations(groups.items(), 2):
        if np.any(np.asarray(first) & np.asarray(second)):
            raise ValueError(f"groups {a!r} and {b!r} share SSPs: they must not")


def compare_speeds(result: SCCResult, groups: Mapping[str, np.ndarray]) -> QTable:
    """
    Compare the speeds along the jet of groups of SSPs.

    A feature belongs to the group that has more of its brightness than of the
    others': of two groups, the shares are divided where the variance within the
    two parts is least (Otsu 1979, IEEE Trans. SMC 9, 62).  The mean speed of a
    group follows from a random-effects model of its features' speeds (see
    ``random_effects``), the p-value of a difference from Welch's
    test (1947, Biometrika 34, 28).

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
        With a ``position_angle``, "radial", "fit" or "ridge".
    groups : dict of `~numpy.ndarray` of bool, shape (n_ssps,)
        Groups from `scale_groups`, or others that share no SSP.

    Returns
    -------
    `~astropy.table.QTable`
        A row for each pair of groups: ``first`` and ``second``; for each of
        them the numbers of SSPs and of features and the mean speed with its
        error; ``difference`` with its error, and ``p_value``.  What is unknown
        with fewer than two features is NaN.

    Raises
    ------
    ValueError
        If the velocity axes are east and north, or groups share SSPs.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.flow import compare_speeds, scale_groups
    >>> scc = StackedCrossCorrelation(scales=[1, 2], max_speed=36 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> matched = scc.match(simulate_two_fluid(n_epochs=8, rng=1).cube)
    >>> groups = scale_groups(matched, {"fine": [1], "coarse": [2]})
    >>> result = scc.stack(matched, n_trials=99, rng=1)
    >>> compare_speeds(result, groups)["first", "second"]
    <QTable length=1>
    first second
     str4  str6
    ----- ------
     fine coarse
    """
    if isinstance(result.frame, SkyFrame):
        raise ValueError(
            "the direction of the flow is needed: give position_angle as an angle, "
            "'fit', 'radial' or 'ridge'"
        )
    _check_groups(groups)
    matched, project = result.decomposed, projection_of(result)
    d = project(result.search.angle)
    beam = float(project.beam(result.search.angle)[0])
    streams = [s for s in result.search.streams if s.kind != "stationary"]
    features = [feature for stream in streams for feature in stream.features]
    belongs = _groups_of(features, d, matched.ssps, list(groups.values()))
    known = []
    for k, (name, member) in enumerate(groups.items()):
        found = [features[i] for i in np.flatnonzero(belongs == k)]
        n_ssp = int((matched.select & member).sum())
        known.append((name, n_ssp, len(found), *_mean(found, beam)))
    rows = [
        (*first[:5], *second[:5], *_difference(first[3:], second[3:]))
        for first, second in combinations(known, 2)
    ]
    speeds = [name for name in COMPARED if "speed" in name or "difference" in name]
    return QTable(rows=rows, names=COMPARED, units=dict.fromkeys(speeds, PM_UNIT))


def compare_scales(result):
    """
    Compare the speeds of the finest scale and of the coarser ones.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    `~astropy.table.QTable` or None
        As of `compare_speeds`; None with one scale, or without a direction.
    """
    scales = result.decomposed.scales
    if len(scales) < 2 or isinstance(result.frame, SkyFrame):
        return None
    groups = {"finest": scales[:1], "coarser": scales[1:]}
    return compare_speeds(result, scale_groups(result.decomposed, groups))


def _groups_of(features, d, ssps, groups):
    """
    Return the group of each feature, the one in which it is relatively brightest.

    Small features are seen on large scales, too, and large ones on small
    scales, so the share of brightness is compared with that of the others: of two
    groups by the division of the shares with the least variance within its parts
    (Otsu 1979, IEEE Trans. SMC 9, 62), of more by the median.
    """
    total = np.zeros((len(features), len(groups)))
    for row, feature in zip(total, features, strict=True):
        for ssp in feature.ssp:
            here = np.flatnonzero(d.epoch == d.epoch[ssp])
            away = np.hypot(*(d.position[here] - d.position[ssp]).T)
            here = here[away <= SAME_FEATURE]
            row += [ssps.peak[here[g[here]]].max(initial=0) for g in groups]
    share = np.log(np.maximum(total, np.finfo(float).tiny))
    share -= share.mean(axis=1, keepdims=True)
    several = np.count_nonzero(total, axis=1) > 1
    if len(groups) == 2 and several.sum() >= 2 * FEWEST:
        share[several] -= _division(share[several, 0]) * np.array([1, -1])
    elif several.any():
        share[several] -= np.median(share[several], axis=0)
    return np.argmax(share, axis=1)


def _division(values):
    """Return the value that divides others into two parts of least variance."""
    middle = np.median(values)
    values = np.sort(np.clip(values, middle - CLEAR, middle + CLEAR))
    ends = range(FEWEST, len(values) - FEWEST + 1)
    within = [k * values[:k].var() + values[k:].var() * (len(values) - k) for k in ends]
    first = ends[int(np.argmin(within))]
    return values[first - 1 : first + 1].mean()


def _mean(features, beam):
    """Return the mean speed in mas/yr, its error, and the degrees of freedom."""
    if len(features) < 2:
        speed = features[0].speed * beam if features else np.nan
        return abs(speed), np.nan, np.nan
    speed, error = (x * beam for x in feature_speeds(features))
    one = np.ones((len(features), 1))
    (mean,), covariance, _, _ = scattered_fit(one, np.abs(speed), error)
    return mean, np.sqrt(covariance[0, 0]), len(features) - 1.0


def _difference(first, second):
    """Return the difference of means, its error, and the p-value of Welch's test."""
    (m1, e1, n1), (m2, e2, n2) = first, second
    error = np.hypot(e1, e2)
    freedom = error**4 / (e1**4 / n1 + e2**4 / n2)
    return m2 - m1, error, 2 * stdtr(freedom, -abs(m2 - m1) / error)
