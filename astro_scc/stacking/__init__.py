# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocities of matches, their stack, its peaks and z-score, as in the paper."""
