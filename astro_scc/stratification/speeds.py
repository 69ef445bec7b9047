# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speeds of groups of SSPs, and the probability of their differences."""

from dataclasses import replace
from itertools import combinations

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.kinematics import RadialFrame, RidgeLine
from astro_scc.measurement import select_ssps
from astro_scc.stacking import Sightings, compare_groups, flow_blocks
from astro_scc.stratification.groups import check_groups

__all__ = ["compare_speeds"]

#: Sightings further across the flow than this many standard errors do not count.
ACROSS = 5.0


def compare_speeds(
    scc, matched, groups, *, r_min=None, r_max=None, n_trials=1000, rng=None
):
    """
    Compare the speeds along the jet of groups of SSPs.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        With a ``position_angle``, "radial", "fit" or "ridge".
    matched : `~astro_scc.measurement.MatchedEpochs`
    groups : dict of `~numpy.ndarray` of bool, shape (n_ssps,)
        Of `scale_groups`, `limb_groups`, or any others that share no SSP.
    r_min, r_max : `~astropy.units.Quantity`, optional
        Of the SSPs, distances from the reference pixel.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `~astropy.table.QTable`
        A row for each pair of groups: ``first``, ``second``, their ``n_ssp``
        and speeds with errors, ``difference`` with its error, ``p_value`` of
        the paired permutation (see `~astro_scc.stacking.compare_groups`) and
        ``n_blocks``.

    Raises
    ------
    ValueError
        If the velocity axes are east and north, groups share SSPs, or one
        has no match.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.stratification import compare_speeds, scale_groups
    >>> scc = StackedCrossCorrelation(scales=[1, 2], max_speed=36 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> matched = scc.match(simulate_two_fluid(n_epochs=6, rng=1).cube)
    >>> groups = scale_groups(matched, {"fine": [1], "coarse": [2]})
    >>> compare_speeds(scc, matched, groups, n_trials=99, rng=1)["first", "second"]
    <QTable length=1>
    first second
     str4  str6
    ----- ------
     fine coarse
    """
    check_groups(groups)
    part = select_ssps(matched, r_min=r_min, r_max=r_max)
    select = np.any([part.select & g for g in groups.values()], axis=0)
    seen, x = flow_sightings(scc, replace(part, select=select))
    across = np.exp(-0.5 * (seen.v2 / seen.s2) ** 2)
    limit = scc.speed_limit(matched.cube).to_value(u.mas / u.yr)
    use = (np.abs(seen.v2) <= ACROSS * seen.s2) & (np.abs(seen.v1) <= limit)
    weight = np.where(use, seen.weight * seen.interval**2 * across, 0.0)
    rows = []
    rngs = np.random.default_rng(rng).spawn(len(groups) * (len(groups) - 1) // 2)
    for (a, b), own in zip(combinations(groups, 2), rngs, strict=True):
        member = [groups[name][seen.ssp] & (weight > 0) for name in (a, b)]
        for name, m in zip((a, b), member, strict=True):
            if not m.any():
                raise ValueError(f"group {name!r} has no match in this part of the jet")
        both = member[0] | member[1]
        middle = float(np.average(seen.v1[both], weights=weight[both]))
        found = compare_groups(
            seen.v1[both],
            seen.s1[both],
            weight[both],
            member[1][both],
            flow_blocks(seen.select(both), x[both], middle),
            n_trials=n_trials,
            rng=own,
        )
        rows.append((a, b, found))
    pm = u.mas / u.yr
    numbers = {name: int((part.select & g).sum()) for name, g in groups.items()}
    table = QTable(
        {
            "first": [a for a, _, _ in rows],
            "second": [b for _, b, _ in rows],
            "first_n_ssp": [numbers[a] for a, _, _ in rows],
            "second_n_ssp": [numbers[b] for _, b, _ in rows],
        }
    )
    for k, name in enumerate(("first", "second")):
        table[f"{name}_speed"] = [f.speed[k] for *_, f in rows] * pm
        table[f"{name}_speed_err"] = [f.error[k] for *_, f in rows] * pm
    table["difference"] = [f.difference for *_, f in rows] * pm
    table["difference_err"] = [f.difference_err for *_, f in rows] * pm
    table["p_value"] = [f.p_value for *_, f in rows]
    table["n_blocks"] = [f.n_blocks for *_, f in rows]
    table.meta["n_trials"] = n_trials
    return table


def flow_sightings(scc, matched):
    """
    Sightings along a flow, and where along it they are.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
    matched : `~astro_scc.measurement.MatchedEpochs`

    Returns
    -------
    sightings : `~astro_scc.stacking.Sightings`
    distance : `~numpy.ndarray`, shape (n,)
        Along the flow in mas, at the mean dates.

    Raises
    ------
    ValueError
        If the velocity axes are east and north.
    """
    displacements, frame = scc.displacements(matched)
    if tuple(frame.axis_names) == ("east", "north"):
        raise ValueError(
            "the direction of the flow is needed: give position_angle as an angle, "
            "'fit', 'radial' or 'ridge'"
        )
    limit = scc.speed_limit(matched.cube).to_value(u.mas / u.yr)
    cube = matched.cube
    seen = Sightings.of(
        displacements, scc.date_pairs(cube), cube.years.to_value(u.yr), (2 * limit,) * 2
    )
    return seen, along_flow(frame, *seen.middle.T)


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
