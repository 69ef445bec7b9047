# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Redshifts, distances, apparent speeds, and the speeds of flows behind them."""

from __future__ import annotations

import re
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy import constants
from numpy.typing import ArrayLike

from astro_scc.columns import describe, round_to_errors
from astro_scc.exceptions import warn
from astro_scc.quantities import NUMBER, named, parse_quantities, to_quantity
from astro_scc.units import PM_UNIT

if TYPE_CHECKING:
    from astropy.cosmology import FLRW, FlatLambdaCDM

#: What apparent speeds follow from, in the meta of tables.
SOURCE = "redshift", "cosmology", "distance"
#: Speeds of sources within this distance are also in km/s.
NEAR = 1 * u.Mpc
KM_S = u.km / u.s
#: Jets that are known have at most 50 c (Lister et al. 2016, AJ 152, 12); twice as fast
#: a stream is doubted.
FASTEST = 100.0
_PARAMETER = re.compile(rf"\s*(\w+)\s*=\s*({NUMBER})\s*")


def paper_cosmology() -> FlatLambdaCDM:
    """
    Return the cosmology of Mertens & Lobanov (2016).

    It is used for every redshift that is given without a cosmology.

    Returns
    -------
    `~astropy.cosmology.FlatLambdaCDM`
        H0 = 71 km/s/Mpc, Om0 = 0.27.

    Examples
    --------
    >>> from astro_scc.kinematics import paper_cosmology
    >>> paper_cosmology().H0
    <Quantity 71. km / (Mpc s)>
    """
    return _cosmology("FlatLambdaCDM", H0=71, Om0=0.27)


@cache
def _cosmology(kind, **parameters):
    """Return a cosmology, which takes astropy some 20 ms to make."""
    from astropy import cosmology

    return getattr(cosmology, kind)(**parameters)


def to_cosmology(value=None):
    """
    Return a cosmology from its name, its parameters or the meta of a table.

    Parameters are in km/s/Mpc and as fractions: ``H0=71, Om0=0.27`` for a flat
    universe, and also ``Ode0`` for any other.  Without a value the result is
    `paper_cosmology`, whatever astropy's own default is.
    """
    from astropy import cosmology

    if value is None:
        return paper_cosmology()
    if isinstance(value, cosmology.FLRW):
        return value
    if isinstance(value, dict):
        with suppress(KeyError, TypeError, ValueError):
            return cosmology.Cosmology.from_format(value, format="mapping")
    name = value.strip() if isinstance(value, str) else ""
    if name in cosmology.available:
        return getattr(cosmology, name)
    matches = [_PARAMETER.fullmatch(part) for part in name.split(",")]
    if all(matches):
        values = {match[1]: float(match[2]) for match in matches}
        kinds = {"H0 Om0": "FlatLambdaCDM", "H0 Ode0 Om0": "LambdaCDM"}
        kind = kinds.get(" ".join(sorted(match[1] for match in matches)))
        if kind and values["H0"] > 0 and np.all(np.isfinite([*values.values()])):
            return _cosmology(kind, **values)
    raise ValueError(
        "is no cosmology; give H0=71,Om0=0.27 (and Ode0 unless it is flat) or one of "
        f"{', '.join(sorted(cosmology.available))}"
    )


def cosmology_text(cosmology):
    """Return a short text about a cosmology, in any form that `to_cosmology` takes."""
    cosmology = to_cosmology(cosmology)
    name = f"{cosmology.name}, " if cosmology.name else ""
    hubble = cosmology.H0.to_value(u.km / u.s / u.Mpc)
    curved = "" if cosmology.is_flat else f", Ode0 = {cosmology.Ode0:g}"
    return (
        f"{name}{type(cosmology).__name__} with H0 = {hubble:g} km/s/Mpc, "
        f"Om0 = {cosmology.Om0:g}{curved}"
    )


def to_redshift(value):
    """
    Return a redshift, or an array of redshifts, as plain numbers between 0 and 30.

    It may be given as a number, as text, in per cent, or in the unit ``redshift`` of
    `astropy.cosmology.units`.  A velocity is refused because it has three
    definitions (c z, the radio convention and the relativistic one), and a length
    because it is a distance.
    """
    import astropy.cosmology.units as cu

    wanted = "must be a redshift, a number such as 0.158"
    try:
        if isinstance(value, bool | np.bool_) or np.any(getattr(value, "mask", False)):
            raise TypeError
        if isinstance(value, str) and not re.fullmatch(rf"\s*{NUMBER}\s*", value):
            (value,) = parse_quantities(value)
        z = u.Quantity(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(wanted) from None
    if z.unit.is_equivalent(u.m):
        raise u.UnitConversionError("is a length; give it as the distance")
    if z.unit.is_equivalent(u.m / u.s):
        found = (z / constants.c).to_value(u.one)
        raise u.UnitConversionError(
            f"is a velocity, which may be defined in three ways; give the redshift, "
            f"{found:.4g} if it is c z"
        )
    try:
        z = z.to_value(cu.redshift, cu.dimensionless_redshift())
    except u.UnitConversionError:
        raise u.UnitConversionError(wanted) from None
    if not np.all(z > 0):
        raise ValueError("must be above 0; give the distance of a nearby source")
    # Nothing with parts to follow is known beyond half of it: larger ones are mistakes.
    if not np.all(z < 30):
        raise ValueError("must be below 30; of a velocity c z give z")
    return z if np.ndim(z) else float(z)


def to_distance(value):
    """Return a distance, a positive length, from a quantity or text."""
    distance = to_quantity(value, u.Mpc, "must be a length with a unit, as '16.7 Mpc'")
    if not np.all((distance > 0) & np.isfinite(distance)):
        raise ValueError("must be finite and above 0")
    return distance


def apparent_speed(
    proper_motion: u.Quantity, *, redshift: float | str | u.Quantity | None = None,
    cosmology: FLRW | str | dict | None = None,
    distance: u.Quantity | str | None = None,
) -> u.Quantity:  # fmt: skip
    """
    Return the apparent speed of a proper motion, in units of c.

    It is ``beta_app = mu D_M / c = mu D_A (1 + z) / c``, with the transverse
    comoving distance ``D_M`` of the redshift (in a flat universe the
    comoving distance), or ``mu D / c`` with the distance of a nearby
    source.  The factor (1 + z) accounts for time dilation.

    Parameters
    ----------
    proper_motion : `~astropy.units.Quantity`
        Angle per time, of any shape.
    redshift : float, str or `~astropy.units.Quantity`, optional
        A number, per cent, or in the unit ``redshift`` of
        `astropy.cosmology.units`, between 0 and 30.
    cosmology : `~astropy.cosmology.FLRW`, str or dict, optional
        Cosmology for the redshift: an object, the name of a realization of
        `astropy.cosmology` such as ``Planck18``, parameters such as ``H0=71,
        Om0=0.27``, or the entry in the meta of a table; by default
        `paper_cosmology`.  The result depends on it by several per cent.
    distance : `~astropy.units.Quantity` or str, optional
        Length, instead of a redshift and a cosmology.

    Returns
    -------
    `~astropy.units.Quantity`
        Dimensionless, with the shape of ``proper_motion``.

    Raises
    ------
    ValueError
        If neither a redshift nor a distance is given, or both; if a cosmology
        is given with a distance; or if one of them is not allowed.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.kinematics import apparent_speed
    >>> apparent_speed(1 * u.mas / u.yr, redshift="15.8 %").round(2)
    <Quantity 10.2>
    >>> apparent_speed(1 * u.mas / u.yr, redshift=0.158, cosmology="Planck18").round(2)
    <Quantity 10.65>
    >>> apparent_speed(1 * u.mas / u.yr, distance=16.7 * u.Mpc).round(3)
    <Quantity 0.264>
    """
    wanted = "must be an angle per time, such as '2 mas/yr'"
    motion = named("proper_motion", to_quantity, proper_motion, "mas/yr", wanted)
    given = _source(redshift, cosmology, distance)
    distance = given.get("distance")
    if distance is None:
        distance = given["cosmology"].comoving_transverse_distance(given["redshift"])
    motion = motion.to_value(u.rad / u.yr) / u.yr
    return (motion * distance.to(u.Mpc) / constants.c).to(u.dimensionless_unscaled)


def table_in_c(table, *, redshift=None, cosmology=None, distance=None):
    """
    Return a copy of a table of proper motions with speeds in units of c.

    ``beta_app`` and ``beta_app_err`` follow from the columns ``pm`` and
    ``pm_err``, see `apparent_speed`; of sources within 1 Mpc, ``v_app`` and its error
    are the same in km/s.  The redshift and the cosmology, or the
    distance, are in its meta.  The cosmology is a dictionary that any reader of
    ECSV understands and that `to_cosmology` takes.  Streams that move at more than
    twice the speed of any known jet are warned of.
    """
    given = _source(redshift, cosmology, distance)
    for name, value in given.items():
        if np.size(value) > 1:
            raise ValueError(f"{name} must be one value, that of the source")
    table = table.copy()
    for name in ("", "_err"):
        table[f"beta_app{name}"] = apparent_speed(table[f"pm{name}"], **given)
    moves = "kind" in table.colnames and np.asarray(table["kind"] == "moving")
    fastest = np.max(table["beta_app"].value, where=moves, initial=0.0)
    if fastest > FASTEST:
        warn(
            f"a stream moves at {fastest:.3g} c, and no jet is known to exceed "
            "50 c: check the scale of the pixels, and the redshift or distance"
        )
    if given.get("distance", NEAR) < NEAR:
        for name in ("", "_err"):
            table[f"v_app{name}"] = (table[f"beta_app{name}"] * constants.c).to(KM_S)
    describe(table, "added")
    if "cosmology" in given:
        plain = given["cosmology"].to_format("mapping", cosmology_as_str=True)
        # A cosmology object can be read only after astropy.cosmology is imported.
        given["cosmology"] = {
            k: v for k, v in plain.items() if k != "meta" and v is not None
        }
    table.meta.update(given)
    return round_to_errors(table)


def table_in_c_as(table, other):
    """
    Return a table of proper motions with speeds in units of c as another one has.

    Parameters
    ----------
    table : `~astropy.table.QTable`
    other : `~astropy.table.QTable`
        Of the same source.

    Returns
    -------
    `~astropy.table.QTable`
        The same table if the meta of the other has neither a redshift nor a distance,
        see `table_in_c`.
    """
    given = _given(other.meta)
    return table_in_c(table, **given) if given else table


def beta_per_pm(table):
    """
    Return the speed in units of c of 1 mas/yr at the source of a table.

    Parameters
    ----------
    table : `~astropy.table.QTable`

    Returns
    -------
    float or None
        None if its meta has neither a redshift nor a distance, see `table_in_c`.
    """
    given = _given(table.meta)
    return float(apparent_speed(1 * PM_UNIT, **given)) if given else None


def _given(meta):
    """Return what apparent speeds follow from, of the meta of a table."""
    return {k: meta[k] for k in SOURCE if meta.get(k) is not None}


def source_text(meta):
    """Return what apparent speeds follow from as text, empty if there are none."""
    if "distance" in meta:
        return f"distance {meta['distance']:g}"
    if "redshift" in meta:
        return f"redshift {meta['redshift']:g}, {cosmology_text(meta['cosmology'])}"
    return ""


def _source(redshift, cosmology, distance):
    """Return the given redshift and cosmology, or the given distance."""
    if (redshift is None) == (distance is None):
        raise ValueError(
            "give either a redshift, of which the cosmology may be given, or a distance"
        )
    if distance is None:
        given = {"redshift": named("redshift", to_redshift, redshift)}
        return given | {"cosmology": named("cosmology", to_cosmology, cosmology)}
    if cosmology is not None:
        raise ValueError("a distance needs no cosmology; leave it out")
    return {"distance": named("distance", to_distance, distance)}


# -- flows behind apparent speeds --------------------------------------------------


def _in_units_of_c(value):
    """Return speeds as plain numbers in units of c."""
    speed = u.Quantity(value, dtype=float)
    if not speed.unit.is_equivalent(u.one):
        raise u.UnitConversionError(
            f"speeds must be in units of c, got {speed.unit}: divide them by "
            "astropy.constants.c"
        )
    return speed.to_value(u.one)


def beta_intrinsic(beta_app: ArrayLike, viewing_angle: u.Quantity) -> u.Quantity:
    """
    Return the speed of a flow from its apparent speed, in units of c.

    It is ``beta = beta_app / (sin t + beta_app cos t)``, the inverse of
    ``beta_app = beta sin t / (1 - beta cos t)``.

    Parameters
    ----------
    beta_app : array_like or `~astropy.units.Quantity`
        Apparent speeds in units of c, not negative.
    viewing_angle : `~astropy.units.Quantity`
        Angle between the flow and the line of sight.

    Returns
    -------
    `~astropy.units.Quantity`
        Dimensionless; NaN where no speed below c gives ``beta_app``.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.kinematics import beta_intrinsic
    >>> beta_intrinsic([4, 10], 15 * u.deg).round(4)
    <Quantity [0.9703,    nan]>
    """
    beta_app = _in_units_of_c(beta_app)
    angle = u.Quantity(viewing_angle).to_value(u.rad)
    with np.errstate(divide="ignore", invalid="ignore"):
        beta = beta_app / (np.sin(angle) + beta_app * np.cos(angle))
    return np.where((beta >= 0) & (beta < 1), beta, np.nan) * u.one


def lorentz_factor(beta: ArrayLike) -> u.Quantity:
    """
    Return the Lorentz factor ``1 / sqrt(1 - beta^2)`` of a speed.

    Parameters
    ----------
    beta : array_like or `~astropy.units.Quantity`
        Speeds in units of c.

    Returns
    -------
    `~astropy.units.Quantity`
        Dimensionless; NaN where ``abs(beta) >= 1``.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.kinematics import beta_intrinsic, lorentz_factor
    >>> lorentz_factor(beta_intrinsic([4, 6], 15 * u.deg)).round(2)
    <Quantity [4.13, 7.48]>
    """
    beta = _in_units_of_c(beta)
    with np.errstate(divide="ignore", invalid="ignore"):
        gamma = 1 / np.sqrt(1 - beta**2)
    return np.where(np.abs(beta) < 1, gamma, np.nan) * u.one


def minimum_lorentz_factor(beta_app: ArrayLike) -> u.Quantity:
    """
    Return the smallest Lorentz factor that can show an apparent speed.

    It is ``Gamma_min = sqrt(1 + beta_app^2)``, at the viewing angle with
    ``cos t = beta``.  Conversely, a Lorentz factor shows at most ``sqrt(Gamma^2 - 1)``,
    5.92 c for a Lorentz factor of 6.  Mertens & Lobanov (2016) explain a change from
    4 c to 6 c at that Lorentz factor by a change of viewing angle, which is not
    possible: 6 c needs at least 6.08, and 7.48 at 15 degrees.

    Parameters
    ----------
    beta_app : array_like or `~astropy.units.Quantity`
        Apparent speeds in units of c.

    Returns
    -------
    `~astropy.units.Quantity`
        Dimensionless.

    Examples
    --------
    >>> from astro_scc.kinematics import minimum_lorentz_factor
    >>> minimum_lorentz_factor(6).round(2)
    <Quantity 6.08>
    """
    return np.sqrt(1 + _in_units_of_c(beta_app) ** 2) * u.one


def doppler_factor(beta: ArrayLike, viewing_angle: u.Quantity) -> u.Quantity:
    """
    Return the Doppler factor ``1 / (Gamma (1 - beta cos t))`` of a flow.

    Parameters
    ----------
    beta : array_like or `~astropy.units.Quantity`
        Speeds of the flow in units of c.
    viewing_angle : `~astropy.units.Quantity`
        Angle between the flow and the line of sight.

    Returns
    -------
    `~astropy.units.Quantity`
        Dimensionless; NaN where ``abs(beta) >= 1``.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.kinematics import doppler_factor
    >>> doppler_factor(0.9, 10 * u.deg).round(2)
    <Quantity 3.83>
    """
    angle = u.Quantity(viewing_angle).to_value(u.rad)
    beta = _in_units_of_c(beta)
    return 1 / (lorentz_factor(beta) * (1 - beta * np.cos(angle)))


def maximum_viewing_angle(beta_app: ArrayLike) -> u.Quantity:
    """
    Return the largest angle to the line of sight that allows an apparent speed.

    It is ``t_max = 2 atan(1 / beta_app)``, which is approached as the flow's speed
    approaches c; 180 deg for no apparent speed.

    Parameters
    ----------
    beta_app : array_like or `~astropy.units.Quantity`
        Apparent speeds in units of c.

    Returns
    -------
    `~astropy.units.Quantity`

    Examples
    --------
    >>> from astro_scc.kinematics import maximum_viewing_angle
    >>> maximum_viewing_angle(6).round(2)
    <Quantity 18.92 deg>
    """
    return np.degrees(2 * np.arctan2(1, np.abs(_in_units_of_c(beta_app)))) * u.deg


def viewing_angle(beta_app: ArrayLike, doppler: ArrayLike) -> u.Quantity:
    """
    Return the angle to the line of sight from apparent speed and Doppler factor.

    It follows from ``tan t = 2 beta_app / (beta_app^2 + delta^2 - 1)``.

    Parameters
    ----------
    beta_app : array_like or `~astropy.units.Quantity`
        Apparent speeds in units of c, of either sign.
    doppler : array_like or `~astropy.units.Quantity`
        Doppler factors.

    Returns
    -------
    `~astropy.units.Quantity`
        Angles between 0 and 180 deg.

    Examples
    --------
    >>> from astro_scc.kinematics import viewing_angle
    >>> viewing_angle(5, 10).round(1)
    <Quantity 4.6 deg>
    """
    beta_app, doppler = np.abs(_in_units_of_c(beta_app)), _in_units_of_c(doppler)
    return np.degrees(np.arctan2(2 * beta_app, beta_app**2 + doppler**2 - 1)) * u.deg
