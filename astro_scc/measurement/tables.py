# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tables of a measurement: streams, spectrum, SSPs, p-values, and what to cite."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.nddata import NDData
from astropy.table import Column, QTable, Table, vstack
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.columns import build_table, cells, describe, round_to_errors, with_errors
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.images import positions
from astro_scc.images.beam import beam_fwhm, position_errors
from astro_scc.images.dates import date_labels
from astro_scc.kinematics.cosmology import cosmology_text, table_in_c, to_cosmology
from astro_scc.measurement.cautions import cautions_of
from astro_scc.units import PM_UNIT, in_speed_unit
from astro_scc.writing import versions

if TYPE_CHECKING:
    from astropy.cosmology import FLRW

#: Standard errors above the mean at the one-sided 95% limit of a normal distribution.
LIMIT = 1.645
#: Offsets of SSPs.
SKY = "east", "north"
#: How probabilities without an error are printed.
PROBABILITY = ".2g"
#: Columns of a table in a paper, in their order.
PAPER = (
    "source redshift feature stream r_min r_max kind scale n_epochs first last "
    "separation position_angle pm beta_app v_app pm_pa acc_parallel "
    "acc_perpendicular published published_pm share dispersion t_ej p_false p_global "
    "p_fdr n_features secure"
).split()


def stream_table(
    rows: Sequence[dict[str, Any]], *, meta: dict[str, Any] | None = None,
    unit: u.UnitBase = PM_UNIT,
) -> QTable:  # fmt: skip
    """
    Return streams as a table.

    Parameters
    ----------
    rows : sequence of dict
        One per stream: the columns as plain numbers, proper motions in
        mas/yr and angles in degrees.  May be empty.
    meta : dict, optional
    unit : `~astropy.units.Unit`, optional
        Unit of the proper motions of the table.

    Returns
    -------
    `~astropy.table.QTable`
        It has all columns with their units even if there is no row.

    Examples
    --------
    >>> from astro_scc.measurement.tables import stream_table
    >>> empty = stream_table([])
    >>> len(empty), empty["pm"].unit
    (0, Unit("mas / yr"))
    """
    table = in_speed_unit(build_table("streams", rows), unit)
    table.meta.update(meta or {})
    return round_to_errors(table)


class Components:
    """A measurement with a table of ``streams``."""

    @property
    def components(self: Any) -> QTable:
        """Another name of ``streams``."""
        return self.streams

    def components_in_c(
        self, *, redshift: float | str | u.Quantity | None = None,
        cosmology: FLRW | str | dict | None = None,
        distance: u.Quantity | str | None = None,
    ) -> QTable:  # fmt: skip
        """
        Return the streams with apparent speeds in units of c.

        Parameters
        ----------
        redshift : float, str or `~astropy.units.Quantity`, optional
        cosmology : `~astropy.cosmology.FLRW` or str, optional
            Cosmology for the redshift, or its name; by default
            `~astro_scc.kinematics.paper_cosmology`.
        distance : `~astropy.units.Quantity` or str, optional
            Distance of a nearby source, instead of a redshift.

        Returns
        -------
        `~astropy.table.QTable`
            ``components`` with the columns ``beta_app`` and ``beta_app_err``,
            the speed ``pm`` in units of c, see
            `~astro_scc.kinematics.apparent_speed`.  The meta holds the redshift
            and cosmology, or the distance.

        Raises
        ------
        ValueError
            If neither a redshift nor a distance is given, or if one is invalid.
        """
        return table_in_c(
            self.components, redshift=redshift, cosmology=cosmology, distance=distance
        )

    def citations(self, components: QTable | None = None) -> str:
        """
        Return what the measurement rests on as BibTeX: papers, survey, this package.

        Parameters
        ----------
        components : `~astropy.table.QTable`, optional
            The table that `components_in_c` returns: its cosmology is cited, too.

        Returns
        -------
        str
            Command-line users have it in ``citations.bib``.
        """
        table = self.components if components is None else components
        return citations_of(self.cube.meta.get("history", ()), table.meta)


class VelocityMaps(Components):
    """A measurement with maps of velocities, its ``grid``, on the axes of a frame."""

    @property
    def coefficient(self: Any) -> np.ndarray:
        """The velocity map: the coefficient of correlation at each velocity."""
        return self.grid.coefficient

    @property
    def z_score(self: Any) -> np.ndarray:
        """The velocity map in standard deviations of permuted epochs."""
        return self.grid.z_score

    def velocity_map(self: Any, which: str = "coefficient") -> NDData:
        """
        Return the velocity map as an image with velocity coordinates.

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
        if names == ("east", "north") and positions.axis_words(self.cube)[0] != "east":
            names = "lon", "lat"
        wcs = WCS(naxis=2)
        wcs.wcs.ctype = [name.upper()[:8] for name in names]
        wcs.wcs.cunit = ["mas/yr", "mas/yr"]
        wcs.wcs.crpix = [(n + 1) / 2 for n in self.grid.shape[::-1]]
        wcs.wcs.crval = [0.0, 0.0]
        wcs.wcs.cdelt = self.grid.step
        return NDData(getattr(self, which), wcs=wcs, meta={"axes": names})


def paper_table(table, *, sign="±"):
    """
    Return the main columns of a table as text, values with their errors.

    Parameters
    ----------
    table : `~astropy.table.Table`
        Streams, features or a profile.
    sign : str, optional
        What stands between a value and its error.

    Returns
    -------
    `~astropy.table.Table`
        Of the columns in `PAPER` those that the table has.  Values are rounded to
        two significant digits of their own errors; "-" is what is not known.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> from astro_scc.measurement.tables import paper_table
    >>> table = QTable({"pm": [2.1279], "pm_err": [0.072]}, units=[u.mas / u.yr] * 2)
    >>> print(paper_table(table)["pm"][0])
    2.128 ± 0.072
    """
    shown, paper = dates_as_text(table), Table()
    forms = {"p_global": PROBABILITY}
    for name, texts in cells(shown, PAPER, sign=sign, forms=forms).items():
        unit = shown[name].info.unit
        unit = None if unit == u.one else unit
        paper[name] = Column(np.array(texts, dtype=str), unit=unit)
    return paper


def dates_as_text(table):
    """
    Return a copy with dates as text, with times where epochs share a day.

    The meta knows whether they do: a table may have fewer dates, or means of dates.
    """
    table = table.copy(copy_data=False)
    names = [name for name in table.colnames if isinstance(table[name], Time)]
    if names and len(table):
        every = Time(np.concatenate([table[name].utc.isot for name in names]))
        first = table.meta.get("first_epoch")
        if first is None or "T" in first:
            texts = date_labels(every, clock=first is not None)
        else:
            texts = every.strftime("%Y-%m-%d")
        texts = np.reshape(texts, (len(names), -1))
        for name, column in zip(names, texts, strict=True):
            about = table[name].info.description
            table.replace_column(name, Column(column, description=about))
    return table


def stream_row(result, k):
    """Return the columns of stream k, counted from 0, as plain numbers."""
    search, stream = result.search, result.search.streams[k]
    test = search.test
    axes = result.frame, result.position_angle
    row = velocity_columns(stream.velocity, stream.covariance, *axes)
    by_alignment = velocity_columns(stream.velocity, stream.alignment, *axes)
    p, n = stream.p_global, result.meta["n_trials"]
    # All orders of a few epochs leave nothing to chance.
    p_err = np.sqrt(p * (1 - p) / n) if test.p_smallest <= 1 / n else 0.0
    limit = row["pm"] + LIMIT * row["pm_err"]
    # A limit that one of its features exceeds is none, unless it is of all together.
    together = stream.kind == "not confirmed" and np.isnan(stream.p_global)
    slow = len(stream.members) and stream.fastest <= limit
    limited = together or (stream.kind != "moving" and slow)
    same = "kind share dispersion dispersion_err p_local p_global p_distinct".split()
    row |= {name: getattr(stream, name) for name in same}
    row |= with_errors(pm_features=stream.features, pm_spectrum=stream.spectrum) | {
        "stream": k + 1, "pm_limit": limit if limited else np.nan,
        "pm_err_alignment": by_alignment["pm_err"] or np.nan, "pm_from": stream.source,
        "p_global_err": p_err, "p_smallest": test.p_smallest,
        "n_features": len(stream.members), "pm_min": stream.slowest,
        "pm_max": stream.fastest,
    }  # fmt: skip
    # ECSV reads empty text as a missing value.
    return row | {"caution": "; ".join(cautions_of(result, k, row)) or "-"}


def spectrum_table(result):
    """Return the velocity spectrum as a table, see `SCCResult.spectrum`."""
    search, test = result.search, result.search.test
    share = search.spectrum / (search.spectrum.sum() or 1.0)
    direction, _ = test.best
    order = np.argsort(test.speed)
    tested = test.speed[order] * search.beam

    def at(values):
        inside = np.interp(search.speed, tested, values[direction][order])
        outside = (search.speed < tested[0]) | (search.speed > tested[-1])
        return np.where(outside | (search.speed == 0), np.nan, inside)

    table = build_table(
        "spectrum", pm_parallel=search.speed * PM_UNIT, share=share, z=at(test.z),
        p_global=at(test.p_speed),
    )  # fmt: skip
    table.meta.update(result.meta | result.cube.facts)
    return in_speed_unit(table, result.cube.speed_unit)


def velocity_columns(velocity, covariance, frame, position_angle):
    """
    Return the components of a velocity, on the sky and relative to the jet.

    Each has an error, which is NaN if the data do not determine it.
    """
    known = np.all(np.isfinite(covariance))
    covariance = covariance if known else np.full((2, 2), np.nan)
    if frame.uniform:
        to_sky = np.linalg.inv(frame.matrix(0.0, 0.0))
        sky, sky_covariance = to_sky @ velocity, to_sky @ covariance @ to_sky.T
        pa = position_angle.to_value(u.rad)
        jet = np.array([[np.sin(pa), np.cos(pa)], [np.cos(pa), -np.sin(pa)]])
        along, along_covariance = jet @ sky, jet @ sky_covariance @ jet.T
    else:
        # The axes of radial and curved frames have no single direction on the sky.
        sky, sky_covariance = np.full(2, np.nan), np.full((2, 2), np.nan)
        along, along_covariance = velocity, covariance
    speed = float(np.hypot(*along))
    unit = along / speed if speed > 0 else np.array([1.0, 0.0])
    across = np.array([-unit[1], unit[0]])
    names = ("pm_ra_cosdec", "pm_dec", "pm_parallel", "pm_transverse", "pm")
    variances = [*np.diag(sky_covariance), *np.diag(along_covariance)]
    variances += [axis @ along_covariance @ axis for axis in (unit, across)]
    # Rounding can make a variance negative that should be zero.
    *errors, across_err = np.sqrt(np.maximum(variances, 0.0)).tolist()
    pa_err = np.pi if known and frame.uniform else np.nan
    if speed > 0:
        # A direction cannot be wrong by more than half a turn.
        pa_err = np.minimum(across_err, pa_err * speed) / speed
    values = zip(map(float, (*sky, *along, speed)), errors, strict=True)
    pa = float(np.degrees(np.arctan2(*sky)) % 360), float(np.degrees(pa_err))
    return with_errors(**dict(zip(names, values, strict=True)), pm_pa=pa)


def ssp_table(decomposed):
    """
    Return the catalogue of the SSPs of `~astro_scc.patterns.DecomposedEpochs`.

    ``in_region`` says which were used.  ``east`` and ``north`` are offsets of the
    maximum from the reference pixel, with thermal errors ``beam / (sqrt(2) SNR)``; in
    frames without right ascension they have other names.
    """
    ssps, cube = decomposed.ssps, decomposed.cube
    fwhm = beam_fwhm(cube, ssps.epoch, ssps.scale, np.eye(2))
    error = position_errors(ssps.snr, fwhm.reshape(-1, 2), 0.0)
    size = np.array([scale_size(s) for s in ssps.scale], dtype=float)
    names, date = ("epoch", "scale", "snr", "n_pixels"), cube.times[ssps.epoch]
    columns = {"ssp": np.arange(len(ssps)), "date": Time(date, format="isot")}
    columns |= {name: getattr(ssps, name) for name in names}
    columns |= {"scale_size": size * cube.pixel_scale, "in_region": decomposed.select}
    columns |= {"x": ssps.x * u.pix, "y": ssps.y * u.pix}
    columns |= {"peak": ssps.peak * cube.unit, "coefficient_sum": ssps.flux * cube.unit}
    for end, centroid in (("", False), ("_centroid", True)):
        offsets = positions.ssp_offsets(ssps, cube, centroid=centroid)
        columns |= {f"{n}{end}": o * u.mas for n, o in zip(SKY, offsets, strict=True)}
    columns |= {f"{n}_err": e * u.mas for n, e in zip(SKY, error.T, strict=True)}
    table = build_table("ssps", **columns)
    return positions.name_by_frame(round_to_errors(table), cube)


def stack_tables(tables, meta):
    """Return one table of the rows of all, with a meta of its own."""
    filled = [table for table in tables if len(table)] or tables[:1]
    stacked = vstack(filled, metadata_conflicts="silent")
    stacked.meta.clear()
    stacked.meta.update(meta)
    return round_to_errors(stacked)


def false_discovery_rate(tables: Sequence[QTable] | Mapping[Any, QTable]) -> Any:
    """
    Adjust the p-values of streams for the number of regions searched.

    Let :math:`p_{(1)} \\le \\ldots \\le p_{(m)}` be the ``p_global`` of the m
    velocities that were tested in all regions, bins or groups of scales
    together.  The k-th smallest becomes

    .. math:: q_{(k)} = \\min_{l \\ge k}\\ \\min(1,\\ m\\, p_{(l)} / l)

    (Benjamini & Hochberg 1995, J. R. Stat. Soc. B 57, 289).  Of the streams with
    ``p_fdr <= q``, a share of at most q is expected to be false.  It holds for
    independent and for positively dependent tests, for example of regions that share
    features or of scales that see the same feature.

    Parameters
    ----------
    tables : sequence of `~astropy.table.QTable`, or a mapping to them
        Streams, see `SCCResult.streams`: one table for each region,
        bin or group of scales, *those without streams included*.

    Returns
    -------
    list or dict of `~astropy.table.QTable`
        Copies with the column ``p_fdr`` after ``p_global_err``; their meta
        holds the method and the number of tests.

    Raises
    ------
    TypeError
        If ``tables`` is one table.
    ValueError
        If a table has no column ``p_global``, or a value in it is no probability.

    Notes
    -----
    ``p_global`` is adjusted because it already accounts for all velocities at
    which one region was searched; ``p_local`` does not.  Every velocity that
    was tested counts, including those "not significant", and a table without
    any counts as one test with a p-value of 1.  If only significant velocities
    counted, a single false alarm among twenty regions would not be corrected
    for the other nineteen.  "stationary" streams are not tested and do not
    count.  ``kind`` is not changed: a stream is a discovery of the whole
    search if it is "moving" *and* its ``p_fdr`` is small.

    With n trials, the ``p_fdr`` of a single small p-value cannot be below
    m / (n + 1).

    Examples
    --------
    >>> from astropy.table import QTable
    >>> from astro_scc.measurement import false_discovery_rate
    >>> kinds = ["moving", "not significant"]
    >>> inner = QTable({"kind": kinds, "p_global": [0.004, 0.3]})
    >>> outer = QTable({"kind": ["moving"], "p_global": [0.04]})
    >>> inner, outer = false_discovery_rate([inner, outer])
    >>> inner["p_fdr"].tolist(), outer["p_fdr"].tolist()
    ([0.012, 0.3], [0.06])
    """
    from scipy.stats import false_discovery_control

    if isinstance(tables, Table):
        raise TypeError("tables must be a sequence of tables, got one: give [table]")
    is_mapping = hasattr(tables, "items")
    tables = dict(tables.items() if is_mapping else enumerate(tables))
    tested, p = {}, []
    for name, table in tables.items():
        if "p_global" not in table.colnames:
            raise ValueError(f"table {name!r} has no column p_global: give streams")
        values = np.array(table["p_global"], dtype=float)
        kinds = table["kind"] if "kind" in table.colnames else [""] * len(table)
        kinds = np.array(kinds, dtype=str)
        # What stands still, alone or on average, is not tested.
        together = (kinds == "not confirmed") & np.isnan(values)
        tested[name] = values, (kinds != "stationary") & ~together
        # A region where nothing could be tested was searched all the same.
        p.append(values[tested[name][1]] if tested[name][1].any() else [1.0])
    adjusted = false_discovery_control(np.concatenate(p)) if p else []
    meta = {"false_discovery": {"method": "bh", "n_tests": len(adjusted)}}
    parts = np.split(adjusted, np.cumsum([len(part) for part in p])[:-1])
    done = {}
    for (name, (values, use)), part in zip(tested.items(), parts, strict=False):
        done[name] = table = tables[name].copy()
        values[use] = part[: use.sum()]
        if "p_fdr" in table.colnames:
            table.remove_column("p_fdr")
        before = "p_global_err" if "p_global_err" in table.colnames else "p_global"
        index = table.colnames.index(before) + 1
        table.add_column(values, index, name="p_fdr")
        describe(table, "added").meta.update(meta)
    return done if is_mapping else list(done.values())


# -- what to cite ------------------------------------------------------------------

#: What names the MOJAVE survey and its table of features in a history.
MOJAVE = re.compile(r"MOJAVE|apjac230ft4|J/ApJ/923/30")


def citations_of(history, meta):
    """
    Return what a measurement rests on as BibTeX.

    Parameters
    ----------
    history : sequence of str
        What was done to the images, and what they were compared with.
    meta : dict
        Of a table: its ``cosmology`` is cited.

    Returns
    -------
    str
        Entries, and comments on what has none.

    Examples
    --------
    >>> from astro_scc.measurement.tables import citations_of
    >>> text = citations_of(["components from MOJAVE"], {"cosmology": "Planck18"})
    >>> print("; ".join(line for line in text.splitlines() if line.startswith("@")))
    @article{mertens2016,; @article{mertens2015,; @software{astro_scc,;
    @article{lister2021,; @misc{cosmology,
    """
    text = resources.files("astro_scc.measurement").joinpath("citations.bib")
    version = versions()["astro_scc"]
    entries = text.read_text(encoding="utf-8").replace("VERSION", version)
    *parts, survey = entries.strip().split("\n\n")
    if any(MOJAVE.search(line) for line in history):
        parts.append(survey)
    else:
        parts.append("% Cite the survey or the observers of the images, too.")
    if "cosmology" in meta:
        parts.append(_cosmology(to_cosmology(meta["cosmology"])))
    return "\n\n".join(parts) + "\n"


def _cosmology(cosmology):
    """Return the source of a cosmology as an entry, or the cosmology as a comment."""
    from astropy.cosmology import available

    # Tables keep the parameters and the name, which astropy knows with its source.
    known = to_cosmology(cosmology.name) if cosmology.name in available else cosmology
    if source := known.meta.get("reference"):
        note = re.sub(r"([&%#_])", r"\\\1", source)
        return f"@misc{{cosmology,\n  note = {{{cosmology.name}: {note}}}\n}}"
    whose = ", as in mertens2016" if cosmology == to_cosmology() else ""
    return f"% Cosmology: {cosmology_text(cosmology)}{whose}."
