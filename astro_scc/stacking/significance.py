# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which velocities are common to many features: the step-down search."""

from dataclasses import dataclass, field

import numpy as np

from astro_scc.stacking.contrast import Contrast
from astro_scc.stacking.nulls import NULLS, REST, NullTest, Scene
from astro_scc.stacking.sightings import Sightings
from astro_scc.stacking.witnesses import find_witnesses

__all__ = ["Finding", "find_velocities"]

#: SSPs with a sighting this close to a component are explained by it.
EXPLAINED = 1.5
#: Fewest witnesses that can be searched.
FEWEST = 3


@dataclass(frozen=True)
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
        Largest of the null hypotheses.
    p_error : float
        Monte Carlo standard error of ``p_global``.
    tests : dict of `~astro_scc.stacking.NullTest`
        By the name of the null hypothesis.
    n_witnesses : int
        Witnesses within 1.5 standard errors.
    """

    v1: float
    v2: float
    kind: str
    p_local: float
    p_global: float
    p_error: float
    tests: dict = field(default_factory=dict)
    n_witnesses: int = 0


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
    SSPs that it explains are taken away and the search starts again; it
    ends with the first velocity that the scramble cannot reject.  The
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
        In the order they were found; the last ones may be uncertain.
    """
    everything = Sightings.of(
        displacements, pairs, years, _widened(displacements, v_max, pairs)
    )
    alive = np.ones(len(everything), dtype=bool)
    rest = displacements
    findings = []
    for step_rng in rng.spawn(max_components):
        scene = _scene(rest, pairs, everything.select(alive), v_max)
        if scene is None:
            break
        finding = _test(scene, nulls, n_trials, level, step_rng)
        findings.append(finding)
        if progress is not None:
            progress(1)
        scramble = finding.tests.get("scramble")
        if (scramble.p_global if scramble else finding.p_global) > level:
            break
        near = everything.near(*scene.velocity, EXPLAINED)
        gone = np.unique(everything.ssp[near])
        alive &= ~np.isin(everything.ssp, gone)
        rest = rest.select(~np.isin(rest.ssp, gone))
    return findings


def _widened(displacements, v_max, pairs):
    """Limits beyond which a sighting touches no searched velocity."""
    if len(displacements) == 0:
        return v_max
    shortest = pairs.interval.min()
    return (
        v_max[0] + 10 * displacements.s1.max() / shortest,
        v_max[1] + 10 * displacements.s2.max() / shortest,
    )


def _scene(displacements, pairs, sightings, v_max):
    witnesses = find_witnesses(sightings)
    if len(witnesses) < FEWEST:
        return None
    contrast = Contrast.of(witnesses, v_max)
    observed = contrast.maps(
        witnesses.v1[None], witnesses.v2[None], witnesses.weight, range(4)
    )[:, 0]
    row, column = np.unravel_index(observed.min(axis=0).argmax(), observed.shape[1:])
    return Scene(
        displacements, pairs, witnesses, contrast, observed, int(row), int(column)
    )


def _test(scene, nulls, n_trials, level, rng):
    v1, v2 = scene.velocity
    w = scene.witnesses
    still = np.hypot(v1 / np.median(w.s1), v2 / np.median(w.s2)) <= REST
    tests: dict[str, NullTest] = {}
    for null, own in zip(nulls, rng.spawn(len(nulls)), strict=True):
        # No order of the epochs tells what stands still.
        if still and null.name != "scramble":
            continue
        tests[null.name] = null.test(scene, n_trials, own)
    worst = max(tests.values(), key=lambda t: t.p_global)
    kind = "stationary" if still else "moving"
    near = np.hypot((w.v1 - v1) / w.s1, (w.v2 - v2) / w.s2) <= EXPLAINED
    return Finding(
        v1=float(v1),
        v2=float(v2),
        kind=kind if worst.p_global <= level else "uncertain",
        p_local=max(t.p_local for t in tests.values()),
        p_global=worst.p_global,
        p_error=worst.error,
        tests=tests,
        n_witnesses=int(near.sum()),
    )
