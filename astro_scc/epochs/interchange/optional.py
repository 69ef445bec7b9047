# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Packages that are needed for one format only."""

from importlib import import_module

__all__ = ["optional"]


def optional(package, purpose, extra):
    """
    Import a package that is not installed with this one.

    Parameters
    ----------
    package : str
        Name of the module.
    purpose : str
        What it is needed for.
    extra : str
        Of this package, that installs it.

    Returns
    -------
    module

    Raises
    ------
    ImportError
        If it is not there, with what to do.
    """
    try:
        return import_module(package)
    except ImportError:
        raise ImportError(
            f"{purpose} needs {package}; install it: pip install 'astro_scc[{extra}]'"
        ) from None
