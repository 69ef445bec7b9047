# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Model of an image: circular Gaussians, each convolved with the beam."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.linalg.lapack import dgesv

# Full width at half maximum of a Gaussian in standard deviations.
_FWHM = np.sqrt(8 * np.log(2))
# Columns of the parameters of components: convolved peak, position, and variance
# before the convolution, which unlike a width has a gradient at zero.
_PEAK, _Y, _X, _VARIANCE = range(4)
#: All samples of an image.
EVERYWHERE = slice(None)
#: Least residual for a new component, and its least peak, in errors of the image there.
THRESHOLD = 5.0
#: Error of an image relative to its largest value within half a beam, for what is
#: neither Gaussian nor well calibrated; added to the noise in quadrature.
RELATIVE_ERROR = 0.001
#: Greatest number of components.
MOST_COMPONENTS = 20


@dataclass(frozen=True, eq=False)
class Gaussians:
    """
    Circular Gaussians that make up a model of one image, brightest first.

    Attributes
    ----------
    y, x : `~numpy.ndarray`, shape (n,)
        Position in pixels.
    peak : `~numpy.ndarray`, shape (n,)
        Peak after the convolution with the beam, in the unit of the image.
    flux : `~numpy.ndarray`, shape (n,)
        Integrated flux in the unit of the image times beams: Jy for an image in
        Jy/beam.
    size : `~numpy.ndarray`, shape (n,)
        Full width at half maximum in pixels before the convolution; zero for a
        point.
    y_err, x_err : `~numpy.ndarray`, shape (n,)
        Standard errors of the position in pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.features.gaussians import fit_gaussians
    >>> y, x = np.mgrid[:40, :60]
    >>> image = np.exp(-((x - 20.3) ** 2 + (y - 15) ** 2) / 18)
    >>> len(fit_gaussians(image, 9 * np.eye(2), 0.01))
    1
    """

    y: np.ndarray
    x: np.ndarray
    peak: np.ndarray
    flux: np.ndarray
    size: np.ndarray
    y_err: np.ndarray
    x_err: np.ndarray

    def __len__(self) -> int:
        return len(self.y)


def fit_gaussians(
    image: ArrayLike, beam: np.ndarray, noise: float, *, mask: ArrayLike = False
) -> Gaussians:
    r"""
    Fit circular Gaussians, convolved with the beam, to an image.

    A component is added where the residual is largest, and fitted together with
    its neighbours, as long as the residual there exceeds five errors and the
    Bayesian information criterion falls (Schwarz 1978),

    .. math:: \mathrm{BIC} = \chi^2 + 4 n \ln N,

    with n components of four parameters each.  :math:`\chi^2` and N count the
    area of the image in correlation areas of its noise,
    :math:`4 \pi \sqrt{\det B}` (Condon 1997).  Then all components are fitted
    together, and those that the criterion does not need any more are left out, as
    are those whose peak is below five errors.

    The errors of the positions are those of this fit in noise that is correlated
    as the beam.  For an isolated point they are :math:`\sqrt{2} b / \mathrm{SNR}`
    along each axis, with the standard deviation b of the beam: 0.6 full widths per
    SNR, where Fomalont (1999) has 0.5.

    Parameters
    ----------
    image : array_like, shape (ny, nx)
        Only positive components are fitted.
    beam : `~numpy.ndarray`, shape (2, 2)
        Covariance of the Gaussian beam over (y, x) in square pixels.
    noise : float
        Standard deviation of the noise, in the unit of the image.
    mask : array_like of bool, shape (ny, nx), optional
        True marks missing pixels, as does NaN.  They take no part in the fit.

    Returns
    -------
    `Gaussians`
        Without rows if nothing is above five errors.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.features.gaussians import fit_gaussians
    >>> y, x = np.mgrid[:50, :60]
    >>> beam = np.diag([16.0, 9.0])
    >>> point = np.exp(-((y - 20.3) ** 2 / 32 + (x - 30.6) ** 2 / 18))
    >>> wide = np.exp(-((y - 30) ** 2 / 50 + (x - 40) ** 2 / 36))
    >>> found = fit_gaussians(point + 0.5 * wide, beam, 0.001)
    >>> found.y.round(2), found.x.round(2), found.size.round(2)
    (array([20.3, 30. ]), array([30.6, 40. ]), array([0.  , 7.06]))
    """
    data = _Data.of(image, beam, noise, mask)
    p = [] if data is None else _grown(data)
    if len(p) == 0:
        return Gaussians(*(np.empty(0) for _ in fields(Gaussians)))
    p = _pruned(_least_squares(p, data, EVERYWHERE, 0.0), data)
    y_err, x_err = _position_errors(p, data)
    order = np.argsort(-p[:, _PEAK], kind="stable")
    # Their peaks are compared with the error beside them: fainter ones are needed by
    # the model, but their places mean little.
    square = np.subtract.outer(p[order, _Y], data.y) ** 2
    square += np.subtract.outer(p[order, _X], data.x) ** 2
    beside = data.weight[square.argmin(axis=1)]
    order = order[p[order, _PEAK] * beside >= THRESHOLD]
    p, y_err, x_err = p[order], y_err[order], x_err[order]
    peak = p[:, _PEAK] * noise
    return Gaussians(
        y=p[:, _Y] + data.origin[0], x=p[:, _X] + data.origin[1], peak=peak,
        flux=peak * np.sqrt(_areas(p, beam) / np.linalg.det(beam)),
        size=_FWHM * np.sqrt(p[:, _VARIANCE]), y_err=y_err, x_err=x_err,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Data:
    """
    Samples of an image near its bright parts, three to a beam.

    ``value`` and ``weight`` (inverse errors) are in units of the noise, the
    positions ``y`` and ``x`` count from ``origin``.  ``independent`` is the number
    of independent samples for each sample, ``penalty`` the least decrease of chi^2 for
    a component.
    """

    y: np.ndarray
    x: np.ndarray
    value: np.ndarray
    weight: np.ndarray
    origin: tuple[int, int]
    beam: np.ndarray
    independent: float
    penalty: float

    @classmethod
    def of(cls, image, beam, noise, mask):
        """Return the samples of an image; None if nothing is above the threshold."""
        if not noise > 0:
            return None
        good = np.isfinite(image) & ~np.asarray(mask, dtype=bool)
        value = np.where(good, image, 0.0) / noise
        bright = value > THRESHOLD
        if not bright.any():
            return None
        width = _FWHM * np.sqrt(np.diag(beam))
        margin = np.ceil(width).astype(int)
        cut = tuple(
            slice(max(at.min() - m, 0), at.max() + m + 1)
            for at, m in zip(np.nonzero(bright), margin, strict=True)
        )
        good, bright, value = good[cut], bright[cut], value[cut]
        peak = ndimage.maximum_filter(value, size=tuple(width.astype(int) | 1))
        near = ndimage.maximum_filter(bright, size=tuple(2 * margin + 1))
        step = np.maximum(width.astype(int) // 3, 1)
        y, x = np.nonzero((near & good)[:: step[0], :: step[1]])
        if len(y) == 0:
            return None
        independent = step.prod() / (4 * np.pi * np.sqrt(np.linalg.det(beam)))
        at = y * step[0], x * step[1]
        error = np.hypot(1.0, RELATIVE_ERROR * peak[at])
        return cls(
            y=at[0].astype(float), x=at[1].astype(float), value=value[at],
            weight=1 / error, beam=beam, origin=(cut[0].start, cut[1].start),
            independent=independent, penalty=4 * np.log(max(len(y) * independent, 2)),
        )  # fmt: skip

    def distance(self, y, x, at):
        """Return distances from a position in full widths of the beam."""
        offset = np.stack([y - at[0], x - at[1]])
        inverse = np.linalg.inv(self.beam)
        return np.sqrt(np.einsum("in,ij,jn->n", offset, inverse, offset)) / _FWHM

    def model(self, p, where):
        """Return the sum of components at some of the samples."""
        return p[:, _PEAK] @ _shapes(p, self.y[where], self.x[where], self.beam)[0]

    def chi2(self, p, where):
        """Return the chi^2 of some of the samples."""
        left = (self.value[where] - self.model(p, where)) * self.weight[where]
        return left @ left * self.independent


def _areas(p, beam):
    """Return the determinants of the covariances of the convolved components."""
    v = p[:, _VARIANCE]
    return (beam[0, 0] + v) * (beam[1, 1] + v) - beam[0, 1] ** 2


def _shapes(p, y, x, beam):
    """
    Return components of unit peak, and the offsets times the inverse covariance.

    All have the shape (n, number of positions).
    """
    v, area = p[:, _VARIANCE, None], _areas(p, beam)[:, None]
    dy, dx = y - p[:, _Y, None], x - p[:, _X, None]
    cross = beam[0, 1] / area
    gy = (beam[1, 1] + v) / area * dy
    gy -= cross * dx
    gx = (beam[0, 0] + v) / area * dx
    gx -= cross * dy
    # These arrays are small, and new ones take longer than the numbers.
    dy *= gy
    dx *= gx
    dy += dx
    dy *= -0.5
    return np.exp(dy, out=dy), gy, gx


def _derivatives(p, shape, gy, gx):
    """Return the derivatives of the components, shape (n, 4, number of positions)."""
    value = p[:, _PEAK, None] * shape
    found = np.empty((len(p), 4, shape.shape[1]))
    found[:, _PEAK] = shape
    np.multiply(value, gy, out=found[:, _Y])
    np.multiply(value, gx, out=found[:, _X])
    square = gy * gy
    square += gx * gx
    square *= 0.5
    np.multiply(value, square, out=found[:, _VARIANCE])
    return found


def _least_squares(p, data, where, fixed, iterations=12, tolerance=1e-4):
    """
    Fit components by the method of Levenberg and Marquardt.

    ``fixed`` is the sum of other components at the samples.  The normal equations
    are solved, which takes less time than the decomposition of the whole Jacobian
    by `scipy.optimize.least_squares`.
    """
    y, x, weight = data.y[where], data.x[where], data.weight[where]
    value = (data.value[where] - fixed) * weight
    largest_step = np.array([np.inf, *np.sqrt(np.diag(data.beam)), np.inf])
    widest = np.ptp(data.y) ** 2 + np.ptp(data.x) ** 2
    lowest = np.array([0.0, -np.inf, -np.inf, 0.0])
    highest = np.array([np.inf, np.inf, np.inf, widest])

    def state(p):
        shape, gy, gx = _shapes(p, y, x, data.beam)
        shape *= weight
        left = value - p[:, _PEAK] @ shape
        return (shape, gy, gx), left, left @ left

    parts, left, cost = state(p)
    damping = 1e-3
    for _ in range(iterations):
        jacobian = _derivatives(p, *parts).reshape(p.size, -1)
        normal, gradient = jacobian @ jacobian.T, jacobian @ left
        scale = np.sqrt(normal.diagonal())
        # A component without samples stays as it is, and so does a variance of zero
        # that would become negative.
        scale[scale <= 1e-9 * scale.max()] = 1.0
        stays = (p[:, _VARIANCE] <= 0) & (gradient[_VARIANCE::4] <= 0)
        scale[_VARIANCE::4][stays] = np.inf
        normal /= scale
        normal /= scale[:, None]
        gradient /= scale
        for _ in range(6):
            damped = normal.copy()
            damped.flat[:: p.size + 1] += damping
            step = dgesv(damped, gradient)[2] / scale
            step = step.reshape(p.shape).clip(-largest_step, largest_step)
            new = (p + step).clip(lowest, highest)
            after = state(new)
            if after[2] < cost:
                break
            damping *= 5
        else:
            break
        done = cost - after[2] < tolerance * cost
        p, (parts, left, cost) = new, after
        damping = max(damping / 5, 1e-7)
        if done:
            break
    return p


def _refitted(p, data, at):
    """Fit the components around a position; return all, and the samples used."""
    near = data.distance(p[:, _Y], p[:, _X], at) < 3
    width = _FWHM * np.sqrt(np.diag(data.beam))
    where = np.abs(data.y - at[0]) < 4 * width[0]
    where &= np.abs(data.x - at[1]) < 4 * width[1]
    if near.any():
        fixed = data.model(p[~near], where)
        p = p.copy()
        p[near] = _least_squares(p[near], data, where, fixed)
    return p, where


def _grown(data):
    """Return components, added one after the other at the largest residual."""
    p, tried = np.empty((0, 4)), 0
    residual = data.value * data.weight
    while len(p) < MOST_COMPONENTS and tried < 3:
        k = np.argmax(residual)
        if residual[k] < THRESHOLD:
            break
        at = data.y[k], data.x[k]
        first = residual[k] / data.weight[k], *at, data.beam.trace() / 32
        new, where = _refitted(np.vstack([p, first]), data, at)
        if data.chi2(p, where) - data.chi2(new, where) > data.penalty:
            p, tried = new, 0
            residual = (data.value - data.model(p, EVERYWHERE)) * data.weight
        else:
            tried += 1
            residual[data.distance(data.y, data.x, at) < 0.5] = 0.0
    return p


def _pruned(p, data):
    """Return components without those whose removal costs less than they do."""
    for one in p[np.argsort(p[:, _PEAK], kind="stable")]:
        k = np.argmin(np.abs(p - one).sum(axis=1))
        new, where = _refitted(np.delete(p, k, axis=0), data, p[k, [_Y, _X]])
        if data.chi2(new, where) - data.chi2(p, where) < data.penalty:
            p = new
    return p


def _position_errors(p, data):
    """
    Return the standard errors of y and x.

    The covariance of a least-squares fit is (J J')^-1 J C J' (J J')^-1.  The
    covariance of the noise C is the square of a convolution with the beam, which
    turns components into wider ones.
    """
    beam, weight = data.beam, data.weight
    plain = _derivatives(p, *_shapes(p, data.y, data.x, beam)) * weight
    smooth = _derivatives(p, *_shapes(p, data.y, data.x, 2 * beam)) * weight
    area, wide = _areas(p, beam), _areas(p, 2 * beam)
    # The convolution lowers the peak, the less the wider the component.
    v = p[:, _VARIANCE]
    change = (beam.trace() / 2 + v) / area - (beam.trace() + v) / wide
    smooth[:, _VARIANCE] += (change * p[:, _PEAK])[:, None] * smooth[:, _PEAK]
    smooth *= np.sqrt(area / wide)[:, None, None]
    plain, smooth = plain.reshape(p.size, -1), smooth.reshape(p.size, -1)
    inverse = np.linalg.pinv(plain @ plain.T)
    spread = inverse @ smooth
    variance = (spread**2).sum(axis=1) / data.independent
    return np.sqrt(variance[_Y::4]), np.sqrt(variance[_X::4])
