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
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.columns import build_table, cell, describe, round_to_errors
from astro_scc.epochs import EpochCube
from astro_scc.epochs.serialize import read_object, write_object
from astro_scc.features import Features
from astro_scc.features.finder import feature_table
from astro_scc.images.positions import axis_words, name_by_frame, ssp_offsets
from astro_scc.matching.matched import MatchedEpochs
from astro_scc.measurement import tables
from astro_scc.measurement.axes import projection_of
from astro_scc.stacking.stack import VelocityPeak, sample_velocities
from astro_scc.stacking.velocities import DatePairs, VelocityGrid, VelocitySamples
from astro_scc.streams.diagram import DEFAULT, INTERVAL_STEP
from astro_scc.streams.dispersion import StreamVelocity
from astro_scc.streams.search import Search
from astro_scc.units import PM_UNIT, in_speed_unit, unit_name
from astro_scc.writing import ascii_line

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: What the files of results are, in their headers and in messages.
RESULT = "astro_scc result"
#: What the header of the diagram says about it.
DIAGRAM = (
    "Matches per pattern (SSP) and beam of displacement beyond those of",
    "permuted epochs, weighted by their correlation coefficients, and smoothed",
    "by a Gaussian with a standard deviation of {blur:g} BEAM.  What moves at a",
    "constant speed is at displacement = speed * interval.",
    "INTV-LOG: interval = CRVAL1 * exp(CDELT1 * (pixel - CRPIX1) / CRVAL1).",
    "NaN: no two dates have this interval.  The table INTERVALS has the mean",
    "interval and the number of pairs of dates of each column.",
)


@dataclass(frozen=True, eq=False, repr=False)
class SCCResult(tables.Components):
    """
    The stacked cross-correlation of a cube and its velocity components.

    Attributes
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
    frame : frame of `astro_scc.kinematics`
        The two velocity axes.
    position_angle : `~astropy.units.Quantity`
        Direction of the jet, to which ``pm_parallel`` refers.
    pairs : ``DatePairs``
    displacements : ``VelocitySamples``
    grid : ``VelocityGrid``
        In mas/yr.
    coefficient, z_score : `~numpy.ndarray`, shape ``grid.shape``
        The stack and its significance.
    search : ``Search``
        The streams, and the displacement-interval diagram that shows them.
    velocities : tuple of ``StreamVelocity``
        Velocities of the streams, with their errors.
    maxima : tuple of ``VelocityPeak``
        The peak of the stack that is nearest to each velocity.
    jitters : tuple of `~numpy.ndarray`, shape (2, 2)
        Covariances of these maxima in the velocity-jitter test, the paper's error.
    choices : list of dict
        Rows of `sensitivity`, as plain numbers.
    meta : dict
        Settings, seed and versions.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> result = scc(cube, n_trials=20, rng=1)
    >>> result.coefficient.shape == result.grid.shape
    True
    >>> len(result.components) == len(result.search.streams)
    True
    """

    matched: MatchedEpochs
    frame: Any
    position_angle: u.Quantity
    pairs: DatePairs
    displacements: VelocitySamples
    grid: VelocityGrid
    coefficient: np.ndarray
    z_score: np.ndarray
    search: Search
    velocities: tuple[StreamVelocity, ...]
    maxima: tuple[VelocityPeak, ...]
    jitters: tuple[np.ndarray, ...]
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
            The same to the bit, with its epochs, matches and permutations.

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
        table = tables.printed(self.components)
        unit = unit_name(table["pm"].unit)
        speeds = [f"{cell(row, 'pm', '+-')} {unit} {row['kind']}" for row in table]
        found = ", ".join(speeds) or "no stream"
        return f"<{name}: {found}, {len(self.cube)} epochs>"

    def _repr_html_(self):
        lines = [repr(self)[1:-1], repr(self.cube)[1:-1]]
        text = f"<p>{'<br>'.join(map(escape, lines))}</p>"
        shown = tables.paper_table(tables.printed(self.components))
        if len(shown) == 0:
            return text
        return text + "".join(shown.pformat(max_lines=-1, max_width=-1, html=True))

    @property
    def cube(self) -> EpochCube:
        """The epochs that were measured."""
        return self.matched.cube

    @cached_property
    def ssps(self) -> QTable:
        """The SSPs of all epochs as a `~astropy.table.QTable`."""
        return tables.ssp_table(self.matched)

    @property
    def tracked_features(self) -> Features:
        """The features that are followed in the images of ``matched``."""
        return self.matched.features

    @cached_property
    def features(self) -> QTable:
        """
        The features, a `~astropy.table.QTable` with a row for each.

        Its ``component`` is that of `components` of which it is a member, or 0.
        Standing features, and those beside chains of matches, belong to the one whose
        velocity they have within two standard errors, the dispersion included.
        """
        own = tables.components_of(self, self.tracked_features)
        table = feature_table(self.tracked_features, own)
        table.meta["core"] = self.core
        return table

    @cached_property
    def core(self) -> list[int]:
        """The rows of `components` that are the core, the reference of positions."""
        if self.cube.beams is None:
            return []
        near = max(beam.major for beam in self.cube.beams).to_value(u.mas) / 2
        distance = np.hypot(*ssp_offsets(self.matched.ssps, self.cube))
        found = []
        for number, stream in enumerate(self.search.streams, start=1):
            if stream.kind == "stationary":
                # Each SSP of the core is at the origin.
                ssps = self.displacements.ssp[self._matches_of(number)]
                if len(ssps) and distance[ssps].max() <= near:
                    found.append(number)
        return found

    @cached_property
    def feature_positions(self) -> QTable:
        """The features by epoch, a `~astropy.table.QTable`."""
        return self.tracked_features.positions

    @cached_property
    def sensitivity(self) -> QTable:
        """
        The main speed from parts of the data, a `~astropy.table.QTable`.

        The first row is the speed of the first component, along itself.  The others
        have its speed from short and from long intervals, from the first and the
        second half of the epochs, from the inner and the outer half of its features,
        and from fine and coarse scales.  Each part is searched again, from the matches
        on, and NaN where nothing is found.  Where two parts, or a part and the whole,
        differ by more than two errors, ``significant`` says so, and the error of the
        component holds half of the difference.  Without significant motion the table
        is empty, and the ``note`` in its meta says so.
        """
        table = build_table("sensitivity", self.choices)
        if not self.choices:
            table.meta["note"] = "nothing moves significantly"
        return round_to_errors(in_speed_unit(table, self.cube.speed_unit))

    @property
    def sensitivity_line(self) -> str:
        """On what the main speed depends, in words; empty if on nothing."""
        lines, table, found = [], self.sensitivity, np.isfinite(self.sensitivity["pm"])
        parts = [
            f"{cell(row, 'pm', '+-')} {row['pm'].unit} ({row['choice']})"
            for row in table[table["significant"] & found]
        ]
        if parts:
            lines.append("differs with the data: " + ", ".join(parts))
        # The first row is the whole.
        missing, n = np.sum(~found), len(table[1:])
        if 2 * missing > n:
            lines.append(f"not found in {missing} of {n} parts of the data")
        return "; ".join(lines)

    @cached_property
    def components(self) -> QTable:
        """
        The velocity components, a `~astropy.table.QTable`.

        There is one row per stream: first those that move, the ones with more
        features first, then what stands still.  If nothing moves significantly,
        the first row is the strongest speed that was tested, "not significant",
        and its ``caution`` says why.  The meta holds the settings, the seed, the
        versions, the ``slowest_searched`` and ``fastest_searched`` speed along the
        streams, and the numbers of the rows that are the ``core``.
        """
        numbers = range(1, len(self.maxima) + 1)
        rows = [tables.component_row(self, number) for number in numbers]
        meta, unit = self.meta | self.cube.facts, self.cube.speed_unit
        if rows:
            speed = np.abs(self.search.permutations.speed)
            speed = speed[speed > 0] * projection_of(self).beam(self.search.angle)[0]
            meta["slowest_searched"] = (speed.min() * PM_UNIT).to(unit)
            meta["fastest_searched"] = (speed.max() * PM_UNIT).to(unit)
            meta["core"] = self.core
        table = tables.component_table(rows, meta=meta, unit=unit)
        return name_by_frame(table, self.cube)

    def velocity_map(self, which: str = "coefficient") -> NDData:
        """
        Return the stack as an image with velocity coordinates.

        Parameters
        ----------
        which : {"coefficient", "z_score"}

        Returns
        -------
        `~astropy.nddata.NDData`
            Its WCS is linear in mas/yr along the two axes of the frame.

        Raises
        ------
        ValueError
            If ``which`` is another name.
        """
        if which not in ("coefficient", "z_score"):
            raise ValueError(f"unknown map {which!r}: use 'coefficient' or 'z_score'")
        names = tuple(self.frame.axis_names)
        if names == ("east", "north") and axis_words(self.cube)[0] != "east":
            names = "lon", "lat"
        wcs = WCS(naxis=2)
        wcs.wcs.ctype = [name.upper()[:8] for name in names]
        wcs.wcs.cunit = ["mas/yr", "mas/yr"]
        wcs.wcs.crpix = [(n + 1) / 2 for n in self.grid.shape[::-1]]
        wcs.wcs.crval = [0.0, 0.0]
        wcs.wcs.cdelt = self.grid.step
        return NDData(getattr(self, which), wcs=wcs, meta={"axes": names})

    def diagram(self) -> NDData:
        """
        Return the displacement-interval diagram along the direction of the streams.

        What moves at a constant speed lies on a ray from the origin; what
        stands still lies at zero displacement.

        Returns
        -------
        `~astropy.nddata.NDData`
            Matches per pattern and beam of displacement beyond those of permuted
            epochs, weighted by their coefficients, shape (n_displacements,
            n_intervals); NaN at intervals that no two dates have.  The axes of the WCS
            are the interval, logarithmic like its bins (FITS ``-LOG``), and the
            displacement in mas.  The meta holds the mean ``interval`` and the
            ``n_pairs`` of each bin, the ``beam`` along the displacement, the
            ``direction`` of the displacement on the axes of the frame, and its
            ``position_angle``, or None if that differs from place to place.
        """
        diagram, angle = self.search.diagram, self.search.angle
        beam = projection_of(self).beam(angle)[0]
        direction, position_angle = np.array([np.cos(angle), np.sin(angle)]), None
        # Both patterns of a match look for each other, and each match is a Gaussian
        # whose peak is one.
        n_patterns = 2 * max(self.ssps["in_region"].sum(), 1) / len(self.cube)
        area = np.sqrt(2 * np.pi) * DEFAULT.blur
        excess = (diagram.excess / diagram.n_pairs[:, None]).T / (n_patterns * area)
        if self.frame.uniform:
            sky = np.linalg.solve(self.frame.matrix(0.0, 0.0), direction)
            position_angle = np.degrees(np.arctan2(*sky)) * u.deg
            if np.cos(position_angle - self.position_angle) < 0:
                # Displacements down the jet are positive.
                direction, excess = -direction, excess[::-1]
                position_angle += 180 * u.deg
            position_angle %= 360 * u.deg
        # The first bin begins at the shortest interval that was used.
        baseline, years = self.meta["settings"]["baseline"], self.cube.years
        first, second = np.triu_indices(len(years), 1)
        every = (years[second] - years[first]).to_value(u.yr)
        least = 0.0 if baseline is None else baseline[0].to_value(u.yr)
        shortest = every[(every > 0) & (every >= least)].min()
        step = INTERVAL_STEP
        bins = np.floor(np.log(diagram.interval / shortest) / step + 1e-9).astype(int)
        n_bins = bins[-1] + 1
        data = np.full((len(excess), n_bins), np.nan)
        interval, n_pairs = np.full(n_bins, np.nan), np.zeros(n_bins, int)
        data[:, bins], interval[bins] = excess, diagram.interval
        n_pairs[bins] = diagram.n_pairs
        middle = shortest * np.exp(step / 2)
        wcs = WCS(naxis=2)
        wcs.wcs.ctype, wcs.wcs.cunit = ["INTV-LOG", "DISPLACE"], ["yr", "mas"]
        wcs.wcs.crpix = [1.0, (len(data) + 1) / 2]
        wcs.wcs.crval = [middle, 0.0]
        wcs.wcs.cdelt = [step * middle, beam * np.diff(diagram.displacement).mean()]
        meta = {
            "axes": ("interval", "displacement"),
            "interval": interval * u.yr,
            "n_pairs": n_pairs,
            "beam": beam * u.mas,
            "direction": direction,
            "position_angle": position_angle,
        }
        return NDData(data, unit=1 / u.beam, wcs=wcs, meta=meta)

    def members(self, number: int) -> QTable:
        """
        Return the matches that belong to a component.

        Parameters
        ----------
        number : int
            Number of the component, from 1.

        Returns
        -------
        `~astropy.table.QTable`
            The matches between two SSPs of the same feature of the stream.  If no
            feature was followed, they are the matches between dates of the map
            that agree with the velocity within two standard errors on both axes.
            A row has the ``match``, its index in ``displacements``; the ``ssp`` and
            the ``target_ssp`` (-1 if the match lies on none) with their epochs and
            dates; the ``interval``; the position of the SSP, an offset from the
            reference pixel; and the displacement along both axes of the frame
            with its errors.

        Raises
        ------
        ValueError
            If there is no such component.
        """
        if not 1 <= number <= len(self.maxima):
            raise ValueError(f"no stream {number}: there are {len(self.maxima)}")
        d, cube, match = self.displacements, self.cube, self._matches_of(number)
        ssp, start, end = d.ssp[match], d.reference[match], d.target[match]
        columns = {
            "match": match,
            "ssp": ssp,
            "target_ssp": d.target_ssp[match],
            "scale": d.scale[ssp],
            "epoch": start,
            "target_epoch": end,
            "date": Time(cube.times[start], format="isot"),
            "target_date": Time(cube.times[end], format="isot"),
            "interval": (cube.years[end] - cube.years[start]).to(u.yr),
        }
        columns["east"], columns["north"] = d.position[ssp].T * u.mas
        about, axes = {}, ((d.d1, d.s1), (d.d2, d.s2))
        for axis, (values, errors) in zip(self.frame.axis_names, axes, strict=True):
            name = f"displacement_{axis}"
            columns[name] = values[match] * u.mas
            columns[f"{name}_err"] = errors[match] * u.mas
            about[name] = f"displacement of the match, {axis}"
            about[f"{name}_err"] = f"standard error of {name}"
        table = QTable(columns | {"weight": d.weight[match]}, descriptions=about)
        describe(describe(table, "ssps"), "members")
        return name_by_frame(round_to_errors(table), cube)

    def _matches_of(self, number):
        """Return the indices of the matches of a component."""
        d, features = self.displacements, self.search.streams[number - 1].features
        if features:
            label = np.full(len(d.epoch), -1)
            for k, feature in enumerate(features):
                label[feature.ssp] = k
            there = np.where(d.target_ssp >= 0, label[d.target_ssp], -1)
            return np.flatnonzero((there >= 0) & (label[d.ssp] == there))
        index, *v, s1, s2, _ = sample_velocities(d, self.pairs)
        apart = np.abs(np.transpose(v) - self.velocities[number - 1].value)
        sigma = np.stack([s1, s2], axis=1)
        return index[np.all(apart <= tables.MEMBER_SIGMA * sigma, axis=1)]

    def plot(self, kind: str = "velocity_map", **options: Any) -> Figure:
        """
        Draw a figure of the measurement.

        Parameters
        ----------
        kind : str
            ``"velocity_map"``, the paper's stack with the components;
            ``"significance"``, its z-score along the jet; ``"paper"``, both as in
            Fig. 2 of Mertens & Lobanov (2016); ``"diagram"``, the displacement-interval
            diagram with the rays of the streams; ``"members"``, the matches of each
            component; ``"speeds"``, ``"tracks"`` and ``"separation"`` of the features;
            ``"epochs"``, the images with their SSPs; ``"sensitivity"``, the speed
            with other choices of the data.
        **options
            ``ax``, the axes to draw on, or for "paper", "members", "tracks" and
            "epochs" ``figure``; ``unit`` of the axes, but for "speeds" and
            "sensitivity".  Of figures with components: their table
            ``components``; of figures with speeds: ``beta_per_pm``, the apparent speed
            in units of c of 1 mas/yr, for a second axis.  Also ``which``, the map
            "coefficient" or "z_score"; ``colorbar``; ``max_panels`` of "members" and
            "epochs"; ``profile`` of "speeds", see `astro_scc.flow.feature_profile`;
            ``published`` features of "tracks" and "separation"; and what
            `EpochCube.plot <astro_scc.epochs.EpochCube.plot>` takes for "epochs".

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

        tables = self.components, self.features
        return write_explore(path, *tables, velocity_hdus(self), cube=self.cube)


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
        The stacked correlation coefficients, and the extension ``ZSCORE``,
        with a linear WCS in mas/yr along the velocity axes; the image
        ``DIAGRAM`` of `SCCResult.diagram`; the table ``INTERVALS``, which
        describes the columns of that image; and the table ``FEATURES``, which is
        `SCCResult.feature_positions` without fluxes, with the velocity of the feature
        on the axes of the velocity map, ``pm_axis1`` and ``pm_axis2``, and dates as
        text.
    """
    maps = map_hdus(result, text=text)
    return fits.HDUList([*maps, *_diagram_hdus(result), _features_hdu(result)])


def map_hdus(result, *, text=None):
    """
    Return the velocity map and its significance, the first two of `velocity_hdus`.

    Parameters
    ----------
    result : `SCCResult` or `~astro_scc.paper_method.PaperMeasurement`
    text : str, optional

    Returns
    -------
    list of FITS extensions
    """
    hdus = []
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


def _features_hdu(result):
    features = result.feature_positions.copy()
    features.meta.clear()
    # The standard does not have DN, which solar images are in.
    features.remove_column("flux")
    # Readers of FITS know dates as text.
    features["date"] = np.asarray(features["date"].isot, dtype="U23")
    velocity, _ = tables.frame_velocities(result.frame, result.tracked_features)
    row = np.searchsorted(result.tracked_features.number, features["feature"])
    features["pm_axis1"], features["pm_axis2"] = velocity[row].T * PM_UNIT
    return fits.table_to_hdu(features, name="FEATURES")


def _diagram_hdus(result):
    image = result.diagram()
    along = result.frame.axis_names[0]
    along = "DISPPA" if along == "east" else along
    header = _header(image, ("between two dates", f"of patterns, along {along}"))
    header["BUNIT"] = image.unit.to_string("fits")
    header["BEAM"] = image.meta["beam"].value, "[mas] FWHM along the displacement"
    if (angle := image.meta["position_angle"]) is not None:
        header["DISPPA"] = angle.value, "[deg] position angle of the displacement"
    for line in DIAGRAM:
        header.add_comment(line.format(blur=DEFAULT.blur))
    columns = QTable({name: image.meta[name] for name in ("interval", "n_pairs")})
    table = fits.table_to_hdu(columns, name="INTERVALS")
    return fits.ImageHDU(image.data, header, name="DIAGRAM"), table


def _header(image, comments):
    header = image.wcs.to_header()
    # Keywords of celestial coordinates, which these axes are not.
    for key in ("LATPOLE", "LONPOLE", "MJDREF", "RADESYS"):
        header.remove(key, ignore_missing=True)
    for i, named in enumerate(zip(image.meta["axes"], comments, strict=True), start=1):
        header[f"CNAME{i}"] = named
    return header
