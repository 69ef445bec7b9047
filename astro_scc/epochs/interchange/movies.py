# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Movies in HDF5, as eht-imaging writes them."""

import os
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.time import Time

from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.interchange.optional import optional
from astro_scc.epochs.offset_grid import offset_wcs

__all__ = ["is_hdf5", "read_movie"]
__doctest_requires__ = {"read_movie": ["h5py"]}

_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def is_hdf5(path):
    """
    Whether a file is HDF5.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    bool

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.epochs.interchange import is_hdf5
    >>> _ = Path("jet.fits").write_text("SIMPLE")
    >>> is_hdf5("jet.fits")
    False
    """
    try:
        with open(path, "rb") as file:
            return file.read(len(_SIGNATURE)) == _SIGNATURE
    except OSError:
        return False


def read_movie(path, *, beams=None):
    """
    Read an HDF5 movie of eht-imaging as epochs.

    Parameters
    ----------
    path : str or path-like
    beams : beam or sequence of beams, optional
        To which the frames have been blurred; a movie says nothing of it.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        Stokes I in Jy/pixel; offsets are from the centre of the frames.

    Raises
    ------
    OSError
        If h5py is not installed, or the file is no such movie.

    Notes
    -----
    The dataset ``I`` holds the frames (time, row, column), the first row in
    the north and the first column in the east, ``times`` hours UTC after
    the day ``mjd``.  That and ``psize`` (rad), ``ra`` (h), ``dec`` (deg),
    ``rf`` (Hz) and ``source`` are attributes of ``header``.

    Examples
    --------
    >>> import h5py
    >>> import numpy as np
    >>> from astro_scc.epochs.interchange import read_movie
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
            frames = np.asarray(file["I"], dtype=float)
            hours = np.asarray(file["times"], dtype=float)
            head = {key: _plain(v) for key, v in file["header"].attrs.items()}
        start = Time(float(head["mjd"]), format="mjd", scale="utc")
        size = float(head["psize"]) * u.rad
        where = SkyCoord(float(head["ra"]) * u.hourangle, float(head["dec"]) * u.deg)
    except (KeyError, ValueError, OSError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise OSError(
            f"{path}: is no movie of eht-imaging, which has the datasets I and times "
            f"and the attributes mjd, psize, ra and dec of header ({reason})"
        ) from None
    if frames.ndim != 3 or len(frames) != len(hours):
        raise OSError(
            f"{path}: its frames have shape {frames.shape} for {len(hours)} times"
        )
    n, ny, nx = frames.shape
    facts = {"object": str(head["source"])} if head.get("source") else {}
    try:
        facts["frequency"] = float(head["rf"])
    except (KeyError, ValueError):
        pass
    return EpochCube(
        data=frames[:, ::-1],
        times=start + hours * u.hour,
        wcs=offset_wcs(size.to(u.mas), ((nx - 1) / 2, (ny - 1) / 2), where),
        unit=u.Jy / u.pix,
        beams=beams,
        epoch_meta=[dict(facts) for _ in range(n)],
        meta={
            **{k: v for k, v in facts.items() if k == "object"},
            "history": [f"{n} frames of the movie {path.name}"],
        },
    )


def _plain(value):
    """An attribute as text, however it is kept."""
    value = value.item() if isinstance(value, np.generic) else value
    return value.decode() if isinstance(value, bytes) else value
