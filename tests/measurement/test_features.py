# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features of a result: their components, their region, and their tables on disk."""

from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time

from astro_scc.kinematics import PositionAngleFrame, RadialFrame, SkyFrame
from astro_scc.measurement import write_products
from astro_scc.measurement.tables import components_of


def motion(velocity, place=(3.0, 0.0), error=0.05):
    speed = float(np.hypot(*velocity))
    return SimpleNamespace(
        velocity=np.array(velocity), velocity_err=np.full(2, error), speed=speed,
        speed_err=error, place=np.array(place),
    )  # fmt: skip


class Moving(list):
    """Features of which only the motions are known."""

    @property
    def motions(self):
        return self


def streams(*each, frame):
    """A result with components: kind, velocity on the axes and dispersion."""
    made = [
        (
            SimpleNamespace(kind=kind, angle=np.arctan2(*velocity[::-1])),
            SimpleNamespace(
                value=np.array(velocity), covariance=np.diag([0.03, 0.03]) ** 2,
                dispersion=dispersion,
            ),
        )
        for kind, velocity, dispersion in each
    ]  # fmt: skip
    own, velocities = zip(*made, strict=True)
    search = SimpleNamespace(streams=own)
    return SimpleNamespace(search=search, velocities=velocities, frame=frame)


ALONG = (
    ("moving", (2.0, 0.0), 0.3),
    ("moving", (4.0, 0.0), np.nan),
    ("stationary", (0.0, 0.0), np.nan),
    ("not significant", (8.0, 0.0), np.nan),
)


@pytest.mark.parametrize(
    ("velocity", "component"),
    [
        ((2.5, 0.0), 1),  # within the dispersion
        ((2.0, 0.1), 1),
        ((2.0, 0.5), 1),  # which is that across as well
        ((2.0, 0.7), 0),
        ((2.7, 0.0), 0),
        ((4.1, 0.0), 2),
        ((4.2, 0.0), 0),
        ((0.05, 0.05), 3),
        ((0.11, 0.11), 0),  # within two errors on both axes, but it moves
        ((8.0, 0.0), 0),
    ],
)
def test_a_feature_is_of_the_component_with_its_velocity(velocity, component):
    speed, across = velocity
    sky = SkyFrame(), motion((speed, across))
    west = PositionAngleFrame(270 * u.deg), motion((-speed, across))
    # At north of the origin, a radial motion is to the north.
    radial = RadialFrame(), motion((across, speed), place=(0.0, 5.0))
    for frame, own in (sky, west, radial):
        result = streams(*ALONG, frame=frame)
        assert components_of(result, Moving([own])).tolist() == [component]


def test_the_nearest_component_in_units_of_the_errors():
    wide, narrow = ("moving", (2.0, 0.0), 1.0), ("moving", (3.0, 0.0), 0.0)
    result = streams(wide, narrow, frame=SkyFrame())
    slow, fast = motion((2.85, 0.0)), motion((3.02, 0.0))
    assert components_of(result, Moving([slow, fast])).tolist() == [1, 2]


def test_rows_agree_with_the_positions(sky_result):
    table, positions = sky_result.features, sky_result.feature_positions
    assert len(table) >= 3
    assert np.any(table["component"] == 1)
    for row in table:
        own = positions[positions["feature"] == row["feature"]]
        assert len(own) == row["n_epochs"]
        dates = row["first"], row["last"], row["date"]
        middle = own["date"][0] + np.mean(own["date"] - own["date"][0])
        for date, expected in zip(dates, (*own["date"][[0, -1]], middle), strict=True):
            assert abs(date - expected) < 1 * u.s
        years = own["date"].jyear
        slope = np.polyfit(years, own["ra_offset"].to_value(u.mas), 1)[0]
        off = row["pm_ra_cosdec"].value - slope
        assert abs(off) < 3 * row["pm_ra_cosdec_err"].value
        if np.isfinite(row["t_ej"]):
            moved = row["pm"] * (row["date"].jyear * u.yr - row["t_ej"])
            assert moved.value == pytest.approx(row["separation"].value, rel=0.05)


@pytest.mark.parametrize("what", ["some", "none"])
def test_files_hold_the_tables(what, sky_result, tmp_path):
    result = sky_result
    if what == "none":
        dull = np.random.default_rng(1).normal(size=sky_result.cube.shape)
        cube = replace(sky_result.cube, data=1e-3 * dull, noise=None)
        result = replace(result, matched=replace(result.matched, cube=cube))
    components = sky_result.components_in_c(redshift=0.1)
    assert (len(result.features) > 0) == (what == "some")
    object.__setattr__(result, "sensitivity", sky_result.sensitivity)
    write_products(result, components, tmp_path)
    tables = {"features": result.features, "positions": result.feature_positions}
    for name, table in tables.items():
        for path in (f"{name}.ecsv", f"publication/{name}.vot"):
            read = QTable.read(tmp_path / path)
            speeds = ["beta_app", "beta_app_err"] if name == "features" else []
            assert read.colnames == table.colnames + speeds
            assert len(read) == len(table)
            for column in table.colnames:
                one, other = table[column], read[column]
                # VOTable has a unit for each real number.
                assert (getattr(one, "unit", None) or u.one) == (
                    getattr(other, "unit", None) or u.one
                )
                if isinstance(one, Time):
                    one, other = one.isot, getattr(other, "isot", other)
                np.testing.assert_array_equal(np.asarray(one), np.asarray(other))
    assert read["flux"].unit == u.Jy
    read = QTable.read(tmp_path / "features.ecsv")
    expected = read["pm"] * (components["beta_app"] / components["pm"])[0]
    np.testing.assert_allclose(read["beta_app"], expected.to_value(u.one))
    with fits.open(tmp_path / "scc.fits") as hdus:
        seen = QTable.read(hdus["FEATURES"])
    assert list(seen["date"]) == list(result.feature_positions["date"].isot)
    row = np.searchsorted(result.features["feature"], seen["feature"])
    of_rows = result.features[row]
    for k, name in enumerate(("pm_ra_cosdec", "pm_dec"), start=1):
        assert np.all(seen[f"pm_axis{k}"] == of_rows[name])
        assert seen[f"pm_axis{k}"].unit == u.mas / u.yr
