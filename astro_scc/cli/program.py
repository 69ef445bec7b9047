# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
The program: its parser, its messages, and the handling of errors and signals.

Options of settings are made from `Settings`; ``commands.toml`` has the others and the
commands.  What a command does is a function of its name in another module, which takes
seconds to import.
"""

import argparse
import atexit
import gc
import os
import re
import signal
import sys
import tomllib
from contextlib import contextmanager
from importlib import import_module, resources

from astro_scc import __version__
from astro_scc.settings import GROUPS, OPTIONS
from astro_scc.writing import handled

#: The commands as ``commands.toml`` has them, and the options that are no settings.
with resources.files("astro_scc.cli").joinpath("commands.toml").open("rb") as file:
    COMMANDS = tomllib.load(file)
OWN = COMMANDS.pop("options")
TYPES = {"int": int, "float": float}
# Errors that a user can correct, missing extras among them; other exceptions are
# mistakes of the program.
USER_ERRORS = (ValueError, TypeError, OSError, MemoryError, ImportError)
# Signals handled like an interrupt: from `kill` and batch systems, and from a terminal
# that is closed.
SIGNALS = ("SIGTERM", "SIGHUP")


def option_name(name):
    """Return the option of a setting or argument as it is typed."""
    return f"--{name.replace('_', '-')}"


def one_line(error):
    """
    Return an error as one line that begins with the file, if there is one.

    Parameters
    ----------
    error : Exception or str

    Returns
    -------
    str

    Examples
    --------
    >>> from astro_scc.cli.program import one_line
    >>> try:
    ...     open("nothing.fits")
    ... except OSError as error:
    ...     print(one_line(error))
    nothing.fits: No such file or directory
    """
    text = str(error)
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        text = f"{error.filename}: {error.strerror}"
    elif isinstance(error, MemoryError) and "this machine has" not in text:
        text = f"not enough memory; --crop reads a part of the images ({text})"
    return " ".join(text.split()) or type(error).__name__


def _print(text, file):
    # Names from files may have control codes, or letters that the terminal lacks.
    text = "".join(
        c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text
    )
    encoding = getattr(file, "encoding", None) or "utf-8"
    print(text.encode(encoding, "backslashreplace").decode(encoding), file=file)


class Reporter:
    """
    Print messages of a command: results to standard output, others to standard error.

    Parameters
    ----------
    name : str
        Name of the command.
    quiet : bool, optional
        Print errors only.
    settings : iterable of str, optional
        Settings that are options here: warnings and errors name the options, where
        the library names the settings.

    Attributes
    ----------
    warnings : list of str
        All warnings that were issued, each once.
    progress : bool
        Whether to show progress.
    resumes : bool
        Whether the same command goes on where it was interrupted.
    """

    def __init__(self, name, *, quiet=False, settings=()):
        self.name = name
        self.settings = settings
        self.quiet = quiet
        self.warnings = []
        self.resumes = False
        self.progress = not quiet

    def say(self, *lines):
        """Print a result."""
        if not self.quiet:
            _print("\n".join(lines), sys.stdout)

    def note(self, text):
        """Print a note on what was decided or left out."""
        if not self.quiet:
            _print(f"note: {text}", sys.stderr)

    def warn(self, text):
        """Print and keep a warning the first time it is given."""
        text = self._as_typed(text)
        if text not in self.warnings:
            self.warnings.append(text)
            if not self.quiet:
                _print(f"warning: {text}", sys.stderr)

    def error(self, error):
        """Print an error."""
        _print(f"{self.name}: error: {self._as_typed(error)}", sys.stderr)

    def _as_typed(self, error):
        """Return a message as one line, with options in place of the settings."""
        text = one_line(error)
        for name in self.settings:
            # Most names are words, too; and what follows a colon is of a file.
            place = r"(?<!: )\b" if "_" in name else "^"
            text = re.sub(rf"{place}{name}( =)?(?=[ ,]|$)", option_name(name), text)
        return text

    @contextmanager
    def warnings_as_lines(self):
        """
        Print each warning as a line and keep it, within this context.

        Yields
        ------
        None
        """
        import warnings

        # Astropy replaces the function that shows warnings when it is imported, so
        # it must be imported first.
        from astropy.utils.exceptions import AstropyWarning

        def show(message, category, filename, lineno, file=None, line=None):
            self.warn(str(message))

        with warnings.catch_warnings():
            warnings.filterwarnings("always", category=AstropyWarning)
            # What ERFA says of leap seconds to come concerns no user.
            warnings.filterwarnings("ignore", "ERFA function")
            warnings.showwarning = show
            yield


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


def _end(number, frame):
    """End as after an interrupt, with the number of the signal."""
    raise KeyboardInterrupt(number)


class Completion(argparse.Action):
    """Print what a shell needs to complete commands, options and files, and end."""

    def __call__(self, parser, namespace, values, option_string=None):
        try:
            import shtab
        except ImportError:
            parser.error(f"{option_string} needs shtab: pip install shtab")
        print(shtab.complete(parser, values))
        parser.exit()


class Once(argparse.Action):
    """Store the value of an option that may be given once."""

    def __call__(self, parser, namespace, values, option_string=None):
        if option_string and getattr(namespace, self.dest, None) is not self.default:
            raise argparse.ArgumentError(self, "is given twice; give it once")
        setattr(namespace, self.dest, values)


@contextmanager
def _seldom_collected(made=100_000):
    """
    Let Python look for unreachable objects when so many are made.

    By default it does so 350 times while it imports and measures, for a twentieth of
    the time.
    """
    before = gc.get_threshold()
    gc.set_threshold(made, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def _add(parser, arguments):
    """Add options and settings by their names, and what argparse takes."""
    for argument in arguments:
        if isinstance(argument, str):
            name, flags = argument, {"flags": option_name(argument)}
            if name == "epochs":
                flags = {"flags": name, "nargs": "*"}
            known = OWN.get(name) or {k: OPTIONS[name][k] for k in ("help", "metavar")}
            argument = flags | known
        options = argument.copy()
        flags, kind = options.pop("flags").split(), options.pop("type", None)
        if options.pop("once", False):
            options["action"] = Once
        if options.get("metavar") == "true|false":
            del options["metavar"]
            options["action"] = argparse.BooleanOptionalAction
        elif "metavar" in options or "choices" in options:
            options["type"] = TYPES.get(kind, str)
        else:
            options["action"] = "store_true"
        parser.add_argument(*flags, **options)


def build_parser():
    """
    Return the parser of the command line.

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
    for name, about in COMMANDS.items():
        texts = {key: about[key] for key in ("help", "description", "epilog")}
        command = commands.add_parser(name, **texts)
        _add(command, about["arguments"])
        settings = [
            (facts["group"], setting)
            for setting, facts in OPTIONS.items()
            if name in facts["commands"] and facts["metavar"]
        ]
        for group in GROUPS if settings else ():
            names = (setting for place, setting in settings if place == group)
            _add(command.add_argument_group(group), names)
        if settings:
            _add(command, ["config"])
        for group, names in about.get("groups", {}).items():
            _add(command.add_argument_group(group), names)
        _add(command.add_argument_group("messages"), ["quiet"])
        command.add_argument("--debug", action="store_true", help=argparse.SUPPRESS)
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
    if argv is None:
        # The process is ours: looking for unreachable objects at its end takes longer
        # than many a command.
        atexit.register(gc.freeze)
    args = build_parser().parse_args(argv)
    options = [name for name in OPTIONS if name in vars(args) and name != "epochs"]
    name = f"astro-scc {args.command}"
    reporter = Reporter(name, quiet=args.quiet, settings=options)
    try:
        ended = handled(_end, SIGNALS, only_default=True)
        with _seldom_collected(), ended, reporter.warnings_as_lines():
            module = COMMANDS[args.command]["module"]
            module = import_module(f"astro_scc.cli.{module}")
            getattr(module, args.command)(args, reporter)
        sys.stdout.flush()
    except KeyboardInterrupt as error:
        if args.debug:
            raise
        goes_on = "; the same command goes on from what is done"
        kept = goes_on if reporter.resumes else ", nothing was written"
        reporter.error(f"interrupted{kept}")
        return 128 + (error.args[0] if error.args else signal.SIGINT)
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
