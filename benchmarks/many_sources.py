# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure a survey of many small simulated sources, and its memory and cost as it grows.

    python benchmarks/many_sources.py [--sources 1000] [--workers 2] [--parts 10]

Each source has six epochs of 64 x 40 pixels.  After each part of the sources the
processor time of the workers for it and their memory are taken; then the time of the
catalogues of all of them, and of a second run, which finds that everything is done.
"""

import argparse
import os
import tempfile
import time
from multiprocessing import active_children
from pathlib import Path

import numpy as np
from common import memory_of, write_table

from astro_scc.cli.survey import run_survey
from astro_scc.cli.survey_sources import read_survey
from astro_scc.simulation import simulate_two_fluid

#: Share of the sources that may fail.
MOST_FAILED = 0.01
HEAD = """\
[defaults]
scales = [1]
max_speed = "30 mas/yr"
n_trials = 59
"""


def write_sources(folder, number):
    """Write cubes of short jets, and return the survey that measures them."""
    text = [HEAD]
    for k in range(number):
        cube = simulate_two_fluid(n_epochs=6, rng=k).cube
        cube.crop((slice(44, 84), slice(20, 84))).write(folder / f"jet{k:05d}.fits")
        text.append(f'[sources."Jet {k}"]\nepochs = "jet{k:05d}.fits"\n')
    path = folder / "survey.toml"
    path.write_text("\n".join(text), encoding="utf-8")
    return read_survey(path)


def at_work():
    """Return the processor seconds of the workers, and the memory of each in MB."""
    seconds, memory = 0.0, []
    for worker in active_children():
        fields = Path(f"/proc/{worker.pid}/stat").read_text().rpartition(")")[2].split()
        seconds += sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
        memory.append(1e3 * memory_of(worker.pid))
    return seconds, memory


def main():
    """Measure the survey and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("--sources", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--parts", type=int, default=10)
    args = parser.parse_args()
    size = args.sources // args.parts
    rows, done, before = [], 0, [0.0, time.monotonic()]

    def count(*_):
        nonlocal done
        done += 1
        if done % size == 0 and active_children():
            seconds, memory = at_work()
            now = time.monotonic()
            cost = (seconds - before[0]) / size
            rows.append([done, f"{cost:.3f}", f"{max(memory):.0f}"])
            before[:] = seconds, now
            print(*rows[-1], f"{now:.0f}", flush=True)

    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        survey = write_sources(folder, args.sources)
        how = {"n_workers": args.workers}
        start = time.process_time()
        table = run_survey(survey, folder / "out", done=count, **how)
        failed = table["status"] != "measured"
        if failed.mean() > MOST_FAILED:
            raise SystemExit(f"not measured: {sorted({*table['message'][failed]})}")
        first = time.process_time() - start
        start = time.process_time()
        run_survey(survey, folder / "out", **how)
        again = time.process_time() - start
        names = ("survey.ecsv", "features.ecsv", "overview.html")
        sizes = [(folder / "out" / name).stat().st_size for name in names]
    costs, memory = (np.array([float(row[k]) for row in rows]) for k in (1, 2))
    if len(rows) > 2:
        # Workers import everything for their first sources.
        x, y = np.arange(len(rows) - 1), costs[1:]
        drift = np.polyfit(x, y, 1)[0] * (len(x) - 1) / y.mean()
        print(f"cost from part 2 to the last: {drift:+.1%}")
        print(f"memory from part 2 to the last: {memory[-1] / memory[1] - 1:+.1%}")
    rows.append(
        ["catalogues and page, ms a source", f"{first / args.sources * 1e3:.1f}", ""]
    )
    rows.append(["run again, ms a source", f"{again / args.sources * 1e3:.1f}", ""])
    kilobytes = sum(sizes) / args.sources / 1e3
    rows.append(["catalogues and page, kB a source", f"{kilobytes:.1f}", ""])
    head = ["sources", "processor s a source", "memory of a worker [MB]"]
    write_table("many_sources", head, rows)


if __name__ == "__main__":
    main()
