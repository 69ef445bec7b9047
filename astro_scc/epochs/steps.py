# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The operations on epochs as methods, so that they can be chained."""

from functools import cached_property

__all__ = ["EpochSteps"]


class EpochSteps:
    """
    Methods of a cube that call the functions of this folder.

    The functions are imported at first use, each with the libraries that it
    needs.
    """

    def to_common_beam(self, beam=None):
        """
        Convolve to one beam, see `~astro_scc.epochs.common_beam`.

        Parameters
        ----------
        beam : beam, optional
            By default the smallest that contains the beams of all epochs.

        Returns
        -------
        `EpochCube`
        """
        from astro_scc.epochs.smoothing import common_beam

        return common_beam(self, beam=beam)

    def align(self, method="core", **kwargs):
        """
        Shift the epochs on one another, see `~astro_scc.epochs.align`.

        Parameters
        ----------
        method : {"core", "correlate", "table", "wcs", "none"} or path, optional
            The path is that of a table of core positions.
        **kwargs
            Options of the method: ``table``, ``reference``, ``region``,
            ``jet_pa``, ``max_shift``.

        Returns
        -------
        `EpochCube`
        """
        from astro_scc.epochs.alignment import align

        return align(self, method, **kwargs)

    @cached_property
    def misalignment(self):
        """
        Scatter of the epochs about where their neighbours put them, in beams.

        None where that cannot be told, see
        `~astro_scc.epochs.misalignment.misalignment`.
        """
        from astro_scc.epochs.misalignment import misalignment

        return misalignment(self)

    def reproject_to(self, wcs, shape=None, order=None, *, method="interp"):
        """
        Resample to another grid, see `~astro_scc.epochs.reproject_cube`.

        Parameters
        ----------
        wcs : `~astropy.wcs.WCS`, `~astropy.io.fits.Header` or `EpochCube`
            The new grid, celestial.
        shape : (int, int), optional
            Shape (ny, nx) of the new grid, by default its own.
        order : {"bicubic", "biquadratic", "bilinear", "nearest-neighbor"}, optional
            Of the interpolation.
        method : {"interp", "exact", "adaptive"}, optional
            Averages for larger pixels by the last two.

        Returns
        -------
        `EpochCube`
        """
        from astro_scc.epochs.grid import reproject_cube

        return reproject_cube(self, wcs, shape, order, method=method)

    def crop(self, region, pad=0):
        """
        Cut all epochs down to a region, see `~astro_scc.epochs.crop`.

        Parameters
        ----------
        region : (slice, slice) or region
            Slices of pixels (y, x), or what `region_mask` takes, of which
            the bounding box is kept.
        pad : int, optional
            Pixels to keep around the box.

        Returns
        -------
        `EpochCube`
        """
        from astro_scc.epochs.cutout import crop

        return crop(self, region, pad=pad)

    def region_mask(self, region):
        """
        Pixels inside a region, see `~astro_scc.epochs.region_mask`.

        Parameters
        ----------
        region : region, list of regions, path, array of bool or None
            None is everything.

        Returns
        -------
        `~numpy.ndarray` of bool, shape (ny, nx)
            True inside.
        """
        from astro_scc.epochs.cutout import region_mask

        return region_mask(self, region)

    def to_xarray(self):
        """
        As `xarray.Dataset`, see `~astro_scc.epochs.interchange.to_xarray`.

        Returns
        -------
        `xarray.Dataset`
        """
        from astro_scc.epochs.interchange import to_xarray

        return to_xarray(self)

    def to_ndcube(self):
        """
        As NDCube, see `~astro_scc.epochs.interchange.to_ndcube`.

        Returns
        -------
        `ndcube.NDCube`
        """
        from astro_scc.epochs.interchange import to_ndcube

        return to_ndcube(self)

    def plot(self, epoch=None, ssps=None, **kwargs):
        """
        Draw one epoch, or all of them.

        Parameters
        ----------
        epoch : int, optional
            Index of the epoch; without it, a panel each.
        ssps : `~astropy.table.QTable` or `~astro_scc.decomposition.SSPs`, optional
            Drawn on the images.
        **kwargs
            Passed to `astro_scc.visualization.plot_epoch`, or
            `~astro_scc.visualization.plot_epochs`.

        Returns
        -------
        `matplotlib.figure.Figure`
        """
        from astro_scc.visualization import plot_epoch, plot_epochs

        if epoch is None:
            return plot_epochs(self, ssps, **kwargs)
        return plot_epoch(self, epoch, ssps, **kwargs)
