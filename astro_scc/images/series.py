# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A series of images on one pixel grid, made of what users give, and its geometry."""

from __future__ import annotations

import operator
from collections.abc import Iterator, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Self, TypeVar, overload

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.io.fits import Header
from astropy.nddata import CCDData, NDData, StdDevUncertainty
from astropy.time import Time
from astropy.utils.masked import Masked
from astropy.wcs import WCS
from astropy.wcs.utils import wcs_to_celestial_frame
from numpy.typing import ArrayLike

from astro_scc.decomposition.wavelet import measure_noise
from astro_scc.exceptions import refusing, warn
from astro_scc.images import dates, headers, pixels, positions
from astro_scc.images.beam import BEAM, Beam, as_beam, different_beam
from astro_scc.intervals import median_interval
from astro_scc.units import PM_UNIT, speed_unit

Series = TypeVar("Series", bound="ImageSeries")

#: Fields that have a value for each epoch.
EACH = "data", "mask", "times", "labels", "beams", "noise", "epoch_wcs", "epoch_meta"


@dataclass(frozen=True, eq=False, repr=False)
class ImageSeries:
    """
    Images of one object at many dates on one pixel grid, in order of date.

    The fields are those of an `~astro_scc.epochs.EpochCube`.  They are checked and
    converted once, when they are given; the steps of this package make others of them
    that need no checks.
    """

    data: np.ndarray
    times: Time = None
    wcs: WCS = None
    unit: u.UnitBase = u.dimensionless_unscaled
    mask: np.ndarray = None
    beams: Sequence[Beam] | None = None
    noise: u.Quantity | None = None
    labels: Sequence[str] = ()
    epoch_wcs: Sequence[WCS] | None = None
    epoch_meta: Sequence[dict] = ()
    meta: dict = field(default_factory=dict)

    def __post_init__(self):
        if self.times is None or self.wcs is None:
            raise TypeError(
                "an EpochCube needs data, times and wcs; EpochCube.from_arrays(data, "
                "times, pixel_scale=...) makes it of arrays without a wcs"
            )
        data, mask, unit = as_stack(self.data, self.mask, self.unit)
        n = len(data)
        times = dates.as_times(self.times, n)
        labels = as_epoch_tuple(self.labels, n, "labels", str)
        labels = labels or dates.date_labels(times)
        facts = as_epoch_tuple(self.epoch_meta, n, "epoch_meta", dict)
        facts = facts or tuple({} for _ in range(n))
        each_wcs = as_epoch_tuple(self.epoch_wcs, n, "epoch_wcs", headers.as_celestial)
        beams, noise = as_beams(self.beams, n), as_noise(self.noise, n, unit)
        mask, wcs = as_mask(data, mask), headers.as_celestial(self.wcs)
        refuse_empty(mask, labels)
        if not positions.is_flat(wcs, data.shape[1:]):
            wcs = flat_wcs(wcs, data, mask)
        order = times.argsort()
        dates.warn_of_equal_dates(times[order])
        values = data, mask, times, labels, beams, noise, each_wcs, facts
        each = dict(zip(EACH, values, strict=True))
        if np.any(np.diff(order) < 0):
            each = picked(each, order)
        vars(self).update(each, unit=unit, wcs=wcs, meta=dict(self.meta))

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
        mask, unit = (fields.pop(name, None) for name in ("mask", "unit"))
        data, mask, unit = as_stack(data, mask, unit)
        n, ny, nx = data.shape
        if reference_pixel is None:
            reference_pixel = (nx - 1) / 2, (ny - 1) / 2
        wcs = positions.offset_wcs(pixel_scale, reference_pixel, position)
        fields = {"meta": {"history": [f"{n} epochs from arrays"]}, **fields}
        return cls(data=data, times=times, wcs=wcs, unit=unit, mask=mask, **fields)

    @classmethod
    def _of(cls, **fields: Any) -> Self:
        """Return a series of fields as ``__post_init__`` makes them."""
        made = object.__new__(cls)
        vars(made).update(fields)
        refuse_empty(made.mask, made.labels)
        return made

    def _changed(self, **changes):
        present = {each.name: getattr(self, each.name) for each in fields(self)}
        return self._of(**present | changes)

    def with_step(self, line: str, **changes: Any) -> Self:
        """
        Return a copy with changed fields and one more line of provenance.

        Parameters
        ----------
        line : str
            What was done, for ``meta["history"]``.
        **changes
            Fields of the new cube, as they are: like those of this cube, with all
            pixels masked that are not finite.

        Returns
        -------
        `EpochCube`
        """
        if self.noise is not None and changes.get("noise", self.noise) is None:
            line += "; the noise, which had been given, is measured in the new images"
        meta = changes.pop("meta", self.meta)
        meta = {**meta, "history": [*meta.get("history", ()), line]}
        each = {k: tuple(v) for k, v in changes.items() if isinstance(v, list)}
        if changes:
            return self._changed(**changes | each, meta=meta)
        # What has been measured in the same images holds.
        made = copy(self)
        vars(made).update(meta=meta)
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
        if not (hasattr(item, "__index__") and np.ndim(item) == 0):
            keep = np.asarray(np.arange(len(self))[item])
            if keep.ndim != 1 or keep.size == 0:
                raise ValueError(
                    f"the selection {item!r} holds none of {len(self)} epochs"
                )
            keep = keep[self.times[keep].argsort()]
            each = {name: getattr(self, name) for name in EACH}
            return self._changed(**picked(each, keep))
        index = epoch_index(item, len(self))
        noise = None
        if self.noise is not None:
            every = np.full(self.shape[1:], self.noise[index].value)
            noise = StdDevUncertainty(every, unit=self.unit, copy=False)
        return CCDData(
            self.data[index], mask=self.mask[index], unit=self.unit, uncertainty=noise,
            wcs=self.wcs.deepcopy(), meta=epoch_header(self, index),
        )  # fmt: skip

    def mean_image(self) -> CCDData:
        """
        Return the mean image, each pixel averaged over the epochs that have it.

        Returns
        -------
        `~astropy.nddata.CCDData`
            Masked and NaN where no epoch has the pixel.
        """
        mean = mean_of(self.data, self.mask)
        wcs, meta = self.wcs.deepcopy(), {"n_epochs": len(self)}
        return CCDData(mean, unit=self.unit, mask=np.isnan(mean), wcs=wcs, meta=meta)

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
        return u.Quantity([*map(measure_noise, self.data, self.mask)], self.unit)

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
        return speed_unit(days[-1], self.resolution, median_interval(days))

    @property
    def facts(self) -> dict[str, Any]:
        """Name and position of the source, dates and beam, for the meta of tables."""
        labels = dates.date_labels(self.times)
        found = {"n_epochs": len(self), "first_epoch": labels[0]}
        found["last_epoch"] = labels[-1]
        if name := self.meta.get("object"):
            found["object"] = str(name)
        place = tuple(self.wcs.wcs.crval)
        if place != positions.UNKNOWN and positions.axis_words(self)[0] == "east":
            sky = SkyCoord(*place, unit="deg", frame=wcs_to_celestial_frame(self.wcs))
            found["position"] = sky.icrs.to_string("hmsdms", precision=5)
        if self.beams is not None:
            beam, differ = self.beams[0], different_beam(self.beams) is not None
            several = f", that of the first of {len(self)} epochs" if differ else ""
            found["beam"] = f"{beam}{several}"
        return found

    @property
    def pixel_matrix(self) -> u.Quantity:
        """
        Offsets (east, north) of one pixel step in (x, y), shape (2, 2).

        ``(east, north) = pixel_matrix @ (dx, dy)``.  It is the CD matrix of the
        WCS in angles, which holds where the structure is: if that of the images does
        not, ``wcs`` is a tangent plane there.
        """
        return (self.wcs.pixel_scale_matrix * u.deg).to(u.mas)

    @property
    def pixel_scale(self) -> u.Quantity:
        """Side of a square pixel with the area of the cube's pixels."""
        return np.sqrt(np.abs(np.linalg.det(self.pixel_matrix.value))) * u.mas

    @cached_property
    def resolution(self) -> u.Quantity:
        """Width of one beam, the epochs' median; three pixels without beams."""
        if self.beams is None:
            return positions.PIXELS_RESOLVED * self.pixel_scale
        axes = np.array([(beam.major.value, beam.minor.value) for beam in self.beams])
        return np.median(np.sqrt(axes.prod(axis=1))) * u.mas

    @property
    def beam_shapes(self) -> list[np.ndarray]:
        """Covariances of the beams over (x, y) in square pixels."""
        to_pixels = np.linalg.inv(self.pixel_matrix.value)
        return [to_pixels @ b.covariance.value @ to_pixels.T for b in self.beams]

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


def epoch_header(cube, i):
    """Return the date, label, beam, noise and facts of an epoch as a FITS header."""
    time = cube.times[i]
    header = Header()
    header["DATE-OBS"] = time.isot
    header["TIMESYS"] = time.scale.upper()
    header["LABEL"] = cube.labels[i].encode("ascii", "replace").decode()
    if cube.beams is not None:
        axes = (getattr(cube.beams[i], name) for name in ("major", "minor", "pa"))
        header.update(zip(BEAM, (axis.to_value(u.deg) for axis in axes), strict=True))
    if cube.noise is not None:
        header["NOISE"] = cube.noise[i].value, f"rms, {cube.noise.unit}"
    facts = cube.epoch_meta[i]
    for fact, row in headers.KEYWORDS["facts"].items():
        if fact in facts:
            header[row["keywords"][0]] = facts[fact]
    return header


def refuse_empty(mask, labels):
    """Refuse images without a pixel."""
    for i in np.flatnonzero(mask.all(axis=(1, 2))):
        raise ValueError(f"{labels[i]}: no valid pixel; leave this epoch out")


def picked(each, epochs):
    """Return the values of some epochs of fields with a value for each, or None."""
    found = {}
    for name, values in each.items():
        if isinstance(values, tuple):
            found[name] = tuple(values[i] for i in epochs)
        else:
            found[name] = None if values is None else values[epochs]
    return found


def flat_wcs(wcs, data, mask):
    """Return the `positions.flat_wcs` of images, of which the scale must hold."""
    flat, _ = positions.flat_wcs(wcs, mean_of(data, mask))
    if flat is None:
        raise ValueError(positions.too_wide(wcs))
    return flat


def mean_of(data, mask):
    """Return the mean of images, NaN where none has the pixel."""
    count = np.sum(~mask, axis=0)
    mean = np.full(count.shape, np.nan)
    total = np.sum(data, axis=0, where=~mask)
    return np.divide(total, count, out=mean, where=count > 0)


def as_stack(data, mask, unit):
    """Return data as float64 (epoch, y, x), the mask and the unit."""
    images = data if isinstance(data, list | tuple) else [data]
    if any(isinstance(image, NDData) for image in images):
        raise TypeError(
            "data are images with unit, mask and coordinates of their own; use "
            "EpochCube.from_ccddata or from_ndcube, which keep them"
        )
    unknown = f"unit {unit!r} is not one that astropy knows"
    with refusing(unknown, TypeError, ValueError):
        unit = u.Unit("" if unit is None else unit)
    if problem := headers.logarithm(unit):
        raise ValueError(f"data: {problem}")
    try:
        if images is data and data:
            masked = any(isinstance(image, np.ma.MaskedArray) for image in data)
            data = (np.ma if masked else np).stack(data)
        if isinstance(data, Masked | np.ma.MaskedArray):
            inner = np.broadcast_to(data.mask, data.shape)
            mask = inner if mask is None else inner | np.asarray(mask, dtype=bool)
            data = data.unmasked if isinstance(data, Masked) else data.data
        if isinstance(data, u.Quantity):
            unit = data.unit if unit == u.dimensionless_unscaled else unit
            data = data.to_value(unit)
        data = as_numbers(data)
    except (TypeError, ValueError, u.UnitsError) as error:
        raise TypeError(
            f"data must be images of real numbers in one unit: {error}"
        ) from None
    if data.ndim != 3 or 0 in data.shape:
        raise ValueError(f"data must have shape (n_epochs, ny, nx), got {data.shape}")
    return data, mask, unit


def as_numbers(data):
    """Return an array as float64."""
    data = np.asarray(data)
    if data.dtype.kind not in "fiub":
        raise TypeError(f"they are of type {data.dtype}")
    return data.astype(np.float64, copy=False)


def as_mask(data, mask):
    """Return the mask, with pixels that are not finite and zeros that pad images."""
    if mask is not None and np.shape(mask) != data.shape:
        raise ValueError(f"mask has shape {np.shape(mask)}, data has {data.shape}")
    mask = np.zeros(data.shape) if mask is None else mask
    given = np.asarray(mask).astype(bool)
    every, remarks = zip(*map(pixels.missing, data, given), strict=True)
    for remark in filter(None, dict.fromkeys(remarks)):
        warn(remark)
    return np.stack(every)


def as_shape(shape):
    """Return the shape (ny, nx) of an image as two integers."""
    with suppress(TypeError, ValueError):
        ny, nx = map(operator.index, shape)
        if min(ny, nx) > 0:
            return ny, nx
    raise ValueError(f"shape={shape} must be two positive integers (ny, nx)")


def as_beams(beams, n):
    """Return one beam per epoch, or None."""
    beams = beams if np.iterable(beams) or beams is None else [beams] * n
    return as_epoch_tuple(beams, n, "beams", as_beam)


def as_noise(noise, n, unit):
    """Return noise of shape (n,) in the unit of the data, or None."""
    if noise is None:
        return None
    wrong = f"noise must be a Quantity in {unit}, got {noise!r}"
    with refusing(wrong, TypeError, u.UnitConversionError, error=TypeError):
        noise = u.Quantity(noise).to(unit)
    if noise.shape not in ((), (n,)):
        raise ValueError(f"{n} epochs need {n} noises, got shape {noise.shape}")
    if not np.all(np.isfinite(noise) & (noise.value >= 0)):
        raise ValueError("noise must be finite and not negative")
    return noise if noise.shape else np.repeat(noise, n)


def as_epoch_tuple(values, n, name, convert):
    """Return one value per epoch as a tuple, None if there are none."""
    values = () if values is None else tuple(convert(v) for v in values)
    if len(values) not in (0, n):
        raise ValueError(f"{n} epochs need {n} {name}, got {len(values)}")
    return values or None


def epoch_index(epoch, n):
    """Return the index of one of n epochs, which may be counted from the last."""
    index = operator.index(epoch)
    if not -n <= index < n:
        raise IndexError(f"epoch {index} of a cube with {n} epochs")
    return index % n
