# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The whole of tracking, on jets whose features are known."""

from dataclasses import replace
from functools import cache

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time

from astro_scc import Beam, EpochCube
from astro_scc.correlation import Correlator, all_pairs
from astro_scc.decomposition import Decomposer
from astro_scc.exceptions import MeasurementWarning
from astro_scc.kinematics import paper_cosmology
from astro_scc.tracking import FeatureTracker, plain_table

PM = u.mas / u.yr


@cache
def jet(n_epochs=12, missing=(), beams=True, step=0.5):
    """Two features that leave the core to the west and north-west, and one at rest."""
    years = step * np.arange(n_epochs)
    y, x = np.mgrid[:96, :160]
    images = np.zeros((n_epochs, 96, 160))
    # Pixels of 0.1 mas; west is to larger x, the core at (20, 20).
    features = [(3.0, 0.0, 1.0), (1.5, 1.5, 0.7), (0.0, 0.0, 0.9)]
    start = [(32.0, 20.0), (30.0, 30.0), (80.0, 60.0)]
    for k, t in enumerate(years):
        for f, ((vx, vy, peak), (x0, y0)) in enumerate(
            zip(features, start, strict=True)
        ):
            if (f, k) in missing:
                continue
            at = x0 + 2 * vx * t, y0 + 2 * vy * t
            images[k] += peak * np.exp(
                -((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * 2.5**2)
            )
    images += np.random.default_rng(1).normal(0, 2e-3, images.shape)
    cube = EpochCube.from_arrays(
        images, Time(2000.0 + years, format="jyear"), pixel_scale=0.1 * u.mas,
        unit=u.Jy / u.beam, reference_pixel=(20, 20),
        beams=Beam(0.59 * u.mas, 0.59 * u.mas) if beams else None,
    )  # fmt: skip
    return cube, [Decomposer(scales=[1, 2], detection=10)(d) for d in cube.data]


@pytest.fixture(scope="module")
def tracker():
    return FeatureTracker(max_speed=1.5 * PM)


@pytest.fixture(scope="module")
def tracking(tracker):
    return tracker(*jet(), n_trials=3, rng=1)


def test_every_feature_is_one_track_on_each_scale(tracking):
    tracks = tracking.tracks
    assert len(tracks) == 6
    assert repr(tracking) == "<Tracking: 6 tracks with 72 of 72 SSPs in 12 epochs>"
    for scale in (1, 2):
        own = tracks[tracks["scale"] == scale]
        own = own[np.argsort(own["pm"].value)]
        assert list(own["n_epochs"]) == [12] * 3
        assert own["pm"].to_value(PM) == pytest.approx([0, 0.424, 0.6], abs=0.01)
        west, north = -own["pm_ra_cosdec"].value, own["pm_dec"].value
        assert west[1:] == pytest.approx([0.3, 0.6], abs=0.01)
        assert north[1:] == pytest.approx([0.3, 0.0], abs=0.01)
        assert own["pm_pa"][1:].value == pytest.approx([315, 270], abs=1)
        assert np.all(own["pm_err"].value < 0.02)


def test_ejection_epochs_accelerations_and_speeds(tracking):
    tracks = tracking.tracks_in_c(redshift=0.158, cosmology=paper_cosmology())
    moving = tracks["pm"].value > 0.1
    epochs = tracks["t_ej"][moving]
    assert not np.any(epochs.mask)
    # Distances from the core: 1.2 mas at 0.6 mas/yr, 1.41 mas at 0.42.
    wanted = np.where(tracks["pm"][moving].value > 0.5, 1998, 2000 - 1 / 0.3)
    assert epochs.unmasked.value == pytest.approx(wanted, abs=0.15)
    assert np.all(tracks["t_ej"].mask[~moving])
    assert not np.any(tracks["pm_dot_parallel"].mask)
    assert not np.any(tracks["accelerated"])
    assert tracks["beta_app"] == pytest.approx(10.20 * tracks["pm"].value, rel=0.01)


def test_features_of_the_sun_need_no_solar_library(tracking):
    wcs = tracking.cube.wcs.deepcopy()
    wcs.wcs.ctype = "HPLN-TAN", "HPLT-TAN"
    sun = replace(tracking, cube=replace(tracking.cube, wcs=wcs))
    features, ours = sun.features, tracking.features
    assert "sky" not in features.colnames
    assert features["lon"].unit == u.deg
    x, y = wcs.world_to_pixel_values(features["lon"].value, features["lat"].value)
    east, _ = tracking.cube.pixel_to_offset(x, y)
    assert east.value == pytest.approx(features["lon_offset"].value, abs=1e-3)
    assert features["pm_lat"].value == pytest.approx(ours["sky"].pm_dec.to_value(PM))
    assert {"pm_lon_coslat", "pm_lat_err", "lon_offset"} <= set(sun.tracks.colnames)
    assert "scatter_lat_offset" in sun.tracks.colnames
    assert not {"pm_dec", "east", "scatter_north"} & set(sun.tracks.colnames)


def test_features_have_places_and_motions_on_the_sky(tracking):
    features = tracking.features
    assert len(features) == 72
    assert set(features["link"]) == {"first", "link"}
    sky = features["sky"]
    assert sky.pm_dec.unit == PM
    first = features[0]
    own = tracking.tracks[tracking.tracks["track"] == first["track"]]
    assert sky[0].pm_dec.value == pytest.approx(own["pm_dec"][0].value)
    x, y = tracking.cube.wcs.world_to_pixel(sky)
    east, north = tracking.cube.pixel_to_offset(x, y)
    assert east.value == pytest.approx(features["east"].value, abs=1e-3)
    assert north.value == pytest.approx(features["north"].value, abs=1e-3)
    assert np.hypot(features["east"], features["north"]).value == pytest.approx(
        features["r"].value
    )


def test_confidence_is_observed_and_permuted(tracking):
    table = tracking.confidence
    assert table["scale"].tolist() == [0, 1, 2]
    assert table["share"][0] == 1.0
    assert table["share_err"][0] == 0.0
    # The feature at rest is linked in any order.
    assert 0.2 < table["share_permuted"][0] < 1
    assert tracking.tracks.meta["confidence"][0]["n_linked"] == 66


def test_the_profile_is_that_of_the_features(tracking):
    profile = tracking.profile([1.0, 2.5, 20.0] * u.mas, half_width=0.8 * u.mas)
    assert len(profile) == 2
    assert 0.4 < profile["speed"][1].value < 0.62
    one = tracking.profile([2.5] * u.mas, half_width=0.8 * u.mas, scales=[1])
    assert one["n_tracks"][0] < profile["n_tracks"][1]


def test_the_profile_has_no_core(tracker):
    cube, decompositions = jet()
    # The feature at rest is the core of this cube.
    cube = EpochCube.from_arrays(
        cube.data, cube.times, pixel_scale=0.1 * u.mas, reference_pixel=(80, 60),
        beams=cube.beams[0],
    )  # fmt: skip
    found = tracker(cube, decompositions)
    assert np.sum(found.tracks["r"].to_value(u.mas) < 0.1) == 2
    near = {"half_width": 0.5 * u.mas}
    assert len(found.profile([0.1] * u.mas, **near)) == 0
    assert len(found.profile([4.0] * u.mas, **near)) == 1


def test_tables_survive_being_written(tracking, tmp_path):
    for name in ("features", "tracks", "confidence"):
        table = getattr(tracking, name)
        table.write(tmp_path / f"{name}.ecsv")
        back = QTable.read(tmp_path / f"{name}.ecsv")
        assert back.colnames == table.colnames
        plain = plain_table(table)
        plain.write(tmp_path / f"{name}.vot", format="votable")
    assert {"ra", "dec", "pm_dec"} <= set(plain_table(tracking.features).colnames)


@pytest.mark.slow
def test_a_missing_feature_is_a_gap(tracker):
    cube, decompositions = jet(missing=((0, 4),))
    tracking = tracker(cube, decompositions)
    tracks = tracking.tracks
    fast = tracks[tracks["pm"].value > 0.5]
    assert fast["n_epochs"].tolist() == [11, 11]
    assert fast["n_gaps"].tolist() == [1, 1]
    assert np.sum(tracking.features["link"] == "gap") == 2
    apart = FeatureTracker(max_speed=1.5 * PM, max_gap=0)(cube, decompositions)
    assert np.sum(apart.tracks["pm"].value > 0.5) == 4


@cache
def core_jet(dark=()):
    """A core, one feature that fades, and flashes that are seen at one date each."""
    years = np.array([0, 0.7, 1.0, 1.5, 2.2, 2.4, 3.0, 4.3, 5.2, 7.4])
    y, x = np.mgrid[:96, :160]
    images = np.random.default_rng(2).normal(0, 2e-3, (10, 96, 160))
    for k, t in enumerate(years):
        at = [(20, 48, 0 if k in dark else 30.0), (34 + 6 * t, 48, 0.2 * 0.8**t)]
        if k in (3, 6, 8):
            at.append((70 + 3 * k, 50 + k, 0.05))
        for x0, y0, peak in at:
            images[k] += peak * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / 24.5)
    cube = EpochCube.from_arrays(
        images, Time(2000.0 + years, format="jyear"), pixel_scale=0.1 * u.mas,
        unit=u.Jy / u.beam, reference_pixel=(20, 48),
        beams=Beam(0.82 * u.mas, 0.82 * u.mas),
    )  # fmt: skip
    return cube, [Decomposer(scales=[1, 2], detection=5)(d) for d in cube.data]


def test_the_core_is_one_track_and_nothing_jumps_into_it():
    tracking = FeatureTracker()(*core_jet())
    tracks = tracking.tracks
    assert np.sum(tracks["r"].value < 0.1) == 2
    for number in range(tracking.n_tracks):
        r = np.hypot(*tracking.offsets[:, tracking.members(number)])
        assert len(r) == 10 if r[0] < 0.5 else len(r) >= 6
        assert np.all(r < 0.1) or np.all(r > 1)
    moving = tracks[tracks["r"].value > 1]
    assert len(moving) == 2
    assert moving["pm"].value == pytest.approx([0.6, 0.6], abs=0.03)
    assert tracks["pm"][tracks["r"].value < 0.1].value == pytest.approx(0, abs=0.01)
    assert np.all(tracks["t_ej"].mask[tracks["r"].value < 0.1])


def test_the_core_is_one_track_however_long_it_is_not_seen():
    tracking = FeatureTracker(max_gap=1)(*core_jet(dark=(3, 4, 5)))
    core = tracking.tracks[tracking.tracks["r"].value < 0.1]
    assert core["n_epochs"].tolist() == [7, 7]
    assert core["n_gaps"].tolist() == [3, 3]
    features = tracking.features
    own = features[features["track"] == core["track"][0]]
    assert own["link"].tolist() == ["first", *["link"] * 2, "gap", *["link"] * 3]


@pytest.mark.slow
def test_features_of_0003_380_are_those_of_the_survey(shared_data):
    cube = EpochCube.read(str(shared_data / "0003+380" / "*.fits"))
    with pytest.warns(MeasurementWarning, match="the core is blended with the jet"):
        cube = cube.to_common_beam().align("core")
    decompositions = [Decomposer(scales=[1, 2])(d) for d in cube.data]
    tracking = FeatureTracker()(cube, decompositions)
    tracks = tracking.tracks
    speed, error = tracks["pm"].value, tracks["pm_err"].value
    core = tracks["r"].value < 0.5
    # Nothing within a beam of the core moves: 0.003 and 0.013 mas/yr in the survey.
    assert tracks["n_epochs"][core].tolist() == [10, 10]
    assert np.all(speed[core] < 0.02)
    for number in np.flatnonzero(core):
        assert np.hypot(*tracking.offsets[:, tracking.members(number)]).max() < 0.2
    # One feature at 1.8 mas, 0.316 +- 0.026 mas/yr to 120 degrees.
    near = (np.abs(tracks["r"].value - 1.8) < 0.3) & (tracks["n_epochs"] >= 4)
    assert np.sum(near) == 2
    assert np.all(np.abs(speed[near] - 0.316) < np.hypot(error[near], 0.026))
    assert np.all(np.abs(tracks["pm_pa"][near].value - 120) < 10)
    # And nothing faster, or inwards.
    assert np.all(speed < 0.5)
    assert np.all((tracks["turn"].value < 30) | core)


def test_names_stay_when_epochs_are_added(tracker, tracking):
    cube, decompositions = jet()
    fewer = tracker(cube[:9], decompositions[:9])
    assert fewer.names == tracking.names


def test_names_are_different_where_places_round_to_one(tracking):
    ssps = tracking.ssps
    names = replace(tracking, ssps=replace(ssps, y=0 * ssps.y, x=0 * ssps.x)).names
    first = [name for name in names if "_s1_" in name]
    assert first == ["20000101_s1_+2.0-2.0" + end for end in ("", ".2", ".3")]


def test_matches_may_be_those_of_a_measurement(tracker, tracking):
    cube, decompositions = jet()
    matches = Correlator(kappa=0.5)(decompositions, all_pairs(12), 40)
    same = tracker(cube, decompositions, matches)
    assert np.array_equal(same.links.source, tracking.links.source)
    assert np.array_equal(same.links.target, tracking.links.target)


@pytest.mark.slow
def test_ranges_of_speed_along_and_across(tracking):
    cube, decompositions = jet()
    narrow = FeatureTracker(
        position_angle=-90 * u.deg, along=[0.4, 0.8] * PM, across=[-0.1, 0.1] * PM,
        tolerance=0.05,
    )(cube, decompositions)  # fmt: skip
    assert narrow.tracks["pm"].to_value(PM) == pytest.approx([0.6, 0.6], abs=0.02)
    radial = FeatureTracker(
        position_angle="radial", along=[0.2, 0.8] * PM, max_speed=1 * PM
    )
    found = radial(cube, decompositions).tracks
    assert np.sum(found["pm"].value > 0.2) == 4
    half = FeatureTracker(
        position_angle=-90 * u.deg, across=[-0.1, 0.1] * PM, max_speed=1 * PM
    )
    assert len(half(cube, decompositions).tracks) >= 2


def test_images_without_beams_and_long_intervals():
    cube, decompositions = jet(beams=False)
    assert len(FeatureTracker(max_speed=1.5 * PM)(cube, decompositions).tracks) == 6
    none = FeatureTracker(max_speed=1.5 * PM, max_interval=0.1 * u.yr)
    tracking = none(cube, decompositions)
    assert len(tracking.tracks) == len(tracking.features) == 0
    assert tracking.tracks.colnames[0] == "track"
    assert tracking.tracks["pm"].unit == PM
    assert "sky" in tracking.features.colnames
    assert plain_table(tracking.features)["pm_dec"].unit == PM
    assert len(tracking.profile([1.0] * u.mas)) == 0


def test_only_selected_ssps_are_tracked(tracker, tracking):
    cube, decompositions = jet()
    select = tracking.ssps.x < 75
    before = select.copy()
    found = tracker(cube, decompositions, select=select, n_trials=1, rng=1)
    assert np.all(select[found.track >= 0])
    assert np.array_equal(select, before)
    assert found.n_tracks == 4


@pytest.mark.parametrize(
    ("setting", "error", "message"),
    [
        (
            {"max_speed": -1 * PM},
            ValueError,
            "max_speed = -1.0 mas / yr must be finite and",
        ),
        (
            {"max_speed": 1 * u.mas},
            u.UnitConversionError,
            "max_speed = 1.0 mas must be an angle per time",
        ),
        (
            {"max_interval": [1, 2] * u.yr},
            ValueError,
            "max_interval = .* must be a time with a unit",
        ),
        (
            {"along": [1, 0] * PM},
            ValueError,
            "along = .* must be a smallest and a largest",
        ),
        ({"along": [0, 1] * PM}, ValueError, "along and across need a position_angle"),
        ({"position_angle": "ridge"}, ValueError, "must be an angle or 'radial'"),
        (
            {"position_angle": "up"},
            ValueError,
            "or an angle with a unit, such as '65 deg'",
        ),
        ({"tolerance": 0}, ValueError, "tolerance = 0 must be a part of the beam"),
        ({"max_gap": -1}, ValueError, "max_gap = -1 must be 0 or more"),
        ({"min_epochs": 2}, ValueError, "min_epochs = 2 must be 3 or more"),
        ({"kappa": 2}, ValueError, "kappa must be between 0 and 1"),
    ],
)
def test_settings_that_make_no_sense_are_refused(setting, error, message):
    with pytest.raises(error, match=message):
        FeatureTracker(**setting)


def test_settings_may_be_text():
    text = FeatureTracker(
        max_speed="2 mas/yr",
        position_angle="-112deg",
        along="-1 4 mas/yr",
        max_interval="365.25 d",
    )
    assert text.max_speed == 2 * PM
    assert text.position_angle == -112 * u.deg
    assert (text.max_interval, text.along.unit) == (1 * u.yr, PM)
    assert text.along.value.tolist() == [-1, 4]


def test_what_does_not_go_together_is_refused(tracker):
    cube, decompositions = jet(n_epochs=3)
    nothing = [Decomposer(scales=[1, 2])(0 * image) for image in cube.data]
    with pytest.raises(
        ValueError, match=r"no significant pattern \(SSP\) in any epoch"
    ):
        tracker(cube, nothing)
    with pytest.raises(ValueError, match="2 decompositions for 3 epochs"):
        tracker(cube, decompositions[:2])
    with pytest.raises(ValueError, match="n_trials must be 0 or more"):
        tracker(cube, decompositions, n_trials=-1)
    with pytest.raises(ValueError, match="select must be one bool for each of the"):
        tracker(cube, decompositions, select=[True])
    with pytest.raises(ValueError, match="needs epochs of two different dates"):
        tracker(cube[:1], decompositions[:1])
