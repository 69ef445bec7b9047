# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Progress of long work, on standard error."""

from contextlib import contextmanager

__all__ = ["progress"]


@contextmanager
def progress(total, label, *, show=True):
    """
    Show a progress bar for a while.

    Parameters
    ----------
    total : int
        Number of steps.
    label : str
    show : bool, optional
        Nothing is shown, and nothing imported, if False.

    Yields
    ------
    callable
        Called with the number of steps done.

    Examples
    --------
    >>> from astro_scc.progress import progress
    >>> with progress(10, "Waiting", show=False) as done:
    ...     done(10)
    """
    if not show or total == 0:
        yield lambda number: None
        return
    from tqdm import tqdm

    with tqdm(total=total, desc=label, dynamic_ncols=True) as bar:
        yield bar.update
