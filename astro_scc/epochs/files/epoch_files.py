# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Writing a cube as one FITS image an epoch."""

import re
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.io import fits

from astro_scc.epochs.files.headers import epoch_header
from astro_scc.partial import replace_when_complete

__all__ = ["write_epochs"]


def write_epochs(cube, directory, *, prefix=None, overwrite=False):
    """
    Write a cube as one FITS image an epoch, for any program that reads FITS.

    Parameters
    ----------
    cube : `EpochCube`
    directory : path
        Made if need be.
    prefix : str, optional
        Start of the files' names, by default the object's name; the number
        of the epoch and its date follow.
    overwrite : bool, optional
        Replace files that exist.

    Returns
    -------
    list of `~pathlib.Path`

    Raises
    ------
    OSError
        If a file exists and ``overwrite`` is False, or cannot be written.

    Notes
    -----
    Masked pixels become NaN; values are kept as 32-bit floats.  A file
    appears under its name when it is complete.

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
    days = cube.times.strftime("%Y-%m-%d")
    digits = max(2, len(str(len(cube) - 1)))
    paths = [
        directory / f"{prefix}_{i:0{digits}d}_{day}.fits" for i, day in enumerate(days)
    ]
    existing = [path for path in paths if path.exists()]
    if existing and not overwrite:
        raise OSError(
            f"{existing[0]}: exists already; choose another folder, or overwrite"
        )
    directory.mkdir(parents=True, exist_ok=True)
    for i, path in enumerate(paths):
        with replace_when_complete(path, overwrite=True) as part:
            _image_hdu(cube, i).writeto(part)
    return paths


def _image_hdu(cube, i):
    image = np.array(cube.data[i], dtype=np.float32)
    image[cube.mask[i]] = np.nan
    header = epoch_header(
        time=cube.times[i],
        label=cube.labels[i],
        beam=cube.beams and cube.beams[i],
        noise=None if cube.noise is None else cube.noise[i],
        facts=cube.epoch_meta[i],
    )
    wcs = cube.wcs.to_header()
    # The epoch's own date stands; wcslib derives others from the first.
    for keyword in ("DATE-OBS", "MJD-OBS", "MJDREF", "DATEREF", "TIMESYS"):
        wcs.remove(keyword, ignore_missing=True)
    header.update(wcs)
    if cube.unit == u.Jy / u.beam:
        header["BUNIT"] = "JY/BEAM"
    elif cube.unit != u.dimensionless_unscaled:
        header["BUNIT"] = cube.unit.to_string("fits")
    for line in cube.meta.get("history", ()):
        header.add_history(str(line).encode("ascii", "replace").decode())
    return fits.PrimaryHDU(image, header)
