# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Results as lines of text."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Column, vstack

from astro_scc.cli.summary import component_lines


@pytest.fixture(scope="module")
def radial(jet_results):
    """Components away from a point, which have no direction on the sky."""
    row = jet_results["radial"].components[:1]
    assert row["kind"] == "moving"
    table = vstack([row] * 4, metadata_conflicts="silent")
    table["kind"] = ["moving", "not significant", "stationary", "not significant"]
    table["p_global"] = [0.00099, 0.5, 1.0, 0.3]
    table["dispersion"][2] = np.nan * u.mas / u.yr
    table.replace_column("note", Column(["-", "permuted", "-", "blends"]))
    return table


def test_summary(radial):
    lines = component_lines(radial)
    assert len(lines) == 6
    head = lines[0].replace(" (mas / yr)", "").replace("proper ", "")
    names = head.replace(" (deg)", "").replace("z score", "z").split()
    assert names == ["component", "motion", "PA", "dispersion", "p_global", "z",
                     "features"]  # fmt: skip
    moving, still = lines[1].split(), lines[2].split()
    # "5.7 +- 0.2" is three words.
    assert moving[0] == "1"
    assert moving[2] == "+-"
    spread = radial["dispersion"][0].value
    number = str(radial["n_features"][0])
    assert moving[4:] == ["-", f"{spread:.2g}", "0.00099", moving[7], number]
    assert still[4:7] == ["-", "-", "-"]
    assert lines[2].endswith("stationary")
    assert lines[3].startswith("p_global: probability that epochs in permuted order")
    assert lines[5] == (
        "Not significant: 2 of 4 rows of components.ecsv, permuted; blends"
    )


def test_summary_of_chance(radial):
    table = radial[1:2]
    lines = component_lines(table)
    assert lines[0].startswith("No significant velocity component.")
    assert lines[-1] == "Not significant: 1 of 1 rows of components.ecsv, permuted"
    assert component_lines(table[:0]) == lines[:-1]


def test_fast_motion_has_a_unit_that_can_be_read(radial):
    table = radial[:1].copy()
    table["pm"], table["pm_err"] = [50_000] * u.mas / u.yr, [300] * u.mas / u.yr
    head, line = component_lines(table)[:2]
    assert "proper motion (arcsec / yr)" in head
    assert "50.00 +- 0.30" in line
