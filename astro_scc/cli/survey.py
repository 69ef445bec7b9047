# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Measure many sources, on one machine or a Dask cluster."""

from __future__ import annotations

import json
import os
import shutil
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from astro_scc import parallel
from astro_scc.cli import survey_sources as sources
from astro_scc.cli.inputs import read_epochs, workers_of
from astro_scc.cli.measure import WORK, write_measurement
from astro_scc.cli.program import one_line
from astro_scc.cli.survey_table import survey_of
from astro_scc.columns import table_lines
from astro_scc.images.grid import refuse_pixels
from astro_scc.kinematics.cosmology import cosmology_text
from astro_scc.matching import select_ssps
from astro_scc.products.publication import FOLDER, write_publication
from astro_scc.products.published import published_positions
from astro_scc.progress import progress
from astro_scc.report.page import write_overview
from astro_scc.scc import StackedCrossCorrelation
from astro_scc.writing import hold, partial_folder, remove_left, replace_when_complete

if TYPE_CHECKING:
    from astropy.table import QTable
    from distributed import Client

__all__ = ["run_survey"]

SOURCES, STATE, TABLE, PLAN = "sources", "source.json", "survey.ecsv", "survey.toml"
FEATURES = "features.ecsv"
#: Prefix of the folder of a source until it is complete.
PARTIAL = "partial-"
#: Why there is nothing to test.
NO_MATCH = "no match that could be tested"
#: Options on images that are restored from components.
RESTORING = "beam", "pixel", "noise", "seed", "after", "before", "source", "origin"
NO_PATTERN = "no significant pattern here on these scales"


@dataclass(frozen=True)
class Outcome:
    """Outcome of a region and scale group; ``folder`` has its products."""

    source: str
    region: str
    scale_group: str
    status: str
    message: str = ""
    folder: str = ""
    n_epochs: int = 0
    first: str = ""
    last: str = ""


def _refuse_restoring(args):
    """Refuse options on images that are restored, where there are images."""
    for name in RESTORING:
        if getattr(args, name) is not None:
            raise ValueError(
                f"--{name} is for a table of components, not for {args.survey}; "
                "settings are written into survey.toml"
            )


def run(args, reporter):
    """Run a survey according to the arguments."""
    n_workers, output = workers_of(args), Path(args.output)
    reporter.resumes = True
    if Path(args.survey).suffix.lower() == ".toml":
        if args.redshifts:
            raise ValueError("--redshifts is not for a .toml file; write them to it")
        _refuse_restoring(args)
        survey, report = sources.read_survey(args.survey), args.report is not False
    else:
        report = bool(args.report)
        if Path(args.survey).is_dir():
            _refuse_restoring(args)
        survey = survey_of(args, output, reporter)

    def done(name, outcomes, before):
        name = name if name.isprintable() else ascii(name)
        failed = {o.message for o in outcomes if o.status == "failed"}
        for message in sorted(failed):
            reporter.warn(f"{name}: {message}")
        if not failed and not sys.stderr.isatty():
            reporter.say(f"{name}: {'finished before' if before else 'done'}")

    with ExitStack() as stack:
        if not isinstance(n_workers, int):
            client = parallel.open_client(n_workers)
            if n_workers == "local":
                client = parallel.open_local(args.workers or 1)
            n_workers = stack.enter_context(client)
            reporter.note(f"dashboard of the cluster: {n_workers.dashboard_link}")
        table = run_survey(
            survey,
            output,
            n_workers=n_workers,
            report=report,
            done=done,
            progress_bar=reporter.progress,
        )
    reporter.say(*_summary(table))
    if set(table["status"]) == {"failed"}:
        raise ValueError(f"no source could be measured; {output / TABLE} says why")
    reporter.say(
        f"\nCatalogues: {output / TABLE}, {output / FEATURES}, {output / FOLDER}",
        f"Overview: {output / 'overview.html'}",
        *([f"Reports: {output / SOURCES}"] if report else []),
    )


def _summary(table):
    """Yield lines on the numbers of sources and of significant components."""
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
        A row for each source, region, scale group and component, with the
        columns of `~astro_scc.measurement.SCCResult.components` and ``p_fdr``
        over all that was searched, see
        `~astro_scc.measurement.false_discovery_rate`; a region and scale group
        without a component has a row with masked numbers.  The table is written
        to ``survey.ecsv``, that of all features to ``features.ecsv``, both for archives
        to ``publication``, and an overview to ``overview.html``.

    Raises
    ------
    OSError
        If the folder has other files, another run writes there, or it cannot
        be written to.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.cli.survey_sources import read_survey
    >>> from astro_scc.cli.survey import run_survey
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> simulate_two_fluid(n_epochs=5, rng=1).cube.write("jet.fits")
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
    work = output / WORK
    if output.is_dir() and any(output.iterdir()) and not (output / PLAN).is_file():
        raise OSError(f"{output}: exists and is not of a survey; choose another folder")
    try:
        (output / SOURCES).mkdir(parents=True, exist_ok=True)
        work.mkdir(exist_ok=True)
    except OSError as error:
        raise OSError(f"{output}: cannot be made or used: {error.strerror}") from None
    try:
        with hold(work):
            with replace_when_complete(output / PLAN, overwrite=True) as part:
                part.write_text(survey.text, encoding="utf-8")
            try:
                found = _outcomes(
                    survey.sources, output, report, n_workers, done, progress_bar
                )
            finally:
                # Delete what terminated workers left.
                remove_left(work, PARTIAL)
            table, features = sources.catalogues(found, survey.sources, output)
            _write_catalogues(table, features, output)
            published = {source.name: source.published for source in survey.sources}
            write_overview(table, features, found, output, published=published)
    except BlockingIOError:
        raise OSError(
            f"{output}: another run measures a survey here; wait for it, or choose "
            "another folder"
        ) from None
    return table


def _write_catalogues(table, features, output):
    """Write the components and features of all sources, also for archives."""
    for name, own in ((TABLE, table), (FEATURES, features)):
        with replace_when_complete(output / name, overwrite=True) as part:
            own.write(part, format="ascii.ecsv")
    measured = table[table["status"] == "measured"]
    measured.remove_columns(["status", "message"])
    with partial_folder(output / WORK, PARTIAL) as part:
        write_publication({"components": measured, "features": features}, part)
        if (output / FOLDER).exists():
            os.replace(output / FOLDER, part / "old")
        os.replace(part / FOLDER, output / FOLDER)


def _outcomes(every, output, report, n_workers, done, progress_bar):
    """Return the outcomes of the sources, in their order."""
    found = [finished_outcomes(source, output, report) for source in every]
    left = [k for k, outcomes in enumerate(found) if outcomes is None]
    before = [pair for pair in enumerate(found) if pair[0] not in left]
    # The largest first, so that no process waits for one at the end.
    left.sort(key=lambda k: -every[k].size())
    measure = partial(measure_source, output=output, report=report)
    with (
        parallel.workers_of(n_workers) as workers,
        progress(len(every), "Sources", show=progress_bar) as step,
    ):
        new = parallel.as_done(measure, (every[k] for k in left), workers)
        for k, outcomes in chain(before, ((left[i], own) for i, own in new)):
            if isinstance(outcomes, Exception):
                # The worker failed, not the measurement: it died, or its disk is full.
                outcomes = _failed(every[k], outcomes)
            found[k] = outcomes
            step(1)
            if done is not None:
                done(every[k].name, outcomes, k not in left)
    return [outcome for outcomes in found for outcome in outcomes]


def finished_outcomes(source, output, report):
    """Return the outcomes of a source whose products are complete, else None."""
    path = Path(output, SOURCES, source.folder, STATE)
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
        if state["key"] != source.key():
            return None
        found = [Outcome(**outcome) for outcome in state["outcomes"]]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    needed = ["components.ecsv", FEATURES, "report.html"][: 2 + report]
    there = all(
        outcome.status != "failed" and Path(output, outcome.folder, name).is_file()
        for outcome in found
        for name in needed
    )
    return found if there else None


# -- one source ------------------------------------------------------------------


def measure_source(source, output, report=False):
    """
    Measure a source in all its regions and scale groups, without raising errors.

    SSPs are correlated once, in all regions and on all scales together; each region and
    scale group is a stack of its own.  The folder of the source is replaced as a whole
    when everything is written.  An error becomes the message of an outcome; its
    traceback is in ``error.txt`` of the folder.

    Parameters
    ----------
    source : Source
    output : path
        Folder of the survey.
    report : bool, optional

    Returns
    -------
    list of Outcome
        One for each region and scale group.
    """
    output, key = Path(output), source.key()
    (output / WORK).mkdir(exist_ok=True)
    with (
        partial_folder(output / WORK, PARTIAL) as part,
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
        final = output / SOURCES / source.folder
        final.parent.mkdir(exist_ok=True)
        with partial_folder(output / WORK, PARTIAL) as old:
            if final.exists():
                os.replace(final, old / "old")
            os.replace(part, final)
    return outcomes


def _measure(source, output, part, report, said):
    """Match a source and measure its parts."""
    cube, settings, left_out, *_ = read_epochs(source.settings)
    published = source.compare and published_positions(source.compare, cube)
    masks, failed, matched = {}, {}, None
    for name, path in source.regions.items():
        try:
            if path is not None and settings.crop is not None:
                refuse_pixels(path)
            masks[name] = None if path is None else cube.region_mask(path)
        except (ValueError, OSError) as error:
            failed[name] = _reason(error)
    if masks:
        whole = None in source.regions.values()
        inside = None if whole else np.any(list(masks.values()), axis=0)
        # One part takes no longer to match again than to be read.
        several = len(source.parts) > 1
        cache = output / WORK / f"{source.folder}.fits" if several else None
        scc = StackedCrossCorrelation.from_settings(settings)
        matched = scc.match(cube, region=inside, cache=cache)
    regions, groups = map(sources.folder_names, (source.regions, source.scale_groups))
    of_all, outcomes = len(said), []
    first, last = cube.times.isot[[0, -1]].tolist()
    seen = {"n_epochs": len(cube), "first": first, "last": last}
    for region, group in source.parts:
        outcome = partial(Outcome, source.name, region, group, **seen)
        if region in failed:
            outcomes.append(outcome("failed", failed[region]))
            continue
        where = Path(SOURCES, source.folder, regions[region], groups[group])
        folder = part / regions[region] / groups[group]
        folder.mkdir(parents=True)
        names = (name for name in (region, group) if name != sources.WHOLE)
        title = [source.name, *names]
        page = {"title": ", ".join(title), "report": report, "left_out": left_out}
        page |= {"archives": report, "published": published}
        own, before = {"region": source.regions[region]}, len(said)
        if (scales := source.scale_groups[group]) is not None:
            own["scales"] = scales
        own = replace(settings, **own)
        try:
            scc = StackedCrossCorrelation.from_settings(own)
            of_part = select_ssps(matched, region=masks[region], scales=scc.scales)
            result = scc.stack(of_part, n_trials=own.n_trials, rng=own.seed)
            page["warnings"] = _lines([*said[:of_all], *said[before:]])
            final = output / where
            components = write_measurement(result, own, folder, output=final, **page)
        except Exception as error:
            shutil.rmtree(folder)
            _note_error(part, f"{region}, {group}:\n")
            outcomes.append(outcome("failed", _reason(error)))
            continue
        status, message = "measured", ""
        if len(components) == 0:
            searched = result.matched.select.any()
            status, message = "empty", NO_MATCH if searched else NO_PATTERN
        outcomes.append(outcome(status, message, where.as_posix()))
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
