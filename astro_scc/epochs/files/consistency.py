# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Whether images belong into one series of epochs."""

from collections import Counter

import numpy as np

__all__ = ["find_odd", "find_same_dates", "looks_like_mask"]

# Images of one band: VLBI bands are a few per cent wide and 30% apart.
BAND = 0.1
POLARISED = ("Q", "U", "V")
UNNAMED = {"", "UNKNOWN", "NONE", "N/A"}


def find_odd(facts, positions=None, extents=None):
    """
    Images of another object, band or polarisation than most.

    Parameters
    ----------
    facts : sequence of dict
        As of `~astro_scc.epochs.files.headers.header_facts`.
    positions : array_like, shape (n, 2), optional
        Longitude and latitude of the reference pixels in degrees.
    extents : array_like, shape (n,), optional
        Sizes of the images in degrees.

    Returns
    -------
    list of (int, str, bool)
        Number of the image, what is odd about it, and whether it must be
        left out.  Another name for the same place is only worth a warning.
    """
    odd = []
    for i, mine, others in _minority([_object_name(f) for f in facts]):
        first = next(k for k, f in enumerate(facts) if _object_name(f) == others)
        same = _same_place(positions, extents, i, first)
        where = "at the same place" if same else "somewhere else"
        odd.append((i, f"shows {mine}, {where}, where others show {others}", not same))
    for i, mine, others in _minority([f.get("filter") for f in facts]):
        odd.append((i, f"is of the filter {mine}, others are of {others}", True))
    polarised = [
        f["stokes"] if f.get("stokes") in POLARISED else "I" if "stokes" in f else None
        for f in facts
    ]
    for i, mine, others in _minority(polarised):
        odd.append((i, f"is of Stokes {mine}, others are of {others}", True))
    odd += _other_bands([f.get("frequency") for f in facts])
    return sorted(odd)


def _object_name(facts):
    name = str(facts.get("object", "")).strip()
    return None if name.upper() in UNNAMED else name


def _minority(values):
    """Those that have another value than most, or than the first ones."""
    keys = [v and v.upper().replace(" ", "").replace("_", "") for v in values]
    count = Counter(key for key in keys if key)
    if len(count) < 2:
        return []
    usual = count.most_common(1)[0][0]
    name = values[keys.index(usual)]
    return [(i, values[i], name) for i, key in enumerate(keys) if key and key != usual]


def _same_place(positions, extents, i, k):
    if positions is None:
        return False
    (lon_i, lat_i), (lon_k, lat_k) = positions[i], positions[k]
    east = (lon_i - lon_k + 180) % 360 - 180
    separation = np.hypot(east * np.cos(np.radians(lat_k)), lat_i - lat_k)
    return bool(separation < max(extents[i], extents[k]))


def _other_bands(frequencies):
    known = np.array([f if f else np.nan for f in frequencies], dtype=float)
    with np.errstate(invalid="ignore"):
        near = np.abs(np.log(known[:, None] / known)) < BAND
    if np.all(near | np.isnan(known) | np.isnan(known)[:, None]):
        return []
    usual = int(np.argmax(near.sum(axis=1)))
    return [
        (
            int(i),
            f"is at {known[i] / 1e9:.4g} GHz, others are at {known[usual] / 1e9:.4g}",
            True,
        )
        for i in np.flatnonzero(~near[usual] & ~np.isnan(known))
    ]


def find_same_dates(times):
    """
    Epochs with the date of another one, to the second.

    Parameters
    ----------
    times : `~astropy.time.Time`, shape (n,)

    Returns
    -------
    list of (int, int)
        Pairs of numbers.
    """
    order = np.argsort((times - times[0]).sec, kind="stable")
    gaps = np.diff((times - times[0]).sec[order])
    return [(int(order[k]), int(order[k + 1])) for k in np.flatnonzero(gaps < 1)]


def looks_like_mask(image):
    """
    Whether an image has no more than two values.

    Parameters
    ----------
    image : array_like, shape (ny, nx)
        Values that are not finite do not count.

    Returns
    -------
    bool

    Examples
    --------
    >>> from astro_scc.epochs.files.consistency import looks_like_mask
    >>> looks_like_mask([[0, 1, 1]]), looks_like_mask([[0, 1, 2]])
    (True, False)
    """
    values = np.asarray(image, dtype=float)
    # Mostly a few pixels are enough to tell.
    few = values.flat[:1000]
    if len(np.unique(few[np.isfinite(few)])) > 2:
        return False
    values = values[np.isfinite(values)]
    if values.size == 0:
        return False
    return bool(np.all((values == values.min()) | (values == values.max())))
