# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The displacement-interval diagram as an image with coordinates."""

import astropy.units as u
import numpy as np
from astropy.nddata import NDData
from astropy.wcs import WCS

from astro_scc.measurement.axes import AxisProjection
from astro_scc.stacking import SearchSettings

__all__ = ["diagram_image"]


def diagram_image(result):
    """
    The diagram of a search with a WCS, see `SCCResult.diagram`.

    Parameters
    ----------
    result : `SCCResult`

    Returns
    -------
    `~astropy.nddata.NDData`

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.measurement.diagram_image import diagram_image
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> result = scc(simulate_two_fluid(n_epochs=5, rng=1).cube, n_trials=20, rng=1)
    >>> diagram_image(result).meta["axes"]
    ('interval', 'displacement')
    """
    diagram, angle = result.search.diagram, result.search.angle
    where = result.displacements, result.matched.ssps, result.cube, result.frame
    beam = AxisProjection(*where).beam(angle)[0]
    direction, position_angle = np.array([np.cos(angle), np.sin(angle)]), None
    excess = (diagram.excess / diagram.n_pairs[:, None]).T
    if result.frame.uniform:
        sky = np.linalg.solve(result.frame.matrix(0.0, 0.0), direction)
        position_angle = np.degrees(np.arctan2(*sky)) * u.deg
        if np.cos(position_angle - result.position_angle) < 0:
            # Displacements down the jet are positive.
            direction, excess = -direction, excess[::-1]
            position_angle += 180 * u.deg
        position_angle %= 360 * u.deg
    step = SearchSettings().interval_step
    shortest = _shortest(result.cube.years.to_value(u.yr), diagram)
    bins = np.floor(np.log(diagram.interval / shortest) / step + 1e-9).astype(int)
    data = np.full((len(excess), bins[-1] + 1), np.nan)
    interval, n_pairs = np.full(bins[-1] + 1, np.nan), np.zeros(bins[-1] + 1, int)
    data[:, bins], interval[bins], n_pairs[bins] = (
        excess, diagram.interval, diagram.n_pairs
    )  # fmt: skip
    middle = shortest * np.exp(step / 2)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.cunit = ["INTV-LOG", "DISPLACE"], ["yr", "mas"]
    wcs.wcs.crpix = [1.0, (len(data) + 1) / 2]
    wcs.wcs.crval = [middle, 0.0]
    wcs.wcs.cdelt = [step * middle, beam * np.diff(diagram.displacement).mean()]
    return NDData(
        data,
        wcs=wcs,
        meta={
            "axes": ("interval", "displacement"),
            "interval": interval * u.yr,
            "n_pairs": n_pairs,
            "beam": beam * u.mas,
            "direction": direction,
            "position_angle": position_angle,
        },
    )


def _shortest(years, diagram):
    """The shortest interval that was used, with which the first bin begins."""
    first, second = np.triu_indices(len(years), 1)
    every, n = np.sort(years[second] - years[first]), diagram.n_pairs[0]
    every = every[every > 0]
    total = np.concatenate([[0.0], every.cumsum()])
    mean = (total[n:] - total[:-n]) / n
    return every[np.abs(mean - diagram.interval[0]).argmin()]
