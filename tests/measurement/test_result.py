# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The vectors, kinds, maps and members of a measurement."""

from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.cosmology import FlatLambdaCDM
from astropy.nddata import NDData
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.kinematics import PositionAngleFrame, RadialFrame, SkyFrame
from astro_scc.measurement.result import SCCResult, _smallest, _vectors
from astro_scc.stacking import NullTest

PM = u.mas / u.yr
#: One pixel between two epochs of the simulated jets.
PIXEL = (0.1 * u.mas / (30 * u.day)).to(PM)
PAPER = FlatLambdaCDM(H0=71, Om0=0.27)

speeds = st.floats(-5, 5)
angles = st.floats(-360, 360)
errors = st.floats(0.01, 2)
correlations = st.floats(-0.95, 0.95)


def covariance_of(err1, err2, correlation):
    c = correlation * err1 * err2
    return np.array([[err1**2, c], [c, err2**2]])


def nearest(table, x, y=0.0):
    """The component nearest to a motion in pixels between epochs, x to the west."""
    distance = np.hypot(-table["pm_ra_cosdec"] / PIXEL - x, table["pm_dec"] / PIXEL - y)
    return table[int(np.argmin(distance))]


# Vectors -------------------------------------------------------------------------


@given(speeds, speeds, errors, errors, correlations, angles)
def test_on_the_sky_frame(east, north, err1, err2, correlation, pa):
    covariance = covariance_of(err1, err2, correlation)
    row = _vectors(np.array([east, north]), covariance, SkyFrame(), pa * u.deg)
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


@given(speeds, speeds, errors, errors, correlations, angles, angles)
def test_whatever_the_frame_the_vector_is_the_same(
    east, north, err1, err2, correlation, pa, jet
):
    covariance = covariance_of(err1, err2, correlation)
    sky = np.array([east, north])
    frame = PositionAngleFrame(pa * u.deg)
    turn = frame.matrix()
    here = _vectors(sky, covariance, SkyFrame(), jet * u.deg)
    there = _vectors(turn @ sky, turn @ covariance @ turn.T, frame, jet * u.deg)
    assert here.keys() == there.keys()
    for name in here.keys() - {"pm_pa", "pm_pa_err", "pm_err"}:
        assert there[name] == pytest.approx(here[name], rel=1e-6, abs=1e-7)
    if here["pm"] > 1e-3:
        assert there["pm_err"] == pytest.approx(here["pm_err"], rel=1e-4)
        assert there["pm_pa_err"] == pytest.approx(here["pm_pa_err"], rel=1e-4)
        difference = (there["pm_pa"] - here["pm_pa"] + 180) % 360 - 180
        assert difference == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize(
    ("sky", "angle"), [((0, 1), 0), ((1, 0), 90), ((0, -1), 180), ((-1, 0), 270)]
)
def test_angles_run_from_north_through_east(sky, angle):
    row = _vectors(np.array(sky, float), np.eye(2) * 0.01, SkyFrame(), 0 * u.deg)
    assert row["pm_pa"] == pytest.approx(angle)
    assert row["pm_pa_err"] == pytest.approx(np.degrees(0.1))


def test_in_its_own_frame_a_jet_moves_along_itself():
    frame = PositionAngleFrame(230 * u.deg)
    covariance = covariance_of(0.1, 0.4, 0.5)
    row = _vectors(np.array([3.0, 0.0]), covariance, frame, frame.pa)
    assert row["pm_parallel"] == pytest.approx(3.0)
    assert row["pm_transverse"] == pytest.approx(0.0)
    assert row["pm_pa"] == pytest.approx(230)
    assert row["pm_parallel_err"] == pytest.approx(0.1)
    assert row["pm_err"] == pytest.approx(0.1)
    assert row["pm_transverse_err"] == pytest.approx(0.4)
    assert row["pm_pa_err"] == pytest.approx(np.degrees(0.4 / 3))


def test_what_stands_still_has_any_direction():
    row = _vectors(np.zeros(2), np.eye(2) * 0.04, SkyFrame(), 0 * u.deg)
    assert row["pm"] == 0.0
    assert row["pm_err"] == pytest.approx(0.2)
    assert row["pm_pa_err"] == 180.0


def test_away_from_a_point_there_is_no_direction_on_the_sky():
    covariance = covariance_of(0.1, 0.2, 0.0)
    row = _vectors(np.array([2.0, 0.0]), covariance, RadialFrame(), 30 * u.deg)
    assert (row["pm_parallel"], row["pm_transverse"]) == (2.0, 0.0)
    assert row["pm_parallel_err"] == pytest.approx(0.1)
    assert row["pm"] == 2.0
    assert row["pm_err"] == pytest.approx(0.1)
    for name in ("pm_ra_cosdec", "pm_dec", "pm_pa"):
        assert np.isnan(row[name])
        assert np.isnan(row[f"{name}_err"])


def test_errors_that_are_not_known_stay_so():
    row = _vectors(np.array([2.0, 1.0]), np.full((2, 2), np.nan), SkyFrame(), 0 * u.deg)
    assert row["pm"] == pytest.approx(np.sqrt(5))
    for name in ("pm", "pm_pa", "pm_ra_cosdec", "pm_parallel"):
        assert np.isnan(row[f"{name}_err"])


# Frames, on images ---------------------------------------------------------------


@pytest.mark.parametrize("pa", [270.0, 250.0, 35.0])
def test_the_same_matches_in_another_frame_give_the_same_vectors(
    sky_result, stacked, pa
):
    turned = stacked(pa * u.deg)
    assert turned.position_angle == pa * u.deg
    step = max(*sky_result.grid.step, *turned.grid.step)
    for x in (5.0, 20.0):
        one, other = (nearest(r.components, x) for r in (sky_result, turned))
        for name in ("pm_ra_cosdec", "pm_dec"):
            assert abs(one[name] - other[name]) < step * PM
        assert one["pm_err"].value == pytest.approx(other["pm_err"].value, rel=0.6)
        sin, cos = np.sin(pa * u.deg), np.cos(pa * u.deg)
        along = other["pm_ra_cosdec"] * sin + other["pm_dec"] * cos
        across = other["pm_ra_cosdec"] * cos - other["pm_dec"] * sin
        assert other["pm_parallel"].value == pytest.approx(along.value)
        assert other["pm_transverse"].value == pytest.approx(across.value)


def test_without_a_position_angle_parallel_is_along_the_flow(sky_result):
    """The simulated jet lies to the west of the reference pixel."""
    assert abs(sky_result.position_angle - 270 * u.deg) < 3 * u.deg
    assert sky_result.frame == SkyFrame()
    slow = nearest(sky_result.components, 5.0)
    assert slow["pm_parallel"] > 0
    assert abs(slow["pm_parallel"] - slow["pm"]) < 0.1 * slow["pm"]
    assert sky_result.components.meta["jet_position_angle"] == sky_result.position_angle


# Tables --------------------------------------------------------------------------


def test_components_are_the_velocities_tested_in_the_order_of_the_search(sky_result):
    table = sky_result.components
    np.testing.assert_array_equal(table["component"], np.arange(1, len(table) + 1))
    assert table["kind"][0] == "moving"
    assert table["kind"][-1] == "uncertain"
    assert np.all((table["p_global"] <= 0.05) == (table["kind"] != "uncertain"))
    for row, finding, peak, covariance in zip(
        table,
        sky_result.findings,
        sky_result.maxima,
        sky_result.errors,
        strict=True,
    ):
        for name, value in (
            ("p_local", finding.p_local),
            ("p_global", finding.p_global),
            ("p_global_err", finding.p_error),
        ):
            assert row[name] == value
        assert row["p_smallest"] == pytest.approx(1 / 31)
        assert row["p_smallest"] <= row["p_global"]
        assert row["p_local"] <= row["p_global"]
        # The maximum near the velocity that was tested.
        box = 1.0 / np.mean(sky_result.pairs.interval)
        assert np.hypot(peak.v1 - finding.v1, peak.v2 - finding.v2) <= box / 2
        assert row["pm_ra_cosdec"].value == peak.v1
        assert row["pm_ra_cosdec_err"].value == pytest.approx(covariance[0, 0] ** 0.5)
        assert row["pm_dec_err"].value == pytest.approx(covariance[1, 1] ** 0.5)
        assert row["coefficient"] == sky_result.coefficient[peak.row, peak.column]
        assert row["z_score"] == sky_result.z_score[peak.row, peak.column]
    assert repr(sky_result).startswith(f"<SCCResult: {len(table)} components of <Epoch")


def test_the_papers_error_stands_beside_that_of_the_features(sky_result):
    for row, jitter in zip(sky_result.components, sky_result.jitters, strict=True):
        speeds = np.array([row["pm_ra_cosdec"].value, row["pm_dec"].value])
        along = speeds / np.hypot(*speeds)
        c = np.array(
            [[jitter.err1**2, jitter.covariance], [jitter.covariance, jitter.err2**2]]
        )
        assert row["pm_err_jitter"].value == pytest.approx((along @ c @ along) ** 0.5)


def test_a_papers_error_that_is_not_known_is_nan(sky_result):
    lost = replace(sky_result.jitters[0], err1=np.nan, err2=np.nan, covariance=np.nan)
    jitters = (lost, *sky_result.jitters[1:])
    table = replace(sky_result, jitters=jitters).components
    assert np.isnan(table["pm_err_jitter"][0])
    assert np.isfinite(table["pm_err"]).all()


@pytest.mark.parametrize(
    ("found", "v1", "err", "kind"),
    [
        ("moving", 3.0, 1.0, "moving"),
        # Within the ellipse of 95% in two dimensions, 2.45 standard errors.
        ("moving", 2.4, 1.0, "stationary"),
        ("moving", 2.5, 1.0, "moving"),
        # Further than half a beam an interval from rest, the order of the
        # epochs says that it moves, however badly its speed is known.
        ("moving", 2.6, 5.0, "moving"),
        ("moving", -2.4, 1.0, "stationary"),
        ("moving", 2.4, np.inf, "moving"),
        ("moving", 0.0, 0.0, "stationary"),
        ("stationary", 3.0, 1.0, "stationary"),
        ("uncertain", 3.0, 1.0, "uncertain"),
        ("uncertain", 0.0, 1.0, "uncertain"),
    ],
)
def test_what_does_not_move_within_its_errors_is_stationary(found, v1, err, kind):
    peak = SimpleNamespace(v1=v1, v2=0.0)
    covariance = np.diag([err**2, 0.01])
    finding, kernel = SimpleNamespace(kind=found), np.ones(2)
    assert SCCResult._kind(finding, peak, covariance, kernel) == kind


def test_the_smallest_probability_is_that_of_the_tests_that_count():
    tests = {
        "scramble": NullTest(0.01, 0.01, 99, 0.01),
        "shuffle": NullTest(0.3, 0.3, 23, 0.08),
    }
    for kind, smallest in (("moving", 0.08), ("uncertain", 0.08), ("stationary", 0.01)):
        assert _smallest(SimpleNamespace(kind=kind, tests=tests)) == smallest


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


def test_apparent_speeds_of_a_distance(sky_result):
    table = sky_result.components_in_c(distance=16.7 * u.Mpc)
    np.testing.assert_allclose(table["beta_app"], 0.264 * table["pm"].value, rtol=1e-2)
    assert table.meta["distance"] == 16.7 * u.Mpc
    assert "redshift" not in table.meta


@pytest.mark.parametrize("how", [{}, {"cosmology": PAPER}])
def test_apparent_speeds_need_a_distance(sky_result, how):
    with pytest.raises(ValueError, match=r"redshift|cosmology|distance"):
        sky_result.components_in_c(**how)


# Members -------------------------------------------------------------------------


def test_members_are_the_matches_at_the_velocity(sky_result):
    d, years = sky_result.displacements, sky_result.cube.years.value
    for number, row in enumerate(sky_result.components, start=1):
        member = set(sky_result.members(number))
        expected = set()
        velocity = row["pm_ra_cosdec"].value, row["pm_dec"].value
        for k in np.flatnonzero(d.target == d.reference + 1):
            interval = years[d.target[k]] - years[d.reference[k]]
            if (
                abs(d.d1[k] - velocity[0] * interval) <= 2 * d.s1[k]
                and abs(d.d2[k] - velocity[1] * interval) <= 2 * d.s2[k]
            ):
                expected.add(k)
        assert member == expected
        assert row["n_ssp"] == len({d.ssp[k] for k in member})
        assert row["n_pairs"] == len({d.reference[k] for k in member})
        assert 1 <= row["n_pairs"] <= 5


def test_there_is_no_component_zero(sky_result):
    for number in (0, -1, len(sky_result.components) + 1):
        with pytest.raises(ValueError, match=f"no component {number}: there are"):
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


def test_axes_are_named_after_the_frame(stacked):
    assert stacked(270 * u.deg).velocity_map().meta["axes"] == (
        "parallel",
        "transverse",
    )


def test_plot_is_a_figure_of_the_map(sky_result):
    from matplotlib import pyplot as plt

    figure = sky_result.plot()
    assert len(figure.axes) >= 1
    plt.close(figure)


def test_matched_epochs_say_what_they_hold(matched):
    assert repr(matched) == (
        f"<MatchedEpochs: 6 epochs, {len(matched.ssps)} SSPs, "
        f"{len(matched.matches)} matches>"
    )


@pytest.mark.parametrize("unknown", [np.inf, np.nan])
def test_errors_that_are_not_known_are_nan_and_the_velocity_is_not(unknown):
    covariance = np.diag([unknown, unknown])
    row = _vectors(np.array([3.0, 4.0]), covariance, SkyFrame(), 65 * u.deg)
    assert row["pm"] == pytest.approx(5.0)
    for name, value in row.items():
        assert np.isnan(value) == name.endswith("_err")
