# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The program: its commands, and what becomes of errors and warnings."""

import argparse
import os
import re
import sys

from astro_scc import __version__
from astro_scc.cli import (
    demo,
    inspect,
    measure,
    profile,
    restore,
    simulate,
    survey,
    track,
)
from astro_scc.cli.reporter import Reporter

__all__ = ["main"]

# What a user gets wrong, extras that are not installed among it; other exceptions
# are mistakes of the program.
USER_ERRORS = (ValueError, TypeError, OSError, MemoryError, ImportError)
COMMANDS = (demo, simulate, restore, inspect, measure, profile, track, survey)


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def __init__(self, **options):
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(allow_abbrev=False, **options)
        # "-112deg" is an angle and no option, as argparse takes "-112" for one.
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message):
        """Leave with one line and status 2."""
        self.exit(2, f"{self.prog}: error: {message}; see {self.prog} --help\n")


def build_parser():
    """
    The parser of the whole command line.

    Returns
    -------
    `argparse.ArgumentParser`
    """
    parser = Parser(
        prog="astro-scc",
        description="How many speeds are in this jet?  Velocities in images of many "
        "dates\nby stacked cross-correlation (Mertens & Lobanov 2016).",
        epilog="astro-scc COMMAND --help explains a command.  Start with: "
        "astro-scc demo",
    )
    parser.add_argument(
        "--version", action="version", version=f"%(prog)s {__version__}"
    )
    commands = parser.add_subparsers(
        title="commands", metavar="COMMAND", dest="command", required=True
    )
    for module in COMMANDS:
        command = module.add_parser(commands)
        command.set_defaults(run=module.run)
        group = command.add_argument_group("messages")
        group.add_argument(
            "--quiet",
            action="store_true",
            help="print errors only: no warnings, progress or summary",
        )
        group.add_argument("--debug", action="store_true", help=argparse.SUPPRESS)
    return parser


def main(argv=None):
    """
    Run the command line.

    Parameters
    ----------
    argv : list of str, optional
        Arguments; those of the process when not given.

    Returns
    -------
    int
        Exit status: 0, 2 for what the user can mend, 130 when interrupted.

    Raises
    ------
    SystemExit
        After ``--help`` and for arguments that are not understood.
    """
    args = build_parser().parse_args(argv)
    reporter = Reporter(f"astro-scc {args.command}", quiet=args.quiet)
    try:
        with reporter.warnings_as_lines():
            args.run(args, reporter)
        sys.stdout.flush()
    except KeyboardInterrupt:
        if args.debug:
            raise
        reporter.error(reporter.on_interrupt)
        return 130
    except BrokenPipeError:
        # The reader of the output has gone, as `head` does.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except USER_ERRORS as error:
        if args.debug:
            raise
        reporter.error(error)
        return 2
    return 0
