# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Null hypotheses: what a velocity component must be told from."""

import math
from dataclasses import dataclass, field

import numpy as np

from astro_scc.stacking.contrast import DIRECTIONS, Contrast
from astro_scc.stacking.displacements import Displacements
from astro_scc.stacking.grid import VelocityGrid
from astro_scc.stacking.orders import (
    AllOrders,
    BlockOrders,
    ReversedBlocks,
    WithoutSuccessors,
)
from astro_scc.stacking.pair_maps import PairMaps
from astro_scc.stacking.pairs import DatePairs
from astro_scc.stacking.witnesses import Witnesses

__all__ = [
    "NULLS",
    "NULL_HYPOTHESES",
    "NullTest",
    "Scene",
    "ScrambleNull",
    "ShuffleNull",
]

#: Witnesses are scrambled by up to this many standard errors.
SCRAMBLE_REACH = 4.0
#: Trials made at once.
BLOCK = 50
#: Stacks whose excess differs by less than this part of the largest tie.
TIE = 1e-6
#: Bytes of shuffled stacks that are made at once.
PART_BYTES = 2**25
#: A test ends early when so many trials have beaten the observation.
ENOUGH = 30
#: Closer to rest than this many standard errors, motion is not told from it.
REST = 0.75


@dataclass(frozen=True, eq=False)
class Scene:
    """
    What is left to be explained at one step of the search.

    Attributes
    ----------
    displacements : `~astro_scc.stacking.Displacements`
    pairs : `~astro_scc.stacking.DatePairs`
    witnesses : `~astro_scc.stacking.Witnesses`
    contrast : `~astro_scc.stacking.Contrast`
    observed : `~numpy.ndarray`, shape (4, n2, n1)
        Contrast of the witnesses, one map a direction.
    row, column : int
        The velocity that is tested, on the grid of ``contrast``.
    free : `~numpy.ndarray` of bool, shape (n2, n1)
        Velocities that are told from those found before.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import NullTest, find_velocities
    >>> rng = np.random.default_rng(1)
    >>> years = np.arange(6.0)
    >>> epoch, feature = (k.ravel() for k in np.indices((5, 20)))
    >>> v = rng.uniform(-6, 6, (20, 2))[feature]
    >>> v[feature < 12] = 3.0, 0.0
    >>> start = rng.uniform(0, 90, (20, 2))[feature]
    >>> moved, one = v + rng.normal(0, 0.1, v.shape), np.ones(100)
    >>> d = Displacements(
    ...     d1=moved[:, 0], d2=moved[:, 1], s1=0.3 * one, s2=0.3 * one, weight=one,
    ...     reference=epoch, target=epoch + 1, ssp=20 * epoch + feature,
    ...     target_ssp=20 * epoch + 20 + feature, n_ssps=np.full(6, 20),
    ...     position=start + v * epoch[:, None], motion=moved)
    >>> pairs = consecutive_pairs(years)
    >>> class Any:
    ...     name = "any"
    ...     def test(self, scene, n_trials, rng):
    ...         p = float(scene.observed[0, scene.row, scene.column] <= 0)
    ...         return NullTest(p, p, n_trials, 0.0)
    >>> found = find_velocities(
    ...     d, pairs, years, (9.0, 9.0), n_trials=9, rng=rng, nulls=(Any(),),
    ...     max_components=1)
    >>> list(found[0].tests)
    ['any']
    """

    displacements: Displacements
    pairs: DatePairs
    witnesses: Witnesses
    contrast: Contrast
    observed: np.ndarray
    row: int
    column: int
    free: np.ndarray

    @property
    def grid(self):
        """The velocities searched."""
        return self.contrast.grid

    @property
    def velocity(self):
        """The velocity that is tested, (v1, v2)."""
        return self.grid.v1[self.column], self.grid.v2[self.row]


@dataclass(frozen=True)
class NullTest:
    """
    The outcome of a test.

    Attributes
    ----------
    p_local : float
        Probability of as much at this velocity.
    p_global : float
        Probability of as much at any velocity.
    n_trials : int
    smallest : float
        Smallest probability that the test can give.
    exhaustive : bool
        Whether the trials were all that there are, so that the probability
        is exact.

    Examples
    --------
    >>> from astro_scc.stacking import NullTest
    >>> test = NullTest(p_local=0.01, p_global=0.04, n_trials=999, smallest=0.001)
    >>> test.p_global >= test.smallest
    True
    """

    p_local: float
    p_global: float
    n_trials: int
    smallest: float
    exhaustive: bool = False

    @property
    def error(self):
        """Monte Carlo standard error of ``p_global``, ``sqrt(p (1 - p) / n)``."""
        p = 0.0 if self.exhaustive else self.p_global
        return math.sqrt(max(p * (1 - p), 0.0) / (self.n_trials + 1))


@dataclass(frozen=True)
class ScrambleNull:
    """
    Features move, but share no speed.

    For each of four directions in the plane of velocities every witness is
    shifted along it by a random amount, up to four standard errors either
    way, which keeps the density of witnesses but for a peak as narrow as
    their errors.  ``p = (b + 1) / (n + 1)``, b the number of trials whose
    largest contrast along that direction is at least the observed one along
    it; the largest of the four is taken, because a ridge is destroyed by
    shifts across it and yet no component.  A test that ``b`` has reached 30 in
    ends (Besag & Clifford 1991, Biometrika 78, 301).

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import ScrambleNull, find_velocities
    >>> rng = np.random.default_rng(1)
    >>> years = np.arange(6.0)
    >>> epoch, feature = (k.ravel() for k in np.indices((5, 20)))
    >>> v = rng.uniform(-6, 6, (20, 2))[feature]
    >>> v[feature < 12] = 3.0, 0.0
    >>> start = rng.uniform(0, 90, (20, 2))[feature]
    >>> moved, one = v + rng.normal(0, 0.1, v.shape), np.ones(100)
    >>> d = Displacements(
    ...     d1=moved[:, 0], d2=moved[:, 1], s1=0.3 * one, s2=0.3 * one, weight=one,
    ...     reference=epoch, target=epoch + 1, ssp=20 * epoch + feature,
    ...     target_ssp=20 * epoch + 20 + feature, n_ssps=np.full(6, 20),
    ...     position=start + v * epoch[:, None], motion=moved)
    >>> pairs = consecutive_pairs(years)
    >>> found = find_velocities(
    ...     d, pairs, years, (9.0, 9.0), n_trials=99, rng=rng, nulls=(ScrambleNull(),))
    >>> found[0].tests["scramble"].p_global
    0.01
    """

    name = "scramble"

    def test(self, scene, n_trials, rng):
        """
        Test a velocity.

        Parameters
        ----------
        scene : `Scene`
        n_trials : int
        rng : `~numpy.random.Generator`

        Returns
        -------
        `NullTest`
        """
        observed = scene.observed[:, scene.row, scene.column]
        tests = [
            self._along(scene, u, observed[u], n_trials, rng)
            for u in range(len(DIRECTIONS))
        ]
        worst = max(tests, key=lambda t: t.p_global)
        return NullTest(
            p_local=max(t.p_local for t in tests),
            p_global=worst.p_global,
            n_trials=worst.n_trials,
            smallest=1 / (n_trials + 1),
        )

    def _along(self, scene, u, observed, n_trials, rng):
        w = scene.witnesses
        above_here = above = done = 0
        while done < n_trials and above < ENOUGH:
            size = min(BLOCK, n_trials - done)
            shift = rng.uniform(-SCRAMBLE_REACH, SCRAMBLE_REACH, (size, len(w)))
            trial = scene.contrast.maps(
                w.v1 + shift * w.s1 * DIRECTIONS[u, 0],
                w.v2 + shift * w.s2 * DIRECTIONS[u, 1],
                w.weight,
                [u],
            )[0]
            largest = trial.max(axis=(1, 2), where=scene.free, initial=-np.inf)
            above += int((largest >= observed).sum())
            above_here += int((trial[:, scene.row, scene.column] >= observed).sum())
            done += size
        return NullTest(
            (above_here + 1) / (done + 1), (above + 1) / (done + 1), done, 0.0
        )


@dataclass(frozen=True)
class ShuffleNull:
    """
    The epochs have no order: nothing moves.

    Some orders of the epochs over the dates, the observed one among them,
    are equally likely.  The statistic is the excess of the stack, of both
    directions of each pair, over its mean in all orders drawn, the observed
    one included; at the velocity, against the largest of each order at
    velocities other than rest.  It is not divided by the spread of the
    orders, which would hand the maximum to velocities at which hardly
    anything matches.  Where there are few orders all are gone through, and
    no probability is below one over their number.

    Parameters
    ----------
    orders : optional
        Which orders are equally likely: `AllOrders`, `BlockOrders`,
        `ReversedBlocks`, or `WithoutSuccessors` for comparison.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import ReversedBlocks, ScrambleNull, ShuffleNull
    >>> from astro_scc.stacking import find_velocities
    >>> rng = np.random.default_rng(1)
    >>> years = np.arange(6.0)
    >>> epoch, feature = (k.ravel() for k in np.indices((5, 20)))
    >>> v = rng.uniform(-6, 6, (20, 2))[feature]
    >>> v[feature < 12] = 3.0, 0.0
    >>> start = rng.uniform(0, 90, (20, 2))[feature]
    >>> moved, one = v + rng.normal(0, 0.1, v.shape), np.ones(100)
    >>> d = Displacements(
    ...     d1=moved[:, 0], d2=moved[:, 1], s1=0.3 * one, s2=0.3 * one, weight=one,
    ...     reference=epoch, target=epoch + 1, ssp=20 * epoch + feature,
    ...     target_ssp=20 * epoch + 20 + feature, n_ssps=np.full(6, 20),
    ...     position=start + v * epoch[:, None], motion=moved)
    >>> pairs = consecutive_pairs(years)
    >>> nulls = ScrambleNull(), ShuffleNull(ReversedBlocks(2))
    >>> found = find_velocities(
    ...     d, pairs, years, (9.0, 9.0), n_trials=99, rng=rng, nulls=nulls)
    >>> list(found[0].tests)
    ['scramble', 'reversal']
    """

    orders: object = field(default_factory=AllOrders)

    @property
    def name(self):
        """Name of the strategy."""
        return self.orders.name

    def test(self, scene, n_trials, rng):
        """
        Test a velocity.

        Parameters
        ----------
        scene : `Scene`
        n_trials : int
        rng : `~numpy.random.Generator`

        Returns
        -------
        `NullTest`
        """
        pairs, grid = scene.pairs, scene.grid
        orders = self.orders.draw(pairs.n_dates, n_trials, rng)
        smallest = max(1 / self.orders.number(pairs.n_dates), 1 / (len(orders) + 1))
        smallest = min(smallest, 1.0)
        if len(scene.displacements) == 0 or len(orders) == 0:
            return NullTest(1.0, 1.0, len(orders), 1.0)
        maps = PairMaps.of(scene.displacements, grid.v_max, pairs.interval.max())
        own = np.arange(pairs.n_dates)[None]
        where = scene.free & ~_at_rest(scene)
        here, largest = _excess(
            maps.both_ways(), scene, np.concatenate([own, orders]), where
        )
        # Orders that differ by a reversal tie, but for rounding.
        observed = here[0] - TIE * np.abs(largest).max()
        above = int((largest[1:] >= observed).sum())
        above_here = int((here[1:] >= observed).sum())
        n = len(orders)
        return NullTest(
            p_local=max((above_here + 1) / (n + 1), smallest),
            p_global=max((above + 1) / (n + 1), smallest),
            n_trials=n,
            smallest=smallest,
            exhaustive=self.orders.exhausts(pairs.n_dates, n_trials),
        )


def _excess(maps, scene, orders, where):
    """
    What the stacks of some orders have more than their mean.

    Returns
    -------
    here : `~numpy.ndarray`, shape (n_orders,)
        At the velocity of the scene.
    largest : `~numpy.ndarray`, shape (n_orders,)
        There or anywhere in ``where``.
    """
    n2, n1 = scene.grid.shape
    # All orders on a part of the grid, so that memory does not grow with them.
    points = max(1, PART_BYTES // (8 * len(orders)))
    rows, columns = max(1, points // n1), min(n1, points)
    here, largest = None, np.full(len(orders), -np.inf)
    for row in range(0, n2, rows):
        for column in range(0, n1, columns):
            part = slice(row, row + rows), slice(column, column + columns)
            grid = VelocityGrid(scene.grid.v1[part[1]], scene.grid.v2[part[0]])
            excess = np.concatenate(list(maps.stacks(scene.pairs, grid, orders)))
            excess -= excess.mean(axis=0)
            inside = where[part]
            if inside.any():
                np.maximum(largest, excess[:, inside].max(axis=1), out=largest)
            i, j = scene.row - row, scene.column - column
            if 0 <= i < grid.shape[0] and 0 <= j < grid.shape[1]:
                here = excess[:, i, j]
    return here, np.maximum(largest, here)


def _at_rest(scene):
    """Grid points that are not told from rest."""
    s1, s2 = np.median(scene.witnesses.s1), np.median(scene.witnesses.s2)
    return (scene.grid.v1 / s1) ** 2 + (scene.grid.v2[:, None] / s2) ** 2 <= REST**2


#: The null hypotheses that a component's ``p_global`` is the largest of.
NULLS = (ScrambleNull(), ShuffleNull())
#: All that there are, by name.
NULL_HYPOTHESES = {
    null.name: null
    for null in (
        *NULLS,
        ShuffleNull(BlockOrders()),
        ShuffleNull(ReversedBlocks()),
        ShuffleNull(WithoutSuccessors()),
    )
}
