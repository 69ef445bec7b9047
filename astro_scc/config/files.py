# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Settings in TOML files."""

import tomllib
from pathlib import Path

from astro_scc.config.settings import SETTINGS, parse_setting, plain_settings
from astro_scc.quantities import shortened

__all__ = ["format_config", "read_config", "read_toml"]


def read_config(path):
    """
    Read the settings of a measurement.

    Parameters
    ----------
    path : path
        A TOML file.  Its table ``versions``, which says what wrote it, is
        returned as it is.

    Returns
    -------
    settings : dict
        Those that the file has, see `parse_setting`.
    versions : dict of str

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no TOML, or a key or a value in it makes no sense.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.config import read_config
    >>> _ = Path("jet.toml").write_text('epochs = ["jet/*.fits"]\\nn_trials = 500\\n')
    >>> read_config("jet.toml")
    ({'epochs': ['jet/*.fits'], 'n_trials': 500}, {})
    """
    values, _ = read_toml(path)
    versions = values.pop("versions", {})
    if not isinstance(versions, dict):
        raise ValueError(f"{path}: versions must be a table")
    settings = {}
    for name, value in values.items():
        if name not in SETTINGS:
            raise ValueError(
                f"{path}: unknown key {name!r}{_nearest(name)}; "
                "see astro-scc measure --help"
            )
        try:
            settings[name] = parse_setting(name, value)
        except ValueError as error:
            raise ValueError(f"{path}: {name} = {shortened(value)} {error}") from None
    return settings, versions


def read_toml(path):
    """
    Read a TOML file.

    Parameters
    ----------
    path : path

    Returns
    -------
    values : dict
    text : str

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no TOML.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text), text
    except RecursionError:
        raise ValueError(f"{path}: is not a TOML file: nested too deep") from None
    except ValueError as error:
        # Of the encoding, of TOML, of numbers with thousands of digits.
        raise ValueError(f"{path}: is not a TOML file: {error}") from None


def _nearest(name):
    from difflib import get_close_matches

    near = get_close_matches(name.replace("-", "_"), SETTINGS, 1)
    return f", did you mean {near[0]}?" if near else ""


def format_config(settings, *, versions=None, remarks=()):
    """
    Settings as the text of a TOML file.

    Parameters
    ----------
    settings : dict
        See `plain_settings`.
    versions : dict of str, optional
    remarks : sequence of str, optional
        Comments for the head of the file.

    Returns
    -------
    str

    Examples
    --------
    >>> from astro_scc.config import format_config
    >>> print(format_config({"n_trials": 500}, remarks=["A try."]))
    # A try.
    <BLANKLINE>
    n_trials = 500
    <BLANKLINE>
    """
    import tomli_w

    plain = plain_settings(settings)
    if versions:
        plain["versions"] = dict(versions)
    head = "".join(f"# {line}\n" for line in remarks)
    return head + "\n" * bool(head) + tomli_w.dumps(plain)
