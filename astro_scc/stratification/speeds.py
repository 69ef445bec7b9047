# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speeds of groups of SSPs, and the probability of their differences."""

from itertools import combinations

import astropy.units as u
import numpy as np
from astropy.table import QTable
from scipy.special import stdtr

from astro_scc.kinematics import RadialFrame, RidgeLine, SkyFrame
from astro_scc.measurement.axes import AxisProjection
from astro_scc.stacking.search import DEFAULT
from astro_scc.stacking.streams import feature_speeds, scattered_fit
from astro_scc.stratification.groups import check_groups

__all__ = ["compare_speeds"]


def compare_speeds(result, groups):
    """
    Compare the speeds along the jet of groups of SSPs.

    A feature belongs to the group that has more of its brightness than of
    that of the median feature: of two scale groups, the larger half of the
    features is of the coarse one.  The mean speed of a group is that of its
    features by the random-effects model (see `~astro_scc.stacking.random_effects`),
    the probability of a difference that of Welch's test (1947, Biometrika
    34, 28).

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
        With a ``position_angle``, "radial", "fit" or "ridge".
    groups : dict of `~numpy.ndarray` of bool, shape (n_ssps,)
        Of `scale_groups`, `limb_groups`, or any others that share no SSP.

    Returns
    -------
    `~astropy.table.QTable`
        A row for each pair of groups: ``first``, ``second``, and of either the
        numbers of SSPs and of features and the mean speed with its error;
        ``difference`` with its error, and ``p_value``.  What fewer than two
        features leave unknown is NaN.

    Raises
    ------
    ValueError
        If the velocity axes are east and north, or groups share SSPs.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.stratification import compare_speeds, scale_groups
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
    check_groups(groups)
    matched = result.matched
    project = AxisProjection(
        result.displacements, matched.ssps, matched.cube, result.frame
    )
    d = project(result.search.angle)
    beam = float(project.beam(result.search.angle)[0])
    features = result.search.follow(d)
    belongs = _groups_of(features, d, matched.ssps, list(groups.values()))
    speeds, columns = {}, {}
    for k, (name, member) in enumerate(groups.items()):
        found = [f for f, own in zip(features, belongs, strict=True) if own == k]
        speeds[name] = _mean(found, beam)
        columns[name] = int((matched.select & member).sum()), len(found)
    pairs = list(combinations(groups, 2))
    table = QTable()
    for which, names in zip(("first", "second"), zip(*pairs, strict=True), strict=True):
        table[which] = list(names)
        table[f"{which}_n_ssp"] = [columns[name][0] for name in names]
        table[f"{which}_n_features"] = [columns[name][1] for name in names]
        mean, error, _ = np.array([speeds[name] for name in names]).T
        table[f"{which}_speed"] = mean * u.mas / u.yr
        table[f"{which}_speed_err"] = error * u.mas / u.yr
    differences = np.array([_difference(speeds[a], speeds[b]) for a, b in pairs])
    table["difference"] = differences[:, 0] * u.mas / u.yr
    table["difference_err"] = differences[:, 1] * u.mas / u.yr
    table["p_value"] = differences[:, 2]
    return table


def _groups_of(features, d, ssps, groups):
    """
    The group that a feature belongs to: that in which it is brighter than others.

    A small feature is seen on large scales, too, and a large one on small
    ones: what counts is its share of brightness beside that of the median
    feature.
    """
    total = np.zeros((len(features), len(groups)))
    for row, feature in zip(total, features, strict=True):
        for ssp in feature.ssp:
            here = np.flatnonzero(d.epoch == d.epoch[ssp])
            away = np.hypot(*(d.position[here] - d.position[ssp]).T)
            here = here[away <= DEFAULT.same_feature]
            row += [ssps.peak[here[g[here]]].max(initial=0) for g in groups]
    share = np.log(np.maximum(total, np.finfo(float).tiny))
    share -= share.mean(axis=1, keepdims=True)
    several = np.count_nonzero(total, axis=1) > 1
    if several.any():
        share[several] -= np.median(share[several], axis=0)
    return np.argmax(share, axis=1)


def _mean(features, beam):
    """Mean speed in mas/yr, its standard error, and the degrees of freedom."""
    if len(features) < 2:
        speed = features[0].speed * beam if features else np.nan
        return abs(speed), np.nan, np.nan
    speed, error = (x * beam for x in feature_speeds(features))
    one = np.ones((len(features), 1))
    (mean,), covariance, _, _ = scattered_fit(one, np.abs(speed), error)
    return mean, np.sqrt(covariance[0, 0]), len(features) - 1.0


def _difference(first, second):
    """The difference of two means, its error, and the p-value of Welch's test."""
    (m1, e1, n1), (m2, e2, n2) = first, second
    error = np.hypot(e1, e2)
    freedom = error**4 / (e1**4 / n1 + e2**4 / n2)
    return m2 - m1, error, 2 * stdtr(freedom, -abs(m2 - m1) / error)


def along_flow(frame, east, north):
    """
    Distance along the flow of places.

    Parameters
    ----------
    frame : frame of `astro_scc.kinematics`
    east, north : `~numpy.ndarray`, shape (n,)
        In mas.

    Returns
    -------
    `~numpy.ndarray`, shape (n,)
    """
    if isinstance(frame, RidgeLine):
        return frame.coordinates(east * u.mas, north * u.mas)[0].to_value(u.mas)
    if isinstance(frame, RadialFrame):
        x0, y0 = frame.origin.value
        return np.hypot(east - x0, north - y0)
    return np.stack([east, north], axis=-1) @ frame.matrix()[0]
