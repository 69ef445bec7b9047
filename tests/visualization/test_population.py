# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The figure of the features of many sources."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

from astro_scc.visualization.population import (
    fastest_of,
    plot_population,
    population,
)


@pytest.fixture
def features():
    """Outward, inward, stationary and accelerated ones, and a doubtful one."""
    speed = u.mas / u.yr
    table = QTable({"source": list("aabbb"), "n_epochs": [5, 12, 12, 12, 5]})
    table["secure"] = [True, True, False, True, False]
    table["p_false"] = [0.1, 0.1, 0.2, 0.1, 0.9]
    table["pm"], table["pm_radial"] = (
        [1, 2, 0.1, 3, 9] * speed,
        [1, -2, 0, 3, 9] * speed,
    )
    for name in ("pm_err", "pm_radial_err"):
        table[name] = np.full(5, 0.1) * speed
    for name in ("acc_parallel", "acc_perpendicular"):
        table[name] = [np.nan, np.nan, np.nan, 0.4, 0.4] * speed / u.yr
        table[f"{name}_err"] = np.full(5, 0.1) * speed / u.yr
    table["beta_app"] = 10 * table["pm"].value
    return table


def test_who_is_counted(features):
    found = {name: use.tolist() for name, use in population(features).items()}
    assert found == {
        "moving": [True, True, False, True, False],
        "at rest": [False, False, True, False, False],
        "inward": [False, True, False, False, False],
        "judged": [False, True, False, True, False],
        "accelerated": [False, False, False, True, False],
    }
    assert fastest_of(features).tolist() == [2.0, 3.0]


def test_what_is_drawn(features):
    left, right, *in_c = plot_population(features).axes
    assert sum(patch.get_height() for patch in right.patches) == 2
    # The bars of inward ones are on top of those of the others.
    assert sum(patch.get_height() for patch in left.patches) == 3
    assert [text.get_text() for text in left.get_legend().get_texts()] == [
        "outward",
        "inward",
    ]
    assert len(in_c) == 2
    features["secure"] = False
    with pytest.raises(ValueError, match="no secure feature moves"):
        plot_population(features)
