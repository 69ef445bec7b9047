# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Arguments that several commands have; those of settings are made from `Settings`."""

import argparse

from astro_scc.settings import GROUPS, OPTIONS

#: An option of a setting that is on or off.
SWITCH = "true|false"


def add_setting(parser, name):
    """Add the option of a setting, or the argument if it is the epochs."""
    facts = OPTIONS[name]
    if name == "epochs":
        parser.add_argument(
            name, nargs="*", metavar=facts["metavar"], help=facts["help"]
        )
        return
    kind = {"metavar": facts["metavar"]}
    if facts["metavar"] == SWITCH:
        kind = {"action": argparse.BooleanOptionalAction}
    option = f"--{name.replace('_', '-')}"
    parser.add_argument(option, help=facts["help"], **kind)


def add_settings(parser, command):
    """Add all settings that a command has, in their groups, and who works."""
    for group in GROUPS:
        own = [
            name
            for name, facts in OPTIONS.items()
            if facts["group"] == group
            and command in facts["commands"]
            and facts["metavar"] is not None
        ]
        box = parser.add_argument_group(group) if own else None
        for name in own:
            add_setting(box, name)
    parser.add_argument("--config", metavar="FILE.toml", help="read settings from here")
    add_workers(parser)


def add_output(parser, what, *, default=None):
    """Add ``--output``, required without a default, and ``--overwrite``."""
    parser.add_argument(
        "-o",
        "--output",
        metavar="DIR",
        required=default is None,
        default=default,
        help=f"folder for {what}" + (f"; default {default}" if default else ""),
    )
    add_overwrite(parser)


def add_overwrite(parser):
    """Add ``--overwrite``."""
    add_switch(
        parser, "--overwrite", "replace what is in the folder under the same names"
    )


def add_switch(parser, option, text):
    """Add an option that is given or not."""
    parser.add_argument(option, action="store_true", help=text)


def add_no_report(parser):
    """Add ``--no-report``."""
    add_switch(parser, "--no-report", "write no report.html and figures")


def add_votable(parser, files):
    """Add ``--votable``."""
    add_switch(parser, "--votable", f"write {files} too, for TOPCAT, STILTS and Aladin")


def add_workers(parser):
    """Add the options that say who works."""
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
