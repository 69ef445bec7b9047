# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Columns of tables: units, meanings, UCDs and headings of papers."""

import re

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.utils.masked import Masked

from astro_scc.units import PM_UNIT

#: Columns of a table in a paper, in their order, and their headings in LaTeX.
PAPER = {
    "source": "Source",
    "redshift": "$z$",
    "track": "Track",
    "feature": "Feature",
    "component": "Stream",
    "r_min": r"$r_\mathrm{min}$",
    "r_max": r"$r_\mathrm{max}$",
    "kind": "Kind",
    "scale": "Scale",
    "n_epochs": "Epochs",
    "first": "First",
    "last": "Last",
    "separation": "Separation",
    "position_angle": "PA",
    "r": "$r$",
    "pa": "PA",
    "pm": r"$\mu$",
    "beta_app": r"$\beta_\mathrm{app}$",
    "pm_pa": r"PA of $\mu$",
    "published": "Published",
    "published_pm": r"$\mu_\mathrm{pub}$",
    "dispersion": r"$\sigma_\mu$",
    "t_ej": r"$t_\mathrm{ej}$",
    "p_false": r"$p_\mathrm{false}$",
    "p_global": r"$p_\mathrm{global}$",
    "p_fdr": r"$p_\mathrm{FDR}$",
    "n_features": "Features",
    "n_pairs": "Pairs of epochs",
    "secure": "Secure",
}
#: Patterns of names of columns, the first of which that fits tells the UCD.
UCDS = {
    "pm_ra_cosdec": "pos.pm;pos.eq.ra",
    "pm_dec": "pos.pm;pos.eq.dec",
    "pm_pa": "pos.posAng;pos.pm",
    "(published_)?pm(_.*)?|change": "pos.pm",
    "beta_app": "phys.veloc",
    "dispersion": "stat.stdev;pos.pm",
    "acc_.*": "phys.acceleration",
    "(ra_offset|east)(_centroid)?": "pos.eq.ra;arith.diff",
    "(dec_offset|north)(_centroid)?": "pos.eq.dec;arith.diff",
    "(lon|lat)_offset.*": "pos;arith.diff",
    "separation|r(_min|_mid|_max)?|motion": "pos.angDistance",
    "position_angle|pa": "pos.posAng",
    "x": "pos.cartesian.x",
    "y": "pos.cartesian.y",
    "date|t_ej": "time.epoch",
    "first": "time.start;obs",
    "last": "time.end;obs",
    "flux": "phot.flux.density",
    "size|scale_size": "phys.angSize",
    "p_.*": "stat.probability",
    "snr": "stat.snr",
    "coefficient": "stat.correlation",
    "z_score|peak|coefficient_sum": "stat.value",
    "n_.*": "meta.number",
    "epoch": "meta.id;obs",
    "published": "meta.id.cross",
    "source": "meta.id;src;meta.main",
    "redshift": "src.redshift",
    "track|feature|component|ssp|region|scale_group": "meta.id",
    "kind": "meta.code.class",
    "secure|proven|used|in_region|main|scale": "meta.code.qual",
    "caution": "meta.note",
}


def column_ucd(name):
    """Return the UCD of a column, or None if it is of no table of this package."""
    plain = re.sub("_err(?=_|$)", "", name)
    found = (ucd for own, ucd in UCDS.items() if re.fullmatch(own, plain))
    ucd = next(found, None)
    return f"stat.error;{ucd}" if ucd and plain != name else ucd


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


def describe(table, meanings):
    """Set the descriptions of the columns of a table that are among the meanings."""
    for name in meanings.keys() & set(table.colnames):
        table[name].info.description = meanings[name]


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
