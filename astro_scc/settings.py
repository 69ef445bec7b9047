# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
The settings of a measurement, each declared once, with type, check and default.

Their commands, units for calculations and words for the help are in ``settings.csv``,
in the order of files and help; those without a ``metavar`` are not on the command line.
The command line, TOML files, Python and the table in the documentation use these.
Quantities may be text with a unit, ``"2 mas / yr"``.
"""

from __future__ import annotations

import csv
import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from difflib import get_close_matches
from importlib import import_module, resources
from operator import le, lt
from pathlib import Path
from typing import TYPE_CHECKING, Any

from astro_scc import quantities as q

if TYPE_CHECKING:
    import astropy.units as u

__all__ = ["Settings", "read_config"]

#: `~astro_scc.kinematics.paper_cosmology`, as text for a file.
PAPER_COSMOLOGY = "H0=71,Om0=0.27"
#: Settings, and options of the command line, that one method alone uses.
METHODS = {
    "paper": "min_error_beams kappa target min_overlap small_displacement_correction",
    "spectrum": "outward alignment_error ds9_regions compare all_figures",
}
#: Comment at the head of a settings file; the command is filled in.
REMARKS = """\
# What determined the results.  To get them again, in the folder it was done in, with
# the path of this file: astro-scc {} --config FILE -o FOLDER

"""


def _of_object(value, name):
    """Check one redshift or distance by `astro_scc.kinematics.cosmology`."""
    from astro_scc.kinematics import cosmology

    found = getattr(cosmology, f"to_{name}")(value)
    if getattr(found, "shape", ()):
        raise ValueError(f"must be one {name}")
    return found


def _text_for(value, module, parse):
    """Return text that a function can read, whose module is imported when needed."""
    getattr(import_module(f"astro_scc.{module}"), parse)(q.check_text(value))
    return value.strip()


# Checks, and their arguments after the value.
POSITIVE = (q.check_number, 0, math.inf, "must be above 0")
SHARE = (q.check_number, 0, 1, "must be between 0 and 1")
BEAMS = (q.check_number, 0, 5, "must be a part of the beam between 0 and 5")


def _setting(check, *more, default=None):
    """Declare a setting by its check and the arguments of that after the value."""
    return field(default=default, metadata={"check": (check, *more)})


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasurementSettings:
    """The settings of `~astro_scc.StackedCrossCorrelation`."""

    method: str = _setting(q.check_choice, "spectrum", "paper", default="spectrum")
    scales: u.Quantity | Sequence[float | str] | None = _setting(q.check_scales)
    max_speed: u.Quantity | str | None = _setting(
        q.one_quantity, "an angle per time", "2 mas/yr"
    )
    position_angle: Any = _setting(q.check_position_angle)
    baseline: u.Quantity | Sequence[str] | None = _setting(
        q.check_range, "a shortest and a longest time", "0.2 yr 1.0 yr", 0, le
    )
    min_error_beams: float = _setting(*BEAMS, default=0.2)
    kappa: float = _setting(*SHARE, default=0.6)
    target: str = _setting(q.check_choice, "segments", "plane", default="segments")
    min_overlap: float = _setting(
        q.check_number, 0, math.nextafter(1, 2), "must be above 0, up to 1", default=0.8
    )
    wavelet: str = _setting(q.check_choice, "b1", "b3", default="b1")
    detection: float = _setting(*POSITIVE, default=4.0)
    segmentation: float = _setting(*POSITIVE, default=3.0)
    noise: str = _setting(q.check_choice, *q.NOISES, default="plane")
    alpha: float = _setting(*SHARE, default=0.01)
    outward: bool = _setting(q.check_boolean, default=False)
    alignment_error: u.Quantity | Sequence[str] | None = _setting(
        q.check_alignment_error
    )
    small_displacement_correction: bool = _setting(q.check_boolean, default=False)
    common_beam: bool | None = _setting(q.check_boolean)

    def __post_init__(self):
        vars(self).update(self._checked())

    def _checked(self):
        """Return the checked values of all settings, in their units."""
        names = (one.name for one in fields(self))
        return {name: require(name, getattr(self, name)) for name in names}

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return _plain(self) == _plain(other)

    def __hash__(self) -> int:
        return hash(repr(_plain(self)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Settings(MeasurementSettings):
    """
    All settings that determine a measurement.

    Attributes
    ----------
    scales, max_speed, ..., distance
        The settings of `~astro_scc.StackedCrossCorrelation`, the epochs, the trials,
        the distance of the object, and the settings of ``astro-scc profile`` and
        ``track``; the table in :ref:`command_line` explains them.  None means that
        a setting is not given.

    Raises
    ------
    ValueError
        If a value is not allowed.  The message is one line with the name, the value
        and what it must be; the attribute ``setting`` is the name.  For a wrong unit
        it is a `~astropy.units.UnitConversionError`.

    Examples
    --------
    >>> from astro_scc.settings import Settings
    >>> settings = Settings(epochs="3c273/*.fits", max_speed="2 mas/yr", redshift=0.158)
    >>> settings.max_speed, settings.kappa, settings.cosmology
    (<Quantity 2. mas / yr>, 0.6, 'H0=71,Om0=0.27')
    """

    epochs: Sequence[str] | None = _setting(q.check_paths)
    beam: str | None = _setting(_text_for, "images.beam", "parse_beam")
    after: str | None = _setting(q.check_date)
    before: str | None = _setting(q.check_date)
    align: str | None = _setting(q.check_text)
    crop: str | None = _setting(q.check_text)
    region: str | None = _setting(q.check_text)
    bins: u.Quantity | Sequence[str] | None = _setting(
        q.check_range, "increasing distances", "0.5 1.5 2.5 mas", 0, lt, None
    )
    window: u.Quantity | str | None = _setting(q.one_quantity, "an angle", "2 mas")
    scale_groups: Any = _setting(q.check_scale_groups)
    detections: str = _setting(q.check_choice, "gaussians", "ssp", default="gaussians")
    n_trials: int | None = _setting(q.check_integer, 2, 10**9)
    # FITS and TOML keep integers of 64 bits.
    seed: int | None = _setting(q.check_integer, 0, 2**63 - 1)
    redshift: float | str | u.Quantity | None = _setting(_of_object, "redshift")
    cosmology: str | None = _setting(_text_for, "kinematics.cosmology", "to_cosmology")
    distance: u.Quantity | str | None = _setting(_of_object, "distance")

    def _checked(self):
        made = {name: check_setting(name, getattr(self, name)) for name in OPTIONS}
        redshift, cosmology = made["redshift"], made["cosmology"]
        by_redshift = redshift is not None or cosmology is not None
        if made["distance"] is not None and by_redshift:
            text = "distance needs neither redshift nor cosmology; leave one out"
            raise _error(text, "distance")
        if redshift is not None and cosmology is None:
            made["cosmology"] = PAPER_COSMOLOGY
        if cosmology is not None and redshift is None:
            raise _error("cosmology needs a redshift", "cosmology")
        refuse_other_method(made["method"], made)
        return made

    def changed(self, **values: Any) -> Settings:
        """
        Return settings of which some have other values.

        Parameters
        ----------
        **values
            Their names and values.

        Returns
        -------
        `Settings`

        Raises
        ------
        ValueError
            If a value is not allowed, or does not go with the others.
        """
        return replace(self, **values)

    @property
    def in_c(self) -> dict[str, Any]:
        """Options with which ``components_in_c`` turns proper motions into speeds."""
        if self.distance is not None:
            return {"distance": self.distance}
        if self.redshift is not None:
            return {"redshift": self.redshift, "cosmology": self.cosmology}
        return {}

    def to_dict(self, command: str = "measure") -> dict[str, Any]:
        """
        Return the settings of a command as text, numbers and lists.

        Parameters
        ----------
        command : str, optional
            "measure", "profile" or "track".

        Returns
        -------
        dict
            Without the settings that are None.  `Settings` makes the same values
            from it, to the last bit.
        """
        names = [k for k, facts in OPTIONS.items() if command in facts["commands"]]
        given = {name: getattr(self, name) for name in names}
        return {name: _plain(v) for name, v in given.items() if v is not None}

    def to_toml(self, command: str = "measure", *, versions: dict | None = None) -> str:
        """
        Return the settings of a command as the text of a TOML file.

        Parameters
        ----------
        command : str, optional
            See `to_dict`.
        versions : dict of str, optional
            Versions of the software that writes the file.

        Returns
        -------
        str
        """
        import tomli_w

        plain = self.to_dict(command)
        if versions:
            plain["versions"] = dict(versions)
        return REMARKS.format(command) + tomli_w.dumps(plain)


def _plain(value):
    """Return a value as text, numbers, and lists and dictionaries of them."""
    if is_dataclass(value):
        parts = (_plain(getattr(value, one.name)) for one in fields(value))
        return [type(value).__name__, *parts]
    if hasattr(value, "items"):
        return {name: _plain(item) for name, item in value.items()}
    if getattr(value, "shape", ()) or isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if hasattr(value, "unit"):
        return f"{float(value.value)!r} {value.unit}"
    # Whole numbers read better without a point, and TOML cannot hold numpy's.
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < 1e15 else float(value)
    return value


def _read_options():
    """Return check, default and words of each setting, in the order of the file."""
    declared, found = {one.name: one for one in fields(Settings)}, {}
    with resources.files("astro_scc").joinpath("settings.csv").open() as file:
        for row in csv.DictReader(file):
            one = declared.pop(row.pop("name"))
            facts = {key: text or None for key, text in row.items()}
            facts["commands"] = row["commands"].split()
            found[one.name] = facts | {"default": one.default, **one.metadata}
    return found


#: What is known of each setting by its name.
OPTIONS = _read_options()
GROUPS = tuple(dict.fromkeys(facts["group"] for facts in OPTIONS.values()))


def _error(text, name):
    """Return an error that has the name of its setting."""
    error = ValueError(text)
    error.setting = name
    return error


def check_setting(name, value):
    """Return the value of a setting; an error has the attribute ``setting``."""
    if value is None:
        return None
    check, *more = OPTIONS[name]["check"]
    try:
        return q.named(name, check, value, *more)
    except ValueError as error:
        error.setting = name
        raise


def refuse_other_method(method, given):
    """
    Refuse what another method alone uses.

    Parameters
    ----------
    method : str
    given : dict
        Values of settings, or of arguments of the command line, by their names.
    """
    other = "spectrum" if method == "paper" else "paper"
    for name in METHODS[other].split():
        known = OPTIONS.get(name, {"default": None})
        if _plain(given.get(name)) not in (None, False, known["default"]):
            # What is no setting is an option.
            shown = name if name in OPTIONS else f"--{name.replace('_', '-')}"
            raise _error(f"{shown} is for method {other}: leave it out", name)


def require(name, value):
    """Check the value of a setting and return it in the unit of calculations."""
    value, unit = check_setting(name, value), OPTIONS[name]["unit"]
    return value.to(unit) if unit and hasattr(value, "to") else value


def read_toml(path):
    """Return the values of a TOML file, and its text."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        return tomllib.loads(text), text
    except RecursionError:
        raise ValueError(f"{path}: is not a TOML file: nested too deep") from None
    except ValueError as error:
        # Errors of the encoding, of TOML, of numbers with thousands of digits.
        raise ValueError(f"{path}: is not a TOML file: {error}") from None


def read_config(path: Path | str) -> tuple[dict[str, Any], dict[str, str]]:
    """
    Read the settings of a measurement.

    Parameters
    ----------
    path : path
        A TOML file.  Its table ``versions`` says what wrote it.

    Returns
    -------
    given : dict
        The values as they are in the file, for `Settings`.
    versions : dict of str

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If the file is not TOML, has a key that is not a setting, or a value that is
        not allowed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.settings import Settings, read_config
    >>> _ = Path("jet.toml").write_text("n_trials = 500")
    >>> given, versions = read_config("jet.toml")
    >>> Settings(**given).n_trials
    500
    """
    given, _ = read_toml(path)
    versions = given.pop("versions", {})
    if not isinstance(versions, dict):
        raise ValueError(f"{path}: versions must be a table")
    for name in given:
        if name not in OPTIONS:
            near = get_close_matches(name.replace("-", "_"), OPTIONS, 1)
            hint = f", did you mean {near[0]}?" if near else ""
            raise ValueError(
                f"{path}: unknown key {name!r}{hint}; see astro-scc measure --help"
            )
        try:
            check_setting(name, given[name])
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
    return given, versions
