# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import beta

from astro_scc.measurement.tables import build_table
from astro_scc.recovery.completeness import epochs_needed, share, smallest_p


@pytest.mark.parametrize(
    ("n_epochs", "p"), [(2, 1.0), (3, 1 / 3), (4, 1 / 12), (5, 1 / 60), (400, 0.0)]
)
def test_the_smallest_p_is_that_of_the_permutations(n_epochs, p):
    assert smallest_p(n_epochs) == pytest.approx(p, abs=1e-12)


@given(level=st.floats(1e-9, 0.9))
def test_as_many_epochs_as_a_level_needs(level):
    n = epochs_needed(level)
    assert smallest_p(n) <= level
    assert n == 2 or smallest_p(n - 1) > level


@given(of=st.integers(1, 200), part=st.floats(0, 1))
def test_intervals_are_those_of_jeffreys(of, part):
    number = round(part * of)
    fraction, low, high = share(number, of)
    assert fraction == number / of
    assert 0 <= low <= fraction <= high <= 1
    own = beta(number + 0.5, of - number + 0.5)
    if 0 < number < of:
        np.testing.assert_allclose([low, high], own.ppf([0.025, 0.975]))


def test_what_is_not_known_is_masked():
    rows = [{"known": 1.0, "v": None, "n": 1}, {"known": 2.0, "v": 2.0, "n": None}]
    columns = {"known": (u.mas, "a"), "v": (u.mas, "b"), "n": (None, "c")}
    table = build_table(rows, columns)
    assert isinstance(table["known"], u.Quantity)
    assert not hasattr(table["known"], "mask")
    assert table["v"].mask.tolist() == [True, False]
    assert table["v"].unit == u.mas
    assert table["n"].mask.tolist() == [False, True]
    assert table["n"].info.description == "c"
