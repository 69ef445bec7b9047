# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Arguments that several commands have; those of settings are made from `Settings`."""

import argparse

from astro_scc.settings import GROUPS, OPTIONS

#: A default folder: the names of the object and of the command.
OF_OBJECT = "OBJECT-COMMAND"
#: An option of a setting that is on or off.
SWITCH = "true|false"


def option_name(name):
    """Return the option of a setting or argument as it is typed."""
    return f"--{name.replace('_', '-')}"


def add_setting(parser, name):
    """Add the option of a setting; epochs are a positional argument."""
    facts = OPTIONS[name]
    option, kind = option_name(name), {"metavar": facts["metavar"]}
    if name == "epochs":
        option, kind["nargs"] = name, "*"
    elif facts["metavar"] == SWITCH:
        kind = {"action": argparse.BooleanOptionalAction}
    parser.add_argument(option, help=facts["help"], **kind)


def add_settings(parser, command):
    """Add all settings of a command in their groups, ``--config`` and the workers."""
    boxes = {group: parser.add_argument_group(group) for group in GROUPS}
    for name, facts in OPTIONS.items():
        if command in facts["commands"] and facts["metavar"] is not None:
            add_setting(boxes[facts["group"]], name)
    parser.add_argument("--config", metavar="FILE.toml", help="read settings from here")
    add_workers(parser)


def add_option(parser, option, metavar, text, **kind):
    """Add an option that has a value."""
    parser.add_argument(option, metavar=metavar, help=text, **kind)


def add_switches(parser, *, default=False, **texts):
    """Add options without a value, each with its help."""
    for name, text in texts.items():
        parser.add_argument(
            option_name(name), action="store_true", default=default, help=text
        )


def add_output(
    parser, what, *, default=None, votable=None, overwrite=True, report=False
):
    """Add ``--output``, required without a default, and options on what is written."""
    parser.add_argument(
        *("-o", "--output"),
        metavar="DIR",
        required=default is None,
        default=None if default == OF_OBJECT else default,
        help=f"folder for {what}" + (f"; default {default}" if default else ""),
    )
    if overwrite:
        add_overwrite(parser)
    if votable:
        text = f"write {votable} too, for TOPCAT, STILTS and Aladin"
        add_switches(parser, votable=text)
    if report:
        add_switches(parser, no_report="write no report.html and figures")


def add_overwrite(parser):
    """Add ``--overwrite``."""
    text = "replace what is in the folder under the same names"
    add_switches(parser, overwrite=text)


def add_workers(parser):
    """Add the options ``--workers`` and ``--scheduler``."""
    group = parser.add_argument_group("running")
    text = (
        "processes; the numbers do not depend on it; by default one, and one per core "
        "for more than three million pixels"
    )
    add_option(group, "--workers", "N", text, type=int)
    text = "of a Dask cluster that works instead, tcp://node1:8786"
    add_option(group, "--scheduler", "ADDRESS", text)
