# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Write a measurement to files: tables, maps, settings, and SSPs as regions."""

from __future__ import annotations

import errno
import os
import re
import shutil
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.table import QTable
from numpy.typing import ArrayLike
from skimage.measure import find_contours

from astro_scc import writing
from astro_scc.columns import describe
from astro_scc.decomposition import SSPs
from astro_scc.epochs import EpochCube
from astro_scc.images.series import epoch_index
from astro_scc.kinematics.cosmology import table_in_c_as
from astro_scc.measurement.result import SCCResult, map_hdus, velocity_hdus
from astro_scc.measurement.tables import citations_of
from astro_scc.products.publication import with_published, write_publication

if TYPE_CHECKING:
    from photutils.segmentation import SegmentationImage
    from regions import Regions

# Errors of the disk, which do not always name a file.
DISK_ERRORS = {errno.ENOSPC, errno.EFBIG, errno.EIO, errno.EROFS, errno.EDQUOT}


#: One colour per scale, by its name in DS9.
COLORS = ("cyan", "orange", "green", "magenta", "yellow", "red")
#: Decimal places of degrees and arcsec, for errors below a nanoarcsecond.
DIGITS = 13


@contextmanager
def product_folder(
    path: Path | str, *, overwrite: bool = False, stale: Sequence[str] = ()
) -> Iterator[Path]:
    """
    Make a folder of products that appears only when all of them are complete.

    Parameters
    ----------
    path : path
        The folder.  Its parents are made if needed.
    overwrite : bool, optional
        Replace files of the same names in a folder that is not empty; other
        files stay.
    stale : sequence of str, optional
        Names of files that are deleted if they are not replaced, and of
        folders that are deleted as a whole.

    Yields
    ------
    `~pathlib.Path`
        Where to write.  Nothing is left behind if there is an error; a process that
        is killed leaves this folder, which is hidden.

    Raises
    ------
    OSError
        If the path is a file or cannot be written to, if the folder is not
        empty and ``overwrite`` is False, or if another run has written there.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.products.folder import product_folder
    >>> with product_folder("out") as folder:
    ...     _ = (folder / "a.txt").write_text("done")
    >>> [path.name for path in Path("out").iterdir()]
    ['a.txt']
    """
    target, folder, exists = Path(path), None, Path(path).is_dir()
    if target.exists() and not exists:
        raise OSError(f"{path}: is a file; choose another folder")
    made = [parent for parent in target.absolute().parents if not parent.exists()]
    # On the same disk as the target, so that files only have to be renamed.
    place = target.parent, f".{target.name}.partial-"
    if exists:
        place = target, ".partial-"
    try:
        # Neither what a killed run has left nor kept matches are products.
        names = [path.name for path in target.iterdir()] if exists else []
        kept = any(not name.startswith((".partial-", ".astro_scc-")) for name in names)
        if kept and not overwrite:
            what = "exists and is not empty; choose another folder, or --overwrite"
            raise OSError(f"{path}: {what}")
        target.parent.mkdir(parents=True, exist_ok=True)
        with writing.partial_folder(*place) as folder:
            yield folder
            # Files that are complete are moved, come what may.
            with writing.handled(signal.SIG_IGN, ("SIGINT", "SIGTERM", "SIGHUP")):
                if exists:
                    _move(folder, target, stale)
                else:
                    folder.rename(target)
    except BaseException as error:
        for parent in made:
            with suppress(OSError):
                parent.rmdir()
        # Errors that are raised here have no number.
        if not isinstance(error, OSError) or error.errno is None:
            raise
        if folder is None:
            what = f"cannot be made or used: {error.strerror}"
        elif error.filename2 == str(target):
            what = "cannot be made: another run has written there; choose another"
        elif error.errno in DISK_ERRORS:
            why = f"{error.strerror}; make room there or choose another folder"
            what = f"cannot be written: {why}"
        else:
            raise
        raise OSError(f"{path}: {what}") from None


def _move(folder, target, stale=()):
    """Move all files of a folder into another one, and delete stale ones there."""
    new = {path.name for path in folder.iterdir()}
    for name in stale:
        if (target / name).is_dir():
            shutil.rmtree(target / name)
    for path in sorted(folder.iterdir()):
        if path.is_dir() and (target / path.name).is_dir():
            _move(path, target / path.name)
        else:
            os.replace(path, target / path.name)
    for name in set(stale) - new:
        (target / name).unlink(missing_ok=True)
    folder.rmdir()


def write_products(
    result: SCCResult, streams: QTable, directory: Path | str, *,
    configuration: dict[str, Any] | None = None, text: str | None = None,
    published: QTable | None = None, archives: bool = True,
) -> list[Path]:  # fmt: skip
    """
    Write tables and maps of a measurement.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
        Or a ``PaperMeasurement``.
    streams : `~astropy.table.QTable`
        Its ``streams``, with apparent speeds if there are any.
    directory : path
        A folder that exists, see ``product_folder``.
    configuration : dict, optional
        Settings as plain numbers and text.  In the meta of the tables, they
        replace the settings of the measurement alone.
    text : str, optional
        The same settings as TOML, for ``config.toml``.
    published : `~astropy.table.QTable`, optional
        Published features, see
        ``astro_scc.products.publication.published_positions``, of which the table of
        features has columns.
    archives : bool, optional
        Write the folder ``publication``.

    Returns
    -------
    list of `~pathlib.Path`
        ``streams.ecsv``, ``components.ecsv``, the same for older scripts,
        ``spectrum.ecsv``, ``features.ecsv``, with apparent speeds if the streams have
        them, ``positions.ecsv``, ``sensitivity.ecsv``, ``epochs.ecsv``, ``ssps.ecsv``,
        ``citations.bib``, if ``text`` is given ``config.toml``, ``scc.fits``, and the
        folder ``publication``, see
        ``astro_scc.products.publication.write_publication``.  The paper's method has
        no spectrum, features, sensitivity and table of epochs.

    Raises
    ------
    OSError
        If a file cannot be written.

    Notes
    -----
    The files do not hold the time of writing: the same measurement gives the
    same files, to the byte.

    Examples
    --------
    >>> from pathlib import Path
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.products import write_products
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=6, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> result = scc(cube, n_trials=100, rng=1)
    >>> Path("out").mkdir()
    >>> paths = write_products(result, result.streams, "out")
    >>> [path.name for path in paths if path.parent.name == "out"][:3]
    ['streams.ecsv', 'components.ecsv', 'spectrum.ecsv']
    """
    tables = {"streams": streams}
    meta, cube = {**result.meta, **streams.meta}, result.cube
    if isinstance(result, SCCResult):
        features = table_in_c_as(result.features, streams)
        features = with_published(features, result.tracked_features, published)
        epochs, used = cube.epochs, result.ssps["epoch"][result.ssps["in_region"]]
        epochs["n_ssp"] = np.bincount(used, minlength=len(epochs))
        tables |= {
            "spectrum": result.spectrum, "features": features,
            "positions": result.feature_positions, "sensitivity": result.sensitivity,
            "epochs": describe(epochs, "epochs"),
        }  # fmt: skip
        hdus = velocity_hdus(result, text=text)
    else:
        # Nothing of it is compared.
        hdus, published = map_hdus(result, text=text), None
    written, paths = write_tables(
        tables | {"ssps": result.ssps}, directory, meta, cube,
        configuration=configuration, text=text, published=published,
    )  # fmt: skip
    paths.insert(1, shutil.copyfile(paths[0], Path(directory, "components.ecsv")))
    paths.append(Path(directory, "scc.fits"))
    hdus.writeto(paths[-1], output_verify="exception", overwrite=True)
    if archives:
        names = "streams", "features", "positions"
        printed = {name: written[name] for name in names if name in written}
        paths += write_publication(printed, directory, {"ssps": result.ssps})
    return paths


def write_tables(
    tables, folder, meta, cube, *, configuration=None, text=None, published=None
):
    """
    Write tables by their names with one meta and their notes, settings and citations.

    Parameters
    ----------
    tables : dict of `~astropy.table.QTable`
    folder : path
    meta : dict
    cube : `~astro_scc.epochs.EpochCube`
        The meta gets its history.
    configuration, text, published : optional
        See `write_products`.

    Returns
    -------
    tables : dict of `~astropy.table.QTable`
        As they were written.
    paths : list of `~pathlib.Path`
    """
    if configuration is not None:
        kept = {key: value for key, value in meta.items() if key != "settings"}
        meta = {"configuration": configuration, **kept}
    history = list(cube.meta.get("history", ()))
    if published is not None and "survey" in published.meta:
        history.append(f"compared with {published.meta['survey']}")
    meta, written, paths = meta | {"history": history}, {}, []
    for name, table in tables.items():
        written[name] = copy = table.copy(copy_data=False)
        note = {key: table.meta[key] for key in ("note", "doubts") if key in table.meta}
        copy.meta = plain_meta(meta | note)
        paths.append(Path(folder, f"{name}.ecsv"))
        copy.write(paths[-1], format="ascii.ecsv", overwrite=True)
    texts = {"citations.bib": citations_of(history, meta)}
    if text is not None:
        texts["config.toml"] = text
    for name, content in texts.items():
        paths.append(Path(folder, name))
        paths[-1].write_text(content, encoding="utf-8")
    return written, paths


def write_files(files, folder):
    """Write contents of files by their names, each when it is complete."""
    for name, content in files.items():
        with writing.replace_when_complete(folder / name, overwrite=True) as part:
            part.write_bytes(content)


def plain_meta(value):
    """Convert meta to Python scalars, lists and quantities, which ECSV writes."""
    if isinstance(value, dict):
        return {key: plain_meta(item) for key, item in value.items()}
    if isinstance(value, u.Quantity):
        return [plain_meta(item) for item in value] if value.shape else value
    if isinstance(value, tuple | list | np.ndarray):
        return [plain_meta(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


# -- SSPs as regions on the sky and as segmentation images ---------------------------


def ssp_regions(
    ssps: SSPs, cube: EpochCube, epoch: int, *, scales: ArrayLike | None = None,
    frame: str = "cube",
) -> Regions:  # fmt: skip
    """
    Return the SSPs of an epoch as regions on the sky.

    They are polygons around the centres of the pixels of each SSP; holes are not cut
    out.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs, for example ``result.decomposed.ssps``.
    cube : `~astro_scc.epochs.EpochCube`
    epoch : int
        Index of the epoch.
    scales : sequence of float, optional
        By default all scales.
    frame : {"cube", "epoch"}
        The coordinates of the cube, as in the files of
        `~astro_scc.epochs.write_epochs`, or those that the epoch's own file
        gives to these pixels.  They differ if epochs are aligned on the core,
        and in most VLBI images.

    Returns
    -------
    `regions.Regions`
        Each is a `~regions.PolygonSkyRegion`.  Its text is its number in ``ssps``,
        its colour shows the scale.

    Raises
    ------
    IndexError
        If there is no such epoch.
    ValueError
        If the frame is unknown, or if the coordinates of the epoch's own file are
        wanted but the cube was not read from files.

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.products import ssp_regions
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> ssps = SSPs.of_epochs([Decomposer(scales=[2])(image) for image in cube.data])
    >>> found = ssp_regions(ssps, cube, 0)
    >>> len(found) == (ssps.epoch == 0).sum().item(), found[0].meta["text"]
    (True, '0')
    """
    # It imports matplotlib.
    from regions import PolygonSkyRegion, Regions

    if frame not in ("cube", "epoch"):
        raise ValueError(f"frame must be 'cube' or 'epoch', got {frame!r}")
    if frame == "epoch" and cube.epoch_wcs is None:
        raise ValueError("the cube was not read from files; there is no frame 'epoch'")
    wcs = cube.wcs if frame == "cube" else cube.epoch_wcs[epoch]
    colors = {s: COLORS[k % len(COLORS)] for k, s in enumerate(np.unique(ssps.scale))}
    found = Regions([])
    for index in _chosen(ssps, cube, epoch, scales):
        y0, x0, y1, x1 = ssps.bbox[index]
        row, column = np.divmod(ssps.pixels_of(index), cube.shape[2])
        inside = np.zeros((y1 - y0 + 2, x1 - x0 + 2))
        inside[row - y0 + 1, column - x0 + 1] = 1
        contours = find_contours(inside, 0.5, fully_connected="high")
        # The longest contour is the outer one; the others surround holes.
        y, x = max(contours, key=len)[:-1].T
        region = PolygonSkyRegion(wcs.pixel_to_world(x + x0 - 1, y + y0 - 1))
        region.meta["text"] = str(index)
        region.visual["color"] = colors[ssps.scale[index]]
        found.append(region)
    return found


def write_ssp_regions(
    ssps: SSPs, cube: EpochCube, epoch: int, path: Path | str, *,
    overwrite: bool = False, **options: Any,
) -> int:  # fmt: skip
    """
    Write the SSPs of an epoch as regions for DS9, CARTA and others.

    Parameters
    ----------
    ssps, cube, epoch
        As in `ssp_regions`.
    path : path
        A file, commonly ``.reg``.
    overwrite : bool, optional
    **options
        ``scales`` and ``frame`` of `ssp_regions`.

    Returns
    -------
    int
        The number of regions.

    Raises
    ------
    OSError
        If the file exists and ``overwrite`` is False, or cannot be written.

    Notes
    -----
    On scales of mas, regions need more digits than `regions` writes by
    default: positions and sizes are accurate to a nanoarcsecond.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.products import write_ssp_regions
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=2, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> matched = scc.match(cube)
    >>> n = write_ssp_regions(matched.ssps, cube, 0, "epoch_0.reg")
    >>> n == int((matched.ssps.epoch == 0).sum())
    True
    """
    found = ssp_regions(ssps, cube, epoch, **options)
    # For an empty list, regions writes nothing at all.
    text = "# Region file format: DS9 version 4.1\nglobal color=green\nicrs\n"
    if len(found):
        text = found.serialize(format="ds9", precision=DIGITS)
    with writing.replace_when_complete(os.fspath(path), overwrite=overwrite) as part:
        part.write_text(text, encoding="ascii")
    return len(found)


def ssp_segmentation(
    ssps: SSPs, cube: EpochCube, epoch: int, scale: float
) -> SegmentationImage:
    """
    Return the SSPs of one scale of an epoch as a photutils segmentation image.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    cube : `~astro_scc.epochs.EpochCube`
    epoch : int
        Index of the epoch.
    scale : float

    Returns
    -------
    `photutils.segmentation.SegmentationImage`
        Labels are 1 + the number in ``ssps``, which is also the column
        ``ssp`` of the tables.

    Raises
    ------
    IndexError
        If there is no such epoch.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.products import ssp_segmentation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=2, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> matched = scc.match(cube)
    >>> image = ssp_segmentation(matched.ssps, cube, 0, scale=2)
    >>> image.shape, image.n_labels == int((matched.ssps.epoch == 0).sum())
    ((128, 256), True)
    """
    from photutils.segmentation import SegmentationImage

    labels = np.zeros(cube.shape[1:], dtype=np.int32)
    for index in _chosen(ssps, cube, epoch, [scale]):
        labels.flat[ssps.pixels_of(index)] = index + 1
    return SegmentationImage(labels)


def _chosen(ssps, cube, epoch, scales):
    here = ssps.epoch == epoch_index(epoch, len(cube))
    if scales is not None:
        here &= np.isin(ssps.scale, list(scales))
    return np.flatnonzero(here)


def write_epoch_regions(
    ssps: SSPs, cube: EpochCube, directory: Path | str, **options: Any
) -> list[Path]:
    """
    Write the SSPs of every epoch as regions for DS9, one file per epoch.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs, for example ``result.decomposed.ssps``.
    cube : `~astro_scc.epochs.EpochCube`
    directory : path
        Its folder ``ssp_regions`` is made if needed; files of the same names
        are replaced.
    **options
        ``scales`` of `ssp_regions`.

    Returns
    -------
    list of `~pathlib.Path`
        Named by the number and the name of each epoch: ``00_first.reg``.

    Raises
    ------
    OSError
        If a file cannot be written.

    Notes
    -----
    The coordinates are those of the epoch's own file, which DS9 can show below
    the regions, or those of the cube if it was not read from files.

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.products import write_epoch_regions
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> ssps = SSPs.of_epochs([Decomposer(scales=[2])(image) for image in cube.data])
    >>> paths = write_epoch_regions(ssps, cube, ".")
    >>> [path.as_posix() for path in paths]
    ['ssp_regions/00_2000-01-01.reg', 'ssp_regions/01_2000-01-31.reg']
    """
    folder = Path(directory, "ssp_regions")
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
    """Return a label in the characters of a file name."""
    stem = PurePath(label).name.removesuffix(".fits")
    return re.sub(r"[^A-Za-z0-9+._-]+", "_", stem)[:60].strip("._") or "epoch"
