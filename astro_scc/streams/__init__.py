# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams: from the velocity spectrum and the features to velocities on the sky."""
