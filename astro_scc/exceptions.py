# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Warnings and errors of the package; most are ValueError, TypeError and OSError."""

import os
import sys
import warnings
from contextlib import contextmanager

from astropy.utils.exceptions import AstropyUserWarning

__all__ = ["AstroSccWarning", "EpochWarning", "MeasurementWarning"]


class AstroSccWarning(AstropyUserWarning):
    """
    Base class of every warning that `astro_scc` issues.

    Examples
    --------
    >>> from astro_scc.exceptions import AstroSccWarning, EpochWarning
    >>> issubclass(EpochWarning, AstroSccWarning)
    True
    """


class EpochWarning(AstroSccWarning):
    """
    Warning that part of an epoch's file or header was guessed, repaired or left out.

    Examples
    --------
    >>> import warnings
    >>> from astro_scc.exceptions import EpochWarning
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore", EpochWarning)
    """


class MeasurementWarning(AstroSccWarning):
    """
    Warning that the data support a measurement less well than the user may think.

    Examples
    --------
    >>> import warnings
    >>> from astro_scc.exceptions import MeasurementWarning
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore", MeasurementWarning)
    """


class NoFlowError(ValueError):
    """
    Error that nothing in the images is bright enough to be measured.

    Examples
    --------
    >>> from astro_scc.exceptions import NoFlowError
    >>> issubclass(NoFlowError, ValueError)
    True
    """


def warn(message, category=EpochWarning):
    """Warn the first caller outside this package."""
    here = os.path.dirname(__file__) + os.sep
    level, frame = 1, sys._getframe()
    while frame and frame.f_code.co_filename.startswith(here):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)


def first_line(error):
    """Return the first line of an error's message."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


@contextmanager
def naming(name):
    """Begin the messages of the errors that are raised inside with a name."""
    try:
        yield
    except (OSError, TypeError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from None


@contextmanager
def refusing(message, *kinds, error=ValueError):
    """Raise an error with a message instead of those of some kinds inside."""
    try:
        yield
    except kinds:
        raise error(message) from None


@contextmanager
def naming_all(name, kind=ValueError):
    """Make every error inside, of whatever parser, one line that begins with a name."""
    try:
        yield
    except Exception as error:
        raise kind(f"{name}: {first_line(error)}") from None
