# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""How far a velocity stands out from its surroundings, among witnesses."""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from astro_scc.stacking.grid import VelocityGrid

__all__ = ["DIRECTIONS", "Contrast"]

#: Directions in the plane of velocities, in units of the standard errors.
DIRECTIONS = np.array([[1, 0], [0, 1], [0.5**0.5, 0.5**0.5], [0.5**0.5, -(0.5**0.5)]])
#: Distances of the background along a direction, in standard errors.
BACKGROUND = np.array([3.0, 4.0, 5.0])
#: Reach of the filters in standard errors: the background and its tails.
FILTER_REACH = BACKGROUND.max() + 3.5
#: Standard errors are rounded to powers of this ratio...
CLASS_RATIO = 2.0
#: ...and raised to, or left out beyond, these multiples of their median.
NARROWEST, WIDEST = 0.5, 2.8
#: Spacing of the grid in the smallest standard error.
STEP = 0.75
#: Largest number of velocities on an axis.
MAX_SIZE = 401
#: Bytes that are worked on at once.
CACHED = 2**20


@dataclass(frozen=True, eq=False, repr=False)
class Contrast:
    """
    The contrast of velocities, for one set of witnesses and any shift of it.

    With ``C(v) = sum W g(v - V)`` the sum of Gaussians of unit area at the
    witnesses' velocities and ``B_u`` its mean at 3, 4 and 5 standard errors
    to both sides along a direction u, the contrast is ``T_u = C - B_u``.
    Along a ridge of C it is nought.  Unit area makes a Gaussian plus a flat
    background the model of which C is the score: witnesses of long
    intervals, which are sharp, count more.

    Attributes
    ----------
    grid : `~astro_scc.stacking.VelocityGrid`
        The velocities searched.
    kind : `~numpy.ndarray` of int, shape (n_witnesses,)
        Class of standard errors that each witness belongs to, or -1 for
        those too wide to tell velocities apart.
    s1, s2 : `~numpy.ndarray`, shape (n_classes,)
        Standard errors of the classes along the two axes.
    shape : tuple of int
        Of the padded grid.
    response : `~numpy.ndarray`, shape (n_classes, 4, ny, nx)
        Fourier transforms of the filters, one a direction.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Contrast, find_witnesses
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import Sightings
    >>> rng = np.random.default_rng(1)
    >>> years, n, one = np.array([0.0, 1.0, 2.0]), 40, np.ones(40)
    >>> first = np.repeat([0, 1], 20)
    >>> d = Displacements(
    ...     d1=3 + rng.normal(0, 0.2, n), d2=rng.normal(0, 0.2, n), s1=0.3 * one,
    ...     s2=0.3 * one, weight=0.8 * one, reference=first, target=first + 1,
    ...     ssp=np.arange(n), target_ssp=np.full(n, -1), n_ssps=np.full(3, 20),
    ...     position=rng.uniform(0, 50, (n, 2)), motion=np.tile([3.0, 0.0], (n, 1)))
    >>> pairs = consecutive_pairs(years)
    >>> seen = Sightings.of(d, pairs, years, (9.0, 9.0))
    >>> witnesses = find_witnesses(seen)
    >>> contrast = Contrast.of(witnesses, (9.0, 9.0))
    >>> maps = contrast.maps(
    ...     witnesses.v1[None], witnesses.v2[None], witnesses.weight, range(4))
    >>> least = maps[:, 0].min(axis=0)
    >>> row, column = np.unravel_index(least.argmax(), least.shape)
    >>> bool(abs(contrast.grid.v1[column] - 3) < 0.3)
    True
    """

    grid: VelocityGrid
    kind: np.ndarray
    s1: np.ndarray
    s2: np.ndarray
    shape: tuple
    response: np.ndarray

    @classmethod
    def of(cls, witnesses, v_max):
        """
        Prepare the filters.

        Parameters
        ----------
        witnesses : `~astro_scc.stacking.Witnesses`
            At least one.
        v_max : tuple of float
            Largest velocities to search along the two axes.

        Returns
        -------
        `Contrast`
        """
        kind, s1, s2 = _classes(witnesses.s1, witnesses.s2)
        grid = VelocityGrid.covering(
            v_max, (STEP * s1.min(), STEP * s2.min()), max_size=MAX_SIZE
        )
        step1, step2 = grid.step
        # The convolution is circular: the margin keeps the ends apart.
        margin = 2 * FILTER_REACH * np.array([s2.max() / step2, s1.max() / step1])
        shape = tuple(
            fft.next_fast_len(n + int(np.ceil(m)), real=True)
            for n, m in zip(grid.shape, margin, strict=True)
        )
        k2 = np.fft.fftfreq(shape[0], step2)[:, None]
        k1 = np.fft.rfftfreq(shape[1], step1)[None, :]
        response = [
            [
                gauss * (1 - _shifted_mean(e1 * a * k1 + e2 * b * k2))
                for e1, e2 in DIRECTIONS
            ]
            for a, b in zip(s1, s2, strict=True)
            for gauss in [np.exp(-2 * np.pi**2 * ((a * k1) ** 2 + (b * k2) ** 2))]
        ]
        return cls(grid, kind, s1, s2, shape, np.array(response))

    def maps(self, v1, v2, weight, directions):
        """
        Contrast maps for witnesses at given velocities.

        Parameters
        ----------
        v1, v2 : `~numpy.ndarray`, shape (n_trials, n_witnesses)
        weight : `~numpy.ndarray`, shape (n_witnesses,)
        directions : sequence of int
            Indices of `DIRECTIONS`.

        Returns
        -------
        `~numpy.ndarray`, shape (n_directions, n_trials, n2, n1)
        """
        use = self.kind >= 0
        v1, v2, kind = v1[:, use], v2[:, use], self.kind[use]
        weight = weight[use]
        n_trials, (n2, n1) = len(v1), self.grid.shape
        result = np.empty((len(directions), n_trials, n2, n1))
        size = self._trials_at_once(v1.shape[1])
        for start in range(0, n_trials, size):
            part = slice(start, start + size)
            transform = self._transform(v1[part], v2[part], weight, kind)
            for place, u in enumerate(directions):
                if len(self.s1) == 1:
                    product = transform[:, 0] * self.response[0, u]
                else:
                    product = np.einsum("tcij,cij->tij", transform, self.response[:, u])
                result[place, part] = self._on_grid(product)
        return result

    def _trials_at_once(self, n_witnesses):
        """So many that what is worked on stays in the processor's cache."""
        numbers = max(8 * n_witnesses, len(self.s1) * self.shape[0] * self.shape[1])
        return max(1, CACHED // (8 * numbers))

    @property
    def _margin(self):
        """Rows and columns of the padded grid before the velocities searched."""
        return [(p - n) // 2 for p, n in zip(self.shape, self.grid.shape, strict=True)]

    def _on_grid(self, product):
        """Back from Fourier space, without the margins."""
        (m2, m1), (n2, n1) = self._margin, self.grid.shape
        rows = fft.ifft(product, axis=-2)[:, m2 : m2 + n2]
        return fft.irfft(rows, self.shape[1], axis=-1)[:, :, m1 : m1 + n1]

    def _transform(self, v1, v2, weight, kind):
        """Transforms of the weights on the padded grid, one a class."""
        n2, n1 = self.shape
        m2, m1 = self._margin
        step1, step2 = self.grid.step
        x = (v1 - (self.grid.v1[0] - m1 * step1)) / step1
        y = (v2 - (self.grid.v2[0] - m2 * step2)) / step2
        # Beyond the margin nothing is in reach of the grid; it would come in
        # again on the other side.
        weight = weight * ((x >= 0) & (x < n1 - 1) & (y >= 0) & (y < n2 - 1))
        np.clip(x, 0, n1 - 2, out=x)
        np.clip(y, 0, n2 - 2, out=y)
        i, j = x.astype(np.intp), y.astype(np.intp)
        x -= i
        y -= j
        j += (np.arange(len(v1))[:, None] * len(self.s1) + kind) * n2
        j *= n1
        j += i
        # Linear weights to four neighbours.
        upper = weight * y
        lower = weight - upper
        corners = np.empty((4, *v1.shape))
        np.multiply(lower, x, out=corners[1])
        np.subtract(lower, corners[1], out=corners[0])
        np.multiply(upper, x, out=corners[3])
        np.subtract(upper, corners[3], out=corners[2])
        places = j + np.array([0, 1, n1, n1 + 1])[:, None, None]
        size = len(v1) * len(self.s1) * n2 * n1
        total = np.bincount(places.ravel(), corners.ravel(), size)
        return fft.rfft2(total.reshape(len(v1), len(self.s1), n2, n1))


def _classes(s1, s2):
    """Round standard errors to few classes of one axis ratio."""
    size = np.sqrt(s1 * s2)
    relative = size / np.median(size)
    power = np.rint(np.log(np.maximum(relative, NARROWEST)) / np.log(CLASS_RATIO))
    classes = np.unique(power[relative <= WIDEST])
    kind = np.where(relative <= WIDEST, np.searchsorted(classes, power), -1)
    width = np.median(size) * CLASS_RATIO**classes
    ratio = np.sqrt(np.median(s1 / s2))
    return kind, width * ratio, width / ratio


def _shifted_mean(phase):
    """Response of the mean of the places on both sides along a direction."""
    return np.mean([np.cos(2 * np.pi * r * phase) for r in BACKGROUND], axis=0)
