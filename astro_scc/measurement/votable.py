# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tables for the tools of the Virtual Observatory."""

import os

import numpy as np
from astropy.table import Column, MaskedColumn, Table
from astropy.time import Time

from astro_scc.partial import replace_when_complete

__all__ = ["write_votable"]


def write_votable(table, path, *, overwrite=False):
    """
    Write a table as VOTable, which TOPCAT, STILTS and Aladin read.

    Parameters
    ----------
    table : `~astropy.table.Table`
        Any table of this package, in memory or read from its ECSV file.
    path : path
        A file, commonly ``.vot`` or ``.xml``.
    overwrite : bool, optional

    Raises
    ------
    OSError
        If the file exists and ``overwrite`` is False, or cannot be written.

    Notes
    -----
    Columns keep their units and descriptions.  Dates become ISO text.  Of
    the meta, what is one number or one line of text becomes a parameter;
    ECSV keeps all of it.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> from astro_scc.measurement import write_votable
    >>> write_votable(QTable({"pm": [0.5] * u.mas / u.yr}), "components.vot")
    >>> QTable.read("components.vot")["pm"].unit
    Unit("mas / yr")
    """
    from astropy.io.votable import from_table
    from astropy.io.votable.tree import Param

    plain = Table()
    for name in table.colnames:
        plain[name] = _column(table[name])
    votable = from_table(plain)
    first = votable.get_first_table()
    for key, value in table.meta.items():
        if isinstance(value, bool | int | float | str) and value != "":
            datatype = {bool: "boolean", int: "long", float: "double"}
            kind = datatype.get(type(value), "unicodeChar")
            more = {"arraysize": "*"} if kind == "unicodeChar" else {}
            first.params.append(
                Param(votable, name=key, datatype=kind, value=value, **more)
            )
    with replace_when_complete(os.fspath(path), overwrite=overwrite) as part:
        votable.to_xml(str(part))


def _column(values):
    if isinstance(values, Time):
        # Of no dates, text is not known to be text.
        dates = np.asarray(values.isot, dtype=str if len(values) else "U23")
        return Column(dates, description=values.info.description)
    plain = getattr(values, "value", values)
    masked = {"mask": values.mask} if hasattr(values, "mask") else {}
    column = (MaskedColumn if masked else Column)(
        getattr(plain, "unmasked", plain),
        unit=getattr(values, "unit", None),
        description=values.info.description,
        **masked,
    )
    # VOTable has no type for numbers of 8 bits with a sign, nor of 128 bits.
    if column.dtype == np.int8:
        column = column.astype(np.int16)
    return column
