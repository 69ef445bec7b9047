# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Results as lines of text."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Column, vstack

from astro_scc.cli.summary import component_lines, feature_lines
from astro_scc.columns import cell


def plus_minus(row, name):
    return cell(row, name, "+-")


@pytest.fixture(scope="module")
def features(jet_results):
    return jet_results["radial"].features


@pytest.fixture(scope="module")
def radial(jet_results):
    """Components away from a point, which have no direction on the sky."""
    row = jet_results["radial"].components[:1]
    assert row["kind"] == "moving"
    table = vstack([row] * 4, metadata_conflicts="silent")
    table["kind"] = ["moving", "not significant", "stationary", "not significant"]
    table["p_global"] = [0.00099, 0.5, 1.0, 0.3]
    table["dispersion"][2] = np.nan * u.mas / u.yr
    table.replace_column("caution", Column(["-", "permuted", "-", "blends"]))
    return table


def test_summary(radial, features):
    lines = component_lines(radial, features)
    speed = plus_minus(radial[0], "pm")
    n = radial["n_features"][0]
    assert lines[:2] == [f"Motion: {speed} mas/yr outward, {n} features.", ""]
    head = lines[2].replace(" (mas / yr)", "").replace("proper ", "")
    names = head.replace(" (deg)", "").split()
    assert names == ["stream", "kind", "motion", "PA", "dispersion", "p_global",
                     "features"]  # fmt: skip
    moving, still = lines[3].split(), lines[5].split()
    # "5.7 +- 0.2" is three words.
    assert moving[:2] == ["1", "moving"]
    assert moving[3] == "+-"
    spread = radial["dispersion"][0].value
    number = str(radial["n_features"][0])
    assert moving[5:] == ["-", f"{spread:.2g}", "0.00099", number]
    assert still[1] == "stationary"
    assert still[5:8] == ["-", "-", "-"]
    assert lines[7].startswith("p_global: probability that epochs in permuted order")
    number = radial["component"][0]
    assert lines[9:11] == [
        f"Stream {number} (not significant): permuted",
        f"Stream {number} (not significant): blends",
    ]


def test_summary_of_chance(radial, features):
    table = radial[1:2].copy()
    lines = component_lines(table, features)
    p = f"{table['p_global'][0]:.2g}"
    low, high = (table.meta[f"{k}_searched"].value for k in ("slowest", "fastest"))
    assert 0 < low < 2 < 20 < high < 40
    none = f"No motion found between {low:.2g} and {high:.2g} mas/yr:"
    assert lines[0] == f"{none} the strongest peak has p_global {p}."
    assert lines[6] == "Stream 1 (not significant): permuted"
    table["kind"] = "stationary"
    assert component_lines(table, features)[0] == (
        f"{none} all features are stationary within their errors."
    )
    nothing = component_lines(table[:0], features)
    assert nothing[0] == "No motion found: no pattern has a match in another epoch."


def test_motion_that_is_not_confirmed(radial, features):
    table = radial[:1].copy()
    table["kind"], table["caution"] = ["not confirmed"], ["rest is near"]
    speed, p = plus_minus(table[0], "pm"), f"{table['p_global'][0]:.2g}"
    lines = component_lines(table, features)
    assert lines[0] == (
        f"Motion not confirmed: {speed} mas/yr with p_global {p}, but rest is near."
    )
    assert " ".join(lines).count("rest is near") == 1


def test_without_features_there_is_no_speed(radial, features):
    table = radial[:1].copy()
    table["kind"], table["caution"] = ["not confirmed"], ["no single feature is seen"]
    table["n_features"], table["pm_limit"] = 0, 3 * u.mas / u.yr
    lines = component_lines(table, features)
    p = f"{table['p_global'][0]:.2g}"
    assert lines[0] == (
        f"Motion not confirmed: p_global {p}, but no single feature is seen."
    )
    assert lines[3].split()[:5] == ["1", "not", "confirmed", "-", "-"]
    assert "mean speed" not in " ".join(lines)


def test_the_core_is_the_reference(radial, features):
    table = radial[[0, 2]].copy()
    table["component"], table["kind"] = [1, 2], ["moving", "stationary"]
    table.meta["core"] = [2]
    lines = component_lines(table, features)
    assert "stationary" not in " ".join(lines)
    assert "Row 2 of components.ecsv is the core, the reference" in lines
    alone = component_lines(table[1:], features)
    assert alone[0].startswith("No motion found between")
    assert alone[1] == "Row 2 of components.ecsv is the core, the reference"


def test_features_that_differ_have_their_range(radial, features):
    table = radial[:1].copy()
    n = table["n_features"][0]
    for name, value in (("dispersion", 1.0), ("dispersion_err", 0.4)):
        table[name] = value * u.mas / u.yr
    for name, value in (("pm_min", 0.14), ("pm_max", 0.58)):
        table[name] = value * u.mas / u.yr
    mean = plus_minus(table[0], "pm")
    assert component_lines(table, features)[0] == (
        f"Motion: 0.14 to 0.58 mas/yr, mean {mean} mas/yr outward, {n} features."
    )
    table["caution"], table["pm_pa"] = ["moves towards the core"], 90 * u.deg
    assert (
        "towards PA 90 deg, which is towards the core"
        in component_lines(table, features)[0]
    )


def test_secure_features_are_shown_with_their_speeds(jet_results):
    result = jet_results["radial"]
    components = result.components_in_c(redshift=0.1)
    table, secure = result.features, np.asarray(result.features["secure"])
    assert 0 < secure.sum() <= 10
    lines = component_lines(components, table)
    (head,) = (k for k, line in enumerate(lines) if line.startswith("feature "))
    said = f"{len(table)} features, {secure.sum()} of them secure:"
    assert lines[head - 2 : head] == ["", said]
    assert "speed (c)" in lines[head]
    for line, row in zip(lines[head + 1 :], table[secure], strict=False):
        assert line.split()[:2] == [str(row["feature"]), str(row["component"])]
        assert plus_minus(row, "pm") in line
    assert lines[head + secure.sum() + 1] == ""


def test_of_many_features_those_of_most_epochs_are_shown(jet_results):
    features = vstack([jet_results["radial"].features[:1]] * 12)
    features["secure"], features["feature"] = True, np.arange(1, 13)
    features["n_epochs"] = [4, 4, *range(5, 15)]
    _, said, _, *rows, _ = feature_lines(features)
    assert said == (
        "12 features, 12 of them secure; the 10 that were seen in most epochs:"
    )
    assert [row.split()[0] for row in rows] == [str(k) for k in range(3, 13)]
    features["secure"] = False
    assert feature_lines(features[:1])[0] == "1 feature, 0 of them secure."
    assert feature_lines(features[:0])[0] == "0 features, 0 of them secure."
