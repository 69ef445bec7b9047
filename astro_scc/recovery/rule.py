# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which component of a measurement is one that was put in."""

import astropy.units as u
import numpy as np

from astro_scc.kinematics import RadialFrame

__all__ = ["moving_components", "recovered", "velocity_along"]

#: A feature that was put in holds an SSP whose maximum is this close, in beams.
NEAR = 0.5


def velocity_along(frame, position_angle):
    """
    The unit vector of a direction of motion, on the axes of a frame.

    Parameters
    ----------
    frame : frame of `astro_scc.kinematics`
    position_angle : `~astropy.units.Quantity` or "radial"

    Returns
    -------
    `~numpy.ndarray`, shape (2,)
    """
    if isinstance(frame, RadialFrame):
        return np.array([1.0, 0.0])
    angle = position_angle.to_value(u.rad)
    return frame.matrix(0.0, 0.0) @ [np.sin(angle), np.cos(angle)]


def moving_components(result, level):
    """
    The components of a measurement that move.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    level : float
        Largest ``p_global``.

    Returns
    -------
    list of int
        Their numbers, from 1.
    """
    table = result.components
    moving = (table["kind"] == "moving") & (table["p_global"] <= level)
    return [int(number) for number in table["component"][moving]]


def recovered(result, own, velocity, *, tolerance, level, paths, fwhm):
    """
    The component that is due to features that were put in.

    It is moving, with ``p_global <= level``, within the tolerance of their
    velocity; it is none of the components that the epochs have of their
    own, each of which takes the component nearest to it, if one is within
    the tolerance; and more of its SSPs are within half a beam of a feature
    that was put in than of the others.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
        Of the epochs with the features.
    own : array_like, shape (n, 2)
        Velocities of the components without them.
    velocity : array_like, shape (2,)
        Of the features, in mas/yr on the axes of the result's frame.
    tolerance : float
        In mas/yr.
    level : float
    paths : `FeaturePaths`
    fwhm : float
        Resolution in mas.

    Returns
    -------
    int or None
        Number of the component, from 1; the nearest if there are several.
    """
    left = {
        number: result.velocities[number - 1].value
        for number in moving_components(result, level)
    }
    for v in np.reshape(own, (-1, 2)):
        nearest = _nearest(left, v, tolerance)
        left.pop(nearest, None)
    while (nearest := _nearest(left, np.asarray(velocity), tolerance)) is not None:
        if _share_of_features(result, nearest, paths, fwhm) > 0.5:
            return nearest
        del left[nearest]
    return None


def _nearest(velocities, velocity, tolerance):
    """Key of the nearest velocity within a tolerance, or None."""
    distance = {k: np.hypot(*(v - velocity)) for k, v in velocities.items()}
    near = [k for k, d in distance.items() if d <= tolerance]
    return min(near, key=distance.get, default=None)


def _share_of_features(result, number, paths, fwhm):
    """Share of a component's SSPs that lie on features that were put in."""
    ssps = result.matched.ssps
    member = np.unique(result.displacements.ssp[result.members(number)])
    if len(member) == 0:
        return 0.0
    epoch = ssps.epoch[member]
    pixels = np.stack(
        [paths.x[:, epoch] - ssps.x[member], paths.y[:, epoch] - ssps.y[member]]
    )
    offset = np.einsum("ij,jnm->inm", result.cube.pixel_matrix.value, pixels)
    # A feature that is not there is NaN, and near to nothing.
    near = (np.hypot(*offset) <= NEAR * fwhm).any(axis=0)
    return float(near.mean())
