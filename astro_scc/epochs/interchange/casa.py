# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""CASA images, which are folders."""

import os
import tempfile
import warnings
from importlib.util import find_spec
from pathlib import Path

__all__ = ["is_casa_image", "read_casa_image"]


def is_casa_image(path):
    """
    Whether a path is a CASA table, as its images are.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    bool

    Examples
    --------
    >>> from astro_scc.epochs.interchange import is_casa_image
    >>> is_casa_image("jet.fits")
    False
    """
    return (Path(os.fspath(path)) / "table.dat").is_file()


def read_casa_image(path):
    """
    A CASA image as the FITS images that CASA would export.

    Parameters
    ----------
    path : str or path-like
        The folder of the image.

    Returns
    -------
    `~astropy.io.fits.HDUList`

    Raises
    ------
    OSError
        If neither casatools nor spectral-cube is installed, or the folder
        is no image that they can read.

    Notes
    -----
    ``casatools`` is asked first, since the date of observation comes with
    it; ``spectral-cube`` gives images without date, for which
    ``EpochCube.read`` takes ``times``.

    Examples
    --------
    >>> from astro_scc.epochs.interchange import read_casa_image
    >>> hdus = read_casa_image("ngc253.image")  # doctest: +SKIP
    >>> hdus[0].header["BUNIT"]  # doctest: +SKIP
    'Jy/beam'
    """
    path = Path(os.fspath(path))
    for module, read in (("casatools", _by_casatools), ("spectral_cube", _by_cube)):
        if find_spec(module) is None:
            continue
        try:
            return read(path)
        except Exception as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise OSError(
                f"{path}: {module} cannot read it as a CASA image: {reason}"
            ) from None
    raise OSError(
        f"{path}: a CASA image; export it as FITS (exportfits in CASA), or install "
        "spectral-cube: pip install 'astro_scc[casa]'"
    )


def _by_casatools(path):
    from astropy.io import fits
    from casatools import image

    tool = image()
    with tempfile.TemporaryDirectory() as folder:
        exported = Path(folder) / "image.fits"
        tool.open(str(path))
        try:
            tool.tofits(str(exported), velocity=False, stokeslast=True)
        finally:
            tool.close()
        with fits.open(exported, memmap=False) as hdus:
            return fits.HDUList([hdu.copy() for hdu in hdus])


def _by_cube(path):
    from astropy.io import fits
    from spectral_cube import SpectralCube

    with warnings.catch_warnings():
        # What it says about frequency axes is of no concern here.
        warnings.simplefilter("ignore")
        cube = SpectralCube.read(str(path), format="casa_image")
        cube.allow_huge_operations = True
        return fits.HDUList([cube.hdu])
