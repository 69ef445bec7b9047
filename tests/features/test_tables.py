# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Columns of features and positions, for features whose motions are known."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time

from astro_scc.columns import columns_of
from astro_scc.epochs import Beam, EpochCube
from astro_scc.features import Features

N = 8


@pytest.fixture(scope="module")
def features(series):
    """One feature to the east, one that stands in the north, one that bends."""
    rows = []
    for t in range(N):
        rows += [(t, 1 + 0.4 * t, 0.0, 2.0), (t, 0.0, 3.0, 1.0)]
        rows += [(t, -2.0 - 0.3 * t, -0.1 * t**2 - 1, 0.5)]
    core = series([(t, 0.02 * (-1) ** t, 0.0) for t in range(N)])
    dates = Time([f"{2000 + t}-01-01" for t in range(N)])
    cube = EpochCube.from_arrays(
        np.ones((N, 8, 8)), dates, pixel_scale=0.1 * u.mas, unit=u.Jy / u.beam,
        beams=Beam(1 * u.mas, 1 * u.mas),
    )  # fmt: skip
    d = series(rows, years=dates.jyear)
    tracks = tuple(np.arange(first, 3 * N, 3) for first in (0, 1, 5))
    return Features(
        cube, d, core, tracks, np.array([1.0, 1.0, 0.2]), np.array([True, True, False])
    )


@pytest.mark.parametrize("empty", [False, True])
def test_each_column_has_a_unit_or_type_and_a_meaning(features, empty):
    found, nothing = features, features.detections.select(np.arange(0))
    if empty:
        none = np.zeros(0)
        found = replace(features, detections=nothing, core=nothing, tracks=(),
                        same_speed=none, proven=none)  # fmt: skip
        assert found.core_error == 0
    for table, own in ((found.table, "features"), (found.positions, "positions")):
        known_ones = columns_of(own)
        assert table.colnames == list(known_ones)
        for column, known in zip(table.itercols(), known_ones.values(), strict=True):
            assert column.info.description == known["meaning"]
            if known["kind"] in (int, float, bool):
                assert column.dtype.kind == np.dtype(known["kind"]).kind
            elif not isinstance(column, Time):
                assert column.unit == (known["kind"] or u.Jy)
    assert len(found.table) == len(found.tracks)
    assert len(found.positions) == sum(map(len, found.tracks))


def test_the_motion_of_a_radial_feature(features):
    row = features.table[0]
    assert (row["feature"], row["n_epochs"], row["stream"]) == (101, N, 0)
    assert (row["secure"], row["flux"], row["t_ej_err"] > 0) == (True, 2 * u.Jy, True)
    words = "<Features: 3, 1 of them secure, from 24 detections in 8 epochs>"
    assert repr(features) == words
    wanted = {
        "ra_offset": 2.4, "dec_offset": 0, "separation": 2.4, "motion": 2.8, "pm": 0.4,
        "pm_ra_cosdec": 0.4, "pm_radial": 0.4, "pm_nonradial": 0,
    }  # fmt: skip
    for name, value in wanted.items():
        assert row[name].value == pytest.approx(value, abs=0.01)
    for name in ("position_angle", "pm_pa"):
        assert row[name].to_value(u.deg) == pytest.approx(90, abs=0.5)
    assert row["t_ej"].to_value(u.yr) == pytest.approx(1997.5, abs=0.05)
    assert row["last"].isot.startswith("2007-01-01")
    assert np.isnan(row["acc_parallel"])
