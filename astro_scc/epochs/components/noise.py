# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Random noise with the correlation that a restoring beam gives to it."""

import astropy.units as u
import numpy as np
from scipy import fft

__all__ = ["correlated_noise"]

# Padding of the periodic Fourier grid, in standard deviations of the beam:
# the noise of opposite edges is then independent to exp(-(6 / 2)**2).
PADDING = 6.0


def correlated_noise(shape, *, rms, beam=None, pixel_scale=None, rng=None):
    """
    Gaussian noise as the image of a beam has it.

    White noise is convolved with the beam, so that its autocorrelation is
    the beam convolved with itself, and scaled by the theoretical gain of
    that convolution: the expected root mean square is ``rms`` whatever the
    beam, while that of one image scatters about it.

    Parameters
    ----------
    shape : tuple of int
        Shape (ny, nx) of the image.
    rms : float or `~astropy.units.Quantity`
        Root mean square of the noise.
    beam : `~astro_scc.epochs.Beam`, optional
        Without it the noise is white.
    pixel_scale : `~astropy.units.Quantity`, optional
        Side of a pixel; needed with a beam.  East is towards smaller x,
        north towards larger y.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.

    Returns
    -------
    `numpy.ndarray` or `~astropy.units.Quantity`, shape (ny, nx)
        In the unit of ``rms``.

    Raises
    ------
    ValueError
        If ``rms`` is negative or not finite, or a beam comes without a
        positive ``pixel_scale``.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.epochs.beam import Beam
    >>> from astro_scc.epochs.components.noise import correlated_noise
    >>> beam = Beam(1 * u.mas, 0.5 * u.mas)
    >>> noise = correlated_noise((64, 128), rms=0.3 * u.mJy / u.beam, beam=beam,
    ...                          pixel_scale=0.1 * u.mas, rng=1)
    >>> noise.shape, noise.unit
    ((64, 128), Unit("mJy / beam"))
    """
    rng = np.random.default_rng(rng)
    level = u.Quantity(rms)
    if not (level.isscalar and np.isfinite(level) and level.value >= 0):
        raise ValueError(f"rms must be one finite, non-negative number, got {rms}")
    if beam is None:
        return rms * rng.standard_normal(shape)
    if pixel_scale is None:
        raise ValueError("noise with a beam needs pixel_scale, the side of a pixel")

    ny, nx = shape
    # Offsets run east to the left: dx = -east / pixel, dy = north / pixel.
    flip = np.diag([-1.0, 1.0])
    scale = u.Quantity(pixel_scale).to_value(u.mas)
    if not (np.isfinite(scale) and scale > 0):
        raise ValueError(f"pixel_scale must be positive, got {pixel_scale}")
    covariance = flip @ beam.covariance.to_value(u.mas**2) @ flip / scale**2
    padding = int(np.ceil(PADDING * np.sqrt(np.trace(covariance))))
    padded = tuple(fft.next_fast_len(n + padding, real=True) for n in (ny, nx))

    ky = fft.fftfreq(padded[0])[:, None]
    kx = fft.rfftfreq(padded[1])[None, :]
    transfer = np.exp(
        -2
        * np.pi**2
        * (
            covariance[0, 0] * kx**2
            + 2 * covariance[0, 1] * kx * ky
            + covariance[1, 1] * ky**2
        )
    )
    # A kernel h turns unit white noise into variance sum h^2 = mean |H|^2
    # (Parseval), over the whole plane of which rfft keeps one half.
    weight = np.full(transfer.shape[1], 2.0)
    weight[0] = 1.0
    if padded[1] % 2 == 0:
        weight[-1] = 1.0
    gain = np.sqrt(np.sum(weight * transfer**2) / np.prod(padded))

    white = rng.standard_normal(padded)
    noise = fft.irfft2(fft.rfft2(white) * transfer, s=padded)
    return rms * (noise[:ny, :nx] / gain)
