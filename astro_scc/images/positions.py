# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Positions of pixels and SSPs on the sky, their errors, and the resolution."""

import re

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.wcs import WCS

from astro_scc.decomposition.wavelet import scale_size
from astro_scc.quantities import named, one_quantity

#: Where longitude and latitude increase, and if longitude does so leftwards, by the
#: start of its CTYPE.
AXES = {
    "RA--": ("east", "north", True),
    "GLON": ("galactic east", "galactic north", True),
} | dict.fromkeys(
    ("HPLN", "HGLN", "CRLN", "HCLN"), ("solar west", "solar north", False)
)
#: New names of columns if longitude is not right ascension.
LONGITUDE = {
    r"\bpm_ra_cosdec": "pm_lon_coslat",
    r"\bpm_dec(?=_err|\b)": "pm_lat",
    r"\bra_offset": "lon_offset",
    r"\bdec_offset": "lat_offset",
    r"(\b|_)east(?=_|$)": r"\1lon_offset",
    r"(\b|_)north(?=_|$)": r"\1lat_offset",
}
#: Name of coordinates that are offsets in a plane, however large a pixel is.
PLANE = "OFFSETS"
#: Longitude and latitude of a source whose position is not known.
UNKNOWN = (180.0, 0.0)
#: Resolution of images without a beam, in pixels.
PIXELS_RESOLVED = 3


def readable_angle(angle):
    """Return an angle as text, in the unit that suits its size."""
    least = {u.deg: 0.1, u.arcsec: 0.1, u.mas: 0.01, u.uas: 0.1}
    fits = (unit for unit in least if abs(angle).to_value(unit) >= least[unit])
    unit = next(fits, u.mas)
    return f"{angle.to_value(unit):.4g} {unit}"


def pixel_side(pixel_scale):
    """Return the side of a pixel as a Quantity, a positive angle."""
    return named("pixel_scale", one_quantity, pixel_scale, "an angle", "0.1 mas")


def offset_wcs(pixel_scale, reference_pixel, position=None):
    """
    Return a celestial WCS for offsets from a reference pixel.

    It is orthographic (``SIN``), with east to the left, north up and square pixels.

    Parameters
    ----------
    pixel_scale : `~astropy.units.Quantity`
        Side of a pixel, an angle.
    reference_pixel : tuple of float
        (x, y) of the origin of offsets, counted from 0.
    position : `~astropy.coordinates.SkyCoord`, optional
        Celestial position of the origin; by default (180 deg, 0 deg).
    """
    step = pixel_side(pixel_scale).to_value(u.deg)
    if not isinstance(position, SkyCoord | None):
        raise TypeError(f"position must be a SkyCoord, got {position!r}")
    position = SkyCoord(*UNKNOWN, unit=u.deg) if position is None else position.icrs
    try:
        x, y = (u.Quantity(v, u.pix).value.item() for v in reference_pixel)
    except (AttributeError, TypeError, ValueError):
        raise ValueError(
            f"reference_pixel must be two numbers (x, y), got {reference_pixel!r}"
        ) from None
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = "RA---SIN", "DEC--SIN"
    wcs.wcs.cunit = "deg", "deg"
    wcs.wcs.crval = position.ra.deg, position.dec.deg
    wcs.wcs.crpix = x + 1, y + 1
    wcs.wcs.cdelt = -step, step
    wcs.wcs.radesys = "ICRS"
    wcs.wcs.name = PLANE
    wcs.wcs.set()
    return wcs


def axis_words(cube):
    """
    Return where longitude and latitude increase, and if longitude does so leftwards.

    On the sky longitude increases to the east, which is left; in coordinates of the
    Sun it increases to the west, which is right.  The words are "east" and "north" for
    right ascension and declination only.  Only the ``wcs`` of the ``cube`` is used.
    """
    start = str(cube.wcs.wcs.ctype[0])[:4]
    return AXES.get(start, ("larger longitude", "larger latitude", True))


def ssp_offsets(ssps, cube, *, centroid=False):
    """
    Return the offsets of SSPs from the reference pixel, in mas.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
    cube : `~astro_scc.epochs.EpochCube`
    centroid : bool, optional
        Use the centroids instead of the maxima.

    Returns
    -------
    east, north : `~numpy.ndarray`, shape (n,)

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.images.positions import ssp_offsets
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> ssps = SSPs.of_epochs([Decomposer(scales=[2])(image) for image in cube.data])
    >>> east, north = ssp_offsets(ssps, cube)
    >>> east.shape == (len(ssps),)
    True
    """
    y, x = (ssps.y_centroid, ssps.x_centroid) if centroid else (ssps.y, ssps.x)
    return tuple(offset.value for offset in cube.pixel_to_offset(x, y))


def name_by_frame(table, cube):
    """
    Name the columns of a table by the celestial frame of its cube, in place.

    Tables are made with names for right ascension and declination.  In other
    frames, such as those of the Sun, ``pm_ra_cosdec`` becomes
    ``pm_lon_coslat``, ``pm_dec`` becomes ``pm_lat``, and the offsets ``east``
    and ``north`` become ``lon_offset`` and ``lat_offset``; columns derived from
    them change likewise.  The table is returned.
    """
    first, second, _ = axis_words(cube)
    if first == "east":
        return table
    words = {"to the east": f"to {first}", "to the north": f"to {second}"}
    words["through east"] = f"through {first}"
    for name in table.colnames:
        new, about = name, table[name].info.description or ""
        for pattern, replacement in LONGITUDE.items():
            new = re.sub(pattern, replacement, new)
        renamed = {f"of {name.removesuffix('_err')}": f"of {new.removesuffix('_err')}"}
        for old, word in {**renamed, **words}.items():
            about = about.replace(old, word)
        if new != name:
            table.rename_column(name, new)
        if about:
            table[new].info.description = about
    return table


def sky_columns(table):
    """Return the names of the proper motions in longitude and latitude."""
    if "pm_lon_coslat" in table.colnames:
        return "pm_lon_coslat", "pm_lat"
    return "pm_ra_cosdec", "pm_dec"


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
    >>> from astro_scc.images.positions import beam_fwhm
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
    >>> from astro_scc.images.positions import position_errors
    >>> position_errors([10, 100], [[1, 1], [1, 1]], 0.2).round(3)
    array([[0.158, 0.158],
           [0.142, 0.142]])
    """
    snr = np.maximum(np.asarray(snr, dtype=float), 1.0)[:, None]
    return fwhm * np.sqrt(0.5 / snr**2 + 0.5 * fraction**2)
