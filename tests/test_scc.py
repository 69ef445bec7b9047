# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The whole way from images to components, on motions that are known."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time

from astro_scc import Beam, EpochCube, StackedCrossCorrelation, measure_velocities
from astro_scc.exceptions import MeasurementWarning
from astro_scc.paper.stack import find_velocity_peaks
from astro_scc.products import write_products

PM = u.mas / u.yr
DAYS = 30
#: One pixel of 0.1 mas between two epochs.
PIXEL = (0.1 * u.mas / (DAYS * u.day)).to(PM)


def moving(velocity=(3.0, 1.0), n_epochs=6, seed=0, shape=(72, 96), rms=0.01):
    """Images of nine features that all move by (x, y) pixels between epochs."""
    rng, (ny, nx) = np.random.default_rng(seed), shape
    y, x = np.mgrid[:ny, :nx]
    # One feature a cell, so that they do not blend.
    start = [
        (nx * (c + 0.5) / 3 + rng.uniform(-5, 5), ny * (r + 0.5) / 3 +
         rng.uniform(-4, 4), rng.uniform(0.5, 1.5)) for r in range(3) for c in range(3)
    ]  # fmt: skip
    images = np.zeros((n_epochs, ny, nx))
    for k, image in enumerate(images):
        step = k - (n_epochs - 1) / 2
        for x0, y0, height in start:
            r2 = (x - x0 - velocity[0] * step) ** 2 + (y - y0 - velocity[1] * step) ** 2
            image += height * np.exp(-4 * np.log(2) * r2 / 6.0**2)
        image += rng.normal(scale=rms, size=shape)
    return images


def dates(steps):
    return Time("2000-01-01") + np.asarray(steps) * DAYS * u.day


def make_cube(data, steps=None, **kwargs):
    options = {"beams": Beam(0.6 * u.mas, 0.6 * u.mas), "pixel_scale": 0.1 * u.mas}
    times = dates(range(len(data)) if steps is None else steps)
    return EpochCube.from_arrays(data, times, **{**options, **kwargs})


def make_scc(**settings):
    options = {"scales": [1, 2], "max_speed": 8 * PIXEL}
    return StackedCrossCorrelation(**{**options, **settings})


def measure(cube, *, n_trials=119, **settings):
    return make_scc(**settings)(cube, n_trials=n_trials, rng=1)


def in_pixels(table):
    """Motions in pixels between epochs, (x, y), x to the west."""
    columns = [(table[k] / PIXEL).to_value(u.one) for k in ("pm_ra_cosdec", "pm_dec")]
    return np.stack(columns, axis=1) * [-1, 1]


def strongest(result):
    """The highest maximum of the stack, significant or not, as `in_pixels`."""
    box = (6 * PIXEL).value
    axes = result.grid.v1, result.grid.v2
    velocities, _ = find_velocity_peaks(result.coefficient, axes, (box, box))
    return result.frame.matrix().T @ velocities[0] * [-1, 1] / PIXEL.value


def check_motion(result, velocity, atol=0.15):
    """The highest maximum of the stack, and the speed of the features."""
    np.testing.assert_allclose(strongest(result), velocity, atol=atol)
    np.testing.assert_allclose(in_pixels(result.components)[0], velocity, atol=atol)


@pytest.fixture(scope="module")
def data():
    return moving()


@pytest.fixture(scope="module")
def cube(data):
    return make_cube(data)


@pytest.fixture(scope="module")
def result(cube):
    return measure(cube)


def test_what_cannot_be_meant_is_refused(cube):
    for call, words in [
        (lambda scc, cube: scc("*.fits"), "cube must be an EpochCube, got str: read"),
        (lambda scc, cube: scc.plan(cube[:1]), "at least 2 epochs"),
        (lambda scc, cube: scc(cube, rng="abc"), "^rng must be a seed"),
        (lambda _, cube: make_scc(kappa=0.7)(cube), "^kappa is for method paper"),
        (lambda scc, cube: make_scc(method="paper").measure(scc.decompose(cube)),
         "^method = 'paper' measures images"),
    ]:  # fmt: skip
        with pytest.raises((ValueError, TypeError), match=words):
            call(make_scc(), cube)


def test_finds_the_motion(result):
    (only,) = result.components
    assert (only["kind"], only["n_features"]) == ("moving", 9)
    np.testing.assert_allclose(strongest(result), (3, 1), atol=0.1)
    np.testing.assert_allclose(in_pixels(result.components)[0], (3, 1), atol=0.02)
    assert result.coefficient.max() > 0.5
    row, column = np.unravel_index(result.coefficient.argmax(), result.grid.shape)
    assert result.z_score[row, column] > 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        {"scales": [1, 2], "wavelet": "b3"},
        {"noise": "local", "baseline": [20, 70] * u.day},
        {"noise": "propagated", "position_angle": 288 * u.deg, "outward": True},
    ],
    ids=repr,
)
def test_finds_it_with_other_settings(cube, settings):
    # The filter b3 reaches far beyond the edges: the error is 0.2 pixels.
    atol = 0.2 if "wavelet" in settings else 0.15
    check_motion(measure(cube, **settings), (3, 1), atol=atol)


@pytest.mark.slow
def test_reversed_and_slow_motions(data, result):
    x, y = in_pixels(result.components)[0]
    slow = {"max_speed": 0.8 * PIXEL}
    for cube, settings, expected in (
        (make_cube(data[::-1]), {}, (-x, -y)),
        (make_cube(data, 10 * np.arange(6)), slow, (x / 10, y / 10)),
    ):
        found = in_pixels(measure(cube, **settings).components)[0]
        np.testing.assert_allclose(found, expected, rtol=0.02, atol=0.02)


def test_a_region_without_ssps_is_told(cube, tmp_path):
    scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    path = tmp_path / "corner.reg"
    path.write_text("image\ncircle(3,3,2)\n")
    line = rf"^{path}: no significant pattern has its centroid inside, \d+ in the rest"
    for decompose in (scc.decompose, scc.match):
        with pytest.warns(MeasurementWarning, match=line):
            found = decompose(cube, region=path)
        assert not found.select.any()
    corner = cube.region_mask(path)
    with pytest.warns(MeasurementWarning, match="^the region: no significant pattern"):
        scc.match(cube, region=corner)
    # Where there is nothing anywhere the place is no matter.
    flat = replace(cube, data=np.zeros(cube.shape))
    assert len(scc.match(flat, region=corner).ssps) == 0


NO_SSP = r"^no significant pattern \(SSP\) in any epoch on scale 1, 2: try other scale"


def test_in_flat_images_nothing_moves(result, tmp_path):
    scc, flat = make_scc(position_angle="radial"), make_cube(np.ones((6, 48, 48)))
    with pytest.raises(ValueError, match=NO_SSP):
        scc(flat, n_trials=119)
    found = scc.measure(scc.decompose(flat), n_trials=119, rng=1)
    assert list(found.streams["kind"]) == ["not significant"]
    assert len(found.features) == len(found.ssps) == 0
    # The products have all columns and units.
    paths = write_products(found, found.components_in_c(distance=1 * u.Mpc), tmp_path)
    read = {p.stem: QTable.read(p) for p in paths if p.suffix == ".ecsv"}
    assert not any(len(read[name]) for name in ("features", "positions", "ssps"))
    for name in result.streams.colnames:
        unit = getattr(result.streams[name], "unit", None)
        assert getattr(read["streams"][name], "unit", None) == unit


def test_one_call_gives_the_table(cube, result):
    options = {"scales": [1, 2], "max_speed": 8 * PIXEL, "n_trials": 119, "rng": 1}
    one, other = measure_velocities(cube, n_workers=2, **options), result.streams
    for name in one.colnames:
        np.testing.assert_array_equal(np.asarray(one[name]), np.asarray(other[name]))
    # A region of the whole is no more than another way to the same.
    whole = measure_velocities(cube, region=np.ones(cube.shape[1:], bool), **options)
    np.testing.assert_allclose(in_pixels(whole), in_pixels(result.streams), rtol=1e-3)
