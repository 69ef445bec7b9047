# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Hidden folders for incomplete output, signals, and text and versions in it."""

import os
import secrets
import shutil
import signal
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from pathlib import Path


@contextmanager
def partial_folder(parent, prefix):
    """
    Make a folder for this process alone, and delete it at the end.

    Parameters
    ----------
    parent : `~pathlib.Path`
    prefix : str
        Start of the folder's name.

    Yields
    ------
    `~pathlib.Path`
        The folder.  It is deleted with its contents when the block ends,
        unless it has been renamed by then.  A killed process leaves it.

    Raises
    ------
    OSError
        If the folder cannot be made.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.writing import partial_folder
    >>> Path("out").mkdir()
    >>> with partial_folder(Path("out"), ".partial-") as folder:
    ...     _ = (folder / "a.txt").write_text("done")
    ...     (folder / "a.txt").replace("out/a.txt").name
    'a.txt'
    >>> [path.name for path in Path("out").iterdir()]
    ['a.txt']
    """
    folder = Path(parent) / f"{prefix}{secrets.token_hex(4)}"
    try:
        folder.mkdir()
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def replace_when_complete(path, *, overwrite=False):
    """
    Provide a temporary file beside ``path`` that replaces it when complete.

    Parameters
    ----------
    path : str or path-like
    overwrite : bool

    Yields
    ------
    `~pathlib.Path`
        The file to write.  If the block raises an error, the file is deleted
        and ``path`` is left as it was.

    Raises
    ------
    OSError
        If the file exists and ``overwrite`` is False, or its folder does
        not exist.
    """
    path = Path(os.fspath(path))
    if path.is_dir():
        raise IsADirectoryError(f"{path}: is a directory; give the name of a file")
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path}: exists; pass overwrite=True to replace it")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: its folder {path.parent} does not exist")
    with partial_folder(path.parent, ".astro_scc-") as folder:
        part = folder / path.name
        yield part
        os.replace(part, path)


@contextmanager
def handled(handler, names, *, only_default=False):
    """
    Handle signals in another way for a while.

    Parameters
    ----------
    handler : callable or `signal.Handlers`
    names : sequence of str
        Those that a system lacks are left out.
    only_default : bool, optional
        Leave signals alone that other code handles or ignores.
    """
    with ExitStack() as stack:
        for name in names:
            number = getattr(signal, name, None)
            # Only the main thread may set handlers; elsewhere the host decides.
            with suppress(TypeError, ValueError):
                before = signal.getsignal(number)
                if before is signal.SIG_DFL or not only_default:
                    signal.signal(number, handler)
                    stack.callback(signal.signal, number, before or signal.SIG_DFL)
        yield


def make_folder(path, named):
    """Make a folder with its parents; errors are of the folder that a user named."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        what = "is a file" if Path(named).is_file() else f"{path} is a file"
        raise OSError(f"{named}: {what}; choose another folder") from None
    except OSError as error:
        raise OSError(f"{named}: cannot be made or used: {error.strerror}") from None


def ascii_line(text):
    """Return text in one line of ASCII."""
    return " ".join(str(text).split()).encode("ascii", "replace").decode()


def versions() -> dict[str, str]:
    """
    Return the versions of this package and of the packages its numbers depend on.

    Returns
    -------
    dict of str

    Examples
    --------
    >>> from astro_scc.writing import versions
    >>> {"astro_scc", "numpy", "scipy"} <= set(versions())
    True
    """
    needed = ("astro_scc", "numpy", "scipy", "astropy", "skimage")
    found = {name: import_module(name).__version__ for name in needed}
    return found | {"scikit-image": found.pop("skimage")}
