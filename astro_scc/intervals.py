# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Intervals between the dates of a series, some of which may be close together."""

import numpy as np


def without_short(gaps, short=0.1):
    """
    Return the gaps between dates without those inside of pairs or campaigns.

    Gaps are short below ``short`` of the mean of all others but the longest, as one
    long pause says nothing.  If fewer than a quarter of the gaps are short, all are
    returned: neither their lower quartile nor their median is a short one.

    Parameters
    ----------
    gaps : `~numpy.ndarray`
        Those that are 0 are left out.
    short : float, optional

    Returns
    -------
    `~numpy.ndarray`
        In ascending order.
    """
    every = kept = np.sort(gaps[gaps > 0])
    while len(kept) > 1:
        others = kept[kept >= short * kept[:-1].mean()]
        if len(others) == len(kept):
            break
        kept = others
    return kept if len(kept) <= 0.75 * len(every) else every


def median_interval(dates):
    """Return the median gap between dates, of pairs or campaigns if they come so."""
    return np.median(without_short(np.diff(np.unique(dates))))
