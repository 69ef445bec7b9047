# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Simulated jets imaged from visibilities."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

from astro_scc.epochs import Beam
from astro_scc.epochs.restoring import add_gaussians
from astro_scc.simulation import observe, simulate_jet
from astro_scc.simulation.vlbi import (
    _coverage,
    _dirty_beam,
    _fitted_beam,
    _transform,
    _visibilities,
)

SMALL = {"shape": (80, 160), "n_epochs": 1, "length": 8.0}


@pytest.fixture(scope="module")
def uv():
    return _coverage(20 * u.deg, 15.4 * u.GHz, 8, np.random.default_rng(1))


def test_longest_and_shortest_baselines(uv):
    """St. Croix to Mauna Kea are 8611 km, Pie Town to Los Alamos 236 km."""
    length = np.hypot(*uv[0].T) * 0.29979 / 15.4 / 1e3
    assert 8000 < length.max() <= 8612
    assert 100 < length.min() < 237
    first, second, scan = uv[1]
    assert set(first) | set(second) == set(range(10))
    assert set(scan) == set(range(8))


def test_stations_that_do_not_see_the_source_are_left_out():
    rng = np.random.default_rng(1)
    south, _ = _coverage(-30 * u.deg, 15.4 * u.GHz, 8, rng)
    north, _ = _coverage(60 * u.deg, 15.4 * u.GHz, 8, rng)
    assert len(south) < 0.8 * len(north)


def test_visibilities_are_the_transform_of_the_brightness(uv):
    """Against a sum over a finely drawn image of the features."""
    jet = simulate_jet(rng=1, **SMALL, noise=0.0, n_features=4)
    truth = jet.truth
    truth["fwhm"] = np.maximum(truth["fwhm"], 0.3 * u.mas)
    sigma = truth["fwhm"].to_value(u.mas) * 10 / np.sqrt(8 * np.log(2))
    image = add_gaussians(
        np.zeros((80, 160)),
        truth["x"].value,
        truth["y"].value,
        truth["flux"].value / (2 * np.pi * sigma**2),
        sigma[:, None, None] ** 2 * np.eye(2),
    )
    y, x = np.indices(image.shape)
    scale = (0.1 * u.mas).to_value(u.rad)
    east = -(x - jet.simulation.extent[0]).ravel() * scale
    north = (y - jet.simulation.axis).ravel() * scale
    some = uv[0][::40]
    phase = np.outer(some[:, 0], east) + np.outer(some[:, 1], north)
    expected = np.exp(-2j * np.pi * phase) @ image.ravel()
    found = _visibilities(truth, jet.simulation, some)
    np.testing.assert_allclose(found, expected, atol=2e-4 * truth["flux"].sum().value)


def test_transform_against_a_plain_sum(uv):
    uv = uv[0][:50]
    rng = np.random.default_rng(2)
    visibility = rng.normal(size=50) + 1j * rng.normal(size=50)
    east, north = np.array([0.0, 1e-9, 5e-9]), np.array([-3e-9, 2e-9])
    image = _transform(visibility, uv, east, north)
    for i, m in enumerate(north):
        for k, l_ in enumerate(east):
            terms = visibility * np.exp(2j * np.pi * (uv[:, 0] * l_ + uv[:, 1] * m))
            assert image[i, k] == pytest.approx(terms.mean().real)


def test_the_fitted_beam_is_the_main_lobe(uv):
    jet = simulate_jet(rng=1, **SMALL)
    pixel = 0.1 * u.mas
    uv = uv[0][uv[0][:, 0] * uv[0][:, 1] < 0]  # A beam that is inclined.
    psf = _dirty_beam(uv, pixel.to_value(u.rad), (40, 60))
    assert psf.shape == (79, 119)
    np.testing.assert_allclose(psf, psf[::-1, ::-1], atol=1e-12)
    assert psf[39, 59] == psf.max() == pytest.approx(1.0)
    beam = _fitted_beam(psf, pixel)
    covariance = jet.simulation.covariance(beam)
    model = add_gaussians(np.zeros(psf.shape), [59], [39], [1.0], [covariance])
    lobe = model > 0.5
    np.testing.assert_allclose(psf[lobe], model[lobe], atol=0.06)


def test_a_perfect_observation_gives_the_image_of_the_features():
    """Without errors and noise: the features in the restoring beam."""
    beam = Beam(1 * u.mas, 0.6 * u.mas, -10 * u.deg)
    jet = simulate_jet(rng=1, **SMALL, noise=0.0, beam=beam)
    seen = observe(jet, gain_error=0.0, beam=beam, n_scans=12, rng=1)
    assert seen.cube.beams == (beam,)
    assert seen.truth is jet.truth
    assert np.abs(seen.cube.data - jet.cube.data).max() < 0.02 * jet.cube.data.max()


def test_the_beam_shrinks_with_the_frequency():
    jet = simulate_jet(rng=1, **SMALL)
    low, high = (
        observe(jet, frequency=f * u.GHz, n_iterations=0, rng=1).cube.beams[0]
        for f in (8.4, 15.4)
    )
    assert (low.area / high.area).value == pytest.approx((15.4 / 8.4) ** 2, rel=0.1)


def test_noise_is_that_of_the_simulation():
    jet = simulate_jet(rng=1, **SMALL, noise=0.002, noise_scatter=0, n_features=0)
    seen = observe(jet, gain_error=0.0, rng=1)
    assert seen.cube.noise is None
    away = seen.cube.data[0, :20]
    assert away.std() == pytest.approx(0.002, rel=0.2)


def test_errors_of_the_gains_leave_artefacts():
    jet = simulate_jet(rng=1, **SMALL, noise=0.0)
    rms = [
        observe(jet, gain_error=e, n_iterations=300, rng=1).cube.data[0, :20].std()
        for e in (0.0, 0.01, 0.04)
    ]
    assert rms[0] < rms[1] < rms[2]


def test_epochs_have_their_own_coverage_and_seeds_repeat():
    jet = simulate_jet(rng=1, **(SMALL | {"n_epochs": 2}))
    one, again = (observe(jet, rng=3, n_iterations=50).cube for _ in range(2))
    np.testing.assert_array_equal(one.data, again.data)
    assert one.beams[0] != one.beams[1]
    other = observe(jet, rng=4, n_iterations=50).cube
    assert not np.array_equal(one.data, other.data)
    assert one.meta["history"][-1] == "observed with 10 antennas"


def test_an_epoch_without_any_feature():
    jet = simulate_jet(rng=1, **SMALL, core_flux=0.0, n_features=0, standing=(2.0,))
    empty = QTable(jet.truth[:0], meta=jet.truth.meta)
    jet = type(jet)(jet.cube, empty, jet.simulation)
    assert observe(jet, rng=1).cube.data.std() < 0.001


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_scans": 0}, "n_scans must be at least 1"),
        ({"gain_error": -0.1}, "gain_error zero or positive"),
        ({"n_iterations": -1}, "n_iterations and gain_error zero or positive"),
        ({"declination": -70 * u.deg}, "fewer than three baselines of the VLBA"),
    ],
)
def test_bad_observations(options, message):
    with pytest.raises(ValueError, match=message):
        observe(simulate_jet(rng=1, **SMALL), **options)
