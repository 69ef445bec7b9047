# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Messages of a command: results, notes, warnings and errors."""

import re
import sys
from contextlib import contextmanager

from astro_scc.cli.arguments import option_name


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
    >>> from astro_scc.cli.reporter import one_line
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
    bars : bool
        Whether to show progress as bars, which needs a terminal.
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
        self.bars = self.progress and sys.stderr.isatty()

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
            warnings.showwarning = show
            yield
