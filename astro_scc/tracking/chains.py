# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""From links to tracks, and what tracks are called."""

import numpy as np

__all__ = ["chain", "track_names"]


def chain(links, n_ssps, *, min_epochs=1, one=None):
    """
    Number the tracks that one-to-one links make.

    Parameters
    ----------
    links : `~astro_scc.tracking.Links`
    n_ssps : int
    min_epochs : int, optional
        Tracks of fewer SSPs than this are none.
    one : array_like of int, shape (n_ssps,), optional
        SSPs with the same number, if it is not negative, are one feature:
        those of them that are linked at all make one track, however long it
        is not seen.

    Returns
    -------
    `~numpy.ndarray` of int, shape (n_ssps,)
        Track of each SSP, in the order of their first SSPs, or -1.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking import Links, chain
    >>> links = Links(np.array([0, 2]), np.array([2, 3]), np.array(["link"] * 2),
    ...               *(np.zeros(2) for _ in range(4)))
    >>> chain(links, 5).tolist(), chain(links, 5, min_epochs=2).tolist()
    ([0, 1, 0, 0, 2], [0, -1, 0, 0, -1])
    """
    own = links.kind == "link"
    follower = np.full(n_ssps, -1)
    follower[links.source[own]] = links.target[own]
    begins = np.ones(n_ssps, bool)
    begins[links.target[own]] = False
    pieces = []
    of_one = {}
    for start in np.flatnonzero(begins):
        members = [start]
        while follower[members[-1]] >= 0:
            members.append(follower[members[-1]])
        key = -1 if one is None or len(members) < 2 else one[start]
        if key in of_one:
            of_one[key] += members
            continue
        if key >= 0:
            of_one[key] = members
        pieces.append(members)
    track = np.full(n_ssps, -1)
    number = 0
    for members in pieces:
        if len(members) >= min_epochs:
            track[members] = number
            number += 1
    return track


def track_names(track, ssps, dates, offsets, *, decimals=2):
    """
    Names of tracks by the date, scale and place at which they begin.

    A name stays what it is when epochs are added after the first one of its
    track, whatever the other tracks are.

    Parameters
    ----------
    track : array_like of int, shape (n_ssps,)
        See `chain`.
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    dates : sequence of str, shape (n_epochs,)
        ``"2006-03-09"``, or longer; what is the same for all is of no use.
    offsets : tuple of array_like, shape (n_ssps,)
        East and north of each SSP.
    decimals : int, optional
        Of the offsets in the name.

    Returns
    -------
    list of str

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.tracking import track_names
    >>> y, x = np.mgrid[:64, :96]
    >>> image = np.exp(-((x - 40) ** 2 + (y - 32) ** 2) / 30)
    >>> ssps = Decomposer(scales=[2])(image).ssps
    >>> track_names([0], ssps, ["2006-03-09"], ([1.234], [-0.5]))
    ['20060309_s2_+1.23-0.50']
    """
    track = np.asarray(track)
    numbers, first = _first_members(track, ssps)
    names = []
    for index in first:
        date = str(dates[ssps.epoch[index]]).replace("-", "").replace(":", "")
        place = "".join(
            f"{np.round(o[index], decimals) + 0.0:+.{decimals}f}" for o in offsets
        )
        names.append(f"{date}_s{ssps.scale[index]:g}_{place}")
    # Two that round to one place: in the order of the catalogue.
    seen = {}
    for k in range(len(numbers)):
        seen[names[k]] = seen.get(names[k], 0) + 1
        if seen[names[k]] > 1:
            names[k] = f"{names[k]}.{seen[names[k]]}"
    return names


def _first_members(track, ssps):
    """The first SSP of each track, in the order of the tracks."""
    own = np.flatnonzero(track >= 0)
    own = own[np.lexsort((ssps.epoch[own], track[own]))]
    numbers, start = np.unique(track[own], return_index=True)
    return numbers, own[start]
