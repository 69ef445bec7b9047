# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Files of other packages: movies of eht-imaging in HDF5, and CASA images."""

import os
import tempfile
import warnings
from collections.abc import Sequence
from contextlib import closing
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.time import Time

from astro_scc.epochs import Beam, EpochCube
from astro_scc.epochs.headers import first_line, get

__doctest_requires__ = {"read_movie": ["h5py"]}


def optional(package, purpose, extra):
    """Return an optional module; an ImportError says how to install it."""
    try:
        return import_module(package)
    except ImportError:
        raise ImportError(
            f"{purpose} needs {package}; install it: pip install 'astro_scc[{extra}]'"
        ) from None


def read_movie(
    path: Path | str, *, beams: Beam | Sequence[Beam] | None = None
) -> EpochCube:
    """
    Read an HDF5 movie of eht-imaging as epochs.

    Parameters
    ----------
    path : str or path-like
    beams : beam or sequence of beams, optional
        Beams to which the frames have been blurred; a movie does not state them.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        Stokes I in Jy/pixel, with offsets from the centre of the frames.

    Raises
    ------
    OSError
        If h5py is not installed, or the file is not such a movie.

    Notes
    -----
    The dataset ``I`` holds the frames (time, row, column), with the first row
    in the north and the first column in the east; ``times`` are hours UTC
    after the start of day ``mjd``.  The latter, ``psize`` (rad), ``ra`` (h),
    ``dec`` (deg), ``rf`` (Hz) and ``source`` are attributes of ``header``.

    Examples
    --------
    >>> import h5py
    >>> import numpy as np
    >>> from astro_scc.interchange import read_movie
    >>> with h5py.File("movie.hdf5", "w") as file:
    ...     file["I"], file["times"] = np.ones((2, 20, 20)), [0.5, 1.5]
    ...     header = file.create_dataset("header", (0,), dtype="S10")
    ...     header.attrs.update({"mjd": "57850", "psize": "9.7e-12", "ra": "17.76",
    ...                          "dec": "-28.99"})
    >>> print(read_movie("movie.hdf5").times[0].isot)
    2017-04-07T00:30:00.000
    """
    path = Path(os.fspath(path))
    try:
        h5py = optional("h5py", "reading an HDF5 movie", "hdf5")
    except ImportError as error:
        raise OSError(f"{path}: {error}") from None
    try:
        with h5py.File(path, "r") as file:
            frames, hours = (np.asarray(file[k], dtype=float) for k in ("I", "times"))
            head = {key: _plain(v) for key, v in file["header"].attrs.items()}
        mjd, size, ra, dec = (float(head[k]) for k in ("mjd", "psize", "ra", "dec"))
        where = SkyCoord(ra * u.hourangle, dec * u.deg)
    except (KeyError, ValueError, OSError, TypeError) as error:
        raise OSError(
            f"{path}: is no movie of eht-imaging, which has the datasets I and times "
            f"and the attributes mjd, psize, ra and dec of header ({first_line(error)})"
        ) from None
    if frames.ndim != 3 or len(frames) != len(hours):
        raise OSError(
            f"{path}: its frames have shape {frames.shape} for {len(hours)} times"
        )
    name, frequency = get(head, "source", kind=str), get(head, "rf", kind=float)
    facts = {} if frequency is None else {"frequency": frequency}
    meta = {} if name is None else {"object": name}
    return EpochCube.from_arrays(
        frames[:, ::-1],
        Time(mjd, format="mjd", scale="utc") + hours * u.hour,
        pixel_scale=(size * u.rad).to(u.mas),
        position=where,
        unit=u.Jy / u.pix,
        beams=beams,
        epoch_meta=[meta | facts] * len(frames),
        meta=meta | {"history": [f"{len(frames)} frames of the movie {path.name}"]},
    )


def _plain(value):
    """Return an attribute as a plain value, bytes as text."""
    value = value.item() if isinstance(value, np.generic) else value
    return value.decode() if isinstance(value, bytes) else value


def read_casa_image(path):
    """
    Return a CASA image, a folder, as the FITS images that CASA would export.

    ``casatools`` is tried first, since it gives the date of observation;
    ``spectral-cube`` gives images without a date, so ``EpochCube.read`` needs
    ``times``.  An OSError is raised if neither is installed or the image cannot
    be read.
    """
    path = Path(os.fspath(path))
    for module, read in (("casatools", _by_casatools), ("spectral_cube", _by_cube)):
        if find_spec(module) is not None:
            try:
                return read(path)
            except Exception as error:
                raise OSError(
                    f"{path}: {module} cannot read it as a CASA image: "
                    f"{first_line(error)}"
                ) from None
    raise OSError(
        f"{path}: a CASA image; export it as FITS (exportfits in CASA), or install "
        "spectral-cube: pip install 'astro_scc[casa]'"
    )


def _by_casatools(path):
    from casatools import image

    with tempfile.TemporaryDirectory() as folder:
        exported = Path(folder) / "image.fits"
        with closing(image()) as tool:
            tool.open(str(path))
            tool.tofits(str(exported), velocity=False, stokeslast=True)
        with fits.open(exported, memmap=False) as hdus:
            return fits.HDUList([hdu.copy() for hdu in hdus])


def _by_cube(path):
    from spectral_cube import SpectralCube

    with warnings.catch_warnings(action="ignore"):
        # Its warnings about frequency axes do not matter here.
        cube = SpectralCube.read(str(path), format="casa_image")
        cube.allow_huge_operations = True
        return fits.HDUList([cube.hdu])
