# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the settings of a measurement must be, and in which units they are kept."""

import astropy.units as u
import numpy as np

from astro_scc.measurement.stacking import NAMED_FRAMES
from astro_scc.measurement.tables import PM_UNIT
from astro_scc.stacking import NULL_HYPOTHESES

__all__ = ["REQUIREMENTS", "different_scales"]


def _in_unit(name, value, unit):
    try:
        return u.Quantity(value).to(unit)
    except u.UnitConversionError:
        raise u.UnitConversionError(
            f"{name} must be in a unit like {unit}, got {value}"
        ) from None


def _max_speed(value):
    if value is None:
        return None
    speed = _in_unit("max_speed", value, PM_UNIT)
    if not (speed.isscalar and 0 < speed.value < np.inf):
        raise ValueError(f"max_speed must be one positive speed, got {speed}")
    return speed


def _baseline(value):
    if value is None:
        return None
    baseline = _in_unit("baseline", value, u.yr)
    if baseline.shape != (2,) or not 0 <= baseline[0] <= baseline[1]:
        raise ValueError(
            f"baseline must be a shortest and a longest time, got {baseline}"
        )
    return baseline


def _position_angle(value):
    if isinstance(value, str):
        if value not in NAMED_FRAMES:
            raise ValueError(
                "position_angle must be an angle, 'radial', 'ridge' or 'fit', "
                f"got {value!r}"
            )
        return value
    if value is None or hasattr(value, "matrix"):
        return value
    angle = _in_unit("position_angle", value, u.deg)
    if not (angle.isscalar and np.isfinite(angle)):
        raise ValueError(f"position_angle must be one finite angle, got {angle}")
    return angle


def _nulls(value):
    names = (value,) if isinstance(value, str) else tuple(value)
    unknown = [name for name in names if name not in NULL_HYPOTHESES]
    if unknown or not names:
        raise ValueError(
            f"nulls must be of {', '.join(NULL_HYPOTHESES)}, "
            f"got {', '.join(map(repr, unknown)) or 'none'}"
        )
    return names


def _alignment_error(value):
    if value is None:
        return None
    error = _in_unit("alignment_error", value, u.mas)
    if error.ndim > 1 or not np.all((error >= 0) & np.isfinite(error)):
        raise ValueError(
            f"alignment_error must be zero or positive angles, got {error}"
        )
    return error


def _level(value):
    if not 0 < value < 1:
        raise ValueError(f"level must be between 0 and 1, got {value}")
    return value


def _kernel(value):
    if not 0 < value < 5:
        raise ValueError(f"kernel must be a part of the beam, got {value}")
    return value


def _scales(value):
    if isinstance(value, u.Quantity):
        sizes = _in_unit("scales", value, u.mas).value
        if np.size(sizes) == 0 or not np.all((sizes > 0) & np.isfinite(sizes)):
            raise ValueError(f"scales must be positive angles, got {value}")
        return value
    return different_scales(tuple(float(s) for s in np.atleast_1d(value)))


def different_scales(scales):
    """
    The scales, if none is there twice.

    Parameters
    ----------
    scales : tuple of float
        Their numbers.

    Returns
    -------
    tuple of float

    Raises
    ------
    ValueError
        If two are the same.
    """
    if len(set(scales)) < len(scales):
        raise ValueError(
            f"scales must differ, got {', '.join(f'{s:g}' for s in scales)}: leave out "
            "what is there twice"
        )
    return scales


#: By the name of the setting: what makes its value, or raises.
REQUIREMENTS = {
    "max_speed": _max_speed,
    "baseline": _baseline,
    "position_angle": _position_angle,
    "nulls": _nulls,
    "alignment_error": _alignment_error,
    "level": _level,
    "kernel": _kernel,
    "scales": _scales,
}
