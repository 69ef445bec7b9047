# Licensed under a 3-clause BSD style license - see LICENSE.rst
import pytest


@pytest.fixture(scope="session")
def matched(jet_matched):
    return jet_matched


@pytest.fixture(scope="session")
def sky_result(jet_stacked):
    """The small jet, stacked along east and north."""
    return jet_stacked()
