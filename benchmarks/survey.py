# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
A survey of simulated sources on one and on two Dask workers.

    python benchmarks/survey.py [--sources 20] [--repeat 1] [--trials 100]

Each cluster is a real one, of processes with one thread each, on this machine; its
workers have measured a source before the clock starts, and so imported everything.
The tables are compared byte by byte.
"""

import argparse
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from common import write_table
from distributed import Client, LocalCluster

from astro_scc.cli.sources import read_survey, run_survey
from astro_scc.simulation import simulate_two_fluid

HEAD = """\
[defaults]
scale_groups = {fine = [1], coarse = [2]}
max_speed = "30 mas/yr"
redshift = 0.1
"""


class Busy:
    """Mean number of processes at work on the machine, these included."""

    def __enter__(self):
        self.samples, self.stop = [], threading.Event()
        self.thread = threading.Thread(target=self._sample, daemon=True)
        self.thread.start()
        return self

    def _sample(self):
        while not self.stop.wait(0.5):
            try:
                running = Path("/proc/loadavg").read_text().split()[3]
                self.samples.append(int(running.split("/")[0]))
            except OSError:
                return

    def __exit__(self, *args):
        self.stop.set()
        self.thread.join()

    @property
    def mean(self):
        """The mean, NaN where the system does not tell."""
        return float(np.mean(self.samples)) if self.samples else np.nan


def write_sources(folder, number, trials):
    """Cubes of short jets, and the survey that measures them."""
    text = [HEAD, f"n_trials = {trials}\n"]
    for k in range(number):
        cube = simulate_two_fluid(n_epochs=6, rng=k).cube
        cube = cube.crop((slice(64, 192), slice(16, 240)))
        cube.write(folder / f"jet{k:02d}.fits")
        text.append(f'[sources."Jet {k}"]\nepochs = "jet{k:02d}.fits"\n')
    path = folder / "survey.toml"
    path.write_text("\n".join(text), encoding="utf-8")
    return read_survey(path)


def tables(folder):
    """Bytes of all tables of a survey by their name."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*.ecsv"))
    }


def ready(source):
    """Measure a source in a worker, so that it has imported all that it needs."""
    from astro_scc.cli.sources import measure_source

    with tempfile.TemporaryDirectory() as folder:
        measure_source(source, folder)


def timed(survey, output, n_workers):
    """Seconds of a survey, by the clock and of processors, and how busy it was."""
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
        client.run(ready, survey.sources[0])
        before = sum(client.run(time.process_time).values())
        with Busy() as busy:
            start = time.perf_counter()
            table = run_survey(survey, output, n_workers=client)
            spent = time.perf_counter() - start
        processor = sum(client.run(time.process_time).values()) - before
    assert set(np.asarray(table["status"])) <= {"measured", "empty"}
    return spent, processor, busy.mean


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
        seconds, processor, busy = ({1: [], 2: []} for _ in range(3))
        found = []
        for turn in range(args.repeat):
            # The one first, then the other first.
            for n in (1, 2) if turn % 2 == 0 else (2, 1):
                output = folder / f"out-{turn}-{n}"
                spent, of_processors, mean = timed(survey, output, n)
                seconds[n].append(spent)
                processor[n].append(of_processors)
                busy[n].append(mean)
                found.append(tables(output))
    same = all(one == found[0] for one in found)
    one, two = (float(np.median(seconds[n])) for n in (1, 2))
    write_table(
        "survey",
        ["sources", "1 worker [s]", "2 workers [s]", "ratio",
         "processor 1, 2 [s]", "identical tables", "at work 1, 2"],
        [
            [
                args.sources,
                f"{one:.1f}",
                f"{two:.1f}",
                f"{one / two:.2f}",
                ", ".join(f"{np.median(processor[n]):.1f}" for n in (1, 2)),
                f"{len(found[0])}" if same else "DIFFER",
                f"{np.mean(busy[1]):.1f}, {np.mean(busy[2]):.1f}",
            ]
        ],
    )  # fmt: skip
    if not same:
        raise SystemExit("the tables differ")


if __name__ == "__main__":
    main()
