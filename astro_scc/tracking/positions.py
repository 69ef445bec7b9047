# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Where SSPs are on the sky, and how well that is known."""

import astropy.units as u
import numpy as np

from astro_scc.decomposition import scale_size

__all__ = ["position_errors", "ssp_offsets"]


def ssp_offsets(ssps, cube):
    """
    Offsets of the maxima of SSPs from the reference pixel.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    `~numpy.ndarray`, shape (2, n)
        East and north in mas.
    """
    return np.stack([v.to_value(u.mas) for v in cube.pixel_to_offset(ssps.x, ssps.y)])


def position_errors(ssps, cube, floor):
    """
    Standard errors of the offsets.

    ``sigma^2 = (b / (sqrt(2) SNR))^2 + (f b)^2`` with the width b of the
    beam on the axis, the first term after Fomalont (1999).

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
    cube : `~astro_scc.epochs.EpochCube`
        Without beams, b is twice the size of the SSP's scale.
    floor : float
        The part f of the beam that no position is known better than.

    Returns
    -------
    `~numpy.ndarray`, shape (2, n)
        East and north in mas.
    """
    if cube.beams is None:
        size = np.array([scale_size(s) for s in ssps.scale], dtype=float)
        fwhm = np.broadcast_to(2 * size * cube.pixel_scale.value, (2, len(ssps)))
    else:
        widths = [b.fwhm_along([90, 0] * u.deg).to_value(u.mas) for b in cube.beams]
        fwhm = np.array(widths)[ssps.epoch].T.reshape(2, -1)
    thermal = 0.5 / np.maximum(ssps.snr, 1.0) ** 2
    return fwhm * np.sqrt(thermal + floor**2)
