# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Results as lines of text."""

import astropy.units as u
import pytest
from astropy.table import vstack

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.cli.summary import component_lines, with_error


def epochs(folder):
    return sorted(folder.glob("*.fits"))


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (12.345, 0.123, "12.35 +- 0.12"),
        (123.4, 12.0, "123 +- 12"),
        (0.5, float("nan"), "0.5 +- ?"),
        (0.5, float("inf"), "0.5 +- ?"),
        (0.5, 0.0, "0.5 +- 0"),
    ],
)
def test_numbers_with_errors(value, error, text):
    assert with_error(value, error) == text


@pytest.fixture(scope="module")
def radial(jet):
    """Components away from a point, which have no direction on the sky."""
    scc = StackedCrossCorrelation(
        scales=[2], max_speed=30 * u.mas / u.yr, position_angle="radial"
    )
    row = scc(EpochCube.read(epochs(jet)), n_trials=20, rng=1).components[:1]
    return vstack([row] * 3, metadata_conflicts="silent")


def test_summary(radial):
    table = radial.copy()
    table["kind"] = ["moving", "stationary", "uncertain"]
    table["p_global"] = [0.00099, 0.01, 0.5]
    lines = component_lines(table)
    assert len(lines) == 6
    assert "0.00099" in lines[1].split()
    assert lines[1].split()[4] == "-"
    assert lines[2].endswith("stationary, no discovery")
    assert lines[3].startswith("p_global: probability of as much at any velocity")
    assert lines[5] == (
        "1 of 3 rows of components.ecsv may be chance (p_global above 0.05)"
    )


def test_summary_of_chance(radial):
    table = radial.copy()
    table["kind"] = "uncertain"
    table.meta["settings"]["level"] = 0.01
    lines = component_lines(table)
    assert lines[0].startswith("No velocity component stands out.")
    assert lines[-1] == (
        "3 of 3 rows of components.ecsv may be chance (p_global above 0.01)"
    )


def test_fast_motion_has_a_unit_that_can_be_read(radial):
    table = radial.copy()
    table["kind"] = "moving"
    for name in ("pm", "pm_err"):
        table[name] = table[name] * 0 + (50_000 if name == "pm" else 300) * u.mas / u.yr
    head, line = component_lines(table)[:2]
    assert "proper motion (arcsec / yr)" in head
    assert "50.00 +- 0.30" in line
