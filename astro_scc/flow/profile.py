# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocity profile: streams in bins of core separation, their table and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable
from threadpoolctl import threadpool_limits

from astro_scc.columns import describe
from astro_scc.epochs import EpochCube
from astro_scc.flow.acceleration import FlowAcceleration, acceleration_of
from astro_scc.flow.models import fit_profile
from astro_scc.flow.parts import (
    PartFit,
    PartSpeeds,
    fit_part,
    has_flow,
    place_of,
    speeds_in_parts,
)
from astro_scc.flow.speeds import check_groups, feature_distances, flow_by_scale
from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import RidgeLine
from astro_scc.kinematics.cosmology import beta_per_pm
from astro_scc.measurement import SCCResult, false_discovery_rate
from astro_scc.measurement.axes import alignment_errors
from astro_scc.measurement.tables import Components, stack_tables, stream_table
from astro_scc.patterns import DecomposedEpochs, ssp_distances
from astro_scc.plan import flow_direction, scale_numbers
from astro_scc.products.folder import write_files, write_tables
from astro_scc.progress import progress
from astro_scc.quantities import random_generator, seeded
from astro_scc.scc import StackedCrossCorrelation, used_intervals
from astro_scc.settings import require
from astro_scc.streams.decomposed import DecomposedFlow
from astro_scc.streams.finder import find_streams
from astro_scc.units import PM_UNIT
from astro_scc.visualization import speeds, style
from astro_scc.writing import versions

#: The name of all scales together.
ALL = "all"


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
    The measurement in each bin of distance, and each group of scales.

    Attributes
    ----------
    bins : `~astropy.units.Quantity`, shape (n, 2)
        Limits of the bins.
    results : dict of tuple of `~astro_scc.measurement.SCCResult` or None
        By the name of the group of scales, "all" if there are none: one per bin, None
        if nothing is seen there.
    fits, speeds : dict
        By the same names: one stream fitted to each bin, and its speeds with their
        covariance, in beams and years.
    flow : ``DecomposedFlow``
        The flow that is divided.
    along : {"radius", "ridge"}
        Whether distances are measured from the core or along the ridge line.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import measure_profile
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=8, rng=1).cube
    >>> scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    >>> profile = measure_profile(scc, cube, [2, 10, 18] * u.mas, n_trials=20, rng=1)
    >>> len(profile), profile.components.colnames[:3], profile.covariance.shape
    (2, ['r_min', 'r_max', 'r_mid'], (2, 2))
    """

    bins: u.Quantity
    results: dict[str, tuple[SCCResult | None, ...]]
    fits: dict[str, tuple[PartFit | None, ...]]
    speeds: dict[str, PartSpeeds]
    flow: DecomposedFlow
    along: str = "radius"

    def __len__(self) -> int:
        return len(self.bins)

    def __repr__(self):
        return (
            f"<Profile: {len(self)} bins from {self.bins.min():g} to "
            f"{self.bins.max():g}, {len(self.components)} streams>"
        )

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups of scales, ("all",) if there are none."""
        return tuple(self.results)

    @property
    def covariance(self) -> u.Quantity:
        """
        Covariance of the speeds of the spectrum in the bins, of the first group.

        The speeds are the means of one Gaussian in each bin; NaN where none is known.
        """
        return self.speeds[self.groups[0]].covariance * (self.flow.beam * PM_UNIT) ** 2

    @cached_property
    def acceleration(self) -> FlowAcceleration:
        """The slope of the speeds of the first group, with their covariance."""
        return self.accelerations[self.groups[0]]

    @cached_property
    def accelerations(self) -> dict[str, FlowAcceleration]:
        """The acceleration by the name of the group of scales."""
        unit = self.flow.cube.speed_unit
        return {
            name: acceleration_of(own, self.flow.beam, unit)
            for name, own in self.speeds.items()
        }

    @cached_property
    def components(self) -> QTable:
        """
        The streams of all bins, a `~astropy.table.QTable`.

        The columns are ``r_min``, ``r_max``, ``r_mid``, with groups of scales
        ``scale_group``, those of
        `SCCResult.streams <astro_scc.measurement.SCCResult.streams>`
        with ``p_fdr``, adjusted for all bins and groups, and ``main``, which marks at
        most one stream of each bin: of those whose speed exceeds its error, the
        moving one with the largest share or, if none moves, the one with the largest
        share that is not significant.  The meta holds, by group, the ``covariance`` of
        the speeds of the spectrum in the bins, and the ``acceleration``.
        """
        named = [
            (name, limits, stream_table([]) if own is None else own.streams)
            for name, found in self.results.items()
            for limits, own in zip(self.bins, found, strict=True)
        ]
        tables = [table for *_, table in named]
        adjusted = false_discovery_rate(tables)
        several = self.groups != (ALL,)
        placed = [
            _in_bin(table, limits, name if several else None)
            for (name, limits, _), table in zip(named, adjusted, strict=True)
        ]
        meta = dict(next((table.meta for table in tables if table.meta), {}))
        if tested := adjusted[0].meta.get("false_discovery"):
            meta["false_discovery"] = tested
        meta["bins"] = self.bins.to_value(u.mas).tolist()
        meta["along"] = self.along
        meta["covariance"] = {name: self._covariance(name) for name in self.groups}
        meta["acceleration"] = {
            name: asdict(own) for name, own in self.accelerations.items()
        }
        return stack_tables(placed, meta)

    @property
    def streams(self) -> QTable:
        """Another name of `components`."""
        return self.components

    def _covariance(self, name):
        """Return the speeds of a group and their covariance for the meta."""
        own, beam = self.speeds[name], self.flow.beam
        known = np.flatnonzero(np.isfinite(own.speed))
        square = own.covariance[np.ix_(known, known)]
        return {
            "bins": known.tolist(),
            "distance": own.place[known] * beam * u.mas,
            "speed": own.speed[known] * beam * PM_UNIT,
            "covariance": square * (beam * PM_UNIT) ** 2,
        }

    @property
    def main(self) -> QTable:
        """The rows of `components` that are ``main`` in their bin."""
        return self.components[self.components["main"]]


def _in_bin(table, limits, group):
    """Return a table of streams with the limits of their bin in front."""
    low, high = limits.to_value(u.mas)
    values = {"r_min": low, "r_max": high, "r_mid": (low + high) / 2}
    columns = {name: np.full(len(table), r) * u.mas for name, r in values.items()}
    if group is not None:
        columns["scale_group"] = np.full(len(table), group)
    columns |= dict(table.items()) | {"main": _main(table)}
    return describe(QTable(columns, meta=table.meta), "profile")


def _main(table):
    """Return which row, if any, represents the bin."""
    chosen = np.zeros(len(table), dtype=bool)
    share = np.nan_to_num(np.asarray(table["share"], dtype=float))
    for wanted in ("moving", "not confirmed", "not significant"):
        moves = (table["kind"] == wanted) & (table["pm"] > table["pm_err"])
        if moves.any():
            chosen[np.where(moves, share, -np.inf).argmax()] = True
            break
    return chosen


def measure_profile(
    scc: StackedCrossCorrelation, decomposed: DecomposedEpochs | EpochCube,
    edges: u.Quantity | str, *, window: u.Quantity | str | None = None,
    ridge: RidgeLine | None = None,
    scale_groups: Mapping[str, Sequence[float]] | str | None = None,
    n_trials: int = 1000, rng: np.random.Generator | int | None = None,
    progress_bar: bool = False,
) -> Profile:  # fmt: skip
    """
    Measure the streams in bins of distance, and by scale.

    A displacement counts in the bin of its middle, and a feature in that of its mean
    place.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        The settings.
    decomposed : `~astro_scc.patterns.DecomposedEpochs` or cube
        The result of ``scc.decompose(cube)``, or a cube, which is decomposed first.
    edges : `~astropy.units.Quantity` or str, shape (n + 1,)
        Limits of the bins: increasing angles, none negative.
    window : `~astropy.units.Quantity` or str, optional
        Width of windows that replace the bins between edges: each edge is the
        middle of a window, and neighbours share what moves where they overlap.
    ridge : `~astro_scc.kinematics.RidgeLine`, optional
        Measure distances and speeds along this line.
    scale_groups : dict of sequence of float, or str, optional
        Numbers of the scales of each group by its name, or as text, ``"1,2; 3,4"``.
        Each is measured by itself, from the spectrum alone, as features have no scale.
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
        If the bins or groups are invalid, or nothing is seen in any bin.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import measure_profile
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    >>> cube = simulate_two_fluid(n_epochs=8, rng=1).cube
    >>> profile = measure_profile(scc, cube, [2, 18] * u.mas, scale_groups="1; 2,3",
    ...                           n_trials=50, rng=1)
    >>> sorted(set(profile.components["scale_group"].tolist()))
    ['1', '2, 3']
    """
    bins = bins_of(edges, window=window)
    groups = None if scale_groups is None else require("scale_groups", scale_groups)
    n_trials = require("n_trials", n_trials)
    if not hasattr(decomposed, "decomposer"):
        decomposed = scc.decompose(decomposed, progress_bar=progress_bar)
    scc = scc if ridge is None else replace(scc, position_angle=ridge)
    cube, features = decomposed.cube, decomposed.follow(progress_bar=progress_bar)
    rng, seed = seeded(rng)
    generator, of_scales = random_generator(rng), groups is not None
    search = {
        "misaligned": alignment_errors(cube, scc.alignment_error), "alpha": scc.alpha,
        "outward": scc.outward, "intervals": used_intervals(cube, scc.baseline),
        "n_trials": n_trials,
    }  # fmt: skip
    meta = {
        "settings": scc.to_dict(), "n_trials": n_trials, "seed": seed,
        "versions": versions(),
    }  # fmt: skip
    # The matrix products are small: threads would wait for one another.
    with threadpool_limits(1):
        flow = scc.flow(decomposed)
        if len(flow.grids) > 1:
            # Bins need one direction, that of the whole flow.
            flow = find_streams(flow, features, rng=generator, **search).flow
        flows = _by_scale(cube, flow, groups) if of_scales else {ALL: flow}
        total = len(flows) * len(bins)
        with progress(total, "Searching", show=progress_bar) as done:
            results = {
                name: _search_bins(
                    own, bins, decomposed, root=not of_scales, search=search, meta=meta,
                    rngs=generator.spawn(len(bins)), done=done,
                )
                for name, own in flows.items()
            }  # fmt: skip
        if not any(result for found in results.values() for result in found):
            raise ValueError(
                f"nothing is seen in the bins, {bins.min():g} to {bins.max():g} from "
                "the core: choose others"
            )
        sign, intervals = _sign_of(results), search["intervals"]
        fits = {
            name: tuple(
                _fit_again(one, sign, intervals, root=not of_scales) for one in found
            )
            for name, found in results.items()
        }
        limits = bins.to_value(u.mas)
        places = [place_of(flow.between(low, high)) for low, high in limits]
        speeds = {name: speeds_in_parts(own, places) for name, own in fits.items()}
    along = "ridge" if isinstance(flow.frame, RidgeLine) else "radius"
    return Profile(bins, results, fits, speeds, flow, along)


def _search_bins(flow, bins, decomposed, *, root, search, meta, rngs, done):
    """Return the result of each bin, or None; groups of scales have no features."""
    features = decomposed.features
    distance = feature_distances(flow, features)
    direction, found = flow_direction(decomposed, flow.frame), []
    for (low, high), rng in zip(bins.to_value(u.mas), rngs, strict=True):
        part, result = flow.between(low, high), None
        if has_flow(part):
            inside = root & (distance >= low) & (distance < high)
            streams = find_streams(
                part, features, inside=inside, root=root, rng=rng, **search
            )
            result = SCCResult(decomposed, streams, direction, meta=dict(meta))
        found.append(result)
        done(1)
    return tuple(found)


def _by_scale(cube, flow, groups):
    """Return the flows of groups of scales by their names."""
    numbers = {name: scale_numbers(cube, own) for name, own in groups.items()}
    check_groups(numbers)
    whole = flow_by_scale(flow, sorted({s for own in numbers.values() for s in own}))
    return {name: whole.part(scales=own) for name, own in numbers.items()}


def _sign_of(results):
    """Return the sign of the speed of the bin in which motion is clearest."""
    tests = [
        result.search.test for found in results.values() for result in found if result
    ]
    test = max(tests, key=lambda test: test.z.max())
    return float(np.sign(test.speed[test.best[1]]))


def _fit_again(result, sign, intervals, *, root):
    """Return the fit of one stream to a bin."""
    if result is None:
        return None
    search, fit = result.search, result.search.fit
    same = fit is not None and len(fit.mean) == 1 and fit.mean[0] * sign > 0
    return fit_part(
        search.flow, sign=sign, root=root, intervals=intervals, diagram=search.diagram,
        fit=fit if same else None,
    )  # fmt: skip


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
    >>> cube = simulate_two_fluid(n_epochs=8, rng=1).cube
    >>> scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    >>> profile = measure_profile(scc, cube, [2, 10, 18] * u.mas, n_trials=20, rng=1)
    >>> Path("out").mkdir()
    >>> [path.name for path in write_profile(profile, profile.components, "out")]
    ['profile.ecsv', 'profile.png', 'position_angles.png']
    """
    tables = {"profile": components}
    _, paths = write_tables(tables, directory, components.meta, **settings)
    files = style.figure_files(_figures(profile, components))
    write_files(files, Path(directory))
    return paths + [Path(directory, name) for name in files]


def _figures(profile, components):
    """Return functions that draw the figures of a profile by their names."""
    found = [result for own in profile.results.values() for result in own if result]
    shown = {
        "line": _line_of(found[0], profile.bins.max()), "fits": _fits(profile),
        "cube": found[0].cube, "beta_per_pm": beta_per_pm(components),
    }  # fmt: skip
    angles = angles_by_scale(profile, found[0])
    return {
        "profile": partial(speeds.plot_profile, components, **shown),
        "position_angles": partial(speeds.plot_position_angles, angles),
    }


def angles_by_scale(profile, result):
    """
    Return the position angles of SSPs in the bins, by groups of scales or by scale.

    Parameters
    ----------
    profile : `Profile`
    result : `~astro_scc.measurement.SCCResult`
        Of any bin.

    Returns
    -------
    dict of `~astropy.units.Quantity`
    """
    decomposed, frame = result.decomposed, profile.flow.frame
    ridge = frame if profile.along == "ridge" else None
    r = ssp_distances(decomposed, ridge=ridge)
    inside = decomposed.select & (r >= profile.bins.min()) & (r < profile.bins.max())
    angle, scale = ssp_angles(decomposed, result.position_angle), decomposed.ssps.scale
    groups = {f"scale {j:g}": [j] for j in np.unique(scale[inside])}
    if profile.groups != (ALL,):
        groups = {
            f"scales {name}": own[0].planes.scales
            for name, fits in profile.fits.items()
            if (own := [fit for fit in fits if fit])
        }
    return {name: angle[inside & np.isin(scale, own)] for name, own in groups.items()}


def ssp_angles(decomposed, jet):
    """
    Return the position angles of the centroids of SSPs from the reference pixel.

    Parameters
    ----------
    decomposed : `~astro_scc.patterns.DecomposedEpochs`
    jet : `~astropy.units.Quantity`
        Direction of the jet.

    Returns
    -------
    `~astropy.units.Quantity`, shape (n_ssps,)
        Within half a turn of the jet's.
    """
    east, north = ssp_offsets(decomposed.ssps, decomposed.cube, centroid=True)
    angle, jet = np.degrees(np.arctan2(east, north)), jet.to_value(u.deg)
    return (jet + (angle - jet + 180) % 360 - 180) * u.deg


def _line_of(result, length):
    """Return the line along which the jet is drawn."""
    if isinstance(result.frame, RidgeLine):
        return result.frame
    angle, s = result.position_angle, u.Quantity([0 * u.mas, length])
    return RidgeLine(s * np.sin(angle), s * np.cos(angle))


def _fits(profile):
    """Return a straight line and a power law, if there are enough speeds."""
    own, beam = profile.speeds[profile.groups[0]], profile.flow.beam
    unit = profile.flow.cube.speed_unit
    v, e = ((x * beam * PM_UNIT).to(unit) for x in (own.speed, own.error))
    fits = []
    for model in ("linear", "power-law"):
        with suppress(ValueError):
            r = own.place * beam * u.mas
            fits.append(
                fit_profile(r, v, e, model=model, covariance=profile.covariance)
            )
    return tuple(fits)
