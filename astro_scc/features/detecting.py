# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Detections in the images of a cube: Gaussians, or SSPs."""

import astropy.units as u
import numpy as np

from astro_scc.correlation.parallel import in_order
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.features.detections import Detections
from astro_scc.features.gaussians import fit_gaussians
from astro_scc.images.positions import (
    SCALES_PER_FWHM,
    beam_fwhm,
    position_errors,
    ssp_offsets,
)
from astro_scc.progress import progress

#: SSPs nearer to each other than this, in sizes of the larger one, are one pattern.
SAME_PATTERN = 0.7
#: Ratio of the errors of positions to those of noise: in CLEANed images, blended
#: components are off by about twice the formal errors (``benchmarks/features.py``).
CLEANED = 2.0


def gaussians_of(cube, *, n_workers=1, progress_bar=False):
    """
    Return the components of Gaussian models of all images as detections.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
        With beams.
    n_workers : int, str or `dask.distributed.Client`, optional
        The unit of work is an epoch.
    progress_bar : bool, optional

    Returns
    -------
    `Detections`
        The brightest of each epoch first.
    """
    # From (y, x) in pixels to offsets on the two axes.
    matrix = cube.pixel_matrix.value[:, ::-1]
    inverse, noise = np.linalg.inv(matrix), cube.noise_rms().value
    work = (
        (image, mask, inverse @ beam.covariance.value @ inverse.T, rms)
        for image, mask, beam, rms in zip(
            cube.data, cube.mask, cube.beams, noise, strict=True
        )
    )
    models = []
    with progress(len(cube), "Fitting", show=progress_bar) as done:
        for model in in_order(_fit, work, n_workers):
            models.append(model)
            done(1)
    parts = {
        name: np.concatenate([getattr(model, name) for model in models])
        for name in ("y", "x", "y_err", "x_err", "flux", "size")
    }
    x0, y0 = cube.reference_pixel
    errors = np.stack([parts["y_err"], parts["x_err"]], axis=1)
    return Detections(
        epoch=np.repeat(np.arange(len(cube)), [len(model) for model in models]),
        place=np.stack([parts["y"] - y0, parts["x"] - x0], axis=1) @ matrix.T,
        place_error=CLEANED * np.sqrt(errors**2 @ (matrix**2).T),
        flux=parts["flux"],
        size=parts["size"] * cube.pixel_scale.value,
        years=_years(cube),
        beam=_mean_beam(cube),
    )


def _fit(image_mask_beam_rms):
    """Fit one image, given as the arguments of one task."""
    image, mask, covariance, rms = image_mask_beam_rms
    return fit_gaussians(image, covariance, rms, mask=mask)


def finest_patterns(ssps, keep=None, of=True):
    """
    Return which SSPs are patterns of their own, each on the finest of its scales.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    keep : `~numpy.ndarray` of bool, shape (n_ssps,), optional
        SSPs that are kept in any case.
    of : array_like of bool, optional
        SSPs among which others are chosen.

    Returns
    -------
    `~numpy.ndarray` of int, shape (n,)
        In the order of the epochs.
    """
    size = ssp_sizes(ssps)
    keep = np.zeros(len(ssps), dtype=bool) if keep is None else keep.copy()
    of = np.broadcast_to(of, keep.shape)
    for k in np.lexsort((-ssps.snr, size)).tolist():
        keep[k] |= of[k] and is_new(ssps, keep, k)
    own = np.flatnonzero(keep)
    return own[np.argsort(ssps.epoch[own], kind="stable")]


def is_new(ssps, keep, k):
    """Return whether an SSP lies on none of those that are kept."""
    same = np.flatnonzero(keep & (ssps.epoch == ssps.epoch[k]))
    off = np.hypot(ssps.y[same] - ssps.y[k], ssps.x[same] - ssps.x[k])
    return not (off <= SAME_PATTERN * scale_size(ssps.scale[k])).any()


def ssp_sizes(ssps):
    """Return the size of the scale of each SSP in pixels."""
    return np.array([scale_size(scale) for scale in ssps.scale], dtype=float)


def ssps_of(cube, ssps, own, fwhm=None):
    """
    Return SSPs as detections.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    own : `~numpy.ndarray` of int, shape (n,)
        Those that are detections, in the order of the epochs.
    fwhm : float, optional
        Resolution in mas of a cube without beams, by default that of the finest scale.

    Returns
    -------
    `Detections`
        With errors of the positions from the signal-to-noise ratio.
    """
    if cube.beams is None:
        if fwhm is None:
            finest = ssp_sizes(ssps).min(initial=np.inf) if len(ssps) else 1.0
            fwhm = SCALES_PER_FWHM * finest * cube.pixel_scale.value
        beam = np.eye(2) * fwhm**2 / (8 * np.log(2))
    else:
        beam = _mean_beam(cube)
    place = np.stack(ssp_offsets(ssps, cube), axis=1)
    widths = beam_fwhm(cube, ssps.epoch, ssps.scale, np.eye(2))
    return Detections(
        epoch=ssps.epoch[own],
        place=place[own],
        place_error=position_errors(ssps.snr, widths, 0.0)[own],
        flux=ssps.flux[own],
        size=np.zeros(len(own)),
        years=_years(cube),
        beam=beam,
    )


def _years(cube):
    """Return the dates as Julian years."""
    return cube.times[0].jyear + cube.years.to_value(u.yr)


def _mean_beam(cube):
    """Return the mean covariance of the beams in mas^2."""
    return np.mean([beam.covariance.value for beam in cube.beams], axis=0)
