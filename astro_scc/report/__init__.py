# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Report: an HTML page on a measurement, to read, print and send."""

from astro_scc.report.page import write_report

__all__ = ["write_report"]
