# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The program: help, arguments, errors, signals, warnings, and what it refuses."""

import os
import re
import shlex
import signal
import subprocess
import sys
import warnings

import pytest

from astro_scc.cli import main
from astro_scc.cli.program import Reporter
from astro_scc.exceptions import EpochWarning


@pytest.fixture
def simulated(monkeypatch):
    """Let the simulation of a static jet do something else."""

    def act(function):
        monkeypatch.setattr("astro_scc.simulation.simulate_static", function)

    return act


@pytest.mark.slow
def test_help_imports_nothing_that_takes_time():
    code = (
        "import sys\nfrom astro_scc.cli import main\n"
        "for words in ([], ['demo'], ['measure'], ['inspect'], ['survey']):\n"
        "    try:\n        main([*words, '--help'])\n"
        "    except SystemExit as leave:\n        assert leave.code == 0\n"
        "heavy = {'numpy', 'scipy', 'astropy', 'matplotlib', 'photutils', 'tqdm'}\n"
        "assert heavy.isdisjoint(sys.modules), heavy & set(sys.modules)"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.count("usage: astro-scc") == 5


def test_completion_of_a_shell(capsys, monkeypatch):
    pytest.importorskip("shtab")
    for status in (0, 2):
        with pytest.raises(SystemExit) as leave:
            main(["--print-completion", "bash"])
        assert (leave.value.code or 0) == status
        monkeypatch.setitem(sys.modules, "shtab", None)
    said = capsys.readouterr()
    assert {"survey", "--position-angle"} <= set(re.findall(r"[\w-]+", said.out))
    assert "needs shtab: pip install shtab" in said.err


def test_arguments_that_are_not_understood(capsys):
    for argv, line in [
        ("fly", "astro-scc: error: argument COMMAND: invalid choice: 'fly'"),
        ("--foo inspect", "astro-scc: error: unrecognized arguments: --foo"),
        ("simulate static x --epochs b", "astro-scc simulate: error: argument --epo"),
        ("survey x --source a --source b", "astro-scc survey: error: argument --sou"),
    ]:
        with pytest.raises(SystemExit) as leave:
            main(argv.split())
        assert leave.value.code == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith(line)
        assert err.endswith(f"; see {line.partition(':')[0]} --help\n")
        assert err.count("\n") == 1


@pytest.mark.parametrize("error", [ValueError, MemoryError])
def test_errors_of_the_library_are_one_line(astro_scc, simulated, error):
    def fail(*args, **kwargs):
        raise error("it is\nwrong")

    simulated(fail)
    status, _, err = astro_scc("simulate", "static", "out")
    assert status == 2
    assert re.fullmatch(r"astro-scc simulate: error: .*it is wrong\)?\n", err)
    with pytest.raises(error):
        main(["simulate", "static", "out", "--debug"])


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupt_or_a_signal_is_one_line(astro_scc, here, simulated, name):
    number, theirs = getattr(signal, name), []
    simulated(lambda *args, **kwargs: os.kill(os.getpid(), number) or 1 / 0)
    # Whoever runs the tests may ignore it, as nohup does.
    own = signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
    before = signal.signal(number, own)
    try:
        status, out, err = astro_scc("simulate", "static", "out")
        assert signal.getsignal(number) is own
        with pytest.raises(KeyboardInterrupt):
            main(["simulate", "static", "out", "--debug"])
        # A signal that somebody handles is theirs.
        signal.signal(number, lambda *args: theirs.append(args[0]))
        with pytest.raises(ZeroDivisionError):
            main(["simulate", "static", "out"])
    finally:
        signal.signal(number, before)
    assert (status, out, theirs) == (128 + number, "", [number])
    assert err == "astro-scc simulate: error: interrupted, nothing was written\n"
    assert not list(here.iterdir())


@pytest.mark.parametrize("quiet", [False, True])
def test_warnings_are_lines_each_once(capsys, quiet):
    reporter = Reporter("astro-scc test", quiet=quiet)
    with reporter.warnings_as_lines():
        for _ in range(2):
            warnings.warn("look\n  here", EpochWarning, stacklevel=1)
        reporter.note("this")
        reporter.say("that")
    said = "that\n", "warning: look here\nnote: this\n"
    assert capsys.readouterr() == (("", "") if quiet else said)
    assert reporter.warnings == ["look here"]


#: Beside ``tools/inputs.py``, by the beginning of a command: further words, and a part
#: of what is said.
REFUSED = {
    "measure JET -o out": """
--beam "10 arcsec" | arcsec at 0.0 deg, is larger than the image; give another
--align coer | --align 'coer' is none of
--align "core 9" | --align core '9' has no unit at its end; it must be a position angle
--region no.reg | no.reg: No such file or directory
-o full | full: exists and is not empty
--method paper --ds9-regions | --ds9-regions is for method spectrum: leave it out
""",
    "profile JET -o out": """
| --bins is missing
""",
    "track -o out": """
| no epochs were given
""",
    "inspect": """
JET --speed fast | --speed 'fast' has 'fast' where a number is expected; it must be an
note.fits more.fits | (and 1 more like it)
""",
    "simulate": """
static x --dense | --dense is for two-fluid, not for static
""",
    "restore MODELS": """
--beam "1 mas" | error: -o and --pixel must be given to make images
-o out --pixel "0.1 mas" | 3c1_2006-03-09.mod: is a list of
""",
}
MODELS = "3c1_2006-03-09.mod", "3c1_2007-03-09.mod"
FILES = dict.fromkeys(("full/mine.txt", "note.fits", "more.fits"), "no image")
FILES |= dict.fromkeys(MODELS, "1.0v 0.0v 0v 0.2v 1 0 1\n0.3v 2.0v 45v 0.5v 1 0 1\n")


def cases():
    for command, rows in REFUSED.items():
        for row in rows.strip().splitlines():
            options, _, reason = row.rpartition("| ")
            # Images are read, and the cases of measure are many.
            slow = pytest.mark.slow if command == "measure JET -o out" else ()
            yield pytest.param(f"{command} {options}", reason, marks=slow)


@pytest.mark.parametrize(("command", "reason"), list(cases()))
def test_what_a_user_gets_wrong(jet, refused, here, command, reason):
    for name, text in FILES.items():
        (here / name).parent.mkdir(exist_ok=True)
        (here / name).write_text(text)
    files = {"JET": jet, "MODELS": sorted(here.glob("3c1*"))}
    words = (files.get(word, [word]) for word in shlex.split(command))
    assert reason in refused(*(word for own in words for word in own))
