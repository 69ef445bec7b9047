# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure many sources, on one machine or a Dask cluster.

Measure the velocities of many sources and make one table.

examples:
  astro-scc survey survey.toml -o out --workers 8
  astro-scc survey survey.toml -o out --scheduler tcp://node1:8786
  astro-scc survey survey.toml -o out --workers 8 --scheduler local

survey.toml:
  [defaults]
  align = "core"
  baseline = "0.1 yr 1.0 yr"
  scale_groups = {fine = [1, 2], coarse = [3, 4]}

  [sources."3C 273"]
  epochs = "3c273/*.fits"
  redshift = 0.158
  max_speed = "2 mas/yr"
  regions = {inner = "3c273/inner.reg", outer = "3c273/outer.reg"}

[defaults] and each source may hold any setting of a configuration of astro-scc measure
except region.  Paths are relative to the file.  A source that fails does not stop the
others.  Run again with the same folder, the command resumes: sources that are finished
with the same settings, files and versions are not measured again.  The folder gets
survey.ecsv, with a row for each source, region, scale group and component, and p_fdr
over all of them, or the reason why there is no component; and in sources/ a folder
for each source with the products of astro-scc measure, including a report.
"""

from contextlib import contextmanager
from pathlib import Path

from astro_scc.cli.inputs import workers_of
from astro_scc.cli.options import add_no_report, add_output, add_workers
from astro_scc.cli.summary import table_lines


def add_arguments(parser):
    """Add the arguments of the command."""
    parser.add_argument("survey", metavar="SURVEY.toml", help="what to measure")
    what = "the table and the sources' products, new or of this survey"
    add_output(parser, what, overwrite=False)
    add_no_report(parser)
    add_workers(parser)


def run(args, reporter):
    """Run a survey according to the arguments."""
    from astro_scc.cli.sources import read_survey
    from astro_scc.cli.survey_run import TABLE, run_survey

    n_workers = workers_of(args) or 1
    survey = read_survey(args.survey)
    reporter.on_interrupt = "interrupted; the same command goes on from what is done"
    statuses = set()

    def done(name, outcomes, before):
        name = name if name.isprintable() else ascii(name)
        statuses.update(outcome.status for outcome in outcomes)
        failed = {o.message for o in outcomes if o.status == "failed"}
        for message in sorted(failed):
            reporter.warn(f"{name}: {message}")
        if not failed and not reporter.bars:
            reporter.say(f"{name}: {'finished before' if before else 'done'}")

    with _cluster(n_workers, args.workers or 1, reporter) as workers:
        table = run_survey(
            survey,
            args.output,
            n_workers=workers,
            report=not args.no_report,
            done=done,
            progress_bar=reporter.progress,
        )
    for line in _summary(table):
        reporter.say(line)
    path = Path(args.output) / TABLE
    if statuses == {"failed"}:
        raise ValueError(f"no source could be measured; {path} says why")
    reporter.say(f"\nTable: {path}")
    if not args.no_report:
        reporter.say(f"Reports: {Path(args.output) / 'sources'}")


@contextmanager
def _cluster(n_workers, n_local, reporter):
    """Yield a number of processes, or a client, and note its dashboard's address."""
    if isinstance(n_workers, int):
        yield n_workers
        return
    from astro_scc.correlation.parallel import open_client, open_local

    opened = open_local(n_local) if n_workers == "local" else open_client(n_workers)
    with opened as client:
        reporter.note(f"dashboard of the cluster: {client.dashboard_link}")
        yield client


def _summary(table):
    """Yield lines on the numbers of sources and of significant components."""
    from collections import Counter

    import numpy as np

    from astro_scc.kinematics.cosmology import cosmology_text

    status = np.asarray(table["status"], dtype=str)
    source = np.asarray(table["source"], dtype=str)
    rows = []
    for kind in ("measured", "empty", "failed"):
        own = status == kind
        rows.append([kind, str(len(np.unique(source[own]))), str(int(own.sum()))])
    yield from table_lines(["status", "sources", "rows"], rows)
    if "measured" in status:
        with_p = table[status == "measured"]
        for kind in ("moving", "stationary"):
            found = np.asarray(with_p["kind"], dtype=str) == kind
            small = found & (np.asarray(with_p["p_fdr"]) <= 0.05)
            yield (f"{kind}: {int(found.sum())}, with p_fdr <= 0.05 {int(small.sum())}")
    how = (
        cosmology_text(meta["cosmology"]) if "cosmology" in meta else "distances"
        for meta in table.meta["speeds_in_c"].values()
    )
    for text, n in Counter(how).items():
        yield f"speeds in c: {text}, sources {n}"
