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

from astro_scc import StackedCrossCorrelation
from astro_scc.features import find_features
from astro_scc.kinematics import PositionAngleFrame, RadialFrame, SkyFrame
from astro_scc.measurement import MatchedEpochs, write_products
from astro_scc.measurement.feature_tables import components_of


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


def test_where_the_frame_has_no_axes_and_without_features_or_components():
    result = streams(*ALONG, frame=RadialFrame())
    at_origin = motion((2.0, 0.0), place=(0.0, 0.0))
    assert components_of(result, Moving([at_origin])).tolist() == [0]
    assert components_of(result, Moving()).shape == (0,)
    result.search.streams = result.velocities = ()
    assert components_of(result, Moving([at_origin])).tolist() == [0]


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


def test_features_are_searched_inside_the_region_alone(jet_cube, tmp_path):
    scc = StackedCrossCorrelation(scales=[1, 2], max_speed=30 * u.mas / u.yr)
    mask = np.zeros(jet_cube.shape[1:], dtype=bool)
    mask[:, 60:] = True
    matched = scc.match(jet_cube, region=mask)
    result = scc.stack(matched, n_trials=20, rng=1)
    positions = result.feature_positions
    east, _ = jet_cube.pixel_to_offset(60, 0)
    assert 0 < len(result.features)
    assert np.all(positions["ra_offset"] < east + 1 * jet_cube.pixel_scale)
    everywhere = find_features(jet_cube).positions["ra_offset"]
    assert np.any(everywhere > east + 1 * jet_cube.pixel_scale)
    # The region is in the files of matches.
    matched.write(tmp_path / "matches.fits")
    again = MatchedEpochs.read(tmp_path / "matches.fits", jet_cube)
    np.testing.assert_array_equal(again.region, mask)
    assert again.region.dtype == bool
    again = scc.stack(again, n_trials=20, rng=1)
    assert np.all(again.feature_positions["ra_offset"] == positions["ra_offset"])


def test_without_a_beam_features_are_of_ssps(jet_cube):
    scc = StackedCrossCorrelation(scales=[1, 2], max_speed=30 * u.mas / u.yr)
    result = scc(replace(jet_cube, beams=None), n_trials=20, rng=1)
    assert len(result.features) > 0
    ssps = {(row["epoch"], row["east"].value) for row in result.ssps}
    for row in result.feature_positions:
        at = np.array([x for epoch, x in ssps if epoch == row["epoch"]])
        assert np.abs(at - row["ra_offset"].value).min() < 1.0


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
