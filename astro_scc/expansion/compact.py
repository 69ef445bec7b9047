# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images without their compact features."""

import astropy.units as u
import numpy as np
from scipy.ndimage import (
    binary_dilation,
    correlate1d,
    gaussian_filter,
    maximum_filter,
)

#: Standard deviation, in widths, of the narrowest of three Gaussians that are told
#: apart; with it a feature of two widths is half as bright in the finer band.
NARROWEST = 0.227
#: The finer band of a compact feature is more than this part of the coarser one.
RATIO = 0.5
#: Deviation in pixels of the Gaussian that leaves the finest structure, the noise.
FINEST = 0.7
#: Half of the hole for a feature, and the deviation of the weights of its filling, in
#: widths: larger holes are filled worse, smaller ones leave more of the feature.
REACH = 1.0
NEAR = 1.0
#: Terms of the surface that fills holes.
POWERS = ((0, 0), (0, 1), (1, 0), (0, 2), (1, 1), (2, 0))


def remove_compact(cube, width, *, threshold=5.0):
    r"""
    Replace compact features by what surrounds them.

    A pattern of a large scale holds the small features that lie on it, and
    moves in part as they do.  Without them it moves as itself.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    width : `~astropy.units.Quantity`
        Full width at half maximum of the largest feature that is compact.
    threshold : float, optional
        Faintest feature, in standard deviations of the noise around it.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`

    Raises
    ------
    ValueError
        If the width is not positive, or the images are not larger than ten
        widths.
    `~astropy.units.UnitConversionError`
        If the width is no angle.

    Notes
    -----
    With the images :math:`G_k` smoothed by Gaussians of :math:`k\,\times`
    0.227 widths, a feature is a maximum of :math:`F = G_1 - G_2` above the
    noise at which :math:`F > |G_2 - G_4| / 2`.  A Gaussian of two widths is
    just not one.  The noise of F is the local one of the finest structure,
    which is that of counts, scaled as noise that is independent from pixel
    to pixel; where it is not, give a higher threshold.  Within a width of
    each feature the image is replaced by surfaces of the second degree,
    fitted with Gaussian weights of one width to the pixels that stay.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.expansion import remove_compact
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
    """Return what is compact, and its surroundings."""
    share = good.astype(float)

    def smooth(s):
        weight = np.maximum(gaussian_filter(share, s), 1e-6)
        return np.where(good, gaussian_filter(image, s) / weight, 0.0)

    a = NARROWEST * w
    narrow, middle, wide = (smooth(k * a) for k in (1, 2, 4))
    fine, coarse = narrow - middle, middle - wide
    least = image - smooth(FINEST)
    local = gaussian_filter(least**2, 3 * w)
    local /= np.maximum(gaussian_filter(share, 3 * w), 1e-6)
    noise = _noise_ratio(a) * np.sqrt(local)
    top = (
        good
        & (maximum_filter(fine, size=3) == fine)
        & (fine > threshold * noise)
        & (fine > RATIO * np.abs(coarse))
    )
    reach = REACH * w
    k = int(np.ceil(reach))
    y, x = np.mgrid[-k : k + 1, -k : k + 1]
    return binary_dilation(top, structure=np.hypot(x, y) <= reach)


def _noise_ratio(a):
    """Return white noise of the finer band over that of the finest structure."""
    point = np.zeros((2 * int(np.ceil(10 * a)) + 1,) * 2)
    point[len(point) // 2, len(point) // 2] = 1
    fine = gaussian_filter(point, a) - gaussian_filter(point, 2 * a)
    least = point - gaussian_filter(point, FINEST)
    return np.sqrt((fine**2).sum() / (least**2).sum())


def _fill(image, known, good, hole, s):
    """Return an image with surfaces of the second degree in its holes."""
    if not hole.any():
        return image
    weight = good.astype(float)
    values = known * weight
    n = int(np.ceil(4 * s))
    step = np.arange(-n, n + 1) / s
    bell = np.exp(-0.5 * step**2)

    def moment(of, p, q):
        rows = correlate1d(of, bell * step**p, axis=0, mode="constant")
        return correlate1d(rows, bell * step**q, axis=1, mode="constant")[hole]

    right = np.stack([moment(values, *power) for power in POWERS], axis=-1)
    moments = {(p, q): moment(weight, p, q) for p in range(5) for q in range(5 - p)}
    normal = np.empty((len(right), len(POWERS), len(POWERS)))
    for i, (p, q) in enumerate(POWERS):
        for j, (r, t) in enumerate(POWERS):
            normal[:, i, j] = moments[p + r, q + t]
    found = np.linalg.pinv(normal, rcond=1e-6, hermitian=True) @ right[..., None]
    filled = np.array(image, dtype=float)
    filled[hole] = found[:, 0, 0]
    return filled
