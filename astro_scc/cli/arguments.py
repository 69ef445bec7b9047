# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Arguments that several commands have, each written once."""

import argparse

__all__ = [
    "add_config",
    "add_distance",
    "add_epochs",
    "add_images",
    "add_no_report",
    "add_output",
    "add_overwrite",
    "add_patterns",
    "add_selection",
    "add_trials",
    "add_votable",
    "add_workers",
]


def add_epochs(parser, *, nargs="*"):
    """
    Add the files of the epochs.

    Parameters
    ----------
    parser : `argparse.ArgumentParser`
    nargs : {"*", "+"}, optional
        With "*" a configuration may name them.
    """
    parser.add_argument(
        "epochs",
        metavar="EPOCH.fits",
        nargs=nargs,
        help="one image a date, or a file that EpochCube.write made",
    )


def add_output(parser, *, what, required=True, default=None):
    """
    Add ``--output`` and ``--overwrite``.

    Parameters
    ----------
    parser : `argparse.ArgumentParser`
    what : str
        That is written.
    required : bool, optional
    default : str, optional
    """
    parser.add_argument(
        "-o",
        "--output",
        metavar="DIR",
        required=required,
        default=default,
        help=f"folder for {what}" + (f"; default {default}" if default else ""),
    )
    add_overwrite(parser)


def add_overwrite(parser):
    """
    Add ``--overwrite``.

    Parameters
    ----------
    parser : `argparse.ArgumentParser`
    """
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace what is in the folder under the same names",
    )


def add_config(parser):
    """
    Add ``--config``.

    Parameters
    ----------
    parser : `argparse.ArgumentParser`
    """
    parser.add_argument("--config", metavar="FILE.toml", help="read settings from here")


def add_no_report(parser):
    """
    Add ``--no-report``.

    Parameters
    ----------
    parser : `argparse.ArgumentParser`
    """
    parser.add_argument(
        "--no-report", action="store_true", help="write no report.html and figures"
    )


def add_votable(parser, files):
    """
    Add ``--votable``.

    Parameters
    ----------
    parser : `argparse.ArgumentParser`
    files : str
        That are written.
    """
    parser.add_argument(
        "--votable",
        action="store_true",
        help=f"write {files} too, for TOPCAT, STILTS and Aladin",
    )


def add_selection(group):
    """
    Add ``--after`` and ``--before``.

    Parameters
    ----------
    group : argument group
    """
    group.add_argument(
        "--after", metavar="DATE", help="take epochs of this date, 2006-03-09, or later"
    )
    group.add_argument("--before", metavar="DATE", help="take epochs before this date")


def add_images(parser, *, verb):
    """
    Add the group of options that say which images, and how they are prepared.

    Parameters
    ----------
    parser : `argparse.ArgumentParser`
    verb : str
        What is done with patterns inside the region.
    """
    group = parser.add_argument_group("images")
    add_selection(group)
    group.add_argument(
        "--align",
        metavar="none|core|correlate|wcs|TABLE",
        help="lay the epochs on their reference pixels (none, the default), on the "
        "core that is fitted in each, on one another by correlation, on their "
        "absolute coordinates (wcs; not for VLBI), or by a table (CSV or ECSV) of "
        "dates and offsets of the core",
    )
    group.add_argument(
        "--common-beam",
        action=argparse.BooleanOptionalAction,
        help="convolve to the smallest beam that contains all; the default where "
        "beams differ",
    )
    group.add_argument(
        "--crop",
        metavar="FILE.reg",
        help="read no more of the images than the box around a DS9 or CRTF region, "
        "where all are more than the memory holds",
    )
    group.add_argument(
        "--region",
        metavar="FILE.reg",
        help=f"{verb} patterns inside a DS9 or CRTF region only",
    )


def add_patterns(group, *, kappa, speed):
    """
    Add ``--scales``, ``--max-speed`` and ``--kappa``.

    Parameters
    ----------
    group : argument group
    kappa : float
        Smallest correlation without the option.
    speed : str
        Largest speed without the option.
    """
    group.add_argument(
        "--scales",
        metavar="1,2,3",
        help='wavelet scales by number (j is 2^j pixels) or angle, "0.2 mas, 0.4 mas"; '
        "default 1,2,3,4",
    )
    group.add_argument(
        "--max-speed",
        metavar='"2 mas/yr"',
        help=f"largest proper motion; default {speed}",
    )
    group.add_argument(
        "--kappa",
        metavar=f"{kappa:g}",
        help=f"smallest correlation of a match; default {kappa:g}",
    )


def add_trials(group, *, number, what):
    """
    Add ``--n-trials`` and ``--seed``.

    Parameters
    ----------
    group : argument group
    number : int
        Without the option.
    what : str
        That is tried.
    """
    group.add_argument(
        "--n-trials", metavar=f"{number}", help=f"{what}; default {number}"
    )
    group.add_argument(
        "--seed", metavar="N", help="of the trials; drawn and written down by default"
    )


def add_distance(parser):
    """
    Add the group of options that turn proper motions into speeds.

    Parameters
    ----------
    parser : `argparse.ArgumentParser`
    """
    group = parser.add_argument_group("speeds in units of c")
    group.add_argument("--redshift", metavar="Z", help="of the object")
    group.add_argument(
        "--cosmology",
        metavar='NAME|"H0=71,Om0=0.27"',
        help="for the redshift, as Planck18 or by parameters; default H0=71,Om0=0.27 "
        "(Mertens & Lobanov 2016)",
    )
    group.add_argument(
        "--distance", metavar='"16.7 Mpc"', help="of a near object, without a redshift"
    )


def add_workers(parser):
    """
    Add the group of options that say who works.

    Parameters
    ----------
    parser : `argparse.ArgumentParser`
    """
    group = parser.add_argument_group("running")
    group.add_argument(
        "--workers",
        metavar="N",
        type=int,
        default=1,
        help="processes; the numbers do not depend on it; default 1",
    )
    group.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a Dask cluster that works instead, tcp://node1:8786",
    )
