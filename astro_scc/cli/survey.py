# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Measure many sources, on one machine or a Dask cluster."""

from __future__ import annotations

import json
import re
import shutil
import sys
import traceback
import warnings
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy.table import Column, MaskedColumn, QTable, vstack

from astro_scc import parallel, writing
from astro_scc.cli import survey_sources as sources
from astro_scc.cli.inputs import (
    published_of,
    read_epochs,
    read_table,
    refuse_paper,
    workers_of,
)
from astro_scc.cli.measure import write_measurement
from astro_scc.cli.program import one_line
from astro_scc.cli.survey_sources import FEATURES, SOURCES, STATE, Outcome
from astro_scc.columns import round_to_errors
from astro_scc.images.regions import refuse_pixels
from astro_scc.kinematics.cosmology import table_in_c
from astro_scc.measurement import false_discovery_rate
from astro_scc.measurement.tables import stream_table
from astro_scc.products import publication
from astro_scc.products.folder import plain_meta
from astro_scc.progress import progress
from astro_scc.report.answer import PROFILE_EXPLANATION
from astro_scc.report.page import write_overview
from astro_scc.scc import StackedCrossCorrelation

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["run_survey"]

TABLE = "survey.ecsv"
#: Prefix of a folder until it is complete.
PARTIAL = ".partial-"
#: Why there is nothing to test.
NO_PATTERN = "no significant pattern here on these scales"
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
    n_workers, output = workers_of(args), Path(args.output)
    reporter.resumes = True
    plan, report = sources.survey_of(args, output, reporter)

    def done(name, outcomes, before):
        failed = {o.message for o in outcomes if o.status == "failed"}
        for message in sorted(failed):
            reporter.warn(f"{name}: {message}")
        if not failed and not sys.stderr.isatty():
            reporter.say(f"{name}: {'finished before' if before else 'done'}")

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
    reporter.say(
        f"\nCatalogues: {output / TABLE}, {output / FEATURES}, "
        f"{output / publication.FOLDER}",
        f"Overview: {output / 'overview.html'}",
        *([f"Reports: {output / SOURCES}"] if report else []),
    )


def _summary(table):
    """Yield lines on the numbers of sources and of streams that move."""
    kinds = ("measured", "empty", "failed")
    numbers = (len(set(table["source"][table["status"] == kind])) for kind in kinds)
    each = (f"{n} {kind}" for n, kind in zip(numbers, kinds, strict=True) if n)
    yield f"Sources: {', '.join(each)}."
    p_fdr = table["p_fdr"][table["kind"] == "moving"]
    if len(p_fdr):
        small = np.sum(p_fdr <= 0.05)
        yield f"Streams that move: {len(p_fdr)}, {small} of them with p_fdr <= 0.05"
        yield PROFILE_EXPLANATION.replace("bins", "searches")


# -- the run ---------------------------------------------------------------------


def run_survey(
    survey: sources.Survey, output: Path | str, *, n_workers: int | str | Client = 1,
    report: bool = False, done: Callable[..., Any] | None = None,
    progress_bar: bool = False,
) -> QTable:  # fmt: skip
    """
    Measure all sources of a survey and write one table.

    Parameters
    ----------
    survey : Survey
        See `~astro_scc.cli.survey_sources.read_survey`.
    output : path
        Folder of the products; on a cluster, all workers must see it.  Sources
        that an earlier run in this folder finished are not measured again.
    n_workers : int, str or `dask.distributed.Client`, optional
        Number of processes, or a Dask scheduler, given by its address or a
        client; the unit of work is a source.  The results do not depend on it.
    report : bool, optional
        Write a report for each region and scale group.
    done : callable, optional
        Called for each source that is done, with its name, the list of outcomes
        of its regions and scale groups, and whether it was finished before.
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
    output, every, found = Path(output).absolute(), survey.sources, {}
    plan = output / sources.PLAN
    if output.is_dir() and any(output.iterdir()) and not plan.is_file():
        raise OSError(f"{output}: exists and is not of a survey; choose another folder")
    writing.make_folder(output / SOURCES, output)
    # The largest first, so that no process waits for one at the end.
    order = sorted(every, key=sources.Source.size, reverse=True)
    with (
        sources.alone(output),
        progress(len(every), "Sources", show=progress_bar) as step,
        # What terminated workers leave in this folder is deleted with it.
        writing.partial_folder(output, PARTIAL) as parts,
    ):
        with writing.replace_when_complete(plan, overwrite=True) as part:
            part.write_text(survey.text, encoding="utf-8")
        work = ((source, output, report, parts) for source in order)
        with closing(parallel.as_done(_once, work, n_workers)) as results:
            for k, result in results:
                if isinstance(result, Exception):
                    # The worker failed, not the measurement: it died, say.
                    result = _failed(order[k], result), False
                found[order[k].name], before = result
                step(1)
                if done is not None:
                    done(order[k].name, found[order[k].name], before)
        outcomes = [outcome for source in every for outcome in found[source.name]]
        table, features = catalogues(outcomes, every, output)
        _write_catalogues(table, features, output, parts)
        published = {source.name: source.published for source in every}
        write_overview(table, features, outcomes, output, published=published)
    return table


def _once(task):
    """Return the outcomes of a source, and whether an earlier run has measured it."""
    source, output, report, parts = task
    finished = sources.finished_outcomes(source, output, report)
    if finished is not None:
        return finished, True
    return measure_source(source, output, report=report, parts=parts), False


def _write_catalogues(table, features, output, parts):
    """Write the streams and features of all sources, also for archives."""
    for name, catalogue in ((TABLE, table), (FEATURES, features)):
        with writing.replace_when_complete(output / name, overwrite=True) as part:
            catalogue.write(part, format="ascii.ecsv")
    measured = table[table["status"] == "measured"]
    measured.remove_columns(["status", "message"])
    publication.write_publication({"streams": measured, "features": features}, parts)
    _replace(output / publication.FOLDER, parts / publication.FOLDER)


def _replace(folder, part):
    """Move a complete folder to its place."""
    shutil.rmtree(folder, ignore_errors=True)
    part.replace(folder)


# -- the catalogues -------------------------------------------------------------------


def catalogues(outcomes, every, output):
    """
    Return the streams and the features of all sources.

    Parameters
    ----------
    outcomes : sequence of Outcome
    every : sequence of Source
    output : path
        Folder of the survey.

    Returns
    -------
    streams : `~astropy.table.QTable`
        See `run_survey`.
    features : `~astropy.table.QTable`
        The tables of features of all sources, with the columns of ``HEAD`` that
        identify them.
    """
    empty, numbers = stream_table([]), set(range(len(outcomes)))
    found = _stacked(outcomes, output, "streams.ecsv", empty.copy())
    features = _stacked(outcomes, output, FEATURES, QTable())
    searched = {k for k in numbers if outcomes[k].status != "failed"}
    nothing = dict.fromkeys(searched - set(found["outcome"]), empty)
    tested = false_discovery_rate({"all": found} | nothing)
    rest = np.array(sorted(numbers - set(found["outcome"])), dtype=int)
    rest = QTable({"outcome": rest})
    table = vstack([tested["all"], rest], metadata_conflicts="silent")
    table, features = (_with_head(t, outcomes, every) for t in (table, features))
    measured = {outcomes[k].source for k in searched}
    table.meta = {
        "versions": writing.versions(),
        "false_discovery": {"method": "bh", "n_tests": len(found) + len(nothing)},
        "speeds_in_c": {
            one.name: plain_meta(table_in_c(empty, **one.settings.in_c).meta)
            for one in every
            if one.name in measured and one.settings.in_c
        },
    }
    features.remove_columns(["status", "message"])
    features.meta = {key: table.meta[key] for key in ("versions", "speeds_in_c")}
    return table, features


def _stacked(outcomes, output, name, empty):
    """
    Return a table of all parts with their numbers.

    Most of the time to read an ECSV file is that for its header.  The rows of files
    with the same columns are therefore read together, below the header of the first.
    """
    parts, tables = {}, [empty]
    empty["outcome"] = np.zeros(0, dtype=int)
    for number, outcome in enumerate(outcomes):
        if outcome.folder:
            path = Path(output, outcome.folder, name)
            # Numbers of digits are those of the source.
            text = re.sub(r", format: [^,}]*", "", path.read_text(encoding="utf-8"))
            lines = text.splitlines()
            head = [line for line in lines if line.startswith("#")]
            start, kind = len(head) + 1, text.partition("\n# meta:")[0]
            kind += "".join(re.findall("__class__: .*", text))
            _, every, numbers = parts.setdefault(kind, (path, lines[:start], []))
            every += lines[start:]
            numbers += [number] * len(lines[start:])
    for path, lines, numbers in parts.values():
        table = read_table(lines, name=path)
        table.meta.clear()
        table["outcome"] = numbers
        tables.append(table)
    return round_to_errors(vstack(tables, metadata_conflicts="silent"))


def _with_head(table, outcomes, every):
    """Return rows in the order of their parts, after the columns of ``HEAD``."""
    table = table[np.argsort(table["outcome"], kind="stable")]
    rows = [outcomes[k] for k in np.asarray(table["outcome"], dtype=int)]
    table.remove_column("outcome")
    for k, (name, text) in enumerate(HEAD.items()):
        values = np.array([getattr(row, name) for row in rows], dtype=str)
        table.add_column(Column(values, description=text), index=k, name=name)
    known = {source.name: source.settings.redshift or np.nan for source in every}
    z = np.array([known[row.source] for row in rows], dtype=float)
    column = MaskedColumn(z, mask=np.isnan(z), format="g")
    column.description = "redshift of the source, if it was given"
    table.add_column(column, index=1, name="redshift")
    return table


# -- one source ------------------------------------------------------------------


def measure_source(source, output, report=False, parts=None):
    """
    Measure a source in all its regions and scale groups, without raising errors.

    The epochs are decomposed once for each region.  The folder of the source is
    replaced as a whole when everything is written.  An error becomes the message of an
    outcome; its traceback is in ``error.txt`` of the folder.

    Parameters
    ----------
    source : Source
    output : path
        Folder of the survey.
    report : bool, optional
    parts : path, optional
        Where the folder is until it is complete, by default that of ``output``.

    Returns
    -------
    list of Outcome
        One for each region and scale group.
    """
    output, key = Path(output), source.key()
    (output / SOURCES).mkdir(exist_ok=True)
    with (
        writing.partial_folder(parts or output, PARTIAL) as part,
        warnings.catch_warnings(record=True) as said,
    ):
        warnings.simplefilter("always")
        try:
            outcomes = _measure_parts(source, output, part, report, said)
        except Exception as error:
            outcomes = _failed(source, error, part)
        state = {
            "key": key, "source": source.name, "outcomes": [*map(asdict, outcomes)],
            "warnings": _lines(said),
        }  # fmt: skip
        (part / STATE).write_text(json.dumps(state, indent=1) + "\n", encoding="utf-8")
        _replace(output / SOURCES / source.folder, part)
    return outcomes


def _measure_parts(source, output, part, report, said):
    """Measure all regions and scale groups of a source into a folder."""
    epochs = _epochs(source)
    cube, settings = epochs.cube, epochs.settings
    regions, groups = map(sources.folder_names, (source.regions, source.scale_groups))
    every, decomposed = StackedCrossCorrelation.from_settings(settings), {}
    first, last = cube.times.isot[[0, -1]].tolist()
    of_all, outcomes = said.copy(), []
    for region, group in source.parts:
        names, before = Path(regions[region], groups[group]), len(said)
        outcome = Outcome(
            source.name, region, group, "empty", NO_PATTERN, "", len(cube), first, last
        )
        try:
            if region not in decomposed:
                chosen = source.regions[region]
                decomposed[region] = every.decompose(cube, region=chosen)
            if decomposed[region].select.any():
                scales = source.scale_groups[group]
                scales = settings.scales if scales is None else scales
                chosen = settings.changed(region=source.regions[region], scales=scales)
                result = StackedCrossCorrelation.from_settings(chosen).measure(
                    decomposed[region], n_trials=chosen.n_trials, rng=chosen.seed
                )
                where = Path(SOURCES, source.folder, names)
                (part / names).mkdir(parents=True)
                titles = (source.name, region, group)
                write_measurement(
                    result, epochs._replace(settings=chosen), part / names,
                    output=output / where, report=report, archives=report,
                    title=", ".join(k for k in titles if k != sources.WHOLE),
                    warnings=_lines([*of_all, *said[before:]]),
                )  # fmt: skip
                folder = where.as_posix()
                outcome = replace(outcome, status="measured", message="", folder=folder)
        except Exception as error:
            shutil.rmtree(part / names, ignore_errors=True)
            message = _reason(error, part, f"{region}, {group}:\n")
            outcome = replace(outcome, status="failed", message=message)
        outcomes.append(outcome)
    return outcomes


def _epochs(source):
    """Return the epochs of a source with its published features."""
    epochs = read_epochs(source.settings, moving=True)
    refuse_paper(epochs.settings)
    for path in filter(None, source.regions.values()):
        refuse_pixels(path, epochs.settings.crop is not None, epochs.cube)
    return epochs._replace(published=published_of(source.compare, epochs.cube))


def _failed(source, error, folder=None):
    """Return the outcomes of a source that failed as a whole."""
    reason = _reason(error, folder)
    return [Outcome(source.name, *names, "failed", reason) for names in source.parts]


def _reason(error, folder=None, head=""):
    """Return an error as one line, with its class unless the text is for users."""
    if folder is not None:
        with open(folder / "error.txt", "a", encoding="utf-8") as file:
            file.write(f"{head}{traceback.format_exc()}\n")
    known = isinstance(error, ValueError | OSError | Warning) and str(error)
    return one_line(error) if known else f"{type(error).__name__}: {one_line(error)}"


def _lines(said):
    """Return the recorded warnings as lines, each once."""
    return sorted({one_line(warning.message) for warning in said})
