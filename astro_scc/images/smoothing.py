# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Convolution of images with Gaussians, and of all epochs to one beam."""

from __future__ import annotations

from collections.abc import Sequence

import astropy.units as u
import numpy as np
from scipy import fft, optimize

from astro_scc.images.beam import Beam, as_beam, beam_of, is_per
from astro_scc.images.series import Series

# Beams that headers round to single precision contain themselves only to this
# fraction of their variance.
CONTAINS = 1e-4
EQUAL = 1e-6


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
    shape = [fft.next_fast_len(n + pad, real=True) for n in image.shape]
    transfer = gaussian_transfer(covariance, shape)

    def convolve(values):
        smooth = fft.irfft2(fft.rfft2(values, s=shape) * transfer, s=shape)
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
    ky = fft.fftfreq(shape[0])[:, None]
    kx = fft.rfftfreq(shape[1])[None, :]
    (xx, xy), (_, yy) = covariance
    form = xx * kx**2 + 2 * xy * kx * ky + yy * ky**2
    return np.exp(-2 * np.pi**2 * form)


def _excess(covariance, others):
    """
    Return the largest ratio of the variances of Gaussians to those of one Gaussian.

    It is the largest eigenvalue of ``C^-1 C_i`` for each i, at most 1 for a
    Gaussian that fits into the one with covariance C.
    """
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    return np.linalg.eigvalsh(root @ np.asarray(others) @ root.T)[..., -1]


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

    Raises
    ------
    ValueError
        If ``beams`` is empty.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.epochs import Beam
    >>> beams = [Beam(1 * u.mas, 0.5 * u.mas, pa) for pa in (10 * u.deg, 50 * u.deg)]
    >>> print(smallest_common_beam(beams))
    1.14 x 0.696 mas at 30.0 deg
    """
    if len(beams) == 0:
        raise ValueError("a common beam needs at least one beam")
    covariances = np.array([beam.covariance.value for beam in beams])
    largest = int(np.argmax(np.linalg.det(covariances)))
    if np.all(_excess(covariances[largest], covariances) <= 1 + EQUAL):
        return beams[largest]

    def shape(p):
        r, angle = np.hypot(*p), np.arctan2(p[1], p[0])
        c, s = np.cos(angle), np.sin(angle)
        return np.cosh(r) * np.eye(2) + np.sinh(r) * np.array([[c, s], [s, -c]])

    best = optimize.minimize(
        lambda p: np.log(_excess(shape(p), covariances).max()),
        [0.1, 0.1],
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000},
    )
    least = np.exp(best.fun) * shape(best.x)
    # Rounding errors must not leave a beam that does not fit.
    least = least * max(1.0, _excess(least, covariances).max() * (1 + 1e-9))
    return beam_of(least, u.mas)


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
            "the epochs have no beams, so there is no common one; give them to "
            "EpochCube as beams=[...], or leave this step out"
        )
    target = smallest_common_beam(cube.beams) if beam is None else as_beam(beam)
    goal = target.covariance.value
    to_pixels = np.linalg.inv(cube.pixel_matrix.to_value(u.mas))
    data = cube.data.copy()
    changed = []
    for i, own in enumerate(cube.beams):
        covariance = own.covariance.value
        if _excess(goal, covariance) > 1 + CONTAINS:
            raise ValueError(
                f"{cube.labels[i]}: its beam {own} does not fit into {target}; "
                "choose a larger one, or none for the smallest common beam"
            )
        if max(_excess(goal, covariance), _excess(covariance, goal)) <= 1 + EQUAL:
            continue
        variances, axes = np.linalg.eigh(to_pixels @ (goal - covariance) @ to_pixels.T)
        # Rounding errors must not leave a negative variance.
        difference = (axes * np.maximum(variances, 0)) @ axes.T
        data[i] = gaussian_smooth(data[i], difference, cube.mask[i])
        if is_per(cube.unit, "beam"):
            data[i] *= float(target.area / own.area)
        changed.append(i)
    return cube.with_step(
        f"common beam {target} ({len(changed)} of {len(cube)} epochs convolved)",
        data=data,
        beams=(target,) * len(cube),
        noise=None if changed else cube.noise,
    )
