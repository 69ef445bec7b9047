# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The ridge line of a jet, with distances along it, offsets from it, and axes."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.table import QTable
from numpy.typing import ArrayLike

from astro_scc.kinematics.frames import axes_along

#: Steps of the curve between two points of the line.
FINE = 8


@dataclass(frozen=True, eq=False, repr=False)
class RidgeLine:
    """
    The line along which a jet flows, and the frame along and across it.

    The distance s is measured along the line from its first point, which is
    the core.  The offset n is positive towards larger position angles of the
    local direction, like the transverse axis of `PositionAngleFrame`.  Beyond
    its ends the line continues straight.

    Parameters
    ----------
    east, north : `~astropy.units.Quantity`, shape (n,)
        Points in the order of the flow, offsets from the reference pixel.
    error : `~astropy.units.Quantity`, shape (n,), optional
        Standard errors of the points across the line.
    meta : dict, optional
        Facts for the meta of a table.

    Raises
    ------
    ValueError
        If there are fewer than two points, or two neighbours coincide.
    `~astropy.units.UnitConversionError`
        If the points are not angles.

    Examples
    --------
    A quarter of a circle with a radius of 10 mas that begins to the west and
    ends to the north:

    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.kinematics import RidgeLine
    >>> angle = np.linspace(0, np.pi / 2, 50)
    >>> line = RidgeLine(-10 * np.sin(angle) * u.mas, 10 * (1 - np.cos(angle)) * u.mas)
    >>> line.length.round(2), line.position_angle([0, 15] * u.mas).round()
    (<Quantity 15.71 mas>, <Quantity [270., 356.] deg>)
    >>> s, n = line.coordinates(-11 * u.mas, 10 * u.mas)
    >>> s.round(2), n.round(2)
    (<Quantity 15.71 mas>, <Quantity -1. mas>)
    """

    east: u.Quantity
    north: u.Quantity
    error: u.Quantity | None = None
    meta: dict = field(default_factory=dict)

    axis_names = ("parallel", "transverse")
    #: Whether the axes are the same everywhere.
    uniform = False

    def __post_init__(self):
        east, north = (
            np.atleast_1d(u.Quantity(v)).to(u.mas) for v in (self.east, self.north)
        )
        if east.shape != north.shape or east.ndim != 1 or len(east) < 2:
            raise ValueError(
                "a ridge line needs two points or more, as many to the east as to the "
                f"north, got shapes {east.shape} and {north.shape}"
            )
        step = np.hypot(np.diff(east), np.diff(north)).value
        if not np.all(step > 0):
            raise ValueError("the points of a ridge line must be finite and differ")
        error = 0 * u.mas if self.error is None else u.Quantity(self.error).to(u.mas)
        error = np.broadcast_to(error, east.shape, subok=True)
        for name, value in (("east", east), ("north", north), ("error", error)):
            object.__setattr__(self, name, value)

    def __repr__(self):
        return (
            f"<RidgeLine: {len(self.east)} points, {self.length:.3g} long, "
            f"PA {self.position_angle(0 * u.mas):.0f} to "
            f"{self.position_angle(self.length):.0f}>"
        )

    @cached_property
    def _curve(self):
        """Return fine points (m, 2), their distances s (m,), in mas."""
        points = np.stack([self.east.value, self.north.value], axis=-1)
        s = lengths_of(points)
        if len(points) > 3:
            from scipy.interpolate import CubicSpline

            number = np.arange(len(s))
            fine = np.interp(np.arange(FINE * number[-1] + 1) / FINE, number, s)
            points = CubicSpline(s, points)(fine)
            s = lengths_of(points)
        return points, s

    @property
    def distances(self) -> u.Quantity:
        """Distance along the line of each of its points, from 0."""
        points, s = self._curve
        return s[:: FINE if len(self.east) > 3 else 1] * u.mas

    @property
    def length(self) -> u.Quantity:
        """Length of the line."""
        return self._curve[1][-1] * u.mas

    def at(self, distance: u.Quantity) -> tuple[u.Quantity, u.Quantity]:
        """
        Return the points of the line at some distances along it.

        Parameters
        ----------
        distance : `~astropy.units.Quantity`

        Returns
        -------
        east, north : `~astropy.units.Quantity`
        """
        points, s = self._curve
        wanted = u.Quantity(distance).to_value(u.mas)
        inside = np.clip(wanted, 0, s[-1])
        beyond = wanted - inside
        direction = self._direction(inside)
        return tuple(
            (np.interp(inside, s, points[:, k]) + beyond * direction[..., k]) * u.mas
            for k in (0, 1)
        )

    def position_angle(self, distance: u.Quantity) -> u.Quantity:
        """
        Return the direction of the line, north through east.

        Parameters
        ----------
        distance : `~astropy.units.Quantity`

        Returns
        -------
        `~astropy.units.Quantity`
            0 to 360 deg.
        """
        direction = self._direction(u.Quantity(distance).to_value(u.mas))
        angle = np.degrees(np.arctan2(direction[..., 0], direction[..., 1]))
        return angle % 360 * u.deg

    def coordinates(
        self, east: u.Quantity, north: u.Quantity
    ) -> tuple[u.Quantity, u.Quantity]:
        """
        Return the distance along the line and the offset from it.

        Parameters
        ----------
        east, north : `~astropy.units.Quantity`
            Offsets from the reference pixel.

        Returns
        -------
        s, n : `~astropy.units.Quantity`
            Distance of the nearest point of the line, and offset from it, in mas.
        """
        x, y = (u.Quantity(v).to_value(u.mas) for v in (east, north))
        s, n = self._project(np.stack(np.broadcast_arrays(x, y), axis=-1))
        return s * u.mas, n * u.mas

    def matrix(self, east: ArrayLike, north: ArrayLike) -> np.ndarray:
        """
        Return matrices that turn (east, north) into the axes of the frame.

        Parameters
        ----------
        east, north : array_like, shape (...,)
            Positions, offsets from the reference pixel in mas.

        Returns
        -------
        `numpy.ndarray`, shape (..., 2, 2)
            ``(v1, v2) = matrix @ (d_east, d_north)``, orthogonal.
        """
        s, _ = self._project(np.stack(np.broadcast_arrays(east, north), axis=-1))
        sin, cos = np.moveaxis(self._direction(s), -1, 0)
        return axes_along(sin, cos)

    def displacement(self, position: ArrayLike, motion: ArrayLike) -> np.ndarray:
        """
        Return displacements as changes of s and n.

        Along a bend this is the length along the line, which is longer than
        the straight distance between the two positions.

        Parameters
        ----------
        position, motion : array_like, shape (n, 2)
            East and north in mas.

        Returns
        -------
        `numpy.ndarray`, shape (n, 2)
        """
        start = np.stack(self._project(np.asarray(position, float)), axis=-1)
        end = np.stack(self._project(np.add(position, motion)), axis=-1)
        return end - start

    def _direction(self, s):
        """Return unit vectors along the line, shape (..., 2)."""
        points, distances = self._curve
        middle = 0.5 * (distances[1:] + distances[:-1])
        step = np.diff(points, axis=0)
        unit = step / np.hypot(*step.T)[:, None]
        found = np.stack([np.interp(s, middle, c) for c in unit.T], axis=-1)
        return found / np.hypot(found[..., 0], found[..., 1])[..., None]

    def _project(self, places):
        from scipy.spatial import cKDTree

        points, distances = self._curve
        flat = places.reshape(-1, 2)
        nearest = cKDTree(points).query(flat)[1]
        last = len(points) - 2
        # The segments before and after the nearest point.
        segment = np.stack([np.maximum(nearest - 1, 0), np.minimum(nearest, last)])
        step, away = points[segment + 1] - points[segment], flat - points[segment]
        length = np.hypot(step[..., 0], step[..., 1])
        unit = step / length[..., None]
        # The first and the last segment continue beyond the line.
        low = np.where(segment == 0, -np.inf, 0.0)
        high = np.where(segment == last, np.inf, length)
        along = np.clip((away * unit).sum(axis=-1), low, high)
        square = ((away - along[..., None] * unit) ** 2).sum(axis=-1)
        side = away[..., 0] * unit[..., 1] - away[..., 1] * unit[..., 0]
        found = np.stack([distances[segment] + along, np.copysign(square**0.5, side)])
        nearer = square.argmin(axis=0), np.arange(len(flat))
        return found[:, *nearer].reshape(2, *places.shape[:-1])

    def to_table(self) -> QTable:
        """
        Return the points of the line as a table.

        Returns
        -------
        `~astropy.table.QTable`
            Columns ``s``, ``east``, ``north``, ``error``, ``pa``.
        """
        s = self.distances
        names = ("s", "east", "north", "error", "pa")
        values = [s, self.east, self.north, self.error, self.position_angle(s)]
        return QTable(values, names=names, meta=dict(self.meta))

    @classmethod
    def from_table(cls, table: QTable) -> RidgeLine:
        """
        Return the ridge line in a table of `to_table`.

        Parameters
        ----------
        table : `~astropy.table.QTable`
            Columns ``east``, ``north`` and, if known, ``error``.

        Returns
        -------
        `RidgeLine`

        Raises
        ------
        ValueError
            If a column is missing.
        """
        for name in ("east", "north"):
            if name not in table.colnames:
                raise ValueError(f"not a table of a ridge line: {name} is missing")
        error = table["error"] if "error" in table.colnames else None
        return cls(table["east"], table["north"], error, meta=dict(table.meta))


def lengths_of(points):
    """Return the length of the path to each of the points, shape (n, 2)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
