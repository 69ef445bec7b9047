# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
The commands: help, arguments and place of each.

Options of settings are made from `Settings`; ``options.csv`` has the others.  A
function with the name of each command adds its arguments, and its docstring is the
help; what the command does is in another module, which takes seconds to import.
"""

import argparse
import csv
from importlib import resources

from astro_scc.settings import GROUPS, OPTIONS

#: Folder, within the folder of the products, for what an interrupted run goes on from.
WORK = ".astro_scc-work"
JETS = ("two-fluid", "random-velocity", "ballistic", "static", "unrelated", "jet")
#: What argparse takes for the options that are no settings, and those of a jet.
OWN, FLOW = {}, []
with resources.files("astro_scc.cli").joinpath("options.csv").open() as file:
    for row in csv.DictReader(file):
        kind = {"action": "store_true", "help": row["help"]}
        if row["metavar"]:
            kind = {"metavar": row["metavar"], "help": row["help"]}
            kind["type"] = {"int": int, "float": float}.get(row["type"], str)
        OWN[row["name"]] = kind
        FLOW += [row["name"]] if row["jet"] else []
#: A default folder: the names of the object and of the command.
OF_OBJECT = "OBJECT-COMMAND"
#: An option of a setting that is on or off.
SWITCH = "true|false"


def option_name(name):
    """Return the option of a setting or argument as it is typed."""
    return f"--{name.replace('_', '-')}"


def add(parser, *names, **more):
    """Add options and settings by their names; epochs are a positional argument."""
    for name in names:
        kind, option = OWN.get(name), option_name(name)
        if kind is None:
            kind = {key: OPTIONS[name][key] for key in ("help", "metavar")}
            if kind["metavar"] == SWITCH:
                kind |= {"action": argparse.BooleanOptionalAction, "metavar": None}
            if name == "epochs":
                option, kind["nargs"] = name, "*"
        parser.add_argument(option, **kind | more)


def add_settings(parser, command):
    """Add all settings of a command in their groups, ``--config`` and the workers."""
    for group in GROUPS:
        box = parser.add_argument_group(group)
        for name, facts in OPTIONS.items():
            there = command in facts["commands"] and facts["metavar"] is not None
            if there and facts["group"] == group:
                add(box, name)
    add(parser, "config")
    add(parser.add_argument_group("running"), "workers", "scheduler")


def add_output(parser, what, default=None):
    """Add ``--output``, required without a default."""
    parser.add_argument(
        *("-o", "--output"),
        metavar="DIR",
        required=default is None,
        default=None if default == OF_OBJECT else default,
        help=f"folder for {what}" + (f"; default {default}" if default else ""),
    )


def add_restoring(parser, *, required):
    """Add options on the images that are restored from components."""
    add(parser, "beam")
    add(parser, "pixel", required=required)
    add(parser, "noise", "seed", "after", "before", "source")
    text = (
        "what is at the reference pixel, the core (feature 0) or the centre of the "
        "map; default the core in tables that refer to it"
    )
    parser.add_argument("--origin", choices=("core", "map"), help=text)


# -- the commands ----------------------------------------------------------------


def demo(parser):
    """
    Simulate the two-fluid jet of the paper and measure it.

    Simulate the two-fluid jet of Mertens & Lobanov (2016), a slow sheath around a
    fast spine, measure it and write the report.  No input is needed.

    The folder gets the products of astro-scc measure, the images in epochs/ and
    the region in region.reg.  To run it again, give --overwrite or another
    folder.
    """
    add_output(parser, "images and report", "astro_scc_demo")
    add(parser, "overwrite")


def simulate(parser):
    """
    Simulate images of a jet whose velocities are known.

    Simulate images of a jet whose velocities are known: one FITS file per epoch,
    and truth.ecsv with the position and the velocity of every feature.

    jets:
      two-fluid        a slow sheath around a fast spine
      random-velocity  a new random velocity for every feature at every epoch
      ballistic        features that each keep a random velocity
      static           stationary features
      unrelated        epochs that have nothing in common
      jet              as in surveys: uneven dates, a core, speeds that scatter

    examples:
      astro-scc simulate two-fluid jet --seed 1 --epochs 10
      astro-scc simulate jet jet --motion 0.4 --dispersion 0.2
    """
    parser.add_argument("jet", choices=JETS, metavar="JET", help="one of those below")
    parser.add_argument("output", metavar="DIR", help="folder for the images")
    add(parser, "overwrite", "seed")
    text = (
        "number of epochs; default 10, 30 days apart, and of a jet 15 at uneven "
        "dates, 0.2 years apart in the median"
    )
    parser.add_argument("--epochs", metavar="N", help=text, type=int)
    add(parser, "dense")
    add(parser.add_argument_group("options of the jet 'jet'"), *FLOW)


def restore(parser):
    """
    Make images from lists of Gaussian or CLEAN components.

    Make images from lists of components, all with one beam: one FITS file per epoch.

    examples:
      astro-scc restore 1226+023.ecsv -o 3c273 --beam "1.0 mas 0.5 mas -7 deg" \\
          --pixel "0.1 mas" --noise "0.3 mJy/beam" --seed 1 --before 2011-01-01
      astro-scc restore apjac230ft4_mrt.txt --source 1226+023 -o 3c273 --beam "1 mas" \\
          --pixel "0.1 mas"
      astro-scc restore models/*.mod -o images --beam "0.9 0.6 mas -5 deg" \\
          --pixel "0.1 mas"

    Tables are ECSV files or the machine-readable tables of journals, from the AAS
    (.txt) or the CDS (.dat, with its ReadMe beside it), with the columns epoch (or
    Obs.Y, Obs.M, Obs.D), flux, separation and position_angle.  Files .mod are models of
    difmap with the date in the name; files .fits have CLEAN components in an AIPS CC
    table.
    """
    text = "a table of many epochs, or one file per epoch"
    parser.add_argument("tables", metavar="TABLE.ecsv|MODEL.mod", help=text, nargs="+")
    add_output(parser, "the images")
    add(parser, "overwrite")
    add_restoring(parser, required=True)


def inspect(parser):
    """
    Show what images hold, what is wrong and what can be measured.

    Print one line per epoch, then the problems, and the speeds that can be measured
    with these dates and from which pairs of epochs.  Nothing is measured or written.

    examples:
      astro-scc inspect 3c273/*.fits
      astro-scc inspect 3c273/*.fits --speed "0.9 mas/yr"
    """
    add(parser, "epochs", "beam", "speed")


def measure(parser):
    """
    Measure the velocities in the images of one jet.

    Measure the velocity components in images of one object at many dates.

    examples:
      astro-scc measure 3c273/*.fits --redshift 0.158
      astro-scc measure *.fits -o out --align cores.ecsv --region jet.reg \\
          --position-angle "-112 deg" --baseline "0.1 yr 0.6 yr" --redshift 0.033
      astro-scc measure m87/*.fits -o out --scales "0.2 mas, 0.4 mas" \\
          --distance "16.7 Mpc"
      astro-scc measure --config out/config.toml -o again

    The folder gets components.ecsv, features.ecsv and positions.ecsv,
    sensitivity.ecsv, ssps.ecsv, scc.fits, report.html with its figures, and
    config.toml, which reproduces the tables bit by bit from the same images.  Its
    folder publication has the tables in LaTeX for AASTeX and A&A, in the forms of the
    AAS and the CDS, and as VOTable.  A configuration file may hold every option of a
    measurement, with _ for -, and some settings that have no option (see the
    documentation).  The command line takes precedence over the file.
    """
    add_output(parser, "tables, maps and report", OF_OBJECT)
    add(parser, "overwrite", "no_report", "all_figures", "pdf", "compare")
    add(parser, "ds9_regions", "resume")
    add_settings(parser, "measure")


def explore(parser):
    """
    See which features, in which epochs, make a speed.

    Write explore.html into the folder of a measurement: the velocity map, the images,
    the separations against time and a table of the features in linked panels.
    Selecting a stream or features in one panel selects them in all.  The page is
    one file that needs no network.

    examples:
      astro-scc measure 3c273/*.fits -o out
      astro-scc explore out

    The images are those that config.toml names, aligned as they were measured; start
    the command where the measurement was started.  It needs bokeh: pip install
    bokeh
    """
    parser.add_argument("folder", metavar="OUT", help="folder that measure has written")


def profile(parser):
    """
    Measure the velocities in bins of distance from the core.

    Measure the velocities in bins of distance from the core.

    examples:
      astro-scc profile 3c120/*.fits -o out --align core --bins "0.5 1.5 2.5 3.5 mas" \\
          --position-angle "-112 deg" --max-speed "5 mas/yr" --redshift 0.033
      astro-scc profile m87/*.fits -o out --bins "1 2 4 8 mas" --position-angle ridge \\
          --distance "16.7 Mpc"
      astro-scc profile *.fits -o out --bins "1 2 3 4 5 mas" --window "2 mas"

    All images are matched once; for each bin, the matches of its patterns are stacked.
    The folder gets profile.ecsv, with a row for each bin and stream, p_fdr adjusted
    for all bins, and in its header the acceleration over all bins; scales.ecsv, which
    compares the speeds of the finest scale and of the others; profile.png,
    velocity_maps.png and position_angles.png; and config.toml.  With --position-angle
    ridge, distances are measured along the ridge line.
    """
    add_output(parser, "the table and figures of the profile", OF_OBJECT)
    add(parser, "overwrite")
    add_settings(parser, "profile")


def track(parser):
    """
    Find features, follow each from epoch to epoch, and measure its motion.

    Follow the features in images of one object at many dates.

    examples:
      astro-scc track 3c120/*.fits -o tracks --align core --redshift 0.033
      astro-scc track hh34/*.fits -o tracks --detections ssp --scales 1,2 \\
          --distance "400 pc"

    The folder gets features.ecsv, with a row for each feature: where it is, its motion
    and whether it is secure; positions.ecsv, with a row for each feature and epoch; and
    figures of both, separation.png and tracks.png.  A configuration file of astro-scc
    measure sets what both commands have.
    """
    add_output(parser, "the tables and figures", OF_OBJECT)
    add(parser, "overwrite", "no_figures", "pdf", "compare")
    add_settings(parser, "track")


def survey(parser):
    """
    Measure many sources, on one machine or a Dask cluster.

    Measure the velocities of many sources and make one table.

    examples:
      astro-scc survey survey.toml -o out --workers 8
      astro-scc survey survey.toml -o out --scheduler tcp://node1:8786
      astro-scc survey survey.toml -o out --workers 8 --scheduler local
      astro-scc survey apjac230ft4_mrt.txt -o out --workers 8
      astro-scc survey images -o out --redshifts redshifts.csv

    survey.toml:
      [defaults]
      align = "core"
      baseline = "0.1 yr 1.0 yr"
      scale_groups = {fine = [1, 2], coarse = [3, 4]}

      [sources."3C 273"]
      epochs = "3c273/*.fits"
      redshift = 0.158
      max_speed = "2 mas/yr"
      regions = {inner = "3c273/inner.reg", outer = "3c273/outer.reg"}

    [defaults] and each source may hold any setting of a configuration of astro-scc
    measure except region.  Paths are relative to the file.  A source that fails does
    not stop the others.  Run again with the same folder, the command resumes: sources
    that are finished with the same settings, files and versions are not measured again.
    published_pm of a source, "0.9 0.1 mas/yr", is shown beside the measured speed, and
    published features of all, in a table that compare names, beside the measured ones.
    The folder gets overview.html, with a row for each source and figures of all;
    survey.ecsv, with a row for each source, region, scale group and stream, and
    p_fdr over all of them, or the reason why there is no stream; features.ecsv, with
    the features of all sources; both in the forms of archives in publication/; and in
    sources/ a folder for each source with the products of astro-scc measure.

    From a table of components, such as astro-scc restore reads, the images of all its
    sources, or of --source, are restored into images/ of the folder and measured; those
    of a folder, with a folder for each source, are measured where they are.  The file
    survey.toml of the folder names them; settings can be added to it.
    """
    text = "what to measure, a table of components, or a folder of folders of images"
    parser.add_argument("survey", metavar="SURVEY.toml|TABLE|DIR", help=text)
    add_output(
        parser, "the catalogues and the sources' products, new or of this survey"
    )
    parser.add_argument(
        "--report",
        action=argparse.BooleanOptionalAction,
        help="write a report of each source; default for a SURVEY.toml alone",
    )
    group = parser.add_argument_group("a table of components, or a folder of folders")
    add(group, "redshifts")
    add_restoring(parser.add_argument_group("a table of components"), required=False)
    add(parser.add_argument_group("running"), "workers", "scheduler")


#: Module and function of each command.
COMMANDS = {
    demo: "measure.demo",
    simulate: "images.simulate",
    restore: "images.restore",
    inspect: "inspect.inspect",
    measure: "measure.measure",
    explore: "measure.explore",
    profile: "profile.profile",
    track: "track.track",
    survey: "survey.run",
}
