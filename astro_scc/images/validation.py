# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Conversion of what users give into the fields of a series of images."""

import operator
from contextlib import contextmanager
from numbers import Integral

import astropy.units as u
import numpy as np
from astropy.nddata import (
    InverseVariance,
    NDData,
    StdDevUncertainty,
    VarianceUncertainty,
)
from astropy.time import Time
from astropy.utils.masked import Masked
from astropy.wcs import WCS

from astro_scc.images.beam import as_beam
from astro_scc.quantities import parse_date, without_doubt

#: Power that turns an uncertainty into a standard deviation.
POWERS = {StdDevUncertainty: 1, VarianceUncertainty: 0.5, InverseVariance: -0.5}
#: Factor by which uncertainties of pixels may differ from the image's median.
EVEN = 1.5
UNEVEN = (
    "its uncertainty differs from pixel to pixel, and the median is taken for the "
    "noise; leave it out to have the noise measured"
)


@contextmanager
def naming(name):
    """Put the name of an image before the message of an error, a ValueError then."""
    try:
        yield
    except (OSError, TypeError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from None


def as_stack(data, mask, unit):
    """Return data as float64 (epoch, y, x), the mask and the unit."""
    images = data if isinstance(data, list | tuple) else [data]
    if any(isinstance(image, NDData) for image in images):
        raise TypeError(
            "data are images with unit, mask and coordinates of their own; use "
            "EpochCube.from_ccddata or from_ndcube, which keep them"
        )
    try:
        unit = u.Unit("" if unit is None else unit)
    except (TypeError, ValueError):
        raise ValueError(f"unit {unit!r} is not one that astropy knows") from None
    try:
        if images is data and data:
            plain = any(isinstance(image, np.ma.MaskedArray) for image in data)
            data = (np.ma.stack if plain else np.stack)(data)
        if isinstance(data, Masked | np.ma.MaskedArray):
            inner = np.broadcast_to(data.mask, data.shape)
            mask = inner if mask is None else inner | np.asarray(mask, dtype=bool)
            data = data.unmasked if isinstance(data, Masked) else data.data
        if isinstance(data, u.Quantity):
            unit = data.unit if unit == u.dimensionless_unscaled else unit
            data = data.to_value(unit)
        data = as_numbers(data)
    except (TypeError, ValueError, u.UnitsError) as error:
        raise TypeError(
            f"data must be images of real numbers in one unit: {error}"
        ) from None
    if data.ndim != 3 or 0 in data.shape:
        raise ValueError(f"data must have shape (n_epochs, ny, nx), got {data.shape}")
    return data, mask, unit


def as_numbers(data):
    """Return an array as float64."""
    data = np.asarray(data)
    if data.dtype.kind not in "fiub":
        raise TypeError(f"they are of type {data.dtype}")
    return data.astype(np.float64, copy=False)


def as_mask(data, mask):
    """Return the mask, to which pixels that are not finite are added."""
    bad = ~np.isfinite(data)
    if mask is not None:
        mask = np.asarray(mask)
        if mask.shape != data.shape:
            raise ValueError(f"mask has shape {mask.shape}, data has {data.shape}")
        bad |= mask.astype(bool)
    return bad


def as_times(times, n):
    """Return dates as a Time of shape (n,)."""
    if not isinstance(times, Time):
        if isinstance(times, str) or not np.iterable(times):
            times = [times]
        try:
            dates = [parse_date(t) if isinstance(t, str) else Time(t) for t in times]
        except (TypeError, ValueError) as error:
            if all(isinstance(value, str) for value in times):
                raise
            raise TypeError(
                f"times must be a Time or strings such as '2006-03-09', got {times!r}"
            ) from error
        times = Time(dates) if dates else Time([], format="jd")
    times = times.reshape(1) if times.isscalar else times
    if times.shape != (n,):
        raise ValueError(f"{n} epochs need {n} times, got shape {times.shape}")
    if np.any(times.mask):
        raise ValueError("every epoch needs a date, times has missing values")
    return without_doubt(times)


def order_of(times):
    """Return the order of dates, of which equal ones stay as they are."""
    return np.argsort((times - times[0]).jd, kind="stable")


def as_beams(beams, n):
    """Return one beam per epoch, or None."""
    beams = [beams] * n if hasattr(beams, "major") else beams
    return as_epoch_tuple(beams, n, "beams", as_beam)


def as_noise(noise, n, unit):
    """Return noise of shape (n,) in the unit of the data, or None."""
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


def uncertainty_noise(uncertainty, unit, mask):
    """
    Return the noise of an image whose pixels have uncertainties.

    The noise is the median standard deviation of the valid pixels, in the ``unit`` of
    the image, which is also assumed for an NDUncertainty without a unit.  The function
    also returns a mask of the pixels without a finite standard deviation, and whether
    the pixels differ little.  An uncertainty that cannot be used raises a ValueError.
    """
    kind, given = type(uncertainty).__name__, uncertainty.unit
    power = next((p for k, p in POWERS.items() if isinstance(uncertainty, k)), None)
    if power is None:
        names = ", ".join(kind.__name__ for kind in POWERS)
        raise ValueError(f"its uncertainty is a {kind}; give it as {names}, or as None")
    values = np.asarray(uncertainty.array, dtype=float)
    if np.any(values < 0):
        raise ValueError("its uncertainty has negative values; correct or remove it")
    try:
        factor = 1.0 if given is None else (given**power).to(unit)
    except u.UnitConversionError:
        raise ValueError(
            f"its uncertainty is a {kind} in {given}, which does not fit images in "
            f"{unit.to_string() or 'no unit'}; correct or remove it"
        ) from None
    with np.errstate(divide="ignore"):
        sigma = np.broadcast_to(values**power * factor, mask.shape)
    bad = ~np.isfinite(sigma)
    valid = sigma[~(mask | bad)]
    if valid.size == 0:
        raise ValueError("its uncertainty is finite at no valid pixel; remove it")
    noise = np.median(valid)
    even = valid.max() <= EVEN * noise and noise <= EVEN * valid.min()
    return noise * unit, bad, bool(even)


def fits_wcs(wcs):
    """
    Return the FITS WCS behind a WCS that was sliced or resampled.

    Images that were sliced or rebinned have a
    `~astropy.wcs.wcsapi.SlicedLowLevelWCS` or a
    `ndcube.wcs.wrappers.ResampledLowLevelWCS` around a WCS; both are understood.

    Returns
    -------
    wcs : `~astropy.wcs.WCS`
        With all axes; an axis sliced to one pixel starts at that pixel.
    size : `~numpy.ndarray`
        Number of original pixels per pixel along each axis.
    kept : `~numpy.ndarray` of bool
        Axes that the image still has.
    """
    wcs = getattr(wcs, "low_level_wcs", wcs)
    if isinstance(wcs, WCS):
        return wcs, np.ones(wcs.naxis), np.ones(wcs.naxis, dtype=bool)
    single, step = False, 1.0
    if hasattr(wcs, "_slices_pixel"):
        single = [isinstance(part, Integral) for part in wcs._slices_pixel]
        start = [getattr(part, "start", part) or 0 for part in wcs._slices_pixel]
    elif hasattr(wcs, "_factor"):
        start, step = wcs._offset, wcs._factor
    else:
        raise TypeError(f"wcs must be a WCS, or one sliced, got {type(wcs).__name__}")
    wcs, size, kept = fits_wcs(wcs._wcs)
    wcs, kept = wcs.deepcopy(), kept.copy()
    axes = np.flatnonzero(kept)
    crpix = wcs.wcs.crpix.copy()
    crpix[axes] = (crpix[axes] - 0.5 - start) / step + 0.5
    if np.any(step != 1):
        size[axes] *= step
        matrix = wcs.pixel_scale_matrix
        matrix[:, axes] *= step
        del wcs.wcs.cd, wcs.wcs.crota
        wcs.wcs.cdelt, wcs.wcs.pc = np.ones(len(matrix)), matrix
    wcs.wcs.crpix = crpix
    wcs.wcs.set()
    wcs.pixel_shape = None
    kept[axes] = np.logical_not(single)
    return wcs, size, kept


def as_celestial(wcs):
    """Return the celestial part of a WCS, two axes without distortions."""
    wcs, _, kept = fits_wcs(wcs)
    if not wcs.has_celestial:
        raise ValueError(f"wcs must have celestial axes, got {list(wcs.wcs.ctype)}")
    if not kept[[wcs.wcs.lng, wcs.wcs.lat]].all():
        raise ValueError("wcs has lost a celestial axis by slicing; slice images only")
    if wcs.naxis != 2:
        wcs = wcs.celestial
    if wcs.wcs.lng > wcs.wcs.lat:
        raise ValueError("wcs has latitude on its first axis; transpose the images")
    if wcs.has_distortion:
        raise ValueError("the grid of a cube has no distortions; resample images first")
    return wcs


def as_epoch_tuple(values, n, name, convert):
    """Return one value per epoch as a tuple, None if there are none."""
    values = () if values is None else tuple(convert(v) for v in values)
    if len(values) not in (0, n):
        raise ValueError(f"{n} epochs need {n} {name}, got {len(values)}")
    return values or None


def epoch_index(epoch, n):
    """Return the index of one of n epochs, which may be counted from the last."""
    index = operator.index(epoch)
    if not -n <= index < n:
        raise IndexError(f"epoch {index} of a cube with {n} epochs")
    return index % n


def date_labels(times):
    """Return dates as short text, with the time of day if two dates are equal."""
    days = tuple(value[:10] for value in times.isot)
    equal = len(set(days)) < len(days)
    return tuple(value[:19] for value in times.isot) if equal else days


def numbers(column, unit, path, own_unit=None):
    """
    Return a column as floats in ``unit``, blanks as NaN.

    ``own_unit`` replaces the unit of the column.  If ``unit`` is
    `astropy.units.one`, the numbers are returned as they are.
    """
    name = column.info.name
    try:
        values = np.array(np.ma.filled(np.ma.asarray(column, dtype=float), np.nan))
    except (TypeError, ValueError):
        raise ValueError(f"{path}: column {name!r} is not numeric") from None
    for i in np.flatnonzero(np.isinf(values)):
        raise ValueError(f"{path}, row {i + 1}: {name} is infinite")
    if unit == u.one:
        return values
    own_unit = own_unit or column.unit
    if own_unit is None:
        raise ValueError(f"{path}: column {name!r} has no unit, such as {unit}")
    try:
        return values * u.Unit(own_unit).to(unit)
    except (u.UnitConversionError, TypeError, ValueError):
        raise ValueError(
            f"{path}: column {name!r} has the unit {own_unit}, expected one like {unit}"
        ) from None
