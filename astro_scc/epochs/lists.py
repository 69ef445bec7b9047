# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Model components: lists of Gaussians at many dates, and how they are read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.columns import numbers
from astro_scc.epochs.tables import (
    UNITS,
    first_names,
    open_table,
    plain,
    read_rows,
    source_names,
)
from astro_scc.exceptions import naming, warn
from astro_scc.images import fits, series
from astro_scc.images.beam import Beam
from astro_scc.images.dates import as_times, given_times
from astro_scc.images.headers import some
from astro_scc.quantities import check_choice, named

COLUMNS = (*UNITS, "feature")
#: Names of components that were not identified.
UNIDENTIFIED = ("", "-", "--", "-1", "nan")


@dataclass(frozen=True, eq=False, repr=False)
class ComponentList:
    """
    Model components of one source at many dates, one entry per component.

    Parameters
    ----------
    times : `~astropy.time.Time`, shape (n_epochs,)
        Dates; they are sorted.
    epoch : array_like of int, shape (n,)
        Index into ``times`` of each component.
    flux : `~astropy.units.Quantity`, shape (n,)
        Flux densities.
    east, north : `~astropy.units.Quantity`, shape (n,)
        Offsets from the origin, small angles.
    major, minor : `~astropy.units.Quantity`, shape (n,), optional
        Full widths at half maximum of the Gaussians; 0 or NaN means a point.
    pa : `~astropy.units.Quantity`, shape (n,), optional
        Position angles of the major axes, north through east.
    feature : array_like of int, shape (n,), optional
        The same number at every epoch for the same feature; 0 is the core,
        -1 a component that was not identified.
    labels : sequence of str, length n_epochs, optional
        Names of the epochs, by default their dates.
    beams : sequence of `Beam`, length n_epochs, optional
        Beams of the images that the components describe.
    meta : dict, optional
        Facts about the source: object, redshift, frequency, position.

    Raises
    ------
    ValueError
        If lengths disagree, a value is not finite, or a minor axis exceeds
        its major axis.
    `~astropy.units.UnitConversionError`
        If a column has the wrong kind of unit.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.time import Time
    >>> from astro_scc.epochs import ComponentList
    >>> components = ComponentList(
    ...     times=Time(["2006-01-01", "2006-07-01"]),
    ...     epoch=[0, 0, 1, 1],
    ...     flux=[900, 300, 950, 280] * u.mJy,
    ...     east=[0, 1.0, 0, 1.3] * u.mas,
    ...     north=[0, 0.5, 0, 0.6] * u.mas,
    ... )
    >>> components
    <ComponentList: 4 components at 2 epochs, 2006-01-01 to 2006-07-01>
    >>> components.select(before="2006-03-01").n_epochs
    1
    """

    times: Time
    epoch: np.ndarray
    flux: u.Quantity
    east: u.Quantity
    north: u.Quantity
    major: u.Quantity | None = None
    minor: u.Quantity | None = None
    pa: u.Quantity | None = None
    feature: np.ndarray | None = None
    labels: tuple[str, ...] = ()
    beams: tuple[Beam, ...] = ()
    meta: dict = field(default_factory=dict)

    def __post_init__(self):
        times, epoch = Time(self.times), np.asarray(self.epoch, dtype=int)
        n = epoch.size
        if times.isscalar or (n and not 0 <= epoch.min() <= epoch.max() < len(times)):
            raise ValueError("components: epoch must be indices into an array of times")
        labels = series.as_epoch_tuple(self.labels, len(times), "labels", str)
        labels = labels or times.strftime("%Y-%m-%d").tolist()
        beams = series.as_beams(self.beams, len(times)) or ()
        order = times.argsort()
        # Components without a size are points, those with one axis are round.
        default = {"major": np.zeros(n) * u.mas, "pa": np.zeros(n) * u.deg}
        default |= {"feature": np.full(n, -1.0)}
        columns, wrong = {}, {}
        for name in COLUMNS:
            values = getattr(self, name)
            if values is None:
                values = columns["major"] if name == "minor" else default[name]
            values = u.Quantity(values).to(UNITS.get(name, u.one))
            if values.shape != (n,):
                raise ValueError(f"{name} has shape {values.shape}, epoch has ({n},)")
            if name in ("major", "minor", "pa"):
                # Blank sizes mean points, and round components have no angle.
                values[np.isnan(values)] = 0
            columns[name] = values
            wrong[f"{name} is blank or not finite"] = ~np.isfinite(values)
        minor, largest = columns["minor"], columns["major"] * (1 + 1e-6)
        wrong["axes must be 0 <= minor <= major"] = (minor < 0) | (minor > largest)
        for problem, where in wrong.items():
            for row in np.flatnonzero(where):
                raise ValueError(f"component {row + 1} of {n}: {problem}")
        columns |= {
            "times": times[order],
            "labels": tuple(labels[i] for i in order),
            "beams": tuple(beams[i] for i in order if beams),
            "epoch": np.argsort(order)[epoch],
            "feature": columns["feature"].value.astype(int),
        }
        vars(self).update(columns)

    def __len__(self) -> int:
        return self.epoch.size

    @property
    def n_epochs(self) -> int:
        """Number of epochs."""
        return len(self.times)

    def __repr__(self):
        days = self.times.strftime("%Y-%m-%d")
        span = f", {days[0]} to {days[-1]}" if len(days) else ""
        what = f"{len(self)} components at {self.n_epochs} epochs{span}"
        return f"<ComponentList: {what}>"

    def select(
        self, *, after: Time | str | None = None, before: Time | str | None = None
    ) -> ComponentList:
        """
        Return some of the components; epochs without any are dropped.

        Parameters
        ----------
        after, before : `~astropy.time.Time` or str, optional
            Keep ``after <= date < before``.

        Returns
        -------
        `ComponentList`

        Raises
        ------
        ValueError
            If no component is left.
        """
        keep, dates = np.ones(len(self), dtype=bool), self.times[self.epoch]
        if after is not None:
            keep &= dates >= Time(after)
        if before is not None:
            keep &= dates < Time(before)
        if not keep.any():
            days = self.times.strftime("%Y-%m-%d")
            what = f"{len(self)} between {days[0]} and {days[-1]}; widen the selection"
            raise ValueError(f"no component is left of {what}")
        epochs, epoch = np.unique(self.epoch[keep], return_inverse=True)
        chosen = {name: getattr(self, name)[keep] for name in COLUMNS}
        chosen["labels"] = tuple(self.labels[i] for i in epochs)
        chosen["beams"] = tuple(self.beams[i] for i in epochs if self.beams)
        return replace(self, times=self.times[epochs], epoch=epoch, **chosen)

    def to_table(self) -> QTable:
        """
        Return all components as a table, which `read_components` reads from ECSV.

        Returns
        -------
        `~astropy.table.QTable`
            One row per component, with offsets from the origin of this list.  Its
            ``meta`` has the ``beam`` if all epochs have the same.
        """
        names = {"major": "major_fwhm", "minor": "minor_fwhm", "pa": "major_pa"}
        table = QTable({"epoch": self.times[self.epoch].isot}, meta=dict(self.meta))
        if self.beams and all(beam == self.beams[0] for beam in self.beams):
            axes = (getattr(self.beams[0], name) for name in ("major", "minor", "pa"))
            table.meta["beam"] = " ".join(map(str, axes))
        for name in ("feature", *UNITS):
            table[names.get(name, name)] = getattr(self, name)
        return table


def _read(path, source, origin, date, beam):
    """Return the `ComponentList` in a file."""
    table, own_date = open_table(path)
    with naming(path):
        values, dates, meta = read_rows(table, source, date or own_date)
        if "feature" in values:
            values["feature"] = _numbers_of(values["feature"], path)
        days, epoch = np.unique(dates, return_inverse=True)
        has_offsets = {"east", "north"} <= values.keys()
        if not has_offsets:
            values |= _offsets(values)
        relative = not has_offsets and "feature" in values
        times = as_times(list(days), len(days))
        if relative and _is_of_the_map(values, epoch, times.jyear):
            warn(
                f"{path}: positions are taken from the core, and seem to be from the "
                "centre of the map, as features move more steadily if those of the "
                "core are subtracted; subtract them, or give 'east' and 'north'"
            )
        if relative or origin == "core":
            _refer(values, epoch, days, relative, origin)
        values |= _sizes(values)
        fields = {name: values[name] * unit for name, unit in UNITS.items()}
        fields |= {"times": times, "epoch": epoch}
        own_beam = meta.pop("beam", None)
        beams = [own_beam if beam is None else beam] * len(days)
        fields |= {"beams": beams if beams[0] else (), "meta": meta}
        fields["labels"] = () if len(days) > 1 else (path.name,)
        return ComponentList(**fields, feature=values.get("feature"))


def _numbers_of(column, path):
    """
    Return the numbers of the components in a column of their numbers or names.

    Of names such as C3 they are those behind the letters, or else in the order of the
    rows, which a warning tells.
    """
    if getattr(getattr(column, "dtype", None), "kind", "") != "U":
        values = numbers(column, u.one)
        for row in np.flatnonzero(values % 1 > 0):
            what = f"{column.info.name} is {values[row]:g}, expected a whole number"
            raise ValueError(f"row {row + 1}: {what}")
        return values
    texts = [str(text).strip() for text in np.ma.filled(column, "")]
    names = dict.fromkeys(text for text in texts if text not in UNIDENTIFIED)
    known = {name: re.search(r"\d*$", name)[0] for name in names}
    if all(name == digits for name, digits in known.items()):
        return np.array([float(known.get(text, -1)) for text in texts])
    bare = [name for name, digits in known.items() if not digits]
    # Beside names with numbers, C alone is the core.
    cores = [k for k in bare if k.casefold() == "core" or bare == ["C"]]
    others = [name for name in known if name not in cores]
    found = {name: int(known[name] or -1) for name in others}
    if -1 in found.values() or len({*found.values()} | {0}) <= len(found):
        found = {name: k for k, name in enumerate(others, start=1)}
        each = some([f"{name} is {k}" for name, k in found.items()], 8)
        what = f"{path}: column {column.info.name!r} has names, which are numbered"
        warn(f"{what}: {each}")
    found |= dict.fromkeys(cores, 0)
    return np.array([found.get(text, -1.0) for text in texts])


def _is_of_the_map(values, epoch, years, *, least=4, less=0.5):
    """
    Return whether features move more steadily once the core's position is subtracted.

    The squares of what remains of straight motions, of features of at ``least`` so many
    epochs, are then ``less`` times those before or fewer.  In 67 tables of MOJAVE,
    where positions are from the core, they are 0.86 times those or more.
    """
    core, squares = values["feature"] == 0, np.zeros(2)
    places = np.stack([values["east"], values["north"]], axis=1)
    of_core = np.full((len(years), 2), np.nan)
    of_core[epoch[core]] = places[core]
    known = np.isfinite(of_core[epoch, 0])
    for number in np.unique(values["feature"][values["feature"] > 0]):
        mine = known & (values["feature"] == number)
        if mine.sum() >= least:
            both = places[mine], places[mine] - of_core[epoch[mine]]
            motion = np.vander(years[epoch[mine]] - years.mean(), 2)
            lines = motion @ np.linalg.pinv(motion)
            squares += [np.sum((each - lines @ each) ** 2) for each in both]
    # Of exact motions, rounding remains.
    return squares[1] + 1e-12 < less * squares[0]


def _refer(values, epoch, days, relative, origin):
    """Shift the positions of each epoch to the requested origin, in place."""
    core = values.get("feature", np.full(len(epoch), -1)) == 0
    needed = origin == ("map" if relative else "core")
    for day, n in zip(days, np.bincount(epoch[core], minlength=len(days)), strict=True):
        if n > 1 or (needed and n == 0):
            found = f"{n} core components" if n else "no core component"
            raise ValueError(
                f"{found} (feature 0) on {day[:10]}, expected one to refer positions "
                "to; correct the file, or give another origin"
            )
    for offsets in (values["east"], values["north"]):
        of_core = np.zeros(len(days))
        of_core[epoch[core]] = offsets[core]
        if relative:
            # The row of the core has its own offset from the map's centre.
            offsets[core] = 0
        if origin == "map":
            offsets += of_core[epoch]
        elif not relative:
            offsets -= of_core[epoch]


def _offsets(values):
    """Return the offsets given by separations and position angles."""
    separation, angle = values["separation"], values["position_angle"]
    if "feature" in values:
        # A core with a blank offset is at the map's centre.
        blank = (values["feature"] == 0) & np.isnan(separation)
        separation = np.where(blank, 0.0, separation)
    angle = np.radians(np.where((separation == 0) & np.isnan(angle), 0.0, angle))
    for i in np.flatnonzero(np.isnan(separation + angle)):
        raise ValueError(f"row {i + 1}: 'separation' or 'position_angle' is blank")
    return {"east": separation * np.sin(angle), "north": separation * np.cos(angle)}


def _sizes(values):
    """Return the axes and angles; a blank size is a point, a blank ratio a circle."""
    zeros = np.zeros(len(values["flux"]))
    major = values.get("major", zeros)
    minor = values.get("minor", major * values.get("ratio", 1.0))
    minor = np.where(np.isnan(minor), major, minor)
    types = values.get("type", zeros + 1)
    for i in np.flatnonzero(~np.isin(types, (0, 1))):
        what = f"component type {types[i]:g} is neither a point (0) nor a Gaussian (1)"
        raise ValueError(f"row {i + 1}: {what}; replace it by one of these")
    sizes = {"major": major, "minor": minor, "pa": values.get("pa", zeros)}
    return {name: np.where(types == 0, 0.0, size) for name, size in sizes.items()}


def _concatenate(lists):
    """Concatenate lists, with the first one's position and the meta common to all."""
    starts = np.cumsum([0] + [part.n_epochs for part in lists[:-1]])
    epochs = [part.epoch + start for part, start in zip(lists, starts, strict=True)]
    dates = np.concatenate([part.times.utc.isot for part in lists])
    beams = tuple(beam for part in lists for beam in part.beams)
    return ComponentList(
        times=Time(dates, format="isot", scale="utc"),
        epoch=np.concatenate(epochs),
        labels=tuple(label for part in lists for label in part.labels),
        beams=beams if len(beams) == len(dates) else (),
        meta={
            key: value
            for key, value in lists[0].meta.items()
            if key == "position" or all(part.meta.get(key) == value for part in lists)
        },
        **{name: np.concatenate([getattr(p, name) for p in lists]) for name in COLUMNS},
    )


def read_components(
    paths: Path | str | Sequence[Path | str], *, source: str | None = None,
    origin: str | None = None, dates: Time | Sequence[Time | str | None] | None = None,
    beams: Beam | Sequence[Beam] | None = None,
) -> ComponentList:  # fmt: skip
    """
    Read the model components of one source from files.

    Parameters
    ----------
    paths : path or sequence of paths
        A table of many epochs, or one file per epoch; also patterns.  The suffix
        tells the format: ``.ecsv``; ``.txt``, ``.dat`` or ``.mrt``, a
        machine-readable table of the AAS or, with its file ``ReadMe`` in the same
        folder, of the CDS; ``.mod``, a difmap model; ``.fits`` with an AIPS CC
        table, the one with the highest version if there are several.
    source : str, optional
        Name of the source, for a table of several.  A file of another source
        is refused.
    origin : {'core', 'map'}, optional
        Put the core, feature 0, at the origin, or keep the map's centre
        there.  The default is 'core' for tables whose positions refer to the
        core, as in MOJAVE's, where only the rows of the core refer to the
        map's centre; it is 'map' for all others.
    dates : sequence of `~astropy.time.Time` or str, optional
        Dates of the files.  Without them a difmap file must have its date in
        its name (2006-03-09, 2006_03_09 or 20060309).
    beams : beam or sequence of beams, optional
        Beam of all files or of each, instead of those in the header of a FITS file or
        in the ``meta`` of a table, ``beam: 1.0 mas 0.5 mas -7 deg``.

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
    ``position_angle`` (or ``east`` and ``north``), with units; they may also
    have ``feature`` (a number or a name, such as C3; the core is 0, ``core`` or, where
    all others have numbers, C), ``major_fwhm``, ``axial_ratio`` or ``minor_fwhm``, and
    ``major_pa``.  Columns of machine-readable tables are recognised by their
    labels and explanations.  A blank size means a point, a blank ratio a circle.

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
    if origin is not None:
        named("origin", check_choice, origin, "core", "map")
    paths = fits.find_files(paths)
    with naming("dates"):
        dates = given_times(dates, len(paths))
    dates = [date and date.utc.isot for date in dates]
    beams = series.as_beams(beams, len(paths)) or [None] * len(paths)
    each = zip(paths, dates, beams, strict=True)
    lists = [_read(path, source, origin, date, beam) for path, date, beam in each]
    objects = sorted({part.meta["object"] for part in lists if "object" in part.meta})
    if len(objects := {*first_names(objects).values()}) > 1:
        warn(
            f"the component files are of {some(sorted(objects))}; if these are not "
            "names of one source, leave the wrong files out"
        )
    return lists[0] if len(lists) == 1 else _concatenate(lists)


def read_sources(
    path: Path | str, *, source: str | None = None, origin: str | None = None,
    beams: Beam | None = None,
) -> dict[str, ComponentList]:  # fmt: skip
    """
    Read the model components of all sources of a table.

    Parameters
    ----------
    path : path
        A table that `read_components` reads.
    source : str, optional
        Only this one.
    origin : {'core', 'map'}, optional
    beams : `Beam`, optional
        See `read_components`.

    Returns
    -------
    dict of `ComponentList`
        By the names of the sources; that of a table without names is its stem.  A
        source that cannot be read is left out with a warning.

    Raises
    ------
    OSError, ValueError
        See `read_components`.
    """
    (path,), options = fits.find_files(path), {"origin": origin, "beams": beams}
    if source is not None:
        components = read_components(path, source=source, **options)
        same = plain(components.meta.get("object", source)) == plain(source)
        return {source if same else components.meta["object"]: components}
    found, names = {}, source_names(open_table(path)[0])
    if names is None or len(names) == 0:
        # A table without rows is refused as any other.
        names = np.array([None])
    for name in dict.fromkeys(names.tolist()):
        try:
            found[name or path.stem] = read_components(path, source=name, **options)
        except ValueError as error:
            reason = error
            warn(f"{error}; the source {name or path.stem} is left out")
    if not found:
        raise reason
    return found
