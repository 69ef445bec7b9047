# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The images of one object at many dates, on one pixel grid."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.nddata import NDData
from astropy.table import QTable
from astropy.time import Time

from astro_scc.epochs import reading, serialize
from astro_scc.epochs.align import align
from astro_scc.epochs.inspection import kind_of
from astro_scc.epochs.registration import misalignment
from astro_scc.epochs.restoring import restore, restore_files
from astro_scc.images import fits, grid, regions, series
from astro_scc.images.beam import Beam, different_beam
from astro_scc.images.dates import date_labels
from astro_scc.images.positions import readable_angle

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from ndcube import NDCube, NDCubeSequence


class EpochCube(series.ImageSeries):
    """
    Images of one object at many dates on one pixel grid.

    Parameters
    ----------
    data : array_like, shape (n_epochs, ny, nx)
        Intensities, kept as float64.
    times : `~astropy.time.Time` or sequence of str, shape (n_epochs,)
        Dates of observation.  Epochs are sorted by date.
    wcs : `~astropy.wcs.WCS`
        Celestial, two-dimensional, without distortions.  Its reference
        pixel is the origin of all offsets.
    unit : `~astropy.units.Unit`, optional
    mask : array_like of bool, shape of ``data``, optional
        True marks bad pixels.  Pixels that are not finite are added to it.
    beams : beam or sequence of beams, length n_epochs, optional
        `~astro_scc.epochs.Beam`, or anything with ``major``, ``minor`` and ``pa``
        (a ``radio_beam.Beam``).  A single beam holds for every epoch.
    noise : `~astropy.units.Quantity`, scalar or shape (n_epochs,), optional
        Root mean square of the noise of each epoch.
    labels : sequence of str, optional
        Names of the epochs, such as their files; by default their dates.
    epoch_wcs : sequence of `~astropy.wcs.WCS`, optional
        Absolute celestial coordinates from each epoch's own header, which
        ``align("wcs")`` uses.
    epoch_meta : sequence of dict, optional
        Facts about each epoch (object, frequency, telescope...).
    meta : dict, optional
        ``meta["history"]`` is a list with one line for every step taken.

    Raises
    ------
    ValueError
        If shapes or numbers of epochs disagree, a date is missing, an epoch
        has no valid pixel, or the WCS is not celestial.
    TypeError
        If an argument has the wrong type.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc import EpochCube
    >>> cube = EpochCube.from_arrays(np.ones((2, 8, 16)), ["2001-06-01", "2000-01-01"],
    ...                              pixel_scale=0.1 * u.mas)
    >>> cube
    <EpochCube 2 epochs 2000-01-01 to 2001-06-01, 16 x 8 pixels of 0.1 mas>
    """

    @classmethod
    def read(
        cls, paths: Path | str | Sequence[Path | str], *, frame: str = "offset",
        times: Time | Sequence[Any] | None = None,
        beams: Beam | Sequence[Beam] | None = None, check: bool = True,
        region: Any = None, pad: int = 0,
    ) -> EpochCube:  # fmt: skip
        """
        Read FITS images, one per epoch, or a file that `write` made.

        Lists of components, as `read_components` reads them, are restored with their
        beams or ``beams``.

        Images on one grid are stacked with their reference pixels aligned.  Others,
        also of another size, are shifted by whole pixels, or resampled with a warning,
        onto the finest grid, which is enlarged to hold all of them.

        Parameters
        ----------
        paths : str, path-like, or sequence of them
            Files, or patterns such as ``"3c273/*.fits"``.  One of several images of a
            file is chosen behind its name, ``"m87.fits[SCI,2]"``.
        frame : {"offset", "absolute"}
            Align the epochs by their reference pixels, or by their celestial
            coordinates, which in VLBI differ between epochs by more than features
            move.
        times : `~astropy.time.Time` or sequence, optional
            Dates in the order of the files (alphabetical for a pattern), instead of
            those in the headers.  For an entry None the header's date is used.
        beams : beam or sequence of beams, optional
            Beams to use instead of those in the headers.
        check : bool
            Refuse files of another object or band, of the date of another file or
            without a beam where others have one, and files that look like masks.
        region, pad : optional
            As in `crop`: read only the bounding box of a region and ``pad`` pixels
            around it, for images that are too large or too many for the memory.
            Pixel coordinates are those of the earliest epoch.

        Returns
        -------
        `EpochCube`

        Raises
        ------
        OSError
            If a file is missing or is not a FITS image.
        ValueError
            If a header lacks what is needed, or files do not belong together.
        MemoryError
            If the images need more memory than this machine has.

        Notes
        -----
        Scale and north are those of the sky where the structure is.  Where the
        reference pixel lies far from the images, or the projection is not flat around
        it, they get a tangent plane at the brightest pixel, or in the middle of the
        structure; this pixel is then the origin of offsets, and such epochs are aligned
        by their coordinates.  Where the scale differs by more than 2% over the
        structure, the images are resampled onto a tangent plane with a warning, and
        what covers too much of the sky for one is refused.  Directions refer to north
        at the origin, and a warning says by how much it turns.

        Regions may be drawn in any celestial frame; their angles are turned to the
        north of the images.

        Examples
        --------
        >>> from astro_scc import EpochCube
        >>> cube = EpochCube.read("../shared/data/0003+380/*.fits")
        >>> len(cube), cube.labels[0]
        (10, '0003+380.u.2006_03_09.fits')
        """
        files = fits.find_files(paths)
        first, kind = files[0], kind_of(files[0])
        if kind == "cube" and len(files) == 1:
            if times is not None or beams is not None:
                raise ValueError(f"{first}: an EpochCube; it has its dates and beams")
            lazy = region is not None
            cube = serialize.read_object(first, creator=fits.CUBE_CREATOR, lazy=lazy)
        elif kind == "components":
            cube = restore_files(cls, files, times=times, beams=beams)
        else:
            options = {"check": check, "region": region, "pad": pad}
            return cls._of(**reading.read_files(files, times, beams, frame, **options))
        return cube if region is None else cube.crop(region, pad)

    @classmethod
    def from_ccddata(
        cls, images: Sequence[NDData], times: Time | Sequence[Any] | None = None,
        beams: Beam | Sequence[Beam] | None = None, *, frame: str = "offset",
        check: bool = True,
    ) -> EpochCube:  # fmt: skip
        """
        Stack CCDData or other NDData with celestial WCS, one per epoch.

        Parameters
        ----------
        images : sequence of `~astropy.nddata.NDData`
            Or objects with an ``hdu``, such as the images of spectral-cube.
            Pixels without a finite uncertainty are bad.  If all images have
            uncertainties, the median standard deviation of each is its ``noise``.
        times : `~astropy.time.Time` or sequence, optional
            By default from the ``meta`` of each image, with the keys of FITS.
        beams : beam or sequence of beams, optional
            By default from the ``meta`` of each image.
        frame, check
            As in `read`.

        Returns
        -------
        `EpochCube`
        """
        images = [images] if isinstance(images, NDData) else list(images)
        return cls._of(**reading.read_images(images, times, beams, frame, check=check))

    @classmethod
    def from_ndcube(
        cls, ndcube: NDCube | NDCubeSequence, times: Time | Sequence[Any] | None = None,
        beams: Beam | Sequence[Beam] | None = None,
    ) -> EpochCube:  # fmt: skip
        """
        Return the epochs of an NDCube, which may be sliced or rebinned.

        Parameters
        ----------
        ndcube : `ndcube.NDCube` or `ndcube.NDCubeSequence`
            It has two celestial axes, and one of the epochs if there are several;
            each item of a sequence is an epoch.
        times : `~astropy.time.Time`, optional
            By default the coordinate of type Time, or the date in the meta.
        beams : beam or sequence of beams, optional
            By default those in the meta, which `to_ndcube` keeps.

        Returns
        -------
        `EpochCube`

        Raises
        ------
        TypeError
            If it is no NDCube and no sequence of them.
        """
        if not (hasattr(ndcube, "data") and hasattr(ndcube, "meta")):
            kind = type(ndcube).__name__
            raise TypeError(
                f"a {kind} is no NDCube; give one of its cubes, or make an "
                "NDCubeSequence of those that are epochs"
            )
        many = isinstance(ndcube.data, list | tuple)
        images = ndcube.data if many else reading.epochs_of(ndcube, times)
        fields = reading.read_images(images, times, beams, "offset", check=False)
        meta = fields["meta"]
        if set(serialize.KEPT) <= (ndcube.meta or {}).keys():
            meta = {k: v for k, v in ndcube.meta.items() if k not in serialize.KEPT}
        meta["history"] = [*meta.get("history", ()), "from an NDCube"]
        return cls._of(**fields | {"epoch_wcs": None, "meta": meta})

    # Functions of other modules that take a cube are its methods.
    from_components = classmethod(restore)
    to_ndcube = serialize.to_ndcube
    write = serialize.write_cube
    to_common_beam = grid.common_beam
    align = align
    misalignment = cached_property(misalignment)
    reproject_to = grid.reproject_cube
    crop = regions.crop
    region_mask = regions.region_mask

    @property
    def epochs(self) -> QTable:
        """
        Facts about the epochs, a `~astropy.table.QTable` with one row per epoch.

        The columns are ``epoch``, ``label``, ``date``, ``major``, ``minor``, ``pa``
        (if the cube has beams), ``noise`` (given or measured), ``object`` and
        ``frequency`` (NaN where unknown).
        """
        table = QTable({"epoch": np.arange(len(self)), "label": list(self.labels)})
        table["date"] = Time(self.times, format="isot")
        for name in ("major", "minor", "pa") if self.beams is not None else ():
            table[name] = u.Quantity([getattr(beam, name) for beam in self.beams])
        table["noise"] = self.noise_rms()
        table["object"] = [str(facts.get("object", "")) for facts in self.epoch_meta]
        frequency = [facts.get("frequency", np.nan) for facts in self.epoch_meta]
        table["frequency"] = np.divide(frequency, 1e9) * u.GHz
        return table

    def __repr__(self):
        n, ny, nx = self.shape
        dates = date_labels(self.times)
        span = f"{n} epochs {dates[0]} to {dates[-1]}"
        parts = [span if n > 1 else f"1 epoch {dates[0]}"]
        parts.append(f"{nx} x {ny} pixels of {readable_angle(self.pixel_scale)}")
        if self.unit != u.dimensionless_unscaled:
            parts.append(f"{self.unit}")
        if self.beams is not None:
            beam = self.beams[0]
            size = f"beam {readable_angle(beam.major)} x {readable_angle(beam.minor)}"
            same = different_beam(self.beams) is None
            parts.append(size if same else "beams that differ")
        return f"<EpochCube {', '.join(parts)}>"

    def _repr_html_(self):
        return f"<p>{escape(repr(self)[1:-1])}</p>" + self.epochs._repr_html_()

    def plot(self, epoch: int | None = None, ssps: Any = None, **kwargs: Any) -> Figure:
        """
        Draw one epoch, or up to twelve that are evenly selected.

        Parameters
        ----------
        epoch : int, optional
            Index of the epoch; by default several epochs, one panel each.
        ssps : `~astropy.table.QTable` or `~astro_scc.decomposition.SSPs`, optional
            SSPs to draw on the images.
        **kwargs
            ``unit`` of the offsets; ``norm``, a `matplotlib.colors.Normalize` of the
            brightness, by default linear up to three times the noise and logarithmic
            above; ``zoom``, whether to show only the part with SSPs.  Of one epoch also
            ``ax`` and ``colorbar``, of several ``figure`` and ``max_panels``.

        Returns
        -------
        `matplotlib.figure.Figure`
        """
        # It imports this module.
        figures = import_module("astro_scc.visualization.images")
        if epoch is None:
            return figures.plot_epochs(self, ssps, **kwargs)
        return figures.plot_epoch(self, epoch, ssps, **kwargs)
