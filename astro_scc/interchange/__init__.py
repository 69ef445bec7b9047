# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Interchange of epochs with the containers of other packages."""

from astro_scc.interchange.containers import from_ndcube, to_ndcube

__all__ = ["from_ndcube", "to_ndcube"]
