# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images from component lists."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.wcs import WCS

__all__ = ["offset_wcs"]


def offset_wcs(pixel_scale, reference_pixel, position=None):
    """
    Celestial WCS of an image that is known by offsets from one pixel.

    Orthographic (``SIN``), east to the left, north up, square pixels.

    Parameters
    ----------
    pixel_scale : `~astropy.units.Quantity`
        Side of a pixel.
    reference_pixel : tuple of float
        (x, y) of the origin of offsets, counted from 0.
    position : `~astropy.coordinates.SkyCoord`, optional
        Celestial position of the origin; (180 deg, 0 deg) without it.

    Returns
    -------
    `~astropy.wcs.WCS`

    Raises
    ------
    ValueError
        If ``pixel_scale`` is not positive.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.epochs.restoring import offset_wcs
    >>> wcs = offset_wcs(0.1 * u.mas, (20, 64))
    >>> [float(p) for p in wcs.wcs.crpix]
    [21.0, 65.0]
    """
    step = u.Quantity(pixel_scale).to_value(u.deg)
    if not (np.isfinite(step) and step > 0):
        raise ValueError(f"pixel_scale must be positive, got {pixel_scale}")
    if position is None:
        position = SkyCoord(180 * u.deg, 0 * u.deg)
    position = position.icrs
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = "RA---SIN", "DEC--SIN"
    wcs.wcs.cunit = "deg", "deg"
    wcs.wcs.crval = position.ra.deg, position.dec.deg
    wcs.wcs.crpix = np.asarray(reference_pixel, dtype=float) + 1
    wcs.wcs.cdelt = -step, step
    wcs.wcs.radesys = "ICRS"
    wcs.wcs.set()
    return wcs
