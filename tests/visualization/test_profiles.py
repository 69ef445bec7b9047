# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speed against distance and what lies beside it, and the features of many sources."""

import re
from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.flow import fit_profile
from astro_scc.units import PM_UNIT as PM
from astro_scc.visualization import speeds
from astro_scc.visualization.speeds import plot_profile

WEST = SimpleNamespace(
    at=lambda s: (-s, 0 * s), position_angle=lambda s: np.full(len(s), 270) * u.deg
)


def test_components_fits_and_others_have_names(cube):
    middle = [0.5, 1.5, 2.5] * u.mas
    table = QTable({
        "r_min": middle - 0.5 * u.mas, "r_max": middle + 0.5 * u.mas, "r_mid": middle,
        "kind": ["moving", "not significant", "stationary"],
        "main": [True, False, True], "n_features": [3, 2, 1],
        "pm_parallel": [1.0, 1.2, 0.0] * PM, "pm_parallel_err": [0.1, 9.0, np.inf] * PM,
    })  # fmt: skip
    fit = fit_profile([1, 2, 4] * u.mas, [1.0, 1.2, 1.6] * PM, [0.1] * 3 * PM)
    assert re.match(r"linear: 0.2\d* ± 0.0\d+ 1/yr$", str(fit))
    _, ax = plot_profile(
        table, cube=replace(cube, beams=None), line=WEST, fits=[fit], beta_per_pm=2.0,
        others=[("MOJAVE", [4] * u.mas, [1] * PM, [0.1] * PM)],
    ).axes  # fmt: skip
    wanted = {"moving", "not significant", "stationary", str(fit), "MOJAVE"}
    assert {text.get_text() for text in ax.get_legend().get_texts()} == wanted
    # The large error does not squeeze the rest.
    assert ax.get_ylim()[1] < 2
    plot_profile(table[:0]).draw_without_rendering()
    table["scale_group"] = ["1, 2", "3", "3"]
    plot_profile(table, markersize=9).draw_without_rendering()
    angles = {"a": [240, 250, 251] * u.deg, "b": [] * u.deg}
    speeds.plot_position_angles(angles).draw_without_rendering()


def test_the_features_of_many_sources():
    """Outward, inward, stationary and accelerated ones, and a doubtful one."""
    table = QTable({"source": list("aabbb"), "n_epochs": [5, 12, 12, 12, 5]})
    table["secure"] = [True, True, False, True, False]
    table["p_false"] = [0.1, 0.1, 0.2, 0.1, 0.9]
    table["pm"], table["pm_radial"] = [1, 2, 0.1, 3, 9] * PM, [1, -2, 0, 3, 9] * PM
    for name in ("acc_parallel", "acc_perpendicular"):
        table[name] = [np.nan, np.nan, np.nan, 0.4, 0.4] * PM / u.yr
    for name in ("pm", "pm_radial", "acc_parallel", "acc_perpendicular"):
        table[f"{name}_err"] = np.full(5, 0.1) * table[name].unit
    table["beta_app"] = 10 * table["pm"].value
    found = {k: [*np.flatnonzero(use)] for k, use in speeds.population(table).items()}
    assert found == {
        "moving": [0, 1, 3], "at rest": [2], "inward": [1], "judged": [1, 3],
        "accelerated": [3],
    }  # fmt: skip
    assert speeds.fastest_of(table, "pm").tolist() == [2.0, 3.0]
    speeds.plot_population(table)
    table["beta_app"] = np.nan
    speeds.plot_population(table)
