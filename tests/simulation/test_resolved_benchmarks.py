# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the benchmarks of resolved jets and of the level simulate."""

import importlib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

FOLDER = Path(__file__).parents[2] / "benchmarks"
if not FOLDER.exists():
    pytest.skip("the benchmarks are not part of this copy", allow_module_level=True)


@pytest.fixture
def script(monkeypatch):
    """Import a script by its name."""
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module


def test_movies_in_true_and_in_scrambled_order(script):
    resolved = script("resolved")
    jet = resolved.simulate("two", "11x21d", 1)
    slow, fast = resolved.true_speeds(jet)
    assert slow == pytest.approx(0.3 / 0.264)
    assert 5 < fast < 9
    cube = resolved.scrambled(jet, 1)
    assert_array_equal(cube.times.mjd, jet.cube.times.mjd)
    old, new = (c.data.reshape(11, -1) for c in (jet.cube, cube))
    order = [int(np.flatnonzero((old == image).all(axis=1))[0]) for image in new]
    assert sorted(order) == list(range(11)) != order
    assert cube.beams == jet.cube.beams
    assert_allclose(cube.noise, jet.cube.noise)
    assert resolved.true_speeds(resolved.simulate("static", "11x21d", 1)) == []


def test_static_series_of_each_kind(script):
    level = script("level")
    for kind in level.KINDS:
        cube = level.static_cube(kind, 1, n_epochs=3)
        assert len(cube) == 3
        again = level.static_cube(kind, np.random.default_rng(1), n_epochs=3)
        assert_array_equal(cube.data, again.data)
