# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Alignment: how far the epochs are displaced, and the shifts that undo it."""
