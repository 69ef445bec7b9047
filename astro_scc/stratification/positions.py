# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Where the SSPs of groups are across the jet."""

import warnings
from itertools import combinations

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.epochs import ssp_offsets
from astro_scc.kinematics import RadialFrame, RidgeLine
from astro_scc.measurement import select_ssps
from astro_scc.measurement.stacking import velocity_frame
from astro_scc.stratification.groups import check_groups
from astro_scc.stratification.speeds import along_flow

__all__ = ["compare_positions", "ssp_places"]

#: SSPs of one feature are those ejected within so many beams of one another.
BLOCK_BEAMS = 2.0


def ssp_places(scc, matched):
    """
    Position angles and transverse offsets of the centroids of SSPs.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        Its velocity axes say what is across.
    matched : `~astro_scc.measurement.MatchedEpochs`

    Returns
    -------
    angle : `~astropy.units.Quantity`, shape (n_ssps,)
        About the reference pixel, within half a turn of the jet's.
    offset : `~astropy.units.Quantity`, shape (n_ssps,)
        Across the jet, positive towards larger position angles.
    distance : `~astropy.units.Quantity`, shape (n_ssps,)
        Along the jet.
    """
    east, north = ssp_offsets(matched.ssps, matched.cube, centroid=True)
    frame, jet = velocity_frame(matched, scc.position_angle)
    jet = jet.to_value(u.deg)
    angle = np.degrees(np.arctan2(east, north))
    angle = jet + (angle - jet + 180) % 360 - 180
    if isinstance(frame, RidgeLine):
        offset = frame.coordinates(east * u.mas, north * u.mas)[1].to_value(u.mas)
    elif isinstance(frame, RadialFrame):
        offset = np.radians(angle - jet) * np.hypot(east, north)
    else:
        p = np.radians(jet)
        offset = east * np.cos(p) - north * np.sin(p)
    distance = (
        np.hypot(east, north)
        if tuple(frame.axis_names) == ("east", "north")
        else along_flow(frame, east, north)
    )
    return angle * u.deg, offset * u.mas, distance * u.mas


def compare_positions(
    scc,
    matched,
    groups,
    *,
    speed=None,
    r_min=None,
    r_max=None,
    n_trials=999,
    rng=None,
):
    """
    Compare where groups of SSPs lie across the jet.

    Both the position angles and the transverse offsets are compared by the
    Anderson-Darling test of two samples (Scholz & Stephens 1987, J. Am.
    Stat. Assoc. 82, 918), and so are the distances of the offsets from the
    median of both groups, which tell a spine from limbs.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        Its velocity axes say what is across.
    matched : `~astro_scc.measurement.MatchedEpochs`
    groups : dict of `~numpy.ndarray` of bool, shape (n_ssps,)
    speed : `~astropy.units.Quantity`, optional
        Of the flow, to tell which SSPs are of one feature; at rest without.
    r_min, r_max : `~astropy.units.Quantity`, optional
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `~astropy.table.QTable`
        A row for each pair of groups and each ``quantity`` ("position
        angle", "offset", "from the middle"): medians and half the central
        68% of both, the ``statistic``, ``p_ksamp`` as
        `scipy.stats.anderson_ksamp` has it, and ``p_paired``.

    Raises
    ------
    ValueError
        If groups share SSPs, or one has fewer than two here.

    Notes
    -----
    ``p_ksamp`` takes every SSP for a sample of its own, but a feature is seen
    in many epochs; it is far too small, and never below 0.001.  ``p_paired``
    is that of a permutation: SSPs are gathered into lengths of the flow of
    two beams, and in each the names of the two groups are kept or swapped.

    Groups of scales can differ in place even in a jet that has no layers,
    because what is apart on a small scale is one pattern on a large one.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.stratification import compare_positions
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> matched = scc.match(cube)
    >>> ssps = matched.ssps
    >>> groups = {"bright": ssps.snr >= 100, "faint": ssps.snr < 100}
    >>> table = compare_positions(scc, matched, groups, n_trials=19, rng=1)
    >>> table["quantity"].tolist()
    ['position angle', 'offset', 'from the middle']
    """
    check_groups(groups)
    part = select_ssps(matched, r_min=r_min, r_max=r_max)
    angle, offset, distance = ssp_places(scc, part)
    blocks = _blocks(part, distance, speed)
    rows = []
    rngs = np.random.default_rng(rng).spawn(3 * len(groups) ** 2)
    for a, b in combinations(groups, 2):
        chosen = [part.select & groups[name] for name in (a, b)]
        for name, c in zip((a, b), chosen, strict=True):
            if c.sum() < 2:
                raise ValueError(
                    f"group {name!r} has {c.sum()} SSPs in this part of the jet: a "
                    "comparison needs two or more"
                )
        both = chosen[0] | chosen[1]
        middle = np.median(offset[both])
        quantities = {
            "position angle": angle,
            "offset": offset,
            "from the middle": np.abs(offset - middle),
        }
        for name, values in quantities.items():
            v = values.value[both]
            second = chosen[1][both]
            statistic, p_ksamp, p_paired = _test(
                v, second, blocks[both], n_trials, rngs.pop()
            )
            summary = [_summary(v[own], values.unit) for own in (~second, second)]
            rows.append((a, b, name, *summary, statistic, p_ksamp, p_paired))
    table = QTable()
    for k, name in enumerate(("first", "second", "quantity")):
        table[name] = [row[k] for row in rows]
    for k, name in enumerate(("first", "second")):
        # Angles and lengths do not share a column of one unit.
        table[f"{name}_median"] = [row[3 + k][0] for row in rows]
        table[f"{name}_spread"] = [row[3 + k][1] for row in rows]
    table["unit"] = [row[3][2] for row in rows]
    for k, name in enumerate(("statistic", "p_ksamp", "p_paired")):
        table[name] = [row[5 + k] for row in rows]
    table.meta["n_trials"] = n_trials
    return table


def _summary(values, unit):
    low, middle, high = np.percentile(values, [16, 50, 84])
    return float(middle), float(0.5 * (high - low)), str(unit)


def _blocks(matched, distance, speed):
    cube = matched.cube
    v = 0.0 if speed is None else u.Quantity(speed).to_value(u.mas / u.yr)
    years = cube.years.to_value(u.yr)[matched.ssps.epoch]
    beam = 4 * cube.pixel_scale.value
    if cube.beams is not None:
        areas = [(b.major * b.minor).to_value(u.mas**2) for b in cube.beams]
        beam = np.sqrt(np.mean(areas))
    start = distance.to_value(u.mas) - v * years
    return np.floor(start / (BLOCK_BEAMS * beam)).astype(int)


def _test(values, second, block, n_trials, rng):
    """Statistic, its own probability and that of the paired permutation."""
    from scipy.stats import anderson_ksamp

    def statistic(names):
        with warnings.catch_warnings():
            # That the table of probabilities ends at 0.001 and 0.25 is known.
            warnings.simplefilter("ignore")
            return anderson_ksamp([values[~names], values[names]])

    found = statistic(second)
    numbers, block = np.unique(block, return_inverse=True)
    beyond = 0
    for swap in rng.random((n_trials, len(numbers))) < 0.5:
        names = second ^ swap[block]
        if 1 < names.sum() < len(names) - 1:
            beyond += statistic(names).statistic >= found.statistic - 1e-12
        else:
            beyond += 1
    return (
        float(found.statistic),
        float(found.pvalue),
        (int(beyond) + 1) / (n_trials + 1),
    )
