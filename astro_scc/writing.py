# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Hidden folders for incomplete output, and what is written of text and versions."""

import hashlib
import os
import platform
import re
import secrets
import shutil
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


@contextmanager
def partial_folder(parent, prefix):
    """
    Make a folder for this process alone, and delete it at the end.

    Parameters
    ----------
    parent : `~pathlib.Path`
    prefix : str
        Start of the folder's name.  Folders with this prefix that killed
        processes left behind are removed, see `remove_left`.

    Yields
    ------
    `~pathlib.Path`
        The folder.  It is deleted with its contents when the block ends,
        unless it has been renamed by then.

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
    remove_left(parent, prefix)
    with ExitStack() as stack:
        while True:
            folder = Path(parent) / f"{prefix}{_machine()}-{secrets.token_hex(4)}"
            folder.mkdir()
            # Before it is held, another process may remove it as left behind.
            with suppress(BlockingIOError):
                stack.enter_context(hold(folder))
                if folder.exists():
                    break
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        yield folder


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


def make_folder(path, named):
    """Make a folder with its parents; errors are of the folder that a user named."""
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        what = "is a file" if Path(named).is_file() else f"{path} is a file"
        raise OSError(f"{named}: {what}; choose another folder") from None
    except OSError as error:
        raise OSError(f"{named}: cannot be made or used: {error.strerror}") from None


def remove_left(parent, prefix):
    """
    Remove the folders of `partial_folder` that killed processes left behind.

    Only folders that were made on this machine and that no process holds are
    removed.  A process holds its folder by a lock, which ends with the process;
    on systems without such locks nothing is removed.

    Parameters
    ----------
    parent : `~pathlib.Path`
    prefix : str

    Returns
    -------
    list of `~pathlib.Path`
        The folders with this prefix that remain.
    """
    # Eight digits of the machine, and eight random ones.
    names = re.compile(re.escape(prefix) + "[0-9a-f]{8}-[0-9a-f]{8}")
    stay = []
    for path in sorted(p for p in Path(parent).glob("*") if names.fullmatch(p.name)):
        if path.is_symlink() or not path.is_dir():
            continue
        with suppress(OSError), hold(path) as held:
            if held and path.name.startswith(prefix + _machine()):
                shutil.rmtree(path)
        if path.exists():
            stay.append(path)
    return stay


def _machine():
    """Return eight hexadecimal digits that stand for this machine."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


@contextmanager
def hold(folder):
    """
    Hold a folder within this context, where the system can lock folders.

    Parameters
    ----------
    folder : path

    Yields
    ------
    bool
        Whether the folder is locked.

    Raises
    ------
    BlockingIOError
        If another process, or another part of this one, holds the folder.
    """
    with ExitStack() as stack:
        try:
            import fcntl

            number = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, number)
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            held = True
        except BlockingIOError:
            raise
        except (ImportError, OSError):
            # Windows and some network file systems have no such locks.
            held = False
        yield held


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
    needed = ("astro_scc", "numpy", "scipy", "astropy", "scikit-image")
    found = dict.fromkeys(needed, "unknown")
    for name in found:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found
