# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Columns of tables, with their units and meanings."""

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.utils.masked import Masked

from astro_scc.units import PM_UNIT

#: Columns of a proper motion: unit, and meaning.
MOTION = {
    "pm_ra_cosdec": (PM_UNIT, "proper motion to the east"),
    "pm_ra_cosdec_err": (PM_UNIT, "standard error of pm_ra_cosdec"),
    "pm_dec": (PM_UNIT, "proper motion to the north"),
    "pm_dec_err": (PM_UNIT, "standard error of pm_dec"),
    "pm": (PM_UNIT, "proper motion, its length"),
    "pm_err": (PM_UNIT, "standard error of pm"),
    "pm_pa": (u.deg, "direction of the proper motion, north through east"),
    "pm_pa_err": (u.deg, "standard error of pm_pa"),
}


def build_table(rows, columns):
    """
    Build a table from dicts, with the unit or type and description of each column.

    Values that are None are masked.
    """
    table = QTable()
    for name, (kind, text) in columns.items():
        is_unit = isinstance(kind, u.UnitBase)
        missing = np.array([row[name] is None for row in rows], dtype=bool)
        values = [0.0 if row[name] is None else row[name] for row in rows]
        column = np.array(values, dtype=float if is_unit else kind)
        if is_unit:
            column = column * kind
        if missing.any():
            masked = Masked if is_unit else np.ma.MaskedArray
            column = masked(column, mask=missing)
        table[name] = column
        table[name].info.description = text
    return table
