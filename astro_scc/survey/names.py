# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Names of sources, regions and scale groups as names of folders."""

import hashlib
import re
from collections import Counter

__all__ = ["folder_names"]

LONGEST = 60
#: What a check sum looks like; a name that has one might be that of another.
SUM = re.compile(r"-[0-9a-f]{6}$", re.IGNORECASE)
#: What Windows keeps for devices.
RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


def folder_names(names):
    """
    Names of folders for any names, of one folder and all different.

    Parameters
    ----------
    names : sequence of str
        All different.

    Returns
    -------
    dict of str
        Letters, digits and ``+ - _ .`` only, none at the beginning that
        hides or goes up, 60 characters and a check sum at most.  A name that
        needs no change is its own; what had to be changed, or differs from
        another in upper and lower case only, ends in a check sum.

    Examples
    --------
    >>> from astro_scc.survey import folder_names
    >>> folder_names(["3C 273", "M87", "../../etc"])
    {'3C 273': '3C_273-ce3b79', 'M87': 'M87', '../../etc': 'etc-74ccf3'}
    """
    plain = {name: _plain(name) for name in names}
    kept = {
        name for name, text in plain.items() if text == name and not SUM.search(name)
    }
    count = Counter(name.casefold() for name in kept)
    return {
        name: name
        if name in kept and count[name.casefold()] == 1
        else f"{text}-{_sum(name)}"
        for name, text in plain.items()
    }


def _plain(name):
    text = re.sub(r"[^A-Za-z0-9+._-]+", "_", name)[:LONGEST]
    text = text.lstrip("._-+").rstrip("._") or "unnamed"
    return f"{text}_" if RESERVED.fullmatch(text) else text


def _sum(name):
    return hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:6]
