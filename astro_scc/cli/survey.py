# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Measure many sources, on one machine or a Dask cluster."""

from __future__ import annotations

import json
import re
import shutil
import sys
import traceback
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import astropy.units as u
import numpy as np
from astropy.table import Column, MaskedColumn, QTable, vstack
from astropy.time import Time

from astro_scc import parallel, writing
from astro_scc.cli import inputs
from astro_scc.cli import survey_sources as sources
from astro_scc.cli.measure import write_measurement
from astro_scc.cli.program import one_line
from astro_scc.cli.survey_sources import FEATURES, SOURCES, STATE, WHOLE
from astro_scc.columns import round_to_errors
from astro_scc.flow import measure_profile
from astro_scc.kinematics.cosmology import table_in_c
from astro_scc.measurement import false_discovery_rate
from astro_scc.measurement.tables import stream_table
from astro_scc.parallel import progress
from astro_scc.products import publication
from astro_scc.products.folder import plain_meta
from astro_scc.report.answer import PROFILE_EXPLANATION
from astro_scc.report.page import write_overview
from astro_scc.scc import StackedCrossCorrelation

__all__ = ["run_survey"]

TABLE = "survey.ecsv"
#: Prefix of a folder until it is complete.
PARTIAL = ".partial-"
#: Why there is nothing to test.
NO_PATTERN = "no significant pattern here on these scales"
#: Zeros of dates at the core: of Julian years and MJD.
DATES = {u.yr: 2000 * u.yr, u.day: Time("J2000", scale="utc").mjd * u.day}
#: Columns that identify a row of the table, and their descriptions.
HEAD = {
    "source": "name of the source",
    "region": "name of the region, all without one",
    "scale_group": "name of the scale group, all without one",
    "status": "measured, empty (searched, nothing to test) or failed",
    "message": "why there is no stream",
}


def survey(args, reporter):
    """Measure the sources of a survey according to the arguments."""
    n_workers, output = inputs.workers_of(args), Path(args.output)
    reporter.resumes = True
    plan, report = sources.survey_of(args, output, reporter)

    def done(part, before):
        if part.status == "failed":
            reporter.warn(f"{part.source}: {part.message}")
        elif not sys.stderr.isatty():
            reporter.say(f"{part.title}: {'finished before' if before else 'done'}")

    with parallel.workers_of(n_workers) as workers:
        if workers is not n_workers:
            reporter.note(f"dashboard of the cluster: {workers.dashboard_link}")
        table = run_survey(
            plan, output, n_workers=workers, report=report, done=done,
            progress_bar=reporter.progress,
        )  # fmt: skip
    reporter.say(*_summary(table))
    if set(table["status"]) == {"failed"}:
        raise ValueError(f"no source could be measured; {output / TABLE} says why")
    tables = f"{output / TABLE}, {output / FEATURES}, {output / publication.FOLDER}"
    reporter.say(f"\nCatalogues: {tables}", f"Overview: {output / 'overview.html'}")
    if report:
        reporter.say(f"Reports: {output / SOURCES}")


def _summary(table):
    """Yield lines on the numbers of sources and of streams that move."""
    kinds = ("measured", "empty", "failed")
    of_kind = [set(table["source"][table["status"] == kind]) for kind in kinds]
    measured, empty, failed = of_kind
    # A source counts once, as in the overview: as the first that any of its parts is.
    once = measured, empty - measured, failed - measured - empty
    each = [f"{len(k)} {kind}" for k, kind in zip(once, kinds, strict=True) if k]
    partly = len(failed) - len(once[-1])
    also = f"; {partly} of the others failed in part" if partly else ""
    yield f"Sources: {', '.join(each)}{also}."
    p_fdr = table["p_fdr"][table["kind"] == "moving"]
    if len(p_fdr):
        small = np.sum(p_fdr <= 0.05)
        yield f"Streams that move: {len(p_fdr)}, {small} of them with p_fdr <= 0.05"
        yield PROFILE_EXPLANATION.replace("bins", "searches")


# -- the run ---------------------------------------------------------------------


def run_survey(
    survey: tuple[list[sources.Part], str], output: Path | str, *,
    n_workers: parallel.Workers = 1, report: bool = False,
    done: Callable[..., Any] | None = None, progress_bar: bool = False,
) -> QTable:  # fmt: skip
    """
    Measure all sources of a survey and write one table.

    Parameters
    ----------
    survey : tuple
        Its parts, and its text, see `~astro_scc.cli.survey_sources.read_survey`.
    output : path
        Folder of the products; on a cluster, all workers must see it.  What an
        earlier run in this folder finished is not measured again.
    n_workers : int, str or `dask.distributed.Client`, optional
        Number of processes, or a Dask scheduler, given by its address or a
        client; the unit of work is a region and scale group of a source.  The results
        do not depend on it.
    report : bool, optional
        Write a report for each region and scale group.
    done : callable, optional
        Called for each region and scale group of a source that is done, with the part
        and whether it was finished before.
    progress_bar : bool, optional

    Returns
    -------
    `~astropy.table.QTable`
        A row for each source, region, scale group and stream, with the
        columns of `~astro_scc.measurement.SCCResult.streams` and ``p_fdr``
        over all that was searched, see
        `~astro_scc.measurement.false_discovery_rate`; a region and scale group
        without a stream has a row with masked numbers.  The table is written
        to ``survey.ecsv``, that of all features to ``features.ecsv``, both for archives
        to ``publication``, and an overview to ``overview.html``.

    Raises
    ------
    OSError
        If the folder has other files, another run writes into it, or it cannot be
        written to.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.cli.survey_sources import read_survey
    >>> from astro_scc.cli.survey import run_survey
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> simulate_two_fluid(n_epochs=6, rng=1).cube.write("jet.fits")
    >>> text = '''[sources.Jet]
    ... epochs = "jet.fits"
    ... scales = [2]
    ... max_speed = "30 mas/yr"
    ... n_trials = 20
    ... '''
    >>> _ = Path("survey.toml").write_text(text)
    >>> table = run_survey(read_survey("survey.toml"), "out")
    >>> set(table["source"].tolist()), set(table["status"].tolist())
    ({'Jet'}, {'measured'})
    """
    (parts, text), output, measured = survey, Path(output).absolute(), {}
    plan = output / sources.PLAN
    if output.is_dir() and any(output.iterdir()) and not plan.is_file():
        raise OSError(f"{output}: exists and is not of a survey; choose another folder")
    writing.make_folder(output / SOURCES, output)
    # The largest first, so that no process waits for one at the end.
    order = sorted(parts, key=sources.Part.size, reverse=True)
    with (
        sources.alone(output),
        progress(len(order), "Parts", show=progress_bar) as step,
        # What terminated workers leave in this folder is deleted with it.
        writing.partial_folder(output, PARTIAL) as folder,
    ):
        with writing.replace_when_complete(plan, overwrite=True) as file:
            file.write_text(text, encoding="utf-8")
        work = ((part, output, report, folder) for part in order)
        with closing(parallel.as_done(_once, work, n_workers)) as results:
            for k, result in results:
                if isinstance(result, Exception):
                    # The worker failed, not the measurement: it died, say.
                    result = _failed(order[k], result), False
                measured[order[k]] = result[0]
                step(1)
                if done is not None:
                    done(*result)
        return _write_catalogues([measured[part] for part in parts], output, folder)


def _write_catalogues(parts, output, folder):
    """Write the streams and features of all parts, and return the streams."""
    table, features = catalogues(parts, output)
    for name, catalogue in ((TABLE, table), (FEATURES, features)):
        with writing.replace_when_complete(output / name, overwrite=True) as file:
            catalogue.write(file, format="ascii.ecsv")
    measured = table[table["status"] == "measured"]
    measured.remove_columns(["status", "message"])
    publication.write_publication({"streams": measured, "features": features}, folder)
    _replace(output / publication.FOLDER, folder / publication.FOLDER)
    write_overview(table, features, parts, output)
    return table


def _once(task):
    """Return a part with its outcome, and whether an earlier run has measured it."""
    part, output, report, folder = task
    if found := sources.finished(part, output, report):
        return found, True
    return measure_part(part, output, report=report, partial=folder), False


def _replace(folder, new):
    """Move a complete folder to its place."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    new.replace(folder)


def measure_part(part, output, report=False, partial=None):
    """
    Measure a region and scale group of a source, without raising errors.

    Its folder is replaced as a whole when everything is written.  An error becomes the
    message of the outcome; its traceback is in ``error.txt`` of the folder.

    Parameters
    ----------
    part : Part
    output : path
        Folder of the survey.
    report : bool, optional
    partial : path, optional
        Where the folder is until it is complete, by default that of ``output``.

    Returns
    -------
    Part
        With its outcome.
    """
    output, key = Path(output), part.key()
    with (
        writing.partial_folder(partial or output, PARTIAL) as folder,
        warnings.catch_warnings(record=True, action="always") as said,
    ):
        try:
            found = _measured(part, folder, output, report, said)
        except Exception as error:
            for path in folder.iterdir():
                path.unlink() if path.is_file() else shutil.rmtree(path)
            (folder / "error.txt").write_text(traceback.format_exc(), encoding="utf-8")
            found = _failed(part, error)
        state = {"key": key, "outcome": found.outcome, "warnings": _lines(said)}
        (folder / STATE).write_text(json.dumps(state, indent=1) + "\n", "utf-8")
        _replace(output / part.folder, folder)
    return found


def _measured(part, folder, output, report, said):
    """Measure a part into a folder; return it with its outcome."""
    epochs = inputs.read_epochs(part.settings, moving=True)
    cube, settings = epochs.cube, epochs.settings
    epochs = epochs._replace(published=inputs.published_of(part.compare, cube))
    first, last = cube.times.isot[[0, -1]].tolist()
    known = {"n_epochs": len(cube), "first": first, "last": last}
    scc = StackedCrossCorrelation.from_settings(settings)
    decomposed = scc.decompose(cube, region=settings.region)
    if not decomposed.select.any():
        return replace(part, status="empty", message=NO_PATTERN, **known)
    command, n_trials, seed = "measure", settings.n_trials, settings.seed
    if settings.scale_groups is None:
        result = scc.measure(decomposed, n_trials=n_trials, rng=seed)
    else:
        # One bin has all: nothing is farther along the flow than both sides together.
        command, far = "profile", sum(cube.shape[1:]) * cube.pixel_scale
        settings = settings.changed(bins=u.Quantity([0 * far, far]))
        found = measure_profile(
            scc, decomposed, settings.bins, scale_groups=settings.scale_groups,
            n_trials=n_trials, rng=seed,
        )  # fmt: skip
        (result,) = found.results[part.scale_group]
        if result is None:
            return replace(part, status="empty", message=NO_PATTERN, **known)
    write_measurement(
        result, epochs._replace(settings=settings), folder, output=output / part.folder,
        report=report, title=part.title, warnings=_lines(said), command=command,
    )  # fmt: skip
    return replace(part, status="measured", **known)


def _failed(part, error):
    """Return a part whose outcome is an error, as one line."""
    known = isinstance(error, ValueError | OSError | Warning) and str(error)
    name = "" if known else f"{type(error).__name__}: "
    return replace(part, status="failed", message=f"{name}{one_line(error)}")


def _lines(said):
    """Return the recorded warnings as lines, each once."""
    return sorted({one_line(warning.message) for warning in said})


# -- the catalogues -------------------------------------------------------------------


def catalogues(parts, output):
    """
    Return the streams and the features of all sources.

    Parameters
    ----------
    parts : sequence of Part
        With their outcomes.
    output : path
        Folder of the survey.

    Returns
    -------
    streams : `~astropy.table.QTable`
        See `run_survey`.
    features : `~astropy.table.QTable`
        The tables of features of all sources, with the columns of ``HEAD`` that
        identify them.  As a feature has no scale, those of several groups are there
        once, under the group ``all``.
    """
    empty, numbers = stream_table([]), set(range(len(parts)))
    found = _stacked(parts, output, "streams.ecsv", empty.copy())
    regions = {}
    for part in parts:
        place = part.source, part.region
        if place not in regions or regions[place].status != "measured":
            regions[place] = replace(part, scale_group=WHOLE)
    whole = [*regions.values()]
    features = _stacked(whole, output, FEATURES, QTable())
    searched = {k for k in numbers if parts[k].status != "failed"}
    nothing = dict.fromkeys(searched - set(found["part"]), empty)
    tested = false_discovery_rate({"all": found} | nothing)
    rest = np.array(sorted(numbers - set(found["part"])), dtype=int)
    table = vstack([tested["all"], QTable({"part": rest})], "outer", "silent")
    table, features = _with_head(table, parts), _with_head(features, whole)
    in_c = {parts[k].source: parts[k].settings.in_c for k in sorted(searched)}
    table.meta = {
        "versions": writing.versions(),
        "false_discovery": {"method": "bh", "n_tests": len(found) + len(nothing)},
        "speeds_in_c": {
            name: plain_meta(table_in_c(empty, **options).meta)
            for name, options in in_c.items() if options
        },
    }  # fmt: skip
    features.remove_columns(["status", "message"])
    features.meta = {key: table.meta[key] for key in ("versions", "speeds_in_c")}
    return table, features


def _stacked(parts, output, name, empty):
    """
    Return a table of all parts with their numbers.

    Most of the time to read an ECSV file is that for its header.  The rows of files
    with the same columns are therefore read together, below the header of the first.
    """
    alike, tables = {}, [empty]
    empty["part"] = np.zeros(0, dtype=int)
    for number, part in enumerate(parts):
        if part.status == "measured":
            path = Path(output, part.folder, name)
            # Numbers of digits are those of the source.
            text = re.sub(r", format: [^,}]*", "", path.read_text(encoding="utf-8"))
            lines = text.splitlines()
            start = sum(line.startswith("#") for line in lines) + 1
            kind = text.partition("\n# meta:")[0], *re.findall("__class__: .*", text)
            _, every, numbers = alike.setdefault(kind, (path, lines[:start], []))
            every += lines[start:]
            numbers += [number] * len(lines[start:])
    for path, lines, numbers in alike.values():
        table = inputs.read_table(lines, name=path)
        table.meta.clear()
        table["part"] = numbers
        tables.append(table)
    _share_units(tables)
    return round_to_errors(vstack(tables, metadata_conflicts="silent"))


def _share_units(tables):
    """
    Convert columns to the unit of most parts, in place.

    Numbers of which the unit cannot be converted, as of counts to Jy, are masked.
    """
    units = defaultdict(Counter)
    for table in tables:
        n = len(set(table["part"]))
        for name in table.colnames:
            units[name][_unit_of(table[name])] += n
    for name, found in units.items():
        if len(found) == 1:
            continue
        alike = {k: sum(found[n] for n in found if k.is_equivalent(n)) for k in found}
        # Of equals, a unit is better than none.
        unit = max(found, key=lambda k: (alike[k], found[k], k != u.one))
        others = [str(k) or "none" for k in found if not k.is_equivalent(unit)]
        having = [table for table in tables if name in table.colnames]
        in_unit = next(table for table in having if _unit_of(table[name]) == unit)
        about = in_unit[name].info.description
        if others:
            about = f"{about}; masked of sources in other units: {', '.join(others)}"
        for table in having:
            given = _unit_of(table[name])
            if not given.is_equivalent(unit):
                column = MaskedColumn(np.full(len(table), np.nan), mask=True)
                column.unit = None if unit == u.one else unit
                table[name] = column
            elif given != unit:
                zero = DATES if name == "t_ej" else {given: 0 * given, unit: 0 * unit}
                table[name] = (table[name] - zero[given]).to(unit) + zero[unit]
            table[name].info.description = about


def _unit_of(column):
    """Return the unit of a column, one if it has none."""
    return u.Unit(getattr(column, "unit", None) or u.one)


def _with_head(table, parts):
    """Return rows in the order of their parts, after the columns of ``HEAD``."""
    table = table[np.argsort(table["part"], kind="stable")]
    rows = [parts[k] for k in np.asarray(table["part"], dtype=int)]
    table.remove_column("part")
    for k, (name, text) in enumerate(HEAD.items()):
        values = np.array([getattr(row, name) for row in rows], dtype=str)
        table.add_column(Column(values, description=text), index=k, name=name)
    z = np.array([row.settings.redshift or np.nan for row in rows], dtype=float)
    column = MaskedColumn(z, mask=np.isnan(z), format="g")
    column.description = "redshift of the source, if it was given"
    table.add_column(column, index=1, name="redshift")
    return table
