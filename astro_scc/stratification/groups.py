# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Groups of SSPs: by scale, or by limb."""

from itertools import combinations

import numpy as np

from astro_scc.kinematics import limb_masks
from astro_scc.measurement import select_ssps

__all__ = ["check_groups", "limb_groups", "scale_groups"]


def scale_groups(matched, groups):
    """
    Groups of SSPs by their scale.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
    groups : dict of sequence of float or `~astropy.units.Quantity`
        Scales by the name of the group.

    Returns
    -------
    dict of `~numpy.ndarray` of bool, shape (n_ssps,)

    Raises
    ------
    ValueError
        If a scale was not decomposed, or is of two groups.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_static
    >>> from astro_scc.stratification import scale_groups
    >>> matched = StackedCrossCorrelation(scales=[1, 2]).match(
    ...     simulate_static(n_epochs=3, rng=1).cube)
    >>> groups = scale_groups(matched, {"fine": [1], "coarse": [2]})
    >>> bool(np.all(groups["fine"] ^ groups["coarse"]))
    True
    """
    chosen = {
        name: select_ssps(matched, scales=scales).select
        for name, scales in groups.items()
    }
    return check_groups(chosen)


def limb_groups(matched, ridge, half_width):
    """
    Groups of SSPs by the side of the ridge line that their centroid is on.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
    ridge : `~astro_scc.kinematics.RidgeLine`
    half_width : `~astropy.units.Quantity`
        Half the width of the spine.

    Returns
    -------
    dict of `~numpy.ndarray` of bool, shape (n_ssps,)
        "north", "spine" and "south"; those that have an SSP.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.kinematics import find_ridge_line
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.stratification import limb_groups
    >>> cube = simulate_two_fluid(n_epochs=3, core=1.0, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> groups = limb_groups(scc.match(cube), find_ridge_line(cube), 0.3 * u.mas)
    >>> set(groups) <= {"north", "spine", "south"}
    True
    """
    masks = limb_masks(matched.cube, ridge, half_width)
    chosen = {
        name: select_ssps(matched, region=mask).select
        for name, mask in masks.items()
        if mask.any()
    }
    return {name: select for name, select in chosen.items() if select.any()}


def check_groups(groups):
    """
    Refuse groups that share SSPs.

    Parameters
    ----------
    groups : dict of `~numpy.ndarray` of bool

    Returns
    -------
    dict of `~numpy.ndarray` of bool

    Raises
    ------
    ValueError
        If there are fewer than two, or two share an SSP.
    """
    if len(groups) < 2:
        raise ValueError(f"a comparison needs two groups or more, got {len(groups)}")
    for (a, first), (b, second) in combinations(groups.items(), 2):
        if np.any(np.asarray(first) & np.asarray(second)):
            raise ValueError(f"groups {a!r} and {b!r} share SSPs: they must not")
    return groups
