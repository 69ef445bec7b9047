# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A measurement for other programs: TOPCAT, STILTS, Aladin, DS9, CARTA."""

import re
from pathlib import Path, PurePath

from astro_scc.measurement.patterns import write_ssp_regions
from astro_scc.measurement.votable import write_votable

__all__ = ["REGIONS", "write_epoch_regions", "write_votables"]

#: Folder of the regions.
REGIONS = "ssp_regions"


def write_votables(result, components, directory):
    """
    Write the tables of a measurement as VOTable.

    Parameters
    ----------
    result : `SCCResult`
    components : `~astropy.table.QTable`
        `SCCResult.components`, with apparent speeds if there are any.
    directory : path
        A folder that exists.  Files of these names are replaced.

    Returns
    -------
    list of `~pathlib.Path`
        ``components.vot`` and ``ssps.vot``, see `write_votable`.

    Raises
    ------
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.measurement import write_votables
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=5, rng=1).cube
    >>> result = StackedCrossCorrelation(scales=[2])(cube, n_trials=20, rng=1)
    >>> [path.name for path in write_votables(result, result.components, ".")]
    ['components.vot', 'ssps.vot']
    """
    tables = {"components": components, "ssps": result.ssps}
    paths = [Path(directory, f"{name}.vot") for name in tables]
    for path, table in zip(paths, tables.values(), strict=True):
        write_votable(table, path, overwrite=True)
    return paths


def write_epoch_regions(ssps, cube, directory, **options):
    """
    Write the SSPs of every epoch as regions for DS9, a file an epoch.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs, such as ``result.matched.ssps``.
    cube : `~astro_scc.epochs.EpochCube`
    directory : path
        Its folder ``ssp_regions`` is made if need be; files of the same
        names are replaced.
    **options
        ``scales`` and ``shape`` of `ssp_regions`.

    Returns
    -------
    list of `~pathlib.Path`
        The number of each epoch and its name, ``00_first.reg``.

    Raises
    ------
    OSError
        If a file cannot be written.

    Notes
    -----
    The coordinates are those of the epoch's own file, which DS9 opens beside
    it, or those of the cube if it was not read from files.

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.measurement import write_epoch_regions
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> ssps = SSPs.of_epochs([Decomposer(scales=[2])(image) for image in cube.data])
    >>> paths = write_epoch_regions(ssps, cube, ".")
    >>> [path.as_posix() for path in paths]
    ['ssp_regions/00_2000-01-01.reg', 'ssp_regions/01_2000-01-31.reg']
    """
    folder = Path(directory, REGIONS)
    folder.mkdir(exist_ok=True)
    frame = "cube" if cube.epoch_wcs is None else "epoch"
    digits = max(2, len(str(len(cube) - 1)))
    paths = []
    for i, label in enumerate(cube.labels):
        paths.append(folder / f"{i:0{digits}d}_{_plain(label)}.reg")
        write_ssp_regions(
            ssps, cube, i, paths[-1], frame=frame, overwrite=True, **options
        )
    return paths


def _plain(label):
    """A label as part of the name of a file."""
    stem = PurePath(label).name.removesuffix(".fits")
    return re.sub(r"[^A-Za-z0-9+._-]+", "_", stem)[:60].strip("._") or "epoch"
