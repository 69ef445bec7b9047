# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the error of a velocity is made of."""

from dataclasses import dataclass, field

import astropy.units as u
import numpy as np

__all__ = ["VelocityError", "alignment_errors", "sampling_error"]

#: Features are drawn to whole pixels by up to this over their width in pixels.
SAMPLING = 0.15


@dataclass(frozen=True, eq=False)
class VelocityError:
    """
    Covariances of a velocity, in the axes of the frame, in (mas/yr)^2.

    Attributes
    ----------
    features : `~numpy.ndarray`, shape (2, 2)
        Of the scatter of its features: what each does, and how well it is
        placed (`~astro_scc.stacking.feature_scatter`).
    alignment : `~numpy.ndarray`, shape (2, 2)
        Of what moves all features of an epoch together
        (`~astro_scc.stacking.alignment_scatter`).
    epochs : `~numpy.ndarray`, shape (2, 2)
        Of leaving out one epoch after another
        (`~astro_scc.stacking.epoch_scatter`): it sees both, but of few
        epochs; not a part of the total.
    sampling : `~numpy.ndarray`, shape (2, 2)
        Of what the pixels do to all displacements alike
        (`~astro_scc.stacking.sampling_scatter`).

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.measurement import VelocityError
    >>> error = VelocityError(features=0.04 * np.eye(2), alignment=0.05 * np.eye(2),
    ...                       epochs=0.1 * np.eye(2))
    >>> np.sqrt(np.diag(error.total)).round(2).tolist()
    [0.3, 0.3]
    """

    features: np.ndarray
    alignment: np.ndarray
    epochs: np.ndarray
    sampling: np.ndarray = field(default_factory=lambda: np.zeros((2, 2)))

    @property
    def total(self):
        """The covariance that is quoted: features, alignment and sampling."""
        return self.features + self.alignment + self.sampling


def sampling_error(cube, fwhm):
    """
    Error of a displacement by the pixels of the images, at most.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    fwhm : float
        Resolution in mas.

    Returns
    -------
    float
        In mas: 0.15 pixels over the resolution in pixels.
    """
    pixel = np.sqrt(abs(np.linalg.det(cube.pixel_matrix.to_value(u.mas))))
    return float(SAMPLING * pixel**2 / fwhm)


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
