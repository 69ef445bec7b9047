# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Options of the examples, and the output of their table and figure."""

import argparse
import sys
from pathlib import Path

import astropy.units as u
from astropy.table import QTable


def run(measure, doc, *, data=False):
    """
    Run an example from the command line.

    Parameters
    ----------
    measure : callable
        Returns a table and a figure.  Its argument is the journal's table of MOJAVE
        if the example needs data.
    doc : str
        The docstring of the example.
    data : bool, optional
        Whether the example needs data.
    """
    parser = argparse.ArgumentParser(description=doc.strip().splitlines()[0])
    if data:
        parser.add_argument(
            "table", type=Path, help="apjac230ft4_mrt.txt of Lister et al. (2021)"
        )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path(),
        help="folder for table and figure, "
        "by default the one in which the example is started",
    )
    parser.add_argument(
        "--pdf", action="store_true", help="write the figure as a PDF, too"
    )
    args = parser.parse_args()
    table, figure = measure(args.table) if data else measure()
    name = measure.__module__ if measure.__module__ != "__main__" else _script()
    args.output.mkdir(parents=True, exist_ok=True)
    text = as_text(table)
    (args.output / f"{name}.txt").write_text(text, encoding="utf-8")
    figure.savefig(args.output / f"{name}.png", dpi=80)
    if args.pdf:
        figure.savefig(args.output / f"{name}.pdf")
    print(text, end="")
    print(f"Figure: {args.output / name}.png", file=sys.stderr)


def _script():
    import __main__

    return Path(__main__.__file__).stem


def as_text(table):
    """Return a table, and the notes in its meta, as the text that is printed."""
    lines = table.pformat(max_lines=-1, max_width=-1, show_unit=True)
    lines += table.meta.get("notes", [])
    return "\n".join(line.rstrip() for line in lines) + "\n"


def brief(table, *columns, digits=2, **others):
    """
    Return some columns of a table; ``others`` are numbers of digits by column.

    Speeds in c, whose names begin with beta, get this unit.
    """
    others = {"p_global": 3, **others}
    short = QTable()
    for name in columns:
        short[name] = table[name]
        if name.startswith("beta"):
            short[name] = table[name].value * u.def_unit("c")
        if short[name].dtype.kind == "f":
            short[name].info.format = f".{others.get(name, digits)}f"
    return short
