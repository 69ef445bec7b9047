# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The elliptical Gaussian beam (PSF): of headers, common to epochs, and at patterns."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
import scipy

from astro_scc.decomposition.wavelet import scale_size
from astro_scc.images.headers import KEYWORDS, axis_numbers, axis_of, get, parse_unit
from astro_scc.quantities import parse_quantities
from astro_scc.units import offset_unit, unit_name

FWHM_TO_SIGMA = 1 / np.sqrt(8 * np.log(2))
#: Keywords of the axes and the angle of a beam.
BEAM = "BMAJ", "BMIN", "BPA"
_NUMBER = r"([-+]?[\d.]+(?:[EeDd][-+]?\d+)?)"
_CLEAN_BEAM = re.compile(
    rf"CLEAN\s+BMAJ\s*=\s*{_NUMBER}\s+BMIN\s*=\s*{_NUMBER}\s+BPA\s*=\s*{_NUMBER}"
)


@dataclass(frozen=True)
class Beam:
    """
    An elliptical Gaussian restoring beam.

    Parameters
    ----------
    major, minor : `~astropy.units.Quantity`
        Full widths at half maximum, scalar angles, ``major >= minor > 0``.
    pa : `~astropy.units.Quantity`, optional
        Position angle of the major axis, north through east.  It is kept
        in the range [-90 deg, 90 deg).

    Raises
    ------
    ValueError
        If an axis is not finite or positive, or ``minor > major``.
    `~astropy.units.UnitConversionError`
        If an argument is not an angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.epochs import Beam
    >>> beam = Beam(1.0 * u.mas, 0.5 * u.mas, -7 * u.deg)
    >>> beam.area.to(u.mas**2).round(3)
    <Quantity 0.567 mas2>
    """

    major: u.Quantity
    minor: u.Quantity
    pa: u.Quantity = 0 * u.deg

    def __post_init__(self):
        major, minor = (u.Quantity(axis).to(u.mas) for axis in (self.major, self.minor))
        pa = u.Quantity(self.pa).to(u.deg)
        if major.shape or minor.shape or pa.shape:
            raise ValueError(
                f"major, minor and pa of a beam are single angles, got {major.size}; "
                "make a list of beams"
            )
        finite = np.all(np.isfinite([major.value, minor.value, pa.value]))
        if not (finite and 0 < minor.value <= major.value * (1 + 1e-9)):
            raise ValueError(
                f"a beam is finite with major >= minor > 0, got {major} x {minor}, {pa}"
            )
        pa = (pa + 90 * u.deg) % (180 * u.deg) - 90 * u.deg
        vars(self).update(major=major, minor=minor, pa=pa)

    def __str__(self):
        unit = max(offset_unit(self.major.value), u.mas)
        major, minor = (axis.to_value(unit) for axis in (self.major, self.minor))
        return f"{major:.3g} x {minor:.3g} {unit_name(unit)} at {self.pa.value:.1f} deg"

    @property
    def area(self) -> u.Quantity:
        """Solid angle, pi major minor / (4 ln 2)."""
        return np.pi * self.major * self.minor / (4 * np.log(2))

    @cached_property
    def covariance(self) -> u.Quantity:
        """
        Covariance of the Gaussian over (east, north), shape (2, 2).

        ``C = s_major^2 p p^T + s_minor^2 q q^T``, where ``p = (sin pa, cos pa)``
        is along the major axis, ``q`` across it, and s are the standard
        deviations.
        """
        along = np.array([np.sin(self.pa), np.cos(self.pa)])
        across = np.array([np.cos(self.pa), -np.sin(self.pa)])
        major = self.major**2 * np.outer(along, along)
        return FWHM_TO_SIGMA**2 * (major + self.minor**2 * np.outer(across, across))

    def fwhm_along(self, position_angle: u.Quantity) -> u.Quantity:
        """
        Return the full width at half maximum of the profile along a direction.

        Parameters
        ----------
        position_angle : `~astropy.units.Quantity`
            Direction, north through east; scalar or array.

        Returns
        -------
        `~astropy.units.Quantity`
            ``sqrt(8 ln 2 d^T C d)``, where d is the unit vector, in mas.
        """
        direction = np.stack([np.sin(position_angle), np.cos(position_angle)])
        variance = np.einsum("i...,ij,j...->...", direction, self.covariance, direction)
        return np.sqrt(variance) / FWHM_TO_SIGMA

    @cached_property
    def _key(self):
        """Covariance to five digits, so that equal beams have equal hashes."""
        values = self.covariance.to_value(u.mas**2)[[0, 0, 1], [0, 1, 1]]
        exponent = int(np.floor(np.log10(values[0] + values[2])))
        return exponent, *np.rint(values / 10.0 ** (exponent - 5)).astype(int).tolist()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Beam):
            return NotImplemented
        return self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


def parse_beam(text):
    """
    Return a beam given as text.

    Parameters
    ----------
    text : str
        One axis, or major axis, minor axis and position angle.

    Returns
    -------
    Beam

    Raises
    ------
    ValueError
        If the text is no beam.

    Examples
    --------
    >>> from astro_scc.images.beam import parse_beam
    >>> print(parse_beam("1.0 mas 0.5 mas -7 deg"))
    1 x 0.5 mas at -7.0 deg
    """
    try:
        found = parse_quantities(text)
        if len(found) not in (1, 3):
            raise ValueError(f"has {len(found)} numbers, not one or three")
        return Beam(*found) if len(found) == 3 else Beam(*found, *found)
    except (ValueError, u.UnitConversionError) as error:
        raise ValueError(
            f"is no beam: {error}; give major axis, minor axis and position angle, "
            "such as '1.0 mas 0.5 mas -7 deg'"
        ) from None


def different_beam(beams, within=0.01):
    """
    Return the index of the first beam that differs from the first one.

    Return None if all widths agree ``within`` a part in every direction, or there are
    no beams.  Headers round widths, and a hundredth affects no displacement.
    """
    if beams is None:
        return None
    covariances = np.array([beam.covariance.value for beam in beams])
    ratios = np.linalg.eigvals(np.linalg.inv(covariances[0]) @ covariances).real
    differs = np.any(np.abs(np.sqrt(ratios) - 1) > within, axis=1)
    return int(np.argmax(differs)) if differs.any() else None


def as_beam(beam):
    """Return a `Beam`, also from an object with major, minor and pa."""
    try:
        return beam if isinstance(beam, Beam) else Beam(beam.major, beam.minor, beam.pa)
    except AttributeError:
        raise TypeError(
            f"a beam has major, minor and pa, got {type(beam).__name__} {beam!r}"
        ) from None


def is_per(unit, *names):
    """Return whether a unit is per one of the given units, "beam" or "pix"."""
    powers = zip(unit.bases, unit.powers, strict=True)
    return any(base.name.lower() in names and power < 0 for base, power in powers)


def beam_of(covariance, unit):
    """Return the beam of a covariance over (east, north) in the square of a unit."""
    variances, axes = np.linalg.eigh(covariance)
    minor, major = np.sqrt(variances) / FWHM_TO_SIGMA * unit
    return Beam(major, minor, np.arctan2(*axes[:, 1]) * u.rad)


def beam_excess(covariance, others):
    """
    Return the largest ratio of the variances of Gaussians to those of one Gaussian.

    It is the largest eigenvalue of ``C^-1 C_i`` for each i, at most 1 for a
    Gaussian that fits into the one with covariance C.
    """
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    return np.linalg.eigvalsh(root @ np.asarray(others) @ root.T)[..., -1]


def contains(covariance, others, within=1e-6):
    """
    Return whether Gaussians fit into one, see `beam_excess`.

    They may be larger ``within`` a part of their variance, by default rounding errors.
    """
    return bool(np.all(beam_excess(covariance, others) <= 1 + within))


def smallest_common_beam(beams: Sequence[Beam]) -> Beam:
    """
    Return the smallest beam to which several beams can all be convolved.

    Its covariance C has the smallest determinant for which no ``C - C_i`` has a
    negative variance.  It is found by a simplex search over axis ratio and
    position angle.

    Parameters
    ----------
    beams : sequence of `~astro_scc.epochs.Beam`

    Returns
    -------
    `~astro_scc.epochs.Beam`
        One of ``beams`` itself if it contains all others.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.epochs import Beam
    >>> beams = [Beam(1 * u.mas, 0.5 * u.mas, pa) for pa in (10 * u.deg, 50 * u.deg)]
    >>> print(smallest_common_beam(beams))
    1.14 x 0.696 mas at 30.0 deg
    """
    covariances = np.array([beam.covariance.value for beam in beams])
    largest = int(np.argmax(np.linalg.det(covariances)))
    if contains(covariances[largest], covariances):
        return beams[largest]

    def shape(p):
        r, angle = np.hypot(*p), np.arctan2(p[1], p[0])
        c, s = np.cos(angle), np.sin(angle)
        return np.cosh(r) * np.eye(2) + np.sinh(r) * np.array([[c, s], [s, -c]])

    def size(p):
        return np.log(beam_excess(shape(p), covariances).max())

    end = {"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000}
    fit = scipy.optimize.minimize(size, [0.1, 0.1], method="Nelder-Mead", options=end)
    least = np.exp(fit.fun) * shape(fit.x)
    # Rounding errors must not leave a beam that does not fit.
    least = least * max(1.0, beam_excess(least, covariances).max() * (1 + 1e-9))
    return beam_of(least, u.mas)


def beam_fwhm(cube, epoch, scale, axes):
    """
    Return the width of the resolution along two axes, in mas.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    epoch : array_like of int, shape (n,)
    scale : array_like, shape (n,)
        Scale numbers of the SSPs.
    axes : `~numpy.ndarray`, shape (2, 2) or (n, 2, 2)
        Rows are the vectors (east, north) of the axes, of unit length except in
        frames that scale with distance.

    Returns
    -------
    `~numpy.ndarray`, shape (n, 2)
        Full width at half maximum of the epoch's beam; for a cube without beams,
        twice the size of the SSP's scale.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.images.beam import beam_fwhm
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> beam_fwhm(cube, [0], [2], np.eye(2))
    array([[1., 1.]])
    """
    covariance = beam_covariance(cube, epoch, scale)
    variance = np.einsum("...ai,...ij,...aj->...a", axes, covariance, axes)
    return np.sqrt(8 * np.log(2) * variance)


def beam_covariance(cube, epoch, scale):
    """
    Return the resolution as covariances of Gaussians, in mas^2, shape (n, 2, 2).

    Parameters
    ----------
    cube, epoch, scale
        See `beam_fwhm`.

    Returns
    -------
    `~numpy.ndarray`, shape (n, 2, 2)
    """
    if cube.beams is None:
        size = np.vectorize(scale_size, otypes=[float])(scale)
        variance = (2 * size * cube.pixel_scale.value) ** 2
        return variance[..., None, None] / (8 * np.log(2)) * np.eye(2)
    each = np.stack([beam.covariance.value for beam in cube.beams])
    return each[np.asarray(epoch)]


def position_errors(snr, fwhm, fraction):
    """
    Return the standard errors of positions.

    ``sigma^2 = (b / (sqrt(2) SNR))^2 + (f b)^2 / 2`` on each axis: the
    thermal error (Fomalont 1999; Mertens & Lobanov 2016, Eq. 2) and a floor
    for errors beyond noise, where f is the ``fraction`` of the beam b by which
    the difference of two positions is uncertain.

    Parameters
    ----------
    snr : array_like, shape (n,)
    fwhm : array_like, shape (n, 2)
        Width of the beam along each axis.
    fraction : float

    Returns
    -------
    `~numpy.ndarray`, shape (n, 2)
        In the unit of ``fwhm``.

    Examples
    --------
    >>> from astro_scc.images.beam import position_errors
    >>> position_errors([10, 100], [[1, 1], [1, 1]], 0.2).round(3)
    array([[0.158, 0.158],
           [0.142, 0.142]])
    """
    snr = np.maximum(np.asarray(snr, dtype=float), 1.0)[:, None]
    return fwhm * np.sqrt(0.5 / snr**2 + 0.5 * fraction**2)


class SeveralBeamsError(ValueError):
    """A table has beams of several channels, and none can be told to be the image's."""


def header_beam(header, tables=()):
    """Return the beam of an image, None if nothing tells it, see `fits.read_header`."""
    beam = get(header, "BEAM")
    if hasattr(beam, "major"):
        return as_beam(beam)
    major, minor, pa = (get(header, keyword, kind=float) for keyword in BEAM)
    if major:
        if pa is None and minor not in (None, major):
            raise ValueError("BPA is missing or no number, and BMAJ and BMIN differ")
        return _beam(major, major if minor is None else minor, pa or 0.0)
    for table in tables:
        if table.name.upper() == "AIPS CG" and len(table.data):
            return _row(table, 0)
        if table.name.upper() == "BEAMS" and len(table.data):
            return _of_channel(header, table)
    # Of a header, str would break the lines.
    lines = header.get("HISTORY") or header.get("history") or ()
    lines = lines if isinstance(lines, str) else "; ".join(map(str, lines))
    found = _CLEAN_BEAM.findall(lines.upper())
    numbers = [float(text.replace("D", "E")) for text in found[-1]] if found else [0]
    return _beam(*numbers) if numbers[0] > 0 else None


def _row(table, row):
    """Return the beam in a row of a table."""
    return _beam(*(_angle(table, name, row) for name in BEAM))


def _angle(table, name, row):
    """Return an angle in a row of a table, in degrees."""
    text = (table.columns[name].unit or "deg").strip().lower()
    unit = parse_unit(text) or parse_unit(text.rstrip("s")) or u.Unit(text)
    return (float(table.data[row][name]) * unit).to_value(u.deg)


def _of_channel(header, table):
    """Return the beam of the channel of an image, of a table of all channels."""
    n = len(table.data)
    rows = np.arange(n)
    every = {row: _row(table, row) for row in rows if _angle(table, "BMAJ", row) > 0}
    if every and different_beam([*every.values()]) is None:
        return next(iter(every.values()))
    columns = [name.upper() for name in table.columns.names]
    spectral = [name for name in KEYWORDS["spectral"]["axes"] if axis_of(header, name)]
    for column, axis in (("CHAN", (*spectral, "FREQ")[0]), ("POL", "STOKES")):
        if column in columns and len(rows) > 1:
            values = np.asarray(table.data[column], dtype=int)
            rows = rows[np.isin(values[rows], _plane_of(header, axis, values))]
    beams = [every[row] for row in rows if row in every]
    if not beams or different_beam(beams) is not None:
        raise SeveralBeamsError(
            f"its table BEAMS has {n} beams, and which one is that of its channel "
            "cannot be told; write BMAJ, BMIN and BPA in degrees to its header, or "
            "give one beam of all (--beam, in Python beams=)"
        )
    return beams[0]


def _plane_of(header, name, numbers):
    """
    Return the numbers that the plane of an image may have on an axis of a table.

    A plane that was cut out of a cube keeps the reference pixel, which was the first
    of the cube; without a step from it nothing tells the plane, unless it is Stokes I.
    """
    if (axis := axis_of(header, name)) is None:
        return numbers
    value, pixel, step = axis_numbers(header, axis)
    first = 1 - pixel
    if name == "STOKES" and value is not None:
        first = (1 - value) / (step or 1)
        known = header.get(f"NAXIS{axis}", 1) > 1 or value + (1 - pixel) * step == 1
        return [round(first)] if known else [round(1 - pixel)]
    if pixel == 1 or abs(first - round(first)) > 1e-6:
        return numbers
    # Some count channels from 1.
    return [round(first) + (1 if numbers.min() == 1 else 0)]


def _beam(major, minor, pa):
    """Return the beam of three numbers in degrees, with the larger axis first."""
    if not (major > 0 and minor > 0):
        raise ValueError(f"the beam {major:g} x {minor:g} deg is not positive")
    if minor > major:
        major, minor, pa = minor, major, pa + 90
    return Beam(major * u.deg, minor * u.deg, pa * u.deg)
