# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The noise of an image."""

import numpy as np
from numpy.typing import ArrayLike

from astro_scc.decomposition.noise import MAD_TO_SIGMA

CLIP = 3.0
MAX_ITERATIONS = 50
# Images with a larger fraction of exact zeros have been blanked with zeros.
BLANKED = 0.1


def measure_noise(image: ArrayLike, *, mask: ArrayLike | None = None) -> float:
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
    image : array_like, shape (ny, nx)
    mask : array_like of bool, shape (ny, nx), optional
        True marks bad pixels.

    Returns
    -------
    float
        In the unit of the image; 0 if no valid pixel is left.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.images.noise import measure_noise
    >>> image = np.random.default_rng(0).normal(scale=2.0, size=(128, 128))
    >>> image[50:70, 50:70] += 1000
    >>> round(measure_noise(image), 1)
    2.0
    """
    image = np.asarray(image, dtype=float)
    valid = np.isfinite(image)
    if mask is not None:
        valid &= ~np.asarray(mask, dtype=bool)
    kept = image[valid]
    del valid
    n_zero = kept.size - np.count_nonzero(kept)
    if n_zero and n_zero / kept.size > BLANKED:
        kept = kept[kept != 0]
    if kept.size == 0:
        return 0.0
    # Images may be large, so the medians sort in place.
    for _ in range(MAX_ITERATIONS):
        middle = np.median(kept, overwrite_input=True)
        deviation = _deviation(kept, middle)
        sigma = MAD_TO_SIGMA * float(np.median(deviation, overwrite_input=True))
        del deviation
        inside = _deviation(kept, middle) <= CLIP * sigma
        if sigma == 0 or inside.all():
            break
        kept = kept[inside]
    return sigma if sigma > 0 else float(np.std(kept))


def _deviation(values, middle):
    apart = values - middle
    return np.abs(apart, out=apart)
