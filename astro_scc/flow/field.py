# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speeds in cells of distance and place across the flow."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.table import QTable
from astropy.wcs import WCS

from astro_scc.kinematics import RidgeLine
from astro_scc.measurement import SCCResult
from astro_scc.quantities import check_range, named, random_generator
from astro_scc.settings import require
from astro_scc.streams.decomposed import find_motion, fit_part, has_flow
from astro_scc.units import PM_UNIT

#: Length of a cell along the flow in beams, and number across it, if none are given.
LENGTH, ACROSS = 2.0, 3
#: Columns of the table that are images of the FITS file.
IMAGES = {"SPEED": "pm_parallel", "ERROR": "pm_parallel_err", "P_FDR": "p_fdr"}


@dataclass(frozen=True, eq=False, repr=False)
class FlowField:
    """
    Speeds in cells of distance and place across the flow.

    Attributes
    ----------
    table : `~astropy.table.QTable`
        A row for each cell: ``r_min``, ``r_max``; ``offset_min``, ``offset_max``,
        across the flow, positive to larger position angles, or, of radial flows, the
        position angles themselves;
        ``pm_parallel`` with ``pm_parallel_err``; ``p_global`` and, adjusted for all
        cells, ``p_fdr``.  What is unknown is NaN.
    along, across : `~astropy.units.Quantity`
        Edges of the cells; ``to_fits`` needs even ones.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> from astro_scc.flow import FlowField
    >>> table = QTable({"pm_parallel": [1.0], "pm_parallel_err": [0.1]},
    ...                units=[u.mas / u.yr] * 2)
    >>> field = FlowField(table, [0, 5] * u.mas, [-1, 1] * u.mas)
    >>> len(field.table)
    1
    """

    table: QTable
    along: u.Quantity
    across: u.Quantity

    def to_fits(self) -> fits.HDUList:
        """
        Return the cells, of even edges, as images with a WCS of distance and offset.

        Returns
        -------
        `~astropy.io.fits.HDUList`
            ``SPEED``, ``ERROR`` and ``P_FDR``.

        Raises
        ------
        ValueError
            If the cells are not of one size.
        """
        wcs = WCS(naxis=2)
        wcs.wcs.ctype = ["DISTANCE", "OFFSET"]
        wcs.wcs.crpix = [0.5, 0.5]
        for k, name in enumerate(("along", "across")):
            edges = getattr(self, name)
            step = np.diff(edges.value)
            if not np.allclose(step, step[0], rtol=1e-6):
                raise ValueError(
                    f"images need cells of one size: give even edges {name}"
                )
            wcs.wcs.cunit[k] = edges.unit.to_string("fits")
            wcs.wcs.crval[k], wcs.wcs.cdelt[k] = edges.value[0], step[0]
        shape, hdus = (len(self.across) - 1, len(self.along) - 1), []
        for name, column in IMAGES.items():
            kind = fits.ImageHDU if hdus else fits.PrimaryHDU
            values = u.Quantity(self.table[column])
            hdu = kind(values.value.reshape(shape), wcs.to_header())
            hdu.name, hdu.header["BUNIT"] = name, values.unit.to_string("fits")
            hdus.append(hdu)
        return fits.HDUList(hdus)


def measure_field(
    result: SCCResult, *, along: u.Quantity | str | None = None,
    across: u.Quantity | None = None, n_trials: int = 200,
    rng: np.random.Generator | int | None = None,
) -> FlowField:  # fmt: skip
    """
    Measure speeds in cells of distance and place across the flow.

    One stream is fitted in each cell, and motion is tested there.  The side of the
    counter-jet is left out, and cells have no speed where nothing can be followed for
    half a beam, as beside an edge of the images.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    along : `~astropy.units.Quantity` or str, optional
        Edges of the cells: increasing distances, by default every two beams.
        `FlowField.to_fits` needs even ones, also across.
    across : `~astropy.units.Quantity`, optional
        Increasing offsets or, of radial and expanding flows, position angles; by
        default three cells over what is seen.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `FlowField`

    Raises
    ------
    ValueError
        If edges do not increase, or nothing is seen in any cell.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import measure_field
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    >>> result = scc(simulate_two_fluid(n_epochs=8, rng=1).cube, n_trials=100, rng=1)
    >>> field = measure_field(
    ...     result, along=[2, 10, 18] * u.mas, across=[-2, 0, 2] * u.mas, n_trials=20)
    >>> len(field.table), [hdu.name for hdu in field.to_fits()]
    (4, ['SPEED', 'ERROR', 'P_FDR'])
    """
    from scipy.stats import false_discovery_control

    n_trials = require("n_trials", n_trials)
    flow, (r, offset, unit) = result.flow, cell_coordinates(result.flow)
    seen = flow.planes[0].mask & ~flow.grids[0].counter
    along, across = _edges(along, across, r[seen], offset[seen], unit, flow.beam)
    rows, rngs = [], iter(random_generator(rng).spawn(len(along) * len(across)))
    for low, high in pairwise(across.value):
        for r_min, r_max in pairwise(along.value):
            ahead = offset - low
            if unit == u.deg:
                # Position angles are the same a turn later.
                ahead = ahead % 360
            inside = (r >= r_min) & (r < r_max) & (ahead >= 0) & (ahead < high - low)
            cell = flow.part(places=[(inside & ~flow.grids[0].counter) * 1.0])
            found = _measure_cell(cell, result, n_trials, next(rngs))
            rows.append((r_min, r_max, low, high, *found))
    names = ("r_min", "r_max", "offset_min", "offset_max", "pm_parallel",
             "pm_parallel_err", "p_global")  # fmt: skip
    units = [u.mas, u.mas, unit, unit, PM_UNIT, PM_UNIT]
    table = QTable(rows=rows, names=names, units=dict(zip(names, units, strict=False)))
    p = table["p_global"] = u.Quantity(table["p_global"]).value
    known = np.isfinite(p)
    if not known.any():
        raise ValueError("nothing is seen in any cell: choose other edges")
    table["p_fdr"] = np.full(len(p), np.nan)
    table["p_fdr"][known] = false_discovery_control(p[known])
    return FlowField(table, along, across)


def _edges(along, across, r, offset, unit, beam):
    """Return the edges of the cells, by default those of what is seen."""
    if along is None:
        step = LENGTH * beam
        first, last = np.floor(r.min() / step), np.ceil(r.max() / step)
        along = np.arange(first, last + 1) * step * u.mas
    if across is None:
        across = np.linspace(offset.min(), offset.max() + 1e-9, ACROSS + 1) * unit
    given = "increasing distances", "0.5 1.5 2.5 mas", 0, np.less, None
    along = named("along", check_range, along, *given).to(u.mas)
    across = u.Quantity(across).to(unit)
    if across.ndim != 1 or len(across) < 2 or not np.all(np.diff(across) > 0):
        raise ValueError(f"across = {across} must be two increasing offsets or more")
    return along, across


def _measure_cell(cell, result, n_trials, rng):
    """Return speed, error and p-value of a cell, or NaN."""
    if not has_flow(cell):
        return np.nan, np.nan, np.nan
    outward, fit = result.meta["settings"]["outward"], result.search.fit
    _, test = find_motion(cell, n_trials, rng, outward=outward)
    sign = 1.0 if fit is None else np.sign(fit.mean[0])
    part = fit_part(cell, sign=sign)
    if part.fit is None or not part.fit.amplitude[0] > 0:
        return np.nan, np.nan, test.p_global
    speed = part.fit.mean[0]
    (error,), *_ = part.errors(speed)
    return abs(speed) * cell.beam, error * cell.beam, test.p_global


def cell_coordinates(flow):
    """
    Return the coordinates of the points of a flow's grid.

    Parameters
    ----------
    flow : ``DecomposedFlow``

    Returns
    -------
    distance, offset : `~numpy.ndarray`, shape (n_along, n_across)
        The first in mas.
    unit : `~astropy.units.Unit`
        Of the offset: mas, or degrees of the position angle in radial flows.
    """
    grid, frame, beam = flow.grids[0], flow.frame, flow.beam
    shape, place = grid.x.shape, flow.cube.pixel_to_offset(grid.x, grid.y)
    distance = grid.distances * beam
    if isinstance(frame, RidgeLine):
        return distance, np.broadcast_to(grid.across * beam, shape), u.mas
    if np.isfinite(grid.angle):
        offset = np.tensordot(grid.axes[1], [p.to_value(u.mas) for p in place], 1)
        return distance, offset, u.mas
    place = zip(place, frame.origin, strict=True)
    east, north = ((p - origin).to_value(u.mas) for p, origin in place)
    # The last row, as a radial grid begins at the origin.  Angles do not jump at north.
    angle = np.degrees(np.unwrap(np.arctan2(east[-1], north[-1])))
    angle -= np.floor(angle.mean() / 360) * 360
    return np.hypot(east, north), np.broadcast_to(angle, shape), u.deg
