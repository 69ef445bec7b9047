# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Grids: images cut, moved, resampled and smoothed on their pixels."""
