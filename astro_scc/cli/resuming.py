# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What an interrupted run leaves behind to go on from."""

from contextlib import contextmanager, suppress
from pathlib import Path

from astro_scc.cli.settings import draw_seed

__all__ = ["WORK", "kept_seed", "working_folder"]

#: Folder for what --resume keeps, in that of the products.
WORK = ".astro_scc-work"
SEED = "seed.txt"


@contextmanager
def working_folder(work, output, *, overwrite):
    """
    Make the folder for what a resumed run needs; leave none without anything.

    Parameters
    ----------
    work : `~pathlib.Path` or None
        None makes nothing.
    output : path
        That of the products, which holds it.
    overwrite : bool
        Whether there may be files.

    Raises
    ------
    OSError
        If the folder has files that are not of an earlier run.
    """
    if work is None:
        yield
        return
    output = Path(output)
    if output.is_dir() and any(output.iterdir()) and not overwrite:
        raise OSError(
            f"{output}: exists and is not of a run with --resume; choose another "
            "folder, or --overwrite"
        )
    made = [p for p in (work, *work.parents) if not p.exists()]
    try:
        work.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"{output}: cannot be made or used: {error.strerror}") from None
    try:
        yield
    except BaseException:
        # A seed alone is nothing to go on from.
        if made and {p.name for p in work.iterdir()} <= {SEED}:
            (work / SEED).unlink(missing_ok=True)
            for folder in made:
                with suppress(OSError):
                    folder.rmdir()
        raise


def kept_seed(work):
    """
    The seed of a run that may be resumed, drawn the first time.

    Parameters
    ----------
    work : `~pathlib.Path` or None
        Without it, one that is not kept.

    Returns
    -------
    int
    """
    if work is None:
        return draw_seed()
    from astro_scc.partial import replace_when_complete

    path = work / SEED
    with suppress(OSError, ValueError):
        return int(path.read_text(encoding="ascii"))
    seed = draw_seed()
    with replace_when_complete(path, overwrite=True) as part:
        part.write_text(f"{seed}\n", encoding="ascii")
    return seed
