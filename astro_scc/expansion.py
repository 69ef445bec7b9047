# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Expansion: the centre of a shell, its rates, and its stack in sectors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import itemgetter

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.epochs.align import alignment_errors
from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import ExpansionFrame, SkyFrame
from astro_scc.measurement import false_discovery_rate
from astro_scc.measurement.tables import stack_tables
from astro_scc.paper.method import matched_displacements
from astro_scc.patterns import DecomposedEpochs, centroids_inside
from astro_scc.quantities import Seed, check_integer, named, random_generator
from astro_scc.scc import StackedCrossCorrelation

__all__ = ["expansion_speed", "fit_shell", "measure_expansion"]

#: Most kinds of one scale, by signal-to-noise ratio, and velocity samples per kind.
PARTS, ENOUGH = 4, 100
#: Rates that are tried first, for expansion and for contraction, and the width of their
#: kernel, in standard errors of a velocity sample.
TRIED, WIDTH = 60, 4.0
#: Most steps of the fit, and the step, in standard errors, that is its last one.
STEPS, SMALL = 100, 0.02
#: Bounds of the scatter, in standard errors of a velocity sample, and of the share of
#: samples that expand.
SCATTER, SHARE = (0.02, 1.0), (0.02, 0.98)
#: Some samples stand still beside the expansion if that adds so much to the mean log
#: likelihood of each: 0.08 to 1.6 with stars in front.  Of 30 simulated shells without
#: any, two of the slowest reach it, and their rates change by half an error.
STILL = 0.05
#: Columns of the streams that the table of sectors keeps.
KEPT = ("kind", "share", "p_local", "p_global", "p_fdr", "n_features", "caution")


@dataclass(frozen=True, eq=False)
class ShellFit:
    """Expansion rates of groups of SSPs from one centre."""

    groups: tuple[str, ...]
    rate: u.Quantity
    rate_err: u.Quantity
    centre: u.Quantity
    centre_err: u.Quantity
    radius: u.Quantity
    covariance: np.ndarray


def fit_shell(
    scc: StackedCrossCorrelation,
    matched: DecomposedEpochs | Mapping[str, DecomposedEpochs], *,
    centre: u.Quantity | None = None,
) -> ShellFit:  # fmt: skip
    r"""
    Fit the centre of a shell and its expansion rates.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        The settings; its velocity axes are not used.
    matched : `~astro_scc.patterns.DecomposedEpochs` or dict of it
        In a dict, each value is a group that has a rate of its own, with the key
        as its name; all must have the same dates.
    centre : `~astropy.units.Quantity`, shape (2,), optional
        (east, north) from the reference pixel, if it is known.

    Returns
    -------
    ``ShellFit``
        ``groups``, their names; ``rate`` of each in per cent per year and
        ``centre``, (east, north) from the reference pixel, both with ``_err``;
        ``radius``, the mean distance of the SSPs from the centre; and
        ``covariance`` of the rates, per year, and the centre, in mas.

    Raises
    ------
    ValueError
        If a group has fewer than ten velocity samples, or if groups have
        different dates.

    Notes
    -----
    Many matches are due to chance, so the model is a mixture: a velocity sample
    either moves with its group, with a scatter that is fitted for each scale
    and quarter of the signal-to-noise ratios, or falls anywhere in the area
    that was searched.  Where that is clearly more likely, as with stars in front of the
    shell, some samples stand still, with the same scatter.  The fit starts at the rates
    at which a wide kernel has its largest sum.  Errors combine a jackknife over 24
    sectors of azimuth, each with all epochs of its features, and the errors of the
    alignment (see ``alignment_errors`` of the epochs): epochs that drift by
    :math:`\delta` in the time T move the centre by :math:`\delta / (e\, T)`.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.expansion import fit_shell
    >>> from astro_scc.simulation import simulate_shell
    >>> shell = simulate_shell(n_epochs=3, interval=10 * u.yr, n_knots=60, rng=1)
    >>> scc = StackedCrossCorrelation(scales=[1.5], max_speed=300 * u.mas / u.yr)
    >>> fit = fit_shell(scc, scc.match(shell.cube))
    >>> bool(abs(fit.rate[0] - 0.11 * u.percent / u.yr) < 0.02 * u.percent / u.yr)
    True
    """
    parts = dict(matched) if hasattr(matched, "keys") else {"all": matched}
    cube, *others = (part.cube for part in parts.values())
    dates = cube.times.mjd
    if not all(np.array_equal(dates, other.times.mjd) for other in others):
        raise ValueError("the matches of a shell must be of the same dates")
    _, pairs, limit, _ = scc.plan(cube)
    samples, first, weight = _samples_of(parts, pairs, limit, scc.min_error_beams)
    x = samples.x
    given = None if centre is None else u.Quantity(centre).to_value(u.mas)
    max_rate = limit / np.median(np.hypot(*(x - x.mean(axis=0)).T))
    start = start_of(samples, weight, max_rate=max_rate, centre=given)
    area = (2 * limit * samples.interval) ** 2
    place, covariance, response, *_ = fit_mixture(
        samples, start, area, fixed=given is not None
    )
    errors = alignment_errors(cube, scc.alignment_error)
    if errors.any():
        years = cube.years.to_value(u.yr)
        more = _of_alignment(response, first, samples.interval, years, errors)
        covariance = covariance + more
    error = np.sqrt(np.diag(covariance))
    per_year = 100 * u.percent / u.yr
    return ShellFit(
        groups=tuple(parts), rate=place[:-2] * per_year,
        rate_err=error[:-2] * per_year, centre=place[-2:] * u.mas,
        centre_err=error[-2:] * u.mas, covariance=covariance,
        radius=float(np.mean(np.hypot(*(x - place[-2:]).T))) * u.mas,
    )  # fmt: skip


#: A velocity sample: ``x`` is the position at the mean date and ``v`` the velocity;
#: ``error`` is the standard error of the displacement over the ``interval``, an upper
#: limit for the scatter.  Samples with the same number of ``group`` share a rate, those
#: with the same number of ``kind`` a scatter, from 0.
SAMPLE = np.dtype([
    ("x", float, 2), ("v", float, 2), ("interval", float), ("error", float),
    ("group", int), ("kind", int),
])  # fmt: skip


def _samples_of(parts, pairs, limit, least):
    """Return velocity samples, and the earlier date and the weight of each."""
    columns = []
    for k, (name, part) in enumerate(parts.items()):
        # Use east and north, as radial axes need the centre.
        s = matched_displacements(part, SkyFrame(), least)
        motion = np.stack([s.d1, s.d2], axis=1)
        position = np.stack(ssp_offsets(part.ssps, part.cube), axis=1)[s.ssp]
        years = part.cube.years.to_value(u.yr)
        interval = years[s.target] - years[s.reference]
        # Those of pairs of dates, in any direction, that are slow enough.
        paired = np.zeros((len(years),) * 2, dtype=bool)
        paired[pairs.first, pairs.second] = paired[pairs.second, pairs.first] = True
        use = np.all(np.abs(motion) <= limit * np.abs(interval)[:, None], axis=1)
        use &= paired[s.reference, s.target]
        n = np.count_nonzero(use)
        of_each = (
            position + 0.5 * motion, motion / interval[:, None], np.abs(interval),
            np.sqrt(s.s1 * s.s2), np.full(len(s), k), part.ssps.scale[s.ssp],
            part.ssps.snr[s.ssp], np.minimum(s.reference, s.target), s.weight,
        )  # fmt: skip
        columns.append([values[use] for values in of_each])
        if n < 10:
            raise ValueError(
                f"an expansion needs 10 velocity samples of each group or more, "
                f"{name} has {n}: choose more SSPs or other scales"
            )
    joined = [np.concatenate(column) for column in zip(*columns, strict=True)]
    columns = [*joined[:5], _kinds(*joined[4:7])]
    return np.rec.fromarrays(columns, dtype=SAMPLE), *joined[7:]


def _kinds(group, scale, snr):
    """Number the kinds: samples of one group, scale and range of signal-to-noise."""
    kind = np.zeros(len(group), dtype=int)
    n = 0
    for g, j in np.unique(np.stack([group, scale]), axis=1).T:
        same = np.flatnonzero((group == g) & (scale == j))
        parts = min(PARTS, max(len(same) // ENOUGH, 1))
        limits = np.quantile(snr[same], np.arange(1, parts) / parts)
        kind[same] = n + np.searchsorted(limits, snr[same], side="right")
        n += parts
    return np.unique(kind, return_inverse=True)[1]


def _of_alignment(response, first, interval, years, errors):
    """Return the covariance of a fit that is due to shifts of whole epochs."""
    changes = []
    second = np.abs(np.subtract.outer(years[first] + interval, years)).argmin(axis=1)
    for k in np.flatnonzero(errors.any(axis=1)):
        moved = ((second == k) * 1.0 - (first == k)) / interval
        changes.append(np.einsum("i,iaj->aj", moved, response) * errors[k][:, None])
    return np.einsum("kai,kaj->ij", changes, changes)


def start_of(samples, weight, *, max_rate, centre=None):
    """
    Return rates and a centre from which to fit, shape (n_groups + 2,).

    The centre is the weighted mean position, or the one that is given, and each rate
    the one of many at which a wide kernel about it has the largest weighted sum.
    """
    x, v, group = samples.x, samples.v, samples.group
    start = np.average(x, axis=0, weights=weight) if centre is None else centre
    width = WIDTH * samples.error / samples.interval
    tried, rates = np.linspace(-max_rate, max_rate, 2 * TRIED + 1), []
    for g in range(int(group.max()) + 1):
        use = group == g
        rest = (v[use] - rate * (x[use] - start) for rate in tried)
        squares = ((r**2).sum(axis=1) / width[use] ** 2 for r in rest)
        sums = [weight[use] @ np.exp(-0.5 * square) for square in squares]
        rates.append(tried[int(np.argmax(sums))])
    return np.array([*rates, *start])


def fit_mixture(samples, start, area, *, fixed=False, n_sectors=24):
    r"""
    Fit rates and centre of the most likely mixture of expansion and chance.

    A velocity sample i, displaced by :math:`d_i` over the interval :math:`t_i`,
    either takes part in the expansion, or falls anywhere in the area
    :math:`A_i` that was searched:

    .. math:: p_i = \frac{f_k}{2\pi\sigma_k^2} \exp\left(-\frac{|d_i - e_g t_i\,
              (x_i - c)|^2}{2\,\sigma_k^2}\right) + \frac{1 - f_k}{A_i}

    The scatter :math:`\sigma_k` and the share :math:`f_k` of each kind are fitted with
    the rates and the centre; where `STILL` is exceeded, so is the share of what stands
    still, a third term with the same scatter.  Expectation maximisation (Dempster,
    Laird & Rubin 1977, J. R. Stat. Soc. B 39, 1) begins at ``start``; with ``fixed``
    the centre is kept.
    Errors are those of a jackknife over ``n_sectors`` of azimuth, each with all epochs
    of its features.

    Returns the place, that is, the rates and the centre; its covariance; its
    derivatives by each velocity, shape (n, 2, n_groups + 2); and of each kind the
    scatter and both shares, of what expands and of what stands still.
    """
    n_groups = len(start) - 2
    kinds = range(int(samples.kind.max()) + 1)
    widest = np.array([np.median(samples.error[samples.kind == k]) for k in kinds])
    share = np.full((2, len(widest)), 0.4)
    beside = [
        _climb(samples, one, 0.5 * widest, share, area, widest, fixed)
        for one in _other_starts(samples, start)
    ]
    found = max(beside, key=itemgetter(-1))
    share = np.multiply.outer((0.5, 0.0), np.ones(len(widest)))
    without = _climb(samples, start, 0.5 * widest, share, area, widest, fixed)
    if found[-1] - without[-1] < STILL * len(samples):
        found = without
    place, scatter, share, inverse, p, _ = found
    turn = np.arctan2(*(samples.x - place[-2:]).T) + np.pi
    part_of = np.floor(turn / (2 * np.pi) * n_sectors) % n_sectors
    others = []
    for k in np.unique(part_of):
        keep = part_of != k
        if np.all(np.bincount(samples.group[keep], minlength=n_groups) > 3):
            begin = samples[keep], place, scatter, share, area[keep]
            others.append(_climb(*begin, widest, fixed)[0])
    covariance, n = np.full((len(place),) * 2, np.inf), len(others)
    # Of fewer parts, the jackknife says nothing.
    if n > 3:
        apart = others - np.mean(others, axis=0)
        covariance = (n - 1) / n * apart.T @ apart
    weight = p * samples.interval**2 / scatter[samples.kind] ** 2
    response = weight[:, None, None] * _design(samples, place, fixed) @ inverse
    return place, covariance, response, scatter, share


def _other_starts(samples, start, quantiles=(0.1, 0.3, 0.7, 0.9)):
    """Return starts that what stands still does not hold at a rate of zero."""
    away, starts = samples.x - start[-2:], [start]
    rate = (samples.v * away).sum(axis=1) / (away**2).sum(axis=1)
    of_group = [rate[samples.group == g] for g in range(len(start) - 2)]
    for q in quantiles:
        starts.append(np.array([*(np.quantile(r, q) for r in of_group), *start[-2:]]))
    return starts


def _climb(samples, place, scatter, share, area, widest, fixed):
    """Return the maximum near ``place``, and what its last step was computed from."""
    kind, square_interval = samples.kind, samples.interval**2
    n = len(widest)
    number = np.maximum(np.bincount(kind, minlength=n), 1)
    moved = (samples.v**2).sum(axis=1) * square_interval
    for _ in range(STEPS):
        rest = samples.v - place[samples.group][:, None] * (samples.x - place[-2:])
        square = (rest**2).sum(axis=1) * square_interval
        width, (f, g) = scatter[kind], share[:, kind]
        norm = 2 * np.pi * width**2
        near = f * np.exp(-0.5 * square / width**2) / norm
        stay = g * np.exp(-0.5 * moved / width**2) / norm
        density = near + stay + (1 - f - g) / area
        p, q = near / density, stay / density
        total, still = np.bincount(kind, p, n), np.bincount(kind, q, n)
        mean = np.bincount(kind, p * square + q * moved, n)
        mean /= np.maximum(2 * (total + still), 1e-12)
        scatter = np.clip(np.sqrt(mean), *np.multiply.outer(SCATTER, widest))
        expand = np.clip(total / number, *SHARE)
        share = np.array([expand, np.minimum(still / number, SHARE[1] - expand)])
        weight = p * square_interval / scatter[kind] ** 2
        step, inverse = _step(samples, place, rest, weight, fixed)
        place = place + step
        if np.all(np.abs(step) <= SMALL * np.sqrt(np.abs(np.diag(inverse)))):
            break
    return place, scatter, share, inverse, p, np.log(density).sum()


def _design(samples, place, fixed):
    """Return the derivatives of the velocities by the rates and the centre."""
    design = np.zeros((len(samples.x), 2, len(place)))
    design[np.arange(len(samples.x)), :, samples.group] = samples.x - place[-2:]
    if not fixed:
        design[:, 0, -2] = design[:, 1, -1] = -place[samples.group]
    return design


def _step(samples, place, rest, weight, fixed):
    """Return a step of weighted least squares, and the inverse of the normal matrix."""
    design = _design(samples, place, fixed)
    weighted = weight[:, None, None] * design
    normal = np.einsum("iaj,iak->jk", weighted, design, optimize=True)
    # Rates and lengths need one scale.  What is fixed stays as it is.
    diagonal = np.diag(normal)
    unit = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1)), 0)
    unit = np.outer(unit, unit)
    inverse = unit * np.linalg.pinv(normal * unit, hermitian=True)
    return inverse @ np.einsum("iaj,ia->j", weighted, rest), inverse


# -- the stack ---------------------------------------------------------------------


def expansion_speed(
    rate: u.Quantity, radius: u.Quantity, distance: u.Quantity
) -> u.Quantity:
    """
    Return the speed of expansion across the line of sight.

    Parameters
    ----------
    rate : `~astropy.units.Quantity`
        Expansion rate, for example in per cent per year.
    radius : `~astropy.units.Quantity`
        Angle from the centre.
    distance : `~astropy.units.Quantity`

    Returns
    -------
    `~astropy.units.Quantity`
        In km/s.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.expansion import expansion_speed
    >>> expansion_speed(0.11 * u.percent / u.yr, 100 * u.arcsec, 3.4 * u.kpc).round(-1)
    <Quantity 1770. km / s>
    """
    length = u.Quantity(radius).to_value(u.rad) * u.Quantity(distance)
    return (u.Quantity(rate) * length).to(u.km / u.s)


def measure_expansion(
    scc: StackedCrossCorrelation, decomposed: DecomposedEpochs, centre: u.Quantity,
    radius: u.Quantity, *, sectors: int = 1, n_trials: int = 1000,
    rng: Seed | None = None,
) -> QTable:  # fmt: skip
    """
    Measure rates of expansion from, and rotation about, a centre.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        The settings; ``max_speed`` is the speed at the radius.
    decomposed : `~astro_scc.patterns.DecomposedEpochs`
    centre : `~astropy.units.Quantity`, shape (2,)
        (east, north) from the reference pixel, see `fit_shell`.
    radius : `~astropy.units.Quantity`
        Radius of the shell, for which speeds are given.
    sectors : int, optional
        Number of equal sectors of azimuth from north through east.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `~astropy.table.QTable`
        A row for each sector and velocity that was tested: ``pa_min``,
        ``pa_max``, ``rate`` and ``rotation`` in per cent per year with
        errors, ``kind``, p-values (``p_fdr`` adjusted for all sectors),
        ``n_features`` and ``caution``.

    Raises
    ------
    ValueError
        If there is no sector, or no SSP in any.

    Notes
    -----
    The rate is that of the velocity spectrum along the logarithm of the radius, whose
    errors hold a quarter of it.  It needs patterns that move by their own size over the
    whole time: slower expansions come out too fast, and are measured by `fit_shell`.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.expansion import measure_expansion
    >>> from astro_scc.simulation import simulate_shell
    >>> shell = simulate_shell(n_epochs=7, interval=4 * u.yr, n_clumps=0, n_knots=25,
    ...                        knot_rate=0.8 * u.percent / u.yr,
    ...                        radius=50 * u.arcsec, size=160, rng=4)
    >>> scc = StackedCrossCorrelation(scales=[1], max_speed=900 * u.mas / u.yr,
    ...                               detection=7, segmentation=5)
    >>> decomposed = scc.decompose(shell.cube)
    >>> table = measure_expansion(
    ...     scc, decomposed, shell.centre, shell.radius, n_trials=119, rng=1)
    >>> table["rate"].round(1)[0]
    <Quantity 0.7 % / yr>
    """
    sectors = named("sectors", check_integer, sectors, 1)
    edges = np.linspace(0, 360, sectors + 1)
    frame = ExpansionFrame(centre, radius)
    stacker = replace(scc, position_angle=frame)
    cube, (x0, y0) = decomposed.cube, frame.centre.value
    east, north = (offset.to_value(u.mas) for offset in cube.offsets())
    azimuth = np.degrees(np.arctan2(east - x0, north - y0))
    everywhere = np.ones(azimuth.shape, dtype=bool)
    whole = everywhere if decomposed.region is None else decomposed.region
    tables = {}
    rngs = random_generator(rng).spawn(sectors)
    for (low, high), of_sector in zip(pairwise(edges), rngs, strict=True):
        sector = whole & ((azimuth - low) % 360 < high - low)
        select = decomposed.select & centroids_inside(decomposed.ssps, cube, sector)
        if select.any():
            part = replace(decomposed, select=select, region=sector)
            found = stacker.measure(part, n_trials=n_trials, rng=of_sector)
            tables[low, high] = found.streams
    if not tables:
        raise ValueError("no SSP lies in any sector: there is nothing to measure")
    rows = []
    for limits, table in false_discovery_rate(tables).items():
        pairs = zip(("pa_min", "pa_max"), limits, strict=True)
        columns = {name: np.full(len(table), limit) * u.deg for name, limit in pairs}
        for name, of in (("rate", "pm_parallel"), ("rotation", "pm_transverse")):
            for end in ("", "_err"):
                columns[name + end] = frame.rate(table[of + end])
        rows.append(QTable(columns | {name: table[name] for name in KEPT}))
    return stack_tables(rows, {"centre": frame.centre, "radius": frame.radius})
