# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Values of the cards of a header, or of a dict with the same keys."""

from contextlib import suppress

import numpy as np
from astropy.io import fits


def get(header, *keywords, kind=None):
    """
    Return the value of the first of some keywords that has one, or None.

    Keys of a dict may be in upper or lower case.  Values that cannot be converted
    to ``kind`` (float or str), empty strings and numbers that are not finite count
    as absent.
    """
    for keyword in (key for name in keywords for key in (name, name.lower())):
        with suppress(KeyError, ValueError, fits.VerifyError):
            value = header[keyword]
            if value is None or isinstance(value, fits.card.Undefined):
                continue
            if kind is str:
                value = str(value).strip()
            elif kind is float:
                value = float(str(value).replace("D", "E"))
            if value if kind is str else kind is None or np.isfinite(value):
                return value
    return None


def axis_numbers(header, axis):
    """Return CRVAL (or None), CRPIX and CDELT (or their defaults) of an axis."""
    pixel = get(header, f"CRPIX{axis}", kind=float)
    return (
        get(header, f"CRVAL{axis}", kind=float),
        1.0 if pixel is None else pixel,
        get(header, f"CDELT{axis}", kind=float) or 0.0,
    )


def axis_of(header, name):
    """Return the number of the axis whose CTYPE starts with a name, None without."""
    for axis in range(1, 10):
        if (get(header, f"CTYPE{axis}", kind=str) or "").upper().startswith(name):
            return axis
    return None


def axis_value(header, name):
    """Return the world coordinate of the first pixel of a degenerate axis."""
    axis = axis_of(header, name)
    if axis is None:
        return None
    value, pixel, step = axis_numbers(header, axis)
    return None if value is None else value + (1 - pixel) * step
