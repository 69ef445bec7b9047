# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Lists of model components: their files, and images of them."""
