# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The program: its commands, and the handling of errors and signals."""

import argparse
import os
import re
import signal
import sys
from contextlib import ExitStack, contextmanager, suppress
from textwrap import dedent

from astro_scc import __version__
from astro_scc.cli import (
    explore,
    inspect,
    measure,
    profile,
    restore,
    simulate,
    survey,
    track,
)
from astro_scc.cli.arguments import add_switches
from astro_scc.cli.reporter import Reporter
from astro_scc.settings import OPTIONS

# Errors that a user can correct, missing extras among them; other exceptions are
# mistakes of the program.
USER_ERRORS = (ValueError, TypeError, OSError, MemoryError, ImportError)
# Signals handled like an interrupt: from `kill` and batch systems, and from a terminal
# that is closed.
SIGNALS = ("SIGTERM", "SIGHUP")
COMMANDS = (
    simulate.Demo, simulate, restore, inspect, measure, explore, profile, track, survey,
)  # fmt: skip


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def __init__(self, **options):
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(allow_abbrev=False, **options)
        # "-112deg" must be a value, not an option, as "-112" already is to argparse.
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def parse_known_args(self, args=None, namespace=None):
        """Refuse unknown arguments in the name of the command that got them."""
        known, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return known, unknown

    def error(self, message):
        """Print the error as one line and exit with status 2."""
        self.exit(2, f"{self.prog}: error: {message}; see {self.prog} --help\n")


class Ended(KeyboardInterrupt):
    """The program got one of `SIGNALS`, whose number is the argument."""


def _end(number, frame):
    raise Ended(number)


class Completion(argparse.Action):
    """Print what a shell needs to complete commands, options and files, and end."""

    def __call__(self, parser, namespace, values, option_string=None):
        try:
            import shtab
        except ImportError:
            parser.error(f"{option_string} needs shtab: pip install shtab")
        print(shtab.complete(parser, values))
        parser.exit()


@contextmanager
def _ended_by_signals():
    """Clean up after `SIGNALS`, unless other code handles or ignores them."""
    with ExitStack() as stack:
        for name in SIGNALS:
            number = getattr(signal, name, None)
            # Only the main thread may set handlers; elsewhere the host decides.
            with suppress(ValueError):
                if number and signal.getsignal(number) is signal.SIG_DFL:
                    stack.callback(signal.signal, number, signal.signal(number, _end))
        yield


def build_parser():
    """
    Return the parser of the whole command line.

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
    parser.add_argument(
        "--print-completion", action=Completion, choices=("bash", "zsh", "tcsh"),
        help="print the completion of commands and options for a shell (needs shtab)",
    )  # fmt: skip
    commands = parser.add_subparsers(
        title="commands", metavar="COMMAND", dest="command", required=True
    )
    for module in COMMANDS:
        # The docstring of a command is its help; python -OO has no docstrings.
        doc = dedent(module.__doc__ or "").strip()
        brief, text, more = [*doc.split("\n\n", 2), "", "", ""][:3]
        command = commands.add_parser(
            module.__name__.rpartition(".")[2].lower(),
            help=brief[:1].lower() + brief[1:].rstrip("."),
            description=text,
            epilog=more,
        )
        module.add_arguments(command)
        command.set_defaults(run=module.run)
        group = command.add_argument_group("messages")
        quiet = "print errors only: no warnings, progress or summary"
        add_switches(group, quiet=quiet, debug=argparse.SUPPRESS)
    return parser


def main(argv: list[str] | None = None) -> int:
    """
    Run the command line.

    Parameters
    ----------
    argv : list of str, optional
        Arguments, by default those of the process.

    Returns
    -------
    int
        Exit status: 0, 2 for errors that the user can correct, 130 when
        interrupted, 143 when terminated.

    Raises
    ------
    SystemExit
        After ``--help`` and for invalid arguments.
    """
    args = build_parser().parse_args(argv)
    options = [name for name in OPTIONS if name in vars(args) and name != "epochs"]
    name = f"astro-scc {args.command}"
    reporter = Reporter(name, quiet=args.quiet, settings=options)
    try:
        with _ended_by_signals(), reporter.warnings_as_lines():
            args.run(args, reporter)
        sys.stdout.flush()
    except KeyboardInterrupt as error:
        if args.debug:
            raise
        goes_on = "; the same command goes on from what is done"
        kept = goes_on if reporter.resumes else ", nothing was written"
        reporter.error(f"interrupted{kept}")
        return 128 + (error.args[0] if isinstance(error, Ended) else signal.SIGINT)
    except BrokenPipeError:
        # The reader of the output has closed the pipe, as `head` does.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except USER_ERRORS as error:
        if args.debug:
            raise
        reporter.error(error)
        return 2
    return 0
