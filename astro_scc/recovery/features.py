# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features of the shape of the beam that move through the epochs of a cube."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np

from astro_scc.epochs.beam import FWHM_TO_SIGMA
from astro_scc.epochs.restoring import add_gaussians
from astro_scc.recovery.checks import PM_UNIT

__all__ = ["FeaturePaths", "draw_paths", "inject"]


@dataclass(frozen=True, eq=False, repr=False)
class FeaturePaths:
    """
    Where features are at each epoch of a cube.

    Attributes
    ----------
    x, y : `~numpy.ndarray`, shape (n_features, n_epochs)
        Pixels, counted from 0; NaN at epochs before a feature has left the
        origin of a radial flow.
    inside : `~numpy.ndarray` of bool, shape (n_features, n_epochs)
        Whether the feature, without its scatter, is in the area.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.recovery import FeaturePaths
    >>> paths = FeaturePaths(x=np.array([[10.0, 15.0]]), y=np.array([[32.0, 32.0]]),
    ...                      inside=np.array([[True, False]]))
    >>> int(paths.inside.sum())
    1
    """

    x: np.ndarray
    y: np.ndarray
    inside: np.ndarray

    def __len__(self):
        return len(self.x)

    def __repr__(self):
        return (
            f"<FeaturePaths: {len(self)} features, "
            f"{self.inside.sum(axis=0).mean():.1f} in the area at a time>"
        )


def draw_paths(
    cube, area, *, speed, position_angle, n_features=10, scatter=None, rng=None
):
    """
    Draw features that flow through an area at one speed.

    All lines that meet the area are equally likely, so that it is populated
    evenly and at all times: a line is drawn through a point of the area at
    one of the epochs and kept with probability 1/m, m the number of epochs
    at which it meets the area.  Lines are added until the mean number of
    features in the area reaches ``n_features``.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    area : array_like of bool, shape (ny, nx)
    speed : `~astropy.units.Quantity`
        An angle per time.
    position_angle : `~astropy.units.Quantity` or "radial"
        Direction of motion, north through east, or away from the reference
        pixel.
    n_features : float, optional
        Mean number in the area at a time.
    scatter : `~astropy.units.Quantity`, optional
        Standard deviation of positions about the lines, an angle, on each
        axis and at each epoch on its own.
    rng : `numpy.random.Generator`, seed or None, optional

    Returns
    -------
    `FeaturePaths`

    Raises
    ------
    ValueError
        If the area holds no pixel.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc import EpochCube
    >>> from astro_scc.recovery import draw_paths
    >>> cube = EpochCube.from_arrays(np.zeros((3, 32, 64)), ["2000-01-01", "2001-01-01",
    ...                              "2003-01-01"], pixel_scale=0.1 * u.mas)
    >>> area = np.zeros((32, 64), dtype=bool)
    >>> area[10:20, 10:50] = True
    >>> paths = draw_paths(cube, area, speed=1 * u.mas / u.yr,
    ...                    position_angle=270 * u.deg, n_features=4, rng=1)
    >>> np.diff(paths.x)[0].round(1)  # west is to the right
    array([10., 20.])
    """
    rng = np.random.default_rng(rng)
    rows, columns = np.nonzero(area)
    if len(rows) == 0:
        raise ValueError("the area for features holds no pixel")
    years = cube.years.to_value(u.yr)
    speed = u.Quantity(speed).to_value(PM_UNIT)
    to_sky = cube.pixel_matrix.value
    to_pixels = np.linalg.inv(to_sky)
    origin = np.array(cube.reference_pixel)
    lines, insides, number = [], [], 0.0
    while number < n_features * (1 - 1e-9):
        epoch, pixel = rng.integers(len(years)), rng.integers(len(rows))
        start = [columns[pixel], rows[pixel]] + rng.uniform(-0.5, 0.5, 2)
        keep = rng.random()
        direction, distance = _direction(start, origin, to_sky, position_angle)
        travelled = speed * (years - years[epoch])
        line = start[:, None] + (to_pixels @ direction)[:, None] * travelled
        line[:, distance + travelled < 0] = np.nan
        inside = _is_inside(line, area)
        if keep * max(inside.sum(), 1) >= 1:
            continue
        lines.append(line)
        insides.append(inside)
        number += inside.mean()
    lines = np.array(lines)
    if scatter is not None:
        sigma = u.Quantity(scatter).to_value(u.mas)
        shift = rng.normal(0, sigma, (len(lines), len(years), 2))
        lines = lines + np.einsum("ij,nej->nie", to_pixels, shift)
    return FeaturePaths(lines[:, 0], lines[:, 1], np.array(insides))


def _direction(start, origin, to_sky, position_angle):
    """Unit vector (east, north) of motion, and the distance from its origin."""
    if isinstance(position_angle, str):
        offset = to_sky @ (start - origin)
        # Rounding must not lose the pixel of the origin itself.
        distance = max(np.hypot(*offset), 1e-12)
        return offset / distance, distance
    angle = u.Quantity(position_angle).to_value(u.rad)
    return np.array([np.sin(angle), np.cos(angle)]), np.inf


def _is_inside(line, area):
    ny, nx = area.shape
    known = np.isfinite(line).all(axis=0)
    x, y = np.rint(np.where(known, line, -1)).astype(int)
    known &= (x >= 0) & (x < nx) & (y >= 0) & (y < ny)
    return known & area[np.clip(y, 0, ny - 1), np.clip(x, 0, nx - 1)]


def inject(cube, paths, peak, *, fwhm=None):
    """
    Add features of the shape of each epoch's beam to a cube.

    Dates, masks, beams and all else stay as they are.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    paths : `FeaturePaths`
    peak : `~astropy.units.Quantity`
        Peak of a feature in the unit of the cube.
    fwhm : `~astropy.units.Quantity`, optional
        Full width of round features, instead of the beams.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`

    Raises
    ------
    ValueError
        If the cube has no beams and ``fwhm`` is not given.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc import EpochCube
    >>> from astro_scc.recovery import FeaturePaths, inject
    >>> dates = ["2000-01-01", "2001-01-01"]
    >>> cube = EpochCube.from_arrays(np.zeros((2, 16, 32)), dates,
    ...                              pixel_scale=0.1 * u.mas)
    >>> x = np.array([[10.0, 20.0]])
    >>> paths = FeaturePaths(x, 0 * x + 8, x > 0)
    >>> fuller = inject(cube, paths, 2.0, fwhm=0.5 * u.mas)
    >>> [int(image.argmax()) % 32 for image in fuller.data]
    [10, 20]
    """
    to_pixels = np.linalg.inv(cube.pixel_matrix.value)
    if fwhm is not None:
        sigma = FWHM_TO_SIGMA * u.Quantity(fwhm).to_value(u.mas)
        covariances = [sigma**2 * np.eye(2)] * len(cube)
    elif cube.beams is not None:
        covariances = [beam.covariance.to_value(u.mas**2) for beam in cube.beams]
    else:
        raise ValueError(
            "the cube has no beams: give fwhm, the full width of features, as an angle"
        )
    value = u.Quantity(peak, cube.unit).to_value(cube.unit)
    data = cube.data.copy()
    for epoch, covariance in enumerate(covariances):
        there = np.isfinite(paths.x[:, epoch])
        n = int(there.sum())
        add_gaussians(
            data[epoch],
            paths.x[there, epoch],
            paths.y[there, epoch],
            np.full(n, value),
            np.broadcast_to(to_pixels @ covariance @ to_pixels.T, (n, 2, 2)),
        )
    return cube.with_step(f"{len(paths)} simulated features added", data=data)
