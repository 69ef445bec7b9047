# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The images of one object at many dates, on one pixel grid."""

from __future__ import annotations

import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, overload

import astropy.units as u
import numpy as np
from astropy.nddata import CCDData, NDData, StdDevUncertainty
from astropy.time import Time
from astropy.wcs import WCS
from numpy.typing import ArrayLike

from astro_scc.epochs import positions, validation
from astro_scc.epochs.alignment import align
from astro_scc.epochs.beam import Beam, common_beam
from astro_scc.epochs.component_tables import is_component_list
from astro_scc.epochs.cutout import crop, region_mask
from astro_scc.epochs.fits import CUBE_CREATOR, find_files
from astro_scc.epochs.grid import reproject_cube
from astro_scc.epochs.headers import epoch_header
from astro_scc.epochs.inspection import epoch_table, noise_of_images, noise_rms
from astro_scc.epochs.positions import offset_wcs, readable_angle
from astro_scc.epochs.reading import read_files, read_images
from astro_scc.epochs.registration import misalignment
from astro_scc.epochs.serialize import is_cube_file, read_object, write_cube
from astro_scc.epochs.validation import (
    as_celestial,
    as_epoch_tuple,
    date_labels,
    epoch_index,
)

if TYPE_CHECKING:
    from astropy.coordinates import SkyCoord
    from astropy.table import QTable
    from matplotlib.figure import Figure
    from ndcube import NDCube, NDCubeSequence


def _picked(each, epochs):
    """Return the fields that have a value per epoch, for some epochs."""
    return {
        name: tuple(values[i] for i in epochs)
        if isinstance(values, tuple)
        else values[epochs]
        for name, values in each.items()
        if values is not None
    }


def _above(room):
    """Return a module that imports this one, so only when it is needed."""
    return import_module(f"astro_scc.{room}")


@dataclass(frozen=True, eq=False, repr=False)
class EpochCube:
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

    data: np.ndarray
    times: Time
    wcs: WCS
    unit: u.UnitBase = u.dimensionless_unscaled
    mask: np.ndarray = None
    beams: Sequence[Beam] | None = None
    noise: u.Quantity | None = None
    labels: Sequence[str] = ()
    epoch_wcs: Sequence[WCS] | None = None
    epoch_meta: Sequence[dict] = ()
    meta: dict = field(default_factory=dict)

    def __post_init__(self):
        data, mask, unit = validation.as_stack(self.data, self.mask, self.unit)
        n = len(data)
        times = validation.as_times(self.times, n)
        labels = as_epoch_tuple(self.labels, n, "labels", str) or date_labels(times)
        own_wcs = as_epoch_tuple(self.epoch_wcs, n, "epoch_wcs", as_celestial)
        facts = as_epoch_tuple(self.epoch_meta, n, "epoch_meta", dict)
        each = {
            "data": data,
            "mask": validation.as_mask(data, mask, labels),
            "times": times,
            "labels": labels,
            "beams": validation.as_beams(self.beams, n),
            "noise": validation.as_noise(self.noise, n, unit),
            "epoch_wcs": own_wcs or None,
            "epoch_meta": facts or tuple({} for _ in range(n)),
        }
        order = np.argsort((times - times[0]).jd, kind="stable")
        if np.any(np.diff(order) < 0):
            each |= _picked(each, order)
        common = {"wcs": as_celestial(self.wcs), "unit": unit, "meta": dict(self.meta)}
        vars(self).update(each, **common)

    @classmethod
    def read(
        cls, paths: Path | str | Sequence[Path | str], *, frame: str = "offset",
        times: Time | Sequence[Any] | None = None,
        beams: Beam | Sequence[Beam] | None = None, hdu: int | str | None = None,
        check: bool = True, region: Any = None, pad: int = 0,
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
            Files, or patterns such as ``"3c273/*.fits"``.
        frame : {"offset", "absolute"}
            Align the epochs by their reference pixels, or by their celestial
            coordinates, which in VLBI differ between epochs by more than features
            move.
        times : `~astropy.time.Time` or sequence, optional
            Dates in the order of the files (alphabetical for a pattern), instead of
            those in the headers.  For an entry None the header's date is used.
        beams : beam or sequence of beams, optional
            Beams to use instead of those in the headers.
        hdu : int or str, optional
            Extension of the image, by default the first image.
        check : bool
            Refuse files of another object or band, and files that look like masks.
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

        Examples
        --------
        >>> from astro_scc import EpochCube
        >>> cube = EpochCube.read("../shared/data/0003+380/*.fits")
        >>> len(cube), cube.labels[0]
        (10, '0003+380.u.2006_03_09.fits')
        """
        files = find_files(paths)
        first, only = files[0], len(files) == 1
        if only and is_cube_file(first):
            if any(value is not None for value in (times, beams, hdu)):
                raise ValueError(f"{first}: an EpochCube; it has its dates and beams")
            lazy = region is not None
            cube = read_object(first, creator=CUBE_CREATOR, lazy=lazy)
        elif is_component_list(first):
            room = _above("epochs.restoring")
            cube = room.restore_files(files, times=times, beams=beams)
        else:
            options = {"check": check, "hdu": hdu, "region": region, "pad": pad}
            return cls(**read_files(files, times, beams, frame, **options))
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
        return cls(**read_images(images, times, beams, frame, check=check))

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
        """
        return _above("interchange.containers").from_ndcube(
            ndcube, times=times, beams=beams
        )

    @classmethod
    def from_arrays(
        cls, data: ArrayLike, times: Time | Sequence[Any], *, pixel_scale: u.Quantity,
        reference_pixel: tuple[float, float] | None = None,
        position: SkyCoord | None = None, **fields: Any,
    ) -> EpochCube:  # fmt: skip
        """
        Return a cube of arrays with east to the left and north up.

        Parameters
        ----------
        data : array_like, shape (n_epochs, ny, nx)
        times : `~astropy.time.Time` or sequence of str, shape (n_epochs,)
        pixel_scale : `~astropy.units.Quantity`
            Side of a pixel, an angle.
        reference_pixel : tuple of float, optional
            (x, y) of the origin of offsets, counted from 0; by default the centre.
        position : `~astropy.coordinates.SkyCoord`, optional
            Celestial position of the reference pixel.
        **fields
            ``unit``, ``mask``, ``beams``, ``noise``, ``labels``, ``epoch_meta`` and
            ``meta`` of an `EpochCube`.

        Returns
        -------
        `EpochCube`

        Raises
        ------
        ValueError
            If shapes or numbers of epochs disagree.
        """
        shape = np.shape(data)
        if len(shape) != 3:
            raise ValueError(f"data must have shape (n_epochs, ny, nx), got {shape}")
        if reference_pixel is None:
            reference_pixel = (shape[2] - 1) / 2, (shape[1] - 1) / 2
        fields = {"meta": {"history": [f"{shape[0]} epochs from arrays"]}, **fields}
        wcs = offset_wcs(pixel_scale, reference_pixel, position)
        return cls(data=data, times=times, wcs=wcs, **fields)

    # Functions of the subpackage that take a cube are its methods; ClassVar: no field.
    write = write_cube
    epochs: ClassVar[QTable] = property(epoch_table)
    noise_rms = noise_rms
    measured_noise = cached_property(noise_of_images)
    to_common_beam = common_beam
    align = align
    misalignment = cached_property(misalignment)
    reproject_to = reproject_cube
    crop = crop
    region_mask = region_mask
    pixel_matrix: ClassVar[u.Quantity] = property(positions.pixel_matrix)
    pixel_scale: ClassVar[u.Quantity] = property(positions.pixel_scale)
    reference_pixel: ClassVar[tuple[float, float]] = property(positions.reference_pixel)
    speed_unit: ClassVar[u.UnitBase] = property(positions.speed_unit)
    facts: ClassVar[dict[str, Any]] = property(positions.facts)
    pixel_to_offset = positions.pixel_to_offset
    offset_to_pixel = positions.offset_to_pixel
    offsets = positions.offsets

    def __len__(self) -> int:
        return self.data.shape[0]

    def __iter__(self) -> Iterator[CCDData]:
        return (self[i] for i in range(len(self)))

    @overload
    def __getitem__(self, item: int) -> CCDData: ...
    @overload
    def __getitem__(self, item: slice | Sequence[int] | np.ndarray) -> EpochCube: ...
    def __getitem__(self, item: Any) -> Any:
        if isinstance(item, tuple):
            raise TypeError("index epochs only, cube[i] or cube[i:j]; crop() cuts out")
        try:
            return self._image(operator.index(item))
        except TypeError:
            pass
        keep = np.arange(len(self))[item]
        if keep.ndim != 1 or keep.size == 0:
            raise ValueError(f"the selection {item!r} holds none of {len(self)} epochs")
        names = "data mask times labels beams noise epoch_wcs epoch_meta".split()
        return replace(self, **_picked({n: getattr(self, n) for n in names}, keep))

    def _image(self, index):
        index = epoch_index(index, len(self))
        noise = self.noise
        if noise is not None:
            every = np.full(self.shape[1:], noise[index].value)
            noise = StdDevUncertainty(every, unit=self.unit, copy=False)
        return CCDData(
            self.data[index],
            uncertainty=noise,
            unit=self.unit,
            mask=self.mask[index],
            wcs=self.wcs.deepcopy(),
            meta=epoch_header(self, index),
        )

    def with_step(self, line: str, **changes: Any) -> EpochCube:
        """
        Return a copy with changed fields and one more line of provenance.

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
        meta = changes.pop("meta", self.meta)
        meta = {**meta, "history": [*meta.get("history", ()), line]}
        return replace(self, meta=meta, **changes)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the data, (n_epochs, ny, nx)."""
        return self.data.shape

    @property
    def years(self) -> u.Quantity:
        """Dates as years since the first epoch, shape (n_epochs,)."""
        return (self.times - self.times[0]).to(u.yr)

    def mean_image(self) -> CCDData:
        """
        Return the mean image, each pixel averaged over the epochs that have it.

        Returns
        -------
        `~astropy.nddata.CCDData`
            Masked and NaN where no epoch has the pixel.
        """
        count = np.sum(~self.mask, axis=0)
        total = np.sum(self.data, axis=0, where=~self.mask)
        mean = np.full(total.shape, np.nan)
        np.divide(total, count, out=mean, where=count > 0)
        wcs, meta = self.wcs.deepcopy(), {"n_epochs": len(self)}
        return CCDData(mean, unit=self.unit, mask=count == 0, wcs=wcs, meta=meta)

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
            same = all(other == beam for other in self.beams)
            parts.append(size if same else "beams that differ")
        return f"<EpochCube {', '.join(parts)}>"

    def _repr_html_(self):
        return f"<p>{escape(repr(self)[1:-1])}</p>" + self.epochs._repr_html_()

    def to_ndcube(self) -> NDCube:
        """
        Return the cube as NDCube of (epoch, latitude, longitude).

        Returns
        -------
        `ndcube.NDCube`
            The dates are its extra coordinate ``time``, the noise its uncertainty; its
            meta has the labels, beams and facts of all epochs.
        """
        return _above("interchange.containers").to_ndcube(self)

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
            ``unit`` of the offsets; ``stretch``, "asinh", "log" or "linear"; ``vmin``
            and ``vmax``, the brightness at the ends of the colours; ``zoom``, whether
            to show only the part with SSPs.  Of one epoch also ``ax`` and ``colorbar``,
            of several ``figure`` and ``max_panels``.

        Returns
        -------
        `matplotlib.figure.Figure`
        """
        figures = _above("visualization.epochs")
        if epoch is None:
            return figures.plot_epochs(self, ssps, **kwargs)
        return figures.plot_epoch(self, epoch, ssps, **kwargs)
