# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Where the epochs of a cube come from, as class methods."""

import numpy as np

from astro_scc.epochs.offset_grid import offset_wcs

__all__ = ["EpochSources"]


class EpochSources:
    """
    Class methods that make a cube, of files and of what others hold in memory.

    What reads them is imported at first use, with the libraries that it needs.
    """

    @classmethod
    def read(
        cls,
        paths,
        *,
        frame="offset",
        times=None,
        beams=None,
        hdu=None,
        check=True,
        region=None,
        pad=0,
    ):
        """
        Read FITS images, one an epoch, or a file that `write` made.

        CASA images and HDF5 movies of eht-imaging are read too, where the
        packages for them are installed.

        Images of one grid are stacked, with their reference pixels on one
        another.  Others are resampled onto one grid, with a warning: that
        of the finest pixels, as large as what all of them cover.  An image
        that lies whole pixels aside is moved without interpolation.

        Parameters
        ----------
        paths : str, path-like, or sequence of them
            Files, or patterns such as ``"3c273/*.fits"``.
        frame : {"offset", "absolute"}
            What is laid on one another: reference pixels, or celestial
            coordinates.  The absolute coordinates of VLBI images differ
            from epoch to epoch by more than features move.
        times : `~astropy.time.Time` or sequence, optional
            Dates in the order of the files (those of a pattern are in
            alphabetical order), in place of the headers'.  None in a
            sequence means the header's.
        beams : beam or sequence of beams, optional
            In place of the headers'.
        hdu : int or str, optional
            The extension that holds the image, by default the first image.
        check : bool
            Refuse files of another object or band, and masks.
        region, pad : optional
            As `~astro_scc.epochs.crop` takes them: read no more than the
            bounding box of a region and so many pixels around it, of images
            that are too large or too many for the memory.  Regions and slices
            in pixels are those of the earliest epoch.

        Returns
        -------
        `EpochCube`
            With a ``region`` the same as after `crop`, if all images are of one
            grid.

        Raises
        ------
        OSError
            If a file is missing or is no FITS image.
        ValueError
            If a header lacks what is needed, or files do not belong
            together.
        MemoryError
            If the images are more than this machine can hold.

        Examples
        --------
        >>> from astro_scc import EpochCube
        >>> cube = EpochCube.read("../shared/data/0003+380/*.fits")
        >>> len(cube), cube.labels[0]
        (10, '0003+380.u.2006_03_09.fits')
        """
        from astro_scc.epochs.files.assembly import cube_from_files

        return cube_from_files(
            paths,
            frame=frame,
            times=times,
            beams=beams,
            hdu=hdu,
            check=check,
            region=region,
            pad=pad,
        )

    @classmethod
    def from_ccddata(
        cls, images, times=None, beams=None, *, frame="offset", check=True
    ):
        """
        Stack CCDData or other NDData with celestial WCS, one an epoch.

        Parameters
        ----------
        images : sequence of `~astropy.nddata.NDData`
            Or what has an ``hdu``, such as the images of spectral-cube.
            Pixels without a finite uncertainty are bad, and the median of the
            others' standard deviations is the ``noise`` of the epoch, if all
            images have uncertainties.
        times : `~astropy.time.Time` or sequence, optional
            By default from the ``meta`` of each image, as in a FITS header.
        beams : beam or sequence of beams, optional
            By default from the ``meta`` of each image.
        frame, check
            As in `read`.

        Returns
        -------
        `EpochCube`
        """
        from astro_scc.epochs.files.assembly import cube_from_images

        return cube_from_images(
            images, times=times, beams=beams, frame=frame, check=check
        )

    @classmethod
    def from_ndcube(cls, ndcube, times=None, beams=None):
        """
        From an NDCube, see `~astro_scc.epochs.interchange.from_ndcube`.

        Parameters
        ----------
        ndcube : `ndcube.NDCube` or `ndcube.NDCubeSequence`
        times : `~astropy.time.Time`, optional
            By default the time axis or the extra coordinates of the cube.
        beams : beam or sequence of beams, optional

        Returns
        -------
        `EpochCube`
        """
        from astro_scc.epochs.interchange import from_ndcube

        return from_ndcube(ndcube, times=times, beams=beams)

    @classmethod
    def from_xarray(cls, source, **kwargs):
        """
        From xarray, see `~astro_scc.epochs.interchange.from_xarray`.

        Parameters
        ----------
        source : `xarray.Dataset` or `xarray.DataArray`
        **kwargs
            ``times``, ``pixel_scale``, ``unit`` and ``beams`` where it has none.

        Returns
        -------
        `EpochCube`
        """
        from astro_scc.epochs.interchange import from_xarray

        return from_xarray(source, **kwargs)

    @classmethod
    def from_arrays(
        cls,
        data,
        times,
        *,
        pixel_scale,
        unit=None,
        beams=None,
        mask=None,
        noise=None,
        reference_pixel=None,
        position=None,
    ):
        """
        From arrays with east to the left and north up.

        Parameters
        ----------
        data : array_like, shape (n_epochs, ny, nx)
        times : `~astropy.time.Time` or sequence of str, shape (n_epochs,)
        pixel_scale : `~astropy.units.Quantity`
            Side of a pixel, an angle.
        unit, beams, mask, noise
            As in `EpochCube`.
        reference_pixel : tuple of float, optional
            (x, y) of the origin of offsets, counted from 0; by default the
            centre of the image.
        position : `~astropy.coordinates.SkyCoord`, optional
            Celestial position of the reference pixel.

        Returns
        -------
        `EpochCube`

        Raises
        ------
        ValueError
            If the arrays are not one an epoch, of one shape, with as many
            dates, beams and noises.
        """
        shape = np.shape(data)
        if len(shape) != 3:
            raise ValueError(f"data must have shape (n_epochs, ny, nx), got {shape}")
        if reference_pixel is None:
            reference_pixel = (shape[2] - 1) / 2, (shape[1] - 1) / 2
        return cls(
            data=data,
            times=times,
            wcs=offset_wcs(pixel_scale, reference_pixel, position),
            unit=unit,
            mask=mask,
            beams=beams,
            noise=noise,
            meta={"history": [f"{shape[0]} epochs from arrays"]},
        )
