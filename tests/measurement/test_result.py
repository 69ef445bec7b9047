# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The vectors, kinds, maps and members of a measurement."""

import astropy.units as u
import numpy as np
import pytest
from astropy.cosmology import FlatLambdaCDM
from astropy.nddata import NDData
from hypothesis import given
from hypothesis import strategies as st

from astro_scc import StackedCrossCorrelation
from astro_scc.exceptions import MeasurementWarning
from astro_scc.kinematics import SkyFrame
from astro_scc.measurement.tables import velocity_columns

PM = u.mas / u.yr
PAPER = FlatLambdaCDM(H0=71, Om0=0.27)

speeds = st.floats(-5, 5)
angles = st.floats(-360, 360)
errors = st.floats(0.01, 2)
correlations = st.floats(-0.95, 0.95)


def covariance_of(err1, err2, correlation):
    c = correlation * err1 * err2
    return np.array([[err1**2, c], [c, err2**2]])


# Vectors -------------------------------------------------------------------------


@given(speeds, speeds, errors, errors, correlations, angles)
def test_on_the_sky_frame(east, north, err1, err2, correlation, pa):
    covariance = covariance_of(err1, err2, correlation)
    row = velocity_columns(np.array([east, north]), covariance, SkyFrame(), pa * u.deg)
    assert (row["pm_ra_cosdec"], row["pm_dec"]) == pytest.approx((east, north))
    assert row["pm_ra_cosdec_err"] == pytest.approx(err1)
    assert row["pm_dec_err"] == pytest.approx(err2)
    assert row["pm"] == pytest.approx(np.hypot(east, north))
    along = np.array([np.sin(np.radians(pa)), np.cos(np.radians(pa))])
    across = np.array([along[1], -along[0]])
    for name, axis in (("parallel", along), ("transverse", across)):
        assert row[f"pm_{name}"] == pytest.approx(
            axis @ [east, north], rel=1e-9, abs=1e-9
        )
        assert row[f"pm_{name}_err"] == pytest.approx(
            np.sqrt(axis @ covariance @ axis), rel=1e-6
        )
    assert 0 <= row["pm_pa"] <= 360
    if row["pm"] > 1e-6:
        pa = np.radians(row["pm_pa"])
        np.testing.assert_allclose(
            (np.sin(pa), np.cos(pa)), np.array([east, north]) / row["pm"], atol=1e-9
        )
        unit = np.array([east, north]) / row["pm"]
        turned = np.array([-unit[1], unit[0]])
        assert row["pm_err"] == pytest.approx(np.sqrt(unit @ covariance @ unit))
        sigma = np.sqrt(turned @ covariance @ turned) / row["pm"]
        assert row["pm_pa_err"] == pytest.approx(min(np.degrees(sigma), 180.0))


# Frames, on images ---------------------------------------------------------------


def test_without_a_position_angle_parallel_is_along_the_flow(sky_result):
    """The simulated jet lies to the west of the reference pixel."""
    assert abs(sky_result.position_angle - 270 * u.deg) < 3 * u.deg
    assert sky_result.frame == SkyFrame()
    moving = sky_result.components[0]
    assert moving["pm_parallel"] > 0
    assert abs(moving["pm_parallel"] - moving["pm"]) < 0.1 * moving["pm"]
    assert sky_result.components.meta["jet_position_angle"] == sky_result.position_angle


# Tables --------------------------------------------------------------------------


def test_components_are_the_streams_in_their_order(sky_result):
    table = sky_result.components
    np.testing.assert_array_equal(table["component"], np.arange(1, len(table) + 1))
    for row, stream, velocity, peak in zip(
        table,
        sky_result.search.streams,
        sky_result.velocities,
        sky_result.maxima,
        strict=True,
    ):
        covariance = velocity.covariance
        assert (row["kind"], row["caution"]) == (stream.kind, stream.reason or "-")
        for name in ("p_local", "p_global", "p_distinct"):
            assert row[name] == getattr(stream, name)
        p = stream.p_global
        assert row["p_global_err"] == pytest.approx(np.sqrt(p * (1 - p) / 40))
        assert row["p_smallest"] == pytest.approx(1 / 41)
        assert row["p_smallest"] <= row["p_global"]
        assert row["p_local"] <= row["p_global"]
        assert row["n_features"] == len(stream.features)
        np.testing.assert_array_equal(row["dispersion"].value, velocity.dispersion)
        np.testing.assert_array_equal(
            row["dispersion_err"].value, velocity.dispersion_error
        )
        assert row["pm_ra_cosdec"].value == velocity.value[0]
        assert row["pm_dec"].value == velocity.value[1]
        assert row["pm_ra_cosdec_err"].value == pytest.approx(covariance[0, 0] ** 0.5)
        assert row["pm_dec_err"].value == pytest.approx(covariance[1, 1] ** 0.5)
        # The maximum of the stack near it.
        box = 1.0 / np.mean(sky_result.pairs.interval)
        away = np.subtract((peak.v1, peak.v2), velocity.value)
        assert np.abs(away).max() <= box / 2
        assert row["coefficient"] == sky_result.coefficient[peak.row, peak.column]
        assert row["z_score"] == sky_result.z_score[peak.row, peak.column]


def test_the_error_of_the_alignment_is_a_part_of_the_error(sky_result, stacked):
    bad = stacked(alignment_error=0.3 * u.mas)
    one, other = sky_result.components[0], bad.components[0]
    assert one["pm_err_alignment"] == 0
    assert other["pm"] == one["pm"]
    assert 0 < other["pm_err_alignment"] < other["pm_err"]
    assert other["pm_err"].value == pytest.approx(
        np.hypot(one["pm_err"].value, other["pm_err_alignment"].value)
    )


def test_the_papers_error_stands_beside_that_of_the_features(sky_result):
    for row, jitter in zip(sky_result.components, sky_result.jitters, strict=True):
        speeds = np.array([row["pm_ra_cosdec"].value, row["pm_dec"].value])
        along = speeds / np.hypot(*speeds)
        c = np.array(jitter.covariance)
        expected = pytest.approx((along @ c @ along) ** 0.5, nan_ok=True)
        assert row["pm_err_jitter"].value == expected
    assert sky_result.components["pm_err_jitter"][0] > 0 * PM


def test_apparent_speeds_of_a_redshift(sky_result):
    table = sky_result.components_in_c(redshift=0.158, cosmology=PAPER)
    # 1 mas/yr is 10.20 c for 3C 273 (paper, Sect. 3).
    np.testing.assert_allclose(table["beta_app"], 10.20 * table["pm"].value, rtol=1e-3)
    np.testing.assert_allclose(
        table["beta_app_err"] / table["beta_app"], table["pm_err"] / table["pm"]
    )
    assert table["beta_app"].info.description
    assert "beta_app" not in sky_result.components.colnames
    assert "cosmology" not in sky_result.components.meta


@pytest.mark.parametrize("how", [{}, {"cosmology": PAPER}])
def test_apparent_speeds_need_a_distance(sky_result, how):
    with pytest.raises(ValueError, match=r"redshift|cosmology|distance"):
        sky_result.components_in_c(**how)


# Members -------------------------------------------------------------------------


def test_members_are_the_matches_between_ssps_of_one_feature(sky_result):
    d = sky_result.displacements
    for number, stream in enumerate(sky_result.search.streams, start=1):
        together = {
            (a, b)
            for feature in stream.features
            for a in feature.ssp
            for b in feature.ssp
        }
        expected = [k for k in range(len(d)) if (d.ssp[k], d.target_ssp[k]) in together]
        assert len(expected) > 10
        table = sky_result.members(number)
        np.testing.assert_array_equal(table["match"], expected)
        np.testing.assert_array_equal(table["target_ssp"], d.target_ssp[expected])
        moved = table["displacement_east"], table["displacement_north"]
        motion = np.stack(moved, axis=1).to_value(u.mas)
        np.testing.assert_allclose(motion, d.motion[expected], atol=1e-9)
        days = (table["target_date"] - table["date"]).to(u.yr)
        np.testing.assert_allclose(table["interval"], days)
        row = sky_result.components[number - 1]
        assert row["n_ssp"] == len(set(d.ssp[expected]))
        pairs = {frozenset((d.reference[k], d.target[k])) for k in expected}
        assert row["n_pairs"] == len(pairs) <= 28


def test_without_features_members_are_the_matches_at_the_velocity(matched):
    """Two epochs: no feature is followed."""
    with pytest.warns(MeasurementWarning, match="2 epochs allow no p_global"):
        result = scc_of_two(matched)
    (row,), d = result.components, result.displacements
    assert row["n_features"] == 0
    velocity = [row[k].to_value(PM) for k in ("pm_ra_cosdec", "pm_dec")]
    interval = np.diff(result.cube.years.value)[0]
    expected = [
        k
        for k in np.flatnonzero(d.target == d.reference + 1)
        if abs(d.d1[k] - velocity[0] * interval) <= 2 * d.s1[k]
        and abs(d.d2[k] - velocity[1] * interval) <= 2 * d.s2[k]
    ]
    np.testing.assert_array_equal(result.members(1)["match"], expected)
    assert row["n_pairs"] == 1


def scc_of_two(matched):
    options = {"scales": [1, 2], "max_speed": 30 * PM}
    return StackedCrossCorrelation(**options)(matched.cube[:2], n_trials=20, rng=1)


def test_there_is_no_component_zero(sky_result):
    for number in (0, -1, len(sky_result.components) + 1):
        with pytest.raises(ValueError, match=f"no stream {number}: there are"):
            sky_result.members(number)


# Maps ----------------------------------------------------------------------------


def test_the_velocity_map_has_velocity_coordinates(sky_result):
    found = sky_result.velocity_map()
    assert isinstance(found, NDData)
    np.testing.assert_array_equal(found.data, sky_result.coefficient)
    grid = sky_result.grid
    columns, rows = np.arange(grid.shape[1]), np.arange(grid.shape[0])
    to_si = (1 * PM).to_value(u.rad / u.s)
    v1 = found.wcs.wcs_pix2world(columns, 0 * columns, 0)[0]
    v2 = found.wcs.wcs_pix2world(0 * rows, rows, 0)[1]
    unit = u.Unit(str(found.wcs.wcs.cunit[0])).to(u.rad / u.s)
    np.testing.assert_allclose(v1 * unit, grid.v1 * to_si, atol=1e-9 * to_si)
    np.testing.assert_allclose(v2 * unit, grid.v2 * to_si, atol=1e-9 * to_si)
    assert found.meta["axes"] == ("east", "north")


def test_the_other_map_is_the_significance(sky_result):
    np.testing.assert_array_equal(
        sky_result.velocity_map("z_score").data, sky_result.z_score
    )
    with pytest.raises(ValueError, match="unknown map 'p': use 'coefficient' or"):
        sky_result.velocity_map("p")


@pytest.mark.parametrize("unknown", [np.inf, np.nan])
def test_errors_that_are_not_known_are_nan_and_the_velocity_is_not(unknown):
    covariance = np.diag([unknown, unknown])
    row = velocity_columns(np.array([3.0, 4.0]), covariance, SkyFrame(), 65 * u.deg)
    assert row["pm"] == pytest.approx(5.0)
    for name, value in row.items():
        assert np.isnan(value) == name.endswith("_err")
