# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which pixels of an image are missing."""

import numpy as np
import scipy

from astro_scc.images.headers import ContentError

#: Side of a block of exact zeros, in pixels, that no noise makes.
BLOCK = 3
#: Beside zeros that pad an image, at least this share of pixels has each sign ...
EACH_SIGN = 0.1
#: ... or the smallest tenth is above this part of the median, as it is where the sky
#: is not zero; where zeros are faint values they go over into others.
JUMP = 0.5
#: A number that stands for missing pixels is this many times as far from all others as
#: the most extreme of them is from their median.
ALONE = 3
#: Share of the other pixels that is in blocks, or no brighter than those beside zeros;
#: and the share that flags hardly call bad in an image worth measuring.
MOST = 0.5


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


def placeholders(values):
    """
    Return the numbers of finite pixels that stand for missing ones: -999 or 1e20.

    Such a number is the smallest or largest one, as far from all others as no noise
    and no source is, and many pixels have exactly this one.
    """
    found = []
    for extreme in (np.min, np.max):
        if values.size == 0 or (number := extreme(values)) == 0:
            continue
        if np.count_nonzero(values == number) < BLOCK**2:
            continue
        others = values[values != number]
        if others.size < MOST * BLOCK**2:
            continue
        nearest = extreme(others)
        spread = abs(nearest - np.median(others))
        if spread > 0 and abs(number - nearest) > ALONE * spread:
            found.append(float(number))
            values = others
    return found


def padding(image):
    """
    Return the pixels of exact zeros that pad an image, as a mask.

    This is the one definition of zeros that are missing: they fill blocks of 3 x 3
    pixels, and beside them the sky begins at once, so that they are no faint values:
    there are values of both signs, or none near zero while most others are no brighter.
    Sparse counts, and sources without noise or above a threshold, have none.
    """
    zero = image == 0
    none = np.zeros(image.shape, dtype=bool)
    if np.count_nonzero(zero) < BLOCK**2:
        return none
    block = np.ones((BLOCK, BLOCK), dtype=bool)
    solid = scipy.ndimage.binary_erosion(zero, block, border_value=1)
    if not solid.any():
        return none
    solid = scipy.ndimage.binary_dilation(solid, block)
    padded = scipy.ndimage.binary_propagation(solid, mask=zero)
    other = np.isfinite(image) & ~zero
    edge = scipy.ndimage.binary_dilation(padded, block) & other
    border, inside = image[edge], np.abs(image[other & ~edge])
    filled = np.count_nonzero(scipy.ndimage.binary_opening(other, block))
    if (
        border.size == 0
        or inside.size == 0
        or filled < MOST * (border.size + inside.size)
    ):
        return none
    positive = np.mean(border > 0)
    if min(positive, 1 - positive) >= EACH_SIGN:
        return padded
    size = np.abs(border)
    low, middle, high = np.quantile(size, [0.1, 0.5, 0.9])
    brighter = np.mean(inside > high)
    return padded if low > JUMP * middle and brighter <= MOST else none


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
    if share <= MOST:
        return bad, ""
    empty = ~np.isfinite(image) | (image == 0)
    if empty.any() and np.mean(bad[empty]) < MOST:
        if set(np.unique(values)) <= {0, 1}:
            return ~bad, (
                f"its extension {name} has 0 where there are no values: 1 is taken for "
                "good"
            )
    elif empty[bad].mean() > MOST:
        return bad, ""
    raise ContentError(
        f"its extension {name} marks {100 * share:.0f}% of the pixels, which are bad "
        "in masks of astropy and good in others; write NaN to the bad pixels instead, "
        f"and remove {name}"
    )
