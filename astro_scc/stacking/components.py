# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocity components: the maxima of a stack."""

from dataclasses import dataclass, field

import numpy as np

from astro_scc.correlation.zncc import find_peaks

__all__ = ["Component", "component_near", "find_components", "fit_gaussian"]

#: Share of a maximum that a grid point must reach to take part in its fit.
LEVEL = 0.5


@dataclass(frozen=True)
class Component:
    """
    A maximum of a stack.

    Attributes
    ----------
    v1, v2 : float
        Velocity along the two axes of the grid, from the Gaussian fit.
    coefficient : float
        Stacked correlation coefficient at the maximum.
    width1, width2 : float
        Standard deviations of the fitted Gaussian along the axes.
    row, column : int
        Grid point of the maximum.
    fitted : bool
        False where no Gaussian with a maximum in the box fits, and the
        velocity is that of the local quadratic.
    points : tuple of `~numpy.ndarray`
        Columns and rows of the grid that the fit's box has, and which of
        its points took part.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import VelocityGrid, stack
    >>> from astro_scc.stacking import find_components
    >>> rng = np.random.default_rng(1)
    >>> years, n, one = np.array([0.0, 1.0, 2.0]), 40, np.ones(40)
    >>> first = np.repeat([0, 1], 20)
    >>> d = Displacements(
    ...     d1=3 + rng.normal(0, 0.2, n), d2=rng.normal(0, 0.2, n), s1=0.3 * one,
    ...     s2=0.3 * one, weight=0.8 * one, reference=first, target=first + 1,
    ...     ssp=np.arange(n), target_ssp=np.full(n, -1), n_ssps=np.full(3, 20))
    >>> pairs = consecutive_pairs(years)
    >>> grid = VelocityGrid.covering(6.0, 0.2)
    >>> scc = stack(d, pairs, grid)
    >>> best = find_components(scc, grid, (1.5, 1.5))[0]
    >>> best.fitted, round(best.v1, 1)
    (True, 3.0)
    """

    v1: float
    v2: float
    coefficient: float
    width1: float
    width2: float
    row: int
    column: int
    fitted: bool
    points: tuple = field(default=(), repr=False, compare=False)


def fit_gaussian(values, x, y):
    """
    Fit a two-dimensional Gaussian by linear least squares of its logarithm.

    ``ln f = a + b x + c y + d x^2 + e x y + f y^2`` with weights f^2, which
    make the residuals those of f itself to first order (Guo 2011, IEEE
    Signal Process. Mag. 28, 134).

    Parameters
    ----------
    values : array_like, shape (ny, nx)
        Only positive ones take part.
    x, y : array_like, shapes (nx,) and (ny,)

    Returns
    -------
    tuple of float or None
        ``x0, y0, height, sigma_x, sigma_y``, sigma those of the marginal
        profiles; None if the surface has no maximum.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import fit_gaussian
    >>> x = y = np.linspace(-2, 2, 9)
    >>> f = 3 * np.exp(-0.5 * ((x - 0.3) ** 2 + (y[:, None] / 2) ** 2))
    >>> np.round(fit_gaussian(f, x, y), 3)
    array([0.3, 0. , 3. , 1. , 2. ])
    """
    values = np.asarray(values, dtype=float)
    gx, gy = np.meshgrid(x, y)
    good = values > 1e-6 * values.max(initial=0.0)
    if good.sum() < 6:
        return None
    f, gx, gy = values[good] / values.max(), gx[good], gy[good]
    # Centred and scaled, or the normal equations lose digits.
    x0, y0 = gx.mean(), gy.mean()
    scale = max(np.ptp(gx), np.ptp(gy))
    px, py = (gx - x0) / scale, (gy - y0) / scale
    design = np.stack([np.ones_like(px), px, py, px * px, px * py, py * py], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(design * f[:, None], f * np.log(f))
    if rank < 6:
        return None
    a, b, c, d, e, g = solution
    curvature = -np.array([[2 * d, e], [e, 2 * g]])
    if not (curvature[0, 0] > 0 and np.linalg.det(curvature) > 0):
        return None
    covariance = np.linalg.inv(curvature)
    centre = covariance @ np.array([b, c])
    height = np.exp(a + 0.5 * np.array([b, c]) @ centre) * values.max()
    sigma = scale * np.sqrt(np.diag(covariance))
    return (
        float(x0 + scale * centre[0]),
        float(y0 + scale * centre[1]),
        float(height),
        float(sigma[0]),
        float(sigma[1]),
    )


def find_components(scc, grid, box, *, threshold=0.0):
    """
    Find the maxima of a stack and fit a Gaussian to a box around each.

    Within the box only those grid points take part that reach half of the
    maximum and are nearer to it than to another one: neighbours in the box
    would pull the fit to themselves, and the level beneath the maximum,
    where the stack is of unrelated matches, would widen it.

    Parameters
    ----------
    scc : `~numpy.ndarray`, shape ``grid.shape``
    grid : `VelocityGrid`
    box : tuple of float
        Sides of the box along the two axes, the beam over the interval in
        the paper.
    threshold : float, optional
        Smallest coefficient of a maximum.

    Returns
    -------
    list of `Component`
        By falling coefficient.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import VelocityGrid, find_components
    >>> grid = VelocityGrid.covering(4.0, 0.25)
    >>> scc = np.exp(-((grid.v1 - 1.1) ** 2 + grid.v2[:, None] ** 2) / 2)
    >>> [round(c.v1, 3) for c in find_components(scc, grid, (2.0, 2.0))]
    [1.1]
    """
    smallest = max(threshold, np.finfo(float).tiny)
    _, y, x, _ = find_peaks(scc[None], smallest)
    points = [_grid_point(scc, *place) for place in zip(y, x, strict=True)]
    half1, half2 = box[0] / 2, box[1] / 2
    step1, step2 = grid.step
    found = []
    for (row, column), py, px in zip(points, y, x, strict=True):
        part, used = _fitted_points(scc, grid, box, (row, column), points)
        near2, near1 = (np.ravel(index) for index in part)
        fit = fit_gaussian(
            np.where(used, scc[part], 0.0), grid.v1[near1], grid.v2[near2]
        )
        v1 = grid.v1[0] + px * step1
        v2 = grid.v2[0] + py * step2
        width1 = width2 = np.nan
        inside = fit is not None and bool(
            abs(fit[0] - v1) <= max(half1, step1)
            and abs(fit[1] - v2) <= max(half2, step2)
        )
        if inside:
            v1, v2, _, width1, width2 = fit
        found.append(
            Component(
                v1=float(v1),
                v2=float(v2),
                coefficient=float(scc[row, column]),
                width1=width1,
                width2=width2,
                row=row,
                column=column,
                fitted=inside,
                points=(near1, near2, used),
            )
        )
    return sorted(found, key=lambda c: -c.coefficient)


def _fitted_points(scc, grid, box, point, points):
    """Grid points of the box, and which of them take part in the fit."""
    row, column = point
    step1, step2 = grid.step
    near1 = np.abs(grid.v1 - grid.v1[column]) <= max(box[0] / 2, 1.5 * step1)
    near2 = np.abs(grid.v2 - grid.v2[row]) <= max(box[1] / 2, 1.5 * step2)
    part = np.ix_(near2, near1)
    high = scc[part] >= LEVEL * scc[row, column]
    return part, high & _nearest(part, point, points)


def component_near(scc, grid, box, v1, v2):
    """
    The maximum of a stack nearest to a velocity.

    Parameters
    ----------
    scc : `~numpy.ndarray`, shape ``grid.shape``
    grid : `VelocityGrid`
    box : tuple of float
        As for `find_components`; the maximum lies within half of it.
    v1, v2 : float

    Returns
    -------
    `Component`
        At the velocity itself, and not ``fitted``, if no maximum is near.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import VelocityGrid, component_near
    >>> grid = VelocityGrid.covering(4.0, 0.25)
    >>> scc = np.exp(-((grid.v1 - 1.1) ** 2 + grid.v2[:, None] ** 2) / 2)
    >>> round(component_near(scc, grid, (2.0, 2.0), 1.5, 0.0).v1, 3)
    1.1
    """

    def distance(c):
        return np.hypot((c.v1 - v1) / box[0], (c.v2 - v2) / box[1])

    nearest = min(find_components(scc, grid, box), key=distance, default=None)
    if nearest is not None and distance(nearest) <= 0.5:
        return nearest
    row = int(np.abs(grid.v2 - v2).argmin())
    column = int(np.abs(grid.v1 - v1).argmin())
    return Component(
        v1=float(v1),
        v2=float(v2),
        coefficient=float(scc[row, column]),
        width1=np.nan,
        width2=np.nan,
        row=row,
        column=column,
        fitted=False,
    )


def _grid_point(scc, y, x):
    """The maximum's grid point; half a step aside, rounding may miss it."""
    rows = {int(np.floor(y)), int(np.ceil(y))}
    columns = {int(np.floor(x)), int(np.ceil(x))}
    return max(((r, c) for r in rows for c in columns), key=lambda p: scc[p])


def _nearest(part, point, points):
    """Whether grid points are nearer to one maximum than to any other."""
    rows, columns = part

    def squares(p):
        return (rows - p[0]) ** 2 + (columns - p[1]) ** 2

    own = squares(point)
    return np.all([own <= squares(p) for p in points], axis=0)
