# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches as velocity samples along the axes of a frame, with their errors."""

from dataclasses import replace

import astropy.units as u
import numpy as np

from astro_scc import kinematics
from astro_scc.correlation.correlate import target_ssps
from astro_scc.images import positions
from astro_scc.kinematics import ExpansionFrame, RidgeLine
from astro_scc.kinematics.frames import frame_displacements
from astro_scc.stacking.velocities import VelocitySamples


class AxisProjection:
    """
    Project the matches of a cube onto axes of the sky, in units of the beam.

    Parameters
    ----------
    displacements : ``VelocitySamples``
        In mas, along the axes of the frame.
    cube : `~astro_scc.epochs.EpochCube`
    frame : frame of `astro_scc.kinematics`
    first : int, optional
        Epoch of the cube that is the first one of the displacements.
    """

    def __init__(self, displacements, cube, frame, first=0):
        d = displacements
        self.displacements, self.frame = d, frame
        self._covariance = positions.beam_covariance(cube, d.epoch + first, d.scale)
        east, north = np.ascontiguousarray(displacements.position.T)
        self._position = frame_positions(frame, east, north)
        self._axes = np.asarray(frame.matrix(east, north))

    def beam(self, angle):
        """
        Return the mean width of the beam along an axis and across it.

        Parameters
        ----------
        angle : float
            Angle of the axis from the first axis of the frame, in radians.

        Returns
        -------
        `~numpy.ndarray`, shape (2,)
            In mas.
        """
        axes = turned(angle) @ self._axes
        known = np.isfinite(axes).all(axis=(-2, -1))
        keep = np.broadcast_to(known, len(self._covariance))
        if not keep.any():
            return np.ones(2)
        axes = axes if axes.ndim == 2 else axes[keep]
        return np.mean(positions.widths_along(self._covariance[keep], axes), axis=0)

    def __call__(self, angle):
        """
        Return the displacements along an axis.

        Parameters
        ----------
        angle : float
            In radians from the first axis of the frame.

        Returns
        -------
        ``VelocitySamples``
        """
        d, turn, beam = self.displacements, turned(angle), self.beam(angle)
        along, across = (turn @ np.stack([d.d1, d.d2])) / beam[:, None]
        place = (self._position @ turn.T) / beam
        unknown = {"s1": None, "s2": None, "motion": None}
        return replace(d, d1=along, d2=across, position=place, **unknown)


def projection_of(result):
    """Return the projection of a result's displacements onto axes of the sky."""
    return AxisProjection(result.displacements, result.cube, result.frame)


def turned(angle):
    """Return the matrix that turns two axes by an angle in radians."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def frame_positions(frame, east, north):
    """Return positions along the axes of a frame, in mas, shape (n, 2)."""
    if isinstance(frame, RidgeLine):
        s, n = frame.coordinates(east * u.mas, north * u.mas)
        return np.stack([s.to_value(u.mas), n.to_value(u.mas)], axis=1)
    if frame.uniform:
        return np.stack([east, north], axis=1) @ np.asarray(frame.matrix()).T
    origin = frame.centre if isinstance(frame, ExpansionFrame) else frame.origin
    x, y = np.stack([east, north]) - origin.to_value(u.mas)[:, None]
    distance = np.maximum(np.hypot(x, y), np.finfo(float).tiny)
    if isinstance(frame, ExpansionFrame):
        # Homologous expansion is uniform in the logarithm of the radius.
        length = frame.radius.to_value(u.mas)
        distance = length * np.log(distance / length)
    else:
        length = distance.sum() / max(len(distance), 1)
    # Radial motion keeps the angle, not the arc length.
    angle = np.arctan2(x, y)
    # Angles wrap opposite to where most SSPs are.
    angle = (angle - np.angle(np.exp(1j * angle).sum()) + np.pi) % (2 * np.pi)
    return np.stack([distance, length * angle], axis=1)


def matched_displacements(matched, settings):
    """
    Return matches as displacements along the velocity axes, and the axes.

    Parameters
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
    settings : `~astro_scc.StackedCrossCorrelation`

    Returns
    -------
    displacements : ``VelocitySamples``
        In mas, for the selected SSPs.  SSPs at which the frame has no axes count as
        SSPs without a match.
    frame : frame of `astro_scc.kinematics`
        Gives the two axes at the position of each SSP.
    """
    cube, ssps, select = matched.cube, matched.ssps, matched.select
    frame = velocity_frame(cube, settings.position_angle)
    fraction = settings.min_error_beams
    east, north = positions.ssp_offsets(ssps, cube)
    axes = np.asarray(frame.matrix(east, north))
    # A radial frame has no axes at its origin.
    known = select & np.isfinite(axes).all(axis=(-2, -1))
    matches = matched.matches.select(known[matched.matches.ssp])
    owner = matches.ssp
    pixels = np.stack([matches.dx, matches.dy], axis=-1).astype(float)
    sky = pixels @ cube.pixel_matrix.value.T
    position = np.stack([east[owner], north[owner]], axis=-1)
    d = frame_displacements(frame, position, sky)
    # The resolution in the epochs of SSPs and of their matches.
    here = positions.beam_fwhm(cube, ssps.epoch, ssps.scale, axes)[owner]
    own = ssps.scale[owner], axes if axes.ndim == 2 else axes[owner]
    there = positions.beam_fwhm(cube, matches.target, *own)
    ends = (ssps.snr[owner], here), (matches.target_snr, there)
    first, second = (positions.position_errors(*end, fraction) for end in ends)
    s = np.sqrt(first**2 + second**2)
    samples = VelocitySamples(
        d1=d[:, 0],
        d2=d[:, 1],
        s1=s[:, 0],
        s2=s[:, 1],
        weight=(matches.coefficient * matches.overlap).astype(float),
        reference=ssps.epoch[owner].astype(np.int32),
        target=matches.target.astype(np.int32),
        ssp=owner.astype(np.int32),
        target_ssp=target_ssps(matches, ssps).astype(np.int32),
        n_ssps=np.bincount(ssps.epoch[select], minlength=len(cube)),
        position=np.stack([east, north], axis=-1),
        motion=sky,
        epoch=ssps.epoch,
        scale=ssps.scale,
        years=cube.years.to_value(u.yr),
    )
    return samples, frame


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
        of_each = [last.get(label, {}) for label in cube.labels]
        left = [[own.get(name) or 0.0 for name in names] for own in of_each]
        each = np.sqrt(np.mean(np.square(left, dtype=float), axis=1))
    else:
        each = np.atleast_1d(error.to_value(u.mas)).astype(float)
        if each.shape not in ((1,), (n,)):
            raise ValueError(
                f"alignment_error must be 1 or {n} angles, got {each.size}"
            )
    return np.broadcast_to(each[:, None], (n, 2))
