# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A survey from its file to its table, whatever becomes of single sources."""

import shutil
from contextlib import suppress
from pathlib import Path

from astro_scc.correlation.parallel import as_done, workers_of
from astro_scc.partial import replace_when_complete
from astro_scc.progress import progress
from astro_scc.survey.lock import alone_in
from astro_scc.survey.source import (
    SOURCES,
    WORK,
    Job,
    Outcome,
    finished_outcomes,
    measure_source,
    one_line,
)
from astro_scc.survey.table import survey_table

__all__ = ["run_survey"]

TABLE, PLAN = "survey.ecsv", "survey.toml"


def run_survey(
    survey, output, *, n_workers=1, write_report=None, report=None, progress_bar=False
):
    """
    Measure all sources of a survey and write one table.

    Parameters
    ----------
    survey : `Survey`
        See `read_survey`.
    output : path
        Folder of the products, on a cluster one that all workers see.  In a
        folder where this ran before, sources that are finished are not
        measured again.
    n_workers : int, str or `dask.distributed.Client`, optional
        Number of processes, or a Dask scheduler, by its address or a client of
        it; the unit of work is a source.  The numbers do not depend on it.
    write_report : callable, optional
        Such as `astro_scc.report.write_report`, a function of a module, which
        workers can import: called for each region and scale group with its
        result, components and folder.
    report : callable, optional
        Called with the name of each source that is done, its list of
        `Outcome` and whether it was finished before.
    progress_bar : bool, optional

    Returns
    -------
    `~astropy.table.QTable`
        See `survey_table`; it is written to ``survey.ecsv``.

    Raises
    ------
    OSError
        If the folder has files of others, another run is at work in it, or it
        cannot be written to.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.survey import read_survey
    >>> from astro_scc.survey import run_survey
    >>> simulate_two_fluid(n_epochs=5, rng=1).cube.write("jet.fits")
    >>> text = '''[sources.Jet]
    ... epochs = "jet.fits"
    ... scales = [2]
    ... max_speed = "30 mas/yr"
    ... n_trials = 20
    ... '''
    >>> _ = Path("survey.toml").write_text(text)
    >>> survey = read_survey("survey.toml")
    >>> table = run_survey(survey, "out")
    >>> set(table["source"].tolist()), set(table["status"].tolist())
    ({'Jet'}, {'measured'})
    """
    output = Path(output).absolute()
    _make_folders(output)
    with alone_in(output / WORK):
        _clean(output)
        with replace_when_complete(output / PLAN, overwrite=True) as part:
            part.write_text(survey.text, encoding="utf-8")
        jobs = [Job(source, str(output), write_report) for source in survey.sources]
        try:
            found = _outcomes(jobs, n_workers, report, progress_bar)
        finally:
            # Of workers that were ended.
            _clean(output)
        table = survey_table([o for k in range(len(jobs)) for o in found[k]], output)
        with replace_when_complete(output / TABLE, overwrite=True) as part:
            table.write(part, format="ascii.ecsv")
    return table


def _outcomes(jobs, n_workers, report, progress_bar):
    """What became of each job, by its place in the list."""
    found = {}
    with (
        workers_of(n_workers) as workers,
        progress(len(jobs), "Sources", show=progress_bar) as done,
    ):

        def finish(k, outcomes, before):
            found[k] = outcomes
            done(1)
            if report is not None:
                report(jobs[k].source.name, outcomes, before)

        for k, job in enumerate(jobs):
            if (outcomes := finished_outcomes(job)) is not None:
                finish(k, outcomes, True)
        left = [k for k in range(len(jobs)) if k not in found]
        pieces = (jobs[k] for k in left)
        for i, outcomes in as_done(measure_source, pieces, workers):
            if isinstance(outcomes, Exception):
                # Of the worker, not of the measurement: it died, or its disk is full.
                source = jobs[left[i]].source
                outcomes = [
                    Outcome(source.name, *names, "failed", one_line(outcomes))
                    for names in source.parts
                ]
            finish(left[i], outcomes, False)
    return found


def _make_folders(output):
    if output.is_dir():
        if any(output.iterdir()) and not (output / PLAN).is_file():
            raise OSError(
                f"{output}: exists and is not of a survey; choose another folder"
            )
    try:
        (output / SOURCES).mkdir(parents=True, exist_ok=True)
        (output / WORK).mkdir(exist_ok=True)
    except OSError as error:
        raise OSError(f"{output}: cannot be made or used: {error.strerror}") from None


def _clean(output):
    """Take away what an interrupted run left half-written."""
    for kind in ("partial-*", "old-*"):
        for folder in (output / WORK).glob(kind):
            with suppress(OSError):
                shutil.rmtree(folder)
