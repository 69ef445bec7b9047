# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which image of a FITS file is meant, which of its pixels are missing, its noise."""

import re
from contextlib import suppress

import astropy.units as u
import numpy as np
import scipy
from astropy.io import fits
from astropy.nddata import InverseVariance, StdDevUncertainty, VarianceUncertainty

from astro_scc.images import headers
from astro_scc.images.dates import time_axis

#: Patterns of the names of extensions.
NAMES = headers.KEYWORDS["extensions"]
KINDS = "flags", "weights", "uncertain", "beside"
_CHOICE = re.compile(r"(?P<file>.+?)\[(?P<choice>[^\[\]*?]+)\]$")
#: Uncertainties by the names that astropy writes.
UNCERTAINTIES = StdDevUncertainty, VarianceUncertainty, InverseVariance
UNCERTAINTIES = {kind.__name__: kind for kind in UNCERTAINTIES}


UNEVEN = (
    "its uncertainty differs from pixel to pixel, and the median is taken for the "
    "noise; leave it out to have the noise measured"
)


class NoImageError(OSError):
    """The file is not FITS, is broken, or holds no image."""


def split_choice(name):
    """
    Return the name of a file and the extension that is chosen in brackets behind it.

    Extensions are written as for astropy and IRAF, ``file.fits[SCI,2]``, ``[SCI]`` or
    ``[2]``, of which the first image of the file is 0.
    """
    match = _CHOICE.match(str(name))
    return (match["file"], match["choice"].strip()) if match else (str(name), None)


def is_of(name, kind):
    """Return whether the name of an extension is that of a kind."""
    return bool(re.fullmatch("|".join(NAMES[kind]), name))


def is_image(hdu):
    """Return whether an HDU has an image of two axes or more."""
    return hdu.is_image and len(hdu.shape) >= 2 and 0 not in hdu.shape


def is_visibilities(hdus):
    """Return whether an open file is UVFITS or FITS-IDI."""
    return any(isinstance(h, fits.GroupsHDU) or h.name == "UV_DATA" for h in hdus)


def find_image(hdus, path, choice=None):
    """
    Return the image of a file that is chosen, or that can only be meant.

    That is the only image, ``SCI``, or else the only one with celestial coordinates of
    its own, planes of one date, and a unit of brightness, that is not named as one
    that tells of another.  If several remain, a ContentError says how to choose.
    """
    found = [hdu for hdu in hdus if is_image(hdu)]
    if choice is not None:
        return _chosen(hdus, found, choice)
    if not found:
        if is_visibilities(hdus):
            raise NoImageError(
                "holds visibilities and no image; make an image of them (difmap, CASA "
                "or AIPS), or give the models that were fitted to them (.mod)"
            )
        if any(isinstance(hdu, fits.BinTableHDU) for hdu in hdus):
            raise NoImageError(
                "holds no image but a table; make an image of events, and of a list of "
                "spots or components a table of astropy, as .ecsv"
            )
        raise NoImageError("holds no image")
    science = [hdu for hdu in found if hdu.name == "SCI"]
    if science:
        found = science
    elif len(found) > 1:
        marks = [_marks(hdu) for hdu in found]
        best = max(marks)
        found = [hdu for hdu, mark in zip(found, marks, strict=True) if mark == best]
    if len(found) > 1:
        names = [f"[{_name(hdus, hdu)}]" for hdu in found]
        file = re.sub(r".*[/\\]", "", split_choice(path)[0])
        raise headers.ContentError(
            f"has {len(found)} images, {headers.some(names)}; choose one by its name "
            f"in brackets, such as '{file}{names[0]}'"
        )
    return found[0]


def _chosen(hdus, found, choice):
    wanted = re.sub(r"\s*,\s*", ",", choice.upper())
    for index, hdu in enumerate(hdus):
        name = hdu.name or "PRIMARY"
        names = str(index), name, f"{name},{version(hdus, hdu)}"
        if wanted in names and is_image(hdu):
            return hdu
    has = headers.some([f"[{_name(hdus, hdu)}]" for hdu in found], 8) or "none"
    raise headers.ContentError(f"has no image [{choice}]; its images are: {has}")


def _name(hdus, hdu):
    """Return the name by which an image can be chosen."""
    if not hdu.name:
        return str(hdus.index(hdu))
    several = sum(other.name == hdu.name for other in hdus) > 1
    return f"{hdu.name},{version(hdus, hdu)}" if several else hdu.name


def version(hdus, hdu):
    """Return the version of an HDU, its number of those of a name if that is lost."""
    same = [other for other in hdus if other.name == hdu.name]
    if len({other.ver for other in same}) == len(same):
        return hdu.ver
    return same.index(hdu) + 1


def _marks(hdu):
    """
    Return what speaks for an image to be the one that is meant, the weightiest first.

    It is not named as one that tells of others, has celestial coordinates, one plane of
    each date and Stokes parameter, and a unit of brightness, and is named as science.
    """
    names, header = (hdu.name, hdu.name.rstrip("0123456789")), hdu.header
    kind = (headers.get(header, "BTYPE", kind=str) or "").upper()
    beside = any(is_of(name, other) for other in KINDS for name in names)
    unit = headers.parse_unit(headers.get(header, "BUNIT", kind=str))
    bright = unit is not None and unit != u.one and not unit.is_equivalent(u.s)
    science = not (beside or re.search(NAMES["types"], kind))
    placed, one_plane = headers.celestial_axes(header) is not None, False
    with suppress(headers.ContentError):
        one_plane = bool(plane_index(header, 0))
    return science, placed, one_plane, bright, hdu.name in NAMES["science"]


def plane_index(header, frame=None):
    """Return the index of the image plane, in numpy's order of axes."""
    index, dates = [], time_axis(header)
    for axis in range(header["NAXIS"], 0, -1):
        name = str(header.get(f"CTYPE{axis}", "")).upper().strip()
        length = header[f"NAXIS{axis}"]
        if headers.axis_kind(name):
            index.append(slice(None))
        elif axis == dates and frame is not None:
            index.append(frame)
        elif length == 1:
            index.append(0)
        elif name.startswith("STOKES"):
            index.append(_stokes_i(header, axis, length))
        else:
            raise headers.ContentError(
                f"has {length} planes on axis {name or f'{axis} of the file'}; write "
                "the one to use, or their mean, to a file of its own"
            )
    return tuple(index)


def _stokes_i(header, axis, length):
    start, pixel, step = headers.axis_numbers(header, axis)
    if start is not None:
        position = (1 - start) / (step or 1) + pixel - 1
        if abs(position - round(position)) < 1e-6 and 0 <= round(position) < length:
            return round(position)
    raise headers.ContentError(
        f"has {length} planes on axis STOKES and none of them is I; write one to a file"
    )


def beside(hdus, image, kind, shape):
    """
    Return the extensions that tell of an image, of its shape.

    The kind is "flags", "weights" or "uncertain".  Of several images, those of its
    version do.  Others of one name but another shape are refused, but for weights.
    """
    found = []
    for hdu in hdus:
        if hdu is image or not is_of(hdu.name, kind) or not is_image(hdu):
            continue
        several = sum(other.name == hdu.name for other in hdus) > 1
        if several and version(hdus, hdu) != version(hdus, image):
            continue
        if tuple(n for n in hdu.shape if n > 1) == tuple(n for n in shape if n > 1):
            found.append(hdu)
        elif kind != "weights":
            raise headers.ContentError(
                f"its extension {hdu.name} has shape {hdu.shape}, it {shape}; remove it"
            )
    return found


def missing(image, mask=False):
    """
    Return the pixels of an image without a value, and a remark on those of a number.

    They are masked, not finite, exact zeros that pad the image, or of a number that is
    written where there is no value, see `placeholders`.
    """
    bad = ~np.isfinite(image) | mask
    filled = placeholders(image[~bad])
    for number in filled:
        bad |= image == number
    bad |= padding(np.where(bad, np.nan, image))
    texts = ", ".join(f"{number:g}" for number in filled)
    said = f"its pixels of exactly {texts} are taken for missing ones"
    return bad, f"{said}; write NaN to such pixels" if filled else ""


def placeholders(values, alone=3, fewest=9):
    """
    Return the numbers of finite pixels that stand for missing ones: -999 or 1e20.

    Such a number is the smallest or largest one, ``alone`` times as far from all others
    as the most extreme of these is from their median, which no noise and no source is,
    and at least ``fewest`` pixels have exactly this one.
    """
    found = []
    for extreme in (np.min, np.max):
        if values.size == 0 or (number := extreme(values)) == 0:
            continue
        others = values[values != number]
        if values.size - others.size < fewest or others.size < fewest / 2:
            continue
        nearest = extreme(others)
        spread = abs(nearest - np.median(others))
        if spread > 0 and abs(number - nearest) > alone * spread:
            found.append(float(number))
            values = others
    return found


def padding(image, side=3, each_sign=0.1, jump=0.5):
    """
    Return the pixels of exact zeros that pad an image, as a mask.

    This is the one definition of zeros that are missing: they fill blocks of ``side`` x
    ``side`` pixels, as no noise does, and beside them the sky begins at once, so that
    they are no faint values, which go over into others.  At least the share
    ``each_sign`` of the pixels there has each sign; or, as where the sky is not zero,
    the smallest tenth of them is above ``jump`` medians while most others are no
    brighter than they.  Sparse counts, and sources without noise or above a threshold,
    have none.
    """
    zero = image == 0
    none = np.zeros(image.shape, dtype=bool)
    if np.count_nonzero(zero) < side**2:
        return none
    block = np.ones((side, side), dtype=bool)
    solid = scipy.ndimage.binary_erosion(zero, block, border_value=1)
    if not solid.any():
        return none
    solid = scipy.ndimage.binary_dilation(solid, block)
    padded = scipy.ndimage.binary_propagation(solid, mask=zero)
    other = np.isfinite(image) & ~zero
    edge = scipy.ndimage.binary_dilation(padded, block) & other
    border, inside = image[edge], np.abs(image[other & ~edge])
    filled = np.count_nonzero(scipy.ndimage.binary_opening(other, block))
    if not (border.size and inside.size and 2 * filled >= border.size + inside.size):
        return none
    positive = np.mean(border > 0)
    if min(positive, 1 - positive) >= each_sign:
        return padded
    low, middle, high = np.quantile(np.abs(border), [0.1, 0.5, 0.9])
    brighter = np.mean(inside > high)
    return padded if low > jump * middle and brighter <= 0.5 else none


def flagged(flags, image, name, telescope=""):
    """
    Return the pixels that flags call bad, and a remark on what they mean.

    Flags other than 0 are bad, of JWST those with the bit of 1 (DO_NOT_USE).  A mask
    of 0 and 1 may mean the opposite, which pixels without a value tell; where nothing
    does and most pixels would be bad it is refused.
    """
    values = np.nan_to_num(np.asarray(flags)).astype(np.int64)
    bad = (values & 1 if telescope == "JWST" and name == "DQ" else values) != 0
    share = float(np.mean(bad))
    if share <= 0.5:
        return bad, ""
    empty = ~np.isfinite(image) | (image == 0)
    if empty.any() and np.mean(bad[empty]) < 0.5:
        if set(np.unique(values)) <= {0, 1}:
            return ~bad, (
                f"its extension {name} has 0 where there are no values: 1 is taken for "
                "good"
            )
    elif empty[bad].mean() > 0.5:
        return bad, ""
    raise headers.ContentError(
        f"its extension {name} marks {100 * share:.0f}% of the pixels, which are bad "
        "in masks of astropy and good in others; write NaN to the bad pixels instead, "
        f"and remove {name}"
    )


def uncertainty_of(hdu, values, unit, mask):
    """
    Return what an extension tells of the uncertainty of an image, or None.

    ``values`` are its pixels in the part that is read; ``unit`` and ``mask`` are those
    of the image.
    """
    name, text = (hdu.header.get(key) for key in ("UTYPE", "BUNIT"))
    kind = UNCERTAINTIES[
        name if name in UNCERTAINTIES else NAMES["uncertain"][hdu.name]
    ]
    given = None if text is None else headers.parse_unit(text)
    values = np.array(values, dtype=float)
    if hdu.name != "UNCERT":
        # Telescopes write 0 where there is no error, and units that do not fit.
        values[~(values > 0)] = np.nan
        if np.isnan(values[~mask]).all():
            return None
        power = 2 if kind is VarianceUncertainty else 1
        if given is not None and not given.is_equivalent(unit**power):
            given = None
    return kind(values, unit=given, copy=False)


def uncertainty_noise(uncertainty, unit, image, mask, *, even=1.5):
    """
    Return the noise of an image whose pixels have uncertainties.

    The noise is the median standard deviation of the valid pixels, in the ``unit`` of
    the image, which is also assumed for an NDUncertainty without a unit.  The function
    also returns a mask of the pixels without one that is finite and no larger than all
    that is seen in the image, where most pixels have a smaller one, and a remark if
    those of the pixels differ by more than the factor ``even`` from the median.  An
    uncertainty that cannot be used raises a ValueError.
    """
    kind, sigma = type(uncertainty).__name__, uncertainty
    if uncertainty.array is None:
        raise ValueError("its uncertainty has no values; remove it")
    try:
        with np.errstate(divide="ignore", invalid="ignore"):
            if not isinstance(uncertainty, StdDevUncertainty):
                sigma = uncertainty.represent_as(StdDevUncertainty)
        factor = 1.0 if sigma.unit is None else sigma.unit.to(unit)
    except TypeError:
        names = ", ".join(UNCERTAINTIES)
        raise ValueError(
            f"its uncertainty is of type {kind}; give it as {names}"
        ) from None
    except u.UnitConversionError:
        raise ValueError(
            f"its {kind} is in {uncertainty.unit}, which does not fit "
            f"images in {unit.to_string() or 'no unit'}; correct or remove it"
        ) from None
    if np.any(np.asarray(uncertainty.array) < 0):
        raise ValueError("its uncertainty has negative values; correct or remove it")
    sigma = np.broadcast_to(np.asarray(sigma.array) * factor, mask.shape)
    bad = ~np.isfinite(sigma)
    valid = sigma[~(mask | bad)]
    if valid.size == 0:
        raise ValueError("its uncertainty is finite at no valid pixel; remove it")
    noise, most = np.median(valid), np.ptp(image[~mask])
    if 0 < noise < most:
        bad |= sigma > most
        valid = sigma[~(mask | bad)]
    alike = valid.max() <= even * noise and noise <= even * valid.min()
    return noise * unit, bad, "" if alike else UNEVEN
