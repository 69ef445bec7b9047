# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The noise of wavelet planes."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from astro_scc.decomposition.wavelet import KERNELS, scale_kernel, scale_size

MAD_TO_SIGMA = 1.482602218505602
#: A tenth of a Gaussian's absolute values lie below ``sigma / DECILE_TO_SIGMA``.
DECILE_TO_SIGMA = 1 / 0.12566134685507402
#: Pixels above this many sigma belong to the source, with their surroundings.
SOURCE_SNR = 5.0
MAX_ITERATIONS = 25
LOCAL_ITERATIONS = 3


def source_free(plane, scale, *, mask=None):
    """
    Find the pixels of a wavelet plane that show no source, and their sigma.

    Pixels beyond 5 sigma are removed together with a disk of one scale
    around them, with sigma = ``1.4826 median |w|`` of all others, until
    sigma converges.  The first sigma is that of the faintest tenth of the
    pixels, so that a source may fill most of the image; if that leaves no
    sky, the first sigma is that of all pixels.
    """
    valid = np.ones(plane.shape, dtype=bool) if mask is None else ~np.asarray(mask)
    values = np.abs(plane[valid])
    values = values[values > 0]
    if values.size == 0:
        return valid, 0.0
    quantiles = np.quantile(values, [0.1, 0.5]) * [DECILE_TO_SIGMA, MAD_TO_SIGMA]
    faintest, everything = quantiles.tolist()
    for start in (min(faintest, everything), everything):
        free, sigma = _without_source(plane, scale_size(scale), valid, start)
        if free is not valid:
            break
    return free, sigma


def _away_from_source(plane, radius, valid, sigma):
    """Return the pixels farther than a radius from all pixels beyond 5 sigma."""
    source = valid & (np.abs(plane) > SOURCE_SNR * sigma)
    away = np.ones(plane.shape, dtype=bool)
    margin = int(np.ceil(radius))
    # There is one box around the source, or none without a source.
    for box in ndimage.find_objects(source.astype(np.uint8)):
        near = tuple(slice(max(k.start - margin, 0), k.stop + margin) for k in box)
        away[near] = ndimage.distance_transform_edt(~source[near]) > radius
    return away


def _without_source(plane, radius, valid, sigma):
    """Iterate `source_free`, starting from a first sigma."""
    free = valid
    for _ in range(MAX_ITERATIONS):
        candidate = valid & _away_from_source(plane, radius, valid, sigma)
        sky = np.abs(plane[candidate & (plane != 0)])
        # A sky smaller than one disk is too small to measure noise.
        if candidate.sum() < np.pi * radius**2 or len(sky) == 0:
            break
        before, free, sigma = sigma, candidate, MAD_TO_SIGMA * float(np.median(sky))
        if abs(sigma - before) < 1e-3 * before:
            break
    return free, sigma


def plane_noise(
    plane: np.ndarray, scale: float, *, mask: ArrayLike | None = None
) -> float:
    """
    Measure the standard deviation of the noise of a wavelet plane in the plane.

    It is ``1.4826 median |w|`` of the pixels that show no source.  These are
    found by iteration: pixels beyond 5 sigma are removed, with a disk of one
    scale around them, until sigma converges.  Pixels that are exactly zero
    (blanked) do not count.

    Parameters
    ----------
    plane : `~numpy.ndarray`, shape (ny, nx)
    scale : float
        Scale number.
    mask : array_like of bool, shape (ny, nx), optional
        True marks missing pixels.

    Returns
    -------
    float
        Zero if the plane is zero.

    Notes
    -----
    Wavelets of a source reach about two scales (four with ``b3``) beyond it.
    If an image holds no sky at that distance, the noise is overestimated, and
    ``noise="propagated"`` of `Decomposer` is better.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.decomposition.noise import plane_noise
    >>> plane = np.random.default_rng(0).normal(size=(128, 128))
    >>> plane[60:68, 60:68] += 100
    >>> round(plane_noise(plane, 1), 1)
    1.0
    """
    return source_free(plane, scale, mask=mask)[1]


def shared_variance(planes, scale, *, masks=(None, None)):
    r"""
    Measure the share of variance beside bright sources that two images have in common.

    It is the largest correlation, at any displacement, of the two planes a and b,
    each set to zero where it shows a source (see `plane_noise`):

    .. math:: \max_d \frac{\sum_x a(x + d)\, b(x)}
              {\sqrt{\sum a^2 \sum b^2}}.

    The image is taken to be periodic.  Noise differs between the images; what they
    share is structure, which moves or stands still.

    ``planes`` are those of one ``scale`` at two epochs, shape (ny, nx), and ``masks``,
    or None, mark missing pixels.  Returns the share, so that the variance of the noise
    is ``1 - share`` of the plane's, or less if structure moves at different
    velocities or changes; and the standard deviation of the correlation of independent
    planes at one displacement, which is infinite if a plane is zero.
    """
    skies, parts = [], []
    for plane, mask in zip(planes, masks, strict=True):
        free, _ = source_free(plane, scale, mask=mask)
        skies.append(np.where(free, plane, 0.0))
        parts.append(free.mean())
    norm = np.sqrt(np.prod([np.sum(sky**2) for sky in skies]))
    if norm == 0:
        return 0.0, np.inf
    one, other = (np.fft.rfft2(sky) for sky in skies)
    correlation = np.fft.irfft2(one * other.conj(), s=skies[0].shape) / norm
    chance = np.sqrt(np.mean(correlation**2) / min(parts))
    return float(correlation.max()), float(chance)


def local_noise(plane, scale, *, mask=None):
    """
    Measure the standard deviation of the noise of a wavelet plane, pixel by pixel.

    It is the root mean square of the source-free pixels in boxes, interpolated
    between them (`photutils.background.Background2D` of the squared plane).
    Then the source is found again with this map.  Boxes that the source fills
    to 90% are interpolated from the others.

    The side of a box is 6 times the scale and at least 32 pixels, but at most a
    quarter of the image.  Returns an array with the shape (ny, nx) of the plane.  If
    the source fills every box, it is constant, as from `plane_noise`.
    """
    from photutils.background import Background2D, MeanBackground

    free, sigma = source_free(plane, scale, mask=mask)
    noise = np.full(plane.shape, sigma)
    radius = scale_size(scale)
    box_size = max(4, min(max(32, int(6 * radius)), min(plane.shape) // 4))
    valid = np.ones(plane.shape, dtype=bool) if mask is None else ~np.asarray(mask)
    options = {"exclude_percentile": 90.0, "filter_size": 3, "sigma_clip": None}
    options["bkg_estimator"] = MeanBackground()
    for _ in range(LOCAL_ITERATIONS if sigma > 0 else 0):
        squares = (plane / sigma) ** 2
        try:
            variance = Background2D(squares, box_size, mask=~free, **options).background
        except ValueError:  # no box has enough pixels
            break
        noise = sigma * np.sqrt(np.where(variance > 0, variance, 1.0))
        free = valid & _away_from_source(plane, radius, valid, noise)
    return noise


def propagated_noise(
    rms: float, scales: ArrayLike, *, beam_covariance: ArrayLike | None = None,
    kernel: str = "b1",
) -> np.ndarray:  # fmt: skip
    """
    Return the noise of wavelet planes for image noise of a given rms and beam.

    By Parseval's theorem ``sigma_j^2 = int |H_j|^2 P dk``, where H_j is the
    response of the filter of scale j and P is the power spectrum of white noise
    smoothed by the Gaussian beam, normalised to ``rms^2``.

    Parameters
    ----------
    rms : float
        Standard deviation of the noise of the image.
    scales : sequence of float
        Scale numbers.
    beam_covariance : array_like, shape (2, 2), optional
        Covariance of the beam over (x, y) in pixels squared.  Without it the
        noise is white.
    kernel : {"b1", "b3"}

    Returns
    -------
    `~numpy.ndarray`, shape (n_scales,)

    Examples
    --------
    >>> from astro_scc.decomposition.noise import propagated_noise
    >>> propagated_noise(1.0, [0, 1, 2]).round(3)
    array([0.8  , 0.273, 0.12 ])
    """
    n = 512
    frequency = np.fft.fftfreq(n)
    power = np.ones((n, n))
    if beam_covariance is not None:
        cxx, cxy, cyy = np.asarray(beam_covariance, dtype=float)[[0, 0, 1], [0, 1, 1]]
        ky, kx = np.meshgrid(frequency, frequency, indexing="ij")
        form = cxx * kx**2 + 2 * cxy * kx * ky + cyy * ky**2
        power = np.exp(-4 * np.pi**2 * form)
    power /= power.sum()

    def smoothed(taps, n_steps):
        """Return the response of some smoothings on one axis."""
        offsets = np.multiply.outer(frequency, np.arange(len(taps)) - len(taps) // 2)
        phases = [2 * np.pi * 2**step * offsets for step in range(n_steps)]
        return np.prod([(taps * np.cos(p)).sum(axis=-1) for p in phases], axis=0)

    sigma = []
    for name, level in (scale_kernel(scale, kernel) for scale in scales):
        before, after = (smoothed(KERNELS[name], level + k) for k in (0, 1))
        response = np.outer(before, before) - np.outer(after, after)
        sigma.append(rms * np.sqrt((response**2 * power).sum()))
    return np.array(sigma)
