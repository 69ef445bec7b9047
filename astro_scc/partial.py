# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Hidden folders for what is not complete, and those that a killed process left."""

import hashlib
import os
import platform
import re
import secrets
import shutil
import time
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["hold", "is_held", "partial_folder", "remove_left", "replace_when_complete"]

#: Seconds that a folder must be held for to count as held.
PATIENCE = 1.0


@contextmanager
def partial_folder(parent, prefix):
    """
    A folder of this process alone, which is gone in the end.

    Parameters
    ----------
    parent : `~pathlib.Path`
    prefix : str
        What its name begins with.  Folders of such names that killed
        processes left are taken away, see `remove_left`.

    Yields
    ------
    `~pathlib.Path`
        What is in it when the block ends is deleted, unless the folder has
        another name by then.

    Raises
    ------
    OSError
        If it cannot be made.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.partial import partial_folder
    >>> Path("out").mkdir()
    >>> with partial_folder(Path("out"), ".partial-") as folder:
    ...     _ = (folder / "a.txt").write_text("done")
    ...     (folder / "a.txt").replace("out/a.txt").name
    'a.txt'
    >>> [path.name for path in Path("out").iterdir()]
    ['a.txt']
    """
    remove_left(parent, prefix)
    folder, lock = _make(parent, prefix)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _release(lock)


@contextmanager
def replace_when_complete(path, *, overwrite=False):
    """
    A temporary file beside ``path`` that takes its name in the end.

    Parameters
    ----------
    path : str or path-like
    overwrite : bool

    Yields
    ------
    `~pathlib.Path`
        What to write.  If the block raises it is deleted and ``path`` is as
        it was.

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


def _make(parent, prefix):
    while True:
        folder = Path(parent) / f"{prefix}{_machine()}-{secrets.token_hex(4)}"
        folder.mkdir()
        with suppress(BlockingIOError):
            lock = _lock(folder)
            # Somebody may have taken it for left before it was locked.
            if folder.exists():
                return folder, lock
            _release(lock)


def remove_left(parent, prefix):
    """
    Take away the folders of `partial_folder` that killed processes left.

    Only what was made on this machine and nobody holds is taken away.  A process
    holds its folder by a lock that ends with it, however it ends; where the
    system has no such locks nothing is taken away.

    Parameters
    ----------
    parent : `~pathlib.Path`
    prefix : str

    Returns
    -------
    list of `~pathlib.Path`
        Folders of such names that stay.
    """
    try:
        paths = sorted(Path(parent).iterdir())
    except OSError:
        return []
    # The machine, and something of its own.
    names = re.compile(re.escape(prefix) + "[0-9a-f]{8}-[0-9a-f]{8}")
    stay = []
    for path in paths:
        if not names.fullmatch(path.name) or path.is_symlink() or not path.is_dir():
            continue
        with suppress(OSError), hold(path) as held:
            if held and path.name.startswith(prefix + _machine()):
                shutil.rmtree(path)
        if path.exists():
            stay.append(path)
    return stay


def _machine():
    """The name of this machine as eight digits."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


@contextmanager
def hold(folder):
    """
    Hold a folder while in this context, where the system can lock folders.

    Parameters
    ----------
    folder : path

    Yields
    ------
    bool
        Whether it can.

    Raises
    ------
    BlockingIOError
        If another process, or another part of this one, holds it.
    """
    lock = _lock(folder)
    try:
        yield lock is not None
    finally:
        _release(lock)


def is_held(folder):
    """
    Whether a process holds a folder.

    The workers of a process that was killed hold what it held until they end,
    which is waited for.

    Parameters
    ----------
    folder : path

    Returns
    -------
    bool
        False also where that cannot be known.
    """
    limit = time.monotonic() + PATIENCE
    while True:
        try:
            with hold(folder):
                return False
        except BlockingIOError:
            if time.monotonic() > limit:
                return True
            time.sleep(PATIENCE / 50)


def _lock(folder):
    """An open file that holds the folder, or None where that is not possible."""
    number = None
    try:
        import fcntl

        number = os.open(folder, os.O_RDONLY)
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (ImportError, OSError) as error:
        _release(number)
        if isinstance(error, BlockingIOError):
            raise
        # Windows, and some disks of networks.
        return None
    return number


def _release(number):
    if number is not None:
        os.close(number)
