# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Run the commands of the page on the paper's results, and keep what they print and draw.

The commands are read from ``docs/paper.rst``; their texts and maps replace those in
``docs/images/paper``.  The scripts that the page names keep their own results::

    python tools/paper_jets.py apjac230ft4_mrt.txt

It takes four minutes.
"""

import argparse
import contextlib
import io
import os
import re
import shlex
import tempfile
from pathlib import Path

from PIL import Image

from astro_scc.cli import main

DOCS = Path(__file__).parents[1] / "docs"
IMAGES = DOCS / "images" / "paper"
#: The table as a reader of the page has it.
TABLE = "apjac230ft4_mrt.txt"
#: What the profile of 3C 120 along diverging lines is called.
DIVERGING = "3c120-diverging"
#: Colours and width in pixels of a figure.
COLORS, WIDTH = 256, 900


def commands(table=TABLE):
    """
    Return the commands of the page by the names of what they write, in their order.

    Parameters
    ----------
    table : path
        Replaces the name that the table has on the page.

    Returns
    -------
    dict of list of str
    """
    text = re.sub(r" *\\\n +", " ", (DOCS / "paper.rst").read_text(encoding="utf-8"))
    lines = re.findall(r"^    astro-scc (.+)$", text, re.MULTILINE)
    words = [shlex.split(line.replace(TABLE, str(table))) for line in lines]
    found = {_name(line): line for line in words}
    # The page says in words what differs without the direction.
    found[DIVERGING] = _without_direction(found["3c120-speeds"])
    return found


def _without_direction(words):
    """Return a profile without ``--position-angle``, written elsewhere."""
    k = words.index("--position-angle")
    words = [*words[:k], *words[k + 2 :]]
    words[words.index("-o") + 1] = DIVERGING
    return words


def _name(words):
    """Return the name of what a command writes."""
    if "-o" in words:
        return words[words.index("-o") + 1]
    return words[2] if words[0] == "simulate" else words[0]


def keep(table, output, names=None):
    """
    Run the commands in a folder of their own, and write what the page shows.

    Parameters
    ----------
    table : path
        Of the journal.
    output : path
    names : sequence of str, optional
        Names of what is run, by default all.
    """
    output = Path(output).resolve()
    output.mkdir(parents=True, exist_ok=True)
    todo = commands(Path(table).resolve())
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for name in todo if names is None else names:
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                status = main(todo[name])
            if status:
                raise SystemExit(status)
            if todo[name][0] not in ("simulate", "restore"):
                text = printed.getvalue()
                (output / f"{name}.txt").write_text(text, encoding="utf-8")
            if (figure := Path(name, "paper.png")).is_file():
                _reduced(figure).save(output / f"{name}.png", optimize=True)


def _reduced(path):
    """Return a figure with fewer pixels and a palette."""
    with Image.open(path) as image:
        size = WIDTH, round(image.height * WIDTH / image.width)
        small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    # Other methods lose the bright colours of the few pixels of a peak.
    how = {"method": Image.Quantize.FASTOCTREE, "dither": Image.Dither.NONE}
    return small.quantize(COLORS, **how)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("table", help="the journal's table of MOJAVE")
    args = parser.parse_args()
    os.environ.setdefault("MPLBACKEND", "Agg")
    keep(args.table, IMAGES)
