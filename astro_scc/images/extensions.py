# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which image of a FITS file is meant, and the extensions that tell of its pixels."""

import re

import astropy.units as u
from astropy.io import fits

from astro_scc.images import headers
from astro_scc.images.cards import KEYWORDS, get, parse_unit
from astro_scc.images.dates import time_axis

#: Patterns of the names of extensions.
NAMES = KEYWORDS["extensions"]
KINDS = "flags", "weights", "uncertain", "beside"
_CHOICE = re.compile(r"(?P<file>.+?)\[(?P<choice>[^\[\]*?]+)\]$")


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
    name, _, number = (part.strip() for part in choice.upper().partition(","))
    for index, hdu in enumerate(hdus):
        if name.isdigit() and not number:
            known = index == int(name)
        else:
            of_version = not number or str(version(hdus, hdu)) == number
            known = of_version and (hdu.name or "PRIMARY") == name
        if known and is_image(hdu):
            return hdu
    has = headers.some([f"[{_name(hdus, hdu)}]" for hdu in found], 8) or "none"
    raise headers.ContentError(f"has no image [{choice}]; its images are: {has}")


def _name(hdus, hdu):
    """Return the name by which an image can be chosen."""
    if not hdu.name:
        return str([other is hdu for other in hdus].index(True))
    several = sum(other.name == hdu.name for other in hdus) > 1
    return f"{hdu.name},{version(hdus, hdu)}" if several else hdu.name


def version(hdus, hdu):
    """Return the version of an HDU, its number of those of a name if that is lost."""
    same = [other for other in hdus if other.name == hdu.name]
    if len({other.ver for other in same}) == len(same):
        return hdu.ver
    return [other is hdu for other in same].index(True) + 1


def _marks(hdu):
    """
    Return what speaks for an image to be the one that is meant, the weightiest first.

    It is not named as one that tells of others, has celestial coordinates, one plane of
    each date and Stokes parameter, and a unit of brightness, and is named as science.
    """
    names, header = (hdu.name, hdu.name.rstrip("0123456789")), hdu.header
    kind = (get(header, "BTYPE", kind=str) or "").upper()
    beside = any(is_of(name, other) for other in KINDS for name in names)
    unit = parse_unit(get(header, "BUNIT", kind=str))
    bright = unit is not None and unit != u.one and not unit.is_equivalent(u.s)
    science = not (beside or re.search(NAMES["types"], kind))
    placed = headers.celestial_axes(header) is not None
    return science, placed, _is_one_plane(hdu), bright, hdu.name in NAMES["science"]


def _is_one_plane(hdu):
    """Return whether an image has one plane, of each date and Stokes parameter."""
    dates = time_axis(hdu.header)
    for axis in range(1, hdu.header["NAXIS"] + 1):
        name = str(hdu.header.get(f"CTYPE{axis}", ""))
        free = headers.axis_kind(name) or axis == dates or name.startswith("STOKES")
        if not free and hdu.header[f"NAXIS{axis}"] > 1:
            return False
    return True


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
