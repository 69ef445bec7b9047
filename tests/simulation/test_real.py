# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Jets as surveys see them."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc.simulation import Flow, simulate_jet

# Nothing but the features.
BARE = {"core_flux": 0.0, "noise": 0.0, "flux_variation": 0.0}


def outward(truth):
    """Speed of each row away from the core, in beams of 0.8 mas an interval."""
    pm = np.hypot(truth["pm_east"], truth["pm_north"])
    return (pm * 0.2 * u.yr / (0.8 * u.mas)).to_value(u.one)


def test_peaks_are_where_the_truth_has_them():
    jet = simulate_jet(
        streams=[], standing=(5.0,), position_angle=200 * u.deg,
        alignment_error=0.3, noise=0.0, core_flux=1.0, rng=2,
    )  # fmt: skip
    for image, i in zip(jet.cube.data, range(len(jet.cube)), strict=True):
        rows = jet.truth[jet.truth["epoch"] == i]
        core = rows[rows["group"] == "core"][0]
        y, x = np.unravel_index(np.argmax(image), image.shape)
        assert abs(x - core["x"].value) <= 0.5
        assert abs(y - core["y"].value) <= 0.5
    still = jet.truth[jet.truth["group"] == "standing"]
    east, north = still["east"].to_value(u.mas), still["north"].to_value(u.mas)
    assert np.ptp(east) == pytest.approx(0, abs=1e-9)
    assert np.hypot(east, north)[0] == pytest.approx(5 * 0.8, rel=0.02)
    angle = np.degrees(np.arctan2(east[0], north[0])) % 360
    assert angle == pytest.approx(200, abs=12)
    shifts = still["x"].value - still["x"].value.mean()
    assert np.std(shifts) == pytest.approx(0.3 * 8, rel=0.5)


@pytest.mark.parametrize(
    ("distribution", "dispersion", "spread"),
    [("normal", 0.2, 0.2), ("uniform", 0.3, 0.3), ("lognormal", 0.4, 0.4165)],
)
def test_speeds_have_their_mean_and_dispersion(distribution, dispersion, spread):
    flow = Flow(speed=0.6, dispersion=dispersion, distribution=distribution)
    speeds = flow.speeds((np.arange(100000) + 0.5) / 100000)
    assert speeds.mean() == pytest.approx(0.6, rel=0.002)
    assert speeds.std() == pytest.approx(0.6 * spread, rel=0.01)
    assert speeds.min() >= 0.06


@pytest.mark.parametrize("options", [{}, {"dispersion": 0.3}, {"acceleration": 1.6}])
def test_number_of_features_in_view(options):
    jet = simulate_jet(rng=1, shape=(8, 8)).simulation
    rng = np.random.default_rng(1)
    drawn = [Flow(**options).features(jet, rng) for _ in range(60)]
    counts = [np.mean(np.sum(features.flux > 0, axis=0)) for features in drawn]
    assert np.mean(counts) == pytest.approx(8, rel=0.04)


def test_truth_has_the_speeds_of_the_features_in_view():
    truth = simulate_jet(rng=1, dispersion=0.2).truth
    flow = truth.meta["streams"][0]
    moving = truth[(truth["group"] == "flow") & truth["visible"]]
    speeds = [
        -part["pm_east"].value.mean()
        for part in moving.group_by("feature").groups
        if len(part) > 1
    ]
    assert flow["n_seen"] == len(speeds)
    assert flow["mean_speed"].to_value(u.mas / u.yr) == pytest.approx(np.mean(speeds))
    spread = flow["std_speed"].to_value(u.mas / u.yr)
    assert spread == pytest.approx(np.std(speeds, ddof=1))
    assert np.mean(speeds) == pytest.approx(0.6 * 0.8 / 0.2, rel=0.3)


@pytest.mark.parametrize("acceleration", [0.5, 1.6])
def test_acceleration(acceleration):
    truth = simulate_jet(
        rng=1, dispersion=0.0, acceleration=acceleration, interval_scatter=0.0,
        interval=0.01 * u.yr, speed=0.03, n_features=60, **BARE,
    ).truth  # fmt: skip
    slope, start = np.polyfit(
        np.abs(truth["east"].value), -truth["pm_east"].value * 0.01 / 0.8 / 0.03, 1
    )
    length = 16 * 0.8
    assert start == pytest.approx(2 / (1 + acceleration), rel=0.02)
    assert start + slope * length == pytest.approx(
        2 * acceleration / (1 + acceleration), rel=0.02
    )


def test_features_fade_and_widen():
    truth = simulate_jet(rng=1, n_features=80, **BARE).truth
    s = np.abs(truth["east"].value) / 0.8
    near, far = (s > 0.5) & (s < 2), (s > 10) & (s < 13)
    assert truth["flux"][far].mean() < 0.4 * truth["flux"][near].mean()
    expected = 0.25 * 0.8 * (1 + s) ** 0.6
    np.testing.assert_allclose(truth["fwhm"].to_value(u.mas), expected, rtol=1e-6)


def test_streams_have_their_own_sizes_and_places():
    spine = Flow("spine", speed=0.9, size=0.2, widening=0.0, width=0.1)
    sheath = Flow("sheath", speed=0.3, size=0.8, widening=0.0, offset=1.5, width=0.1)
    truth = simulate_jet(rng=1, streams=[spine, sheath], flux_variation=0).truth
    a, b = (truth[truth["group"] == name] for name in ("spine", "sheath"))
    assert np.all(a["fwhm"] < b["fwhm"][0])
    far = np.abs(b["east"].value) > 8
    # At position angle 270 deg, larger angles are to the north.
    assert b["north"][far].value.min() > 0.8 > np.abs(a["north"].value).max()
    assert np.nanmean(outward(a)) == pytest.approx(0.9, rel=0.15)
    assert np.nanmean(outward(b)) == pytest.approx(0.3, rel=0.15)


def test_artefacts():
    clean = simulate_jet(rng=1, noise=0.0).cube
    rippled = simulate_jet(rng=1, noise=0.0, ripple=0.01).cube
    hollow = simulate_jet(rng=1, noise=0.0, bowl=0.01).cube
    wave = (rippled.data - clean.data) / clean.data.max(axis=(1, 2), keepdims=True)
    assert 0.005 < np.abs(wave).max() <= 0.01
    assert not np.array_equal(wave[0], wave[1])
    assert rippled.noise is None
    bowls = hollow.data - clean.data
    assert bowls.max() <= 0
    depth = -bowls.min(axis=(1, 2)) / clean.data.max(axis=(1, 2))
    assert np.all((depth > 0.009) & (depth < 0.03))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"distribution": "flat"}, "distribution = .* must be one of"),
        ({"positions": (2.0,)}, "they are those of standing features"),
        ({"positions": (-2.0,), "speed": 0}, "positions must be zero or positive"),
        ({"dispersion": -1.0}, "dispersion must be zero or positive"),
        ({"speed": np.nan}, "speed must be zero or positive"),
        ({"acceleration": 0.0}, "acceleration must be positive"),
    ],
)
def test_bad_flows(options, message):
    with pytest.raises(ValueError, match=f"flow 'f'.*{message}"):
        Flow("f", **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_epochs": 0}, "n_epochs must be at least 1"),
        ({"alignment_error": -1.0}, "alignment_error must be zero or positive"),
        ({"flux_variation": np.nan}, "flux_variation must be zero or positive"),
        ({"length": 0.0}, "extent must be"),
        ({"streams": [Flow()], "speed": 1.0, "size": 0.1}, "speed, size: give them to"),
        ({"length": np.nan}, "length must be zero or positive"),
        ({"noise_scatter": -1}, "noise_scatter must be zero or positive"),
        ({"noise": -0.001}, r"noise must be zero or positive, got -0.00\d+$"),
        ({"standing": -1}, "flow 'standing': n_features must be zero or positive"),
        ({"interval_scatter": np.nan}, "interval_scatter must be zero or positive"),
        ({"interval": -1 * u.yr}, "dates must be an array of increasing times"),
    ],
)
def test_bad_jets(options, message):
    with pytest.raises(ValueError, match=message):
        simulate_jet(**options)
