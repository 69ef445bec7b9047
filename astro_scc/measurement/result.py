# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The result of a measurement."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.nddata import NDData
from astropy.table import QTable
from astropy.wcs import WCS

from astro_scc.columns import build_table, cell, round_to_errors
from astro_scc.epochs import EpochCube
from astro_scc.epochs.serialize import read_object, write_object
from astro_scc.features import Features
from astro_scc.features.finder import feature_table
from astro_scc.images.positions import name_by_frame
from astro_scc.measurement import tables
from astro_scc.measurement.cautions import DIFFERENT, largest_difference
from astro_scc.patterns import DecomposedEpochs
from astro_scc.spectrum.rays import VelocityMap
from astro_scc.streams import members
from astro_scc.streams.decomposed import DecomposedFlow
from astro_scc.streams.finder import StreamSearch
from astro_scc.units import PM_UNIT, in_speed_unit, unit_name
from astro_scc.writing import ascii_line

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: What the files of results are, in their headers and in messages.
RESULT = "astro_scc result"
#: Relative width of the bins of the interval.
INTERVAL_STEP = 0.12
#: What the header of the diagram says about it.
DIAGRAM = (
    "Correlation coefficient of the changes of the images at two dates, at a",
    "displacement along the flow, less its mean over all pairs of dates.  What",
    "moves at a constant speed is at displacement = speed * interval.",
    "INTV-LOG: interval = CRVAL1 * exp(CDELT1 * (pixel - CRPIX1) / CRVAL1).",
    "NaN: no two dates have this interval.  The table INTERVALS has the mean",
    "interval and the number of pairs of dates of each column.",
)


@dataclass(frozen=True, eq=False, repr=False)
class SCCResult(tables.VelocityMaps):
    """
    The streams of a cube, with the velocity spectrum that they follow from.

    Attributes
    ----------
    decomposed : `~astro_scc.patterns.DecomposedEpochs`
    search : ``StreamSearch``
        The streams, the velocity spectrum and the test for motion.
    position_angle : `~astropy.units.Quantity`
        Direction of the jet, to which ``pm_parallel`` refers.
    choices : list of dict
        Rows of `sensitivity`, as plain numbers.
    meta : dict
        Settings, seed and versions.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(rng=1).cube
    >>> scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    >>> result = scc(cube, n_trials=200, rng=1)
    >>> len(result.streams) == len(result.search.streams)
    True
    """

    decomposed: DecomposedEpochs
    search: StreamSearch
    position_angle: u.Quantity
    choices: list = field(default_factory=list)
    meta: dict = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path | str) -> SCCResult:
        """
        Read a result that `write` wrote.

        Parameters
        ----------
        path : path

        Returns
        -------
        `SCCResult`
            The same to the bit, with its epochs and permutations.

        Raises
        ------
        OSError
            If the file cannot be read, is incomplete or no result, or was written by
            a version of this package whose results hold something else.
        """
        return read_object(path, creator=RESULT)

    def write(self, path: Path | str, *, overwrite: bool = False) -> None:
        """
        Write the whole result to one FITS file, which `read` reads.

        Parameters
        ----------
        path : path
        overwrite : bool, optional
            Replace an existing file, once the new one is complete.

        Raises
        ------
        OSError
            If the file exists and ``overwrite`` is False, or cannot be written.
        ValueError
            If the result holds an object of a class that is not of this package.
        """
        write_object(self, path, creator=RESULT, overwrite=overwrite)

    def __repr__(self):
        name = f"SCCResult {self.cube.meta.get('object', '')}".strip()
        table = self.components
        unit = unit_name(table["pm"].unit)
        speeds = [f"{cell(row, 'pm', '+-')} {unit} {row['kind']}" for row in table]
        found = ", ".join(speeds) or "no stream"
        return f"<{name}: {found}, {len(self.cube)} epochs>"

    def _repr_html_(self):
        lines = [repr(self)[1:-1], repr(self.cube)[1:-1]]
        text = f"<p>{'<br>'.join(map(escape, lines))}</p>"
        shown = tables.paper_table(self.components)
        if len(shown) == 0:
            return text
        return text + "".join(shown.pformat(max_lines=-1, max_width=-1, html=True))

    @property
    def cube(self) -> EpochCube:
        """The epochs that were measured."""
        return self.decomposed.cube

    @property
    def flow(self) -> DecomposedFlow:
        """What changes in the images, along the flow."""
        return self.search.flow

    @property
    def frame(self) -> Any:
        """The two velocity axes, a frame of `astro_scc.kinematics`."""
        return self.flow.frame

    @property
    def grid(self) -> VelocityMap:
        """The velocities of the velocity map, in mas/yr."""
        velocities: VelocityMap = self.search.velocities
        return velocities

    @cached_property
    def ssps(self) -> QTable:
        """The SSPs of all epochs as a `~astropy.table.QTable`."""
        return tables.ssp_table(self.decomposed)

    @property
    def tracked_features(self) -> Features:
        """The features that are followed in the images of ``decomposed``."""
        features: Features = self.search.features
        return features

    @cached_property
    def features(self) -> QTable:
        """
        The features, a `~astropy.table.QTable` with a row for each.

        Its ``stream`` is that of `streams` of which it is a member, or 0.  Secure
        features that move belong to the stream of the nearest speed, features that
        stand still to the stationary one.
        """
        found = np.zeros(len(self.tracked_features), dtype=int)
        for number, stream in enumerate(self.search.streams, start=1):
            # What is not tested rests on its features alone.
            if stream.kind == "moving" or np.isnan(stream.p_global):
                found[stream.members] = number
        return feature_table(self.tracked_features, found)

    @cached_property
    def feature_positions(self) -> QTable:
        """The features by epoch, a `~astropy.table.QTable`."""
        return self.tracked_features.positions

    @cached_property
    def sensitivity(self) -> QTable:
        """
        The main speed from parts of the data, a `~astropy.table.QTable`.

        The first row is the speed of the stream with the largest share, from the
        velocity spectrum.  The others have its speed from short and from long
        intervals, from the first and the second half of the epochs, and from the inner
        and the outer half of what is seen; NaN where nothing is found.  Where two
        parts, or a part and the whole, differ by more than two errors, ``significant``
        says so.  Without significant motion the table is empty, and the ``note`` in its
        meta says so.  `~astro_scc.flow.compare_scales` compares scales.
        """
        table = build_table("sensitivity", self.choices)
        if not self.choices:
            table.meta["note"] = "nothing moves significantly"
        return round_to_errors(in_speed_unit(table, self.cube.speed_unit))

    @property
    def sensitivity_line(self) -> str:
        """On what the main speed depends, in words; empty if on nothing."""
        lines, table, found = [], self.sensitivity, np.isfinite(self.sensitivity["pm"])
        apart = found & table["significant"]
        if apart.any():
            unit, rows = unit_name(table["pm"].unit), np.array(self.choices)[apart]
            # Parts that agree differ from the whole.
            apart[0] = not (len(rows) > 1 and largest_difference(rows) > DIFFERENT)
            each = (
                f"{cell(row, 'pm', '+-')} ({row['choice']})" for row in table[apart]
            )
            lines.append(f"its speed differs between parts: {', '.join(each)} {unit}")
        # The first row is the whole.
        missing, n = np.sum(~found), len(table[1:])
        if 2 * missing > n:
            lines.append(f"it is not found in {missing} of {n} parts of the data")
        return "; ".join(lines)

    @cached_property
    def streams(self) -> QTable:
        """
        The streams, a `~astropy.table.QTable`.

        There is one row per stream: first those that move, the slowest first, then what
        stands still.  If nothing moves significantly, the first row is the strongest
        speed that was tested, "not significant", and its ``caution`` says why.  The
        meta holds the settings, the seed, the versions, and the ``slowest`` and
        ``fastest`` speed that were searched along the flow, and the largest one that
        the dates do not alias, ``unambiguous``; ``lines`` are those along which speeds
        are measured, "straight", "diverging" or "bent".
        """
        rows = [tables.stream_row(self, k) for k in range(len(self.search.streams))]
        meta, unit = self.meta | self.cube.facts, self.cube.speed_unit
        for name in ("slowest", "fastest", "unambiguous"):
            meta[name] = (getattr(self.search, name) * PM_UNIT).to(unit)
        meta["lines"] = self.search.flow.grids[0].kind_of_lines
        return name_by_frame(tables.stream_table(rows, meta=meta, unit=unit), self.cube)

    @cached_property
    def spectrum(self) -> QTable:
        """
        The velocity spectrum, a `~astropy.table.QTable`.

        A row for each speed along the flow: ``share``, that of the variance of the
        moving emission; ``z``, and ``p_global``, the fraction of permutations
        with as large a z at any speed, see ``permutation_test``.
        """
        return tables.spectrum_table(self)

    def diagram(self) -> NDData:
        """
        Return the displacement-interval diagram along the direction of the flow.

        What moves at a constant speed lies on a ray from the origin; what
        stands still lies at zero displacement.

        Returns
        -------
        `~astropy.nddata.NDData`
            Correlation coefficients of the changes of the images at two dates, less
            their mean over all pairs, shape (n_displacements, n_intervals); NaN at
            intervals that no two dates have.  The axes of the WCS are the interval,
            logarithmic like its bins (FITS ``-LOG``), and the displacement in mas.  The
            meta holds the mean ``interval`` and the ``n_pairs`` of each bin, the
            ``beam``, the ``direction`` of the displacement on the axes of the frame,
            and its ``position_angle``, or None if that differs from place to place.
        """
        search, diagram = self.search, self.search.diagram
        years, angle = diagram.years, search.angle
        direction, position_angle = np.array([np.cos(angle), np.sin(angle)]), None
        values = diagram.means / (diagram.power or 1.0)
        first, second = np.nonzero(years - years[:, None] > 0)
        apart = ~np.eye(len(years), dtype=bool)
        excess = values[first, second] - values[apart].mean(axis=0)
        excess[:, ~(diagram.overlap > 0)] = np.nan
        if self.frame.uniform:
            sky = np.linalg.solve(self.frame.matrix(0.0, 0.0), direction)
            position_angle = np.degrees(np.arctan2(*sky)) * u.deg
            if np.cos(position_angle - self.position_angle) < 0:
                # Displacements down the jet are positive.
                direction, excess = -direction, excess[:, ::-1]
                position_angle += 180 * u.deg
            position_angle %= 360 * u.deg
        data, interval, n_pairs, middle = _binned(years[second] - years[first], excess)
        wcs = WCS(naxis=2)
        wcs.wcs.ctype, wcs.wcs.cunit = ["INTV-LOG", "DISPLACE"], ["yr", "mas"]
        wcs.wcs.crpix = [1.0, (data.shape[1] + 1) / 2]
        wcs.wcs.crval = [middle, 0.0]
        spacing = np.diff(diagram.displacement).mean() * search.beam
        wcs.wcs.cdelt = [INTERVAL_STEP * middle, spacing]
        meta = {
            "axes": ("interval", "displacement"), "interval": interval * u.yr,
            "n_pairs": n_pairs, "beam": search.beam * u.mas, "direction": direction,
            "position_angle": position_angle,
        }  # fmt: skip
        return NDData(data.T, unit=u.one, wcs=wcs, meta=meta)

    def plot(self, kind: str = "spectrum", **options: Any) -> Figure:
        """
        Draw a figure of the measurement.

        Parameters
        ----------
        kind : str
            ``"spectrum"``, the velocity spectrum with its significance;
            ``"distance"``, speeds against distance from the core; ``"velocity_map"``,
            the correlation along all velocities with the streams; ``"significance"``,
            its z-score along the jet; ``"paper"``, both as in Fig. 2 of Mertens &
            Lobanov (2016); ``"diagram"``, the displacement-interval diagram with the
            rays of the streams; ``"speeds"``, ``"tracks"`` and ``"separation"`` of the
            features; ``"epochs"``, the images with their SSPs; ``"sensitivity"``, the
            speed with other choices of the data.
        **options
            ``ax``, the axes to draw on, or for "paper", "tracks" and
            "epochs" ``figure``; ``unit`` of the axes, but for "speeds" and
            "sensitivity".  Of figures with streams: their table
            ``components``; of figures with speeds: ``beta_per_pm``, the apparent speed
            in units of c of 1 mas/yr, for a second axis.  Also ``which``, the map
            "coefficient" or "z_score"; ``colorbar``; ``max_panels`` of "epochs";
            ``profile`` of "speeds", see `astro_scc.flow.feature_profile`; ``published``
            features of "tracks" and "separation"; and what
            `EpochCube.plot <astro_scc.epochs.EpochCube.plot>` takes for "epochs".
            Other keywords are matplotlib's, of the main image, line or symbols:
            ``cmap``, ``vmin``, ``vmax``, ``norm``, ``color``, ``linewidth``.

        Returns
        -------
        `matplotlib.figure.Figure`
            Notebooks show it; elsewhere use its ``savefig``, as pyplot, which has a
            state, does not know it.

        Raises
        ------
        ValueError
            If there is no such figure, or an option has a wrong value.
        """
        from astro_scc.visualization import plot_result

        return plot_result(self, kind, **options)

    def explore(self, path: Path | str) -> Path:
        """
        Write a page with linked panels that shows which features make a velocity.

        Parameters
        ----------
        path : path
            The HTML file, which is replaced if it exists.  It needs no network.

        Returns
        -------
        `~pathlib.Path`

        Raises
        ------
        ImportError
            If bokeh is not installed.
        OSError
            If the file cannot be written.
        """
        from astro_scc.visualization.explore import write_explore

        tables = self.streams, self.features
        return write_explore(path, *tables, velocity_hdus(self), cube=self.cube)


def _binned(tau, excess):
    """Return means in logarithmic bins of the interval; their intervals and numbers."""
    shortest = tau.min()
    bins = np.floor(np.log(tau / shortest) / INTERVAL_STEP + 1e-9).astype(int)
    n_pairs = np.bincount(bins)
    data = np.zeros((len(n_pairs), excess.shape[1]))
    np.add.at(data, bins, excess)
    with np.errstate(invalid="ignore"):
        data, interval = data / n_pairs[:, None], np.bincount(bins, tau) / n_pairs
    return data, interval, n_pairs, shortest * np.exp(INTERVAL_STEP / 2)


def velocity_hdus(result, *, text=None):
    """
    Return the velocity map, its significance and the diagram as FITS extensions.

    Parameters
    ----------
    result : `SCCResult`
    text : str, optional
        Settings, which become comments of the header.

    Returns
    -------
    `~astropy.io.fits.HDUList`
        The velocity map, and the extension ``ZSCORE``,
        with a linear WCS in mas/yr along the velocity axes; the image
        ``DIAGRAM`` of `SCCResult.diagram`; the table ``INTERVALS``, which
        describes the columns of that image; and the table ``FEATURES``, which is
        `SCCResult.feature_positions` without fluxes, with the velocity of the feature
        on the axes of the velocity map, ``pm_axis1`` and ``pm_axis2``, and dates as
        text.
    """
    hdus, image = map_hdus(result, text=text), result.diagram()
    along = result.frame.axis_names[0]
    along = "DISPPA" if along == "east" else along
    header = _header(image, ("between two dates", f"of patterns, along {along}"))
    header["BEAM"] = image.meta["beam"].value, "[mas] FWHM along the displacement"
    if (angle := image.meta["position_angle"]) is not None:
        header["DISPPA"] = angle.value, "[deg] position angle of the displacement"
    for line in DIAGRAM:
        header.add_comment(line)
    hdus.append(fits.ImageHDU(image.data, header, name="DIAGRAM"))
    columns = QTable({name: image.meta[name] for name in ("interval", "n_pairs")})
    hdus.append(fits.table_to_hdu(columns, name="INTERVALS"))
    features = result.feature_positions.copy()
    features.meta.clear()
    # The standard does not have DN, which solar images are in.
    features.remove_column("flux")
    # Readers of FITS know dates as text.
    features["date"] = np.asarray(features["date"].isot, dtype="U23")
    velocity, _ = members.frame_velocities(result.frame, result.tracked_features)
    row = np.searchsorted(result.tracked_features.number, features["feature"])
    features["pm_axis1"], features["pm_axis2"] = velocity[row].T * PM_UNIT
    hdus.append(fits.table_to_hdu(features, name="FEATURES"))
    return hdus


def map_hdus(result, *, text=None):
    """
    Return the velocity map and its significance, the first two of `velocity_hdus`.

    Parameters
    ----------
    result : `SCCResult` or `~astro_scc.paper.method.PaperMeasurement`
    text : str, optional

    Returns
    -------
    list of FITS extensions
    """
    hdus = fits.HDUList()
    for which, kind in (("coefficient", fits.PrimaryHDU), ("z_score", fits.ImageHDU)):
        image = result.velocity_map(which)
        header = _header(image, ("direction of the proper motion",) * 2)
        hdus.append(kind(np.asarray(image.data, dtype=float), header))
        hdus[-1].name = which.replace("_", "").upper()
    primary, cube, meta = hdus[0].header, result.cube, result.meta
    times, angle = cube.times.utc[[0, -1]], result.position_angle.to_value(u.deg)
    versions = meta.get("versions", {})
    creator = f"astro_scc {versions.get('astro_scc', '')}"
    facts = {
        "OBJECT": (ascii_line(cube.meta.get("object", ""))[:60], "name of the object"),
        # If one form of a date is missing, readers warn that they add it.
        "TIMESYS": ("UTC", "time scale"),
        "DATE-BEG": (times.isot[0], "first epoch"),
        "DATE-END": (times.isot[1], "last epoch"),
        "MJD-BEG": (float(times.mjd[0]), "first epoch"),
        "MJD-END": (float(times.mjd[1]), "last epoch"),
        "NEPOCHS": (len(cube), "number of epochs"),
        "JETPA": (float(angle), "[deg] position angle of the jet"),
        "NTRIALS": (meta.get("n_trials"), "number of trials"),
        "SEED": (meta.get("seed"), "seed of the trials"),
        "CREATOR": (ascii_line(creator)[:60], "program"),
    }
    primary.update({k: v for k, v in facts.items() if v[0] not in (None, "")})
    for i, (name, version) in enumerate(sorted(versions.items()), start=1):
        primary[f"VERS{i}"] = ascii_line(f"{name} {version}")[:60]
    for line in cube.meta.get("history", ()):
        primary.add_history(ascii_line(line))
    for line in (text or "").splitlines():
        primary.add_comment(ascii_line(line) or " ")
    return hdus


def _header(image, comments):
    header = image.wcs.to_header()
    # Keywords of celestial coordinates, which these axes are not.
    for key in ("LATPOLE", "LONPOLE", "MJDREF", "RADESYS"):
        header.remove(key, ignore_missing=True)
    for i, named in enumerate(zip(image.meta["axes"], comments, strict=True), start=1):
        header[f"CNAME{i}"] = named
    return header
