# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which pixels of an image are missing, and its noise by their uncertainties."""

import astropy.units as u
import numpy as np
import scipy
from astropy.nddata import InverseVariance, StdDevUncertainty, VarianceUncertainty

from astro_scc.images import cards, extensions, headers

#: Uncertainties by the names that astropy writes.
UNCERTAINTIES = StdDevUncertainty, VarianceUncertainty, InverseVariance
UNCERTAINTIES = {kind.__name__: kind for kind in UNCERTAINTIES}


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
    size = np.abs(border)
    low, middle, high = np.quantile(size, [0.1, 0.5, 0.9])
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
        name if name in UNCERTAINTIES else extensions.NAMES["uncertain"][hdu.name]
    ]
    given = None if text is None else cards.parse_unit(text)
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


def uncertainty_noise(uncertainty, unit, mask, *, most=np.inf, even=1.5):
    """
    Return the noise of an image whose pixels have uncertainties.

    The noise is the median standard deviation of the valid pixels, in the ``unit`` of
    the image, which is also assumed for an NDUncertainty without a unit.  The function
    also returns a mask of the pixels without one that is finite and no larger than
    ``most`` where most pixels have a smaller one, and whether those of the pixels
    differ by no more than the factor ``even`` from the median.  An uncertainty that
    cannot be used raises a ValueError.
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
    noise = np.median(valid)
    if 0 < noise < most:
        bad |= sigma > most
        valid = sigma[~(mask | bad)]
    alike = valid.max() <= even * noise and noise <= even * valid.min()
    return noise * unit, bad, alike
