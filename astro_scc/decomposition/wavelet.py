# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The isotropic undecimated ("a trous") wavelet transform, and the noise."""

import numpy as np
import scipy
from numpy.typing import ArrayLike

#: Low-pass filters by name: linear and cubic B-spline.
KERNELS = {
    "b1": np.array([1.0, 2.0, 1.0]) / 4,
    "b3": np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16,
}


def scale_size(scale: float) -> float:
    """
    Return the size of a scale in pixels.

    Scale number j means 2^j pixels; j + 1/2 means the intermediate scale of
    1.5 x 2^j pixels.

    Parameters
    ----------
    scale : float
        Scale number, a multiple of one half.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If there is no such scale.

    Examples
    --------
    >>> from astro_scc.decomposition.wavelet import scale_size
    >>> scale_size(1), scale_size(1.5), scale_size(2)
    (2.0, 3.0, 4.0)
    """
    if not (0 <= scale < np.inf and scale % 1 in (0, 0.5)):
        raise ValueError(f"scale {scale} is not a number of the series 0, 0.5, 1, ...")
    return 2.0 ** int(scale) * (1.5 if scale % 1 else 1.0)


def scale_kernel(scale, kernel):
    """
    Return the filter and the level of the transform that give a scale.

    Intermediate scales are planes of the wider cubic spline, which lie between
    those of the linear one.  Raises a ValueError for an unknown filter, a number
    that is not a scale, or an intermediate scale of "b3".
    """
    if kernel not in KERNELS:
        raise ValueError(f"unknown wavelet kernel {kernel!r}: use 'b1' or 'b3'")
    scale_size(scale)
    level = int(np.floor(scale))
    if scale == level:
        return kernel, level
    if kernel != "b1":
        raise ValueError(f"scale {scale} exists between those of kernel 'b1' only")
    return "b3", level


def scale_reach(scale, kernel):
    """
    Return how many pixels away an image still adds to a wavelet plane.

    It is the whole reach of "b1", and as many standard deviations of "b3", whose far
    weights are small.
    """
    name, level = scale_kernel(scale, kernel)
    taps = KERNELS[name]
    square = (np.arange(len(taps)) - len(taps) // 2) ** 2
    return np.sqrt(2 * square @ taps) * (2 ** (level + 1) - 1)


def _smooth(image, kernel, level):
    """Return an image convolved with the filter dilated by 2^level, edges mirrored."""
    dilated = np.zeros((len(kernel) - 1) * 2**level + 1)
    dilated[:: 2**level] = kernel
    for axis in (0, 1):
        image = scipy.ndimage.convolve1d(image, dilated, axis=axis, mode="mirror")
    return image


def atrous_transform(image, n_levels, *, kernel="b1", mask=None):
    """
    Decompose an image into wavelet planes of doubling scale.

    The image a_0 is smoothed to a_{j+1} = h_j * a_j, where h_j is the low-pass
    filter dilated by 2^j.  The planes are ``w_j = a_j - a_{j+1}``, and the image is
    exactly ``sum_j w_j + a_J`` [1]_.  Edges are mirrored.

    The ``image`` and the ``mask`` of missing pixels are arrays of shape (ny, nx).  Each
    smoothing is normalised by the weight of the valid pixels (``h * (m a) / h * m``),
    and the planes are zero where the image is missing.  Returns the planes, shape
    (n_levels, ny, nx), and the smooth image a_J.  Raises a ValueError if the largest
    filter does not fit the image.

    References
    ----------
    .. [1] Starck, J.-L. & Murtagh, F. 2006, Astronomical Image and Data
       Analysis (Springer), chapter 2.
    """
    filter_ = KERNELS[kernel]
    # Half a filter must fit the image, or mirrored edges would be mirrored again.
    if (len(filter_) // 2) * 2 ** (n_levels - 1) >= min(image.shape):
        raise ValueError(
            f"an image of {image.shape[1]} x {image.shape[0]} px is too small for "
            f"wavelet scale {n_levels - 1} ({2 ** (n_levels - 1)} px): "
            "leave out the largest scales"
        )
    planes = np.empty((n_levels, *image.shape))
    smooth = image if mask is None else np.where(mask, 0.0, image)
    valid = None if mask is None else (~mask).astype(float)
    for level in range(n_levels):
        following = _smooth(smooth, filter_, level)
        if mask is not None:
            weight = _smooth(valid, filter_, level)
            # A valid pixel contributes to its own weight, which is thus positive.
            following = np.divide(
                following, weight, out=np.zeros_like(smooth), where=~mask
            )
        planes[level] = smooth - following
        smooth = following
    return planes, smooth


def wavelet_planes(
    image: ArrayLike, scales: ArrayLike, *, kernel: str = "b1",
    mask: ArrayLike | None = None,
) -> np.ndarray:  # fmt: skip
    """
    Return the wavelet planes of chosen scales.

    Parameters
    ----------
    image : array_like, shape (ny, nx)
    scales : sequence of float
        Scale numbers, see `scale_size`.
    kernel : {"b1", "b3"}
    mask : array_like of bool, shape (ny, nx), optional
        True marks missing pixels.

    Returns
    -------
    `~numpy.ndarray`, shape (n_scales, ny, nx)

    Raises
    ------
    ValueError
        If there is no such scale, or it does not fit the image.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.decomposition.wavelet import wavelet_planes
    >>> wavelet_planes(np.eye(32), [1, 1.5, 2]).shape
    (3, 32, 32)
    """
    places = [scale_kernel(scale, kernel) for scale in scales]
    transforms = {}
    for name in {name for name, _ in places}:
        n_levels = 1 + max(level for key, level in places if key == name)
        transforms[name], _ = atrous_transform(image, n_levels, kernel=name, mask=mask)
    return np.stack([transforms[name][level] for name, level in places])


MAD_TO_SIGMA = 1.482602218505602
#: A tenth of a Gaussian's absolute values lie below ``sigma / DECILE_TO_SIGMA``.
DECILE_TO_SIGMA = 1 / 0.12566134685507402


def source_free(plane, scale, *, mask=None, iterations=25):
    """
    Find the pixels of a wavelet plane that show no source, and their sigma.

    Pixels beyond 5 sigma are removed together with a disk of one scale
    around them, with sigma = ``1.4826 median |w|`` of all others, until
    sigma converges.  The first sigma is that of the faintest tenth of the
    pixels, so that a source may fill most of the image; if that leaves no
    sky, the first sigma is that of all pixels.
    """
    valid = np.ones(plane.shape, dtype=bool) if mask is None else ~np.asarray(mask)
    values = np.abs(plane)
    known = valid & (values > 0)
    seen = values[known]
    if seen.size == 0:
        return valid, 0.0
    tenth = 0.1 * (len(seen) - 1)
    below, above = _ranked(seen, int(tenth), int(np.ceil(tenth)))
    faintest = float(below + (above - below) * (tenth % 1)) * DECILE_TO_SIGMA
    everything = median(seen) * MAD_TO_SIGMA
    free, radius = valid, scale_size(scale)
    for sigma in (min(faintest, everything), everything):
        for _ in range(iterations):
            candidate = valid & _away_from_source(values, radius, valid, sigma)
            sky = values[candidate & known]
            # A sky smaller than one disk is too small to measure noise.
            if np.count_nonzero(candidate) < np.pi * radius**2 or len(sky) == 0:
                break
            before, free, sigma = sigma, candidate, MAD_TO_SIGMA * median(sky)
            if abs(sigma - before) < 1e-3 * before:
                break
        if free is not valid:
            break
    return free, float(sigma)


def median(values):
    """Return the median of numbers, several times faster than numpy for many."""
    return float(_ranked(values, (len(values) - 1) // 2, len(values) // 2).mean())


def _ranked(values, first, second):
    """
    Return the values of two ranks that are equal or consecutive.

    Two of a sample are the limits of the few values that are sorted (Floyd & Rivest
    1975, Communications of the ACM 18, 165).
    """
    sample = np.sort(values[::32])
    place, margin = first * len(sample) / len(values), 2 * np.sqrt(len(sample))
    low = sample[max(int(place - margin), 0)]
    high = sample[min(int(place + margin) + 1, len(sample) - 1)]
    below = values < low
    near, n_below = values[below ^ (values <= high)], np.count_nonzero(below)
    if not n_below <= first <= second < n_below + len(near):
        near, n_below = values, 0
    ranks = first - n_below, second - n_below
    return np.partition(near, ranks)[[*ranks]]


def _away_from_source(values, radius, valid, sigma, snr=5.0):
    """Return the pixels farther than a radius from all values beyond 5 sigma."""
    source = valid & (values > snr * sigma)
    near, wide, reach = np.zeros_like(source), source.copy(), 0
    # Rows of a disk around the source, from the narrowest to the widest.
    for away in range(int(radius), -1, -1):
        while (reach + 1) ** 2 + away**2 <= radius**2:
            reach += 1
            wide[:, reach:] |= source[:, :-reach]
            wide[:, :-reach] |= source[:, reach:]
        near[away:] |= wide[: -away or None]
        near[: -away or None] |= wide[away:]
    return ~near


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
    >>> from astro_scc.decomposition.wavelet import plane_noise
    >>> plane = np.random.default_rng(0).normal(size=(128, 128))
    >>> plane[60:68, 60:68] += 100
    >>> round(plane_noise(plane, 1), 1)
    1.0
    """
    return source_free(plane, scale, mask=mask)[1]


def shared_variance(pair, scale):
    r"""
    Measure the share of variance beside bright sources that two images have in common.

    It is the largest correlation, at any displacement, of the two planes a and b,
    each set to zero where it shows a source (see `plane_noise`):

    .. math:: \max_d \frac{\sum_x a(x + d)\, b(x)}
              {\sqrt{\sum a^2 \sum b^2}}.

    The image is taken to be periodic.  Noise differs between the images; what they
    share is structure, which moves or stands still.

    The ``pair`` are two planes of one ``scale``, shape (ny, nx), each with a mask of
    its missing pixels, or None.  Returns the share, so that the variance of the noise
    is ``1 - share`` of the plane's, or less if structure moves at different
    velocities or changes; and the standard deviation of the correlation of independent
    planes at one displacement, which is infinite if a plane is zero.
    """
    skies, parts = [], []
    for plane, mask in pair:
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


def local_noise(plane, scale, *, mask=None, iterations=3):
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
    for _ in range(iterations if sigma > 0 else 0):
        squares = (plane / sigma) ** 2
        try:
            variance = Background2D(squares, box_size, mask=~free, **options).background
        except ValueError:  # no box has enough pixels
            break
        noise = sigma * np.sqrt(np.where(variance > 0, variance, 1.0))
        free = valid & _away_from_source(np.abs(plane), radius, valid, noise)
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
    >>> from astro_scc.decomposition.wavelet import propagated_noise
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

    def smoothed(name, n_steps):
        """Return the response of some smoothings on one axis."""
        waves = [np.cos(np.pi * 2**step * frequency) for step in range(n_steps)]
        # The response of a B-spline is a power of a cosine.
        return np.prod(waves, axis=0) ** (len(KERNELS[name]) - 1)

    sigma = []
    for name, level in (scale_kernel(scale, kernel) for scale in scales):
        before, after = (smoothed(name, level + k) for k in (0, 1))
        response = np.outer(before, before) - np.outer(after, after)
        sigma.append(rms * np.sqrt((response**2 * power).sum()))
    return np.array(sigma)


def measure_noise(
    image: np.ndarray, mask: np.ndarray, *, clip: float = 3.0, blanked: float = 0.1
) -> float:
    """
    Return the root mean square of the noise of an image, away from the source.

    With the median m and ``s = 1.4826 median|I - m|`` (from the median absolute
    deviation, MAD), pixels with ``|I - m| > 3 s`` are left out, and m and s are
    computed again until no more pixels are left out.  Noise that the beam
    correlates has the same distribution of values as white noise of the same
    rms, so it needs no correction.  Pixels that are exactly zero count as
    blanked if they are more than a tenth of the image.  If the MAD is still
    zero, the standard deviation is returned.

    The source should cover less than half of the image.

    Parameters
    ----------
    image : `~numpy.ndarray`, shape (ny, nx)
    mask : `~numpy.ndarray` of bool, shape (ny, nx)
        True marks bad pixels.
    clip : float, optional
        Pixels further from the median, in standard deviations, are no noise.
    blanked : float, optional
        Images with a larger fraction of exact zeros have been blanked with zeros.

    Returns
    -------
    float
        In the unit of the image; 0 if no valid pixel is left.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.decomposition.wavelet import measure_noise
    >>> image = np.random.default_rng(0).normal(scale=2.0, size=(128, 128))
    >>> image[50:70, 50:70] += 1000
    >>> round(measure_noise(image, np.zeros(image.shape, bool)), 1)
    2.0
    """
    image = np.asarray(image, dtype=float)
    kept = image[np.isfinite(image) & ~mask]
    n_zero = kept.size - np.count_nonzero(kept)
    if n_zero and n_zero / kept.size > blanked:
        kept = kept[kept != 0]
    if kept.size == 0:
        return 0.0
    # astropy's SigmaClip gives the same number in several times the time.
    while True:
        deviation = np.abs(kept - median(kept))
        sigma = MAD_TO_SIGMA * median(deviation)
        inside = deviation <= clip * sigma
        if sigma == 0 or inside.all():
            return sigma or float(np.std(kept))
        kept = kept[inside]
