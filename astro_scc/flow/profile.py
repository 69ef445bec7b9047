# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocity profile: streams in bins of core separation, their table and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable
from threadpoolctl import threadpool_limits

from astro_scc.columns import describe
from astro_scc.epochs import EpochCube
from astro_scc.flow.models import FlowAcceleration, acceleration_of
from astro_scc.flow.speeds import (
    distances_along,
    flows_by_scale,
    halves,
    moves_in,
    place_of,
    speeds_in_parts,
)
from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import RidgeLine
from astro_scc.kinematics.cosmology import beta_per_pm
from astro_scc.measurement import SCCResult, false_discovery_rate
from astro_scc.measurement.tables import Components, stack_tables, stream_table
from astro_scc.parallel import progress
from astro_scc.patterns import DecomposedEpochs
from astro_scc.plan import flow_direction, scale_numbers
from astro_scc.products.folder import write_files, write_tables
from astro_scc.quantities import seeded
from astro_scc.scc import StackedCrossCorrelation, meta_of
from astro_scc.settings import refuse_other_method, require
from astro_scc.streams.decomposed import (
    DecomposedFlow,
    PartFit,
    fit_along_lines,
    fit_part,
    has_flow,
)
from astro_scc.streams.finder import find_streams
from astro_scc.units import PM_UNIT
from astro_scc.visualization import speeds, style

#: The name of all scales together.
ALL = "all"
#: What is said of a lone stream of a group of scales.
ONE_OF_TWO = "the whole flow has two streams: compare the groups by both"


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
        By the same names: one stream fitted to each bin, None if its speed is not
        known, and its distances, speeds and their covariance, in beams and years.
    flow : ``DecomposedFlow``
        The flow that is divided.
    pair : sequence of (float, float) or None
        With groups, mean and dispersion of both of two streams of the whole flow.

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
    speeds: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]
    flow: DecomposedFlow
    pair: list[tuple[float, float]] | None = None

    def __len__(self) -> int:
        return len(self.bins)

    def __repr__(self):
        return (
            f"<Profile: {len(self)} bins from {self.bins.min():g} to "
            f"{self.bins.max():g}, {len(self.components)} streams>"
        )

    @property
    def along(self) -> str:
        """Along what distances are measured, the "radius" or the "ridge" line."""
        return "ridge" if isinstance(self.flow.frame, RidgeLine) else "radius"

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups of scales, ("all",) if there are none."""
        return tuple(self.results)

    @property
    def pairs(self) -> tuple[list[tuple[float, float]] | None, ...]:
        """For each bin, the ``pair`` or, without one, that of any group in this bin."""
        return tuple(
            self.pair
            or next((r.search.pair for r in found if r and r.search.pair), None)
            for found in zip(*self.results.values(), strict=True)
        )

    @property
    def covariance(self) -> u.Quantity:
        """
        Covariance of the speeds of the spectrum in the bins, of the first group.

        The speeds are the means of one Gaussian in each bin; NaN where none is known.
        """
        return self.speeds[self.groups[0]][2] * (self.flow.beam * PM_UNIT) ** 2

    @cached_property
    def acceleration(self) -> FlowAcceleration:
        """The slope of the speeds of the first group, with their covariance."""
        return self.accelerations[self.groups[0]]

    @cached_property
    def accelerations(self) -> dict[str, FlowAcceleration]:
        """The acceleration by the name of the group of scales."""
        unit, found = self.flow.cube.speed_unit, {}
        for name, parts in self.speeds.items():
            moves = sum(map(moves_in, self.results[name])) > 1
            found[name] = acceleration_of(parts, self.flow, unit, moves=moves)
        return found

    @cached_property
    def streams(self) -> QTable:
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
        tables = {
            (name, k): stream_table([]) if result is None else result.streams
            for name, found in self.results.items()
            for k, result in enumerate(found)
        }
        if self.pair:
            tables = {key: _one_of_two(table) for key, table in tables.items()}
        adjusted = false_discovery_rate(tables)
        several = self.groups != (ALL,)
        placed = [
            _in_bin(table, self.bins[k], name if several else None)
            for (name, k), table in adjusted.items()
        ]
        meta = dict(next((table.meta for table in tables.values() if table.meta), {}))
        if tested := next(iter(adjusted.values())).meta.get("false_discovery"):
            meta["false_discovery"] = tested
        accelerations = self.accelerations.items()
        return stack_tables(placed, meta | {
            "bins": self.bins.to_value(u.mas).tolist(), "along": self.along,
            "covariance": {name: self._covariance(name) for name in self.groups},
            "acceleration": {name: asdict(found) for name, found in accelerations},
        })  # fmt: skip

    def _covariance(self, name):
        """Return the speeds of a group and their covariance for the meta."""
        (place, speed, covariance), beam = self.speeds[name], self.flow.beam
        known = np.flatnonzero(np.isfinite(speed))
        square = covariance[np.ix_(known, known)]
        return {
            "bins": known.tolist(), "distance": place[known] * beam * u.mas,
            "speed": speed[known] * beam * PM_UNIT,
            "covariance": square * (beam * PM_UNIT) ** 2,
        }  # fmt: skip

    @property
    def main(self) -> QTable:
        """The rows of `streams` that are ``main`` in their bin."""
        return self.streams[self.streams["main"]]


def _in_bin(table, limits, group):
    """Return a table of streams with the limits of their bin in front."""
    low, high = limits.to_value(u.mas)
    values = {"r_min": low, "r_max": high, "r_mid": (low + high) / 2}
    columns = {name: np.full(len(table), r) * u.mas for name, r in values.items()}
    if group is not None:
        columns["scale_group"] = np.full(len(table), group)
    columns |= dict(table.items()) | {"main": _main(table)}
    return describe(QTable(columns, meta=table.meta), "profile")


def _one_of_two(table):
    """Return a table that says of a lone stream that the whole flow has two."""
    moving = np.flatnonzero(table["kind"] == "moving")
    if len(moving) != 1:
        return table
    said = table["caution"].tolist()
    said[moving[0]] = "; ".join(filter(None, (said[moving[0]], ONE_OF_TWO)))
    table = table.copy(copy_data=False)
    table["caution"] = said
    return describe(table, "streams")


def _main(table):
    """Return which row, if any, represents the bin."""
    chosen = np.zeros(len(table), dtype=bool)
    share = np.nan_to_num(np.asarray(table["share"], dtype=float))
    for wanted in ("moving", "not confirmed", "not significant"):
        moves = (table["kind"] == wanted) & (table["pm"] > table["pm_err"])
        moves &= np.isfinite(table["p_global"])
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
    features = decomposed.follow(progress_bar=progress_bar)
    generator, seed = seeded(rng)
    refuse_other_method("spectrum", scc.to_dict())
    limits, meta = bins.to_value(u.mas), meta_of(scc, n_trials, seed)
    searches, results, fits, speeds, both = {}, {}, {}, {}, None
    # The matrix products are small: threads would wait for one another.
    with threadpool_limits(1):
        flow, flows = _flows(scc, decomposed, groups, n_trials, generator)
        with progress(len(flows) * len(bins), "Searching", show=progress_bar) as done:
            for name, part in flows.items():
                searches[name] = []
                for search in _search_bins(
                    part, limits, features, scc, n_trials, generator, name == ALL
                ):
                    searches[name].append(search)
                    done(1)
        if groups is not None:
            # Bins and groups have fewer patterns to tell two streams from one.
            both = _search(flow, features, scc, n_trials, generator.spawn(1)[0]).pair
        sign, angle = _sign_of(searches, bins), flow_direction(decomposed, flow.frame)
        places = [place_of(flow.between(low, high)) for low, high in limits]
        for name, found in searches.items():
            fits[name] = tuple(_fit_again(one, sign) for one in found)
            speeds[name] = speeds_in_parts(fits[name], places)
            results[name] = tuple(
                one and SCCResult(decomposed, one, angle, [], meta) for one in found
            )
    return Profile(bins, results, fits, speeds, flow, both)


def _flows(scc, decomposed, groups, n_trials, rng):
    """Return the flow along its direction and lines, and those of groups of scales."""
    cube, flow, numbers = decomposed.cube, scc.flow(decomposed), {}
    if groups is not None:
        numbers = {k: scale_numbers(cube, scales) for k, scales in groups.items()}
    if len(flow.grids) > 1:
        # Bins need one direction, that of the whole flow.
        flow = _search(flow, decomposed.features, scc, n_trials, rng).flow
    else:
        every = sorted(set().union(*numbers.values()))
        flow = flow.along(scales=every) if every else flow
        flow = fit_along_lines(flow).flow
    return flow, flows_by_scale(flow, numbers) if numbers else {ALL: flow}


def _sign_of(searches, bins):
    """Return the sign of the speed of the bin in which motion is clearest."""
    seen = [one for found in searches.values() for one in found if one is not None]
    if not seen:
        raise ValueError(
            f"nothing is seen in the bins, {bins.min():g} to {bins.max():g} from the "
            "core: choose others"
        )
    return max(seen, key=lambda search: search.test.z.max()).sign


def _search(flow, features, scc, n_trials, rng, inside=None):
    """Return a search whose streams have the speeds of Gaussians."""
    # Their covariance is known, as that of a mean of the spectrum is not.
    return find_streams(
        flow, features, scc, n_trials=n_trials, whole=False, inside=inside, rng=rng
    )


def _search_bins(flow, limits, features, scc, n_trials, generator, tracked):
    """Yield the search of each bin, or None; groups of scales have no features."""
    distance = distances_along(flow, features.places)
    seeds = generator.spawn(len(limits))
    if tracked:
        # Bins are too small to tell which features may be seen by chance.
        whole = find_streams(
            flow, features, scc, n_trials=n_trials, rng=generator.spawn(1)[0]
        )
        features = whole.features
    for (low, high), rng in zip(limits, seeds, strict=True):
        part, search = flow.between(low, high), None
        if has_flow(part):
            inside = tracked & (distance >= low) & (distance < high)
            search = _search(part, features, scc, n_trials, rng, inside)
        yield search


def _fit_again(search, sign):
    """Return the fit of one stream to a bin, None if its speed is not known."""
    if search is None:
        return None
    fit = search.fit
    same = fit is not None and len(fit.mean) == 1 and fit.mean[0] * sign > 0
    part = fit_part(
        search.flow, sign=sign, diagram=search.diagram, fit=fit if same else None
    )
    if part.fit is None:
        return None
    speed = part.fit.mean[0]
    error = fit.mean_err[0] if same else part.errors()[0][0]
    # The table has another mean of the spectrum then, or does not confirm it.
    known = error < abs(speed) and search.tested(speed * search.beam)
    return part if known else None


def write_profile(profile, streams, directory, **settings):
    """
    Write the table and the figures of a profile into a folder that exists.

    ``streams`` are those of the profile, with or without units of c; ``settings`` are
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
    ['profile.ecsv', 'citations.bib', 'profile.png', 'position_angles.png']
    """
    tables, cube = {"profile": streams}, profile.flow.cube
    _, paths = write_tables(tables, directory, streams.meta, cube, **settings)
    result = next(one for found in profile.results.values() for one in found if one)
    angles = angles_by_scale(profile, result)
    # Emission in the bins may be of no SSP.
    figures = ["profile"] + ["position_angles"] * any(map(len, angles.values()))

    # What is drawn is the acceleration that is printed.
    lines = {
        name.replace(ALL, ""): [found.line]
        for name, found in profile.accelerations.items()
        if np.isfinite(found.p_value)
    }
    fitted = _spectrum_speeds(profile)

    def draw(name):
        if name == "position_angles":
            return speeds.plot_position_angles(angles)
        return speeds.plot_profile(
            streams, line=_line_of(result, profile.bins.max()), fits=lines, cube=cube,
            others=fitted if lines else (), beta_per_pm=beta_per_pm(streams),
        )  # fmt: skip

    files = style.figure_files(figures, draw)
    write_files(files, Path(directory))
    return paths + [Path(directory, name) for name in files]


def angles_by_scale(profile, result):
    """
    Return the position angles of SSPs in the bins, by groups of scales.

    Parameters
    ----------
    profile : `Profile`
        Without groups, the scales of its speeds are divided into fine and coarse ones.
    result : `~astro_scc.measurement.SCCResult`
        Of any bin.

    Returns
    -------
    dict of `~astropy.units.Quantity`
        Of the groups that have any.
    """
    decomposed, jet = result.decomposed, result.position_angle.to_value(u.deg)
    offsets = ssp_offsets(decomposed.ssps, decomposed.cube, centroid=True)
    low, high = profile.bins.min().value, profile.bins.max().value
    r = distances_along(profile.flow, np.stack(offsets, axis=1))
    inside = decomposed.select & (r >= low) & (r < high)
    # Angles within half a turn of the jet's.
    angle = (np.degrees(np.arctan2(*offsets)) - jet + 180) % 360 - 180 + jet
    scale = decomposed.ssps.scale
    if profile.groups == (ALL,):
        groups = halves(np.intersect1d(scale[inside], profile.flow.planes[0].scales))
    else:
        groups = {
            name: next((fit.flow.planes[0].scales for fit in fits if fit), ())
            for name, fits in profile.fits.items()
        }
    angles = {}
    for name, scales in groups.items():
        label = f"scales {name}" if "," in name else f"scale {name}"
        angles[label] = angle[inside & np.isin(scale, scales)] * u.deg
    return {name: each for name, each in angles.items() if len(each)}


def _line_of(result, length):
    """Return the line along which the jet is drawn."""
    if isinstance(result.frame, RidgeLine):
        return result.frame
    angle, s = result.position_angle, u.Quantity([0 * u.mas, length])
    return RidgeLine(s * np.sin(angle), s * np.cos(angle))


def _spectrum_speeds(profile):
    """Return the speeds that a line is fitted to, if those of the points are others."""
    if profile.groups != (ALL,):
        return []
    known = profile._covariance(ALL)
    error = np.sqrt(np.diag(known["covariance"]))
    return [("speeds of the spectrum", known["distance"], known["speed"], error)]
