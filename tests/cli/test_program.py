# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The program: help, arguments, errors, warnings."""

import os
import re
import signal
import subprocess
import sys
import threading
import warnings

import pytest

from astro_scc.cli import main
from astro_scc.cli.program import Reporter, build_parser
from astro_scc.exceptions import EpochWarning


@pytest.mark.slow
def test_help_imports_nothing_that_takes_time():
    code = (
        "import sys\nfrom astro_scc.cli import main\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit as leave:\n"
        "    assert leave.code == 0\n"
        "heavy = {'numpy', 'scipy', 'astropy', 'matplotlib', 'photutils', 'tqdm'}\n"
        "assert heavy.isdisjoint(sys.modules), heavy & set(sys.modules)"
    )
    for words in ([], ["demo"], ["measure"], ["inspect"], ["track"], ["survey"]):
        done = subprocess.run(
            [sys.executable, "-c", code, *words, "--help"],
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.startswith("usage: astro-scc")


def test_completion_of_a_shell(capsys, monkeypatch):
    pytest.importorskip("shtab")
    with pytest.raises(SystemExit) as leave:
        main(["--print-completion", "bash"])
    assert leave.value.code in (0, None)
    script = capsys.readouterr().out
    assert "survey" in script
    assert "--position-angle" in script
    monkeypatch.setitem(sys.modules, "shtab", None)
    with pytest.raises(SystemExit) as leave:
        main(["--print-completion", "bash"])
    assert leave.value.code == 2
    assert "needs shtab: pip install shtab" in capsys.readouterr().err


def test_an_option_of_several_commands_is_explained_alike():
    parser = build_parser()
    (commands,) = (a for a in parser._actions if a.dest == "command")
    # What differs by what a command makes or takes.
    own = {"--output", "--epochs", "--no-report"}
    said = {}
    for command in commands.choices.values():
        for action in command._actions:
            for option in set(action.option_strings) - own:
                if option.startswith("--"):
                    said.setdefault(option, set()).add((action.metavar, action.help))
    assert {option for option, texts in said.items() if len(texts) > 1} == set()
    assert len(said) > 25


@pytest.mark.parametrize("angle", ["-112deg", "-112 deg", "-.5rad", "-112", "radial"])
def test_angles_below_zero_are_no_options(angle):
    words = ["measure", "a.fits", "-o", "out", "--position-angle", angle, "--quiet"]
    args = build_parser().parse_args(words)
    assert (args.position_angle, args.quiet) == (angle, True)


@pytest.mark.parametrize(
    ("argv", "line"),
    [
        ([], "astro-scc: error: the following arguments are required: COMMAND"),
        (["fly"], "astro-scc: error: argument COMMAND: invalid choice: 'fly'"),
        (["restore", "a.ecsv"], "astro-scc restore: error: the following arguments"),
        (["--foo", "inspect"], "astro-scc: error: unrecognized arguments: --foo"),
        (["measure", "--bins", "3"], "astro-scc measure: error: unrecognized arg"),
        (["simulate", "jets", "x"], "astro-scc simulate: error: argument JET: invalid"),
        (["simulate", "static", "x", "--epochs", "b"], "astro-scc simulate: error: "),
    ],
)
def test_arguments_that_are_not_understood(capsys, argv, line):
    with pytest.raises(SystemExit) as leave:
        main(argv)
    assert leave.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(line)
    assert len(err.splitlines()) == 1
    # The help of the command, if there is one.
    program = line.partition(":")[0]
    assert err.endswith(f"; see {program} --help\n")


def test_an_interrupt_is_one_line(astro_scc, here, monkeypatch):
    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("astro_scc.simulation.simulate_static", interrupt)
    status, out, err = astro_scc("simulate", "static", "out")
    assert (status, out) == (130, "")
    assert err == "astro-scc simulate: error: interrupted, nothing was written\n"
    assert not list(here.iterdir())
    with pytest.raises(KeyboardInterrupt):
        main(["simulate", "static", "out", "--debug"])


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_signal_that_ends_is_one_line(astro_scc, here, monkeypatch, name):
    number = getattr(signal, name)
    monkeypatch.setattr(
        "astro_scc.simulation.simulate_static",
        lambda *a, **k: os.kill(os.getpid(), number),
    )
    # Whoever runs the tests may ignore it, as nohup does.
    before = signal.signal(number, signal.SIG_DFL)
    try:
        status, out, err = astro_scc("simulate", "static", "out")
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, before)
    assert (status, out) == (128 + number, "")
    assert err == "astro-scc simulate: error: interrupted, nothing was written\n"
    assert not list(here.iterdir())


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_signal_that_somebody_handles_is_theirs(astro_scc, here, monkeypatch):
    received = []
    before = signal.signal(signal.SIGTERM, lambda *args: received.append(args[0]))
    try:
        monkeypatch.setattr(
            "astro_scc.simulation.simulate_static",
            lambda *a, **k: os.kill(os.getpid(), signal.SIGTERM) or 1 / 0,
        )
        with pytest.raises(ZeroDivisionError):
            main(["simulate", "static", "out"])
    finally:
        signal.signal(signal.SIGTERM, before)
    assert received == [signal.SIGTERM]


def test_beside_the_main_thread(astro_scc, here):
    """Where no handler of signals can be set."""
    status = []
    run = threading.Thread(target=lambda: status.append(astro_scc("inspect", "none")))
    run.start()
    run.join()
    assert status[0][0] == 2


@pytest.mark.parametrize("error", [ValueError, TypeError, OSError, MemoryError])
def test_errors_of_the_library_are_one_line(astro_scc, monkeypatch, here, error):
    def fail(*args, **kwargs):
        raise error("it is\nwrong")

    monkeypatch.setattr("astro_scc.simulation.simulate_static", fail)
    status, _, err = astro_scc("simulate", "static", "out")
    assert status == 2
    assert re.fullmatch(r"astro-scc simulate: error: .*it is wrong\)?\n", err)
    with pytest.raises(error):
        main(["simulate", "static", "out", "--debug"])


def test_mistakes_of_the_program_are_not_hidden(monkeypatch, here):
    def fail(*args, **kwargs):
        raise AssertionError

    monkeypatch.setattr("astro_scc.simulation.simulate_static", fail)
    with pytest.raises(AssertionError):
        main(["simulate", "static", "out"])
    assert not list(here.iterdir())


@pytest.mark.slow
def test_a_reader_that_goes_away_is_no_error(tmp_path):
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "astro_scc",
            "simulate",
            "static",
            "x",
            "--epochs=1",
        ],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 0


def test_warnings_are_lines_each_once(capsys):
    reporter = Reporter("astro-scc test")
    with reporter.warnings_as_lines():
        for _ in range(2):
            warnings.warn("look\n  here", EpochWarning, stacklevel=1)
    assert capsys.readouterr().err == "warning: look here\n"
    assert reporter.warnings == ["look here"]
    quiet = Reporter("astro-scc test", quiet=True)
    with quiet.warnings_as_lines():
        warnings.warn("look here", EpochWarning, stacklevel=1)
        quiet.note("this")
        quiet.say("that")
    assert capsys.readouterr() == ("", "")
    assert quiet.warnings == ["look here"]


@pytest.mark.parametrize(
    ("said", "typed"),
    [
        ("max_speed = '2' has no unit", "--max-speed '2' has no unit"),
        ("kappa must be above 0", "--kappa must be above 0"),
        ("give a smaller max_speed, or", "give a smaller --max-speed, or"),
        ("along needs a position_angle", "along needs a --position-angle"),
        ("the kappa of all", "the kappa of all"),
        # Names of files, and keys in them.
        ("kappa.reg: no such file", "kappa.reg: no such file"),
        ("c.toml: max_speed = '2' has no", "c.toml: max_speed = '2' has no"),
        ("c.toml: did you mean max_speed; see", "c.toml: did you mean max_speed; see"),
    ],
)
def test_messages_name_options_as_they_are_typed(capsys, said, typed):
    settings = ("max_speed", "position_angle", "kappa")
    reporter = Reporter("astro-scc test", settings=settings)
    reporter.warn(said)
    reporter.error(said)
    err = capsys.readouterr().err
    assert err == f"warning: {typed}\nastro-scc test: error: {typed}\n"
    # A survey has its settings in a file.
    Reporter("astro-scc test").error(said)
    assert capsys.readouterr().err == f"astro-scc test: error: {said}\n"
