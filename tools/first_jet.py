# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Run the commands of the page "Quick start" on 3C 120, and keep what it shows.

The commands are read from ``docs/start.rst``; what they print, the figures that they
write, and two more of one epoch replace those in ``docs/images/start``::

    python tools/first_jet.py ../shared/data

It takes three minutes.  Without the folder of the data, give the machine-readable table
of the journal instead.
"""

import argparse
import contextlib
import io
import os
import re
import shlex
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
from astropy.table import Table
from matplotlib.colors import Normalize

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.cli import main
from astro_scc.decomposition.wavelet import wavelet_planes

DOCS = Path(__file__).parents[1] / "docs"
#: The table as a reader of the page has it, and here.
TABLE = "apjac230ft4_mrt.txt"
PART = Path("mojave_xviii", "0430+052.ecsv")
#: The part of the images that is shown, in mas.
INNER = {"xlim": (2, -15), "ylim": (-8, 2), "xticks": range(0, -16, -5)}
#: Figures that ``measure`` writes.
FIGURES = ("spectrum", "distance", "separation")
#: Three dates within a year, in which the same features are seen.
DATES = ("2012-03-04", "2012-07-12", "2012-11-02")


def commands(table, options=()):
    """
    Return the commands of the page, with the options that shorten a test.

    Parameters
    ----------
    table : path
        Replaces the name that the table has on the page.
    options : sequence of str
        For ``restore``.

    Returns
    -------
    list of list of str
    """
    text = re.sub(r" *\\\n +", " ", (DOCS / "start.rst").read_text(encoding="utf-8"))
    lines = re.findall(
        r"^    astro-scc ((?:restore|inspect|measure) .*3c120.*)$", text, re.M
    )
    words = [shlex.split(line.replace(TABLE, str(table))) for line in lines]
    return [[*line, *options] if line[0] == "restore" else line for line in words]


def plot_dates(cube):
    """
    Draw the inner part of the images of some dates below one another.

    Parameters
    ----------
    cube : `~astro_scc.EpochCube`

    Returns
    -------
    `matplotlib.figure.Figure`
    """
    figure, axes = plt.subplots(
        len(cube), 1, figsize=(5, 7.8), sharex=True, sharey=True, layout="compressed"
    )
    for epoch, ax in enumerate(axes):
        cube.plot(epoch, ax=ax, colorbar=False)
        ax.set(xlabel="", ylabel="", title="", **INNER)
        ax.text(0.97, 0.9, cube.times[epoch].strftime("%Y-%m-%d"), ha="right",
                va="top", transform=ax.transAxes)  # fmt: skip
    axes[len(axes) // 2].set_ylabel("Relative Decl. (mas)")
    axes[-1].set_xlabel("Relative R.A. (mas)")
    return figure


def plot_planes(cube, epoch, scales=(1, 2, 3)):
    """
    Draw an image and the structure in it that the first scales show.

    Parameters
    ----------
    cube : `~astro_scc.EpochCube`
    epoch : int
        Index of the epoch.
    scales : sequence of int

    Returns
    -------
    `matplotlib.figure.Figure`
    """
    figure, axes = plt.subplots(
        2, 2, figsize=(7.5, 4), sharex=True, sharey=True, layout="compressed"
    )
    first, *others = axes.flat
    cube.plot(epoch, ax=first, colorbar=False)
    first.set(xlabel="", ylabel="", **INNER)
    first.set_title("Image", fontsize="medium")
    planes = wavelet_planes(cube.data[epoch], scales)
    for ax, plane, scale in zip(others, planes, scales, strict=True):
        limit = 0.05 * plane.max()
        part = replace(cube[epoch : epoch + 1], data=plane[None])
        part.plot(0, ax=ax, colorbar=False, norm=Normalize(-limit, limit))
        ax.images[0].set_cmap("RdBu_r")
        size = 2**scale * cube.pixel_scale
        ax.set(xlabel="", ylabel="", **INNER)
        ax.set_title(f"Scale {scale}: {size:.1f}", fontsize="medium")
    figure.supxlabel("Relative R.A. (mas)", fontsize="medium")
    figure.supylabel("Relative Decl. (mas)", fontsize="medium")
    return figure


def keep(source, output, options=()):
    """
    Write all that the page shows.

    Parameters
    ----------
    source : path
        The folder of the data, or the table.
    output : path
        The folder of the figures and texts.
    options : sequence of str
        For ``restore``.
    """
    source, output = Path(source).resolve(), Path(output).resolve()
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        table = source
        if source.is_dir():
            part, table = Table.read(source / PART), Path("table.ecsv")
            # The journal's table has the names of B1950 only.
            part.meta.pop("name", None)
            part.write(table)
        for words in commands(table, options):
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                status = main(words)
            if status:
                raise SystemExit(status)
            path = output / f"{words[0]}.txt"
            path.write_text(printed.getvalue(), encoding="utf-8")
        for name in FIGURES:
            shutil.copy(Path(words[words.index("-o") + 1], f"{name}.png"), output)
        cube = EpochCube.read("3c120/*.fits")
    days = list(cube.times.strftime("%Y-%m-%d"))
    shown = cube[[days.index(day) for day in DATES if day in days] or slice(3)]
    ssps = StackedCrossCorrelation().match(shown).ssps
    figures = {
        "epochs": plot_dates(shown),
        "wavelets": plot_planes(shown, 1),
        "ssps": shown.plot(1, ssps),
    }
    for name, figure in figures.items():
        figure.savefig(output / f"{name}.png", dpi=100)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("data", help="folder of the data, or the table")
    parser.add_argument("--output", default=DOCS / "images" / "start")
    args = parser.parse_args()
    os.environ.setdefault("MPLBACKEND", "Agg")
    keep(args.data, args.output)
