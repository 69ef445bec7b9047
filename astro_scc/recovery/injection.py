# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Inject moving features into epochs, and find the component that they cause."""

from __future__ import annotations

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from numpy.typing import ArrayLike

from astro_scc.components.restoring import add_gaussians
from astro_scc.epochs import EpochCube
from astro_scc.images.beam import FWHM_TO_SIGMA
from astro_scc.kinematics import RadialFrame
from astro_scc.units import PM_UNIT

#: An SSP belongs to an injected feature within this distance, in beams.
NEAR = 0.5
NO_BEAMS = "the cube has no beams: give fwhm, the full width of features, as an angle"


@dataclass(frozen=True, eq=False, repr=False)
class FeaturePaths:
    """Positions of features at each epoch of a cube, see `draw_paths`."""

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
    cube: EpochCube, area: ArrayLike, *, speed: u.Quantity,
    position_angle: u.Quantity | str, n_features: float = 10,
    scatter: u.Quantity | None = None, rng: np.random.Generator | int | None = None,
) -> FeaturePaths:  # fmt: skip
    """
    Draw features that flow through an area at one speed.

    All lines that meet the area are equally likely, so features populate it
    evenly at all times: a line is drawn through a point of the area at one of
    the epochs and kept with probability 1/m, where m is the number of epochs at
    which it meets the area.  Lines are added until the mean number of features
    in the area reaches ``n_features``.

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
        Standard deviation of positions around the lines, an angle; it is drawn
        on each axis and at each epoch independently.
    rng : `numpy.random.Generator`, seed or None, optional

    Returns
    -------
    ``FeaturePaths``
        ``x`` and ``y``, shape (n_features, n_epochs), in pixels counted from 0,
        NaN at epochs before a feature has left the origin of a radial flow; and
        ``inside``, whether the feature, without scatter, is in the area.

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
        direction, distance = _motion(start, origin, to_sky, position_angle)
        travelled = speed * (years - years[epoch])
        line = start[:, None] + (to_pixels @ direction)[:, None] * travelled
        line[:, distance + travelled < 0] = np.nan
        inside = _is_inside(line, area)
        if keep * max(inside.sum(), 1) < 1:
            lines.append(line)
            insides.append(inside)
            number += inside.mean()
    lines = np.array(lines)
    if scatter is not None:
        sigma = u.Quantity(scatter).to_value(u.mas)
        shift = rng.normal(0, sigma, (len(lines), len(years), 2))
        lines = lines + np.einsum("ij,nej->nie", to_pixels, shift)
    return FeaturePaths(lines[:, 0], lines[:, 1], np.array(insides))


def _motion(start, origin, to_sky, position_angle):
    """Return the direction of motion (east, north) and the distance from its origin."""
    if isinstance(position_angle, str):
        offset = to_sky @ (start - origin)
        # Avoid a division by zero at the origin.
        distance = max(np.hypot(*offset), 1e-12)
        return offset / distance, distance
    angle = u.Quantity(position_angle).to_value(u.rad)
    return np.array([np.sin(angle), np.cos(angle)]), np.inf


def _is_inside(line, area):
    """Return at which epochs a line is in the area."""
    ny, nx = area.shape
    known = np.isfinite(line).all(axis=0)
    x, y = np.rint(np.where(known, line, -1)).astype(int)
    known &= (x >= 0) & (x < nx) & (y >= 0) & (y < ny)
    return known & area[np.clip(y, 0, ny - 1), np.clip(x, 0, nx - 1)]


def inject(
    cube: EpochCube, paths: FeaturePaths, peak: u.Quantity, *,
    fwhm: u.Quantity | None = None,
) -> EpochCube:  # fmt: skip
    """
    Add features with the shape of each epoch's beam to a cube.

    Everything but the images stays the same.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    paths : ``FeaturePaths``
        See `draw_paths`.
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
    >>> from astro_scc.recovery import draw_paths, inject
    >>> dates = ["2000-01-01", "2001-01-01"]
    >>> cube = EpochCube.from_arrays(np.zeros((2, 16, 32)), dates,
    ...                              pixel_scale=0.1 * u.mas)
    >>> paths = draw_paths(cube, np.eye(16, 32) > 0, speed=1 * u.mas / u.yr,
    ...                    position_angle=270 * u.deg, n_features=1, rng=1)
    >>> fuller = inject(cube, paths, 2.0, fwhm=0.5 * u.mas)
    >>> bool(fuller.data.max() > 1)
    True
    """
    to_pixels = np.linalg.inv(cube.pixel_matrix.value)
    if fwhm is not None:
        sigma = FWHM_TO_SIGMA * u.Quantity(fwhm).to_value(u.mas)
        covariances = [sigma**2 * np.eye(2)] * len(cube)
    elif cube.beams is not None:
        covariances = [beam.covariance.to_value(u.mas**2) for beam in cube.beams]
    else:
        raise ValueError(NO_BEAMS)
    value = u.Quantity(peak, cube.unit).to_value(cube.unit)
    data = cube.data.copy()
    for epoch, covariance in enumerate(covariances):
        x, y = paths.x[:, epoch], paths.y[:, epoch]
        there = np.isfinite(x)
        x, y = x[there], y[there]
        shape = np.broadcast_to(to_pixels @ covariance @ to_pixels.T, (len(x), 2, 2))
        add_gaussians(data[epoch], x, y, np.full(len(x), value), shape)
    return cube.with_step(f"{len(paths)} simulated features added", data=data)


def area_for_features(matched, region=None):
    """
    Return the pixels in which features are injected, shape (ny, nx).

    They are the pixels of the region that are valid in any epoch.  Without a region,
    they are the pixels of SSPs of any epoch and scale, or all if there are none.
    """
    exists = ~matched.cube.mask.all(axis=0)
    if region is None:
        area = np.zeros(exists.shape, dtype=bool)
        area.flat[matched.ssps.pixels] = True
        return area if area.any() else exists
    area = region & exists
    if not area.any():
        raise ValueError("region holds masked pixels only: no feature can be injected")
    return area


def velocity_along(frame, position_angle):
    """Return the unit vector of a direction of motion on the axes of a frame."""
    if isinstance(frame, RadialFrame):
        return np.array([1.0, 0.0])
    angle = position_angle.to_value(u.rad)
    return frame.matrix(0.0, 0.0) @ [np.sin(angle), np.cos(angle)]


def moving_components(result, level):
    """Return the numbers, from 1, of moving components with ``p_global <= level``."""
    table = result.components
    moving = (table["kind"] == "moving") & (table["p_global"] <= level)
    return [int(number) for number in table["component"][moving]]


def recovered(result, own, velocity, *, tolerance, level, paths, fwhm):
    """
    Return the number of the component that is due to injected features, or None.

    The component is moving with ``p_global <= level``, and within the ``tolerance``
    (mas/yr) of the features' ``velocity`` on the axes of the result's frame.  It is not
    a component that the epochs have without features: each velocity in ``own``, shape
    (n, 2), claims the component nearest to it within the tolerance.  And more than
    half of its SSPs are within half a beam (``fwhm`` in mas) of an injected feature.
    """
    left = {
        number: result.velocities[number - 1].value
        for number in moving_components(result, level)
    }
    for v in np.reshape(own, (-1, 2)):
        left.pop(_nearest(left, v, tolerance), None)
    while (nearest := _nearest(left, np.asarray(velocity), tolerance)) is not None:
        if _share_of_features(result, nearest, paths, fwhm) > 0.5:
            return nearest
        del left[nearest]
    return None


def _nearest(velocities, velocity, tolerance):
    """Return the key of the nearest velocity within a tolerance, or None."""
    distance = {k: np.hypot(*(v - velocity)) for k, v in velocities.items()}
    near = [k for k, d in distance.items() if d <= tolerance]
    return min(near, key=distance.get, default=None)


def _share_of_features(result, number, paths, fwhm):
    """Return the share of a component's SSPs that lie on injected features."""
    ssps = result.matched.ssps
    member = np.unique(result.members(number)["ssp"])
    if len(member) == 0:
        return 0.0
    epoch = ssps.epoch[member]
    pixels = paths.x[:, epoch] - ssps.x[member], paths.y[:, epoch] - ssps.y[member]
    offset = np.einsum("ij,jnm->inm", result.cube.pixel_matrix.value, np.stack(pixels))
    # Positions of features that do not exist yet are NaN and compare as far away.
    return float((np.hypot(*offset) <= NEAR * fwhm).any(axis=0).mean())
