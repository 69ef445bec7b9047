# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Convolution of images with Gaussians, and of a series to a common beam."""

import astropy.units as u
import numpy as np
import scipy

from astro_scc.images.beam import (
    CONTAINS,
    EQUAL,
    Beam,
    as_beam,
    beam_excess,
    is_per,
    smallest_common_beam,
)
from astro_scc.images.series import Series


def gaussian_smooth(image, covariance, mask=False):
    """
    Return an image convolved with an elliptical Gaussian of unit sum.

    The image is multiplied in Fourier space by ``exp(-2 pi^2 k^T C k)``, with
    the ``covariance`` C over (x, y) in square pixels, which may be singular.
    This is exact for well-sampled images however narrow the Gaussian is.  A
    normalised convolution (Knutsson & Westin 1993) leaves out bad pixels and
    everything beyond the edges: ``(g * (m I)) / (g * m)``, where m is 1 for good
    pixels and 0 for others.  Pixels that are masked or not finite are bad, and
    stay NaN.
    """
    variances = np.linalg.eigvalsh(covariance)
    bad = ~np.isfinite(image) | mask
    pad = int(np.ceil(6 * np.sqrt(variances[1]))) + 2
    shape = [scipy.fft.next_fast_len(n + pad, real=True) for n in image.shape]
    transfer = gaussian_transfer(covariance, shape)

    def convolve(values):
        smooth = scipy.fft.irfft2(scipy.fft.rfft2(values, s=shape) * transfer, s=shape)
        return smooth[: image.shape[0], : image.shape[1]]

    weight = convolve((~bad).astype(float))
    smooth = convolve(np.where(bad, 0.0, image))
    # Good pixels contribute to their own weight, so it is never zero there.
    return np.divide(smooth, weight, out=np.full(image.shape, np.nan), where=~bad)


def gaussian_transfer(covariance, shape):
    """
    Return the transform of a Gaussian of unit sum in the layout of `scipy.fft.rfft2`.

    The ``covariance`` over (x, y), in square pixels, may be singular; ``shape`` is
    that of the image, (ny, nx).
    """
    ky = scipy.fft.fftfreq(shape[0])[:, None]
    kx = scipy.fft.rfftfreq(shape[1])[None, :]
    (xx, xy), (_, yy) = covariance
    form = xx * kx**2 + 2 * xy * kx * ky + yy * ky**2
    return np.exp(-2 * np.pi**2 * form)


def common_beam(cube: Series, beam: Beam | None = None) -> Series:
    """
    Return the cube with all epochs convolved to the same beam.

    An epoch with beam covariance ``C_i`` is convolved with a Gaussian of
    covariance ``C - C_i``; intensities per beam are multiplied by the ratio
    of the beam areas, so that flux densities are conserved.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
        With ``beams``.
    beam : beam, optional
        `~astro_scc.epochs.Beam`, or anything with the attributes ``major``,
        ``minor`` and ``pa``.  By default the smallest beam that contains the
        beams of all epochs.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        Epochs that already have the beam are identical to the bit.  Bad
        pixels stay bad and do not contribute; good pixels beside them and at
        the edges keep their level.  ``noise`` is None, and is then measured
        again, unless no epoch needed convolution.

    Raises
    ------
    ValueError
        If the epochs have no beams, or one of them does not fit into
        ``beam``.
    TypeError
        If ``beam`` is not a beam.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.epochs import Beam, EpochCube
    >>> cube = EpochCube.from_arrays(
    ...     np.ones((2, 32, 32)),
    ...     ["2000-01-01", "2001-01-01"],
    ...     pixel_scale=0.1 * u.mas,
    ...     unit=u.Jy / u.beam,
    ...     beams=[Beam(s * u.mas, s * u.mas) for s in (0.5, 1)],
    ... )
    >>> smooth = common_beam(cube)
    >>> print(smooth.beams[0])
    1 x 1 mas at 0.0 deg
    >>> smooth.data[:, 16, 16].round(6)
    array([4., 1.])
    """
    if cube.beams is None:
        raise ValueError(
            "the epochs have no beams; give them, beams=[...], or leave this step out"
        )
    target = smallest_common_beam(cube.beams) if beam is None else as_beam(beam)
    goal = target.covariance.value
    to_pixels = np.linalg.inv(cube.pixel_matrix.to_value(u.mas))
    data = cube.data.copy()
    changed = []
    for i, beam_now in enumerate(cube.beams):
        covariance = beam_now.covariance.value
        excess = beam_excess(goal, covariance)
        if excess > 1 + CONTAINS:
            raise ValueError(
                f"{cube.labels[i]}: its beam {beam_now} does not fit into {target}; "
                "choose a larger one, or none for the smallest common beam"
            )
        if max(excess, beam_excess(covariance, goal)) <= 1 + EQUAL:
            continue
        variances, axes = np.linalg.eigh(to_pixels @ (goal - covariance) @ to_pixels.T)
        # Rounding errors must not leave a negative variance.
        difference = (axes * np.maximum(variances, 0)) @ axes.T
        data[i] = gaussian_smooth(data[i], difference, cube.mask[i])
        if is_per(cube.unit, "beam"):
            data[i] *= float(target.area / beam_now.area)
        changed.append(i)
    line = f"common beam {target} ({len(changed)} of {len(cube)} epochs convolved)"
    noise = None if changed else cube.noise
    return cube.with_step(line, data=data, beams=(target,) * len(cube), noise=noise)
