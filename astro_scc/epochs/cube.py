# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The images of one object at many dates, on one pixel grid."""

import operator
from dataclasses import dataclass, field, replace

import astropy.units as u
import numpy as np
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.epochs.beam import Beam
from astro_scc.epochs.offset_grid import OffsetGrid
from astro_scc.epochs.sources import EpochSources
from astro_scc.epochs.steps import EpochSteps
from astro_scc.epochs.validation import (
    as_beams,
    as_celestial,
    as_epoch_tuple,
    as_mask,
    as_noise,
    as_stack,
    as_times,
    date_labels,
)

__all__ = ["EpochCube"]


@dataclass(frozen=True, eq=False, repr=False)
class EpochCube(OffsetGrid, EpochSources, EpochSteps):
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
        True marks bad pixels.  Pixels that are not finite are added to it;
        the attribute is an array always.
    beams : beam or sequence of beams, length n_epochs, optional
        `~astro_scc.epochs.Beam`, or anything with the attributes ``major``,
        ``minor`` and ``pa`` (a ``radio_beam.Beam``).  One beam is every
        epoch's.
    noise : `~astropy.units.Quantity`, scalar or shape (n_epochs,), optional
        Root mean square of the noise of each epoch.
    labels : sequence of str, optional
        What an epoch is called in messages and tables, its file name where
        there is one, by default its date.
    epoch_wcs : sequence of `~astropy.wcs.WCS`, optional
        For each epoch the absolute celestial coordinates that its own
        header gives to the pixels of this grid.  Used by
        ``align("wcs")`` only.
    epoch_meta : sequence of dict, optional
        Facts of each epoch (object, frequency, telescope...).
    meta : dict, optional
        ``meta["history"]`` is a list with one line for every step taken.

    Raises
    ------
    ValueError
        If shapes or numbers of epochs disagree, a date is missing, an epoch
        has no valid pixel, or the WCS is not celestial.
    TypeError
        If an argument is of another kind than described.

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
    mask: np.ndarray | None = None
    beams: tuple[Beam, ...] | None = None
    noise: u.Quantity | None = None
    labels: tuple[str, ...] = ()
    epoch_wcs: tuple[WCS, ...] | None = None
    epoch_meta: tuple[dict, ...] = ()
    meta: dict = field(default_factory=dict)

    def __post_init__(self):
        data, mask, unit = as_stack(self.data, self.mask, self.unit)
        n = len(data)
        times = as_times(self.times, n)
        labels = as_epoch_tuple(self.labels, n, "labels", str) or date_labels(times)
        mask = as_mask(data, mask, labels)
        beams = as_beams(self.beams, n)
        noise = as_noise(self.noise, n, unit)
        epoch_wcs = as_epoch_tuple(self.epoch_wcs, n, "epoch_wcs", as_celestial)
        epoch_meta = as_epoch_tuple(self.epoch_meta, n, "epoch_meta", dict)
        epoch_meta = epoch_meta or tuple({} for _ in range(n))

        order = np.argsort((times - times[0]).jd, kind="stable")
        if np.any(np.diff(order) < 0):
            data, mask, times = data[order], mask[order], times[order]
            labels, epoch_meta, beams, epoch_wcs = (
                values and tuple(values[i] for i in order)
                for values in (labels, epoch_meta, beams, epoch_wcs)
            )
            noise = None if noise is None else noise[order]

        values = {
            "data": data,
            "times": times,
            "wcs": as_celestial(self.wcs),
            "unit": unit,
            "mask": mask,
            "beams": beams or None,
            "noise": noise,
            "labels": labels,
            "epoch_wcs": epoch_wcs or None,
            "epoch_meta": epoch_meta,
            "meta": dict(self.meta),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def write(self, path, *, overwrite=False):
        """
        Write everything to one FITS file, which `read` reads back.

        Parameters
        ----------
        path : str or path-like
        overwrite : bool
            Replace a file that exists.  A file is replaced only when the
            new one is complete.

        Raises
        ------
        OSError
            If the file exists and ``overwrite`` is False, or cannot be
            written.

        Examples
        --------
        >>> import astropy.units as u
        >>> import numpy as np
        >>> from astro_scc import EpochCube
        >>> cube = EpochCube.from_arrays(np.ones((1, 8, 8)), ["2000-01-01"],
        ...                              pixel_scale=0.1 * u.mas)
        >>> cube.write("cube.fits")
        >>> EpochCube.read("cube.fits").shape
        (1, 8, 8)
        """
        from astro_scc.epochs.files.serialize import write_cube

        write_cube(self, path, overwrite=overwrite)

    def __len__(self):
        return self.data.shape[0]

    def __iter__(self):
        return (self[i] for i in range(len(self)))

    def __getitem__(self, item):
        if isinstance(item, tuple):
            raise TypeError("index epochs only, cube[i] or cube[i:j]; crop() cuts out")
        try:
            return self._image(operator.index(item))
        except TypeError:
            pass
        keep = np.arange(len(self))[item]
        if keep.ndim != 1 or keep.size == 0:
            raise ValueError(f"the selection {item!r} holds none of {len(self)} epochs")
        return self._select(keep)

    def _image(self, index):
        from astropy.nddata import CCDData, StdDevUncertainty

        from astro_scc.epochs.files.headers import epoch_header

        if not -len(self) <= index < len(self):
            raise IndexError(f"epoch {index} of a cube with {len(self)} epochs")
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
            meta=epoch_header(
                time=self.times[index],
                label=self.labels[index],
                beam=self.beams and self.beams[index],
                noise=None if self.noise is None else self.noise[index],
                facts=self.epoch_meta[index],
            ),
        )

    def _select(self, keep):
        def pick(values):
            return values and tuple(values[i] for i in keep)

        return replace(
            self,
            data=self.data[keep],
            times=self.times[keep],
            mask=self.mask[keep],
            beams=pick(self.beams),
            noise=None if self.noise is None else self.noise[keep],
            labels=pick(self.labels),
            epoch_wcs=pick(self.epoch_wcs),
            epoch_meta=pick(self.epoch_meta),
        )

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
        meta = changes.pop("meta", self.meta)
        meta = {**meta, "history": [*meta.get("history", ()), line]}
        return replace(self, meta=meta, **changes)

    @property
    def shape(self):
        """Shape of the data, (n_epochs, ny, nx)."""
        return self.data.shape

    @property
    def years(self):
        """Dates as years since the first epoch, shape (n_epochs,)."""
        return (self.times - self.times[0]).to(u.yr)

    @property
    def epochs(self):
        """
        One row an epoch, `~astropy.table.QTable`.

        Columns ``epoch``, ``label``, ``date``, where the cube has beams
        ``major``, ``minor``, ``pa``, then ``noise`` (given or measured),
        ``object`` and ``frequency`` (NaN where unknown).
        """
        from astro_scc.epochs.description import epoch_table

        return epoch_table(self)

    def noise_rms(self):
        """
        Noise of each epoch: what was given, or else measured.

        See `~astro_scc.epochs.measure_noise`.

        Returns
        -------
        `~astropy.units.Quantity`, shape (n_epochs,)
        """
        from astro_scc.epochs.statistics import measure_noise

        if self.noise is not None:
            return self.noise
        pairs = zip(self.data, self.mask, strict=True)
        return u.Quantity([measure_noise(d, mask=m) for d, m in pairs], self.unit)

    def mean_image(self):
        """
        Mean of the epochs, each pixel over those that have it.

        Returns
        -------
        `~astropy.nddata.CCDData`
            Masked and NaN where no epoch has the pixel.
        """
        from astropy.nddata import CCDData

        count = np.sum(~self.mask, axis=0)
        total = np.sum(self.data, axis=0, where=~self.mask)
        mean = np.full(total.shape, np.nan)
        np.divide(total, count, out=mean, where=count > 0)
        return CCDData(
            mean,
            unit=self.unit,
            mask=count == 0,
            wcs=self.wcs.deepcopy(),
            meta={"n_epochs": len(self)},
        )

    def __repr__(self):
        from astro_scc.epochs.description import describe

        return f"<EpochCube {describe(self)}>"

    def _repr_html_(self):
        from html import escape

        return f"<p>{escape(repr(self)[1:-1])}</p>" + self.epochs._repr_html_()
