# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The rule by which the comparison with other packages reads speeds."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

PATH = Path(__file__).parents[1] / "benchmarks" / "comparison_reading.py"
if not PATH.exists():
    pytest.skip("the benchmarks are not part of this copy", allow_module_level=True)
SPEC = importlib.util.spec_from_file_location("comparison_reading", PATH)
reading = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(reading)


def speeds_of(along, pair=None, across=0.0):
    along = np.asarray(along, dtype=float)
    pair = np.arange(len(along)) % 9 if pair is None else np.asarray(pair)
    here = np.zeros(len(along))
    return reading.read_speeds(reading.Sample(pair, here, here, along, here + across))


@pytest.mark.parametrize("speeds", [(5,), (2, 7, 12), (-8, 0, 25)])
def test_all_speeds_of_a_sample_are_read(speeds):
    rng = np.random.default_rng(1)
    v = np.concatenate([rng.normal(speed, 1, 90) for speed in speeds])
    np.testing.assert_allclose(speeds_of(v), speeds, atol=0.5)
