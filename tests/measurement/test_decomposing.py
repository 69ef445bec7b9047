# Licensed under a 3-clause BSD style license - see LICENSE.rst
import numpy as np
import pytest

from astro_scc.decomposition import Decomposer
from astro_scc.measurement.decomposing import LazyDecompositions, decompose_epochs
from astro_scc.simulation import simulate_static


@pytest.mark.parametrize("noise", ["plane", "propagated"])
def test_lazy_decompositions_are_those_of_the_epochs(noise):
    cube = simulate_static(n_epochs=3, rng=1).cube
    decomposer = Decomposer(scales=[1, 2], noise=noise)
    lazy = LazyDecompositions(cube, decomposer)
    whole = decompose_epochs(cube, decomposer)
    assert len(lazy) == 3
    assert lazy.scales == (1.0, 2.0)
    for one, other in zip(lazy, whole, strict=True):
        np.testing.assert_array_equal(one.planes, other.planes)
        np.testing.assert_array_equal(one.ssps.y, other.ssps.y)


def test_lazy_decompositions_are_made_once_and_when_asked_for(monkeypatch):
    cube = simulate_static(n_epochs=3, rng=1).cube
    lazy = LazyDecompositions(cube, Decomposer(scales=[1]))
    made = []
    call = Decomposer.__call__
    monkeypatch.setattr(
        Decomposer, "__call__", lambda *a, **k: made.append(1) or call(*a, **k)
    )
    assert lazy[-1] is lazy[2]
    assert len(made) == 1
    assert lazy[1:] == (lazy[1], lazy[2])
    assert len(made) == 2
    with pytest.raises(IndexError):
        lazy[3]
