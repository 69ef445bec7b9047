# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the images tell about how to measure them: alignment and direction."""

import warnings

import astropy.units as u
import numpy as np
from scipy.ndimage import map_coordinates

from astro_scc.epochs.registration import MISALIGNED
from astro_scc.exceptions import AstroSccWarning
from astro_scc.kinematics import fit_position_angle
from astro_scc.kinematics.ridge_search import mean_width

#: Faintest pixels that show a direction, in noises of an epoch.
SNR = 5.0
#: Structure is one-sided if the mean of the unit vectors from the core, weighted by
#: brightness, is as long as this: of 70 simulated jets it is 0.95 or more, of 20
#: shells 0.23 or less (seeds from 8000 on).
ONE_SIDED = 0.85
#: It begins at the core if this share of the brightness is as near, in beams: within
#: 3.5 of those jets; the shells have none within 18.
INNER, NEAR = 0.05, 4.0
#: Largest error of a direction that is used, in degrees.
CERTAIN = 10.0


def choose_alignment(cube):
    """
    Return the alignment that the images need.

    Epochs that agree on their reference pixels to 0.2 beams are left so: beyond it,
    static jets can appear to move (``docs/calibration.rst``).  Others are aligned on
    the core, if they agree better afterwards.

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
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AstroSccWarning)
            on_core = cube.align("core").misalignment
    except ValueError:
        on_core = None
    if on_core is None or on_core >= scatter:
        return "none", f"the epochs scatter by {scatter:.2f} beams, no less on the core"
    return (
        "core",
        f"the epochs scatter by {scatter:.2f} beams, {on_core:.2f} on the core",
    )


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
    # Without what is as bright on the other side: the core's wings, a shell.
    x, y = cube.offset_to_pixel(-east, -north)
    excess = image - map_coordinates(image, [y, x], order=1, cval=0.0)
    noise = np.median(u.Quantity(cube.noise_rms()).value)
    use = (excess > SNR * noise) & (r > width)
    weight = excess[use] / r[use]
    mean = [weight @ offset[use].to_value(u.mas) for offset in (east, north)]
    if np.hypot(*mean) <= ONE_SIDED * excess[use].sum() or error.value > CERTAIN:
        return None, "the structure is not on one side of the reference pixel"
    order = np.argsort(r[use])
    share = np.cumsum(excess[use][order]) / excess[use].sum()
    if r[use][order][np.searchsorted(share, INNER)] > NEAR * width:
        return None, "the structure does not begin at the reference pixel"
    return np.round(angle), "that of the mean image"
