# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The images of one object at many dates, on one pixel grid."""

from dataclasses import dataclass, field, replace

import astropy.units as u
import numpy as np
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.epochs.beam import Beam

__all__ = ["EpochCube"]


@dataclass(frozen=True, eq=False, repr=False)
class EpochCube:
    """
    Images of one object at many dates on one pixel grid.

    Parameters
    ----------
    data : array_like, shape (n_epochs, ny, nx)
        Intensities.
    times : `~astropy.time.Time`, shape (n_epochs,)
        Dates of observation.  Epochs are sorted by date.
    wcs : `~astropy.wcs.WCS`
        Celestial, two-dimensional.  Its reference pixel is the origin of
        all offsets.
    unit : `~astropy.units.Unit`, optional
    mask : array_like of bool, shape of ``data``, optional
        True marks bad pixels.  Pixels that are not finite are added to it.
    beams : sequence of `~astro_scc.epochs.Beam`, length n_epochs, optional
    noise : `~astropy.units.Quantity`, shape (n_epochs,), optional
        Root mean square of the noise of each epoch.
    labels : sequence of str, optional
        What an epoch is called in messages and tables, its file name where
        there is one.
    epoch_wcs : sequence of `~astropy.wcs.WCS`, optional
        For each epoch the absolute celestial coordinates that its own
        header gives to the pixels of this grid.  Used by
        ``align("wcs")`` only.
    epoch_meta : sequence of dict, optional
        Facts of each epoch (object, frequency, telescope...).
    meta : dict, optional
        ``meta["history"]`` is a list with one line for every step taken.
    """

    data: np.ndarray
    times: Time
    wcs: WCS
    unit: u.UnitBase = u.dimensionless_unscaled
    mask: np.ndarray | None = None
    beams: tuple[Beam, ...] | None = None
    noise: u.Quantity | None = None
    labels: tuple[str, ...] = ()
    epoch_wcs: tuple[WCS, ...] | None = None
    epoch_meta: tuple[dict, ...] = ()
    meta: dict = field(default_factory=dict)

    def __len__(self):
        return self.data.shape[0]

    @property
    def shape(self):
        """Shape of the data, (n_epochs, ny, nx)."""
        return self.data.shape

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
    def years(self):
        """Dates as years since the first epoch, shape (n_epochs,)."""
        return (self.times - self.times[0]).to(u.yr)

    def with_step(self, line, **changes):
        """
        Copy with changed fields and one more line of provenance.

        Parameters
        ----------
        line : str
            What was done, for ``meta["history"]``.
        **changes
            Fields of the new cube.

        Returns
        -------
        `EpochCube`
        """
        meta = {**self.meta, "history": [*self.meta.get("history", ()), line]}
        return replace(self, meta=meta, **changes)
