# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Conversion between cubes and the NDCube of ndcube."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.nddata import StdDevUncertainty
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.epochs.serialize import EXACT, without_dates
from astro_scc.images.fits import Plane
from astro_scc.images.headers import read_header
from astro_scc.images.series import ImageSeries
from astro_scc.images.validation import as_celestial, as_numbers, fits_wcs

if TYPE_CHECKING:
    from ndcube import NDCube

__doctest_requires__ = {("to_ndcube",): ["ndcube"]}

#: Name of the WCS axis that counts the epochs.
AXIS = "EPOCH"
#: Fields of each epoch that `to_ndcube` keeps.
EACH = ("labels", "beams", "epoch_meta")


def to_ndcube(cube: ImageSeries) -> NDCube:
    """
    Return a cube as NDCube of (epoch, latitude, longitude).

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    `ndcube.NDCube`
        The third axis of its WCS is the index of the epoch, and the dates are
        the extra coordinate ``time``.  The noise is its uncertainty; its meta
        has the labels, beams and facts of all epochs, in which `from_ndcube`
        finds those of an epoch by its index.

    Raises
    ------
    ImportError
        If ndcube is not installed.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_static
    >>> simulate_static(n_epochs=2, rng=1).cube.to_ndcube().shape
    (2, 128, 256)
    """
    try:
        import ndcube
    except ImportError:
        raise ImportError("to_ndcube needs ndcube; pip install ndcube") from None
    noise = cube.noise
    if noise is not None:
        every = np.broadcast_to(noise.value[:, None, None], cube.shape)
        noise = StdDevUncertainty(every, unit=cube.unit, copy=False)
    header = without_dates(cube.wcs.to_header(relax=EXACT))
    # The third axis is the index of the epoch, from 0.
    header.update({"WCSAXES": 3, "CTYPE3": AXIS, "CRPIX3": 1.0})
    made = ndcube.NDCube(
        cube.data.copy(),
        wcs=WCS(header),
        uncertainty=noise,
        unit=cube.unit,
        mask=cube.mask.copy(),
        meta={**cube.meta, **{name: getattr(cube, name) for name in EACH}},
    )
    made.extra_coords.add("time", (0,), cube.times)
    return made


def planes_of(ndcube, times=None, beams=None):
    """
    Return the epochs of an NDCube as `Plane`, and the meta that is common to them.

    It has two celestial axes, and one of the epochs if there are several; its WCS is a
    FITS WCS, possibly sliced or resampled.  Dates are needed unless ``times`` are
    given, equal beams of epochs that were averaged unless ``beams`` are.
    """
    try:
        wcs, size, kept = fits_wcs(ndcube.wcs)
        celestial = {wcs.wcs.lng, wcs.wcs.lat}
        others = [int(axis) for axis in np.flatnonzero(kept) if axis not in celestial]
        fits = wcs.has_celestial and kept[[*celestial]].all() and len(others) < 2
    except TypeError:
        fits = False
    if not fits:
        raise ValueError(
            "an NDCube must have two celestial axes, one of the epochs, and a FITS "
            "WCS; EpochCube.from_arrays takes what has none"
        )

    # Array axes are in the reverse order of WCS axes.
    axis = int(np.sum(kept[others[0] :])) - 1 if others else None

    def planes(values):
        values = np.broadcast_to(values, ndcube.data.shape)
        return values[None] if axis is None else np.moveaxis(values, axis, 0)

    data = planes(np.asarray(ndcube.data))
    mask = planes(False if ndcube.mask is None else ndcube.mask) | ~np.isfinite(data)
    given, errors = ndcube.uncertainty, [None] * len(data)
    if given is not None:
        errors = planes(np.asarray(given.array))
        errors = [type(given)(one, unit=given.unit, copy=False) for one in errors]
    averaged = bool(others and size[others[0]] != 1)
    meta = dict(ndcube.meta) if isinstance(ndcube.meta, Mapping) else {}
    dates = [None] * len(data)
    if times is None:
        dates = np.atleast_1d(_times_of(ndcube, meta, axis, averaged))
    if AXIS in wcs.wcs.ctype and set(EACH) <= meta.keys():
        first = round(1 - wcs.wcs.crpix[list(wcs.wcs.ctype).index(AXIS)])
        records = _kept_records(meta, first, len(data), averaged, beams)
        meta = {key: value for key, value in meta.items() if key not in EACH}
    else:
        records, meta = [read_header(meta)] * len(data), {}
    common = {"wcs": as_celestial(wcs), "shape": data.shape[1:]}
    common["unit"] = ndcube.unit or u.dimensionless_unscaled
    images = []
    for i, own in enumerate(records):
        pixels = {"data": as_numbers(data[i]), "mask": mask[i]}
        own = own | pixels | {"time": dates[i], "uncertainty": errors[i]}
        images.append(Plane(name=f"epoch {i} of the NDCube", **common, **own))
    meta["history"] = [*meta.get("history", ()), "from an NDCube"]
    return images, meta


def _kept_records(meta, first, n, averaged, beams):
    """Return what `to_ndcube` has kept of each of n epochs from the first one."""
    own = meta["beams"] or [None] * len(meta["labels"])
    if averaged:
        if beams is None and any(beam != own[0] for beam in own):
            raise ValueError(
                "epochs of the NDCube were averaged, of which the beams differ; call "
                "to_common_beam() before to_ndcube(), or give beams="
            )
        return [{"beam": own[0]}] * n
    fields = meta["labels"], own, meta["epoch_meta"]
    rows = zip(*(values[first : first + n] for values in fields), strict=True)
    return [dict(zip(("label", "beam", "facts"), row, strict=True)) for row in rows]


def _times_of(ndcube, meta, axis, averaged):
    """Return the coordinate of type Time, or else the date of a single epoch."""
    if axis is None:
        found = [v for v in ndcube.global_coords.values() if isinstance(v, Time)]
        found.append(read_header(meta)["time"])
        if found[0] is not None:
            return found[0]
    for coordinates in (ndcube.wcs, ndcube.extra_coords) if axis is not None else ():
        try:
            values = ndcube.axis_world_coords(axis, wcs=coordinates)
        except (AttributeError, TypeError, ValueError):
            continue
        for found in (v for v in values if isinstance(v, Time)):
            if averaged and coordinates is ndcube.extra_coords:
                raise ValueError(
                    "epochs of the NDCube were averaged, of which ndcube keeps the "
                    "first date only; give times="
                )
            return found
    raise ValueError("the NDCube has no coordinate of type Time; give times=")
