# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stacked cross-correlation of multi-epoch astronomical images."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from astro_scc.epochs import Beam, EpochCube
    from astro_scc.scc import StackedCrossCorrelation, measure_velocities

try:
    from astro_scc._version import version as __version__
except ImportError:
    __version__ = "0.0+unknown"

# Resolved at first use: importing the package must stay cheap.
_PUBLIC = {
    "Beam": "astro_scc.epochs",
    "EpochCube": "astro_scc.epochs",
    "StackedCrossCorrelation": "astro_scc.scc",
    "measure_velocities": "astro_scc.scc",
}
_FOLDERS = frozenset(
    """
    decomposition epochs expansion features flow grid images kinematics measurement
    paper patterns products recovery report simulation spectrum streams visualization
    """.split()
)

__all__ = ["Beam", "EpochCube", "StackedCrossCorrelation", "measure_velocities"]


def __getattr__(name):
    if name in _FOLDERS:
        return import_module(f"astro_scc.{name}")
    if name in _PUBLIC:
        value = getattr(import_module(_PUBLIC[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    return sorted({*globals(), *_PUBLIC, *_FOLDERS})
