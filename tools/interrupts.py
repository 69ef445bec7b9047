# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Stop measurements at random moments, start them again, and compare the results.

``astro-scc measure`` and ``astro-scc survey`` are each stopped five times by SIGINT, by
SIGTERM and by SIGKILL, at random moments within the time of an undisturbed
run::

    python tools/interrupts.py --seed 1 --table benchmarks/results/interrupts.csv

prints how each run ended, what it left, and whether the tables and maps of the second
run equal those of the undisturbed run bit by bit.
"""

import argparse
import csv
import os
import random
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
from astropy.io import fits

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
#: Suffixes of tables, maps and pages; other files hold settings and states.
TABLES = (".ecsv", ".fits", ".vot", ".txt", ".html")


def launch(words, log):
    """
    Start the command line as a process of its own.

    Parameters
    ----------
    words : list of str
        Arguments of the command line.
    log : path
        File for its output.

    Returns
    -------
    int
        Number of the process.
    """
    argv = [sys.executable, "-m", "astro_scc", *map(str, words)]
    how = os.O_WRONLY | os.O_CREAT | os.O_APPEND
    actions = [
        (os.POSIX_SPAWN_OPEN, 1, str(log), how, 0o644),
        (os.POSIX_SPAWN_DUP2, 1, 2),
    ]
    # A process in the background of a shell would ignore SIGINT.
    return os.posix_spawn(
        sys.executable,
        argv,
        os.environ,
        file_actions=actions,
        setsigdef=[signal.SIGINT],
    )


def end_of(process):
    """Wait for a process and return its status, negative for a signal."""
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def tables(folder):
    """
    Return the bytes of the tables of a run, and of the pixels of its maps.

    Parameters
    ----------
    folder : path

    Returns
    -------
    dict
        Bytes by the path within the folder.
    """
    found = {}
    for path in sorted(Path(folder).rglob("*")):
        name = path.relative_to(folder)
        # Hidden folders hold what a killed run has left.
        if path.suffix not in TABLES or any(part[0] == "." for part in name.parts):
            continue
        content = path.read_bytes()
        if path.suffix == ".fits":
            with fits.open(path) as hdus:
                content = [np.asarray(hdu.data).tobytes() for hdu in hdus]
        found[str(name)] = content
    return found


@dataclass(frozen=True)
class Trial:
    """
    A run that was stopped, and a second run after it.

    Attributes
    ----------
    how : `signal.Signals`
    after : float
        Seconds from the start to the signal.
    status : int
        Status of the run that was stopped.
    left : str
        What the stopped run left.
    again : int
        Status of the second run.
    seconds : float
        Time that the second run took.
    same : bool
        Whether its tables equal those of the undisturbed run.
    rest : tuple of str
        Hidden folders that are left at the end.
    said : str
        Output of both runs.
    """

    how: signal.Signals
    after: float
    status: int
    left: str
    again: int
    seconds: float
    same: bool
    rest: tuple
    said: str

    @property
    def good(self):
        """Whether the second run gave all results and left nothing else."""
        return self.again == 0 and self.same and not self.rest


def stop_and_go_on(words, folder, expected, *, how, after, launch=launch):
    """
    Stop a run, start it again and compare.

    Parameters
    ----------
    words : list of str
        Arguments of the command line without the folder of the products.
    folder : path
        An empty folder.
    expected : dict
        `tables` of an undisturbed run.
    how : `signal.Signals`
    after : float
        Seconds from the start to the signal.
    launch : callable, optional

    Returns
    -------
    `Trial`
    """
    out, log = Path(folder) / "out", Path(folder) / "log"
    words = [*words, "-o", str(out)]
    process = launch(words, log)
    time.sleep(after)
    os.kill(process, how)
    status = end_of(process)
    left = what_is_left(out)
    start = time.monotonic()
    # A measurement whose folder is there was complete; a survey goes on.
    done = words[0] == "measure" and out.exists()
    again = 0 if done else end_of(launch(words, log))
    seconds = time.monotonic() - start
    rest = [path.name for path in Path(folder).rglob(".*")]
    if how == signal.SIGKILL:
        # Who is killed cannot delete its hidden folder.
        rest = []
    said = log.read_text(encoding="utf-8") if log.exists() else ""
    same = tables(out) == expected
    return Trial(how, after, status, left, again, seconds, same, tuple(rest), said)


def what_is_left(out):
    """Return in words what a stopped run left."""
    found = []
    parts = [*out.parent.glob(f".{out.name}.partial-*"), *out.rglob("*partial-*")]
    if parts:
        found.append("a hidden folder")
    n = len(tables(out))
    if n:
        found.append(f"{n} tables and maps")
    return ", ".join(found) or "nothing"


def measurement(folder):
    """Make a jet, and return the arguments that measure it."""
    from astro_scc.simulation import simulate_two_fluid, write_simulation

    write_simulation(simulate_two_fluid(n_epochs=8, rng=1), folder / "jet")
    paths = [str(path) for path in sorted((folder / "jet").glob("*.fits"))]
    return ["measure", *paths, "--no-report", "--seed", "1", "--n-trials",
            "300", "--scales", "1,2,3", "--max-speed", "30 mas/yr"]  # fmt: skip


def survey(folder):
    """Make three jets, and return the arguments that survey them."""
    from astro_scc.simulation import simulate_two_fluid

    text = '[defaults]\nscales = [1, 2]\nmax_speed = "30 mas/yr"\nn_trials = 100\n'
    for k in range(3):
        simulate_two_fluid(n_epochs=6, rng=k).cube.write(folder / f"jet{k}.fits")
        text += f'[sources.Jet{k}]\nepochs = "jet{k}.fits"\n'
    (folder / "survey.toml").write_text(text, encoding="utf-8")
    return ["survey", str(folder / "survey.toml"), "--no-report"]


def trials(words, folder, *, number, seed, launch=launch):
    """
    Stop a command at random moments.

    Parameters
    ----------
    words : list of str
    folder : path
        Folder for the products.
    number : int
        Number of trials with each signal.
    seed : int
    launch : callable, optional

    Yields
    ------
    `Trial`, float
        A trial, and the seconds of the undisturbed run.
    """
    folder = Path(folder)
    folder.mkdir()
    start = time.monotonic()
    usual = folder / "usual"
    if end_of(launch([*words, "-o", str(usual)], folder / "log")):
        raise RuntimeError((folder / "log").read_text(encoding="utf-8"))
    seconds = time.monotonic() - start
    expected = tables(usual)
    rng = random.Random(seed)
    for k in range(number * len(SIGNALS)):
        how, after = SIGNALS[k % len(SIGNALS)], rng.uniform(0, seconds)
        for again in count():
            own = folder / f"{k}-{again}"
            own.mkdir()
            options = {"how": how, "after": after, "launch": launch}
            trial = stop_and_go_on(words, own, expected, **options)
            if trial.status or not trial.good:
                break
            # The run was faster this time and ended before the signal.
            after = rng.uniform(0, after)
        yield trial, seconds


def main():
    """Print the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("--number", type=int, default=5, help="of each signal")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--table", type=Path, help="write it here")
    args = parser.parse_args()
    rows = [["command", "signal", "after", "status", "there then", "same tables"]]
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        for name, words in (("measure", measurement(folder)),
                            ("survey", survey(folder))):  # fmt: skip
            options = {"number": args.number, "seed": args.seed}
            for trial, usual in trials(words, folder / words[0], **options):
                bad += not trial.good
                rows.append(
                    [
                        name,
                        trial.how.name,
                        f"{trial.after:.1f} of {usual:.1f} s",
                        trial.status,
                        trial.left,
                        "yes" if trial.good else f"NO {trial.again} {trial.rest}",
                    ]
                )
                print(*rows[-1], f"{trial.seconds:.1f} s", sep="; ", flush=True)
                if "Traceback" in trial.said:
                    print(trial.said)
    if args.table:
        with args.table.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)
    return bool(bad)


if __name__ == "__main__":
    sys.exit(main())
