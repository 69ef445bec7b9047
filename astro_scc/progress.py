# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Progress of long calculations, on standard error."""

import sys
import threading
import time
from contextlib import contextmanager

#: Seconds between two lines of progress where there is no terminal.
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
        with _lines(total, label) as update:
            yield update


@contextmanager
def _lines(total, label):
    """Print a line every `EVERY` seconds, even if no step has ended since."""
    done, begun, ended = 0, time.monotonic(), threading.Event()

    def update(number):
        nonlocal done
        done += number

    def tell():
        while not ended.wait(EVERY):
            steps = f"{done} of {total}" if total else f"{done} done"
            minutes = (time.monotonic() - begun) / 60
            sys.stderr.write(f"{label}: {steps}, {minutes:.1f} min\n")
            sys.stderr.flush()

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield update
    finally:
        ended.set()
        teller.join()
