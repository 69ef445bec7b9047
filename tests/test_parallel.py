# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work in several processes; files that are complete or not there; progress."""

import io
import multiprocessing
import operator
import os
import pickle
import re
import subprocess
import sys
import threading
import time
from functools import partial
from operator import truediv

import pytest

from astro_scc.parallel import WAITING, as_done, in_order, progress
from astro_scc.writing import partial_folder, replace_when_complete

posix = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
inverse = partial(truediv, 1)
KILL = "__import__('os').kill(__import__('os').getpid(), 9)"
#: An error that is pickled, and raises another one when it is unpickled.
AGAIN = (
    "type('E', (Exception,), {'__reduce__': lambda s: (UnicodeDecodeError, ())})"
    "('again')"
)
#: The usual way to start a process, and others, which take longer.
FIRST, *OTHERS = multiprocessing.get_all_start_methods()
STARTS = [FIRST, *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)]


@pytest.fixture(autouse=True)
def none_left():
    """Whoever stops, fails or ends leaves no process behind."""
    yield
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize("work", [as_done, in_order])
def test_workers_that_are_refused(work):
    for n_workers, words in ((0, "at least 1"), (True, "a number of processes")):
        with pytest.raises((ValueError, TypeError), match=f"n_workers .*{words}"):
            list(work(inverse, [1], n_workers))


@pytest.mark.parametrize(("work", "n"), [(as_done, 1), (in_order, 1), (in_order, 2)])
def test_pieces_are_taken_as_needed_and_keep_their_order(work, n):
    taken = []

    def pieces():
        for k in range(1, 31):
            taken.append(k)
            yield k

    results = work(operator.neg, pieces(), n)
    first = [next(results), next(results)]
    assert first == ([-1, -2] if work is in_order else [(0, -1), (1, -2)])
    assert len(taken) <= (2 if n == 1 else n * WAITING + 2)
    results.close()


def test_errors_of_workers():
    for n_workers in (1, 2):
        found = dict(as_done(inverse, [2, 0], n_workers))
        assert found[0] == 0.5
        assert isinstance(found[1], ZeroDivisionError)
    with pytest.raises(ZeroDivisionError) as caught:
        list(in_order(eval, ["1 // 0"], 2))
    assert "Traceback" in str(caught.value.__cause__)
    # What cannot be sent: to the worker, from it, or as an error.
    unsendable = (AttributeError, TypeError, pickle.PicklingError)
    with pytest.raises(unsendable):
        list(in_order(lambda value: value, [1], 2))
    found = dict(as_done(eval, ["lambda: 1", "2"], 2))
    assert isinstance(found[0], unsendable)
    assert found[1] == 2
    for error in ("OSError(lambda: 1)", AGAIN):
        with pytest.raises(RuntimeError, match="(OSError: .*lambda|E: again)"):
            list(in_order(exec, [f"raise {error}"], 2))


@pytest.mark.slow
@pytest.mark.parametrize("context", STARTS)
def test_workers_have_one_thread_each(context):
    # With numpy, of which a worker that was not forked has nothing yet.
    threads = (
        "__import__('numpy') and "
        "[p['num_threads'] for p in __import__('threadpoolctl').threadpool_info()]"
    )
    for pools in in_order(eval, [threads] * 2, 2, context=context):
        assert set(pools) == {1}


def deadly(values):
    """Expressions, of which that of 3 kills its process, whoever works on it."""
    return [KILL if k == 3 else f"10 * {k}" for k in values]


@posix
@pytest.mark.parametrize("context", STARTS)
def test_a_piece_that_kills_its_process(context, tmp_path):
    mark = str(tmp_path / "mark")
    once = f"__import__('os').path.exists({mark!r}) or open({mark!r}, 'w') and {KILL}"

    def pieces():
        yield from deadly(range(6))
        # Long enough for a process to die before the next piece.
        time.sleep(0.3)
        yield "60"

    found = dict(as_done(eval, pieces(), 2, context=context))
    assert isinstance(found[3], ChildProcessError)
    assert "a worker process died" in str(found.pop(3))
    assert found == {0: 0, 1: 10, 2: 20, 4: 40, 5: 50, 6: 60}
    assert dict(as_done(eval, ["1", once, "3"], 2)) == {0: 1, 1: True, 2: 3}
    with pytest.raises(ChildProcessError, match="fewer workers take less"):
        list(in_order(eval, deadly(range(6)), 2, context=context))


#: A worker is killed at a random moment while it starts, works or writes a result.
SCRIPT = """
import multiprocessing, random, signal, sys, threading, time
from astro_scc.parallel import in_order

context, n = sys.argv[1], int(sys.argv[2])

def work(_):
    time.sleep(0.01)
    return bytes(1_000_000)

def kill(after):
    time.sleep(after)
    while not (workers := multiprocessing.active_children()):
        time.sleep(0.01)
    random.choice(workers).kill()

if __name__ == "__main__":
    for seed in range(n):
        random.seed(seed)
        after = random.uniform(0, 1 if context == "fork" else 4)
        threading.Thread(target=kill, args=[after]).start()
        try:
            for _ in in_order(work, range(10_000), 2, context=context):
                pass
        except ChildProcessError as error:
            print(len(multiprocessing.active_children()), error)
"""


@posix
@pytest.mark.parametrize("context", STARTS)
def test_a_killed_worker_is_an_error(tmp_path, context):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    command = [sys.executable, script, context, "3"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=90)
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert len(lines) == 3
    assert all(line.startswith("0 a worker process died") for line in lines)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_and_a_file_that_are_gone_unless_complete(tmp_path):
    with pytest.raises(RuntimeError), partial_folder(tmp_path, ".part-") as folder:
        raise RuntimeError((folder / "a").write_text("x"))
    with partial_folder(tmp_path, ".part-") as folder:
        folder.rename(tmp_path / "whole")
    file = tmp_path / "a"
    with pytest.raises(KeyboardInterrupt), replace_when_complete(file) as part:
        raise KeyboardInterrupt(part.write_text("half"))
    assert names(tmp_path) == ["whole"]
    with replace_when_complete(file) as part:
        part.write_text("complete")
    assert names(tmp_path) == ["a", "whole"]
    said = {"a": "a: exists; pass overwrite", "whole": "whole: is a directory; give"}
    said |= {"nowhere/a": "folder .*nowhere does not exist"}
    for path, words in said.items():
        with pytest.raises(OSError, match=words):
            replace_when_complete(tmp_path / path).__enter__()


@pytest.mark.parametrize("notebook", [False, True])
def test_a_terminal_and_a_notebook_show_a_bar(monkeypatch, notebook):
    terminal = io.StringIO()
    terminal.isatty = lambda: not notebook
    monkeypatch.setattr(sys, "stderr", terminal)
    if notebook:
        monkeypatch.setitem(sys.modules, "ipykernel", sys)
    # An error passes, and closes the bar.
    with pytest.raises(RuntimeError, match="broken"), progress(4, "First"):
        raise RuntimeError("broken")
    with progress(4, "Correlating") as done:
        done(1)
        done(3)
    assert re.search("Correlating.*4/4", terminal.getvalue())


@pytest.mark.parametrize(("total", "steps"), [(40, "3 of 40"), (None, "3 done")])
def test_lines_where_there_is_no_terminal(monkeypatch, capsys, total, steps):
    # Half a minute is waited for.
    with progress(4, "Correlating") as done:
        done(4)
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr("astro_scc.parallel.EVERY", 0.01)
    threads = threading.active_count()
    with progress(total, "Searching") as done:
        done(1)
        done(2)
        # Without another step.
        time.sleep(0.1)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 2
    assert re.fullmatch(rf"Searching: {steps}, 0\.0 min", lines[-1])
    assert threading.active_count() == threads
