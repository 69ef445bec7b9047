# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Warnings of the package; errors are ValueError, TypeError and OSError."""

from astropy.utils.exceptions import AstropyUserWarning

__all__ = ["AstroSccWarning", "EpochWarning", "MeasurementWarning"]


class AstroSccWarning(AstropyUserWarning):
    """Base class of every warning that `astro_scc` issues."""


class EpochWarning(AstroSccWarning):
    """Something in an epoch's file or header was guessed, repaired or left out."""


class MeasurementWarning(AstroSccWarning):
    """The data do not support what was asked for as well as the user may think."""
