# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Where patterns of a cube are on the sky, and how well that is known."""

import numpy as np

from astro_scc.decomposition import scale_size

__all__ = ["beam_fwhm", "position_errors", "ssp_offsets"]

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
