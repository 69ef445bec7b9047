# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Lists of the Gaussian or point components of a source at many dates."""

from dataclasses import dataclass, field, fields, replace

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

__all__ = ["ComponentList"]

CORE = 0


@dataclass(frozen=True, eq=False, repr=False)
class ComponentList:
    """
    Components of one source at many dates, one entry for each.

    Parameters
    ----------
    times : `~astropy.time.Time`, shape (n_epochs,)
        Dates; they are put in order.
    epoch : array_like of int, shape (n,)
        Index into ``times`` of each component.
    flux : `~astropy.units.Quantity`, shape (n,)
        Flux densities.
    east, north : `~astropy.units.Quantity`, shape (n,)
        Offsets from the origin, small angles.
    major, minor : `~astropy.units.Quantity`, shape (n,), optional
        Full widths at half maximum of the Gaussians; 0 or NaN is a point.
    pa : `~astropy.units.Quantity`, shape (n,), optional
        Position angles of the major axes, north through east.
    feature : array_like of int, shape (n,), optional
        The same number at every epoch for the same feature; 0 is the core,
        -1 a component that was not identified.
    excluded : array_like of bool, shape (n,), optional
        Components that their authors left out of their own fits.
    labels : sequence of str, length n_epochs, optional
        What an epoch is called; its date by default.
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
    excluded: np.ndarray | None = None
    labels: tuple[str, ...] = ()
    meta: dict = field(default_factory=dict)

    def __post_init__(self):
        times = Time(self.times)
        epoch = np.asarray(self.epoch, dtype=int)
        n = epoch.size
        zeros = np.zeros(n)
        columns = {
            "flux": u.Quantity(self.flux).to(u.Jy),
            "east": u.Quantity(self.east).to(u.mas),
            "north": u.Quantity(self.north).to(u.mas),
            "major": _or(self.major, zeros * u.mas).to(u.mas),
            "pa": _or(self.pa, zeros * u.deg).to(u.deg),
            "feature": np.asarray(_or(self.feature, np.full(n, -1)), dtype=int),
            "excluded": np.asarray(_or(self.excluded, zeros), dtype=bool),
        }
        columns["minor"] = _or(self.minor, columns["major"]).to(u.mas)
        for name, values in columns.items():
            if values.shape != (n,):
                raise ValueError(
                    f"components: {name} has shape {values.shape}, epoch has ({n},)"
                )
        # Blank sizes and the angles of round components mean nothing.
        for name in ("major", "minor", "pa"):
            columns[name] = np.nan_to_num(columns[name], nan=0.0)
        for name in ("flux", "east", "north", "major", "minor"):
            bad = ~np.isfinite(columns[name])
            if bad.any():
                raise ValueError(
                    f"component {np.flatnonzero(bad)[0] + 1} of {n}: "
                    f"{name} is not finite"
                )
        wrong = (columns["minor"] > columns["major"] * (1 + 1e-6)) | (
            columns["minor"] < 0
        )
        if wrong.any():
            raise ValueError(
                f"component {np.flatnonzero(wrong)[0] + 1} of {n}: axes must be "
                "0 <= minor <= major"
            )
        if times.isscalar or (n and not 0 <= epoch.min() <= epoch.max() < len(times)):
            raise ValueError("components: epoch must be indices into an array of times")
        labels = tuple(self.labels) or tuple(times.strftime("%Y-%m-%d"))
        if len(labels) != len(times):
            raise ValueError(
                f"components: {len(labels)} labels for {len(times)} epochs"
            )
        order = np.argsort(times.mjd, kind="stable")
        object.__setattr__(self, "times", times[order])
        object.__setattr__(self, "labels", tuple(str(labels[i]) for i in order))
        object.__setattr__(self, "epoch", np.argsort(order)[epoch])
        for name, values in columns.items():
            object.__setattr__(self, name, values)

    def __len__(self):
        return self.epoch.size

    @property
    def n_epochs(self):
        """Number of epochs."""
        return len(self.times)

    def __repr__(self):
        days = self.times.strftime("%Y-%m-%d")
        span = f", {days[0]} to {days[-1]}" if len(days) else ""
        return (
            f"<ComponentList: {len(self)} components at {self.n_epochs} epochs{span}>"
        )

    @classmethod
    def read(cls, paths, **options):
        """
        Read component lists from files.

        Parameters
        ----------
        paths : path or sequence of paths
        **options
            See `read_components`.

        Returns
        -------
        `ComponentList`
        """
        from astro_scc.epochs.components.reading import read_components

        return read_components(paths, **options)

    @classmethod
    def concatenate(cls, lists):
        """
        Put several lists together; no epochs are merged.

        Parameters
        ----------
        lists : sequence of `ComponentList`

        Returns
        -------
        `ComponentList`
            With the position of the first and the meta that all agree in.

        Raises
        ------
        ValueError
            If there is none.
        """
        lists = list(lists)
        if not lists:
            raise ValueError("no component lists to put together")
        starts = np.cumsum([0] + [part.n_epochs for part in lists[:-1]])
        joined = {
            f.name: np.concatenate([getattr(part, f.name) for part in lists])
            for f in fields(cls)
            if f.name not in ("times", "epoch", "labels", "meta")
        }
        times = Time(
            np.concatenate([part.times.utc.isot for part in lists]),
            format="isot",
            scale="utc",
        )
        return cls(
            times=times,
            epoch=np.concatenate(
                [part.epoch + s for part, s in zip(lists, starts, strict=True)]
            ),
            labels=tuple(label for part in lists for label in part.labels),
            meta={
                key: value
                for key, value in lists[0].meta.items()
                if key == "position"
                or all(part.meta.get(key) == value for part in lists[1:])
            },
            **joined,
        )

    def select(self, *, after=None, before=None, features=None, excluded=True):
        """
        Some of the components; epochs that are left with none are dropped.

        Parameters
        ----------
        after, before : `~astropy.time.Time` or str, optional
            Keep ``after <= date < before``.
        features : sequence of int, optional
            Keep these features only.
        excluded : bool, optional
            False leaves out the components flagged as excluded.

        Returns
        -------
        `ComponentList`

        Raises
        ------
        ValueError
            If nothing is left.
        """
        dates = np.ones(self.n_epochs, dtype=bool)
        if after is not None:
            dates &= self.times >= Time(after)
        if before is not None:
            dates &= self.times < Time(before)
        keep = dates[self.epoch]
        if features is not None:
            keep &= np.isin(self.feature, features)
        if not excluded:
            keep &= ~self.excluded
        if not keep.any():
            days = self.times.strftime("%Y-%m-%d")
            raise ValueError(
                f"no component is left of {len(self)} between {days[0]} and "
                f"{days[-1]}; widen the selection"
            )
        epochs, epoch = np.unique(self.epoch[keep], return_inverse=True)
        changes = {
            f.name: getattr(self, f.name)[keep]
            for f in fields(self)
            if f.name not in ("times", "epoch", "labels", "meta")
        }
        return replace(
            self,
            times=self.times[epochs],
            epoch=epoch,
            labels=tuple(self.labels[i] for i in epochs),
            **changes,
        )

    def to_table(self):
        """
        All components as a table, which `read` takes back from ECSV.

        Returns
        -------
        `~astropy.table.QTable`
            A row a component, its offsets from the origin of this list.
        """
        return QTable(
            {
                "epoch": self.times[self.epoch].isot,
                "feature": self.feature,
                "flux": self.flux,
                "east": self.east,
                "north": self.north,
                "major_fwhm": self.major,
                "minor_fwhm": self.minor,
                "major_pa": self.pa,
                "excluded_from_fit": self.excluded,
            },
            meta=dict(self.meta),
        )


def _or(value, default):
    return default if value is None else value
