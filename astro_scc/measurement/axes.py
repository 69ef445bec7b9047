# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The axes of velocities for a setting, and the alignment of the epochs on them."""

import astropy.units as u
import numpy as np

from astro_scc import kinematics


def velocity_frame(cube, position_angle):
    """Return the velocity axes for a setting."""
    match position_angle:
        case u.Quantity():
            return kinematics.PositionAngleFrame(position_angle)
        case "fit":
            angle, _ = kinematics.fit_position_angle(cube)
            return kinematics.PositionAngleFrame(angle)
        case "ridge":
            return kinematics.find_ridge_line(cube)
        case "radial":
            return kinematics.RadialFrame()
        case None | "any":
            return kinematics.SkyFrame()
    return position_angle


def alignment_errors(cube, error=None):
    """
    Return the standard error of the alignment of each epoch on both axes.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    error : `~astropy.units.Quantity`, optional
        One error for all epochs, or one per epoch.  The default is the error
        of each epoch's last alignment, or zero without it.

    Returns
    -------
    `~numpy.ndarray`, shape (n_epochs, 2)
        In mas.

    Raises
    ------
    ValueError
        If ``error`` has neither one element nor one per epoch.
    """
    n, names = len(cube), ("shift_east_err_mas", "shift_north_err_mas")
    if error is None:
        last = {record["epoch"]: record for record in cube.meta.get("alignment", ())}
        records = [last.get(label, {}) for label in cube.labels]
        left = [[record.get(name) or 0.0 for name in names] for record in records]
        each = np.sqrt(np.mean(np.square(left, dtype=float), axis=1))
    else:
        each = np.atleast_1d(error.to_value(u.mas)).astype(float)
        if each.shape not in ((1,), (n,)):
            raise ValueError(
                f"alignment_error must be 1 or {n} angles, got {each.size}"
            )
    return np.broadcast_to(each[:, None], (n, 2))
