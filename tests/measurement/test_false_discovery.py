# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Adjusted probabilities against the definition, and what they promise."""

import numpy as np
import pytest
from astropy.table import QTable
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.measurement import false_discovery_rate
from astro_scc.measurement.tables import component_table


def table(p, **columns):
    return QTable({"p_global": np.array(p, dtype=float), **columns})


def by_definition(p, method):
    """The smallest rate at which the procedure would accept each of them."""
    p = np.asarray(p)
    m = len(p)
    factor = m * (sum(1 / k for k in range(1, m + 1)) if method == "by" else 1.0)
    adjusted = []
    for own in p:
        candidates = [
            factor * other / np.sum(p <= other) for other in p if other >= own
        ]
        adjusted.append(min(1.0, *candidates, np.inf))
    return adjusted


probabilities = st.lists(
    st.integers(1, 40).map(lambda b: b / 40), min_size=1, max_size=9
)


@settings(max_examples=60, deadline=None)
@given(groups=st.lists(probabilities, min_size=1, max_size=4), by=st.booleans())
def test_is_the_procedure_over_all_tables_together(groups, by):
    method = "by" if by else "bh"
    done = false_discovery_rate([table(p) for p in groups], method=method)
    got = np.concatenate([t["p_fdr"] for t in done])
    p = np.concatenate(groups)
    np.testing.assert_allclose(got, by_definition(p, method), rtol=1e-12)
    assert np.all((got >= p - 1e-12) & (got <= 1))


def test_empty_tables_keep_the_column_and_count_as_searched():
    alone = false_discovery_rate([table([0.01])])
    many = false_discovery_rate([table([0.01]), *[component_table([])] * 19])
    assert alone[0]["p_fdr"][0] == pytest.approx(0.01)
    assert many[0]["p_fdr"][0] == pytest.approx(0.2)
    assert many[0].meta["false_discovery"] == {"method": "bh", "n_tests": 20}
    empty = many[1]
    assert len(empty) == 0
    assert empty["p_fdr"].dtype == float
    names = component_table([]).colnames
    place = names.index("p_global_err") + 1
    assert empty.colnames == [*names[:place], "p_fdr", *names[place:]]
    assert empty["p_fdr"].info.description
    assert false_discovery_rate([]) == []


def test_what_stands_still_is_not_tested():
    both = table([0.01, 1.0], kind=["moving", "stationary"])
    still = table([1.0], kind=["stationary"])
    first, second, third = false_discovery_rate([both, still, table([0.02])])
    # Three searches: of 0.01, of nothing, and of 0.02.
    assert first["p_fdr"].tolist() == pytest.approx([0.03, 1.0])
    assert second["p_fdr"].tolist() == [1.0]
    assert third["p_fdr"].tolist() == pytest.approx([0.03])
    assert first.meta["false_discovery"]["n_tests"] == 3


def test_returns_copies_that_can_be_adjusted_again():
    own = table([0.01, 0.2])
    (once,) = false_discovery_rate([own])
    (twice,) = false_discovery_rate([once])
    assert own.colnames == ["p_global"]
    assert once.colnames == twice.colnames == ["p_global", "p_fdr"]
    np.testing.assert_array_equal(once["p_fdr"], twice["p_fdr"])


def test_a_mapping_keeps_its_names():
    done = false_discovery_rate({"inner": table([0.01]), "outer": table([])})
    assert list(done) == ["inner", "outer"]
    assert done["inner"]["p_fdr"][0] == pytest.approx(0.02)


def test_says_what_is_wrong():
    with pytest.raises(TypeError, match=r"got one: give \[table\]"):
        false_discovery_rate(table([0.1]))
    with pytest.raises(ValueError, match="table 1 has no column p_global"):
        false_discovery_rate([table([0.1]), QTable()])
    with pytest.raises(ValueError, match="table 'inner': p_global must be from 0 to 1"):
        false_discovery_rate({"inner": table([np.nan])})
    with pytest.raises(ValueError, match="unknown method 'bonferroni': use 'bh' or"):
        false_discovery_rate([], method="bonferroni")
