# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The record of a series of images on one pixel grid, its geometry and its noise."""

from __future__ import annotations

import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Self, TypeVar, overload

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.nddata import CCDData, StdDevUncertainty
from astropy.time import Time
from astropy.wcs import WCS
from astropy.wcs.utils import wcs_to_celestial_frame
from numpy.typing import ArrayLike

from astro_scc.decomposition.wavelet import measure_noise
from astro_scc.exceptions import warn
from astro_scc.images import positions, validation
from astro_scc.images.beam import Beam
from astro_scc.images.headers import epoch_header
from astro_scc.images.validation import as_celestial, as_epoch_tuple
from astro_scc.units import PM_UNIT, speed_unit

Series = TypeVar("Series", bound="ImageSeries")

#: Fields that have a value for each epoch.
EACH = "data", "mask", "times", "labels", "beams", "noise", "epoch_wcs", "epoch_meta"
#: Fields that `ImageSeries.from_arrays` takes as they are.
FIELDS = (
    "unit", "mask", "beams", "noise", "labels", "epoch_wcs", "epoch_meta", "meta",
)  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class ImageSeries:
    """
    Images of one object at many dates on one pixel grid, in order of date.

    The fields are those of an `~astro_scc.epochs.EpochCube`.  They are checked and
    converted once, when they are given; the steps of this package make others of them
    that need no checks.
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
        labels = as_epoch_tuple(self.labels, n, "labels", str)
        facts = as_epoch_tuple(self.epoch_meta, n, "epoch_meta", dict)
        own = as_epoch_tuple(self.epoch_wcs, n, "epoch_wcs", as_celestial)
        vars(self).update(
            data=data,
            mask=validation.as_mask(data, mask),
            times=times,
            labels=labels or validation.date_labels(times),
            beams=validation.as_beams(self.beams, n),
            noise=validation.as_noise(self.noise, n, unit),
            epoch_wcs=own,
            epoch_meta=facts or tuple({} for _ in range(n)),
            wcs=as_celestial(self.wcs),
            unit=unit,
            meta=dict(self.meta),
        )
        self._refuse_empty()
        order = validation.order_of(times)
        days = times.jd[order]
        for k in np.flatnonzero(np.diff(days) * 86400 < 1)[:1]:
            date = times.isot[order[k]]
            warn(f"two images are of {date}; leave one out, or average them")
        if np.any(np.diff(order) < 0):
            vars(self).update(self._picked(order))

    @classmethod
    def from_arrays(
        cls, data: ArrayLike, times: Time | Sequence[Any], *, pixel_scale: u.Quantity,
        reference_pixel: tuple[float, float] | None = None,
        position: SkyCoord | None = None, **fields: Any,
    ) -> Self:  # fmt: skip
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
        TypeError
            If an argument is of another kind, or not known.
        ValueError
            If shapes or numbers of epochs disagree.

        Warns
        -----
        EpochWarning
            If two images are of one date.
        """
        if unknown := sorted(fields.keys() - set(FIELDS)):
            raise TypeError(
                f"from_arrays has no {unknown[0]!r}; it takes {', '.join(FIELDS)}"
            )
        try:
            n, ny, nx = (*np.shape(data), 1, 1, 1)[:3]
        except ValueError:
            shapes = ", ".join(sorted({str(np.shape(image)) for image in data}))
            raise ValueError(f"the images differ in shape: {shapes}") from None
        if reference_pixel is None:
            reference_pixel = (nx - 1) / 2, (ny - 1) / 2
        fields = {"meta": {"history": [f"{n} epochs from arrays"]}, **fields}
        wcs = positions.offset_wcs(pixel_scale, reference_pixel, position)
        return cls(data=data, times=times, wcs=wcs, **fields)

    @classmethod
    def _of(cls, **fields: Any) -> Self:
        """Return a series of fields as ``__post_init__`` makes them."""
        made = object.__new__(cls)
        vars(made).update(fields)
        made._refuse_empty()
        return made

    def _refuse_empty(self):
        empty = np.flatnonzero(self.mask.all(axis=(1, 2)))
        if empty.size:
            label = self.labels[empty[0]]
            raise ValueError(f"{label}: no valid pixel; leave this epoch out")

    def _picked(self, epochs):
        """Return the fields that have a value for each epoch, for some epochs."""
        found = {name: getattr(self, name) for name in EACH}
        return {
            name: tuple(values[i] for i in epochs)
            if isinstance(values, tuple)
            else values[epochs]
            for name, values in found.items()
            if values is not None
        }

    def _changed(self, **changes):
        own = {each.name: getattr(self, each.name) for each in fields(self)}
        return self._of(**own | changes)

    def with_step(self, line: str, **changes: Any) -> Self:
        """
        Return a copy with changed fields and one more line of provenance.

        Parameters
        ----------
        line : str
            What was done, for ``meta["history"]``.
        **changes
            Fields of the new cube, which are taken as they are: of the types and shapes
            of those of this cube, with all pixels masked that are not finite.

        Returns
        -------
        `EpochCube`
        """
        if self.noise is not None and changes.get("noise", self.noise) is None:
            line += "; the noise, which had been given, is measured in the new images"
        meta = changes.pop("meta", self.meta)
        meta = {**meta, "history": [*meta.get("history", ()), line]}
        each = {k: tuple(v) for k, v in changes.items() if isinstance(v, list)}
        made = self._changed(**changes | each, meta=meta)
        if not changes:
            # What has been measured in the same images holds.
            vars(made).update(vars(self) | vars(made))
        return made

    def __len__(self) -> int:
        return self.data.shape[0]

    def __iter__(self) -> Iterator[CCDData]:
        return (self[i] for i in range(len(self)))

    @overload
    def __getitem__(self, item: int) -> CCDData: ...
    @overload
    def __getitem__(self, item: slice | Sequence[int] | np.ndarray) -> Self: ...
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
        keep = keep[validation.order_of(self.times[keep])]
        return self._changed(**self._picked(keep))

    def _image(self, index):
        index = validation.epoch_index(index, len(self))
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

    def noise_rms(self) -> u.Quantity:
        """
        Return the noise of each epoch, as given or else as measured.

        Returns
        -------
        `~astropy.units.Quantity`, shape (n_epochs,)
            See ``measure_noise``.
        """
        return self.measured_noise if self.noise is None else self.noise

    @cached_property
    def measured_noise(self) -> u.Quantity:
        """Noise of each epoch as measured in its image."""
        return u.Quantity(list(map(measure_noise, self.data, self.mask)), self.unit)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the data, (n_epochs, ny, nx)."""
        return self.data.shape

    @property
    def years(self) -> u.Quantity:
        """Dates as years since the first epoch, shape (n_epochs,)."""
        return (self.times - self.times[0]).to(u.yr)

    @property
    def speed_unit(self) -> u.UnitBase:
        """Unit of proper motions that suits the dates and the resolution."""
        days = np.unique((self.times - self.times[0]).jd) * u.day
        if len(days) < 2:
            return PM_UNIT
        width, median = positions.resolution(self), np.median(np.diff(days))
        return speed_unit(days[-1], width, median)

    @property
    def facts(self) -> dict[str, Any]:
        """Name and position of the source, dates and beam, for the meta of tables."""
        first, last = self.times[[0, -1]].strftime("%Y-%m-%d").tolist()
        found = {"n_epochs": len(self), "first_epoch": first, "last_epoch": last}
        if name := self.meta.get("object"):
            found["object"] = str(name)
        place = tuple(self.wcs.wcs.crval)
        if place != positions.UNKNOWN and positions.axis_words(self)[0] == "east":
            sky = SkyCoord(*place, unit="deg", frame=wcs_to_celestial_frame(self.wcs))
            found["position"] = sky.icrs.to_string("hmsdms", precision=5)
        if self.beams is not None:
            beam, n = self.beams[0], len(set(self.beams))
            several = f", that of the first of {len(self)} epochs" if n > 1 else ""
            found["beam"] = f"{beam}{several}"
        return found

    @property
    def pixel_matrix(self) -> u.Quantity:
        """
        Offsets (east, north) of one pixel step in (x, y), shape (2, 2).

        ``(east, north) = pixel_matrix @ (dx, dy)``.  It is the CD matrix of the
        WCS in angles.
        """
        return (self.wcs.pixel_scale_matrix * u.deg).to(u.mas)

    @property
    def pixel_scale(self) -> u.Quantity:
        """Side of a square pixel with the area of the cube's pixels."""
        return np.sqrt(np.abs(np.linalg.det(self.pixel_matrix.value))) * u.mas

    @property
    def reference_pixel(self) -> tuple[float, float]:
        """(x, y) of the origin of offsets, counted from 0."""
        x, y = self.wcs.wcs.crpix - 1
        return float(x), float(y)

    def pixel_to_offset(
        self, x: ArrayLike, y: ArrayLike
    ) -> tuple[u.Quantity, u.Quantity]:
        """
        Return the offsets of pixels from the reference pixel, in its tangent plane.

        Parameters
        ----------
        x, y : array_like
            Pixels, counted from 0.

        Returns
        -------
        east, north : `~astropy.units.Quantity`
            In mas, with the broadcast shape of ``x`` and ``y``.
        """
        x0, y0 = self.reference_pixel
        step = np.stack(np.broadcast_arrays(np.subtract(x, x0), np.subtract(y, y0)))
        east, north = np.tensordot(self.pixel_matrix.value, step, axes=1)
        return east * u.mas, north * u.mas

    def offset_to_pixel(
        self, east: u.Quantity, north: u.Quantity
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the pixels of offsets, the inverse of `pixel_to_offset`.

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

    def offsets(self) -> tuple[u.Quantity, u.Quantity]:
        """
        Return the offsets of all pixels from the reference pixel.

        Returns
        -------
        east, north : `~astropy.units.Quantity`, shape (ny, nx)
        """
        y, x = np.indices(self.shape[1:])
        return self.pixel_to_offset(x, y)
