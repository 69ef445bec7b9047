# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which velocities are common to many features: the step-down search."""

from dataclasses import dataclass, field, replace

import numpy as np

from astro_scc.stacking.contrast import Contrast
from astro_scc.stacking.displacements import Displacements
from astro_scc.stacking.features import count_features
from astro_scc.stacking.nulls import NULLS, REST, Scene
from astro_scc.stacking.sightings import Sightings
from astro_scc.stacking.witnesses import find_witnesses

__all__ = ["Finding", "find_velocities"]

#: SSPs with a sighting this close to a component are explained by it.
EXPLAINED = 1.5
#: Velocities closer to a component than this are not told from it, in the
#: same unit: half a beam an interval with the default kernel.
RESOLVED = 2.5
#: Fewest features whose velocity is a common one: of the handful that a
#: sparse jet has, three or four often agree by chance.
FEWEST_FEATURES = 5
#: Fewer features than these, the scramble moves as one.
FEW_FEATURES = 3
#: Fewest witnesses that can be searched.
FEWEST = 3


@dataclass(frozen=True, eq=False)
class Finding:
    """
    A velocity that was tested.

    Attributes
    ----------
    v1, v2 : float
        Velocity of the largest contrast, on the grid of the search.
    kind : {"moving", "stationary", "uncertain"}
        Whether it is a component that moves, one at rest within its
        errors, or none that is significant.
    p_local, p_global : float
        Largest of the null hypotheses; of a stationary component that of
        the scramble, as no order of the epochs tells what stands still.
    p_error : float
        Monte Carlo standard error of ``p_global``.
    tests : dict of `~astro_scc.stacking.NullTest`
        By the name of the null hypothesis.
    n_witnesses : int
        Witnesses within 1.5 standard errors.
    n_features : int
        Different features that they are at least; what moves with fewer
        than five is uncertain, with a probability of one.
    everything : `~astro_scc.stacking.Displacements`
        All that was searched.
    left : `~numpy.ndarray` of bool, shape (len(everything),)
        The matches that earlier findings had left to be explained.
    group : `~numpy.ndarray` of int, shape (len(displacements),)
        The witness of each match that was left, -1 if it has none.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
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
    >>> found = find_velocities(d, pairs, years, (9.0, 9.0), n_trials=99, rng=rng)[0]
    >>> found.kind, round(found.v1), sorted(found.tests)
    ('moving', 3, ['scramble', 'shuffle'])
    """

    v1: float
    v2: float
    kind: str
    p_local: float
    p_global: float
    p_error: float
    tests: dict
    n_witnesses: int
    n_features: int
    everything: Displacements = field(repr=False)
    left: np.ndarray = field(repr=False)
    group: np.ndarray = field(repr=False)

    @property
    def displacements(self):
        """What earlier findings had left to be explained, a copy."""
        return self.everything.select(self.left)


def find_velocities(
    displacements,
    pairs,
    years,
    v_max,
    *,
    n_trials=1000,
    level=0.05,
    rng,
    nulls=NULLS,
    max_components=8,
    progress=None,
):
    """
    Search for velocities that many features share, strongest first.

    Sightings are grouped into witnesses, the velocity with the largest
    contrast is tested against every null hypothesis, and if it passes all
    SSPs that it explains are taken away and the search starts again, at
    velocities more than 2.5 standard errors from those found; it ends with
    the first velocity of three features or more that the scramble cannot
    reject.  The
    probability is that of the strongest of what is left, so later steps
    hold given that the earlier ones are right.

    Parameters
    ----------
    displacements : `~astro_scc.stacking.Displacements`
        With ``position`` and ``motion``.
    pairs : `~astro_scc.stacking.DatePairs`
    years : array_like, shape (n_dates,)
        Dates in years.
    v_max : tuple of float
        Largest velocities along the two axes.
    n_trials : int, optional
    level : float, optional
        Largest ``p_global`` of a component.
    rng : `~numpy.random.Generator`
    nulls : sequence, optional
        Null hypotheses with a ``name`` and a method ``test``.
    max_components : int, optional
        The search ends after so many steps.
    progress : callable, optional
        Called with 1 after each step.

    Returns
    -------
    list of `Finding`
        In the order they were found.  The last one may be uncertain, and
        so may others be before it.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
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
    >>> findings = find_velocities(d, pairs, years, (9.0, 9.0), n_trials=99, rng=rng)
    >>> findings[0].kind, round(findings[0].v1), findings[0].p_global
    ('moving', 3, 0.01)
    """
    limits = _widened(displacements, v_max, pairs)
    everything = Sightings.of(displacements, pairs, years, limits)
    left = np.ones(len(displacements), dtype=bool)
    # Places are in the sightings: copies of what is left need them no more.
    placeless = replace(displacements, position=None, motion=None)
    findings, taken = [], []
    for step_rng in rng.spawn(max_components):
        seen = everything.select(left[everything.match])
        scene = _scene(placeless.select(left), pairs, seen, v_max, taken)
        if scene is None:
            break
        group = np.full(len(displacements), -1)
        group[seen.match] = scene.witnesses.group
        finding = Finding(
            **_judged(scene, seen, nulls, n_trials, level, step_rng),
            everything=displacements,
            left=left.copy(),
            group=group[left],
        )
        findings.append(finding)
        if progress is not None:
            progress(1)
        if _rejected(finding, level):
            break
        taken.append(scene.velocity)
        near = everything.near(*scene.velocity, EXPLAINED)
        left &= ~np.isin(displacements.ssp, everything.ssp[near])
    return _without_rest(findings)


def _without_rest(findings):
    """Up to the last component, and the first one after it that is none."""
    last = max((i for i, f in enumerate(findings) if f.kind != "uncertain"), default=-1)
    return findings[: last + 2]


def _rejected(finding, level):
    """
    Whether the search ends.

    A velocity that only the shuffle rejects is no component, but what it
    explains may hide one; and so may what one or two features do, as the
    scramble moves them whole: in every trial they are the strongest again.
    """
    if finding.n_features < FEW_FEATURES:
        return False
    first = finding.tests.get("scramble")
    return (finding.p_global if first is None else first.p_global) > level


def _widened(displacements, v_max, pairs):
    """Limits beyond which a sighting touches no searched velocity."""
    if len(displacements) == 0 or len(pairs) == 0:
        return v_max
    shortest = pairs.interval.min()
    return (
        v_max[0] + 10 * displacements.s1.max() / shortest,
        v_max[1] + 10 * displacements.s2.max() / shortest,
    )


def _scene(displacements, pairs, sightings, v_max, taken):
    witnesses = find_witnesses(sightings)
    if len(witnesses) < FEWEST:
        return None
    contrast = Contrast.of(witnesses, v_max)
    observed = contrast.maps(
        witnesses.v1[None], witnesses.v2[None], witnesses.weight, range(4)
    )[:, 0]
    grid = contrast.grid
    s1, s2 = np.median(witnesses.s1), np.median(witnesses.s2)
    free = np.ones(grid.shape, dtype=bool)
    for v1, v2 in taken:
        away = np.hypot((grid.v1 - v1) / s1, (grid.v2[:, None] - v2) / s2)
        free &= away > RESOLVED
    if not free.any():
        return None
    least = np.where(free, observed.min(axis=0), -np.inf)
    row, column = np.unravel_index(least.argmax(), least.shape)
    return Scene(
        displacements=displacements,
        pairs=pairs,
        witnesses=witnesses,
        contrast=contrast,
        observed=observed,
        row=int(row),
        column=int(column),
        free=free,
    )


def _judged(scene, seen, nulls, n_trials, level, rng):
    """What a finding says of the strongest velocity of a scene."""
    v1, v2 = scene.velocity
    w = scene.witnesses
    n_features = count_features(seen, w.group, seen.near(v1, v2, EXPLAINED))
    tests = {
        null.name: null.test(scene, n_trials, own)
        for null, own in zip(nulls, rng.spawn(len(nulls)), strict=True)
    }
    still = np.hypot(v1 / np.median(w.s1), v2 / np.median(w.s2)) <= REST
    stood = [t for name, t in tests.items() if name == "scramble"]
    everything = list(tests.values())
    if max(t.p_global for t in everything) <= level:
        kind, counted = "moving", everything
    elif still and stood and stood[0].p_global <= level:
        # No order of the epochs tells what stands still.
        kind, counted = "stationary", stood
    else:
        kind, counted = "uncertain", everything
    worst = max(counted, key=lambda t: t.p_global)
    p_local, p_global, error = (
        max(t.p_local for t in counted),
        worst.p_global,
        worst.error,
    )
    if kind == "moving" and n_features < FEWEST_FEATURES:
        # What one feature does at many dates says nothing of others.
        kind, p_local, p_global, error = "uncertain", 1.0, 1.0, 0.0
    near = np.hypot((w.v1 - v1) / w.s1, (w.v2 - v2) / w.s2) <= EXPLAINED
    return {
        "v1": float(v1),
        "v2": float(v2),
        "kind": kind,
        "p_local": p_local,
        "p_global": p_global,
        "p_error": error,
        "tests": tests,
        "n_witnesses": int(near.sum()),
        "n_features": n_features,
    }
