# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocities of streams on the axes of the frame, and their errors."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np

from astro_scc.stacking.streams import alignment_response

__all__ = ["StreamVelocity", "alignment_errors", "velocity_of"]


@dataclass(frozen=True, eq=False)
class StreamVelocity:
    """
    A stream's velocity in the axes of the frame.

    Attributes
    ----------
    value : `~numpy.ndarray`, shape (2,)
        In mas/yr.
    features : `~numpy.ndarray`, shape (2, 2)
        Covariance by the scatter and the errors of its features, in
        (mas/yr)^2; NaN where it has none.
    alignment : `~numpy.ndarray`, shape (2, 2)
        Covariance by what moves all features of an epoch together.
    dispersion, dispersion_error : float
        Of the features' speeds along the stream, in mas/yr.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.measurement import StreamVelocity
    >>> velocity = StreamVelocity(np.array([1.0, 0.0]), 0.04 * np.eye(2),
    ...                           0.05 * np.eye(2), 0.1, 0.02)
    >>> np.sqrt(np.diag(velocity.covariance)).round(2).tolist()
    [0.3, 0.3]
    """

    value: np.ndarray
    features: np.ndarray
    alignment: np.ndarray
    dispersion: float
    dispersion_error: float

    @property
    def covariance(self):
        """The covariance that is quoted."""
        return self.features + self.alignment


def velocity_of(stream, beam, misaligned, epoch):
    """
    A stream's velocity in mas/yr on the axes of the frame.

    Parameters
    ----------
    stream : `~astro_scc.stacking.Stream`
    beam : array_like, shape (2,)
        Width of the beam along the stream and across it, in mas.
    misaligned : `~numpy.ndarray`, shape (n_epochs, 2)
        Standard error of the alignment of each epoch, in mas.
    epoch : `~numpy.ndarray` of int, shape (n_ssps,)

    Returns
    -------
    `StreamVelocity`
    """
    cos, sin = np.cos(stream.angle), np.sin(stream.angle)
    to_frame = np.array([[cos, -sin], [sin, cos]])
    own = np.array([stream.along.mean, stream.across.mean]) * beam
    errors = np.array([stream.along.error, stream.across.error]) * beam
    response = alignment_response(stream, epoch, len(misaligned))
    return StreamVelocity(
        value=to_frame @ own,
        features=to_frame @ np.diag(errors**2) @ to_frame.T,
        alignment=np.diag(response**2 @ misaligned**2),
        dispersion=stream.along.dispersion * beam[0],
        dispersion_error=stream.along.dispersion_error * beam[0],
    )


def alignment_errors(cube, error=None):
    """
    Standard error of the alignment of each epoch, on either axis.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    error : `~astropy.units.Quantity`, optional
        One for all epochs, or one for each.  By default what the alignment
        left with each epoch (``shift_east_err_mas``, ``shift_north_err_mas``
        in its meta), and none where it left nothing.

    Returns
    -------
    `~numpy.ndarray`, shape (n_epochs, 2)
        In mas.

    Raises
    ------
    ValueError
        If there are neither one nor as many as epochs, or one is negative
        or not finite.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.measurement import alignment_errors
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    >>> alignment_errors(cube, 20 * u.uas).tolist()
    [[0.02, 0.02], [0.02, 0.02], [0.02, 0.02]]
    """
    n = len(cube)
    if error is None:
        left = [
            [meta.get(f"shift_{axis}_err_mas") or 0.0 for axis in ("east", "north")]
            for meta in cube.epoch_meta
        ]
        each = np.sqrt(np.mean(np.square(left, dtype=float), axis=1))
    else:
        each = np.atleast_1d(error.to_value(u.mas)).astype(float)
        if each.shape not in ((1,), (n,)):
            raise ValueError(
                f"alignment_error must be one angle or {n}, one an epoch, "
                f"got {each.size}"
            )
        if not np.all((each >= 0) & np.isfinite(each)):
            raise ValueError(f"alignment_error must be zero or positive, got {error}")
    return np.broadcast_to(each[:, None], (n, 2)) + np.zeros((n, 2))
