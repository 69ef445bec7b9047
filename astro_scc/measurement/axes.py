# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Displacements along one axis of a frame, in beams."""

from dataclasses import replace

import astropy.units as u
import numpy as np

from astro_scc.epochs import beam_fwhm, ssp_offsets
from astro_scc.kinematics import ExpansionFrame, RidgeLine

__all__ = ["AxisProjection"]


class AxisProjection:
    """
    Project the matches of a cube on axes of the sky, in units of the beam.

    Parameters
    ----------
    displacements : `~astro_scc.stacking.VelocitySamples`
        In mas, along the axes of the frame.
    ssps : `~astro_scc.decomposition.SSPs`
    cube : `~astro_scc.epochs.EpochCube`
    frame : frame of `astro_scc.kinematics`

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.measurement.axes import AxisProjection
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=2, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> matched = scc.match(cube)
    >>> displacements, frame = scc.displacements(matched)
    >>> project = AxisProjection(displacements, matched.ssps, cube, frame)
    >>> bool(len(project(0.0)) == len(displacements)), project.beam(0.0)
    (True, array([1., 1.]))
    """

    def __init__(self, displacements, ssps, cube, frame):
        self.displacements, self.ssps, self.frame = displacements, ssps, frame
        self.cube = cube
        east, north = ssp_offsets(ssps, cube)
        self._position = _positions(frame, east, north)
        self._axes = np.asarray(frame.matrix(east, north))

    def beam(self, angle):
        """
        Mean width of the beam along an axis and across it.

        Parameters
        ----------
        angle : float
            Of the axis from the first one of the frame, in radians.

        Returns
        -------
        `~numpy.ndarray`, shape (2,)
            In mas.
        """
        axes = _turn(angle) @ self._axes
        known = np.isfinite(axes).all(axis=(-2, -1))
        keep = np.broadcast_to(known, len(self.ssps))
        if not keep.any():
            return np.ones(2)
        axes = axes if axes.ndim == 2 else axes[keep]
        fwhm = beam_fwhm(self.cube, self.ssps.epoch[keep], self.ssps.scale[keep], axes)
        return np.mean(fwhm, axis=0)

    def __call__(self, angle):
        """
        The displacements along an axis.

        Parameters
        ----------
        angle : float
            In radians from the first axis of the frame.

        Returns
        -------
        `~astro_scc.stacking.VelocitySamples`
        """
        d, turn, beam = self.displacements, _turn(angle), self.beam(angle)
        along, across = (turn @ np.stack([d.d1, d.d2])) / beam[:, None]
        return replace(
            d,
            d1=along,
            d2=across,
            s1=None,
            s2=None,
            motion=None,
            position=(self._position @ turn.T) / beam,
            epoch=self.ssps.epoch,
            scale=self.ssps.scale,
            years=self.cube.years.to_value(u.yr),
        )


def _turn(angle):
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def _positions(frame, east, north):
    """Places along the axes of a frame, in mas, (n, 2)."""
    if isinstance(frame, RidgeLine):
        s, n = frame.coordinates(east * u.mas, north * u.mas)
        return np.stack([s.to_value(u.mas), n.to_value(u.mas)], axis=1)
    if frame.uniform:
        return np.stack([east, north], axis=1) @ np.asarray(frame.matrix()).T
    origin = frame.centre if isinstance(frame, ExpansionFrame) else frame.origin
    x, y = np.stack([east, north]) - origin.to_value(u.mas)[:, None]
    distance = np.maximum(np.hypot(x, y), np.finfo(float).tiny)
    if isinstance(frame, ExpansionFrame):
        # Homologous expansion is uniform in the logarithm.
        length = frame.radius.to_value(u.mas)
        distance = length * np.log(distance / length)
    else:
        length = distance.sum() / max(len(distance), 1)
    # What moves away from a point keeps its direction, not its arc.
    angle = np.arctan2(x, y)
    # Angles are cut opposite to where most SSPs are.
    angle = (angle - np.angle(np.exp(1j * angle).sum()) + np.pi) % (2 * np.pi)
    return np.stack([distance, length * angle], axis=1)
