# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The command line, ``astro-scc``."""

from astro_scc.cli.program import main

__all__ = ["main"]
