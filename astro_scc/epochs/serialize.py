# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Forms of a cube: one FITS file, an image per epoch, an NDCube; files of results."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.io.misc import yaml
from astropy.nddata import StdDevUncertainty
from astropy.table import Table
from astropy.time import Time
from astropy.wcs import WCS, WCSHDO_P17, WCSHDO_all

from astro_scc.images import headers
from astro_scc.images.beam import beam_columns
from astro_scc.images.fits import CUBE_CREATOR, Plane, open_fits
from astro_scc.images.headers import BEAM, epoch_header, first_line
from astro_scc.images.series import ImageSeries, as_numbers
from astro_scc.writing import replace_when_complete

if TYPE_CHECKING:
    from ndcube import NDCube

__doctest_requires__ = {("to_ndcube",): ["ndcube"]}

#: Headers of a WCS with all digits of its numbers.
EXACT = WCSHDO_all | WCSHDO_P17
#: Layout of the files.
LAYOUT = 3
#: Images, and arrays of more elements, are extensions, other arrays are in the text.
SHORT = 100
#: Types of arrays that FITS images hold as they are; of others they hold the bytes.
FITS_TYPES = "u1", "i2", "i4", "i8", "f4", "f8"
#: Key of the name of its class in a packed object.
CLASS = "!class"
#: Start of the modules whose dataclasses may be written and read.
PACKAGE = "astro_scc."
#: Name of the axis of an NDCube that counts the epochs.
AXIS = "EPOCH"
#: Fields of each epoch that `to_ndcube` keeps.
KEPT = ("labels", "beams", "epoch_meta")


def write_cube(cube: ImageSeries, path: Path | str, *, overwrite: bool = False) -> None:
    """
    Write the whole cube to one FITS file, which `read` reads back.

    Parameters
    ----------
    cube : `EpochCube`
    path : str or path-like
    overwrite : bool
        Replace an existing file, once the new one is complete.

    Raises
    ------
    OSError
        If the file exists and ``overwrite`` is False, or it cannot be
        written.

    Notes
    -----
    The extension ``DATA`` has the images with the celestial WCS, ``MASK`` the
    bad pixels; ``EPOCHS`` has a row per epoch with the date (also as the two
    parts of the Julian date), beam and noise; ``META`` holds all that is not an
    image as YAML, in which astropy's objects keep their types.  Values that YAML
    cannot hold become text.

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
    table = Table({"DATE_OBS": [value[:23] for value in cube.times.isot]})
    table["JD1"], table["JD2"] = cube.times.jd1, cube.times.jd2
    for name, column in zip(BEAM, beam_columns(cube).values(), strict=False):
        table[name] = column
    if cube.noise is not None:
        table["NOISE"] = cube.noise.value
    images = {name: cube.wcs.to_header(relax=True) for name in ("data", "mask")}
    images["data"]["BUNIT"] = cube.unit.to_string()
    options = {"creator": CUBE_CREATOR, "overwrite": overwrite}
    write_object(cube, path, images=images, tables={"EPOCHS": table}, **options)


def without_dates(header):
    """Return a header without the dates that wcslib adds to the header of a WCS."""
    for keyword in [k for k in header if k.startswith(("DATE", "MJD", "TIMESYS"))]:
        header.remove(keyword)
    return header


def write_object(value, path, *, creator, overwrite=False, images=None, tables=None):
    """
    Write a dataclass, or a dictionary, and all that it holds to one FITS file.

    Parameters
    ----------
    value : object
        It may hold dataclasses of this package, WCS, arrays of numbers, what YAML
        can hold, and containers of these.  Other values become text.
    path : path
    creator : str
        What the file is, which `read_object` checks.
    overwrite : bool, optional
    images : dict of `~astropy.io.fits.Header`, optional
        Headers of the arrays in the attributes of these names.
    tables : dict of `~astropy.table.Table`, optional
        Tables for other readers, which `read_object` does not read.

    Raises
    ------
    ValueError
        If there is another dataclass in it.
    OSError
        If the file exists and ``overwrite`` is False, or cannot be written.

    Notes
    -----
    ``META`` holds YAML; long arrays follow, each in an extension with the name of
    its attribute, bit by bit.
    """
    arrays = []
    text = yaml.dump(_pack(value, "value", arrays, {}), sort_keys=False)
    primary = fits.PrimaryHDU()
    primary.header["CREATOR"] = creator
    primary.header["SCCVERS"] = LAYOUT, "version of this layout"
    hdus = [primary, fits.ImageHDU(np.frombuffer(text.encode(), np.uint8), name="META")]
    for name, array in arrays:
        own = np.ascontiguousarray(array)
        own = own if own.dtype.str[1:] in FITS_TYPES else own.view(np.uint8)
        hdus.append(fits.ImageHDU(own, (images or {}).get(name), name=name))
    for name, table in (tables or {}).items():
        hdus.append(fits.BinTableHDU(table, name=name))
    with replace_when_complete(path, overwrite=overwrite) as part:
        fits.HDUList(hdus).writeto(part, checksum=True)


def read_object(path, *, creator, lazy=False):
    """
    Read what `write_object` wrote.

    Parameters
    ----------
    path : path
    creator : str
    lazy : bool, optional
        Leave long arrays in the file until their elements are used, and do not
        verify its checksums.

    Returns
    -------
    object

    Raises
    ------
    OSError
        If the file cannot be read, is incomplete or something else, or was written
        by a version whose classes are others.
    """
    with open(path, "rb") as file:
        try:
            # astropy only warns of a wrong checksum.
            with (
                warnings.catch_warnings(action="error"),
                open_fits(file, memmap=True, checksum=not lazy) as hdus,
            ):
                if hdus[0].header.get("CREATOR") != creator:
                    raise ValueError("it was not written as one")
                if (layout := hdus[0].header["SCCVERS"]) == LAYOUT:
                    text = hdus["META"].data.tobytes().decode()
                    return _Loader(text, hdus, lazy).get_single_data()
        except _VersionError as error:
            raise OSError(f"{path}: {error}") from None
        except Exception as error:
            what = f"is no complete {creator} file: {first_line(error)}"
            raise OSError(f"{path}: {what}") from None
    raise OSError(f"{path}: of layout {layout}; read it with the version that wrote it")


class _VersionError(Exception):
    """The file is in order, but of another version."""


def _pack(value, name, arrays, memo, *, in_meta=False):
    """
    Return what YAML can hold; append long arrays with their names to ``arrays``.

    Other objects in the meta become text.
    """
    kind = type(value)
    if id(value) in memo:
        return memo[id(value)][0]

    def inner(item, name=name, in_meta=in_meta):
        return _pack(item, name, arrays, memo, in_meta=in_meta)

    if isinstance(value, dict):
        return {str(key): inner(item, str(key), True) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return (list if isinstance(value, list) else tuple)(map(inner, value))
    if is_dataclass(kind) and kind.__module__.startswith(PACKAGE):
        packed = {f.name: inner(getattr(value, f.name), f.name) for f in fields(value)}
        packed[CLASS] = f"{kind.__module__}.{kind.__name__}"
    elif isinstance(value, WCS):
        shape = list(value.array_shape) if value.array_shape else None
        header = value.to_header_string(relax=EXACT)
        packed = {CLASS: "WCS", "header": header, "shape": shape}
    elif kind is np.ndarray and value.size > (0 if value.ndim > 2 else SHORT):
        arrays.append((name, value))
        packed = {CLASS: "array", "hdu": len(arrays) + 1, "shape": list(value.shape)}
        packed["dtype"] = value.dtype.newbyteorder("=").str
    else:
        # astropy's YAML transposes arrays in Fortran's order.
        if kind is np.ndarray:
            value = np.array(value, order="C")
        plain = value.item() if isinstance(value, np.generic) else value
        try:
            yaml.dump(plain)
        except Exception:
            if in_meta:
                return str(value)
            what = f"an object {kind.__name__} cannot be written"
            raise ValueError(f"{name}: {what}") from None
        return plain
    # What is shared is written once; keeping the value keeps its id its own.
    memo[id(value)] = packed, value
    return packed


class _Loader(yaml.AstropyLoader):
    """Reader of YAML that restores what `_pack` has packed."""

    def __init__(self, text, hdus=None, lazy=False):
        super().__init__(text)
        self.hdus, self.lazy = hdus, lazy

    def make(self, node):
        """Return a dictionary, or what is packed in it."""
        packed = self.construct_mapping(node, deep=True)
        name = packed.pop(CLASS, None)
        if name == "WCS":
            made = WCS(without_dates(fits.Header.fromstring(packed["header"])))
            if packed["shape"]:
                made.array_shape = packed["shape"]
        elif name == "array":
            made = self.hdus[packed["hdu"]].data
            if made.dtype.str[1:] != packed["dtype"][1:]:
                made = made.view(packed["dtype"])
            made = made if self.lazy else made.astype(packed["dtype"])
            made = made.reshape(packed["shape"])
        elif name is not None:
            module, _, name = name.rpartition(".")
            own = None
            if module.startswith(PACKAGE):
                with suppress(ImportError):
                    own = getattr(import_module(module), name, None)
            if not is_dataclass(own) or {f.name for f in fields(own)} != packed.keys():
                raise _VersionError(
                    f"its {name} is of another version of astro_scc; read it with the "
                    "version that wrote it"
                )
            # Checks and conversions were made when it was first made.
            made = object.__new__(own)
            vars(made).update(packed)
        return packed if name is None else made


_Loader.add_constructor("tag:yaml.org,2002:map", _Loader.make)


def write_epochs(
    cube: ImageSeries, directory: Path | str, *, prefix: str | None = None,
    overwrite: bool = False,
) -> list[Path]:  # fmt: skip
    """
    Write a cube as one FITS image per epoch, for any program that reads FITS.

    Parameters
    ----------
    cube : `EpochCube`
    directory : path
        Created if necessary.
    prefix : str, optional
        Start of the files' names, by default the object's name; the number
        of the epoch and its date follow.
    overwrite : bool, optional
        Replace existing files.

    Returns
    -------
    list of `~pathlib.Path`

    Raises
    ------
    OSError
        If a file exists and ``overwrite`` is False, or cannot be written.

    Notes
    -----
    Masked pixels become NaN, and values are stored as 32-bit floats.  A file
    has its name only once it is complete.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from astro_scc.epochs import write_epochs
    >>> from astro_scc.simulation import simulate_static
    >>> jet = simulate_static(n_epochs=2, rng=1)
    >>> with TemporaryDirectory() as folder:
    ...     [path.name for path in write_epochs(jet.cube, folder)]
    ['static_00_2000-01-01.fits', 'static_01_2000-01-31.fits']
    """
    directory = Path(directory)
    if prefix is None:
        facts = cube.epoch_meta[0]
        prefix = str(facts.get("object") or cube.meta.get("object") or "epoch")
    prefix = re.sub(r"[^\w+.-]+", "_", prefix.strip()).strip("_") or "epoch"
    digits = max(2, len(str(len(cube) - 1)))
    paths = [
        directory / f"{prefix}_{i:0{digits}d}_{day}.fits"
        for i, day in enumerate(cube.times.strftime("%Y-%m-%d"))
    ]
    existing = [path for path in paths if path.exists()]
    if existing and not overwrite:
        raise OSError(f"{existing[0]}: exists; choose another folder, or overwrite")
    directory.mkdir(parents=True, exist_ok=True)
    # The dates of wcslib would be those of the first epoch.
    own = without_dates(cube.wcs.to_header())
    if cube.unit == u.Jy / u.beam:
        own["BUNIT"] = "JY/BEAM"
    elif cube.unit != u.dimensionless_unscaled:
        try:
            own["BUNIT"] = cube.unit.to_string("fits")
        except ValueError:
            # The standard does not have DN, which solar images are in.
            own["BUNIT"] = cube.unit.to_string()
    for line in cube.meta.get("history", ()):
        own.add_history(str(line).encode("ascii", "replace").decode())
    for i, path in enumerate(paths):
        image = np.where(cube.mask[i], np.nan, cube.data[i]).astype(np.float32)
        header = fits.Header([*epoch_header(cube, i).cards, *own.cards])
        with replace_when_complete(path, overwrite=True) as part:
            # The header is in order, and verifying it takes a third of the time.
            fits.PrimaryHDU(image, header).writeto(part, output_verify="ignore")
    return paths


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
    meta = {**cube.meta, **{name: getattr(cube, name) for name in KEPT}}
    fields = {"unit": cube.unit, "mask": cube.mask.copy(), "uncertainty": noise}
    made = ndcube.NDCube(cube.data.copy(), wcs=WCS(header), meta=meta, **fields)
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
        wcs, size, kept = headers.fits_wcs(ndcube.wcs)
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
    if AXIS in wcs.wcs.ctype and set(KEPT) <= meta.keys():
        first = round(1 - wcs.wcs.crpix[list(wcs.wcs.ctype).index(AXIS)])
        records = _kept_records(meta, first, len(data), averaged, beams)
        meta = {key: value for key, value in meta.items() if key not in KEPT}
    else:
        records, meta = [headers.read_header(meta)] * len(data), {}
    common = {"wcs": headers.as_celestial(wcs), "shape": data.shape[1:]}
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
        found.append(headers.read_header(meta)["time"])
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
