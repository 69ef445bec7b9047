# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The program as ``python -m astro_scc``."""

import sys

from astro_scc.cli import main

if __name__ == "__main__":
    sys.exit(main())
