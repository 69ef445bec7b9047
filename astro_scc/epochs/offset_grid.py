# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Pixels as offsets on the sky from a reference pixel, and back."""

import astropy.units as u
import numpy as np

__all__ = ["OffsetGrid"]


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
