# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Marks of the tests, and one small jet for all that need a measurement."""

from pathlib import Path

import astropy.units as u
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import JetSimulation, Stream

HERE = Path(__file__).parent
#: Folders and modules whose tests run the command line, or scripts, end to end.
INTEGRATION = {
    *("cli", "robustness", "survey"),
    *("test_docs_commands", "test_examples", "test_golden"),
}
OPTIONS = {"scales": [1, 2, 3], "max_speed": 30 * u.mas / u.yr}


def pytest_collection_modifyitems(items):
    """Mark tests as integration tests by their place or the real data they read."""
    for item in items:
        if HERE in item.path.parents:
            place = item.path.relative_to(HERE).with_suffix("").parts[0]
            if place in INTEGRATION or "shared_data" in item.fixturenames:
                item.add_marker(pytest.mark.integration)


@pytest.fixture(scope="session")
def jet_cube():
    """Eight epochs of a core and of features that move 0.6 beam an epoch west."""
    flow = Stream("flow", dx=6.0, sigma=3.0, density=0.6, jitter=0.5)
    jet = JetSimulation(
        [flow], n_epochs=8, core=1.0, shape=(96, 180), extent=(20.0, 140.0), axis=48.0
    )
    return jet.run(rng=2).cube


@pytest.fixture(scope="session")
def jet_matched(jet_cube):
    """Correlated on three scales."""
    return StackedCrossCorrelation(**OPTIONS).match(jet_cube)


@pytest.fixture(scope="session")
def jet_stacked(jet_matched):
    """Measure the same matches with other settings."""

    def run(position_angle=None, **settings):
        scc = StackedCrossCorrelation(
            **{**OPTIONS, "position_angle": position_angle, **settings}
        )
        return scc.stack(jet_matched, n_trials=40, rng=1)

    return run


@pytest.fixture(scope="session")
def jet_results(jet_stacked):
    """Results of the same matches by the kind of their axes."""
    angles = {"jet": 270 * u.deg, "sky": None, "radial": "radial"}
    return {name: jet_stacked(angle) for name, angle in angles.items()}
