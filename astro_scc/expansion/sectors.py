# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stack a shell in expansion rate, as a whole or in sectors."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import ExpansionFrame
from astro_scc.measurement import MatchedEpochs, false_discovery_rate
from astro_scc.measurement.tables import stack_tables
from astro_scc.scc import StackedCrossCorrelation

#: Columns of the components that the table of sectors keeps.
KEPT = ("kind", "coefficient", "z_score", "p_local", "p_global", "p_fdr", "n_ssp",
        "n_pairs", "n_features", "caution")  # fmt: skip


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
    scc: StackedCrossCorrelation, matched: MatchedEpochs, centre: u.Quantity,
    radius: u.Quantity, *, sectors: int | u.Quantity = 1,
    distance: u.Quantity | None = None, n_trials: int = 1000,
    rng: np.random.Generator | int | None = None,
) -> QTable:  # fmt: skip
    """
    Stack a shell in rates of expansion from, and rotation about, a centre.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        The settings; ``max_speed`` is the speed at the radius.
    matched : `~astro_scc.measurement.MatchedEpochs`
    centre : `~astropy.units.Quantity`, shape (2,)
        (east, north) from the reference pixel, see `fit_shell`.
    radius : `~astropy.units.Quantity`
        Radius of the shell, for which speeds are given.
    sectors : int or `~astropy.units.Quantity`, optional
        Number of equal sectors of azimuth from north through east, or the
        limits of sectors.
    distance : `~astropy.units.Quantity`, optional
        Distance of the object, for speeds in km/s at the radius.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `~astropy.table.QTable`
        A row for each sector and velocity that was tested: ``pa_min``,
        ``pa_max``, ``rate`` and ``rotation`` in per cent per year with
        errors, ``kind``, p-values (``p_fdr`` adjusted for all sectors),
        ``n_features``, ``note`` and, with a distance, ``speed`` and
        ``speed_err``.

    Raises
    ------
    ValueError
        If there is no sector, or no SSP in any.

    Notes
    -----
    Without a beam, the resolution of an SSP is twice the size of its scale,
    so the errors of displacements grow with the scale.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.expansion import measure_expansion
    >>> from astro_scc.simulation import simulate_shell
    >>> shell = simulate_shell(n_epochs=6, interval=8 * u.yr, n_clumps=0, n_knots=25,
    ...                        radius=50 * u.arcsec, size=160, rng=4)
    >>> scc = StackedCrossCorrelation(
    ...     scales=[1], max_speed=150 * u.mas / u.yr, min_error_beams=0.1, detection=7,
    ...     segmentation=5)
    >>> matched = scc.match(shell.cube)
    >>> table = measure_expansion(
    ...     scc, matched, shell.centre, shell.radius, n_trials=119, rng=1)
    >>> table["rate"].round(2)[0]
    <Quantity 0.11 % / yr>
    """
    limits = _limits(sectors)
    frame = ExpansionFrame(centre, radius)
    stacker = replace(scc, position_angle=frame)
    east, north = ssp_offsets(matched.ssps, matched.cube, centroid=True)
    x0, y0 = frame.centre.value
    azimuth = np.degrees(np.arctan2(east - x0, north - y0))
    tables = {}
    rngs = np.random.default_rng(rng).spawn(len(limits))
    for (low, high), own in zip(limits, rngs, strict=True):
        inside = (azimuth - low) % 360 < high - low
        part = replace(matched, select=matched.select & inside)
        if part.select.any():
            stacked = stacker.stack(part, n_trials=n_trials, rng=own)
            tables[low, high] = stacked.components
    if not tables:
        raise ValueError("no SSP lies in any sector: there is nothing to stack")
    rows = [
        _in_sector(table, low, high, frame)
        for (low, high), table in false_discovery_rate(tables).items()
    ]
    joined = stack_tables(rows, {"centre": frame.centre, "radius": frame.radius})
    if distance is not None:
        for name, of in (("speed", "rate"), ("speed_err", "rate_err")):
            joined[name] = expansion_speed(joined[of], frame.radius, distance)
        joined.meta["distance"] = u.Quantity(distance)
    return joined


def _limits(sectors):
    """Return the limits of each sector in azimuth, in degrees."""
    if isinstance(sectors, u.Quantity):
        edges = sectors.to_value(u.deg)
        if edges.ndim != 1 or len(edges) < 2 or not np.all(np.diff(edges) > 0):
            raise ValueError(f"the limits of sectors must increase, got {sectors}")
        if edges[-1] - edges[0] > 360 * (1 + 1e-12):
            raise ValueError("sectors must not overlap: they cover more than a turn")
    else:
        if int(sectors) != sectors or sectors < 1:
            raise ValueError(f"sectors must be a whole number above 0, got {sectors}")
        edges = np.linspace(0, 360, int(sectors) + 1)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _in_sector(table, low, high, frame):
    """Return the components of a sector as rates of expansion and rotation."""
    limits = {"pa_min": low, "pa_max": high}
    columns = {name: np.full(len(table), a) * u.deg for name, a in limits.items()}
    for name, of in (("rate", "pm_parallel"), ("rotation", "pm_transverse")):
        for end in ("", "_err"):
            columns[name + end] = frame.rate(table[of + end])
    return QTable(columns | {name: table[name] for name in KEPT})
