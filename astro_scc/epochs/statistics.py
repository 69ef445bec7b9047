# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Robust numbers of one image."""

import numpy as np

__all__ = ["measure_noise"]

MAD_TO_SIGMA = 1.482602218505602
CLIP = 3.0
MAX_ITERATIONS = 50
# Images with more exact zeros than this have been blanked with zeros.
BLANKED = 0.1


def measure_noise(image, *, mask=None):
    """
    Root mean square of the noise of an image, away from the source.

    With m the median and ``s = 1.4826 median|I - m|`` (the median absolute
    deviation, MAD), pixels with ``|I - m| > 3 s`` are left out and both are
    computed again until nothing more falls out.  Noise that the beam
    correlates has the same distribution of values as white noise of that
    rms, so it needs no correction.  Pixels that are exactly zero count as
    blanked where they are more than a tenth of the image.  Where the MAD is
    zero all the same the standard deviation is returned.

    The source should cover less than half of the image.

    Parameters
    ----------
    image : array_like, shape (ny, nx)
    mask : array_like of bool, shape (ny, nx), optional
        True marks bad pixels.

    Returns
    -------
    float
        In the unit of the image; 0 where no valid pixel is left.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.epochs import measure_noise
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
    # Images may be large: medians sort in place, since the order is no matter.
    for _ in range(MAX_ITERATIONS):
        middle = np.median(kept, overwrite_input=True)
        sigma = MAD_TO_SIGMA * float(
            np.median(_deviation(kept, middle), overwrite_input=True)
        )
        inside = _deviation(kept, middle) <= CLIP * sigma
        if sigma == 0 or inside.all():
            break
        kept = kept[inside]
    return sigma if sigma > 0 else float(np.std(kept))


def _deviation(values, middle):
    apart = values - middle
    return np.abs(apart, out=apart)
