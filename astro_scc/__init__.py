# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stacked cross-correlation of multi-epoch astronomical images."""
