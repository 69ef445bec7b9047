# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One run at a time in the folder of a survey."""

import json
import os
import platform
from contextlib import ExitStack, contextmanager
from pathlib import Path

from astro_scc.partial import hold

__all__ = ["alone_in"]

NAME = "running.json"


@contextmanager
def alone_in(folder):
    """
    Keep other runs out of a folder while in this context.

    Parameters
    ----------
    folder : `~pathlib.Path`
        Which exists.  It gets a file that says who is at work; that of a run
        that was killed is taken over.

    Yields
    ------
    None

    Raises
    ------
    OSError
        If another run is at work in it, or may be: one of another machine
        cannot be asked.
    """
    file = Path(folder) / NAME
    with ExitStack() as stack:
        try:
            held = stack.enter_context(hold(folder))
        except BlockingIOError:
            raise OSError(
                f"{folder.parent}: {_who(_read(file))} measures a survey here; wait "
                "for it, or choose another folder"
            ) from None
        _refuse_others(file, held)
        file.write_text(json.dumps(_self()) + "\n", encoding="utf-8")
        stack.callback(file.unlink, missing_ok=True)
        yield


def _self():
    return {"process": os.getpid(), "machine": platform.node()}


def _read(file):
    try:
        run = json.loads(file.read_text(encoding="utf-8"))
        return {"process": int(run["process"]), "machine": str(run["machine"])}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _who(run):
    if run is None:
        return "another run"
    machine = "" if run["machine"] == platform.node() else f" on {run['machine']}"
    return f"process {run['process']}{machine}"


def _refuse_others(file, held):
    """Refuse where the file is of a run that may live, as locks do not tell."""
    run = _read(file)
    if run is None:
        return
    here = run["machine"] == platform.node()
    if here and (held or not _lives(run["process"])):
        return
    raise OSError(
        f"{file.parent.parent}: {_who(run)} measures a survey here, or was killed; "
        f"if it runs no more, delete {file}"
    )


def _lives(process):
    if process == os.getpid():
        # Numbers come again.
        return False
    if os.name == "nt":
        # There is no harmless signal.
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True
