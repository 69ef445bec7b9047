# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Flow planes, their model and its solution, on diagrams and flows that are known."""

import numpy as np
import pytest

from astro_scc.spectrum.diagram import (
    CLIP,
    Diagram,
    SampledPlanes,
    correlate,
    correlate_aside,
)
from astro_scc.spectrum.equations import deconvolve, set_up
from astro_scc.spectrum.gaussians import (
    amplitudes_of,
    fit_errors,
    one_stream,
    peaks_of,
    shares_of,
    two_are_better,
    two_streams,
)
from astro_scc.spectrum.permutations import LENGTH
from astro_scc.spectrum.rays import velocity_map

X = np.arange(-40, 41) / 8
OWN = np.where(np.abs(X) <= 2.2, np.exp(-4 * np.log(2) * X**2 / 2), 0)


def exact_diagram(shares, years):
    """Return the expected diagram of streams with the shares {speed: share}."""
    x, tau = X, years - years[:, None]
    sums = np.zeros((len(years), len(years), len(x)))
    for v, share in shares.items():
        moved = (v * tau)[..., None]
        own = np.exp(-4 * np.log(2) * (x - moved) ** 2 / 2)
        sums += share * own * np.exp(-np.abs(moved) / LENGTH)
    sums -= sums.mean(axis=0)
    sums -= sums.mean(axis=1, keepdims=True)
    return Diagram(sums.astype(np.float32), np.ones(len(x)), x, years)


YEARS = np.cumsum(np.random.default_rng(3).uniform(0.1, 0.4, 14))


@pytest.fixture
def known(monkeypatch):
    """Make the images' own correlation the known one."""
    name = "astro_scc.spectrum.equations.autocorrelation"
    monkeypatch.setattr(name, lambda diagram: OWN)


@pytest.mark.usefixtures("known")
def test_the_model_is_centred_as_the_data_are():
    equations = set_up(exact_diagram({0.0: 1.0}, YEARS))
    k = int(np.abs(equations.speed - 1.0).argmin())
    v = equations.speed[k]
    exact = set_up(exact_diagram({v: 1.0}, YEARS)).data
    left = equations.design[k] - exact
    # Bins of the interval are a few per cent wide.
    assert np.abs(left).max() < 0.12 * np.abs(exact).max()
    assert (left**2).sum() < 0.01 * (exact**2).sum()


@pytest.mark.usefixtures("known")
@pytest.mark.parametrize("shares", [{0.5: 1.0}, {0.5: 0.4, 3.0: 0.6}, {-2.0: 1.0}])
def test_exact_speeds_are_found(shares):
    equations = set_up(exact_diagram(shares, YEARS))
    spectrum = deconvolve(equations)
    peaks = peaks_of(equations, spectrum, 0.1)[: len(shares)]
    assert sorted(p[0] for p in peaks) == pytest.approx(sorted(shares), rel=0.1)
    sign = np.sign(next(iter(shares)))
    one = one_stream(equations, 0.1, sign)
    two = two_streams(equations, one, 0.1)
    assert two_are_better(equations, one, two) == (len(shares) == 2)
    fit = two if len(shares) == 2 else one
    assert sorted(fit.mean) == pytest.approx(sorted(shares), rel=0.06)
    assert one_stream(equations, 1e3, sign) is None


@pytest.mark.usefixtures("known")
@pytest.mark.parametrize("speed", [0.5, -2.0])
def test_a_spectrum_of_aliases_does_not_hide_the_speed(speed, monkeypatch):
    equations = set_up(exact_diagram({speed: 1.0}, YEARS))
    far = 1.0 * (np.abs(equations.speed) > 0.8 * equations.speed[-1])
    monkeypatch.setattr("astro_scc.spectrum.gaussians.deconvolve", lambda _: far)
    fit = one_stream(equations, 0.1, np.sign(speed))
    assert fit.mean == pytest.approx(speed, rel=0.06)
    assert fit.share == 1
    assert np.isnan(amplitudes_of(equations, [-speed], [0.1]).share)


def test_nothing_is_no_stream():
    still = Diagram(np.zeros((5, 5, 11), np.float32), np.ones(11),
                    np.arange(-5, 6) / 4, np.arange(5.0))  # fmt: skip
    equations = set_up(still)
    assert not deconvolve(equations).any()
    assert one_stream(equations, 0.1) is None
    assert amplitudes_of(equations, [1.0], [0.2]).amplitude.tolist() == [0.0]


def test_only_pairs_that_are_asked_for_count():
    diagram = exact_diagram({1.0: 1.0}, YEARS)
    some = set_up(diagram, intervals=(0.5, 1.5))
    used = some.share > 0
    assert np.all(np.abs(some.interval[used]) <= 1.5 * 1.05)
    assert np.all(np.abs(some.interval[used]) >= 0.5 * 0.95)
    assert not some.data[~used].any()
    assert one_stream(some, 0.1).mean[0] == pytest.approx(1.0, rel=0.08)
    assert set_up(diagram, fastest=8.0).speed[-1] >= 8.0


def test_speeds_and_errors_of_random_flows(moving_flow):
    """Errors are those of the scatter, within what twelve flows show."""
    speeds, errors = [], []
    for seed in range(12):
        flow = moving_flow([1.0], seed=seed).fitted
        diagram = correlate(flow)
        equations = set_up(diagram)
        fit = one_stream(equations, 0.1)
        error, number, _, epochs = fit_errors(flow, diagram, equations, fit)
        speeds.append(fit.mean[0])
        errors.append(error[0])
        assert number[0] > 2
        assert epochs.shape == (1, len(flow.years))
    assert np.mean(speeds) == pytest.approx(1.0, abs=0.05)
    assert 0.4 < np.std(speeds) / np.mean(errors) < 2.5


def test_the_map_has_its_peak_at_the_velocity(moving_flow):
    flow = moving_flow([1.0]).fitted
    sheet = correlate_aside(flow, [3, 6])
    aside = 3 * flow.step * np.arange(-2, 3)
    rng = np.random.default_rng(0)
    found = velocity_map(sheet, aside, 3.0, angle=np.pi / 2, beam=2.0, rng=rng)
    assert found.coefficient.shape == found.shape
    row, column = np.unravel_index(found.z_score.argmax(), found.shape)
    assert found.v2[row] == pytest.approx(2.0, abs=0.5)
    assert found.v1[column] == pytest.approx(0.0, abs=0.5)
    assert found.step[0] == pytest.approx(found.v1[1] - found.v1[0])


def planes_of(images, noise=0.0, valid=None, mask=None, normalise="local"):
    valid = np.ones(images.shape, bool) if valid is None else valid
    mask = np.ones(images.shape[1:], bool) if mask is None else mask
    x, y = (np.arange(float(n)) for n in images.shape[1:])
    years, weight = np.arange(float(len(images))), np.ones((len(x), 1))
    return SampledPlanes(
        images[None], valid, mask, np.array([noise]), x, y, weight, years, scales=(1,),
        sizes=(1.0,),
    ).changes(normalise)  # fmt: skip


def test_what_stands_still_is_gone_and_no_unit_matters():
    rng = np.random.default_rng(1)
    images = rng.normal(size=(6, 30, 20))
    found = planes_of(images, 0.1)
    for other in (images + 5.0, 1e-9 * images, 1e6 * images):
        noise = 0.1 * np.abs(other - other.mean(0)).max()
        noise /= np.abs(images - images.mean(0)).max()
        assert np.allclose(planes_of(other, noise).values, found.values, atol=1e-4)
    assert np.abs(found.values.mean(axis=1)).max() < 0.05
    assert np.abs(found.values).max() <= CLIP
    # Noise weighs little.
    images = rng.normal(size=(8, 40, 20))
    images[:, :20] *= 50
    found = planes_of(images, 1.0).values[0]
    assert found[:, :10].std() > 0.9
    assert found[:, 30:].std() < 0.3


def test_missing_pixels_do_not_count():
    rng = np.random.default_rng(3)
    images = rng.normal(size=(6, 30, 20))
    valid = np.ones(images.shape, bool)
    valid[0, :5] = False
    valid[:4, 25:] = False
    found = planes_of(np.where(valid, images, 1e9), valid=valid)
    assert np.all(found.values[0, 0, :5] == 0)
    assert not found.mask[25:].any()
    assert np.abs(found.values[0, 1:, :5]).mean() > 0.5


@pytest.mark.parametrize(("mean", "sd"), [(1.0, 0.2), (-2.0, 0.3), (0.11, 0.06)])
def test_derivatives_of_the_shares_of_gaussians(mean, sd):
    """Also of a Gaussian part of which is beyond the speeds."""
    equations = set_up(exact_diagram({1.0: 1.0}, YEARS))
    step = 1e-6

    def shares(mean, sd):
        return shares_of(equations, np.array([mean]), np.array([sd]))[0]

    _, of_mean, of_sd = shares_of(equations, np.array([mean]), np.array([sd]))
    by_mean = shares(mean + step, sd) - shares(mean - step, sd)
    by_sd = shares(mean, sd * (1 + step)) - shares(mean, sd * (1 - step))
    for found, change in ((of_mean, by_mean), (of_sd, by_sd)):
        np.testing.assert_allclose(found, change / 2 / step, atol=1e-6)
