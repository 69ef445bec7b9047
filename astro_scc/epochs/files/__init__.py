# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Files: images with their headers read, checked and written, as series of epochs."""
