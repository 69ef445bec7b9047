# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Alignment of epochs: where the core is, and shifts."""
