# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Component lists from ECSV, machine-readable tables, difmap and AIPS."""

import warnings
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.time import Time

from astro_scc.epochs.components.lists import CORE, ComponentList
from astro_scc.epochs.components.models import read_aips, read_difmap
from astro_scc.epochs.components.tables import (
    read_ecsv,
    read_mrt,
    require_source,
    row_date,
)
from astro_scc.epochs.fits import check_ordinary
from astro_scc.epochs.validation import as_times
from astro_scc.exceptions import EpochWarning

__all__ = ["read_components"]

READERS = {
    "ecsv": read_ecsv,
    "mrt": read_mrt,
    "difmap": read_difmap,
    "aips-cc": read_aips,
}
SUFFIXES = {
    ".ecsv": "ecsv",
    ".mod": "difmap",
    ".mdl": "difmap",
    ".fits": "aips-cc",
    ".fit": "aips-cc",
    ".fts": "aips-cc",
    ".txt": "mrt",
    ".dat": "mrt",
    ".mrt": "mrt",
}


def read_components(paths, *, format=None, source=None, origin=None, dates=None):
    """
    Read component lists of one source.

    Parameters
    ----------
    paths : path or sequence of paths
        A table of many epochs, or one file an epoch.
    format : {'ecsv', 'mrt', 'difmap', 'aips-cc'}, optional
        By default from the file's suffix: ``.ecsv``; ``.txt``, ``.dat`` or
        ``.mrt``, a machine-readable table of the AAS or, with its file
        ``ReadMe`` beside it, of the CDS; ``.mod``; ``.fits`` with an AIPS CC
        table, of several the one with the highest version.
    source : str, optional
        Which source to take from a table of many.  A file of another source
        is refused.
    origin : {'core', 'map'}, optional
        Put the core, feature 0, at the origin, or leave the map's centre
        there.  By default 'core' for tables whose positions refer to the
        core, as MOJAVE's, whose core rows alone refer to the map's centre;
        'map' for all others.
    dates : sequence of `~astropy.time.Time` or str, optional
        Dates of the files.  Without it a difmap file must have its date in
        its name (2006-03-09, 2006_03_09 or 20060309).

    Returns
    -------
    `ComponentList`

    Raises
    ------
    OSError
        If a file is missing or is not of its format.
    ValueError
        If a value cannot be used; the message names the file and the row.

    Notes
    -----
    Tables need columns for the date (``epoch``, or ``Obs.Y``, ``Obs.M`` and
    ``Obs.D`` for year, month and day), ``flux``, ``separation`` and
    ``position_angle`` (or ``east`` and ``north``), with units; they may have
    ``feature``, ``major_fwhm``, ``axial_ratio`` or ``minor_fwhm``,
    ``major_pa`` and ``excluded_from_fit``.  Machine-readable tables are
    understood by their labels and explanations.  A blank size is a point, a
    blank ratio a circle.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from astro_scc.epochs import read_components
    >>> model = "0.9v 0.1v 90 0.2v 1 0 1\\n0.1v 2.0v -45.0v\\n"
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "source_2006-03-09.mod"
    ...     _ = path.write_text(model)
    ...     components = read_components(path)
    >>> components
    <ComponentList: 2 components at 1 epochs, 2006-03-09 to 2006-03-09>
    >>> components.east.round(2)
    <Quantity [ 0.1 , -1.41] mas>
    """
    if isinstance(paths, (str, Path)):
        paths = [paths]
    paths = [Path(p) for p in paths]
    if not paths:
        raise ValueError("no component files were given")
    for path in paths:
        check_ordinary(path)
    if origin not in (None, "core", "map"):
        raise ValueError(f"origin must be 'core' or 'map', got {origin!r}")
    if format is not None and format not in READERS:
        raise ValueError(f"format must be one of {', '.join(READERS)}, got {format!r}")
    if dates is None:
        dates = [None] * len(paths)
    elif isinstance(dates, str) or (isinstance(dates, Time) and dates.isscalar):
        dates = [dates]
    if len(dates) != len(paths):
        raise ValueError(f"{len(dates)} dates for {len(paths)} component files")

    lists = []
    for path, date in zip(paths, dates, strict=True):
        name = format or SUFFIXES.get(path.suffix.lower())
        if name is None:
            raise ValueError(
                f"{path}: the suffix {path.suffix!r} tells no format; give one of "
                f"{', '.join(READERS)}"
            )
        if not path.is_file():
            raise OSError(f"{path}: no such file")
        if date is not None:
            date = row_date(date, path)
        columns, relative, meta = READERS[name](path, source=source, date=date)
        if name in ("difmap", "aips-cc"):
            require_source(source, [meta["object"]] if "object" in meta else [], path)
        lists.append(_build(path, columns, relative, origin, meta))
    objects = sorted({part.meta["object"] for part in lists if "object" in part.meta})
    if len(objects) > 1:
        warnings.warn(
            f"the component files are of {', '.join(objects)}; if these are not "
            "names of one source, leave the wrong files out",
            EpochWarning,
            stacklevel=2,
        )
    return lists[0] if len(lists) == 1 else ComponentList.concatenate(lists)


def _build(path, columns, relative, origin, meta):
    """Component list of one file; ``relative``: positions refer to the core."""
    dates = np.asarray(columns.pop("date"))
    days, epoch = np.unique(dates, return_inverse=True)
    times = as_times(list(days), len(days))
    east, north = columns["east"], columns["north"]
    core = columns.get("feature", np.full(len(dates), -1)) == CORE
    for i, day in enumerate(days):
        here = epoch == i
        if not relative and origin != "core":
            continue
        n = np.count_nonzero(here & core)
        if n > 1:
            raise ValueError(
                f"{path}: {n} core components (feature 0) on {day[:10]}, expected one"
            )
        if n == 0:
            if relative and origin != "map":
                continue
            raise ValueError(
                f"{path}: no core component (feature 0) on {day[:10]}, which "
                f"origin={origin!r} needs"
            )
        at = np.flatnonzero(here & core)[0]
        x, y = east[at], north[at]
        if relative and origin == "map":
            # The core's row keeps its own offset from the map's centre.
            east[here & ~core] += x
            north[here & ~core] += y
        elif relative:
            east[at] = north[at] = 0
        else:
            east[here] -= x
            north[here] -= y
    labels = () if len(days) > 1 else (path.name,)
    try:
        return ComponentList(
            times=times,
            epoch=epoch,
            flux=columns["flux"] * u.Jy,
            east=east * u.mas,
            north=north * u.mas,
            major=columns["major"] * u.mas,
            minor=columns["minor"] * u.mas,
            pa=columns["pa"] * u.deg,
            feature=columns.get("feature"),
            excluded=columns.get("excluded"),
            labels=labels,
            meta=meta,
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
