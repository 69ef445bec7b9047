# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Registration: the position of the core, displacements, and their scatter."""

from __future__ import annotations

from contextlib import suppress

import astropy.units as u
import numpy as np
import scipy
from astropy.table import QTable

from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.images import grid, zncc
from astro_scc.images.beam import FWHM_TO_SIGMA
from astro_scc.images.series import ImageSeries

#: Scatter in beams at which there is a warning.  Of 200 static jets with 0.2 and 0.3,
#: none seems to move; more is not calibrated (``static_table.csv``).
MISALIGNED = 0.2
#: A local maximum, or a blended component, has this part of the brightest if it is the
#: core.
FAINTEST = 0.1


def core_positions(cube: ImageSeries, *, jet_pa: u.Quantity | None = None) -> QTable:
    """
    Return the position of the core in each epoch.

    The core is taken to be the upstream end of the jet: of the local maxima
    with at least a tenth of the epoch's peak, the one farthest upstream.
    Around it two Gaussians of the shape of the beam are fitted together, and
    the upstream one is the core.  Only one is fitted if a second lowers
    chi-square by less than 25, or if the direction of the jet is unknown.
    Where what is found so moves by 0.2 beams or more (rms) while the brightest
    point stands still, it is no core: the other end of the jet is taken if it
    stands still, or else the brightest point.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
        With ``beams``, which need not be equal.
    jet_pa : `~astropy.units.Quantity`, optional
        Position angle of the jet at the core, north through east.  By
        default the direction from the peak of the mean image to its
        centroid, if they are farther apart than a twentieth of the beam.

    Returns
    -------
    `~astropy.table.QTable`
        One row per epoch: ``label``, ``date``, ``east`` and ``north``
        (offset of the core from the reference pixel, in mas), their
        errors ``east_err`` and ``north_err``, from noise or misfit,
        whichever is larger, and ``blended``, whether a second component
        lies within a beam of the core.

    Raises
    ------
    ValueError
        If the epochs have no beams, or nothing in an epoch is bright enough
        to be the core.

    Warns
    -----
    MeasurementWarning
        If neither end of the jet stands still, but the brightest point does.

    Notes
    -----
    The accuracy is limited by the images.  In ten MOJAVE epochs of 0003+380
    with their own beams (0.9 x 0.6 mas) the result agrees with the core of
    the model fits to the visibilities to 0.02 mas.  After convolution to the
    common beam (1.1 x 0.9 mas) it agrees to 0.03 mas, while the brightest
    pixel is off by up to 0.11 mas.  In images restored from the published
    models, two thirds of the epochs agree to 0.05 mas for 3C 120 (the worst to
    0.16 mas), and to 0.2 mas (0.75 mas) for 3C 273, where bright features
    crowd within a beam of a faint core; M87 is off by 0.04 mas downstream,
    the same in all epochs to 0.02 mas.  If there are core positions from
    model fits, align with a table of them.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.epochs import Beam, EpochCube
    >>> y, x = np.mgrid[:64, :64]
    >>> beam = np.exp(-4 * np.log(2) * ((x - 30) ** 2 + (y - 34.5) ** 2) / 64)
    >>> cube = EpochCube.from_arrays(
    ...     beam[None],
    ...     ["2000-01-01"],
    ...     pixel_scale=0.1 * u.mas,
    ...     reference_pixel=(32, 32),
    ...     beams=Beam(0.8 * u.mas, 0.8 * u.mas),
    ...     noise=1e-3 * u.one,
    ... )
    >>> core_positions(cube)["east", "north"]
    <QTable length=1>
      east   north
      mas     mas
    float64 float64
    ------- -------
        0.2    0.25
    """
    if cube.beams is None:
        raise ValueError(
            "the core is fitted with the beam and the epochs have none; give beams, "
            "or align with 'correlate' or a table of positions"
        )
    matrix = cube.pixel_matrix.to_value(u.mas)
    shapes, noise = cube.beam_shapes, cube.noise_rms().to_value(cube.unit)
    if jet_pa is None:
        direction = _mean_direction(cube, shapes[0], noise.mean())
    else:
        pa = u.Quantity(jet_pa).to_value(u.rad)
        direction = np.linalg.inv(matrix) @ [np.sin(pa), np.cos(pa)]
        direction = direction / np.hypot(*direction)
    rows = _fits(cube, shapes, direction, noise)
    if direction is not None and not _stands(cube, rows):
        rows = _standing_end(cube, rows, shapes, direction, noise)
    position, covariance, blended = map(np.array, zip(*rows, strict=True))
    sky = matrix @ covariance @ matrix.T
    table = QTable({"label": list(cube.labels), "date": cube.times})
    table["east"], table["north"] = cube.pixel_to_offset(*position.T)
    table["east_err"] = np.sqrt(sky[:, 0, 0]) * u.mas
    table["north_err"] = np.sqrt(sky[:, 1, 1]) * u.mas
    table["blended"] = blended
    return table


def _fits(cube, shapes, direction, noise):
    """Return for each epoch the position of the core, its covariance, and blends."""
    rows = []
    for i, label in enumerate(cube.labels):
        image, good = grid.fill_masked(cube.data[i], cube.mask[i]), ~cube.mask[i]
        options = shapes[i], direction, noise[i]
        start = _candidate(image, good, *options)
        if start is None:
            raise ValueError(
                f"{label}: nothing is bright enough to be the core; give a table of "
                "positions"
            )
        rows.append(_fit(image, good, start, *options))
    return rows


def _stands(cube, rows):
    """Return whether positions scatter by less than 0.2 beams."""
    offsets = cube.pixel_to_offset(*np.transpose([row[0] for row in rows]))
    return max(offset.std() for offset in offsets) < MISALIGNED * cube.resolution


def _standing_end(cube, rows, shapes, direction, noise):
    """Return what stands still of all that may be the core, see `core_positions`."""
    brightest = _fits(cube, shapes, None, noise)
    if not _stands(cube, brightest):
        return rows
    other = _fits(cube, shapes, -direction, noise)
    if _stands(cube, other):
        return other
    warn(
        f"what is fitted as the core moves by {MISALIGNED:g} beams or more (rms), the "
        "brightest point stands still and is taken: if that is not the core, give the "
        "direction of the jet (--align 'core 270 deg', in Python jet_pa=) or a table",
        MeasurementWarning,
    )
    return brightest


def farthest_upstream(cube: ImageSeries, direction: np.ndarray) -> np.ndarray:
    """
    Return where in the mean image the core would be, if the jet had a direction.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
        With ``beams``.
    direction : `~numpy.ndarray`, shape (2,)
        To the east and north.

    Returns
    -------
    `~numpy.ndarray`, shape (2,)
        Offset (east, north) in mas of the local maximum that is farthest upstream and
        has a tenth of the peak; of the reference pixel, if there is none.
    """
    mean, way = cube.mean_image(), np.linalg.inv(cube.pixel_matrix.value) @ direction
    image, noise = np.where(mean.mask, 0, mean.data), np.median(cube.noise_rms().value)
    found = _candidate(image, ~mean.mask, cube.beam_shapes[0], way, noise)
    if found is None:
        return np.zeros(2)
    return np.array([v.to_value(u.mas) for v in cube.pixel_to_offset(*found)])


def _mean_direction(cube, shape, level):
    """Return the unit vector (x, y) down the jet, None if there is no direction."""
    mean = cube.mean_image()
    values = np.where(mean.mask, 0, mean.data)
    bright = values > max(0.01 * values.max(), 5 * level)
    if not bright.any():
        return None
    peak = np.unravel_index(np.argmax(values), values.shape)
    away, weight = (np.argwhere(bright) - peak)[:, ::-1], values[bright]
    step = np.array([weight @ part for part in away.T]) / weight.sum()
    width = np.linalg.det(shape) ** 0.25 / FWHM_TO_SIGMA
    length = np.hypot(*step)
    return step / length if length > 0.05 * width else None


def _candidate(image, good, shape, direction, noise):
    """Return the (x, y) of the local maximum that is farthest upstream."""
    # Maxima are compared within half a beam, at least with the eight neighbours.
    size = np.maximum(np.sqrt(np.diag(shape)[::-1]) / FWHM_TO_SIGMA / 2, 3)
    size = (2 * np.rint((size - 1) / 2) + 1).astype(int)
    maximum = (image == scipy.ndimage.maximum_filter(image, size=tuple(size))) & good
    maximum &= image > max(FAINTEST * image[maximum].max(initial=-np.inf), 5 * noise)
    places = np.argwhere(maximum)[:, ::-1]
    if len(places) == 0:
        return None
    order = -image[maximum] if direction is None else places @ direction
    return places[np.argmin(order)].astype(float)


def _fit(image, good, start, shape, direction, noise, radius=1.5):
    """
    Return the position in pixels, its covariance and whether it is blended.

    Pixels within a ``radius`` in widths of the beam (FWHM) are fitted.  A second
    component must lower chi-square by 25.
    """
    radius = radius / FWHM_TO_SIGMA
    precision = np.linalg.inv(shape)
    # Only the box around the ellipse, as images may be a hundred times as large.
    reach = radius * np.sqrt(np.diag(shape))
    left, top = np.maximum(np.floor(start - reach), 0).astype(int)
    right, bottom = np.ceil(start + reach).astype(int) + 1
    image, good = (array[top:bottom, left:right] for array in (image, good))
    y, x = np.mgrid[top : top + image.shape[0], left : left + image.shape[1]]
    used = good & (_distance2(x, y, start, precision) < radius**2)
    x, y, values = x[used], y[used], image[used]
    # In a fit of beams, noise that the beam correlates has one independent value
    # per half a beam area.
    half_area = max(np.pi * np.sqrt(np.linalg.det(shape)), 1.0)

    def solve(parameters):
        at = (_distance2(x, y, p, precision) for p in parameters.reshape(-1, 2))
        basis = np.exp(-0.5 * np.stack([*at], axis=1))
        peaks = np.linalg.lstsq(basis, values, rcond=None)[0]
        return peaks, basis @ peaks - values

    def residuals(parameters):
        return solve(parameters)[1]

    fit = one = scipy.optimize.least_squares(residuals, start)
    core, blended = 0, False
    if direction is not None:
        width = 1 / np.sqrt(direction @ precision @ direction) / FWHM_TO_SIGMA
        guess = [start - 0.1 * width * direction, start + 0.4 * width * direction]
        two = scipy.optimize.least_squares(residuals, np.concatenate(guess))
        positions, peaks = two.x.reshape(2, 2), solve(two.x)[0]
        # A bright feature hides the maximum of a core up to 1.4 beams upstream.
        near = _distance2(*positions.T, start, precision) < radius**2
        better = 2 * (one.cost - two.cost) > 25 * noise**2 * half_area
        real = (peaks >= FAINTEST * peaks.max()) & near
        if better and real.any():
            fit = two
            core = int(np.argmin(np.where(real, positions @ direction, np.inf)))
            apart = _distance2(*positions[1 - core], positions[core], precision)
            blended = bool(apart < FWHM_TO_SIGMA**-2 and peaks.min() > 0)
    variance = max(noise**2, 2 * fit.cost / len(values)) * half_area
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * variance
    pick = slice(2 * core, 2 * core + 2)
    return fit.x[pick], covariance[pick, pick], blended


def _distance2(x, y, centre, precision):
    """Return the squared distance in standard deviations of the beam."""
    dx, dy = x - centre[0], y - centre[1]
    (a, b), (_, d) = precision
    return a * dx**2 + 2 * b * dx * dy + d * dy**2


def displacement(image, mask, reference, use, reach, start=None, alike=0.0):
    """
    Return the displacement (dx, dy) of an image from a reference, and its covariance.

    It starts from ``start``, or else from the pixel within ``reach`` that has the
    largest zero-mean normalised cross-correlation of the good pixels.  From there
    the sum of squares of ``I(x + d) - a R(x) - b`` over the pixels in ``use``,
    which must be good in the reference, is minimised over d, gain a and level b, in
    steps in which the slopes of R are those of I.  I is interpolated with cubic
    splines.  Pixels where the slope of R is less than 1% of the steepest do not
    constrain d and are left out.

    A source at x in the reference is at x + d in the image.  The covariance
    assumes that residuals are independent from pixel to pixel; where a beam spans
    several pixels, it is too small by a factor of half the beam's area in pixels.
    Raises a ValueError if fewer than ten pixels are good, if d is not within ``reach``
    of the start, or if the correlation there is not above ``alike``.
    """
    filled = grid.fill_masked(image, mask)
    # The pixels in use know nothing of others that are farther away than this.
    first = (0, 0) if start is None else start
    reached = 24 + int(np.ceil(reach + np.abs(first).max()))
    for box in scipy.ndimage.find_objects(use.astype(np.uint8)):
        near = tuple(slice(max(k.start - reached, 0), k.stop + reached) for k in box)
        filled, mask = filled[near], mask[near]
        reference, use = reference[near], use[near]
    if start is None:
        # The peak to whole pixels is off by less than one and a half pixels.
        start, reach = _whole_pixels(filled, mask, reference, use, reach), 1.5
    slopes = np.gradient(grid.fill_masked(reference, ~use))[::-1]
    steep = np.hypot(*slopes)
    y, x = np.nonzero(use & (steep >= 0.01 * steep[use].max(initial=0)))
    # The spline spreads the filled values of bad pixels over two pixels, and the
    # fit moves by up to one and a half.
    around = scipy.ndimage.binary_dilation(mask, iterations=3).astype(float)
    at = [y + start[1], x + start[0]]
    weight = scipy.ndimage.map_coordinates(around, at, order=1, cval=1.0)
    keep = weight <= grid.BAD_WEIGHT
    if keep.sum() < 10:
        raise ValueError("too few good pixels to compare; leave it out")
    y, x = y[keep], x[keep]
    target = reference[y, x] - reference[y, x].mean()
    design = [*(slope[y, x] for slope in slopes), target, np.ones_like(target)]
    found = _fit_displacement(filled, (y, x), design, start, reach, alike)
    if found is None:
        raise ValueError("nothing in the image correlates; leave it out")
    return found


def _fit_displacement(filled, pixels, design, start, reach, alike):
    """
    Return the displacement and its covariance, None if nothing fits.

    The ``design`` has slopes along x and y, values and ones at the ``pixels`` (y, x).
    """
    (y, x), target = pixels, design[2]
    solve = np.linalg.pinv(np.stack(design, axis=1))
    spline = scipy.ndimage.spline_filter(filled, order=3)
    options = {"order": 3, "prefilter": False, "mode": "mirror"}
    d = np.array(start, dtype=float)
    for _ in range(10):
        at = [y + d[1], x + d[0]]
        values = scipy.ndimage.map_coordinates(spline, at, **options)
        *step, gain, level = solve @ values
        # A negative gain or a large shift shows that the steps do not converge.
        if gain <= 0 or np.hypot(*(d - start)) > reach:
            return None
        step = np.array(step) / gain
        d -= step * min(1, reach / 2 / max(np.hypot(*step), 1e-9))
        if np.hypot(*step) < 0.01:
            break
    values = values - values.mean()
    if values @ target <= alike * np.sqrt(values @ values * (target @ target)):
        return None
    left = values - gain * target
    freedom = max(len(target) - 4, 1)
    return d, (solve @ solve.T)[:2, :2] * (left @ left) / freedom / gain**2


def _whole_pixels(filled, mask, reference, use, reach, min_overlap=0.5):
    """
    Return the displacement (dx, dy) of the largest correlation.

    At least the part ``min_overlap`` of the pixels in use must fall on good ones.
    """
    steps = int(np.ceil(reach)) + 1
    (box,) = scipy.ndimage.find_objects(use.astype(int))
    # Windows reach past the box on all sides, and past the image.
    window = tuple(slice(s.start, s.stop + 2 * steps) for s in box)
    pattern = np.where(use, reference, 0)[box], use[box]
    around, valid = (np.pad(k, steps)[window] for k in (filled, ~mask))
    coefficient, _ = zncc.correlate_windows(
        *pattern, around, (steps, steps), valid=valid, min_overlap=min_overlap
    )
    dy, dx = np.mgrid[-steps : steps + 1, -steps : steps + 1]
    coefficient = np.where(np.hypot(dx, dy) <= max(reach, 0.5), coefficient, -1)
    best = np.unravel_index(np.argmax(coefficient), coefficient.shape)
    return dx[best], dy[best]


def misalignment(cube: ImageSeries) -> float | None:
    r"""
    Return the scatter of the alignment of a cube's epochs, in beams.

    Each epoch is registered on the mean of the epochs before and after it,
    weighted by time.  In this mean, features that move steadily, by less than
    their size, are where they are in the epoch, and so are standing features.
    The core need not be found, and a feature may outshine it.  With the
    displacements d and the weight w of the epoch before,

    .. math:: \sigma^2 = \left\langle \frac{d^2 / 2}{1 + w^2 + (1 - w)^2} \right\rangle

    is the variance of the positions of epochs along an axis.

    Epochs that are too far apart do not resemble one another.  Then the
    positions of the core (`~astro_scc.epochs.core_positions`) are compared in
    the same way, if they are reliable: if they align some epochs with one
    another.  A steady drift of everything cannot be distinguished from motion
    and does not count.

    Returns
    -------
    float or None
        In units of the mean ``sqrt(major minor)`` of the beams; None without
        beams, for fewer than three dates, or if neither way gives a result.

    Examples
    --------
    >>> from astro_scc.epochs.registration import misalignment
    >>> from astro_scc.simulation import simulate_jet
    >>> jet = simulate_jet(n_epochs=12, alignment_error=0.3, rng=1)
    >>> round(misalignment(jet.cube), 1)
    0.3
    >>> import warnings
    >>> with warnings.catch_warnings():
    ...     # The core is blended with the jet in some epochs.
    ...     warnings.simplefilter("ignore")
    ...     aligned = jet.cube.align("core")
    >>> round(misalignment(aligned), 1)
    0.0
    """
    years = cube.years.to_value(u.yr)
    middle = 1 + np.flatnonzero(years[2:] > years[:-2])
    if cube.beams is None or len(middle) == 0:
        return None
    width = cube.resolution.to_value(u.mas)
    # Weights of the epochs before and after.
    weights = {
        k: np.diff(years[k - 1 : k + 2])[::-1] / (years[k + 1] - years[k - 1])
        for k in middle
    }

    def scatter(shifts):
        # The neighbours, whose weighted mean is the reference, scatter as much.
        squares = [
            np.mean(shift**2) / (1 + np.sum(np.square(weights[k])))
            for k, shift in shifts.items()
            if shift is not None
        ]
        enough = 2 * len(squares) > len(shifts)
        return float(np.sqrt(np.mean(squares)) / width) if enough else None

    def measured(epochs, at=None):
        return scatter({k: _shift(cube, k, weights[k], at) for k in epochs})

    # They give the scatter to 15%.
    if (found := measured(_spread(middle, 24))) is not None:
        return found
    some = _spread(middle, 4)
    every = np.unique([some - 1, some, some + 1])
    try:
        cores = core_positions(cube[every])
    except ValueError:
        return None
    places = np.stack([cores["east"].value, cores["north"].value], axis=1)
    at = dict(zip(every, places, strict=True))
    # Cores are trusted if the epochs that they align agree.
    certain = measured(some, at)
    if certain is None or certain > 0.05:
        return None
    means = {k: weights[k][0] * at[k - 1] + weights[k][1] * at[k + 1] for k in some}
    return scatter({k: at[k] - mean for k, mean in means.items()})


def _spread(values, most):
    """Return at most ``most`` of some values, evenly from the first to the last."""
    places = np.linspace(0, len(values) - 1, most).round().astype(int)
    return values[np.unique(places)]


def _shift(cube, k, weights, positions, alike=0.9):
    """
    Return the shift of an epoch from its neighbours in mas, None if unknown.

    Pixels above five times the noise are of the source.  The correlation of an aligned
    epoch with its neighbours must be above ``alike``: with a core it is 0.97, without
    0.4 to 0.7.
    """
    matrix = cube.pixel_matrix.to_value(u.mas)
    three = slice(k - 1, k + 2)
    images = list(map(grid.fill_masked, cube.data[three], cube.mask[three]))
    if positions is not None:
        for i, image in enumerate(images):
            x, y = np.linalg.solve(matrix, positions[k - 1 + i])
            images[i] = scipy.ndimage.shift(image, (-y, -x), order=3)
    reference = weights[0] * images[0] + weights[1] * images[2]
    masked = cube.mask[three].any(axis=0)
    source = ~masked & (reference > 5 * cube.noise_rms()[k].value)
    reach = (cube.resolution / cube.pixel_scale).to_value(u.one)
    pair = images[1], np.zeros_like(masked), reference, source
    with suppress(ValueError):
        return matrix @ displacement(*pair, reach, (0, 0), alike)[0]
    return None


def warn_of_misalignment(cube):
    """Warn if the alignment of the epochs scatters by 0.2 beams or more."""
    scatter = cube.misalignment
    if scatter is not None and scatter >= MISALIGNED:
        warn(
            f"the epochs are aligned to {scatter:.2f} beams only, where "
            f"{MISALIGNED:g} or more adds to every error of a speed: align them, with "
            "--align core or cube.align('core'), or if they were, in another way",
            MeasurementWarning,
        )
