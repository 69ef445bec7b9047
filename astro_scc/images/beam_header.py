# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The beam of an image, by its header, its tables or its history."""

import re

import astropy.units as u
import numpy as np

from astro_scc.images.beam import Beam, as_beam, different_beam
from astro_scc.images.brightness import parse_unit
from astro_scc.images.cards import axis_numbers, axis_of, get
from astro_scc.images.facts import SPECTRAL

#: Keywords of the axes and the angle of a beam.
BEAM = "BMAJ", "BMIN", "BPA"
_NUMBER = r"([-+]?[\d.]+(?:[EeDd][-+]?\d+)?)"
_CLEAN_BEAM = re.compile(
    rf"CLEAN\s+BMAJ\s*=\s*{_NUMBER}\s+BMIN\s*=\s*{_NUMBER}\s+BPA\s*=\s*{_NUMBER}"
)


class SeveralBeamsError(ValueError):
    """A table has beams of several channels, and none can be told to be the image's."""


def header_beam(header, tables=()):
    """Return the beam of an image, None if nothing tells it, see `read_header`."""
    beam = get(header, "BEAM")
    if hasattr(beam, "major"):
        return as_beam(beam)
    major, minor, pa = (get(header, keyword, kind=float) for keyword in BEAM)
    if major:
        if pa is None and minor not in (None, major):
            raise ValueError("BPA is missing or no number, and BMAJ and BMIN differ")
        return _beam(major, major if minor is None else minor, pa or 0.0)
    for table in tables:
        if table.name.upper() == "AIPS CG" and len(table.data):
            return _row(table, 0)
        if table.name.upper() == "BEAMS" and len(table.data):
            return _of_channel(header, table)
    # Of a header, str would break the lines.
    lines = header.get("HISTORY") or header.get("history") or ()
    lines = lines if isinstance(lines, str) else "; ".join(map(str, lines))
    found = _CLEAN_BEAM.findall(lines.upper())
    numbers = [float(text.replace("D", "E")) for text in found[-1]] if found else [0]
    return _beam(*numbers) if numbers[0] > 0 else None


def _row(table, row):
    """Return the beam in a row of a table."""
    return _beam(*(_angle(table, name, row) for name in BEAM))


def _angle(table, name, row):
    """Return an angle in a row of a table, in degrees."""
    text = (table.columns[name].unit or "deg").strip().lower()
    unit = parse_unit(text) or parse_unit(text.rstrip("s")) or u.Unit(text)
    return (float(table.data[row][name]) * unit).to_value(u.deg)


def _of_channel(header, table):
    """Return the beam of the channel of an image, of a table of all channels."""
    n = len(table.data)
    rows = np.arange(n)
    every = {row: _row(table, row) for row in rows if _angle(table, "BMAJ", row) > 0}
    if every and different_beam([*every.values()]) is None:
        return next(iter(every.values()))
    columns = {name.upper(): name for name in table.columns.names}
    for column, axis in (("CHAN", _spectral(header)), ("POL", "STOKES")):
        if column in columns and len(rows) > 1:
            values = np.asarray(table.data[columns[column]], dtype=int)
            rows = rows[np.isin(values[rows], _plane_of(header, axis, values))]
    beams = [every[row] for row in rows if row in every]
    if not beams or different_beam(beams) is not None:
        raise SeveralBeamsError(
            f"its table BEAMS has {n} beams, and which one is that of its channel "
            "cannot be told; write BMAJ, BMIN and BPA in degrees to its header, or "
            "give one beam of all (--beam, in Python beams=)"
        )
    return beams[0]


def _spectral(header):
    """Return the name of the spectral axis."""
    names = "FREQ", *SPECTRAL
    return next((name for name in names if axis_of(header, name)), "FREQ")


def _plane_of(header, name, numbers):
    """
    Return the numbers that the plane of an image may have on an axis of a table.

    A plane that was cut out of a cube keeps the reference pixel, which was the first
    of the cube; without a step from it nothing tells the plane, unless it is Stokes I.
    """
    if (axis := axis_of(header, name)) is None:
        return numbers
    value, pixel, step = axis_numbers(header, axis)
    first = 1 - pixel
    if name == "STOKES" and value is not None:
        first = (1 - value) / (step or 1)
        known = header.get(f"NAXIS{axis}", 1) > 1 or value + (1 - pixel) * step == 1
        return [round(first)] if known else [round(1 - pixel)]
    if pixel == 1 or abs(first - round(first)) > 1e-6:
        return numbers
    # Some count channels from 1.
    return [round(first) + (1 if numbers.min() == 1 else 0)]


def _beam(major, minor, pa):
    """Return the beam of three numbers in degrees, with the larger axis first."""
    if not (major > 0 and minor > 0):
        raise ValueError(f"the beam {major:g} x {minor:g} deg is not positive")
    if minor > major:
        major, minor, pa = minor, major, pa + 90
    return Beam(major * u.deg, minor * u.deg, pa * u.deg)
