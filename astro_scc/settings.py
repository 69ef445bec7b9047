# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
The settings of a measurement, each declared once, with default, check, unit and help.

The command line, TOML files, Python and the table in the documentation use the fields
of `Settings`.  Quantities may be text with a unit, ``"2 mas / yr"``.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from functools import partial
from operator import le
from pathlib import Path
from typing import TYPE_CHECKING, Any

from astro_scc import quantities as q

if TYPE_CHECKING:
    import astropy.units as u

__all__ = ["Settings", "read_config"]

#: Commands that have the settings of each group, in the order of files and help.
STACK = ("measure", "profile")
ALL = (*STACK, "track")
GROUPS = {
    "images": ALL,
    "distances": ("profile",),
    "measurement": ALL,
    "features": ("track",),
    "trials": ALL,
    "speeds in units of c": ALL,
}
#: `~astro_scc.kinematics.paper_cosmology`, as text for a file.
PAPER_COSMOLOGY = "H0=71,Om0=0.27"
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


def _cosmology(value):
    from astro_scc.kinematics.cosmology import to_cosmology

    to_cosmology(q.check_text(value))
    return value.strip()


def _beam(value):
    from astro_scc.images.beam import parse_beam

    parse_beam(q.check_text(value))
    return value.strip()


# Checks, and their arguments after the value.
POSITIVE = (q.check_number, 0, math.inf, "must be above 0")
BEAMS = (q.check_number, 0, 5, "must be a part of the beam between 0 and 5")
SPEED = (q.one_quantity, "an angle per time", "2 mas/yr")
ANGLE = (q.one_quantity, "an angle", "2 mas")


def _setting(group, check, text, metavar=None, default=None, *, unit=None, only=None):
    """
    Declare a setting.

    One without ``metavar`` is not on the command line; ``unit`` is for calculations.
    """
    facts = {"group": group, "help": text, "metavar": metavar, "unit": unit}
    facts |= {"check": check if isinstance(check, tuple) else (check,)}
    facts |= {"commands": only or GROUPS[group]}
    return field(default=default, metadata=facts)


_image = partial(_setting, "images")
_measure = partial(_setting, "measurement")
_stack = partial(_setting, "measurement", only=STACK)
_distance_bin = partial(_setting, "distances")
_feature = partial(_setting, "features")
_trial = partial(_setting, "trials")
_in_c = partial(_setting, "speeds in units of c")


@dataclass(frozen=True, kw_only=True)
class MeasurementSettings:
    """The settings of `~astro_scc.StackedCrossCorrelation`."""

    scales: u.Quantity | Sequence[float | str] | None = _measure(
        q.check_scales,
        'wavelet scales by number (j is 2^j pixels) or angle, "0.2 mas, 0.4 mas"; '
        "by default from a quarter of the beam to two beams, without a beam up to half "
        "of the size of the structures",
        "1,2,3",
    )
    max_speed: u.Quantity | str | None = _stack(
        SPEED,
        "largest proper motion; default 1.5 beams in the shorter intervals, four of "
        "up to 20 epochs",
        '"2 mas/yr"',
        unit="mas / yr",
    )
    position_angle: Any = _stack(
        q.check_position_angle,
        "direction of the jet, north through east: velocities along and across it; fit "
        "for that of the mean image, ridge for along its ridge line, radial for away "
        "from the reference pixel, any for east and north; by default fit for a "
        "one-sided jet, or else any",
        '"65 deg"|fit|ridge|radial|any',
        unit="deg",
    )
    baseline: u.Quantity | Sequence[str] | None = _stack(
        (q.check_range, "a shortest and a longest time", "0.2 yr 1.0 yr", 0, le),
        "compare only epochs whose separation in time is in this range; by default "
        "each speed has the intervals in which it moves 0.2 to 1 beam",
        '"0.2 yr 1.0 yr"',
        unit="yr",
    )
    min_error_beams: float = _stack(
        BEAMS, "smallest error of a displacement, in beams; default 0.2", "0.2", 0.2
    )
    kappa: float = _stack(
        q.CORRELATION["kappa"],
        "smallest correlation of a match; default 0.6",
        "0.6",
        0.6,
    )
    target: str = _stack(
        q.CORRELATION["target"],
        "what a pattern is correlated with: the patterns of the other epoch or its "
        'whole "plane"',
        default="segments",
    )
    min_overlap: float = _stack(
        q.CORRELATION["min_overlap"],
        "part of a pattern that must lie on good pixels",
        default=0.8,
    )
    wavelet: str = _measure(
        (q.check_choice, "b1", "b3"), 'low-pass filter, or "b3"', default="b1"
    )
    detection: float = _measure(
        POSITIVE, "threshold of patterns, in sigma", default=4.0
    )
    segmentation: float = _measure(
        POSITIVE, "threshold of the pixels of patterns, in sigma", default=3.0
    )
    noise: str = _measure(
        (q.check_choice, *q.NOISES),
        'estimate of the noise of wavelet planes, or "local", "propagated"',
        default="plane",
    )
    alpha: float = _stack(
        (q.check_number, 0, 1, "must be between 0 and 1"),
        "largest p_global of motion",
        default=0.05,
    )
    outward: bool = _stack(
        q.check_boolean,
        "search only speeds away from the core, where position_angle is given",
        "true|false",
        False,
    )
    alignment_error: u.Quantity | Sequence[str] | None = _stack(
        q.check_alignment_error,
        'error of the alignment, "0.02 mas", or a list with one per epoch; by default '
        "what align found",
        unit="mas",
    )
    small_displacement_correction: bool = _stack(
        q.check_boolean,
        "shift the permuted images of the z-score by a fifth of the beam",
        default=False,
    )
    common_beam: bool | None = _image(
        q.check_boolean,
        "convolve to the smallest beam that contains all; the default where beams "
        "differ",
        "true|false",
    )


@dataclass(frozen=True, kw_only=True)
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

    epochs: Sequence[str] | None = _image(
        q.check_paths,
        "one image per date, a file that EpochCube.write made, or lists of components "
        "(difmap .mod, AIPS CC, .ecsv, .mrt) to restore with --beam; in a file also "
        "patterns",
        "EPOCH.fits",
    )
    beam: str | None = _image(
        _beam,
        "beam of all images, instead of those in their headers, and that with which "
        "lists of components are restored; default that of each file",
        '"1.0 mas 0.5 mas -7 deg"',
    )
    after: str | None = _image(
        q.check_date, "take epochs of this date or later", "2001-01-01"
    )
    before: str | None = _image(
        q.check_date, "take epochs before this date", "2011-01-01"
    )
    align: str | None = _image(
        q.check_text,
        "align the epochs on their reference pixels (none), on the core that is fitted "
        "in each, on one another by correlation, on their absolute coordinates (wcs; "
        "not for VLBI), or by a table (CSV or ECSV) of dates and offsets of the core; "
        "by default none, or core where the epochs scatter by more than 0.2 beams",
        "none|core|correlate|wcs|TABLE",
    )
    crop: str | None = _image(
        q.check_text,
        "read no more of the images than the box around a DS9 or CRTF region, where "
        "all are more than the memory holds",
        "FILE.reg",
    )
    region: str | None = _image(
        q.check_text, "use only patterns inside a DS9 or CRTF region", "FILE.reg"
    )
    bins: u.Quantity | Sequence[str] | None = _distance_bin(
        q.check_bins,
        "limits of the bins, distances from the core; needed here or in --config",
        '"0.5 1.5 2.5 mas"',
    )
    window: u.Quantity | str | None = _distance_bin(
        ANGLE,
        "windows of this width about each of the --bins, instead of bins between",
        '"2 mas"',
    )
    detections: str = _feature(
        (q.check_choice, "gaussians", "ssp"),
        "what features are made of: models of the images by gaussians, the default "
        "where there are beams, or ssp, the patterns of all scales",
        "gaussians|ssp",
        "gaussians",
    )
    n_trials: int | None = _trial(
        (q.check_integer, 2, 10**9),
        "permutations of the epochs; the paper's z-score and error take 200 at most; "
        "default 1000",
        "1000",
        only=STACK,
    )
    seed: int | None = _trial(
        (q.check_integer, 0, 2**63 - 1),  # FITS and TOML keep integers of 64 bits
        "of the random numbers; drawn and written down by default",
        "N",
    )
    redshift: float | str | u.Quantity | None = _in_c(
        (_of_object, "redshift"), "of the object, also in percent", "Z"
    )
    cosmology: str | None = _in_c(
        _cosmology,
        "for the redshift, as Planck18 or by parameters; default H0=71,Om0=0.27 "
        "(Mertens & Lobanov 2016)",
        'NAME|"H0=71,Om0=0.27"',
    )
    distance: u.Quantity | str | None = _in_c(
        (_of_object, "distance"), "of a near object, without a redshift", '"16.7 Mpc"'
    )

    def __post_init__(self):
        for name in OPTIONS:
            object.__setattr__(self, name, check_setting(name, getattr(self, name)))
        by_redshift = self.redshift is not None or self.cosmology is not None
        if self.distance is not None and by_redshift:
            text = "distance needs neither redshift nor cosmology; leave one out"
            raise ValueError(text)
        if self.redshift is not None and self.cosmology is None:
            object.__setattr__(self, "cosmology", PAPER_COSMOLOGY)
        if self.cosmology is not None and self.redshift is None:
            raise ValueError("cosmology needs a redshift")

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
        return {
            name: _plain(getattr(self, name))
            for name, facts in OPTIONS.items()
            if command in facts["commands"] and getattr(self, name) is not None
        }

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
    if getattr(value, "shape", ()) or isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if hasattr(value, "unit"):
        return f"{float(value.value)!r} {value.unit}"
    # Whole numbers read better without a point, and TOML cannot hold numpy's.
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < 1e15 else float(value)
    return value


#: Metadata of each setting by its name, in the order of the groups.
OPTIONS = {
    one.name: one.metadata | {"default": one.default}
    for group in GROUPS
    for one in sorted(fields(Settings), key=lambda one: one.name != "epochs")
    if one.metadata["group"] == group
}


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


def require(name, value):
    """Return the value of a setting in the unit of calculations; None stays None."""
    found, unit = check_setting(name, value), OPTIONS[name]["unit"]
    return found.to(unit) if unit and hasattr(found, "to") else found


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
