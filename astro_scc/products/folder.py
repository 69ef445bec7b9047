# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Write a measurement to files: tables, maps and settings."""

from __future__ import annotations

import errno
import os
import shutil
import signal
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc import writing
from astro_scc.columns import describe
from astro_scc.kinematics.cosmology import table_in_c_as
from astro_scc.measurement.citations import citations_of
from astro_scc.measurement.result import SCCResult, map_hdus, velocity_hdus
from astro_scc.products.publication import with_published, write_publication

# Errors of the disk, which do not always name a file.
DISK_ERRORS = {errno.ENOSPC, errno.EFBIG, errno.EIO, errno.EROFS, errno.EDQUOT}
#: Tables in forms of journals and archives.
PRINTED = ("streams", "features", "positions")


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
            with _undisturbed():
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


@contextmanager
def _undisturbed():
    """Ignore interrupts while files that are complete are moved."""
    with ExitStack() as stack:
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)
            # Only the main thread has handlers.
            with suppress(TypeError, ValueError):
                before = signal.signal(number, signal.SIG_IGN)
                stack.callback(signal.signal, number, before or signal.SIG_DFL)
        yield


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
    tables = {"streams": streams, "components": streams}
    meta, cube, journals = {**result.meta, **streams.meta}, result.cube, ["streams"]
    hdus = map_hdus(result, text=text)
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
        hdus, journals = velocity_hdus(result, text=text), PRINTED
    else:
        # Nothing of it is compared.
        published = None
    written, paths = write_tables(
        tables | {"ssps": result.ssps}, directory, meta, cube,
        configuration=configuration, text=text, published=published,
    )  # fmt: skip
    paths.append(Path(directory, "scc.fits"))
    hdus.writeto(paths[-1], output_verify="exception", overwrite=True)
    if archives:
        printed = {name: written[name] for name in journals}
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
        note = {key: table.meta[key] for key in ("note",) if key in table.meta}
        copy.meta = plain_meta(meta | note)
        paths.append(Path(folder, f"{name}.ecsv"))
        if name == "components" and table is tables["streams"]:
            shutil.copyfile(Path(folder, "streams.ecsv"), paths[-1])
        else:
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
