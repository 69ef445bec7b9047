# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The grid of velocities on which correlations are stacked."""

from dataclasses import dataclass

import numpy as np

__all__ = ["VelocityGrid"]


@dataclass(frozen=True, eq=False)
class VelocityGrid:
    """
    A regular grid of velocities along two axes, symmetric about zero.

    Attributes
    ----------
    v1, v2 : `~numpy.ndarray`, shapes (n1,) and (n2,)
        Velocities along the first and second axis.  Maps on the grid have
        shape (n2, n1).

    Examples
    --------
    >>> from astro_scc.stacking import VelocityGrid
    >>> grid = VelocityGrid.covering(2.0, 0.5)
    >>> grid.shape, grid.v1.tolist()[:3]
    ((9, 9), [-2.0, -1.5, -1.0])
    """

    v1: np.ndarray
    v2: np.ndarray

    @property
    def shape(self):
        """Shape of a map, (n2, n1)."""
        return len(self.v2), len(self.v1)

    @property
    def step(self):
        """Spacing of the velocities along both axes."""
        return self.v1[1] - self.v1[0], self.v2[1] - self.v2[0]

    @property
    def v_max(self):
        """Largest velocity along both axes."""
        return self.v1[-1], self.v2[-1]

    @classmethod
    def covering(cls, v_max, step, *, max_size=601):
        """
        The grid that reaches a velocity in every direction.

        Parameters
        ----------
        v_max : float or tuple of float
            Largest velocity, of each axis if two.
        step : float or tuple of float
            Largest spacing.
        max_size : int, optional
            Largest number of velocities an axis; the spacing grows if
            there would be more.

        Returns
        -------
        `VelocityGrid`

        Raises
        ------
        ValueError
            If a number is not positive and finite.

        Examples
        --------
        >>> from astro_scc.stacking import VelocityGrid
        >>> VelocityGrid.covering(2.0, 0.3).v1.round(2)
        array([-2.  , -1.71, -1.43, -1.14, -0.86, -0.57, -0.29, 0.  ,
               0.29, 0.57, 0.86, 1.14, 1.43, 1.71, 2.  ])
        """
        v_max = np.broadcast_to(np.asarray(v_max, dtype=float), 2)
        step = np.broadcast_to(np.asarray(step, dtype=float), 2)
        if not (np.all(np.isfinite(v_max)) and np.all(v_max > 0)):
            raise ValueError(f"the largest velocity must be positive, got {v_max}")
        if not (np.all(np.isfinite(step)) and np.all(step > 0)):
            raise ValueError(f"the velocity step must be positive, got {step}")
        half = np.ceil(v_max / step - 1e-9).astype(int)
        half = np.clip(half, 1, max_size // 2)
        return cls(
            *(v * (np.arange(-n, n + 1) / n) for v, n in zip(v_max, half, strict=True))
        )
