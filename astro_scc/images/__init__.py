# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images: a series of them, its beam, grid, positions and regions, and its files."""
