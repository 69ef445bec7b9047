# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Simulated jets: those of the paper, as surveys see them, and resolved ones."""

import json

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from astro_scc.epochs.restoring import add_gaussians
from astro_scc.simulation import (
    Flow,
    JetSimulation,
    Layer,
    Stream,
    m87_layers,
    simulate_jet,
    simulate_resolved_jet,
    simulate_shell,
    simulate_two_fluid,
    write_simulation,
)
from astro_scc.simulation.streams import raised_cosine


def test_images_of_the_paper_from_their_truth(shared_data):
    """Our image of their features is their image, but for the noise."""
    folder = shared_data / "paper_test" / "two_fluid"
    paper = json.loads((folder / "truth.json").read_text())["features"]
    names = ("x", "y", "fwhm", "peak")
    x, y, width, peak = (np.array([f[name] for f in paper]) for name in names)
    visible = raised_cosine(np.minimum(x - 20, 220 - x) / 10)
    covariance = ((width**2 + 100) / (8 * np.log(2)))[:, None, None] * np.eye(2)
    for i, path in enumerate(sorted(folder.glob("*.fits"))[:3]):
        image = np.zeros((128, 256))
        add_gaussians(image, x[:, i], y[:, i], peak * visible[:, i], covariance)
        residual = fits.getdata(path) - image
        assert residual.std() == pytest.approx(0.002, rel=0.01)
        assert np.abs(residual).max() < 0.01


def test_velocity_field_is_followed():
    stream = Stream("flow", dx=lambda x, y: 0.1 * x, half_width=0.0, density=2.0)
    truth = JetSimulation([stream], n_epochs=3, noise=0).run(rng=1).truth
    for part in truth.group_by("feature").groups:
        x = part["x"].value
        assert_allclose(x[1:], 1.1 * x[:-1])


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


def test_peaks_are_where_the_truth_has_them():
    jet = simulate_jet(
        streams=[], standing=(5.0,), position_angle=200 * u.deg,
        alignment_error=0.3, noise=0.0, core_flux=1.0, rng=2,
    )  # fmt: skip
    core = jet.truth[jet.truth["group"] == "core"]
    still = jet.truth[jet.truth["group"] == "standing"]
    pixels_a_beam = (jet.cube.beams[0].area / (0.1 * u.mas) ** 2).to_value(u.one)
    for image, row, other in zip(jet.cube.data, core, still, strict=True):
        y, x = np.unravel_index(np.argmax(image), image.shape)
        assert max(abs(x - row["x"].value), abs(y - row["y"].value)) <= 0.5
        total = row["flux"].value + other["flux"].value
        assert image.sum() / pixels_a_beam == pytest.approx(total, rel=1e-3)


@pytest.mark.parametrize("kind", ["knots", "ring"])
def test_a_feature_of_a_shell_moves_away_from_the_centre_at_its_rate(kind):
    number = {"n_knots": 1, "n_clumps": 0} if kind == "knots" else {"n_knots": 0}
    options = {"background": 0.0, "counts": 1e4, "n_clumps": 1, **number}
    shell = simulate_shell(n_epochs=3, interval=15 * u.yr, rng=3, **options)
    (row,), rate = shell.truth, 0.11 if kind == "knots" else 0.07
    assert (row["group"], row["rate"]) == (kind, rate * u.percent / u.yr)
    y, x = np.indices(shell.cube.shape[1:])
    for image, year in zip(shell.cube.data, shell.cube.years.value, strict=True):
        middle = [np.average(axis, weights=image) for axis in (x, y)]
        found = u.Quantity(shell.cube.pixel_to_offset(*middle)) - shell.centre
        expected = u.Quantity([row["east"], row["north"]]) * (1 + rate / 100 * year)
        assert u.allclose(found, expected, atol=0.05 * u.arcsec)


ONE = Stream("s", half_width=5.0)
TABLE = {
    "distance": [0.5, 2.0, 6.0] * u.mas,
    "speed": [1.0, 8.0, 10.0] * u.mas / u.yr,
    "half_width": [0.2, 0.4, 0.6] * u.mas,
    "brightness": [20, 10, 5] * u.mJy / u.beam,
}
NEEDED = {Stream: {"name": "s", "half_width": 5.0}, Flow: {"name": "s"},
          JetSimulation: {"streams": [ONE]}, Layer: {"name": "l"} | TABLE}  # fmt: skip


def test_what_is_refused():
    for make, options, message in [
        (Stream, {"sigma": 3.0}, "needs one of half_width and sigma"),
        (Stream, {"fwhm": (6.0, 2.0)}, "fwhm must be two limits"),
        (Stream, {"dx": (1.0, 2.0, 3.0)}, "dx must be a number, two limits"),
        (Flow, {"positions": (2.0,)}, "they are those of standing features"),
        (Flow, {"acceleration": 0.0}, "acceleration must be positive"),
        (JetSimulation, {"streams": ONE}, "sequence of Stream"),
        (JetSimulation, {"dates": Time([2001, 2000], format="jyear")}, "increasing ti"),
        (JetSimulation, {"noise": ()}, "beams and noise need one value"),
        (JetSimulation, {"extent": (220.0, 20.0)}, "extent must be"),
        (simulate_shell, {"n_epochs": 1}, "n_epochs must be at least 2"),
        (simulate_shell, {"size": 100}, "larger than 100 pixels can show"),
        (simulate_jet, {"length": np.nan}, "length must be zero or positive"),
        (simulate_jet, {"streams": [Flow()], "speed": 1.0, "size": 0.1},
         "speed, size: give them to"),
        (Layer, {"speed": [0, 1, 1] * u.mas / u.yr}, "speed must be positive, or zero"),
        (Layer, {"across": ()}, "across needs one place or more"),
        (Layer, {"speed": [1, 1] * u.mas / u.yr}, "brightness must have one len"),
        (Layer, {"distance": [1, 1, 2] * u.mas}, "distance must increase, got"),
        (Layer, {"size": (2, 1) * u.mas}, "size must be two limits, got"),
        (Layer, {"life": np.inf * u.yr}, "life must be positive, and finite for a l"),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match=message):
            make(**NEEDED.get(make, {}) | options)


def test_written_simulation(tmp_path):
    jet = simulate_two_fluid(n_epochs=3, rng=1)
    *images, table = write_simulation(jet, tmp_path / "jet")
    assert (len(images), table.name) == (3, "truth.ecsv")
    assert sorted((tmp_path / "jet").iterdir()) == sorted([*images, table])
    assert QTable.read(table).meta["streams"][1]["dx"] == 20.0
    with pytest.raises(OSError, match="truth.ecsv: exists already"):
        write_simulation(jet, tmp_path / "jet")
    assert write_simulation(jet, tmp_path / "jet", overwrite=True)[-1] == table


def lone_clump():
    """A jet whose one clump is visible at all epochs."""
    own = Layer("layer", **TABLE, n_clumps=1, life=0.6 * u.yr)
    how = {"core": 0.0, "flux_variation": 0.0, "noise": 0.0, "n_epochs": 6}
    how |= {"layers": [own], "interval": 10 * u.day}
    jets = (simulate_resolved_jet(**how, rng=seed) for seed in range(50))
    return next(k for k in jets if len(k.truth) == 6 and k.truth["visible"].all())


def test_the_centroid_of_a_clump_moves_by_its_speed_at_each_distance():
    jet = lone_clump()
    east, north = (jet.truth[name].to_value(u.mas) for name in ("east", "north"))
    sine, cosine = np.sin(288 * u.deg).value, np.cos(288 * u.deg).value
    r, across = east * sine + north * cosine, east * cosine - north * sine
    years = (jet.cube.times - jet.cube.times[0]).to_value(u.yr)
    distance, speed, width = (v.value for v in [*TABLE.values()][:3])
    way = solve_ivp(lambda t, r: np.interp(r, distance, speed), years[[0, -1]], r[:1],
                    t_eval=years, rtol=1e-8)  # fmt: skip
    assert np.ptp(r) > 0.5
    assert_allclose(r, way.y[0], atol=1e-3)
    # It keeps its place in the jet, which widens.
    place = across / np.interp(r, distance, width)
    assert_allclose(place, place[0])
    y, x = np.indices(jet.cube.shape[1:])
    for image, row in zip(jet.cube.data, jet.truth, strict=True):
        assert np.sum(x * image) / image.sum() == pytest.approx(row["x"].value)
        assert np.sum(y * image) / image.sum() == pytest.approx(row["y"].value)


def test_layers_of_m87():
    _, fast = m87_layers(length=20 * u.mas)
    at = np.interp([0.5, 2, 20], fast.distance.value, fast.speed.value) * 0.264
    assert_allclose(at, [0.3, 2.3, 2.7], rtol=0.01)
    with pytest.raises(ValueError, match="layers: give a sequence of Layer, at least"):
        simulate_resolved_jet(layers=[])
    with pytest.raises(ValueError, match=r"length must be above 0.5 mas, got 0.2 mas"):
        m87_layers(length=0.2 * u.mas)
