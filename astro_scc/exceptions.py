# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Warnings of the package; errors are ValueError, TypeError and OSError."""

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
