# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Measure many sources, on one machine or a Dask cluster."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import closing, contextmanager
from dataclasses import asdict
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy.table import Column, MaskedColumn, QTable, vstack

from astro_scc import parallel, writing
from astro_scc.cli import survey_sources as sources
from astro_scc.cli.inputs import read_epochs, read_table, workers_of
from astro_scc.cli.measure import write_measurement
from astro_scc.cli.program import one_line
from astro_scc.cli.survey_sources import FEATURES, SOURCES, STATE, Outcome
from astro_scc.columns import round_to_errors, table_lines
from astro_scc.images.grid import refuse_pixels
from astro_scc.kinematics.cosmology import cosmology_text, table_in_c
from astro_scc.measurement import false_discovery_rate
from astro_scc.measurement.tables import stream_table
from astro_scc.products.folder import plain_meta
from astro_scc.products.publication import (
    FOLDER,
    published_positions,
    write_publication,
)
from astro_scc.progress import progress
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
#: Options on images that are restored from components.
RESTORING = "beam", "pixel", "noise", "seed", "after", "before", "source", "origin"
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
    of_file = Path(args.survey).suffix.lower() == ".toml"
    if of_file or Path(args.survey).is_dir():
        for name in RESTORING:
            if getattr(args, name) is not None:
                raise ValueError(
                    f"--{name} is for a table of components, not for {args.survey}; "
                    "settings are written into survey.toml"
                )
    redshifts = sources.read_redshifts(args.redshifts) if args.redshifts else {}
    path = args.survey if of_file else sources.write_survey(args, output, reporter)
    plan = sources.read_survey(path, redshifts)
    report = of_file if args.report is None else args.report
    if unknown := redshifts.keys() - {source.name for source in plan.sources}:
        some = "source is" if len(unknown) == 1 else "sources are"
        reporter.note(f"{args.redshifts}: {len(unknown)} {some} not of the survey")

    def done(name, outcomes, before):
        failed = {o.message for o in outcomes if o.status == "failed"}
        for message in sorted(failed):
            reporter.warn(f"{name}: {message}")
        if not failed and not sys.stderr.isatty():
            reporter.say(f"{name}: {'finished before' if before else 'done'}")

    with parallel.workers_of(n_workers) as workers:
        if workers is not n_workers:
            reporter.note(f"dashboard of the cluster: {workers.dashboard_link}")
        how = {"n_workers": workers, "progress_bar": reporter.progress}
        table = run_survey(plan, output, report=report, done=done, **how)
    reporter.say(*_summary(table))
    if set(table["status"]) == {"failed"}:
        raise ValueError(f"no source could be measured; {output / TABLE} says why")
    reporter.say(
        f"\nCatalogues: {output / TABLE}, {output / FEATURES}, {output / FOLDER}",
        f"Overview: {output / 'overview.html'}",
        *([f"Reports: {output / SOURCES}"] if report else []),
    )


def _summary(table):
    """Yield lines on the numbers of sources and of streams that move."""
    rows = []
    for status in ("measured", "empty", "failed"):
        own = table["source"][table["status"] == status]
        counts = {"sources": str(len(set(own))), "rows": str(len(own))}
        rows.append({"status": status} | counts)
    yield from table_lines(rows)
    measured = table[table["status"] == "measured"]
    if len(measured):
        p_fdr = measured["p_fdr"][measured["kind"] == "moving"]
        small = sum(p <= 0.05 for p in p_fdr)
        yield f"moving: {len(p_fdr)}, {small} of them with p_fdr <= 0.05"
    how = (
        cosmology_text(meta["cosmology"]) if "cosmology" in meta else "distances"
        for meta in table.meta["speeds_in_c"].values()
    )
    for text, n in Counter(how).items():
        yield f"speeds in c: {text}, sources {n}"


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
        If the folder has other files, or it cannot be written to.

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
    output = Path(output).absolute()
    plan = output / sources.PLAN
    if output.is_dir() and any(output.iterdir()) and not plan.is_file():
        raise OSError(f"{output}: exists and is not of a survey; choose another folder")
    writing.make_folder(output / SOURCES, output)
    with writing.replace_when_complete(plan, overwrite=True) as part:
        part.write_text(survey.text, encoding="utf-8")
    found = _outcomes(survey.sources, output, report, n_workers, done, progress_bar)
    table, features = catalogues(found, survey.sources, output)
    _write_catalogues(table, features, output)
    published = {source.name: source.published for source in survey.sources}
    write_overview(table, features, found, output, published=published)
    return table


def _write_catalogues(table, features, output):
    """Write the streams and features of all sources, also for archives."""
    for name, own in ((TABLE, table), (FEATURES, features)):
        with writing.replace_when_complete(output / name, overwrite=True) as part:
            own.write(part, format="ascii.ecsv")
    measured = table[table["status"] == "measured"]
    measured.remove_columns(["status", "message"])
    with _new_folder(output / FOLDER, output) as part:
        write_publication({"streams": measured, "features": features}, part.parent)


@contextmanager
def _new_folder(path, parts):
    """Provide a folder that takes the place of another one when it is complete."""
    with writing.partial_folder(parts, PARTIAL) as parent:
        part = parent / path.name
        part.mkdir()
        yield part
        if path.exists():
            os.replace(path, parent / "old")
        os.replace(part, path)


def _outcomes(every, output, report, n_workers, done, progress_bar):
    """Return the outcomes of the sources, in their order."""
    found = [sources.finished_outcomes(source, output, report) for source in every]
    left = [k for k, outcomes in enumerate(found) if outcomes is None]
    before = [(k, own) for k, own in enumerate(found) if own is not None]
    # The largest first, so that no process waits for one at the end.
    left.sort(key=lambda k: -every[k].size())
    with (
        progress(len(every), "Sources", show=progress_bar) as step,
        # What terminated workers leave in this folder is deleted with it.
        writing.partial_folder(output, PARTIAL) as parts,
        closing(
            parallel.as_done(
                partial(measure_source, output=output, report=report, parts=parts),
                (every[k] for k in left),
                n_workers,
            )
        ) as new,
    ):
        for k, outcomes in chain(before, ((left[i], own) for i, own in new)):
            if isinstance(outcomes, Exception):
                # The worker failed, not the measurement: it died, or its disk is full.
                outcomes = _failed(every[k], outcomes)
            found[k] = outcomes
            step(1)
            if done is not None:
                done(every[k].name, outcomes, k not in left)
    return [outcome for outcomes in found for outcome in outcomes]


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
    rest = sorted(numbers - set(found["outcome"]))
    rest = QTable({"outcome": np.array(rest, dtype=int)})
    table = vstack([tested["all"], rest], metadata_conflicts="silent")
    redshifts = {source.name: source.settings.redshift for source in every}
    table = _with_head(table, outcomes, redshifts)
    measured = {outcomes[k].source for k in searched}
    in_c = {own.name: own.settings.in_c for own in every if own.name in measured}
    table.meta = {
        "versions": writing.versions(),
        "false_discovery": {"method": "bh", "n_tests": len(found) + len(nothing)},
        "speeds_in_c": {
            name: plain_meta(table_in_c(empty, **how).meta)
            for name, how in in_c.items()
            if how
        },
    }
    features = _with_head(features, outcomes, redshifts)
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
            columns, _, rest = path.read_text(encoding="utf-8").partition("\n# meta:")
            # Numbers of digits are those of the source.
            columns = re.sub(r", format: [^,}]*", "", columns)
            lines = f"{columns}\n# meta:{rest}".splitlines()
            head = [line for line in lines if line.startswith("#")]
            names, rows = lines[len(head) :][:1], lines[len(head) + 1 :]
            kind = columns, *re.findall("__class__: .*", rest)
            _, lines, numbers = parts.setdefault(kind, (path, head + names, []))
            lines += rows
            numbers += [number] * len(rows)
    for path, lines, numbers in parts.values():
        table = read_table(lines, name=path)
        table.meta.clear()
        table["outcome"] = numbers
        tables.append(table)
    return round_to_errors(vstack(tables, metadata_conflicts="silent"))


def _with_head(table, outcomes, redshifts):
    """Return rows in the order of their parts, after the columns of ``HEAD``."""
    table = table[np.argsort(table["outcome"], kind="stable")]
    number = np.asarray(table["outcome"], dtype=int)
    table.remove_column("outcome")
    for k, (name, text) in enumerate(HEAD.items()):
        values = np.array([getattr(own, name) for own in outcomes], dtype=str)[number]
        table.add_column(Column(values, description=text), index=k, name=name)
    z = np.array([redshifts[own.source] or np.nan for own in outcomes])[number]
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
        _new_folder(output / SOURCES / source.folder, parts or output) as part,
        warnings.catch_warnings(record=True) as said,
    ):
        warnings.simplefilter("always")
        try:
            outcomes = _measure(source, output, part, report, said)
        except Exception as error:
            _note_error(part)
            outcomes = _failed(source, error)
        state = {
            "key": key,
            "source": source.name,
            "outcomes": [asdict(outcome) for outcome in outcomes],
            "warnings": _lines(said),
        }
        (part / STATE).write_text(json.dumps(state, indent=1) + "\n", encoding="utf-8")
    return outcomes


def _measure(source, output, part, report, said):
    """Measure the parts of a source."""
    cube, settings, left_out, *_ = read_epochs(source.settings, moving=True)
    if settings.method != "spectrum":
        raise ValueError(
            f"method is {settings.method!r}, which astro-scc measure has: leave it out"
        )
    published = source.compare and published_positions(source.compare, cube)
    for path in filter(None, source.regions.values()):
        refuse_pixels(path, settings.crop is not None, cube)
    masks = {path: path and cube.region_mask(path) for path in source.regions.values()}
    every, decomposed = StackedCrossCorrelation.from_settings(settings), {}
    regions, groups = map(sources.folder_names, (source.regions, source.scale_groups))
    of_all, outcomes = len(said), []
    first, last = cube.times.isot[[0, -1]].tolist()
    seen = {"n_epochs": len(cube), "first": first, "last": last}
    for region, group in source.parts:
        outcome = partial(Outcome, source.name, region, group, **seen)
        where = Path(SOURCES, source.folder, regions[region], groups[group])
        folder = part / regions[region] / groups[group]
        folder.mkdir(parents=True)
        names = (name for name in (region, group) if name != sources.WHOLE)
        page = {"title": ", ".join([source.name, *names]), "left_out": left_out}
        page |= {"report": report, "archives": report, "published": published}
        before, scales = len(said), source.scale_groups[group]
        scales = settings.scales if scales is None else scales
        own = settings.changed(region=source.regions[region], scales=scales)
        try:
            if region not in decomposed:
                decomposed[region] = every.decompose(cube, region=masks[own.region])
            if not decomposed[region].select.any():
                shutil.rmtree(folder)
                outcomes.append(outcome("empty", NO_PATTERN))
                continue
            scc = StackedCrossCorrelation.from_settings(own)
            result = scc.measure(
                decomposed[region], n_trials=own.n_trials, rng=own.seed
            )
            page["warnings"] = _lines([*said[:of_all], *said[before:]])
            page["output"] = output / where
            write_measurement(result, own, folder, **page)
        except Exception as error:
            shutil.rmtree(folder)
            _note_error(part, f"{region}, {group}:\n")
            outcomes.append(outcome("failed", _reason(error)))
            continue
        outcomes.append(outcome("measured", folder=where.as_posix()))
    return outcomes


def _failed(source, error):
    """Return the outcomes of a source that failed as a whole."""
    reason = _reason(error)
    return [Outcome(source.name, *names, "failed", reason) for names in source.parts]


def _reason(error):
    """Return an error as one line, with its class unless the text is for users."""
    known = isinstance(error, ValueError | OSError | Warning) and str(error)
    return one_line(error) if known else f"{type(error).__name__}: {one_line(error)}"


def _note_error(folder, head=""):
    with open(folder / "error.txt", "a", encoding="utf-8") as file:
        file.write(f"{head}{traceback.format_exc()}\n")


def _lines(said):
    """Return the recorded warnings as lines, each once."""
    return sorted({one_line(warning.message) for warning in said})
