# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Make every table and printed result of the documentation again, and say what changed.

    python benchmarks/run_all.py --list
    python benchmarks/run_all.py --data ../shared [--quick] [--only NAME ...] [--again]

Each is made by the command that its page gives.  What was made with the same code of
the package, the same script and command is not made again, so that a run can be stopped
and started.  At the end, and after each command, the numbers that changed are listed
with the largest relative change of each file.
"""

import argparse
import csv
import hashlib
import json
import os
import re
import shlex
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).resolve().parents[1]
#: What was made, with which code, and what changed.
STATE = REPOSITORY / "benchmarks" / "run_all.json"
#: Minutes up to which an entry is quick.
QUICK = 3
#: Relative changes up to this are those of other processors.
SAME = 1e-6
NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")
MRT = "{data}/data/mojave_xviii/apjac230ft4_mrt.txt"


class Entry(NamedTuple):
    """A command, the minutes that it takes, and the files that it writes."""

    command: str
    minutes: float
    files: tuple
    #: Whether standard output is the first of the files.
    prints: bool = False
    #: Whether the numbers are times and memory of a machine, or of a network.
    timing: bool = False


def _script(name, minutes, *files, args="", **more):
    files = tuple(f"benchmarks/results/{file}" for file in files or (f"{name}.csv",))
    return Entry(f"python benchmarks/{name}.py {args}".strip(), minutes, files, **more)


def _example(name, minutes, args=""):
    files = (f"examples/results/{name}.txt",)
    command = f"python examples/{name}.py {args}".strip()
    return Entry(f"{command} --output examples/results", minutes, files)


CALIBRATED = ("speeds", "streams", "static", "flow")
ENTRIES = {
    "start": Entry(
        f"python tools/first_jet.py {MRT}", 3,
        tuple(f"docs/images/start/{k}.txt" for k in ("restore", "inspect", "measure")),
    ),
    "paper": Entry(
        f"python tools/paper_jets.py {MRT}", 4,
        tuple(f"docs/images/paper/{k}.txt" for k in (
            "demo", "two-fluid", "random", "3c273-speeds", "3c120-speeds",
            "3c120-diverging")),
    ),
    "quasar_0003": _example("quasar_0003", 0.5, MRT),
    "quasar_3c273": _example("quasar_3c273", 1, MRT),
    "galaxy_3c120": _example("galaxy_3c120", 1, MRT),
    "galaxy_m87": _example("galaxy_m87", 1, MRT),
    "two_fluid": _example("two_fluid", 0.5),
    "protostar": _example("protostar", 0.5),
    "shell": _example("shell", 1),
    "hubble": _example("hubble", 1),
    "texture": _example("texture", 1),
    "sun": _example("sun", 1),
    "files": _script("files", 0.2, args="{data}/data"),
    "real_images": _script(
        "real_images", 0.1, "real_images_fits.csv", args="{data}/data"),
    "subpixel": _script("subpixel", 1),
    "paper_test": _script("paper_test", 3, args="{data}/data/paper_test"),
    "mojave": _script("mojave", 20, args="{data}/data/mojave_xviii"),
    "shells": _script("shells", 20, "shell_summary.csv"),
    "features": _script("features", 240, args="survey {data} {images}"),
    "features_trust": _script(
        "features", 480, "features_trust.csv", args="trust {data} {images}"),
    "features_simulated": _script(
        "features", 10, "features_simulated.csv", "features_static.csv",
        args="simulated --jets 20"),
    "streams_survey": _script(
        "streams", 240, "streams_survey.csv", args="survey {data} {images}"),
    "streams_few": _script(
        "streams", 40, "streams_few.csv", args="few {data} {images}"),
    "comparison": _script(
        "comparison", 30, "comparison.csv", "comparison_packages.csv"),
    # It keeps what is measured: without its files of a kind, that is measured again.
    "calibration_jets": Entry(
        "python benchmarks/calibration/run.py all --jets 15", 900, ()),
    "calibration": Entry(
        "python benchmarks/calibration/summary.py", 0.2,
        tuple(f"benchmarks/calibration/results/{k}_table.csv" for k in CALIBRATED),
    ),
    "inputs": Entry("python tools/inputs.py --table benchmarks/results/inputs.csv", 10,
                    ("benchmarks/results/inputs.csv",)),
    "interrupts": Entry(
        "python tools/interrupts.py --seed 1 --table benchmarks/results/interrupts.csv",
        60, ("benchmarks/results/interrupts.csv",)),
    "fuzz": Entry("python tools/fuzz.py --number 10000 --seed 2", 60,
                  ("benchmarks/results/fuzz.txt",), prints=True),
    "speed": _script("speed", 2, timing=True),
    "memory": _script("memory", 60, timing=True),
    "survey": _script("survey", 15, timing=True),
    "many_sources": _script("many_sources", 5, args="--sources 200", timing=True),
}  # fmt: skip


def read_cells(path):
    """
    Return the cells of a table or the lines of a text by their places.

    Parameters
    ----------
    path : path

    Returns
    -------
    dict of str
        Empty if there is no such file.
    """
    path = Path(path)
    if not path.is_file():
        return {}
    if path.suffix != ".csv":
        # By their words, so that a line that is new moves no others.
        found, seen = {}, Counter()
        for line in path.read_text(encoding="utf-8").splitlines():
            words = " ".join(NUMBER.sub("#", line).split())[:60]
            seen[words] += 1
            found[f"'{words}' {seen[words]}"] = line
        return found
    with open(path, newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    return {
        f"row {k}, {name}": cell
        for k, row in enumerate(rows, start=1)
        for name, cell in zip(head, row, strict=False)
    }


def largest_change(before, after):
    """
    Return the largest relative change of the numbers of a cell.

    Parameters
    ----------
    before, after : str

    Returns
    -------
    float
        Infinite if the words differ, or the number of numbers.
    """
    numbers = NUMBER.findall(before), NUMBER.findall(after)
    same = NUMBER.sub("", before).split() == NUMBER.sub("", after).split()
    if not same or len(numbers[0]) != len(numbers[1]):
        return float("inf")
    changes = [0.0]
    for one, other in (map(float, pair) for pair in zip(*numbers, strict=True)):
        size = max(abs(one), abs(other))
        changes.append(abs(one - other) / size if size else 0.0)
    return max(changes)


def compare(before, after):
    """
    Return what changed in a file as lines, the first with the number of changes.

    Parameters
    ----------
    before, after : dict of str
        See `read_cells`.

    Returns
    -------
    list of str
        Empty if nothing changed.
    """
    places = list(before | after)
    changes = {
        place: largest_change(before.get(place, ""), after.get(place, ""))
        for place in places
    }
    changed = {place: size for place, size in changes.items() if size > SAME}
    if not changed:
        return []
    most = max(changed.values())
    said = "words" if most == float("inf") else f"{most:.2g} of a number"
    lines = [f"{len(changed)} of {len(places)} changed, at most by {said}"]
    for place in changed:
        pair = before.get(place, "(none)"), after.get(place, "(none)")
        lines.append(f"  {place}: {pair[0].strip()} -> {pair[1].strip()}")
    return lines


def key_of(entry):
    """Return a check sum of the package, of the script and of the command."""
    text = hashlib.sha256(entry.command.encode())
    script = REPOSITORY / shlex.split(entry.command)[1]
    for path in [script, *sorted((REPOSITORY / "astro_scc").rglob("*"))]:
        if path.suffix in (".py", ".csv", ".toml") and path.name != "_version.py":
            text.update(path.read_bytes())
    return text.hexdigest()


def make(entry, *, data, images):
    """
    Run the command of an entry, and return what changed in its files.

    Parameters
    ----------
    entry : Entry
    data, images : path
        Of the folder with data, and of that for images of many sources.

    Returns
    -------
    dict of list of str
        By the name of each file that changed.
    """
    before = {name: read_cells(REPOSITORY / name) for name in entry.files}
    words = shlex.split(entry.command.format(data=data, images=images))
    environment = {"MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1"} | dict(os.environ)
    # That of this clone, whichever is installed.
    paths = str(REPOSITORY), environment.get("PYTHONPATH")
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
    done = subprocess.run(
        [sys.executable, *words[1:]], cwd=REPOSITORY, env=environment, check=False,
        text=True, stdout=subprocess.PIPE,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"exit status {done.returncode}")
    if entry.prints:
        (REPOSITORY / entry.files[0]).write_text(done.stdout, encoding="utf-8")
    after = {name: read_cells(REPOSITORY / name) for name in entry.files}
    found = {name: compare(before[name], after[name]) for name in entry.files}
    return {name: lines for name, lines in found.items() if lines}


def run(names, state, *, data, images, again=False):
    """Make the entries that are not made yet, and keep the state after each."""
    for name in names:
        entry, known = ENTRIES[name], state.get(name, {})
        key = key_of(entry)
        if known.get("key") == key and not again:
            print(f"{name}: made before")
            continue
        print(f"{name}: {entry.command} (about {entry.minutes:g} min)", flush=True)
        start = time.monotonic()
        try:
            changed = make(entry, data=data, images=images)
        except RuntimeError as error:
            print(f"  failed: {error}", flush=True)
            state[name] = {"failed": str(error)}
            continue
        spent = (time.monotonic() - start) / 60
        # The first run after a change says what it changed; a second one adds to it.
        state[name] = {"key": key, "minutes": round(spent, 1), "changed": changed}
        STATE.write_text(json.dumps(state, indent=1), encoding="utf-8")
        for file, lines in changed.items():
            print(f"  {file}: ", "\n  ".join(lines), sep="", flush=True)


def report(names, state):
    """Print a line for each file: what changed, or that nothing did."""
    print("\nWhat changed:")
    for name in names:
        found = state.get(name, {})
        if "failed" in found:
            print(f"  {name}: failed, {found['failed']}")
        note = " (times of this machine)" if ENTRIES[name].timing else ""
        for file, lines in found.get("changed", {}).items():
            print(f"  {file}: {lines[0]}{note}")
    if not any(state.get(name, {}).get("changed") for name in names):
        print("  nothing")


def main():
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("--list", action="store_true", help="show all entries")
    parser.add_argument("--only", nargs="+", choices=ENTRIES, default=list(ENTRIES))
    parser.add_argument("--quick", action="store_true", help=f"up to {QUICK} minutes")
    parser.add_argument("--again", action="store_true", help="also what is made")
    parser.add_argument("--data", default="../shared", help="folder with the data")
    parser.add_argument("--images", default="IMAGES", help="for images of sources")
    args = parser.parse_args()
    names = [k for k in args.only if not args.quick or ENTRIES[k].minutes <= QUICK]
    if args.list:
        for name in names:
            entry = ENTRIES[name]
            print(f"{name:18} {entry.minutes:5g} min  {entry.command}")
        return
    state = json.loads(STATE.read_text("utf-8")) if STATE.is_file() else {}
    folders = {k: Path(getattr(args, k)).resolve() for k in ("data", "images")}
    run(names, state, **folders, again=args.again)
    report(names, state)


if __name__ == "__main__":
    main()
