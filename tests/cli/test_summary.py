# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Results as lines of text."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Column, vstack

from astro_scc.cli.summary import component_lines, plus_minus


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
    speed = plus_minus(radial[0], "pm")
    assert lines[:2] == [f"Significant motion: {speed} mas / yr.", ""]
    head = lines[2].replace(" (mas / yr)", "").replace("proper ", "")
    names = head.replace(" (deg)", "").replace("z score", "z").split()
    assert names == ["component", "kind", "motion", "PA", "dispersion", "p_global", "z",
                     "features"]  # fmt: skip
    moving, still = lines[3].split(), lines[5].split()
    # "5.7 +- 0.2" is three words.
    assert moving[:2] == ["1", "moving"]
    assert moving[3] == "+-"
    spread = radial["dispersion"][0].value
    number = str(radial["n_features"][0])
    assert moving[5:] == ["-", f"{spread:.2g}", "0.00099", moving[8], number]
    assert still[1] == "stationary"
    assert still[5:8] == ["-", "-", "-"]
    assert lines[7].startswith("p_global: probability that epochs in permuted order")
    number = radial["component"][0]
    assert lines[9:] == [
        f"{number} is not significant: permuted", f"{number} is not significant: blends"
    ]  # fmt: skip


def test_summary_of_chance(radial):
    table = radial[1:2].copy()
    lines = component_lines(table)
    speed = plus_minus(table[0], "pm")
    p = f"{table['p_global'][0]:.2g}"
    assert lines[0] == (
        f"No significant motion was found: {speed} mas / yr, the strongest, has "
        f"p_global {p}."
    )
    table["kind"] = "stationary"
    assert component_lines(table)[0] == (
        "No significant motion was found: all features are stationary within their "
        "errors."
    )
    table["kind"] = "not significant"
    assert lines[-1].endswith(" is not significant: permuted")
    nothing = component_lines(table[:0])
    assert nothing[0].startswith("No pattern has a match in another epoch")


def test_choices_that_change_the_speed_follow_the_answer(jet_results):
    result = jet_results["radial"]
    table = result.sensitivity.copy()
    lines = component_lines(result.components, sensitivity=table)
    assert lines == component_lines(result.components)
    table["significant"][1] = True
    lines = component_lines(result.components, sensitivity=table)
    speed = plus_minus(table[1], "pm")
    assert lines[1:3] == [
        f"The main speed changes by more than its error: {speed} mas / yr "
        f"({table['choice'][1]}).",
        "",
    ]


def test_few_features_are_shown_with_their_speeds(jet_results):
    result = jet_results["radial"]
    table = result.components[:1].copy()
    lines = component_lines(table, result.features)
    assert not any(line.startswith("feature of") for line in lines)
    table["n_features"] = 4
    own = result.features[result.features["component"] == 1]
    lines = component_lines(table, own)
    (head,) = (k for k, line in enumerate(lines) if line.startswith("feature of"))
    assert lines[head + 1].endswith(plus_minus(own[0], "pm"))
    assert lines[head + len(own) + 1] == ""


def test_fast_motion_has_a_unit_that_can_be_read(radial):
    table = radial[:1].copy()
    table["pm"], table["pm_err"] = [50_000] * u.mas / u.yr, [300] * u.mas / u.yr
    head, line = component_lines(table)[2:4]
    assert "proper motion (arcsec / yr)" in head
    assert "50.00 +- 0.30" in line
