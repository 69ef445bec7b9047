# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What an `EpochCube` accepts, turned into what it holds."""

import warnings

import astropy.units as u
import numpy as np
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.epochs.beam import Beam
from astro_scc.epochs.keywords import parse_date

__all__ = [
    "as_beam",
    "as_beams",
    "as_celestial",
    "as_epoch_tuple",
    "as_mask",
    "as_noise",
    "as_stack",
    "as_times",
    "date_labels",
]


def as_stack(data, mask, unit):
    """Data as float64 (epoch, y, x), the mask and the unit."""
    if isinstance(data, u.Quantity):
        if unit is None or unit == u.dimensionless_unscaled:
            unit = data.unit
        data = data.to_value(unit)
    if isinstance(data, np.ma.MaskedArray):
        inner = np.ma.getmaskarray(data)
        mask = inner if mask is None else inner | np.asarray(mask, dtype=bool)
        data = data.data
    try:
        data = np.asarray(data)
        if data.dtype.kind not in "fiub":
            raise TypeError(f"it is of type {data.dtype}")
    except (TypeError, ValueError) as error:
        raise TypeError(f"data must be an array of real numbers: {error}") from None
    if data.ndim != 3 or 0 in data.shape:
        raise ValueError(f"data must have shape (n_epochs, ny, nx), got {data.shape}")
    try:
        unit = u.dimensionless_unscaled if unit is None else u.Unit(unit)
    except (TypeError, ValueError):
        raise ValueError(f"unit {unit!r} is not one that astropy knows") from None
    return data.astype(np.float64, copy=False), mask, unit


def as_mask(data, mask, labels):
    """The mask with the pixels that are not finite added."""
    bad = ~np.isfinite(data)
    if mask is not None:
        mask = np.asarray(mask)
        if mask.shape != data.shape:
            raise ValueError(f"mask has shape {mask.shape}, data has {data.shape}")
        bad |= mask.astype(bool)
    empty = np.flatnonzero(bad.all(axis=(1, 2)))
    if empty.size:
        raise ValueError(f"{labels[empty[0]]}: no valid pixel; leave this epoch out")
    return bad


def as_times(times, n):
    """Dates as a Time of shape (n,)."""
    if not isinstance(times, Time):
        if isinstance(times, str) or not np.iterable(times):
            times = [times]
        dates = []
        for value in times:
            if isinstance(value, str):
                dates.append(parse_date(value))
                continue
            try:
                dates.append(Time(value))
            except (TypeError, ValueError):
                raise TypeError(
                    f"times must be a Time or strings such as '2006-03-09', "
                    f"got {value!r}"
                ) from None
        times = Time(dates) if dates else Time([], format="jd")
    times = times.reshape(1) if times.isscalar else times
    if times.shape != (n,):
        raise ValueError(f"{n} epochs need {n} times, got shape {times.shape}")
    if np.any(times.mask):
        raise ValueError("every epoch needs a date, times has missing values")
    with warnings.catch_warnings(record=True) as dubious:
        warnings.simplefilter("always")
        atomic = times.tai
    # Photographic plates are older than UTC; with it every use would warn.
    return atomic if dubious else times


def as_beam(beam):
    """A `Beam` from one, or from what has major, minor and pa."""
    if isinstance(beam, Beam):
        return beam
    try:
        return Beam(*(u.Quantity(getattr(beam, k)) for k in ("major", "minor", "pa")))
    except AttributeError:
        raise TypeError(
            f"a beam has major, minor and pa, got {type(beam).__name__} {beam!r}"
        ) from None


def as_beams(beams, n):
    """One beam an epoch, or None."""
    if beams is None:
        return None
    if hasattr(beams, "major"):
        return (as_beam(beams),) * n
    return as_epoch_tuple(beams, n, "beams", as_beam)


def as_noise(noise, n, unit):
    """Noise of shape (n,) in the unit of the data, or None."""
    if noise is None:
        return None
    try:
        noise = u.Quantity(noise).to(unit)
    except (TypeError, u.UnitConversionError):
        raise TypeError(f"noise must be a Quantity in {unit}, got {noise!r}") from None
    if noise.shape not in ((), (n,)):
        raise ValueError(f"{n} epochs need {n} noises, got shape {noise.shape}")
    if not np.all(np.isfinite(noise) & (noise.value >= 0)):
        raise ValueError("noise must be finite and not negative")
    return noise if noise.shape else np.repeat(noise, n)


def as_celestial(wcs):
    """The celestial part of a WCS, two axes without distortions."""
    wcs = getattr(wcs, "low_level_wcs", wcs)
    if not isinstance(wcs, WCS):
        raise TypeError(f"wcs must be an astropy WCS, got {type(wcs).__name__}")
    if not wcs.has_celestial:
        raise ValueError(f"wcs must have celestial axes, got {list(wcs.wcs.ctype)}")
    if wcs.naxis != 2:
        wcs = wcs.celestial
    if wcs.wcs.lng > wcs.wcs.lat:
        raise ValueError("wcs has latitude on its first axis; transpose the images")
    if wcs.has_distortion:
        raise ValueError(
            "the grid of a cube has no distortions; EpochCube.from_ccddata resamples"
        )
    return wcs


def as_epoch_tuple(values, n, name, convert):
    """One value an epoch as a tuple, empty where there are none."""
    values = () if values is None else tuple(convert(v) for v in values)
    if values and len(values) != n:
        raise ValueError(f"{n} epochs need {n} {name}, got {len(values)}")
    return values


def date_labels(times):
    """Dates as short text, with the time of day where dates alone are equal."""
    text = [value[:10] for value in times.isot]
    if len(set(text)) < len(text):
        text = [value[:19] for value in times.isot]
    return tuple(text)
