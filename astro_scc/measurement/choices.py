# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the images tell about how to measure them: alignment, scales, direction."""

import warnings
from contextlib import suppress

import astropy.units as u
import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter, map_coordinates

from astro_scc.alignment.registration import MISALIGNED
from astro_scc.exceptions import AstroSccWarning
from astro_scc.images.positions import beam_fwhm
from astro_scc.kinematics import fit_position_angle
from astro_scc.kinematics.ridge_line import mean_width

#: Octaves of scales, the finest a quarter of the beam; without a beam, the coarsest
#: is half of the size of the structures (`structure_size`).
OCTAVES = 4
#: What is smooth on this scale, in pixels, is background to the structures: those of 3
#: to 8 px are then measured to 20% (``tests/measurement/test_choices.py``).
BACKGROUND = 16.0
#: Number of epochs in which they are measured, and width of the part in the middle, in
#: pixels.
MOST_EPOCHS, MOST_PIXELS = 5, 512
#: Faintest pixels that show a direction, in noises of an epoch.
SNR = 5.0
#: Structure is one-sided if the mean of the unit vectors from the core, weighted by
#: brightness, is as long as this: of 63 sources of MOJAVE XVIII, CLEANed, it is 0.78 or
#: more, of 20 simulated shells 0.23 or less (seeds from 8000 on).
ONE_SIDED = 0.6
#: Distance in beams within which are the wings of the core; the second one where
#: nothing is seen farther out.
CORE = (1.5, 1.0)
#: It begins at the core if this share of the brightness is as near, in beams: within
#: 3.5 of those jets; the shells have none within 18.
INNER, NEAR = 0.05, 4.0
#: Largest error of a direction that is used, in degrees.
CERTAIN = 10.0


def choose_alignment(cube):
    """
    Return the alignment that the images need.

    Epochs that agree on their reference pixels to 0.2 beams are left so.  Others are
    aligned on the core, if they agree better afterwards.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    align : {"none", "core"}
    reason : str

    Examples
    --------
    >>> from astro_scc.measurement.choices import choose_alignment
    >>> from astro_scc.simulation import simulate_jet
    >>> choose_alignment(simulate_jet(n_epochs=12, alignment_error=0.4, rng=1).cube)
    ('core', 'the epochs scatter by 0.38 beams, 0.01 on the core')
    """
    scatter = cube.misalignment
    if scatter is None:
        return "none", "the images do not show how well they are aligned"
    if scatter < MISALIGNED:
        return "none", f"the epochs are aligned to {scatter:.2f} beams"
    on_core = None
    with suppress(ValueError), warnings.catch_warnings():
        warnings.simplefilter("ignore", AstroSccWarning)
        on_core = cube.align("core").misalignment
    if on_core is None or on_core >= scatter:
        return "none", f"the epochs scatter by {scatter:.2f} beams, no less on the core"
    reason = f"the epochs scatter by {scatter:.2f} beams, {on_core:.2f} on the core"
    return "core", reason


def mean_fwhm(cube, scale):
    """
    Return the resolution, the mean FWHM over epochs and both axes, in mas.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    scale : float
        Number of the scale whose size is the resolution if there are no beams.

    Returns
    -------
    float
    """
    every = np.arange(len(cube))
    return float(np.mean(beam_fwhm(cube, every, np.full(len(cube), scale), np.eye(2))))


def choose_scales(cube):
    """
    Return the scales that suit the resolution of the images.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    scales : tuple of int
        Four from a quarter of the beam to two beams; without a beam, up to half of
        the size of the structures.
    reason : str

    Examples
    --------
    >>> from astro_scc import EpochCube
    >>> from astro_scc.measurement.choices import choose_scales
    >>> from astro_scc.simulation import simulate_jet
    >>> cube = simulate_jet(n_epochs=5, rng=1).cube
    >>> choose_scales(cube)
    ((1, 2, 3, 4), 'from a quarter of the beam (8.0 px) to two beams')
    >>> images = cube.data, cube.times
    >>> choose_scales(EpochCube.from_arrays(*images, pixel_scale=cube.pixel_scale))
    ((1, 2), 'up to half of the size of the structures (7.3 px)')
    """
    most = max(1, int(np.log2(min(cube.shape[1:]) / 2)))
    if cube.beams is None:
        size = structure_size(cube)
        last = min(most, max(1, round(np.log2(size / 2))))
        scales = range(max(1, last - OCTAVES + 1), last + 1)
        reason = f"up to half of the size of the structures ({size:.1f} px)"
    else:
        size = mean_fwhm(cube, 1) / cube.pixel_scale.to_value(u.mas)
        first = round(np.log2(size / 4))
        scales = range(max(1, first), min(most, max(1, first + OCTAVES - 1)) + 1)
        reason = f"from a quarter of the beam ({size:.1f} px) to two beams"
    return tuple(scales) or (most,), reason


def structure_size(cube):
    """
    Return the full width at half maximum of the structures in the images.

    It is the width of their mean autocorrelation over the square root of two, as
    for a Gaussian, after what is much larger has been subtracted.  Lag zero has
    all of the noise, so it is extrapolated from the next two lags by a Gaussian.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    float
        In pixels, at least 2; too small by a fifth for structures of 14 px.
    """
    some = np.unique(np.linspace(0, len(cube) - 1, MOST_EPOCHS).astype(int))
    n = int(min(4 * BACKGROUND, *cube.shape[1:]))
    total = np.zeros((n, n))
    middle = tuple(
        slice(max(0, (size - MOST_PIXELS) // 2), (size + MOST_PIXELS) // 2)
        for size in cube.shape[1:]
    )
    for epoch in some:
        parts = (a[epoch][middle] for a in (cube.data, cube.mask))
        image = np.ma.masked_array(*parts, dtype=float)
        image = np.ma.masked_invalid(image)
        image = (image - np.ma.median(image)).filled(0.0)
        image -= gaussian_filter(image, BACKGROUND)
        # Twice the size, so that the image does not meet itself at its border.
        shape = [fft.next_fast_len(2 * k, real=True) for k in image.shape]
        power = np.abs(fft.rfft2(image, shape)) ** 2
        total += fft.irfft2(power, shape)[:n, :n]
    lag = np.rint(np.hypot(*np.indices((n, n)))).astype(int).ravel()
    profile = (np.bincount(lag, total.ravel()) / np.bincount(lag))[:n]
    if not 0 < profile[2] < profile[1]:
        return 2.0
    profile[0] = profile[1] * (profile[1] / profile[2]) ** (1 / 3)
    below = np.flatnonzero(profile < profile[0] / 2)
    if len(below) == 0:
        return float(n)
    k = below[0]
    step = profile[k - 1] - profile[k]
    half = k - 1 + (profile[k - 1] - profile[0] / 2) / step
    return max(2.0, float(2 * half / np.sqrt(2)))


def choose_direction(cube):
    """
    Return the direction of a one-sided jet, from the mean of its images.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    position_angle : `~astropy.units.Quantity` or None
        In whole degrees; None where the structure does not extend to one side from the
        reference pixel, so that motion in all directions is searched for.
    reason : str

    Examples
    --------
    >>> from astro_scc.measurement.choices import choose_direction
    >>> from astro_scc.simulation import simulate_jet
    >>> choose_direction(simulate_jet(n_epochs=5, rng=1).cube)[0]
    <Quantity 273. deg>
    """
    if cube.beams is None:
        return None, "images without a beam have no core"
    try:
        angle, error = fit_position_angle(cube)
    except ValueError:
        return None, "nothing is seen beyond a beam from the core"
    image = np.nan_to_num(np.asarray(cube.mean_image().data, dtype=float))
    east, north = cube.offsets()
    width = mean_width(cube)
    r = np.hypot(east, north).to_value(u.mas)
    offset = np.stack([east, north], axis=-1).to_value(u.mas)
    beam = np.mean([b.covariance.to_value(u.mas**2) for b in cube.beams], axis=0)
    beams = np.einsum("...i,ij,...j", offset, np.linalg.inv(beam), offset)
    beams = np.sqrt(beams / (8 * np.log(2)))
    # Without what is as bright on the other side: the core's wings, a shell.
    x, y = cube.offset_to_pixel(-east, -north)
    excess = image - map_coordinates(image, [y, x], order=1, cval=0.0)
    noise = np.median(u.Quantity(cube.noise_rms()).value)
    for core in CORE:
        use = (excess > SNR * noise) & (beams > core)
        if use.any():
            break
    else:
        return None, "nothing is seen beyond a beam from the core"
    weight = excess[use] / r[use]
    if (
        np.hypot(*(weight @ offset[use])) <= ONE_SIDED * excess[use].sum()
        or error.value > CERTAIN
    ):
        return None, "the structure is not on one side of the reference pixel"
    order = np.argsort(r[use])
    share = np.cumsum(excess[use][order]) / excess[use].sum()
    if r[use][order][np.searchsorted(share, INNER)] > NEAR * width:
        return None, "the structure does not begin at the reference pixel"
    return np.round(angle), "that of the mean image"
