# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Where patterns of a cube are on the sky, and how well that is known."""

import re

import numpy as np

from astro_scc.decomposition import scale_size

__all__ = [
    "axis_words",
    "beam_fwhm",
    "name_by_frame",
    "position_errors",
    "sky_columns",
    "ssp_offsets",
]

#: What the axes of celestial frames other than right ascension are called.
FRAMES = {"GLON": "galactic", "ELON": "ecliptic", "SLON": "supergalactic"}
SOLAR = ("HPLN", "HGLN", "CRLN", "HCLN")
#: Names of columns where longitude is not right ascension.
LONGITUDE = {
    r"\bpm_ra_cosdec": "pm_lon_coslat",
    r"\bpm_dec(?=_err|\b)": "pm_lat",
    r"(\b|_)east(?=_|$)": r"\1lon_offset",
    r"(\b|_)north(?=_|$)": r"\1lat_offset",
}

#: Size of the resolution of images without a beam, in scales of the SSP.
SCALES_PER_FWHM = 2.0


def axis_words(cube):
    """
    Where longitude and latitude grow, and whether that of longitude is to the left.

    On the sky to the east, which is to the left; in coordinates of the Sun to
    the west, which is to the right.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
        Or anything with its ``wcs``.

    Returns
    -------
    first, second : str
        "east" and "north" for right ascension and declination only.
    to_the_left : bool
    """
    ctype = str(cube.wcs.wcs.ctype[0])
    if ctype[:4] in SOLAR:
        return "solar west", "solar north", False
    if ctype.startswith("RA--"):
        return "east", "north", True
    name = FRAMES.get(ctype[:4])
    if name is None:
        return "larger longitude", "larger latitude", True
    return f"{name} east", f"{name} north", True


def ssp_offsets(ssps, cube, *, centroid=False):
    """
    Offsets of SSPs from the reference pixel.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
    cube : `~astro_scc.epochs.EpochCube`
    centroid : bool, optional
        The centroids instead of the maxima.

    Returns
    -------
    east, north : `~numpy.ndarray`, shape (n,)
        In mas.

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.epochs import ssp_offsets
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> ssps = SSPs.of_epochs([Decomposer(scales=[2])(image) for image in cube.data])
    >>> east, north = ssp_offsets(ssps, cube)
    >>> east.shape == (len(ssps),)
    True
    """
    y, x = (ssps.y_centroid, ssps.x_centroid) if centroid else (ssps.y, ssps.x)
    x0, y0 = cube.wcs.wcs.crpix - 1
    east, north = cube.pixel_matrix.value @ np.stack([x - x0, y - y0])
    return east, north


def name_by_frame(table, cube):
    """
    Name the columns of a table by the celestial frame of its cube.

    Tables are made with names of right ascension and declination.  In other
    frames, such as those of the Sun, ``pm_ra_cosdec`` becomes
    ``pm_lon_coslat``, ``pm_dec`` becomes ``pm_lat``, and the offsets ``east``
    and ``north`` ``lon_offset`` and ``lat_offset``, with all that is derived
    from them.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        Changed in place.
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    `~astropy.table.QTable`
        The same.

    Examples
    --------
    >>> from astropy.table import QTable
    >>> from astropy.wcs import WCS
    >>> from types import SimpleNamespace
    >>> from astro_scc.epochs import name_by_frame
    >>> sun = WCS(naxis=2)
    >>> sun.wcs.ctype = ["HPLN-TAN", "HPLT-TAN"]
    >>> table = QTable({"pm_ra_cosdec": [1.0], "pm_dec_err": [0.1], "east": [2.0]})
    >>> name_by_frame(table, SimpleNamespace(wcs=sun)).colnames
    ['pm_lon_coslat', 'pm_lat_err', 'lon_offset']
    """
    first, second, _ = axis_words(cube)
    if first == "east":
        return table
    for name in table.colnames:
        new, about = name, table[name].info.description or ""
        for pattern, replacement in LONGITUDE.items():
            new = re.sub(pattern, replacement, new)
        about = about.replace(f"of {name.removesuffix('_err')}",
                              f"of {new.removesuffix('_err')}")  # fmt: skip
        for words in (("to the east", f"to {first}"), ("to the north", f"to {second}"),
                      ("through east", f"through {first}")):  # fmt: skip
            about = about.replace(*words)
        if new != name:
            table.rename_column(name, new)
        if about:
            table[new].info.description = about
    return table


def sky_columns(table):
    """
    Names of the proper motions in longitude and latitude, see `name_by_frame`.

    Parameters
    ----------
    table : `~astropy.table.Table`

    Returns
    -------
    (str, str)

    Examples
    --------
    >>> from astropy.table import QTable
    >>> from astro_scc.epochs import sky_columns
    >>> sky_columns(QTable({"pm_lon_coslat": [1.0], "pm_lat": [2.0]}))
    ('pm_lon_coslat', 'pm_lat')
    """
    if "pm_lon_coslat" in table.colnames:
        return "pm_lon_coslat", "pm_lat"
    return "pm_ra_cosdec", "pm_dec"


def beam_fwhm(cube, epoch, scale, axes):
    """
    Width of the resolution along two axes.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    epoch : array_like of int, shape (n,)
    scale : array_like, shape (n,)
        Scale numbers of the SSPs.
    axes : `~numpy.ndarray`, shape (2, 2) or (n, 2, 2)
        Rows are the vectors (east, north) of the axes, of unit length but in
        frames that scale with distance.

    Returns
    -------
    `~numpy.ndarray`, shape (n, 2)
        Full width at half maximum of the beam of the epoch in mas; for a
        cube without beams twice the size of the SSP's scale.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.epochs import beam_fwhm
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> beam_fwhm(cube, [0], [2], np.eye(2))
    array([[1., 1.]])
    """
    epoch = np.asarray(epoch)
    if cube.beams is None:
        size = np.vectorize(scale_size, otypes=[float])(scale) if len(epoch) else scale
        width = SCALES_PER_FWHM * np.asarray(size) * cube.pixel_scale.value
        # Axes of unit length in all frames but those that scale with distance.
        return width[..., None] * np.linalg.norm(axes, axis=-1)
    covariance = np.stack([beam.covariance.value for beam in cube.beams])[epoch]
    variance = np.einsum("...ai,...ij,...aj->...a", axes, covariance, axes)
    return np.sqrt(8 * np.log(2) * variance)


def position_errors(snr, fwhm, fraction):
    """
    Standard errors of positions.

    ``sigma^2 = (b / (sqrt(2) SNR))^2 + (f b)^2 / 2`` on each axis: the
    thermal error (Fomalont 1999; Mertens & Lobanov 2016, Eq. 2) and a floor
    for what a pattern's position suffers beyond noise, f the ``fraction``
    of the beam that two positions together are uncertain by.

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
    >>> from astro_scc.epochs import position_errors
    >>> position_errors([10, 100], [[1, 1], [1, 1]], 0.2).round(3)
    array([[0.158, 0.158],
           [0.142, 0.142]])
    """
    snr = np.maximum(np.asarray(snr, dtype=float), 1.0)[:, None]
    return fwhm * np.sqrt(0.5 / snr**2 + 0.5 * fraction**2)
