# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Remove compact features from images.

``shells.py`` shows with it how far the small features on a shell change its rate.
"""

import astropy.units as u
import numpy as np
from scipy import ndimage

from astro_scc.epochs import EpochCube

#: Standard deviation, in widths, of the narrowest of three Gaussian filters, for which
#: a feature of two widths is half as bright in the finer band.
NARROWEST = 0.227
#: Smallest ratio of the finer to the coarser band of a compact feature.
RATIO = 0.5
#: Standard deviation, in pixels, of the filter that leaves the finest structure, noise.
FINEST = 0.7
#: Radius of the hole for a feature, and standard deviation of the weights that fill it,
#: in widths: larger holes are filled worse, smaller ones leave more of the feature.
REACH = 1.0
NEAR = 1.0
#: Terms of the surface that fills holes.
POWERS = ((0, 0), (0, 1), (1, 0), (0, 2), (1, 1), (2, 0))


def remove_compact(
    cube: EpochCube, width: u.Quantity, *, threshold: float = 5.0
) -> EpochCube:
    r"""
    Replace compact features by what surrounds them.

    A pattern on a large scale includes the small features on it and partly
    moves with them.  Without them, it has its own motion.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    width : `~astropy.units.Quantity`
        Full width at half maximum of the largest compact feature.
    threshold : float, optional
        Faintest feature, in standard deviations of the noise around it.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`

    Raises
    ------
    ValueError
        If the width is not positive, or the images are smaller than ten
        widths.
    `~astropy.units.UnitConversionError`
        If the width is not an angle.

    Notes
    -----
    With the images :math:`G_k` smoothed by Gaussians with standard deviations
    of :math:`k\,\times` 0.227 widths, a compact feature is a maximum of
    :math:`F = G_1 - G_2` above the noise with :math:`F > |G_2 - G_4| / 2`; a
    Gaussian of two widths just fails.  The noise of F is scaled from the local
    noise of the finest structure, which varies as counts do, as if pixels were
    independent; if they are not, give a higher threshold.  Within one width of
    each feature, the image is replaced by surfaces of the second degree, fitted
    to the other pixels with Gaussian weights of one width.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from compact import remove_compact
    >>> from astro_scc.simulation import simulate_shell
    >>> shell = simulate_shell(n_epochs=2, n_clumps=0, rng=1)
    >>> smooth = remove_compact(shell.cube, 5 * u.arcsec)
    >>> int(shell.cube.data.max()) > 300, int(smooth.data.max()) < 120
    (True, True)
    """
    w = _pixels(cube, width)
    images = []
    for image, mask in zip(cube.data, cube.mask, strict=True):
        good = ~mask & np.isfinite(image)
        known = np.where(good, image, 0.0).astype(float)
        hole = _features(known, good, w, threshold) & good
        images.append(_fill(image, known, good & ~hole, hole, NEAR * w))
    return cube.with_step(
        f"features up to {u.Quantity(width):g} wide replaced by what surrounds them",
        data=np.stack(images).astype(cube.data.dtype),
    )


def _pixels(cube, width):
    """Return a width in pixels."""
    width = u.Quantity(width)
    w = width.to_value(u.mas) / cube.pixel_scale.to_value(u.mas)
    if not (width.isscalar and 0 < w < np.inf):
        raise ValueError(f"the width must be one positive angle, got {width}")
    if 10 * w > min(cube.shape[1:]):
        raise ValueError(
            f"features {w:.0f} pixels wide are not compact in images of "
            f"{cube.shape[2]} x {cube.shape[1]} pixels: give a smaller width"
        )
    return float(w)


def _features(image, good, w, threshold):
    """Return the pixels of compact features and of their surroundings."""
    share = good.astype(float)

    def smooth(values, s):
        weight = np.maximum(ndimage.gaussian_filter(share, s), 1e-6)
        return np.where(good, ndimage.gaussian_filter(values, s) / weight, 0.0)

    a = NARROWEST * w
    narrow, middle, wide = (smooth(image, k * a) for k in (1, 2, 4))
    fine, coarse = narrow - middle, middle - wide
    least = image - smooth(image, FINEST)
    noise = _noise_ratio(a) * np.sqrt(smooth(least**2, 3 * w))
    top = (
        good
        & (ndimage.maximum_filter(fine, size=3) == fine)
        & (fine > threshold * noise)
        & (fine > RATIO * np.abs(coarse))
    )
    reach = REACH * w
    k = int(np.ceil(reach))
    y, x = np.mgrid[-k : k + 1, -k : k + 1]
    return ndimage.binary_dilation(top, structure=np.hypot(x, y) <= reach)


def _noise_ratio(a):
    """Return the ratio of white noise in the finer band to the finest structure."""
    point = np.zeros((2 * int(np.ceil(10 * a)) + 1,) * 2)
    point[len(point) // 2, len(point) // 2] = 1
    smooth = ndimage.gaussian_filter
    fine = smooth(point, a) - smooth(point, 2 * a)
    least = point - smooth(point, FINEST)
    return np.sqrt((fine**2).sum() / (least**2).sum())


def _fill(image, known, good, hole, s):
    """Return an image whose holes are filled with surfaces of the second degree."""
    if not hole.any():
        return image
    weight = good.astype(float)
    values = known * weight
    n = int(np.ceil(4 * s))
    step = np.arange(-n, n + 1) / s
    bell = np.exp(-0.5 * step**2)

    def moment(of, p, q):
        rows = ndimage.correlate1d(of, bell * step**p, axis=0, mode="constant")
        return ndimage.correlate1d(rows, bell * step**q, axis=1, mode="constant")[hole]

    right = np.stack([moment(values, *power) for power in POWERS], axis=-1)
    moments = {(p, q): moment(weight, p, q) for p in range(5) for q in range(5 - p)}
    normal = [[moments[p + r, q + t] for r, t in POWERS] for p, q in POWERS]
    normal = np.moveaxis(np.array(normal), -1, 0)
    found = np.linalg.pinv(normal, rcond=1e-6, hermitian=True) @ right[..., None]
    filled = np.array(image, dtype=float)
    filled[hole] = found[:, 0, 0]
    return filled
