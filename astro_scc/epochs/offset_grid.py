# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Pixels as offsets on the sky from a reference pixel, and back."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.wcs import WCS

__all__ = ["OffsetGrid", "offset_wcs"]


class OffsetGrid:
    """
    What follows from the ``wcs`` and ``shape`` of a class that has them.

    Offsets are (east, north) in the plane tangent to the sky at the
    reference pixel, on which the projection of the WCS has its scale.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc import EpochCube
    >>> cube = EpochCube.from_arrays(np.ones((1, 8, 8)), ["2000-01-01"],
    ...                              pixel_scale=0.1 * u.mas, reference_pixel=(2, 3))
    >>> east, north = cube.pixel_to_offset(1, 5)
    >>> east, north
    (<Quantity 0.1 mas>, <Quantity 0.2 mas>)
    >>> x, y = cube.offset_to_pixel(east, north)
    >>> round(float(x), 6), round(float(y), 6)
    (1.0, 5.0)
    """

    @property
    def pixel_matrix(self):
        """
        Offsets (east, north) of one pixel step in (x, y), shape (2, 2).

        ``(east, north) = pixel_matrix @ (dx, dy)``, the CD matrix of the
        WCS as angles.
        """
        return (self.wcs.pixel_scale_matrix * u.deg).to(u.mas)

    @property
    def pixel_scale(self):
        """Side of a square pixel of the same area."""
        return np.sqrt(np.abs(np.linalg.det(self.pixel_matrix.value))) * u.mas

    @property
    def reference_pixel(self):
        """(x, y) of the origin of offsets, counted from 0."""
        x, y = self.wcs.wcs.crpix - 1
        return float(x), float(y)

    def pixel_to_offset(self, x, y):
        """
        Offsets from the reference pixel, in its tangent plane.

        Parameters
        ----------
        x, y : array_like
            Pixels, counted from 0.

        Returns
        -------
        east, north : `~astropy.units.Quantity`
            In mas, of the shape of ``x`` and ``y``.
        """
        x0, y0 = self.reference_pixel
        step = np.stack(np.broadcast_arrays(np.subtract(x, x0), np.subtract(y, y0)))
        east, north = np.tensordot(self.pixel_matrix.value, step, axes=1)
        return east * u.mas, north * u.mas

    def offset_to_pixel(self, east, north):
        """
        Pixels of offsets, the inverse of `pixel_to_offset`.

        Parameters
        ----------
        east, north : `~astropy.units.Quantity`

        Returns
        -------
        x, y : `numpy.ndarray`
            Pixels, counted from 0.
        """
        x0, y0 = self.reference_pixel
        east, north = (u.Quantity(v).to_value(u.mas) for v in (east, north))
        offset = np.stack(np.broadcast_arrays(east, north))
        x, y = np.tensordot(np.linalg.inv(self.pixel_matrix.value), offset, axes=1)
        return x + x0, y + y0

    def offsets(self):
        """
        Offsets of all pixels from the reference pixel.

        Returns
        -------
        east, north : `~astropy.units.Quantity`, shape (ny, nx)
        """
        y, x = np.indices(self.shape[1:])
        return self.pixel_to_offset(x, y)


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
    >>> from astro_scc.epochs import offset_wcs
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
