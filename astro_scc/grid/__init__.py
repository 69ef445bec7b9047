# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Coordinates along and across the flow: the one home of its direction."""
