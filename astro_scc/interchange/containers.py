# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Conversion between cubes and the containers of xarray and ndcube."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.nddata import StdDevUncertainty
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.epochs import Beam, EpochCube
from astro_scc.epochs.beam import beam_columns
from astro_scc.epochs.fits import Plane
from astro_scc.epochs.grid import moved_wcs
from astro_scc.epochs.headers import read_header
from astro_scc.epochs.positions import axis_words, offset_wcs
from astro_scc.epochs.reading import read_images
from astro_scc.epochs.serialize import (
    EXACT,
    pack_facts,
    unpack_facts,
    without_dates,
)
from astro_scc.epochs.validation import as_celestial, fits_wcs
from astro_scc.interchange.files import optional

if TYPE_CHECKING:
    from ndcube import NDCube, NDCubeSequence
    from xarray import DataArray, Dataset

__doctest_requires__ = {
    ("from_ndcube", "to_ndcube"): ["ndcube"],
    ("from_xarray", "to_xarray"): ["xarray"],
}

#: Names of the beams' axes and angles.
BEAM = "beam_major", "beam_minor", "beam_pa"
#: Name of the images.
NAME = "brightness"
IMAGES = "time", "y", "x"
#: Attributes that mark a Dataset of `to_xarray`.
OWN = {"wcs", "meta"}
#: Names of axes to the east, and of axes to the north.
EAST = ("x", "east", "ra", "right_ascension", "lon", "longitude", "hpln")
NORTH = ("y", "north", "dec", "declination", "lat", "latitude", "hplt")
#: Name of the WCS axis that counts the epochs.
AXIS = "EPOCH"
#: Fields of each epoch that `to_ndcube` keeps.
EACH = ("labels", "beams", "epoch_meta")


def to_xarray(cube: EpochCube) -> Dataset:
    """
    Return a cube as `xarray.Dataset`.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    `xarray.Dataset`
        ``brightness`` and ``mask`` over (time, y, x), and if the cube has
        them ``noise``, ``beam_major``, ``beam_minor`` and ``beam_pa`` over
        time, each with ``units``.  Coordinates are ``time`` (UTC),
        ``label``, the pixels ``x`` and ``y`` and the offsets ``east`` and
        ``north`` in mas (``lon_offset`` and ``lat_offset`` in frames without
        right ascension).  Attributes are text, as netCDF requires.

    Raises
    ------
    ImportError
        If xarray is not installed.

    Examples
    --------
    >>> from astro_scc.interchange import to_xarray
    >>> from astro_scc.simulation import simulate_static
    >>> dataset = to_xarray(simulate_static(n_epochs=2, rng=1).cube)
    >>> list(dataset.data_vars)
    ['brightness', 'mask', 'noise', 'beam_major', 'beam_minor', 'beam_pa']
    """
    xarray = optional("xarray", "to_xarray", "xarray")
    _, ny, nx = cube.shape
    unit = {"units": cube.unit.to_string()}
    variables = {
        NAME: (IMAGES, cube.data.copy(), unit),
        "mask": (IMAGES, cube.mask.copy(), {"long_name": "bad pixels"}),
    }
    if cube.noise is not None:
        variables["noise"] = "time", cube.noise.value, unit
    for name, column in beam_columns(cube).items():
        units = {"units": str(column.unit)}
        variables[f"beam_{name}"] = "time", column.value, units
    east, north = (offset.to_value(u.mas) for offset in cube.offsets())
    axes = ("y", "x"), ("y", "x")
    matrix = np.abs(cube.pixel_matrix.value)
    if matrix[~np.eye(2, dtype=bool)].max() <= 1e-9 * matrix.max():
        axes, east, north = ("x", "y"), east[0], north[:, 0]
    is_east = axis_words(cube)[0] == "east"
    names = ("east", "north") if is_east else ("lon_offset", "lat_offset")
    coordinates = {
        "time": cube.times.utc.to_value("datetime64").astype("datetime64[ns]"),
        "label": ("time", list(cube.labels)),
        "y": np.arange(ny),
        "x": np.arange(nx),
        names[0]: (axes[0], east, {"units": "mas"}),
        names[1]: (axes[1], north, {"units": "mas"}),
        "facts": ("time", [pack_facts(facts) for facts in cube.epoch_meta]),
    }
    if cube.epoch_wcs:
        coordinates["own_wcs"] = "time", [pack_facts(w) for w in cube.epoch_wcs]
    attributes = {
        "title": str(cube.meta.get("object", "")),
        "time_scale": cube.times.scale,
        "time_format": cube.times.format,
        "wcs": pack_facts(cube.wcs),
        "meta": pack_facts(cube.meta),
    }
    return xarray.Dataset(variables, coordinates, attributes)


def from_xarray(
    source: Dataset | DataArray, *, times: Time | Sequence[Any] | None = None,
    pixel_scale: u.Quantity | None = None, unit: u.UnitBase | str | None = None,
    beams: Beam | Sequence[Beam] | None = None,
) -> EpochCube:  # fmt: skip
    """
    Return a cube from `to_xarray`, or from images with dates and offsets.

    Parameters
    ----------
    source : `xarray.Dataset` or `xarray.DataArray`
        A result of `to_xarray`, also after a selection of epochs or of a
        window of pixels; or an array of three axes, one of the dates, the
        others named ``x`` and ``y``, ``east`` and ``north``, ``ra`` and
        ``dec`` or ``lon`` and ``lat``.  A Dataset must have exactly one such
        array.
    times : `~astropy.time.Time` or sequence, optional
        By default the coordinate of type ``datetime64``, taken as UTC.
    pixel_scale : `~astropy.units.Quantity`, optional
        By default from the coordinates, which must be evenly spaced, with an
        angle as the attribute ``units``.
    unit : `~astropy.units.Unit`, optional
        By default the attribute ``units``.
    beams : beam or sequence of beams, optional

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        The origin is where the coordinates are 0, if that is in the image,
        otherwise the centre of the image.

    Raises
    ------
    ValueError
        If axes, dates or the size of the pixels cannot be found, or the
        coordinates are uneven.
    TypeError
        If ``source`` is not a Dataset or a DataArray.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> import xarray
    >>> from astro_scc.interchange import from_xarray
    >>> array = xarray.DataArray(np.ones((2, 20, 30)), dims=("time", "y", "x"))
    >>> from_xarray(array, times=["2000-01-01", "2001-01-01"], pixel_scale=25 * u.mas)
    <EpochCube 2 epochs 2000-01-01 to 2001-01-01, 30 x 20 pixels of 25 mas>
    """
    if not hasattr(source, "dims") or not hasattr(source, "coords"):
        raise TypeError(
            f"from_xarray takes a Dataset or a DataArray, got {type(source).__name__}"
        )
    if NAME in getattr(source, "data_vars", ()) and source.attrs.keys() >= OWN:
        if any(value is not None for value in (times, pixel_scale, unit, beams)):
            raise ValueError("what to_xarray made has its dates, pixels, unit, beams")
        return _cube_of(source)
    arrays = source.data_vars.values() if hasattr(source, "data_vars") else [source]
    arrays = [array for array in arrays if array.ndim == 3]
    if len(arrays) != 1:
        raise ValueError(
            f"one array of three axes is needed, there are {len(arrays)}; select it "
            "by its name"
        )
    date, north, east = _axes(arrays[0])
    array = arrays[0].transpose(date, north, east)
    times = _dates_along(array, date) if times is None else times
    unit = _unit_of(array) if unit is None else unit
    (dx, x0), (dy, y0) = (_steps(array, axis, pixel_scale) for axis in (east, north))
    if not np.isclose(abs(dx), abs(dy), rtol=1e-6):
        raise ValueError(
            f"pixels are {abs(dx):.6g} by {abs(dy):.6g} mas; resample the images to "
            "square ones"
        )
    wcs = offset_wcs(abs(dx) * u.mas, (x0, y0))
    # Coordinates without a direction run as on the sky, with east to the left.
    wcs.wcs.cdelt = dx / 3.6e6, dy / 3.6e6
    wcs.wcs.set()
    return EpochCube(
        data=np.asarray(array.values, dtype=float),
        times=times,
        wcs=wcs,
        unit=unit,
        beams=beams,
        meta={"history": [f"{array.sizes[date]} epochs from xarray"]},
    )


def _cube_of(source):
    """Return the cube in a Dataset of `to_xarray`."""
    shift = []
    for axis in ("x", "y"):
        pixels = np.asarray(source[axis].values)
        if np.any(np.diff(pixels) != 1):
            raise ValueError(
                f"pixels {axis} of the Dataset are not one after the other; select "
                "windows, and resample the cube with reproject_to()"
            )
        shift.append(-int(pixels[0]))

    def grid(packed):
        return moved_wcs(unpack_facts(packed), shift)

    attributes = source.attrs
    times = getattr(_dates_along(source, "time"), attributes["time_scale"])
    times.format = attributes["time_format"]
    columns = [source[k].values * _unit_of(source[k]) for k in BEAM if k in source]
    unit = _unit_of(source[NAME])
    own = source["own_wcs"].values if "own_wcs" in source.coords else ()
    data, mask = (source[k].transpose(*IMAGES).values for k in (NAME, "mask"))
    return EpochCube(
        data=np.array(data, dtype=float),
        times=times,
        wcs=grid(attributes["wcs"]),
        unit=unit,
        mask=np.array(mask, dtype=bool),
        beams=[Beam(*row) for row in zip(*columns, strict=True)] or None,
        noise=source["noise"].values * unit if "noise" in source else None,
        labels=[str(label) for label in source["label"].values],
        epoch_wcs=[grid(packed) for packed in own] or None,
        epoch_meta=[unpack_facts(facts) for facts in source["facts"].values],
        meta=unpack_facts(attributes["meta"]),
    )


def _unit_of(array):
    return u.Unit(array.attrs.get("units", ""))


def _axes(array):
    """Return the names of the axes of date, north and east."""
    found = []
    for names, what in ((NORTH, "y"), (EAST, "x")):
        axes = [axis for axis in array.dims if str(axis).lower() in names]
        if len(axes) != 1:
            raise ValueError(
                f"no axis of {', '.join(map(str, array.dims))} is named {what}; "
                f"rename() the axes to time, y, x"
            )
        found += axes
    return ({*array.dims} - {*found}).pop(), *found


def _dates_along(array, axis):
    values = array[axis].values if axis in array.coords else np.empty(0)
    if not np.issubdtype(values.dtype, np.datetime64):
        raise ValueError(f"axis {axis} has no dates of type datetime64; give times=")
    return Time(values, scale="utc", format="datetime64")


def _steps(array, axis, pixel_scale):
    """Return the step of the pixels of an axis in mas, and the pixel at the origin."""
    n = array.sizes[axis]
    origin = (n - 1) / 2
    if pixel_scale is not None:
        sign = -1 if str(axis).lower() in EAST else 1
        return sign * u.Quantity(pixel_scale).to_value(u.mas), origin
    try:
        coordinate = array.coords[axis]
        angle = u.Unit(coordinate.attrs["units"]).to(u.mas)
    except (KeyError, ValueError, TypeError):
        raise ValueError(
            f"axis {axis} has no coordinate with an angle as its attribute units; "
            "give pixel_scale="
        ) from None
    values = np.asarray(coordinate.values, dtype=float) * angle
    steps = np.diff(values)
    step = float(steps.mean()) if n > 1 else 0.0
    if n < 2 or np.any(np.abs(steps - step) > 1e-3 * abs(step)):
        raise ValueError(f"coordinate {axis} is uneven; resample the images")
    zero = -values[0] / step
    return step, float(zero) if -0.5 <= zero <= n - 0.5 else origin


def to_ndcube(cube: EpochCube) -> NDCube:
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
    >>> from astro_scc.interchange import to_ndcube
    >>> from astro_scc.simulation import simulate_static
    >>> to_ndcube(simulate_static(n_epochs=2, rng=1).cube).shape
    (2, 128, 256)
    """
    ndcube = optional("ndcube", "to_ndcube", "ndcube")
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


def from_ndcube(
    ndcube: NDCube | NDCubeSequence, *, times: Time | Sequence[Any] | None = None,
    beams: Beam | Sequence[Beam] | None = None,
) -> EpochCube:  # fmt: skip
    """
    Return a cube from an NDCube of epochs, which may be sliced or rebinned.

    Parameters
    ----------
    ndcube : `ndcube.NDCube` or `ndcube.NDCubeSequence`
        It has two celestial axes, and one of the epochs if there are several;
        each item of a sequence is an epoch.  Its WCS is a FITS WCS, possibly
        sliced or resampled.
    times : `~astropy.time.Time` or sequence, optional
        By default the coordinate of type Time, or the date in the meta.
    beams : beam or sequence of beams, optional
        By default the beams that `to_ndcube` has kept, or ``BMAJ``, ``BMIN``
        and ``BPA`` in the meta, as in a FITS header.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        The uncertainty becomes the noise.

    Raises
    ------
    ValueError
        If axes or dates cannot be found, or epochs with different dates or
        beams were averaged.

    Examples
    --------
    >>> from astro_scc.interchange import from_ndcube, to_ndcube
    >>> from astro_scc.simulation import simulate_static
    >>> made = to_ndcube(simulate_static(n_epochs=3, rng=1).cube)
    >>> from_ndcube(made[1:, 20:100].rebin((1, 2, 2)))
    <EpochCube 2 epochs 2000-01-31 to 2000-03-01, 128 x 40 pixels of 0.2 mas, ...>
    """
    if isinstance(ndcube.data, list | tuple):
        return EpochCube.from_ccddata(ndcube.data, times=times, beams=beams)
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
    if times is None:
        times = _times_of(ndcube, meta, axis, averaged)
    if AXIS in wcs.wcs.ctype and set(EACH) <= meta.keys():
        first = round(1 - wcs.wcs.crpix[list(wcs.wcs.ctype).index(AXIS)])
        records = _kept_records(meta, first, len(data), averaged, beams)
        meta = {key: value for key, value in meta.items() if key not in EACH}
    else:
        records, meta = [vars(read_header(meta))] * len(data), {}
    common = {"wcs": as_celestial(wcs), "shape": data.shape[1:]}
    common["unit"] = ndcube.unit or u.dimensionless_unscaled
    images = []
    for i, own in enumerate(records):
        pixels = {"data": data[i], "mask": mask[i], "uncertainty": errors[i]}
        images.append(Plane(name=f"epoch {i} of the NDCube", **pixels, **common, **own))
    meta["history"] = [*meta.get("history", ()), "from an NDCube"]
    fields = read_images(images, times, beams, "offset", check=False)
    return EpochCube(**fields | {"epoch_wcs": None, "meta": meta})


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
        found.append(read_header(meta).time)
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
