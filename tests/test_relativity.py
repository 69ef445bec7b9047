# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The functions of ``examples/relativity.py``: errors of flows and two-sided jets."""

import doctest
import importlib.util
import sys
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

PATH = Path(__file__).parents[1] / "examples" / "relativity.py"
spec = importlib.util.spec_from_file_location("relativity", PATH)
relativity = importlib.util.module_from_spec(spec)
spec.loader.exec_module(relativity)
intrinsic_table, two_sided_jet = relativity.intrinsic_table, relativity.two_sided_jet

DAY = u.mas / u.day


def test_its_examples(monkeypatch):
    monkeypatch.setitem(sys.modules, "relativity", relativity)
    assert doctest.testmod(relativity).failed == 0


@settings(max_examples=20)
@given(beta=st.floats(0.1, 0.999), theta=st.floats(1, 89))
def test_two_sided_jet_there_and_back(beta, theta):
    t, d = np.radians(theta), 10 * u.kpc
    cos = beta * np.cos(t)
    rate = (beta * np.sin(t) / d.to_value(u.m) * 299792458) * u.rad / u.s
    motions = rate / (1 - cos), rate / (1 + cos)
    found = two_sided_jet(*motions, d, n_trials=2)
    assert found["beta"][0] == pytest.approx(beta, rel=1e-9)
    assert found["angle"][0].to_value(u.deg) == pytest.approx(theta, rel=1e-9)
    assert found["beta_cos"][0] == pytest.approx(cos, rel=1e-9)
    at = two_sided_jet(*motions, found["beta_max_distance"], n_trials=2)
    assert at["beta"][0] == pytest.approx(1)


@pytest.mark.parametrize("speed", [-1.0, np.nan])
def test_speeds_and_motions_that_are_refused(speed):
    with pytest.raises(ValueError, match="finite and not negative"):
        intrinsic_table([speed], [0.1])
    with pytest.raises(ValueError, match="receding motion must be positive"):
        two_sided_jet(17.6 * DAY, 18 * speed * DAY, 1 * u.kpc)
