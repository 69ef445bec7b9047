# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Plan of a measurement: what the images tell, and what settings mean for them."""

from __future__ import annotations

import warnings
from contextlib import suppress

import astropy.units as u
import numpy as np
import scipy

from astro_scc import kinematics
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.epochs.registration import MISALIGNED
from astro_scc.exceptions import AstroSccWarning
from astro_scc.grid import has_core
from astro_scc.images.positions import PIXELS_RESOLVED, ssp_offsets
from astro_scc.settings import require
from astro_scc.spectrum.permutations import EVERY, speeds_tested, within
from astro_scc.streams.finder import FEWEST_EPOCHS
from astro_scc.units import PM_UNIT


def motion_of(cube, max_speed, interval, *, least_motion=0.01, most_motion=10):
    """
    Return in words how far a largest speed moves, and the largest displacement in mas.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    max_speed : float
        In mas/yr.
    interval : `~numpy.ndarray`
        Of the pairs of dates, in years.
    least_motion : float, optional
        Smallest displacement in the longest interval, in pixels.
    most_motion : float, optional
        Largest displacement in the shortest interval, in diagonals of the image.

    Raises
    ------
    ValueError
        If it leads far out of the image even in the shortest interval, or hardly
        moves anything even in the longest.
    """
    side, shape = np.hypot(*cube.pixel_matrix.value), np.array(cube.shape[1:])
    least, most = max_speed * np.array([interval.min(), interval.max()])
    image = np.hypot(*(side * shape[::-1]))
    moved = f"max_speed moves {least:.3g} to {most:.3g} mas between two dates"
    too_fast = least > most_motion * image
    if too_fast or most < least_motion * side.min():
        sizes = f"images of {image:.3g} mas with pixels of {side.min():.3g} mas"
        other = "smaller" if too_fast else "larger"
        raise ValueError(f"{moved}, in {sizes}: give a {other} one")
    return moved, most


def require_speed(cube, max_speed):
    """Refuse a largest speed that does not fit the dates and pixels of a cube."""
    if max_speed is not None:
        gaps = np.diff(cube.years.to_value(u.yr))
        every = np.array([gaps[gaps > 0].min(), gaps.sum()])
        motion_of(cube, max_speed.to_value(PM_UNIT), every)


def scale_numbers(cube, scales, *, tolerance=0.2, largest=12):
    """
    Return the numbers of the scales, for the pixels of a cube.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    scales : tuple of float, `~astropy.units.Quantity` or None
        As settings have them; if None, they follow from the beam, or the size of the
        structures.
    tolerance : float, optional
        Largest relative difference between an angle and the size of the scale it names.
    largest : int, optional
        Number that no scale reaches that an angle can name.

    Returns
    -------
    tuple of float

    Raises
    ------
    ValueError
        If an angle is not near a scale's size, or two angles mean the same
        scale.
    """
    if scales is None:
        return choose_scales(cube)[0]
    if not isinstance(scales, u.Quantity):
        return scales
    numbers = np.arange(0, largest, 0.5)
    sizes = np.array([scale_size(j) for j in numbers])
    wanted = (scales / cube.pixel_scale).to_value(u.one)
    nearest = np.abs(np.log(wanted[:, None] / sizes)).argmin(axis=1)
    for angle, size, k in zip(scales, wanted, nearest, strict=True):
        if abs(size / sizes[k] - 1) > tolerance:
            raise ValueError(
                f"scale {angle} is {size:.2g} px, not near 2^j or 1.5 x 2^j px"
            )
    # Two angles may mean the same scale.
    return require("scales", numbers[nearest].tolist())


def flow_direction(decomposed, frame=None):
    """
    Return the direction of the jet.

    It is that of the velocity axes, if they have one position angle, or that of the
    mean offset of the SSPs, weighted by flux.

    Parameters
    ----------
    decomposed : `~astro_scc.patterns.DecomposedEpochs`
    frame : frame of `astro_scc.kinematics`, optional

    Returns
    -------
    `~astropy.units.Quantity`
        North through east, 0 to 360 deg.
    """
    if isinstance(frame, kinematics.PositionAngleFrame):
        return frame.pa
    use = decomposed.select
    east, north = ssp_offsets(decomposed.ssps, decomposed.cube)
    weight = decomposed.ssps.flux[use]
    if weight.sum() <= 0:
        return 0.0 * u.deg
    mean = [np.average(offset[use], weights=weight) for offset in (east, north)]
    return np.degrees(np.arctan2(*mean)) % 360 * u.deg


def velocity_frame(cube, position_angle):
    """Return the velocity axes for a setting."""
    match position_angle:
        case u.Quantity():
            return kinematics.PositionAngleFrame(position_angle)
        case "fit":
            angle, _ = kinematics.fit_position_angle(cube)
            return kinematics.PositionAngleFrame(np.round(angle))
        case "ridge":
            return kinematics.find_ridge_line(cube)
        case "radial":
            return kinematics.RadialFrame()
        case None | "any":
            return kinematics.SkyFrame()
    return position_angle


def used_intervals(cube, baseline):
    """Return the shortest and the longest interval that is used, in years."""
    years = cube.years.to_value(u.yr)
    limits = EVERY if baseline is None else tuple(baseline.to_value(u.yr).tolist())
    apart = years - years[:, None]
    number = within(apart[apart > 0], limits).sum()
    require_pairs(cube, baseline, number, least=3)
    return limits


def require_pairs(cube, baseline, number, *, least=2):
    """Refuse a cube of which no two epochs are as far apart as the settings want."""
    years = cube.years.to_value(u.yr)
    if len(years) < least:
        raise ValueError(
            f"velocities need at least {least} epochs, {FEWEST_EPOCHS} to show that "
            f"anything moves; the cube has {len(years)}: give images of other dates"
        )
    if number > 0:
        return
    if baseline is None:
        raise ValueError(
            f"all {len(years)} epochs are of one date ({cube.times[0].isot}): "
            "velocities need different dates"
        )
    (shortest, longest), gaps = baseline.to_value(u.yr), np.diff(years)
    raise ValueError(
        f"no two epochs are {shortest:g} to {longest:g} yr apart: their separations go "
        f"from {gaps.min():.3g} to {gaps.sum():.3g} yr; choose another baseline"
    )


def out_of_reach(smallest, n_epochs, n_trials, alpha):
    """Return why no p-value can be as small as the level, or an empty text."""
    if smallest <= alpha:
        return ""
    what = f"{n_trials} trials"
    more = f"give n_trials of {int(np.ceil(1 / alpha))} or more"
    if n_epochs < FEWEST_EPOCHS:
        what = f"{n_epochs} epochs"
        more = f"measure {FEWEST_EPOCHS} epochs or more"
    elif smallest * n_trials > 1:
        what = f"{n_epochs} epochs of which some are close together in time"
        more = "measure more epochs"
    return (
        f"{what} allow no p_global below {smallest:.2g}, so nothing without "
        f"secure features can reach level {alpha:g}: {more}"
    )


# -- what the images tell ----------------------------------------------------------


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
    >>> from astro_scc.plan import choose_alignment
    >>> from astro_scc.simulation import simulate_jet
    >>> choose_alignment(simulate_jet(n_epochs=12, alignment_error=0.4, rng=1).cube)
    ('core', 'the epochs scatter by 0.38 beams, 0.01 on the core')
    """
    scatter, on_core = cube.misalignment, None
    if scatter is None:
        return "none", "the images do not show how well they are aligned"
    if scatter < MISALIGNED:
        return "none", f"the epochs are aligned to {scatter:.2f} beams"
    with suppress(ValueError), warnings.catch_warnings():
        warnings.simplefilter("ignore", AstroSccWarning)
        on_core = cube.align("core").misalignment
    reason = f"the epochs scatter by {scatter:.2f} beams, "
    if on_core is None or on_core >= scatter:
        return "none", f"{reason}no less on the core"
    return "core", f"{reason}{on_core:.2f} on the core"


def flow_beam(cube):
    """
    Return the length in which the flow is measured, in mas.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    float
        The mean beam or, without beams, the size of the structures.
    """
    pixel = cube.pixel_scale.to_value(u.mas)
    if cube.beams is None:
        return structure_size(cube) * pixel
    # Nothing is smaller than what pixels resolve.
    return max(cube.resolution.to_value(u.mas), PIXELS_RESOLVED * pixel)


def searched_speeds(cube):
    """
    Return the slowest and fastest speed that are searched without ``max_speed``.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    `~astropy.units.Quantity`, shape (2,)
    """
    speed = speeds_tested(cube.years.to_value(u.yr))[[0, -1]] * flow_beam(cube)
    return (speed * PM_UNIT).to(cube.speed_unit)


def choose_scales(cube, *, octaves=4):
    """
    Return the scales that suit the resolution of the images.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    octaves : int, optional
        Largest number of scales.

    Returns
    -------
    scales : tuple of int
        Four from a quarter of the beam to two beams; without a beam, up to half of
        the size of the structures.
    reason : str

    Examples
    --------
    >>> from astro_scc import EpochCube
    >>> from astro_scc.plan import choose_scales
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
        scales = range(max(1, last - octaves + 1), last + 1)
        reason = f"up to half of the size of the structures ({size:.1f} px)"
    else:
        size = (cube.resolution / cube.pixel_scale).to_value(u.one)
        first = round(np.log2(size / 4))
        scales = range(max(1, first), min(most, max(1, first + octaves - 1)) + 1)
        reason = f"from a quarter of the beam ({size:.1f} px) to two beams"
    return tuple(scales) or (most,), reason


def structure_size(cube, *, background=16.0, most_epochs=5, most_pixels=512):
    """
    Return the full width at half maximum of the structures in the images.

    It is the width of their mean autocorrelation over the square root of two, as
    for a Gaussian, after what is much larger has been subtracted.  Lag zero has
    all of the noise, so it is extrapolated from the next two lags by a Gaussian.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    background : float, optional
        What is smooth on this scale, in pixels, is background to the structures: those
        of 3 to 8 px are then measured to 20%.
    most_epochs, most_pixels : int, optional
        Number of epochs that are used, and width of the part in the middle.

    Returns
    -------
    float
        In pixels, at least 2; too small by a fifth for structures of 14 px.
    """
    some = np.unique(np.linspace(0, len(cube) - 1, most_epochs).astype(int))
    n = int(min(4 * background, *cube.shape[1:]))
    total = np.zeros((n, n))
    first = [max(0, (size - most_pixels) // 2) for size in cube.shape[1:]]
    middle = tuple(slice(start, start + most_pixels) for start in first)
    for epoch in some:
        parts = (a[epoch][middle] for a in (cube.data, cube.mask))
        image = np.ma.masked_invalid(np.ma.masked_array(*parts, dtype=float))
        image = (image - np.ma.median(image)).filled(0.0)
        image -= scipy.ndimage.gaussian_filter(image, background)
        power = np.abs(scipy.fft.rfft2(image, np.array(image.shape) + n - 1)) ** 2
        total += scipy.fft.irfft2(power, np.array(image.shape) + n - 1)[:n, :n]
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


def choose_direction(
    cube, *, snr=5.0, cores=(1.5, 1.0), one_sided=0.6, begins=(0.05, 4.0), certain=10.0,
    two_sided=0.8,
):  # fmt: skip
    """
    Return the direction of a jet, from the mean of its images.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    snr : float, optional
        Faintest pixels that show a direction, in noises of an epoch.
    cores : tuple of float, optional
        Distance in beams within which are the wings of the core; the next one where
        nothing is seen farther out.
    one_sided : float, optional
        Structure is one-sided if the mean of the unit vectors from the core, weighted
        by brightness, is as long: of 63 sources of MOJAVE XVIII, CLEANed, it is 0.78 or
        more, of 20 simulated shells 0.23 or less (seeds from 8000 on).
    begins : (float, float), optional
        It begins at the core if this share of the brightness is as near, in beams:
        within 3.5 of those jets; the shells have none within 18.
    certain : float, optional
        Largest error of a direction that is used, in degrees.
    two_sided : float, optional
        Structure is along one axis if the mean of the unit vectors with twice the
        position angle is as long: 0.93 for a jet with a counter-jet, below 0.1 for the
        shells.

    Returns
    -------
    position_angle : `~astropy.units.Quantity` or None
        In whole degrees, of two sides the brighter one; None where the structure
        extends from the reference pixel neither to one side nor along one axis, so that
        motion in all directions is searched for.
    reason : str

    Examples
    --------
    >>> from astro_scc.plan import choose_direction
    >>> from astro_scc.simulation import simulate_jet
    >>> choose_direction(simulate_jet(n_epochs=5, rng=1).cube)[0]
    <Quantity 273. deg>
    """
    if cube.beams is None:
        return None, "images without a beam have no core"
    image = np.asarray(cube.mean_image().data, dtype=float)
    # A sky that is not zero would be an excess where the other side is not seen.
    image = np.nan_to_num(image - np.nanmedian(image))
    faintest = snr * np.median(u.Quantity(cube.noise_rms()).value)
    limits = {"cores": cores, "one_sided": one_sided, "begins": begins}
    angle, reason = _on_one_side(cube, image, faintest, certain=certain, **limits)
    if angle is not None:
        if _lies_aside(cube, image, faintest, angle):
            return None, "the structure lies beside the reference pixel"
        return np.round(angle), "that of the mean image"
    angle = _along_both_sides(cube, image, faintest, cores[0], two_sided)
    if angle is None:
        return None, reason
    return np.round(angle), "that of the mean image, on both sides of the core"


def _on_one_side(cube, image, faintest, *, cores, one_sided, begins, certain):
    """Return the direction of a one-sided jet, or None and why there is none."""
    try:
        angle, error = kinematics.fit_position_angle(cube)
    except ValueError:
        return None, "nothing is seen beyond a beam from the core"
    # Of others the excess is less, whatever is on the other side.
    y, x = np.nonzero(image >= faintest + min(image.min(), 0.0))
    offset = cube.pixel_to_offset(x, y)
    # Without what is as bright on the other side: the core's wings, a shell.
    other = cube.offset_to_pixel(*(-part for part in offset))[::-1]
    excess = image[y, x] - scipy.ndimage.map_coordinates(image, other, order=1)
    bright = excess > faintest
    offset, excess = [part.value[bright] for part in offset], excess[bright]
    r, offset = np.hypot(*offset), np.transpose(offset)
    beam = np.mean([b.covariance.to_value(u.mas**2) for b in cube.beams], axis=0)
    beams = np.einsum("...i,ij,...j", offset, np.linalg.inv(beam), offset)
    beams = np.sqrt(beams / (8 * np.log(2)))
    for core in cores:
        use = beams > core
        if use.any():
            break
    else:
        return None, "nothing is seen beyond a beam from the core on one side alone"
    order = np.argsort(r[use])
    r, offset, excess = (a[use][order] for a in (r, offset, excess))
    length = np.hypot(*((excess / r) @ offset))
    if length <= one_sided * excess.sum() or error.value > certain:
        return None, "the structure is not on one side of the reference pixel"
    (inner, near), share = begins, np.cumsum(excess) / excess.sum()
    if r[np.searchsorted(share, inner)] > near * cube.resolution.to_value(u.mas):
        return None, "the structure does not begin at the reference pixel"
    return angle, ""


def _along_both_sides(cube, image, faintest, core, two_sided, *, weaker=0.1):
    """
    Return the direction of a jet on both sides of a core, or None.

    The ``weaker`` side has this part of the brightness or more.
    """
    y, x = np.nonzero(image > faintest)
    places = [offset.to_value(u.rad) for offset in cube.pixel_to_offset(x, y)]
    beam = cube.resolution.to_value(u.mas)
    far = np.hypot(*places) > core * cube.resolution.to_value(u.rad)
    if far.sum() < 3 or not has_core(cube, beam):
        return None
    bright, angle = image[y, x][far], np.arctan2(*places)[far]
    double = bright @ np.exp(2j * angle) / bright.sum()
    axis = np.angle(double) / 2
    ahead = bright @ (np.cos(angle - axis) > 0) / bright.sum()
    if abs(double) < two_sided or min(ahead, 1 - ahead) < weaker:
        return None
    # The brighter end of the axis.
    return (np.degrees(axis + np.pi * (ahead < 0.5)) % 360) * u.deg


def _lies_aside(cube, image, faintest, angle, *, core=0.05, least=25.0, longer=2.0):
    """
    Return whether a jet does not come from the reference pixel, but passes beside it.

    Nothing brighter than this part of the brightest point, the ``core``, is within half
    a beam of that pixel, and the structure is ``longer`` in a direction than across it,
    ``least`` degrees from its direction as seen from there.
    """
    y, x = np.nonzero(image > faintest)
    bright = image[y, x]
    places = np.stack([offset.value for offset in cube.pixel_to_offset(x, y)])
    near = np.hypot(*places) < cube.resolution.to_value(u.mas) / 2
    if bright.size < 3 or (bright[near] > core * bright.max()).any():
        return False
    variances, axes = np.linalg.eigh(np.cov(places, aweights=bright))
    way = np.sin(angle), np.cos(angle)
    turn = np.degrees(np.arccos(min(1.0, abs(float(axes[:, 1] @ way)))))
    return bool(variances[1] > longer**2 * variances[0] and turn > least)
