# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Model of an image: Gaussians, round ones where they suffice, with the beam."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import ArrayLike

# Full width at half maximum of a Gaussian in standard deviations.
_FWHM = np.sqrt(8 * np.log(2))
# Columns of the parameters of components: convolved peak, position, and variance
# before the convolution, which unlike a width has a gradient at zero.  Elliptical ones
# have a variance of the mean of both axes, half of the difference of those along y and
# x, and a covariance; of round ones the last two are zero.
_PEAK, _Y, _X, _VARIANCE, _STRETCH, _TILT = range(6)
#: All samples of an image.
EVERYWHERE = slice(None)
#: Least residual for a new component, and its least peak, in errors of the image there.
THRESHOLD = 5.0
#: Least noise, in parts of the peak: numbers of single precision are rounded as much.
ROUNDING = 1e-7
#: Components of which the nearest are so many beams away may be parts of one ellipse,
#: at most so many of them, if it lowers chi^2 by so many penalties of a component.
JOINED, MOST_JOINED, BETTER = 1.6, 5, 5.0
#: An ellipse is at least as wide as so many beams: those of headers may be off.
NARROWEST = 0.9
#: Columns of Gaussians, see `fit_gaussians`.
COLUMNS = np.dtype([*((k, float) for k in "y x peak flux size y_err x_err".split()),
                    ("group", int)])  # fmt: skip
#: A fit is hopeless if so many times what its next step promises are not enough.
HOPELESS = 100.0


def fit_gaussians(
    image: ArrayLike, beam: np.ndarray, noise: float, *, mask: ArrayLike = False
) -> np.ndarray:
    r"""
    Fit Gaussians, convolved with the beam, to an image.

    A component is added where the residual is largest, and fitted together with
    its neighbours, as long as the residual there exceeds five errors and the
    Bayesian information criterion falls (Schwarz 1978),

    .. math:: \mathrm{BIC} = \chi^2 + 4 n \ln N,

    with n components of four parameters each.  :math:`\chi^2` and N count the
    area of the image in correlation areas of its noise,
    :math:`4 \pi \sqrt{\det B}` (Condon 1997).  Then all components are fitted
    together, and those that the criterion does not need any more are left out, as
    are those whose peak is below five errors.

    One ellipse then replaces neighbours where it lowers :math:`\chi^2` by five times
    what a component must, and the whole model fits the image; where it is as good by
    the criterion, it is returned beside them.  It may be narrower than the beam by a
    tenth, as beams of headers may be off.

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
        Standard deviation of the noise, in the unit of the image.  If not 0, it is at
        least 1e-7 of the peak, as images without noise have that of their rounding.
    mask : array_like of bool, shape (ny, nx), optional
        True marks missing pixels, as does NaN.  They take no part in the fit.

    Returns
    -------
    `~numpy.ndarray`, shape (n,)
        The Gaussians, brightest first; none if nothing is above five errors.  The
        fields are ``y`` and ``x``, the position in pixels, with standard errors
        ``y_err`` and ``x_err``; ``peak``, after the convolution with the beam, in the
        unit of the image; ``flux``, integrated, in that unit times beams: Jy for an
        image in Jy/beam; ``size``, the full width at half maximum in pixels before the
        convolution, zero for a point; and ``group``: where one ellipse fits as well as
        several components, these have a number, and the ellipse that can replace them
        has its negative; others have zero.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.features.gaussians import fit_gaussians
    >>> y, x = np.mgrid[:50, :60]
    >>> beam = np.diag([16.0, 9.0])
    >>> point = np.exp(-((y - 20.3) ** 2 / 32 + (x - 30.6) ** 2 / 18))
    >>> wide = np.exp(-((y - 30) ** 2 / 50 + (x - 40) ** 2 / 36))
    >>> found = fit_gaussians(point + 0.5 * wide, beam, 0.001)
    >>> found["y"].round(2), found["x"].round(2), found["size"].round(2)
    (array([20.3, 30. ]), array([30.6, 40. ]), array([0.  , 7.06]))
    """
    good = np.isfinite(image) & ~np.asarray(mask, dtype=bool)
    if noise > 0:
        noise = max(noise, ROUNDING * np.max(image, where=good, initial=0.0))
    value = np.where(good, image, 0.0) / noise if noise > 0 else np.zeros(1)
    if not np.any(value > THRESHOLD):
        return np.empty(0, COLUMNS)
    data = _Samples(value, good, beam)
    p, wholes = _model(data) if len(data.y) else (np.empty((0, 6)), [])
    if len(p) == 0:
        return np.empty(0, COLUMNS)
    errors, group = _position_errors(p, data), np.zeros(len(p), dtype=int)
    rows = [(p, *errors, group)]
    for number, (parts, ellipse) in enumerate(wholes, start=1):
        group[parts] = number
        model = np.vstack([ellipse, np.delete(p, parts, axis=0)])
        errors = (error[:1] for error in _position_errors(model, data))
        rows.append((ellipse, *errors, [-number]))
    p, y_err, x_err, group = map(np.concatenate, zip(*rows, strict=True))
    order = np.argsort(-p[:, _PEAK], kind="stable")
    # Their peaks are compared with the error beside them: fainter ones are needed by
    # the model, but their places mean little.
    square = np.subtract.outer(p[order, _Y], data.y) ** 2
    square += np.subtract.outer(p[order, _X], data.x) ** 2
    beside = data.weight[square.argmin(axis=1)]
    order = order[p[order, _PEAK] * beside >= THRESHOLD]
    p, y_err, x_err, group = p[order], y_err[order], x_err[order], group[order]
    peak = p[:, _PEAK] * noise
    columns = (
        p[:, _Y] + data.origin[0], p[:, _X] + data.origin[1], peak,
        peak * np.sqrt(_areas(p, beam) / np.linalg.det(beam)),
        _FWHM * np.sqrt(p[:, _VARIANCE].clip(0)), y_err, x_err, group,
    )  # fmt: skip
    return np.array([*zip(*columns, strict=True)], COLUMNS)


class _Samples:
    """
    Samples of an image near its bright parts, three to a beam.

    ``value`` and ``weight`` (inverse errors) are in units of the noise, the
    positions ``y`` and ``x`` count from ``origin``.  ``root`` is the Cholesky factor of
    the ``beam``, ``inverse_root`` its inverse, ``independent`` the number of
    independent samples for each sample, ``penalty`` the least decrease of chi^2 for a
    component, ``widest`` its largest variance.  The ``relative`` error is that of the
    largest value within half a beam, for what is neither Gaussian nor well calibrated,
    added to the noise in quadrature.
    """

    def __init__(self, value, good, beam, relative=0.001):
        bright, width = value > THRESHOLD, _FWHM * np.sqrt(np.diag(beam))
        margin = np.ceil(width).astype(int)
        cut = tuple(
            slice(max(at.min() - m, 0), at.max() + m + 1)
            for at, m in zip(np.nonzero(bright), margin, strict=True)
        )
        good, bright, value = good[cut], bright[cut], value[cut]
        peak = scipy.ndimage.maximum_filter(value, size=tuple(width.astype(int) | 1))
        near = scipy.ndimage.maximum_filter(bright, size=tuple(2 * margin + 1))
        step = np.maximum(width.astype(int) // 3, 1)
        y, x = np.nonzero((near & good)[:: step[0], :: step[1]])
        at = y * step[0], x * step[1]
        self.y, self.x = (places.astype(float) for places in at)
        self.value, self.weight = value[at], 1 / np.hypot(1.0, relative * peak[at])
        self.origin, self.beam = (cut[0].start, cut[1].start), beam
        self.root = np.linalg.cholesky(beam)
        self.inverse_root = np.linalg.inv(self.root)
        self.independent = step.prod() / (4 * np.pi * np.sqrt(np.linalg.det(beam)))
        self.penalty = 4 * np.log(max(len(y) * self.independent, 2))
        self.widest = sum(np.ptp(v) ** 2 for v in (self.y, self.x) if len(v))

    def distance(self, y, x, at):
        """Return distances from a position in full widths of the beam."""
        offset = self.inverse_root @ np.stack([y - at[0], x - at[1]])
        return np.sqrt((offset**2).sum(axis=0)) / _FWHM

    def model(self, p, where):
        """Return the sum of components at some of the samples."""
        return p[:, _PEAK] @ _shapes(p, self.y[where], self.x[where], self.beam)[0]

    def chi2(self, p, where):
        """Return the chi^2 of some of the samples."""
        left = (self.value[where] - self.model(p, where)) * self.weight[where]
        return left @ left * self.independent


def _covariances(p, beam):
    """Return the (y, y), (x, x) and (y, x) covariances of convolved components."""
    v, stretch = p[:, _VARIANCE], p[:, _STRETCH]
    along_y, along_x = beam[0, 0] + v + stretch, beam[1, 1] + v - stretch
    return along_y, along_x, beam[0, 1] + p[:, _TILT]


def _areas(p, beam):
    """Return the determinants of the covariances of the convolved components."""
    along_y, along_x, cross = _covariances(p, beam)
    return along_y * along_x - cross**2


def _is_round(p):
    """Return which components are round."""
    return (p[:, _STRETCH] == 0) & (p[:, _TILT] == 0)


def _shapes(p, y, x, beam):
    """
    Return components of unit peak, and the offsets times the inverse covariance.

    All have the shape (n, number of positions).
    """
    parts = _covariances(p, beam)
    area = parts[0] * parts[1] - parts[2] ** 2
    along_y, along_x, cross = ((part / area)[:, None] for part in parts)
    dy, dx = y - p[:, _Y, None], x - p[:, _X, None]
    gy = along_x * dy
    gy -= cross * dx
    gx = along_y * dx
    gx -= cross * dy
    # These arrays are small, and new ones take longer than the numbers.
    dy *= gy
    dx *= gx
    dy += dx
    dy *= -0.5
    return np.exp(dy, out=dy), gy, gx


def _derivatives(p, shape, gy, gx, n=6):
    """Return derivatives of components by the first n parameters, (n_c, n, n_pos)."""
    value = p[:, _PEAK, None] * shape
    found = np.empty((len(p), n, shape.shape[1]))
    found[:, _PEAK] = shape
    np.multiply(value, gy, out=found[:, _Y])
    np.multiply(value, gx, out=found[:, _X])
    along_y, along_x = 0.5 * gy * gy, 0.5 * gx * gx
    np.multiply(value, along_y + along_x, out=found[:, _VARIANCE])
    if n > _STRETCH:
        np.multiply(value, along_y - along_x, out=found[:, _STRETCH])
        np.multiply(value, gy * gx, out=found[:, _TILT])
    return found


def _least_squares(p, data, where, fixed, iterations=12, tolerance=1e-4, enough=np.inf):
    """
    Fit components by the method of Levenberg and Marquardt.

    ``fixed`` is the sum of other components at the samples.  The normal equations
    are solved, which takes less time than the decomposition of the whole Jacobian
    by `scipy.optimize.least_squares`.  Fits are given up whose chi^2 stays above
    ``enough``, even if it falls by a hundred times what the next step promises.
    Returns the components and their chi^2.
    """
    y, x, weight = data.y[where], data.x[where], data.weight[where]
    value = (data.value[where] - fixed) * weight
    is_round = _is_round(p)
    n, free, variance, largest_step = _free(is_round, data.beam)

    def state(p):
        shape, gy, gx = _shapes(p, y, x, data.beam)
        shape *= weight
        left = value - p[:, _PEAK] @ shape
        return (shape, gy, gx), left, left @ left

    parts, left, cost = state(p)
    damping = 1e-3
    for _ in range(iterations):
        jacobian = _derivatives(p, *parts, n).reshape(len(p) * n, -1)
        if len(free) < len(jacobian):
            jacobian = jacobian[free]
        zero = variance[p[is_round, _VARIANCE] <= 0]
        normal, gradient, scale = _normal_equations(jacobian, left, zero)
        for _ in range(6):
            damped = normal.copy()
            damped.flat[:: len(free) + 1] += damping
            step = scipy.linalg.lapack.dgesv(damped, gradient)[2]
            promised, step = gradient @ step, step / scale
            new = p.copy()
            step = np.minimum(np.maximum(step, -largest_step), largest_step)
            new[:, :n].flat[free] += step
            new = _allowed(new, is_round, data)
            after = state(new)
            if after[2] < cost:
                break
            damping *= 5
        else:
            break
        done = cost - after[2] < tolerance * cost
        p, (parts, left, cost) = new, after
        damping = max(damping / 5, 1e-7)
        if done or (cost - HOPELESS * promised) * data.independent > enough:
            break
    return p, cost * data.independent


def _normal_equations(jacobian, left, zero):
    """
    Return the matrix and the gradient in units of a scale, and the scale.

    Parameters that are ``zero`` do not become negative.
    """
    normal, gradient = jacobian @ jacobian.T, jacobian @ left
    scale = np.sqrt(normal.diagonal())
    # A component without samples stays as it is.
    scale[scale <= 1e-9 * scale.max()] = 1.0
    scale[zero[gradient[zero] <= 0]] = np.inf
    normal /= scale
    normal /= scale[:, None]
    return normal, gradient / scale, scale


def _free(is_round, beam):
    """
    Return which parameters are free.

    These are the number of parameters of a component, the places of the free ones in a
    row of all, which of these are variances of round ones, and their largest steps.
    """
    n = _STRETCH if is_round.all() else 6
    free = np.ones((len(is_round), n), dtype=bool)
    free[is_round, _STRETCH:] = False
    largest_step = np.full(free.shape, np.inf)
    largest_step[:, [_Y, _X]] = np.sqrt(np.diag(beam))
    largest_step, free = largest_step[free], np.flatnonzero(free)
    variance = np.flatnonzero((free % n == _VARIANCE) & is_round[free // n])
    return n, free, variance, largest_step


def _allowed(p, is_round, data):
    """Return components with positive peaks, and with variances that are possible."""
    beam, widest, root = data.beam, data.widest, data.root
    p[:, _PEAK] = np.maximum(p[:, _PEAK], 0)
    p[is_round, _VARIANCE] = p[is_round, _VARIANCE].clip(0, widest)
    if not is_round.all():
        along_y, along_x, cross = _covariances(p[~is_round], beam)
        covariance = np.stack([along_y, cross, cross, along_x], axis=-1)
        inverse = data.inverse_root
        ratio = inverse @ covariance.reshape(-1, 2, 2) @ inverse.T
        limits = NARROWEST**2, 1 + widest / beam.trace()
        middle = (ratio[:, 0, 0] + ratio[:, 1, 1]) / 2
        half = np.hypot((ratio[:, 0, 0] - ratio[:, 1, 1]) / 2, ratio[:, 0, 1])
        if (middle - half).min() >= limits[0] and (middle + half).max() <= limits[1]:
            return p
        ratio, axes = np.linalg.eigh(ratio)
        axes = root @ axes * np.sqrt(ratio.clip(*limits))[:, None]
        extra = axes @ axes.swapaxes(1, 2) - beam
        p[~is_round, _VARIANCE] = (extra[:, 0, 0] + extra[:, 1, 1]) / 2
        p[~is_round, _STRETCH] = (extra[:, 0, 0] - extra[:, 1, 1]) / 2
        p[~is_round, _TILT] = extra[:, 0, 1]
    return p


def _refitted(new, p, data, at, least):
    """
    Fit new components around a position.

    Returns all of them, and by how much chi^2 is lower than with the components ``p``.
    If that is less than ``least``, the fit need not be complete.
    """
    near = data.distance(new[:, _Y], new[:, _X], at) < 3
    width = _FWHM * np.sqrt(np.diag(data.beam))
    where = np.abs(data.y - at[0]) < 4 * width[0]
    where &= np.abs(data.x - at[1]) < 4 * width[1]
    before = data.chi2(p, where)
    if not near.any():
        return new, before - data.chi2(new, where)
    fixed, new = data.model(new[~near], where), new.copy()
    enough = before - least
    new[near], after = _least_squares(new[near], data, where, fixed, enough=enough)
    return new, before - after


def _grown(p, data, most=20):
    """Return at most so many components, added at the largest residual in turn."""
    tried, residual = 0, (data.value - data.model(p, EVERYWHERE)) * data.weight
    while len(p) < most and tried < 3:
        k = np.argmax(residual)
        if residual[k] < THRESHOLD:
            break
        at = data.y[k], data.x[k]
        first = residual[k] / data.weight[k], *at, data.beam.trace() / 32, 0, 0
        new, gain = _refitted(np.vstack([p, first]), p, data, at, data.penalty)
        if gain > data.penalty:
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
        new, at = np.delete(p, k, axis=0), p[k, [_Y, _X]]
        new, gain = _refitted(new, p, data, at, -data.penalty)
        if gain > -data.penalty:
            p = new
    return p


def _model(data, rounds=3, good=1.5):
    """
    Return components, and ellipses that can replace some of them, see `_joined`.

    Components are added again after some have been joined, in at most so many rounds;
    a model with ellipses must fit the image with a good mean chi^2.
    """
    p = plain = _fitted(np.empty((0, 6)), data)
    for _ in range(rounds):
        before = len(p)
        p, wholes = _joined(p, data, BETTER * data.penalty)
        if len(p) == before:
            break
        p = _fitted(p, data)
    else:
        p, wholes = _joined(p, data, np.inf)
    left = (data.value - data.model(p, EVERYWHERE)) * data.weight
    # Where no model is good, ellipses that seem better may cover several sources.
    if not _is_round(p).all() and np.mean(left**2) > good:
        return _joined(plain, data, np.inf)
    return p, wholes


def _fitted(p, data):
    """Return components with those that are missing, and without needless ones."""
    p = _grown(p, data)
    if len(p):
        p, _ = _least_squares(p, data, EVERYWHERE, 0.0)
    return _pruned(p, data)


def _joined(p, data, least):
    """
    Return components of which one ellipse replaces neighbours where it is better.

    Then it lowers chi^2 by ``least``.  Where it is only as good, it is returned beside
    them: the numbers of the components, and the ellipse.
    """
    wholes, seen = [], np.zeros(len(p), dtype=bool)
    for one in p[np.argsort(-p[:, _PEAK], kind="stable")]:
        k = np.argmin(np.abs(p - one).sum(axis=1))
        at = p[k, [_Y, _X]]
        away = np.where(seen, np.inf, data.distance(p[:, _Y], p[:, _X], at))
        near = np.argsort(away, kind="stable")
        whole = None
        for n in range(2, 1 + min(MOST_JOINED, np.sum(away < JOINED))):
            parts, others = np.sort(near[:n]), np.delete(p, near[:n], axis=0)
            if not p[parts, _PEAK].any():
                # Without flux they have no moments.
                continue
            new = np.vstack([others, _moments(p[parts], data.beam)])
            # Each of the components has four parameters, the ellipse six.
            as_good = -(n - 1.5) * data.penalty
            new, gain = _refitted(new, p, data, at, as_good)
            if gain > least:
                moved = np.cumsum(np.isin(np.arange(len(p)), parts))
                wholes = [(k - moved[k], ellipse) for k, ellipse in wholes]
                seen = np.append(np.delete(seen, parts), False)
                p = new
                break
            if gain > as_good:
                whole = parts, new[-1:]
        else:
            if whole:
                wholes.append(whole)
                seen[whole[0]] = True
    return p, wholes


def _moments(p, beam):
    """Return the ellipse with the flux and the moments of some components."""
    flux = p[:, _PEAK] * np.sqrt(_areas(p, beam))
    share = flux / flux.sum()
    dy, dx = (p[:, [_Y, _X]] - share @ p[:, [_Y, _X]]).T
    cross = share @ (p[:, _TILT] + dy * dx)
    along_y = share @ (p[:, _VARIANCE] + p[:, _STRETCH] + dy**2)
    along_x = share @ (p[:, _VARIANCE] - p[:, _STRETCH] + dx**2)
    found = np.array([0, *(share @ p[:, [_Y, _X]]), (along_y + along_x) / 2,
                      (along_y - along_x) / 2, cross])  # fmt: skip
    found[_PEAK] = flux.sum() / np.sqrt(_areas(found[None], beam)[0])
    return found


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
    (yy, xx, yx), (wide_yy, wide_xx, wide_yx) = (
        _covariances(p, b) / _areas(p, b) for b in (beam, 2 * beam)
    )
    changes = (
        (_VARIANCE, (yy + xx - wide_yy - wide_xx) / 2),
        (_STRETCH, (xx - yy - wide_xx + wide_yy) / 2),
        (_TILT, wide_yx - yx),
    )
    for column, change in changes:
        smooth[:, column] += (change * p[:, _PEAK])[:, None] * smooth[:, _PEAK]
    smooth *= np.sqrt(area / wide)[:, None, None]
    free = np.ones(p.shape, dtype=bool)
    free[_is_round(p), _STRETCH:] = False
    plain, smooth = plain[free], smooth[free]
    inverse = np.linalg.pinv(plain @ plain.T)
    spread = inverse @ smooth
    variance = np.full(p.shape, np.nan)
    variance[free] = (spread**2).sum(axis=1) / data.independent
    return np.sqrt(variance[:, _Y]), np.sqrt(variance[:, _X])
