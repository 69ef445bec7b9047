# Licensed under a 3-clause BSD style license - see LICENSE.rst
import json

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.epochs import Beam
from astro_scc.simulation import (
    JetSimulation,
    Stream,
    simulate_ballistic,
    simulate_random_velocity,
    simulate_static,
    simulate_two_fluid,
    simulate_unrelated,
    write_simulation,
)

PRESETS = {
    "two-fluid": simulate_two_fluid,
    "random": simulate_random_velocity,
    "ballistic": simulate_ballistic,
    "static": simulate_static,
    "unrelated": simulate_unrelated,
}


def steps(truth, name="x"):
    """Motion of every feature between consecutive epochs, in pixels."""
    table = truth.group_by("feature")
    return np.concatenate([np.diff(part[name].value) for part in table.groups])


def seen(truth, n_epochs=10):
    """Number of features between x = 20 and 220 at each epoch."""
    inside = (truth["x"] >= 20 * u.pix) & (truth["x"] <= 220 * u.pix)
    return np.bincount(truth["epoch"][inside], minlength=n_epochs)


# The paper's jets -------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "options"),
    [("two_fluid", {}), ("two_fluid_dense", {"dense": True}), ("random", None)],
)
def test_like_the_jets_of_the_paper(shared_data, folder, options):
    """The same numbers of features, fluxes, widths and peaks, within errors."""
    paper = json.loads((shared_data / "paper_test" / folder / "truth.json").read_text())
    jets = [
        simulate_random_velocity(rng=seed)
        if options is None
        else simulate_two_fluid(rng=seed, **options)
        for seed in range(8)
    ]
    for group in paper["config"]["groups"]:
        name = group["name"]
        truths = [jet.truth[jet.truth["group"] == name] for jet in jets]
        counts = [seen(truth).mean() for truth in truths]
        expected = np.mean(paper["n_visible_per_epoch"][name])
        assert np.mean(counts) == pytest.approx(expected, rel=0.1)

        theirs = [f for f in paper["features"] if f["group"] == name]
        x = np.array([f["x"] for f in theirs])
        y = np.array([f["y"] for f in theirs])
        ours = np.concatenate([steps(truth) for truth in truths])
        assert ours.mean() == pytest.approx(np.diff(x).mean(), abs=0.6)
        assert ours.std() == pytest.approx(np.diff(x).std(), rel=0.12)
        across = np.concatenate([steps(truth, "y") for truth in truths])
        assert across.std() == pytest.approx(np.diff(y).std(), rel=0.12)
        first = np.concatenate([t["y"].value[t["epoch"] == 0] for t in truths])
        assert first.std() == pytest.approx(y[:, 0].std(), rel=0.25)
        widths = np.concatenate([t["fwhm"].to_value(u.mas) * 10 for t in truths])
        assert 2 <= widths.min() <= widths.max() <= 6

    peak = np.mean([jet.cube.data.max(axis=(1, 2)).mean() for jet in jets])
    assert peak == pytest.approx(
        np.mean([e["clean_peak"] for e in paper["epochs"]]), rel=0.15
    )


def test_images_of_the_paper_from_their_truth(shared_data):
    """Our image of their features is their image, but for the noise."""
    from astro_scc.components.restoring import add_gaussians

    folder = shared_data / "paper_test" / "two_fluid"
    paper = json.loads((folder / "truth.json").read_text())
    x = np.array([f["x"] for f in paper["features"]])
    y = np.array([f["y"] for f in paper["features"]])
    width = np.array([f["fwhm"] for f in paper["features"]])
    peak = np.array([f["peak"] for f in paper["features"]])
    jet = JetSimulation([Stream("all", half_width=1.0)])
    visibility = jet.visibility(x)
    total = (width**2 + 100) / (8 * np.log(2))
    for i, path in enumerate(sorted(folder.glob("*.fits"))):
        image = add_gaussians(
            np.zeros((128, 256)),
            x[:, i],
            y[:, i],
            peak * visibility[:, i],
            total[:, None, None] * np.eye(2),
        )
        residual = fits.getdata(path) - image
        assert residual.std() == pytest.approx(0.002, rel=0.01)
        assert np.abs(residual).max() < 0.01


# Laws of motion ---------------------------------------------------------------


def test_unrelated_epochs_share_no_feature():
    truth = simulate_unrelated(rng=1, n_epochs=4).truth
    assert len(set(truth["feature"])) == len(truth)
    assert list(seen(truth, 4)) == [36] * 4
    assert np.all(np.isnan(truth["pm_east"]))


def test_velocity_field_is_followed():
    def field(x, y):
        return 0.1 * x

    stream = Stream("flow", dx=field, half_width=0.0, density=2.0)
    truth = JetSimulation([stream], n_epochs=3, noise=0).run(rng=1).truth
    for part in truth.group_by("feature").groups:
        x = part["x"].value
        np.testing.assert_allclose(x[1:], 1.1 * x[:-1])
    across = Stream("flow", dx=(1, 2), dy=lambda x, y: 64 - y, half_width=9.0)
    truth = JetSimulation([across], n_epochs=3, noise=0).run(rng=1).truth
    np.testing.assert_allclose(truth["y"].value[truth["epoch"] > 0], 64)


@settings(max_examples=15, deadline=None)
@given(speed=st.floats(-30, 30), jitter=st.floats(0, 3), seed=st.integers(0, 99))
def test_region_stays_populated(speed, jitter, seed):
    stream = Stream("s", dx=speed, density=20.0, half_width=5.0, jitter=jitter)
    jet = JetSimulation([stream])
    x = stream.features(jet, np.random.default_rng(seed)).x
    inside = ((x >= 20) & (x <= 220)).sum(axis=0)
    # 400 on average, of a binomial.
    assert np.all(np.abs(inside - 400) < 100)


# Images and truth -------------------------------------------------------------


def test_images_show_the_truth():
    stream = Stream("s", dx=7.0, dy=1.0, half_width=10.0, density=0.05)
    jet = JetSimulation([stream], n_epochs=2, noise=0, taper=0).run(rng=4)
    cube, truth = jet.cube, jet.truth
    assert truth["visible"].any()
    for i in range(2):
        rows = truth[(truth["epoch"] == i) & truth["visible"]]
        pixels_a_beam = (cube.beams[i].area / (0.1 * u.mas) ** 2).to_value(u.one)
        total = cube.data[i].sum() / pixels_a_beam
        assert total == pytest.approx(rows["flux"].sum().value, rel=1e-3)
        for row in rows:
            x, y = row["x"].value, row["y"].value
            sky = cube.wcs.pixel_to_world_values(x, y)
            east = ((sky[0] - 180) * u.deg).to_value(u.mas)
            assert east == pytest.approx(row["east"].to_value(u.mas), abs=1e-6)
            north = (sky[1] * u.deg).to_value(u.mas)
            assert north == pytest.approx(row["north"].to_value(u.mas), abs=1e-6)


def test_truth_columns_and_motions():
    jet = simulate_two_fluid(rng=2, jitter=0.0)
    truth = jet.truth
    names = "feature group epoch date x y east north flux fwhm visible pm_east pm_north"
    assert truth.colnames == names.split()
    slow = truth["group"] == "slow"
    np.testing.assert_allclose(
        truth["pm_east"][slow].to_value(u.mas / u.yr), -5 * 1.2175
    )
    np.testing.assert_allclose(truth["pm_north"].value, 0, atol=1e-9)
    assert np.all(truth["date"][truth["epoch"] == 3] == jet.cube.times[3])
    assert truth.meta["velocity_unit"].to_value(u.mas / u.yr) == pytest.approx(1.2175)
    n = len(set(truth["feature"]))
    assert repr(jet) == f"<SimulatedJet 'two-fluid': 10 epochs, {n} features>"


@pytest.mark.parametrize("name", PRESETS)
def test_seeds(name):
    simulate = PRESETS[name]
    one, again = simulate(n_epochs=2, rng=7), simulate(n_epochs=2, rng=7)
    np.testing.assert_array_equal(one.cube.data, again.cube.data)
    assert len(one.truth) == len(again.truth)
    other = simulate(n_epochs=2, rng=8)
    assert not np.array_equal(one.cube.data, other.cube.data)
    generator = simulate(n_epochs=2, rng=np.random.default_rng(7))
    np.testing.assert_array_equal(one.cube.data, generator.cube.data)
    quiet = simulate(n_epochs=2, rng=7, noise=0.0)
    np.testing.assert_array_equal(one.truth["x"], quiet.truth["x"])


# What is refused --------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"motion": "circular"}, "motion = .* must be one of"),
        ({"sigma": 3.0}, "needs one of half_width and sigma"),
        ({"half_width": None}, "needs one of half_width and sigma"),
        ({"density": -1.0}, "density must be zero or positive"),
        ({"jitter": np.nan}, "jitter must be zero or positive"),
        ({"half_width": np.inf}, "half_width must be zero or positive"),
        ({"fwhm": (6.0, 2.0)}, "fwhm must be two limits"),
        ({"peak": (-1.0, 2.0)}, "peak must be two limits"),
        ({"dx": (1.0, 2.0, 3.0)}, "dx must be a number, two limits"),
        ({"dy": np.nan}, "dy must be a number, two limits"),
    ],
)
def test_bad_streams(options, message):
    with pytest.raises(ValueError, match=f"stream 's'.*{message}"):
        Stream("s", **{"half_width": 5.0, **options})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"streams": Stream("s", half_width=5.0)}, "sequence of Stream"),
        ({"streams": []}, "at least one Stream"),
        ({"n_epochs": 0}, "n_epochs must be at least 1"),
        ({"dates": Time("2001-01-01")}, "array of increasing times"),
        ({"dates": Time(["2001-01-02", "2001-01-01"])}, "array of increasing times"),
        ({"beams": [Beam(1 * u.mas, 1 * u.mas)]}, "10 epochs need 10 beams, got 1"),
        ({"beams": []}, "beams and noise need one value, or one for each epoch"),
        ({"noise": ()}, "beams and noise need one value, or one for each epoch"),
        ({"extent": (220.0, 20.0)}, "extent must be"),
        ({"noise": -1.0}, "noise must be zero or positive"),
        ({"taper": -1.0}, "taper must be zero or positive"),
        ({"core": np.nan}, "core must be zero or positive"),
    ],
)
def test_bad_simulations(options, message):
    with pytest.raises(ValueError, match=message):
        JetSimulation(**{"streams": [Stream("s", half_width=5.0)], **options})


def test_proper_motion_of_the_wrong_kind():
    with pytest.raises(u.UnitConversionError):
        simulate_two_fluid(slow=5 * u.km / u.s)


# Files ------------------------------------------------------------------------


def test_written_simulation(tmp_path):
    jet = simulate_two_fluid(n_epochs=3, rng=1)
    *images, table = write_simulation(jet, tmp_path / "jet")
    assert len(images) == 3
    assert table.name == "truth.ecsv"
    assert sorted((tmp_path / "jet").iterdir()) == sorted([*images, table])
    truth = QTable.read(table)
    np.testing.assert_allclose(truth["x"].value, jet.truth["x"].value)
    assert truth["flux"].unit == u.Jy
    assert truth.meta["streams"][1]["dx"] == 20.0
    header = fits.getheader(images[2])
    assert header["DATE-OBS"].startswith("2000-03-01")
    assert (header["CRPIX1"], header["CRPIX2"]) == (21, 65)
    assert header["CDELT1"] < 0
    assert header["BMAJ"] == pytest.approx((1 * u.mas).to_value(u.deg))
    with pytest.raises(OSError, match="truth.ecsv: exists already"):
        write_simulation(jet, tmp_path / "jet")
    assert write_simulation(jet, tmp_path / "jet", overwrite=True)[-1] == table
