# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Components: lists of Gaussians, read from files and restored to images."""
