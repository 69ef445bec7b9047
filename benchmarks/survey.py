# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Time a survey of simulated sources on one and on two Dask workers.

    python benchmarks/survey.py [--sources 20] [--repeat 1] [--trials 100]

Each cluster consists of local processes with one thread each.  Its workers measure a
source before the clock starts, so that everything is imported.  The tables are compared
byte by byte.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from common import Sampler, write_table
from distributed import Client, LocalCluster

from astro_scc.cli.survey import run_survey
from astro_scc.cli.survey_sources import read_survey
from astro_scc.simulation import simulate_two_fluid

HEAD = """\
[defaults]
scale_groups = {fine = [1], coarse = [2]}
max_speed = "30 mas/yr"
redshift = 0.1
"""


def at_work():
    """Return the number of processes at work on the machine."""
    return int(Path("/proc/loadavg").read_text().split()[3].split("/")[0])


def write_sources(folder, number, trials):
    """Write cubes of short jets, and return the survey that measures them."""
    text = [HEAD, f"n_trials = {trials}\n"]
    for k in range(number):
        cube = simulate_two_fluid(n_epochs=6, rng=k).cube
        cube = cube.crop((slice(0, 128), slice(16, 240)))
        cube.write(folder / f"jet{k:02d}.fits")
        text.append(f'[sources."Jet {k}"]\nepochs = "jet{k:02d}.fits"\n')
    path = folder / "survey.toml"
    path.write_text("\n".join(text), encoding="utf-8")
    return read_survey(path)


def tables(folder):
    """Return the bytes of all tables of a survey by name."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*.ecsv"))
    }


def ready(part):
    """Measure a part in a worker, so that it imports everything it needs."""
    from astro_scc.cli.survey import measure_part

    with tempfile.TemporaryDirectory() as folder:
        measure_part(part, folder)


def timed(survey, output, n_workers):
    """Return wall clock and processor time of a survey, and the processes at work."""
    with (
        LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            memory_limit=None,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        client.wait_for_workers(n_workers)
        client.run(ready, survey[0][0])
        before = sum(client.run(time.process_time).values())
        with Sampler(at_work, 0.5) as busy:
            start = time.perf_counter()
            table = run_survey(survey, output, n_workers=client)
            spent = time.perf_counter() - start
        processor = sum(client.run(time.process_time).values()) - before
    assert set(np.asarray(table["status"])) <= {"measured", "empty"}
    return spent, processor, np.mean(busy.values)


def main():
    """Run the surveys in turn and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sources", type=int, default=20)
    parser.add_argument("--repeat", type=int, default=1)
    parser.add_argument("--trials", type=int, default=100)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        survey = write_sources(folder, args.sources, args.trials)
        cost, found = {1: [], 2: []}, []
        for turn in range(args.repeat):
            # Alternate which of the two runs first.
            for n in (1, 2) if turn % 2 == 0 else (2, 1):
                output = folder / f"out-{turn}-{n}"
                cost[n].append(timed(survey, output, n))
                found.append(tables(output))
    same = all(one == found[0] for one in found)
    (one, two), processor, busy = np.transpose([np.median(cost[n], 0) for n in (1, 2)])
    header = ["sources", "1 worker [s]", "2 workers [s]", "ratio", "processor 1, 2 [s]",
              "identical tables", "at work 1, 2"]  # fmt: skip
    row = [args.sources, f"{one:.1f}", f"{two:.1f}", f"{one / two:.2f}",
           "{:.1f}, {:.1f}".format(*processor), len(found[0]) if same else "DIFFER",
           "{:.1f}, {:.1f}".format(*busy)]  # fmt: skip
    write_table("survey", header, [row])
    if not same:
        raise SystemExit("the tables differ")


if __name__ == "__main__":
    main()
