# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Forms of a cube: one FITS file, an image per epoch, an NDCube; files of results."""

from __future__ import annotations

import re
import warnings
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
from astropy.wcs import WCS, WCSHDO_P17, WCSHDO_all

from astro_scc.exceptions import naming_all
from astro_scc.images.fits import CUBE_CREATOR, open_fits
from astro_scc.images.headers import without
from astro_scc.images.series import ImageSeries, epoch_header
from astro_scc.writing import replace_when_complete

if TYPE_CHECKING:
    from ndcube import NDCube

__doctest_requires__ = {("to_ndcube",): ["ndcube"]}

#: Headers of a WCS with all digits of its numbers.
EXACT = WCSHDO_all | WCSHDO_P17
#: Pattern of the dates that wcslib adds to the header of a WCS.
DATES = "DATE|MJD|TIMESYS"
#: Layout of the files.
LAYOUT = 3
OTHER_VERSION = "read it with the version that wrote it"
#: Images, and arrays of more elements, are extensions, other arrays are in the text.
SHORT = 100

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
    The extension ``DATA`` has the images with the celestial WCS, ``MASK`` the bad
    pixels; ``META`` holds all that is not an image as YAML, in which astropy's objects
    keep their types.  Values that YAML cannot hold become text.  `write_epochs` writes
    images with dates and beams for other programs.

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
    images = {name: cube.wcs.to_header(relax=True) for name in ("data", "mask")}
    images["data"]["BUNIT"] = _fits_unit(cube.unit)
    write_object(cube, path, creator=CUBE_CREATOR, overwrite=overwrite, images=images)


def _fits_unit(unit):
    """Return a unit as programs that read FITS expect it."""
    if unit == u.Jy / u.beam:
        return "JY/BEAM"
    try:
        return unit.to_string("fits")
    except ValueError:
        # The standard does not have DN, which solar images are in.
        return unit.to_string()


def write_object(value, path, *, creator, overwrite=False, images=None):
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
        pixels = np.ascontiguousarray(array)
        # Of other types, FITS images hold the bytes.
        if pixels.dtype.str[1:] not in ("u1", "i2", "i4", "i8", "f4", "f8"):
            pixels = pixels.view(np.uint8)
        hdus.append(fits.ImageHDU(pixels, (images or {}).get(name), name=name))
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
    with (
        open(path, "rb") as file,
        naming_all(f"{path}: cannot be read as {creator}", OSError),
        # astropy only warns of a wrong checksum.
        warnings.catch_warnings(action="error"),
        open_fits(file, memmap=True, checksum=not lazy) as hdus,
    ):
        if hdus[0].header.get("CREATOR") != creator:
            raise ValueError("it was not written as one")
        if (layout := hdus[0].header["SCCVERS"]) != LAYOUT:
            raise ValueError(f"it is of layout {layout}; {OTHER_VERSION}")
        text = hdus["META"].data.tobytes().decode()
        return _Loader(text, hdus, lazy).get_single_data()


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
            made = WCS(without(fits.Header.fromstring(packed["header"]), DATES))
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
            kind = None
            if module.startswith(PACKAGE):
                with suppress(ImportError):
                    kind = getattr(import_module(module), name, None)
            names = {f.name for f in fields(kind)} if is_dataclass(kind) else None
            if names != packed.keys():
                raise ValueError(
                    f"its {name} is of another version of astro_scc; {OTHER_VERSION}"
                )
            # Checks and conversions were made when it was first made.
            made = object.__new__(kind)
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
    days = enumerate(cube.times.strftime("%Y-%m-%d"))
    paths = [directory / f"{prefix}_{i:0{digits}d}_{day}.fits" for i, day in days]
    existing = [path for path in paths if path.exists()]
    if existing and not overwrite:
        raise OSError(f"{existing[0]}: exists; choose another folder, or overwrite")
    directory.mkdir(parents=True, exist_ok=True)
    # The dates of wcslib would be those of the first epoch.
    shared = without(cube.wcs.to_header(), DATES)
    shared["BUNIT"] = _fits_unit(cube.unit)
    for line in cube.meta.get("history", ()):
        shared.add_history(str(line).encode("ascii", "replace").decode())
    for i, path in enumerate(paths):
        image = np.where(cube.mask[i], np.nan, cube.data[i]).astype(np.float32)
        header = fits.Header([*epoch_header(cube, i).cards, *shared.cards])
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
    header = without(cube.wcs.to_header(relax=EXACT), DATES)
    # The third axis is the index of the epoch, from 0.
    header.update({"WCSAXES": 3, "CTYPE3": AXIS, "CRPIX3": 1.0})
    meta = {**cube.meta, **{name: getattr(cube, name) for name in KEPT}}
    fields = {"unit": cube.unit, "mask": cube.mask.copy(), "uncertainty": noise}
    made = ndcube.NDCube(cube.data.copy(), wcs=WCS(header), meta=meta, **fields)
    made.extra_coords.add("time", (0,), cube.times)
    return made
