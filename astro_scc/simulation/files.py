# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Writing simulated jets."""

import os
from pathlib import Path

from astro_scc.epochs.serialize import write_epochs

__all__ = ["write_simulation"]


def write_simulation(jet, directory, *, overwrite=False):
    """
    Write a simulated jet: one FITS image an epoch, and ``truth.ecsv``.

    Parameters
    ----------
    jet : `SimulatedJet`
    directory : path
        Made if need be.
    overwrite : bool, optional
        Replace files that exist.

    Returns
    -------
    list of `~pathlib.Path`
        The images, then the table.

    Raises
    ------
    OSError
        If a file exists and ``overwrite`` is False, or cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from astro_scc.simulation import simulate_two_fluid, write_simulation
    >>> jet = simulate_two_fluid(n_epochs=2, rng=1)
    >>> with TemporaryDirectory() as folder:
    ...     [path.name for path in write_simulation(jet, folder)]
    ['two-fluid_00_2000-01-01.fits', 'two-fluid_01_2000-01-31.fits', 'truth.ecsv']
    """
    table = Path(directory) / "truth.ecsv"
    if table.exists() and not overwrite:
        raise OSError(f"{table}: exists already; choose another folder, or overwrite")
    paths = write_epochs(jet.cube, directory, overwrite=overwrite)
    partial = table.with_name(".truth.ecsv.partial")
    try:
        jet.truth.write(partial, format="ascii.ecsv", overwrite=True)
        os.replace(partial, table)
    finally:
        partial.unlink(missing_ok=True)
    return [*paths, table]
