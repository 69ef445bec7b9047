# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Interchange of epochs with the containers of other packages."""
