# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The ridge line and the position angle of a jet, from its mean image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from astro_scc.kinematics.frames import PositionAngleFrame, RadialFrame
from astro_scc.kinematics.ridge_line import RidgeLine, lengths_of
from astro_scc.quantities import named, one_quantity

if TYPE_CHECKING:
    from astro_scc.epochs import EpochCube

#: Step of the search, in beams.
STEP = 0.25
#: A line turns back if it comes within a beam of its points this many beams earlier.
APART = 3.0
#: Number of points of a slice across the jet.
SLICE = 61


def fit_position_angle(
    cube: EpochCube, *, origin: u.Quantity | None = None, threshold: float = 5.0
) -> tuple[u.Quantity, u.Quantity]:
    r"""
    Return the position angle of a jet, from the mean of its images.

    It is the direction of the mean offset, weighted by brightness, of the
    pixels above a threshold that lie more than a beam from the core,

    .. math:: \tan p = \sum I\, \Delta_\mathrm{east} / \sum I\,
              \Delta_\mathrm{north}.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    origin : `~astropy.units.Quantity`, shape (2,), optional
        (east, north) of the core, by default the reference pixel.
    threshold : float, optional
        Faintest pixel, in standard deviations of the mean image's noise.

    Returns
    -------
    angle, error : `~astropy.units.Quantity`
        North through east, 0 to 360 deg; the error is from a jackknife over the
        epochs, and infinite for one epoch.

    Raises
    ------
    ValueError
        If no pixel is bright enough.

    Examples
    --------
    >>> from astro_scc.kinematics import fit_position_angle
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> angle, error = fit_position_angle(simulate_two_fluid(rng=1).cube)
    >>> bool(abs(angle.value - 270) < 3)
    True
    """
    image, noise = _mean(cube)
    start = _origin(origin)
    east, north = (offset.value for offset in cube.offsets())
    x, y = east - start[0], north - start[1]
    width = mean_width(cube)
    use = (image > threshold * noise) & (np.hypot(x, y) > width)
    if not use.any():
        raise ValueError(
            f"no pixel of the mean image is above {threshold:g} times its noise, a "
            "beam or more from the core: give a position angle"
        )
    x, y = x[use], y[use]
    each = np.where(cube.mask, 0.0, cube.data)[:, use]
    sums = np.stack([each @ x, each @ y], axis=-1)
    total = sums.sum(axis=0)
    angle = np.arctan2(*total)
    return np.degrees(angle) % 360 * u.deg, _jackknife(sums, total) * u.deg


def _jackknife(sums, total):
    """Return the error of the direction of a sum over the epochs, in degrees."""
    n = len(sums)
    if n < 2:
        return np.inf
    without = total - sums
    side = without[:, 0] * total[1] - without[:, 1] * total[0]
    turn = np.arctan2(side, without @ total)
    return float(np.degrees(np.sqrt((n - 1) / n * ((turn - turn.mean()) ** 2).sum())))


def find_ridge_line(
    cube: EpochCube, *, position_angle: u.Quantity | None = None,
    origin: u.Quantity | None = None, half_width: u.Quantity | None = None,
    smoothing: u.Quantity | None = None, threshold: float = 5.0,
    r_max: u.Quantity | None = None,
) -> RidgeLine:  # fmt: skip
    """
    Follow the brightest line of a jet in the mean of its images.

    The line starts at the core and advances by a quarter of a beam.  At each
    step, its point is the mean position of the part of a slice across the jet
    that is brighter than half of the slice's maximum.  The next slice is
    perpendicular to the direction of the last points.  The points are then
    smoothed by local parabolas.  The line ends where the slice is no longer
    above the noise, at the edge of the image, or where it would turn back.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    position_angle : `~astropy.units.Quantity`, optional
        Direction at the core, by default from `fit_position_angle`.
    origin : `~astropy.units.Quantity`, shape (2,), optional
        (east, north) of the core, by default the reference pixel.
    half_width : `~astropy.units.Quantity`, optional
        Half length of the slices, by default 1.5 beams.
    smoothing : `~astropy.units.Quantity`, optional
        Standard deviation of the weights of the parabolas, by default two
        beams.
    threshold : float, optional
        The line ends where the slice's maximum is below this many standard
        deviations of the mean image's noise.
    r_max : `~astropy.units.Quantity`, optional
        Largest length.

    Returns
    -------
    `RidgeLine`
        The error of a slice is due to noise, ``b / (sqrt(2) SNR)`` (Fomalont
        1999), or the scatter about the smooth line where that is larger; the
        errors of the points are propagated through the smoothing.

    Raises
    ------
    ValueError
        If the jet cannot be followed over three beams.

    Examples
    --------
    >>> from astro_scc.kinematics import find_ridge_line
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> line = find_ridge_line(simulate_two_fluid(rng=1).cube)
    >>> s, n = line.coordinates(*line.at(line.length / 2))
    >>> bool(abs(line.at(line.length / 2)[1].value) < 0.5)
    True
    """
    image, noise = _mean(cube)
    width = mean_width(cube)
    step = STEP * width
    half = 1.5 * width if half_width is None else _length("half_width", half_width)
    smooth = 2 * width if smoothing is None else _length("smoothing", smoothing)
    # The length is limited, as a line could go in circles.
    longest = 2 * np.hypot(*cube.shape[1:]) * cube.pixel_scale.value
    if r_max is not None:
        longest = min(longest, _length("r_max", r_max))
    if position_angle is None:
        position_angle, _ = fit_position_angle(cube, origin=origin, threshold=threshold)
    angle = PositionAngleFrame(position_angle).pa.to_value(u.rad)
    direction = np.array([np.sin(angle), np.cos(angle)])
    points, tops = _follow(
        cube, image, _origin(origin), direction, half, threshold * noise, longest
    )
    length = (len(points) - 1) * step
    if length < 3 * width:
        raise ValueError(
            f"the jet can be followed over {length:.2g} mas only, less than three "
            "beams: give a position angle instead"
        )
    snr = tops / noise
    snr[0] = np.nanmax(snr)
    error = width / (np.sqrt(2) * snr)
    # A small error keeps the beginning of the line at the core.
    error[0] = 1e-2 * error.min()
    points, error = _smoothed(points, error, smooth, step)
    meta = {"width": width * u.mas, "smoothing": smooth * u.mas}
    return RidgeLine(*(points.T * u.mas), error * u.mas, meta=meta)


def _follow(cube, image, start, direction, half, faintest, longest):
    """Return the points of slices from a start onwards, and the slices' maxima."""
    width = mean_width(cube)
    step = STEP * width
    points, tops = [start], [np.nan]
    while len(points) * step <= longest + step:
        guess = points[-1] + step * direction
        found = _slice_point(cube, image, guess, direction, half)
        if found is None or found[1] < faintest:
            break
        point, top = found
        met = _met_again(points, point, width)
        if met is not None:
            # The line went round the end of the jet, so half of the detour is cut off.
            end = (met + len(points)) // 2
            del points[end:], tops[end:]
            break
        points.append(point)
        tops.append(top)
        # A direction over the last 1.5 beams keeps the slices from tumbling.
        back = points[max(0, len(points) - 1 - round(1.5 / STEP))]
        direction = (point - back) / np.hypot(*(point - back))
    return np.array(points), np.array(tops)


def _met_again(points, point, width):
    """Return the index of an earlier point within a beam of a new one, or None."""
    earlier = np.array(points[: -round(APART / STEP)])
    if len(earlier) == 0:
        return None
    away = np.hypot(*(earlier - point).T)
    return int(away.argmin()) if away.min() < width else None


def _slice_point(cube, image, guess, direction, half):
    """Return the mean position and the maximum of the bright part of a slice."""
    from scipy.ndimage import label, map_coordinates

    normal = np.array([direction[1], -direction[0]])
    n = np.linspace(-half, half, SLICE)
    x, y = cube.offset_to_pixel(*((guess + n[:, None] * normal).T * u.mas))
    values = np.nan_to_num(map_coordinates(image, [y, x], order=1, cval=np.nan))
    top = int(values.argmax())
    if values[top] <= 0:
        return None
    # Only the part connected with the maximum, as another ridge is not part of it.
    parts, _ = label(values >= 0.5 * values[top])
    part = parts == parts[top]
    middle = np.average(n[part], weights=values[part])
    return guess + middle * normal, float(values[top])


def _smoothed(points, error, width, step):
    """Return points smoothed by local parabolas over distance, and their errors."""
    s = lengths_of(points)
    distance = (s - s[:, None]) / width
    windows = np.exp(-0.5 * distance**2)
    smooth, gains = np.empty_like(points), np.empty_like(windows)
    for k, x in enumerate(distance):
        weight = windows[k] / (error / error.max()) ** 2
        design = np.stack([np.ones_like(x), x, x * x], axis=1)
        normal = design.T @ (weight[:, None] * design)
        gains[k] = np.linalg.solve(normal, design.T * weight)[0]
        smooth[k] = gains[k] @ points
    # Half of the square in two dimensions is across the line.
    square = 0.5 * ((points - smooth) ** 2).sum(axis=1)
    scatter = windows @ square / windows.sum(axis=1)
    variance = np.maximum(error**2, scatter)
    # Points within a beam share their noise.
    return smooth, np.sqrt(gains**2 @ variance / STEP)


def _mean(cube):
    """Return the mean image, with NaN for masked pixels, and its noise."""
    image = np.asarray(cube.mean_image().data, dtype=float)
    noise = cube.noise_rms().value
    return image, float(np.sqrt(np.mean(noise**2) / len(cube)))


def mean_width(cube):
    """Return the resolution in mas: the mean beam, or four pixels without beams."""
    if cube.beams is None:
        return 4 * cube.pixel_scale.value
    areas = [(b.major * b.minor).to_value(u.mas**2) for b in cube.beams]
    return float(np.sqrt(np.mean(areas)))


def _origin(origin):
    return (RadialFrame() if origin is None else RadialFrame(origin)).origin.value


def _length(name, value):
    return named(name, one_quantity, value, "an angle", "2 mas").to_value(u.mas)
