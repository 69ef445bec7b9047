# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The command line, ``astro-scc``."""

import argparse

from astro_scc import __version__

__all__ = ["main"]


def main(argv=None):
    """
    Run the command line.

    Parameters
    ----------
    argv : list of str, optional
        Arguments; those of the process when not given.

    Returns
    -------
    int
        Exit status.
    """
    parser = argparse.ArgumentParser(
        prog="astro-scc",
        description="Velocities in multi-epoch images by stacked cross-correlation.",
    )
    parser.add_argument(
        "--version", action="version", version=f"%(prog)s {__version__}"
    )
    parser.parse_args(argv)
    return 0
