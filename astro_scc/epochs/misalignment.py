# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The accuracy of the alignment of the epochs."""

import warnings

import astropy.units as u
import numpy as np
from scipy import ndimage

from astro_scc.epochs.grid import fill_masked
from astro_scc.epochs.registration import core_positions
from astro_scc.exceptions import MeasurementWarning

#: Scatter in beams that can make a static jet seem to move: 5 of 42 static jets did at
#: 0.3 beams, none of 132 at 0.2.
LARGEST = 0.2
#: This number of epochs gives the scatter to 15%.
ENOUGH = 24
#: Number of epochs in which, with their neighbours, the core is sought, and the scatter
#: in beams of the epochs after alignment on it, up to which it is trusted.
CORES, AGREE = 4, 0.05
#: Smallest correlation of an aligned epoch with its neighbours that gives its position:
#: with a core it is 0.97, without 0.4 to 0.7.
ALIKE = 0.9
#: Smallest signal-to-noise ratio of the source's pixels, and their smallest number.
SOURCE_SNR, FEWEST = 5.0, 10
#: Largest number of steps towards a displacement, and the last step in pixels.
STEPS, CONVERGED = 10, 0.01


def misalignment(cube):
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
    >>> from astro_scc.epochs.misalignment import misalignment
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
    width = np.mean([np.sqrt(b.major * b.minor).to_value(u.mas) for b in cube.beams])
    # Weights of the epochs before and after.
    weights = {
        k: np.diff(years[k - 1 : k + 2])[::-1] / (years[k + 1] - years[k - 1])
        for k in middle
    }
    noise = cube.noise_rms().value

    def scatter(epochs, positions=None):
        shifts = {
            k: _shift(cube, k, weights[k], SOURCE_SNR * noise[k], width, positions)
            for k in epochs
        }
        return _scatter(shifts, weights, width)

    found = scatter(_spread(middle, ENOUGH))
    if found is not None:
        return found
    some = _spread(middle, CORES)
    every = np.unique([some - 1, some, some + 1])
    try:
        cores = core_positions(cube[every])
    except ValueError:
        return None
    cores = np.stack([cores[k].to_value(u.mas) for k in ("east", "north")], axis=1)
    cores = dict(zip(every, cores, strict=True))
    certain = scatter(some, cores)
    if certain is None or certain > AGREE:
        return None
    shifts = {}
    for k in some:
        before, after = weights[k]
        shifts[k] = cores[k] - (before * cores[k - 1] + after * cores[k + 1])
    return _scatter(shifts, weights, width)


def _spread(values, most):
    """Return at most ``most`` of some values, evenly from the first to the last."""
    places = np.linspace(0, len(values) - 1, most).round().astype(int)
    return values[np.unique(places)]


def _scatter(shifts, weights, width):
    """
    Return the scatter of one epoch, in beams, or None if most shifts are None.

    The neighbours, whose weighted mean is the reference, scatter as much.
    """
    squares = [
        np.mean(shift**2) / (1 + np.sum(np.square(weights[k])))
        for k, shift in shifts.items()
        if shift is not None
    ]
    if 2 * len(squares) <= len(shifts):
        return None
    return float(np.sqrt(np.mean(squares)) / width)


def _shift(cube, k, weights, threshold, width, positions):
    """Return the shift of an epoch from its neighbours in mas, None if unknown."""
    matrix = cube.pixel_matrix.to_value(u.mas)
    three = slice(k - 1, k + 2)
    images = list(map(fill_masked, cube.data[three], cube.mask[three]))
    if positions is not None:
        for i, image in enumerate(images):
            x, y = np.linalg.solve(matrix, positions[k - 1 + i])
            images[i] = ndimage.shift(image, (-y, -x), order=3)
    reference = weights[0] * images[0] + weights[1] * images[2]
    source = ~cube.mask[three].any(axis=0) & (reference > threshold)
    reach = width / np.sqrt(abs(np.linalg.det(matrix)))
    shift = _displacement(images[1], reference, source, reach)
    return None if shift is None else matrix @ shift


def _displacement(image, reference, use, reach):
    """
    Return the displacement (x, y) from a reference, None if they are not alike.

    ``I(x + d) = a R(x) + b`` is linearised with the slopes of R and solved for
    d, gain a and level b, iteratively.
    """
    y, x = np.nonzero(use)
    if len(y) < FEWEST:
        return None
    slope_y, slope_x = np.gradient(reference)
    r = reference[use] - reference[use].mean()
    design = [slope_x[use], slope_y[use], r, np.ones_like(r)]
    solve = np.linalg.pinv(np.stack(design, axis=1))
    spline = ndimage.spline_filter(image, order=3)
    shift = np.zeros(2)
    for _ in range(STEPS):
        values = ndimage.map_coordinates(
            spline, [y + shift[1], x + shift[0]], order=3, prefilter=False
        )
        *step, gain, _ = solve @ values
        # A negative gain or a large shift shows that the steps do not converge.
        if gain <= 0 or np.hypot(*shift) > reach:
            return None
        step = np.array(step) / gain
        shift -= step * min(1, reach / 2 / max(np.hypot(*step), 1e-9))
        if np.hypot(*step) < CONVERGED:
            break
    values = values - values.mean()
    alike = values @ r > ALIKE * np.sqrt(values @ values * (r @ r))
    return shift if alike else None


def warn_of_misalignment(cube):
    """Warn if the alignment of the epochs scatters by 0.2 beams or more."""
    scatter = cube.misalignment
    if scatter is not None and scatter >= LARGEST:
        warnings.warn(
            f"the epochs are aligned to {scatter:.2f} beams only, where "
            f"{LARGEST:g} can make a jet that stands still move: align them, with "
            "--align core or cube.align('core'), or if they were, in another way",
            MeasurementWarning,
            stacklevel=4,
        )
