# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""An `EpochCube` as one FITS file."""

import warnings
from types import SimpleNamespace

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.epochs.beam import Beam
from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.cutout import box, crop_line
from astro_scc.epochs.files.fits import CUBE_CREATOR, open_fits
from astro_scc.epochs.grid import cut_wcs
from astro_scc.partial import replace_when_complete

__all__ = [
    "is_cube_file",
    "pack_facts",
    "pack_wcs",
    "read_cube",
    "unpack_facts",
    "unpack_wcs",
    "write_cube",
]

VERSION = 1
NUMBERS = ("crval", "crpix", "cdelt", "pc")


def write_cube(cube, path, *, overwrite=False):
    """
    Write a cube; see `EpochCube.write`.

    Notes
    -----
    The images are the extension ``DATA`` with the celestial WCS, bad pixels
    ``MASK``; ``EPOCHS`` has a row an epoch with the date (also as the two
    parts of the Julian date), beam (degrees) and noise; ``META`` holds the
    rest as YAML in which astropy's objects keep their types.  What YAML
    cannot hold becomes text.
    """
    from astropy.table import Table

    table = Table()
    table["DATE_OBS"] = [value[:23] for value in cube.times.isot]
    table["JD1"] = cube.times.jd1
    table["JD2"] = cube.times.jd2
    if cube.beams is not None:
        table["BMAJ"] = [beam.major.to_value(u.mas) for beam in cube.beams] * u.mas
        table["BMIN"] = [beam.minor.to_value(u.mas) for beam in cube.beams] * u.mas
        table["BPA"] = [beam.pa.to_value(u.deg) for beam in cube.beams] * u.deg
    if cube.noise is not None:
        table["NOISE"] = cube.noise.value
    rest = {
        "unit": cube.unit.to_string(),
        "time_scale": cube.times.scale,
        "time_format": cube.times.format,
        "labels": list(cube.labels),
        "wcs": pack_wcs(cube.wcs),
        "epoch_wcs": cube.epoch_wcs and [pack_wcs(w) for w in cube.epoch_wcs],
        "epoch_meta": [_plain(facts) for facts in cube.epoch_meta],
        "meta": _plain(cube.meta),
    }
    header = cube.wcs.to_header(relax=True)
    header["BUNIT"] = rest["unit"]
    primary = fits.PrimaryHDU()
    primary.header["CREATOR"] = CUBE_CREATOR
    primary.header["SCCVERS"] = VERSION, "version of this layout"
    text = np.frombuffer(_dump(rest).encode("ascii"), dtype=np.uint8)
    hdus = fits.HDUList(
        [
            primary,
            fits.ImageHDU(cube.data, header, name="DATA"),
            fits.ImageHDU(cube.mask.astype(np.uint8), cube.wcs.to_header(), "MASK"),
            fits.BinTableHDU(table, name="EPOCHS"),
            fits.ImageHDU(text, name="META"),
        ]
    )
    with replace_when_complete(path, overwrite=overwrite) as part:
        hdus.writeto(part)


def is_cube_file(path):
    """
    Whether `write_cube` wrote a file.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    bool
        False for what is no FITS file at all.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with open(path, "rb") as file, open_fits(file) as hdus:
                return hdus[0].header.get("CREATOR") == CUBE_CREATOR
        except Exception:
            # What is wrong with it, reading it as an image will say.
            return False


def read_cube(path, *, region=None, pad=0):
    """
    Read a file of `write_cube`.

    Parameters
    ----------
    path : str or path-like
    region, pad : optional
        Of which the bounding box is read only, see `~astro_scc.epochs.crop`.

    Returns
    -------
    `EpochCube`

    Raises
    ------
    OSError
        If the file is damaged or of a later version.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with open(path, "rb") as file, open_fits(file) as hdus:
                version = hdus[0].header["SCCVERS"]
                if version == VERSION:
                    return _unpack(hdus, region, pad)
        except _RegionError as error:
            raise error.__cause__ from None
        except Exception as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise OSError(f"{path}: is a damaged EpochCube file: {reason}") from None
    raise OSError(f"{path}: of layout {version}, read it with a newer astro_scc")


class _RegionError(Exception):
    """The file is sound, the region is not."""


def _unpack(hdus, region, pad):
    from astropy.io.misc import yaml

    rest = yaml.load(hdus["META"].data.tobytes().decode("ascii"))
    table = hdus["EPOCHS"].data
    names = {name.upper() for name in table.names}
    times = Time(
        table["JD1"].astype(float),
        table["JD2"].astype(float),
        format="jd",
        scale=rest["time_scale"],
    )
    times.format = rest["time_format"]
    unit = u.Unit(rest["unit"])
    beams = None
    if "BMAJ" in names:
        rows = zip(table["BMAJ"], table["BMIN"], table["BPA"], strict=True)
        beams = [Beam(a * u.mas, b * u.mas, p * u.deg) for a, b, p in rows]
    wcs = unpack_wcs(rest["wcs"])
    epoch_wcs = rest["epoch_wcs"] and [unpack_wcs(w) for w in rest["epoch_wcs"]]
    meta, window = rest["meta"], (slice(None), slice(None))
    if region is not None:
        shape = hdus["DATA"].shape
        try:
            window = box(SimpleNamespace(shape=shape, wcs=wcs), region, pad)
        except Exception as error:
            raise _RegionError from error
        wcs = cut_wcs(wcs, window, shape[1:])
        epoch_wcs = epoch_wcs and [cut_wcs(w, window, shape[1:]) for w in epoch_wcs]
        meta = {**meta, "history": [*meta.get("history", ()), crop_line(window)]}
    return EpochCube(
        data=hdus["DATA"].data[:, *window].astype(np.float64),
        times=times,
        wcs=wcs,
        unit=unit,
        mask=hdus["MASK"].data[:, *window].astype(bool),
        beams=beams,
        noise=table["NOISE"].astype(float) * unit if "NOISE" in names else None,
        labels=rest["labels"],
        epoch_wcs=epoch_wcs,
        epoch_meta=rest["epoch_meta"],
        meta=meta,
    )


def pack_wcs(wcs):
    """Header text, and the numbers that a header would round to 12 digits."""
    scaled = wcs.deepcopy()
    matrix = scaled.pixel_scale_matrix
    if scaled.wcs.has_cd():
        numbers = {"cdelt": [1.0, 1.0], "pc": matrix.tolist()}
    else:
        numbers = {
            "cdelt": scaled.wcs.get_cdelt().tolist(),
            "pc": scaled.wcs.get_pc().tolist(),
        }
    numbers["crval"] = scaled.wcs.crval.tolist()
    numbers["crpix"] = scaled.wcs.crpix.tolist()
    return {
        "header": scaled.to_header_string(relax=True),
        "shape": list(wcs.array_shape) if wcs.array_shape else None,
        **numbers,
    }


def unpack_wcs(packed):
    """The WCS that `pack_wcs` packed, to the last digit."""
    header = fits.Header.fromstring(packed["header"])
    for keyword in ("DATE-OBS", "MJD-OBS", "DATEREF", "MJDREF"):
        header.remove(keyword, ignore_missing=True)
    wcs = WCS(header)
    for name in NUMBERS:
        setattr(wcs.wcs, name, packed[name])
    wcs.wcs.set()
    if packed["shape"]:
        wcs.array_shape = packed["shape"]
    return wcs


def pack_facts(facts):
    """A dictionary as text in which astropy's objects keep their types."""
    return _dump(_plain(facts))


def unpack_facts(text):
    """The dictionary of such a text."""
    from astropy.io.misc import yaml

    return yaml.load(str(text))


def _plain(value):
    """A value as YAML can hold it, what it cannot hold as text."""
    if isinstance(value, dict):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.generic):
        return value.item()
    try:
        _dump(value)
    except Exception:
        return str(value)
    return value


def _dump(value):
    from astropy.io.misc import yaml

    return yaml.dump(value, allow_unicode=False)
