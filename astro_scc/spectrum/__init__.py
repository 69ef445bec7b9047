# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The velocity spectrum: how much of the emission moves with each speed; arrays."""
