# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""From matches in pixels to displacements in angle, with their errors."""

import numpy as np

from astro_scc.correlation import landing_ssps
from astro_scc.decomposition import scale_size
from astro_scc.kinematics import frame_displacements
from astro_scc.stacking import Displacements

__all__ = ["angular_displacements", "beam_fwhm", "position_errors", "ssp_offsets"]

#: Size of the resolution of images without a beam, in scales of the SSP.
SCALES_PER_FWHM = 2.0


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
    """
    y, x = (ssps.y_centroid, ssps.x_centroid) if centroid else (ssps.y, ssps.x)
    x0, y0 = cube.wcs.wcs.crpix - 1
    east, north = cube.pixel_matrix.value @ np.stack([x - x0, y - y0])
    return east, north


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
    """
    snr = np.maximum(np.asarray(snr, dtype=float), 1.0)[:, None]
    return fwhm * np.sqrt(0.5 / snr**2 + 0.5 * fraction**2)


def angular_displacements(matches, ssps, cube, frame, fraction, *, select=None):
    """
    The matches as displacements along the axes of a frame.

    Parameters
    ----------
    matches : `~astro_scc.correlation.Matches`
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    cube : `~astro_scc.epochs.EpochCube`
    frame : frame of `astro_scc.kinematics`
        Gives the two axes at the position of each SSP.
    fraction : float
        Floor of the displacement error in beams.
    select : array_like of bool, shape (n_ssps,), optional
        The SSPs that count.

    Returns
    -------
    `~astro_scc.stacking.Displacements`
        Without the matches of SSPs at which the frame has no axes; they
        count as SSPs without a match.
    """
    select = np.ones(len(ssps), bool) if select is None else np.asarray(select, bool)
    matches = matches.of_ssps(select)
    east, north = ssp_offsets(ssps, cube)
    axes = np.broadcast_to(frame.matrix(east, north), (len(ssps), 2, 2))
    # At the origin of a radial frame there are no axes.
    matches = matches.of_ssps(np.isfinite(axes).all(axis=(1, 2)))
    owner = matches.ssp
    axes = axes[owner]
    pixels = np.stack([matches.dx, matches.dy], axis=-1).astype(float)
    sky = pixels @ cube.pixel_matrix.value.T
    position = np.stack([east[owner], north[owner]], axis=-1)
    d = frame_displacements(frame, position, sky)
    variance = 0.0
    scale = ssps.scale[owner]
    for snr, epoch in (
        (ssps.snr[owner], ssps.epoch[owner]),
        (matches.target_snr, matches.target),
    ):
        fwhm = beam_fwhm(cube, epoch, scale, axes)
        variance = variance + position_errors(snr, fwhm, fraction) ** 2
    s = np.sqrt(variance)
    return Displacements(
        d1=d[:, 0],
        d2=d[:, 1],
        s1=s[:, 0],
        s2=s[:, 1],
        weight=(matches.coefficient * matches.overlap).astype(float),
        reference=ssps.epoch[owner].astype(np.int32),
        target=matches.target.astype(np.int32),
        ssp=owner.astype(np.int32),
        target_ssp=landing_ssps(matches, ssps).astype(np.int32),
        n_ssps=np.bincount(ssps.epoch[select], minlength=len(cube)),
        position=position,
        motion=sky,
    )
