# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Progress of long calculations, on standard error."""

import sys
import time
from contextlib import contextmanager

#: Least seconds between two lines of progress where there is no terminal.
EVERY = 30


@contextmanager
def progress(total, label, *, show=True):
    """
    Show a progress bar, or lines of text where there is no terminal.

    Parameters
    ----------
    total : int or None
        Number of steps, if it is known.
    label : str
    show : bool, optional
        If False, nothing is shown and nothing imported.

    Yields
    ------
    callable
        To be called with the number of steps done since the last call.

    Examples
    --------
    >>> from astro_scc.progress import progress
    >>> with progress(10, "Waiting", show=False) as done:
    ...     done(10)
    """
    if not show or total == 0:
        yield lambda number: None
    # A notebook is not a terminal, but it can show the bar.
    elif sys.stderr.isatty() or "ipykernel" in sys.modules:
        from tqdm import tqdm

        with tqdm(total=total, desc=label, dynamic_ncols=True) as bar:
            yield bar.update
    else:
        yield _lines(total, label)


def _lines(total, label):
    """Return a function of steps that prints a line no sooner than `EVERY` seconds."""
    begun = said = time.monotonic()
    done = 0

    def update(number):
        nonlocal done, said
        done += number
        now = time.monotonic()
        if now - said >= EVERY:
            said = now
            steps = f"{done} of {total}" if total else f"{done} done"
            sys.stderr.write(f"{label}: {steps}, {(now - begun) / 60:.1f} min\n")
            sys.stderr.flush()

    return update
