# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What a notebook shows of a measurement."""

from html import escape

import numpy as np

__all__ = ["result_html"]

#: Columns of the components that fit on a screen, and how they are printed.
COLUMNS = {
    "component": "d",
    "kind": "s",
    "pm": ".3g",
    "pm_err": ".2g",
    "pm_pa": ".1f",
    "coefficient": ".3f",
    "p_global": ".2g",
    "n_ssp": "d",
    "n_pairs": "d",
}


def result_html(result):
    """
    A measurement in a few lines, its components as a table.

    Parameters
    ----------
    result : `SCCResult`

    Returns
    -------
    str
        HTML without scripts and styles.
    """
    cube, table = result.cube, result.components
    name = str(cube.meta.get("object", "")).strip()
    title = f"{name}: " if name else ""
    kinds = [str(kind) for kind in table["kind"]]
    found = ", ".join(
        f"{kinds.count(kind)} {kind}"
        for kind in ("moving", "stationary", "not significant")
        if kind in kinds
    )
    lines = [
        f"SCCResult {title}{found or 'no component'}",
        repr(cube)[1:-1],
        f"{len(result.pairs)} pairs of epochs, {np.sum(result.matched.select)} SSPs, "
        f"{result.meta.get('n_trials')} trials, seed {result.meta.get('seed')}",
    ]
    text = "<br>".join(escape(line) for line in lines)
    if not kinds:
        return f"<p>{text}</p>"
    return f"<p>{text}</p>{_table(table)}"


def _table(table):
    head = "".join(f"<th>{escape(_heading(table, name))}</th>" for name in COLUMNS)
    rows = []
    for row in table:
        cells = (_cell(row[name], form) for name, form in COLUMNS.items())
        rows.append("".join(f"<td>{escape(cell)}</td>" for cell in cells))
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _heading(table, name):
    unit = getattr(table[name], "unit", None)
    return f"{name} ({unit})" if unit else name


def _cell(value, form):
    return format(getattr(value, "value", value), form)
