# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""When a feature was at the core."""

import numpy as np

__all__ = ["ejection_epoch", "turn_between"]

#: A speed or an acceleration counts from so many standard errors.
SIGNIFICANT = 3.0
#: Largest angle, with two standard errors, between motion and radius (deg).
RADIAL = 15.0


def ejection_epoch(fit, beam, *, accelerated=False):
    r"""
    The date at which a feature that moves radially was at the origin.

    .. math:: t_\mathrm{ej} = t_m - \frac{\boldsymbol r \cdot \boldsymbol\mu}
                                         {|\boldsymbol\mu|^2}

    with position and velocity of the straight fit at its middle date.  As
    in MOJAVE (Lister et al. 2009, AJ 138, 1874; 2019, ApJ 874, 43) there is
    none unless the speed is three standard errors or more, the motion is
    not accelerated, and it points outward within 15 degrees with two
    standard errors of the angle to spare.  Far out 15 degrees are several
    beams: the straight line must pass the origin within one as well, nearer
    than which a feature is not told from the core.

    Parameters
    ----------
    fit : `~astro_scc.tracking.MotionFit`
        Of degree 1; the first axis is east, the second north.
    beam : float
        Width of the beam, in the unit of the positions.
    accelerated : bool, optional

    Returns
    -------
    epoch, error : float or None
        In the unit and from the zero of the times of the fit; None where it
        is not allowed.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking import ejection_epoch, fit_motion
    >>> time = np.arange(2000.0, 2006.0)
    >>> fit = fit_motion(time, [0.3 * (time - 1998), 0 * time], np.full((2, 6), 0.01))
    >>> round(ejection_epoch(fit, 0.5)[0], 3)
    1998.0
    """
    r, v = fit.coefficients[:, 0], fit.coefficients[:, 1]
    speed = np.hypot(*v)
    speed_err, angle_err = speed_errors(fit)
    if accelerated or speed < SIGNIFICANT * speed_err:
        return None, None
    distance = np.hypot(*r)
    passes = np.abs(r[0] * v[1] - r[1] * v[0]) / speed
    if distance == 0 or passes > beam:
        return None, None
    # The direction to the mean position has an error of its own.
    across = np.array([r[1], -r[0]]) / distance**2
    radius_err = np.sqrt(np.sum(across**2 * fit.covariance[:, 0, 0]))
    off = turn_between(r, v)
    if off + 2 * np.degrees(np.hypot(angle_err, radius_err)) > RADIAL:
        return None, None
    along = r @ v
    by_r = -v / speed**2
    by_v = -r / speed**2 + 2 * v * along / speed**4
    gradient = np.stack([by_r, by_v], axis=1)
    variance = np.einsum("ai,aij,aj->", gradient, fit.covariance[:, :2, :2], gradient)
    return float(fit.middle - along / speed**2), float(np.sqrt(variance))


def speed_errors(fit):
    """
    Standard errors of the length and direction of a velocity.

    Parameters
    ----------
    fit : `~astro_scc.tracking.MotionFit`

    Returns
    -------
    length, angle : float
        The angle in radians, at most pi.
    """
    v, error = fit.coefficients[:, 1], fit.errors[:, 1]
    speed = np.hypot(*v)
    if speed == 0:
        return float(np.hypot(*error)), np.pi
    along, across = v / speed, np.array([v[1], -v[0]]) / speed
    length = np.sqrt(np.sum((along * error) ** 2))
    return float(length), min(np.sqrt(np.sum((across * error) ** 2)) / speed, np.pi)


def turn_between(a, b):
    """
    Angle between two vectors.

    Parameters
    ----------
    a, b : array_like, shape (2,)

    Returns
    -------
    float
        In degrees, 0 to 180; 0 for a vector without length.

    Examples
    --------
    >>> from astro_scc.tracking import turn_between
    >>> turn_between([1, 0], [0, 2])
    90.0
    """
    cross = a[0] * b[1] - a[1] * b[0]
    return float(np.degrees(np.abs(np.arctan2(cross, np.dot(a, b)))))
