# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The whole of tracking, on jets whose features are known."""

from dataclasses import replace
from functools import cache

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time

from astro_scc import Beam, EpochCube
from astro_scc.decomposition import Decomposer
from astro_scc.exceptions import MeasurementWarning
from astro_scc.tracking import FeatureTracker

PM = u.mas / u.yr


def decomposed(years, spots, reference, width, *, seed, detection, beams=True):
    """Images of spots (x, y, peak) at dates, of a width in pixels, and their SSPs."""
    y, x = np.mgrid[:96, :160]
    images = np.random.default_rng(seed).normal(0, 2e-3, (len(years), 96, 160))
    for image, own in zip(images, spots, strict=True):
        for x0, y0, peak in own:
            image += peak * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * width**2))
    fwhm = np.sqrt(8 * np.log(2)) * 0.1 * width * u.mas
    cube = EpochCube.from_arrays(
        images, Time(2000.0 + years, format="jyear"), pixel_scale=0.1 * u.mas,
        unit=u.Jy / u.beam, reference_pixel=reference,
        beams=Beam(fwhm, fwhm) if beams else None,
    )  # fmt: skip
    return cube, [Decomposer(scales=[1, 2], detection=detection)(d) for d in cube.data]


@cache
def jet(n_epochs=12, beams=True):
    """Two features that leave the core to the west and north-west, and one at rest."""
    years = 0.5 * np.arange(n_epochs)
    # West is to larger x, the core at (20, 20); speeds in pixels a half year.
    spots = [
        [(32 + 3 * k, 20, 1.0), (30 + 1.5 * k, 30 + 1.5 * k, 0.7), (80, 60, 0.9)]
        for k in 2 * years
    ]
    return decomposed(years, spots, (20, 20), 2.5, seed=1, detection=10, beams=beams)


@pytest.fixture(scope="module")
def tracker():
    return FeatureTracker(max_speed=1.5 * PM)


@pytest.fixture(scope="module")
def features(tracker):
    return tracker(*jet())


def test_every_feature_is_one_row_whatever_its_scales(features):
    table = features.table[np.argsort(features.table["pm"].value)]
    assert (len(features.detections), len(features.core)) == (36, 0)
    assert table["n_epochs"].tolist() == [12] * 3
    west, north = -table["pm_ra_cosdec"].value, table["pm_dec"].value
    assert west == pytest.approx([0, 0.3, 0.6], abs=0.01)
    assert north == pytest.approx([0, 0.3, 0.0], abs=0.01)
    assert np.all(table["pm_err"].value < 0.05)
    assert table["secure"].tolist() == [False, True, True]
    # Distances from the core: 1.2 mas at 0.6 mas/yr, 1.41 mas at 0.42.
    born = [2000 - 1 / 0.3, 1998]
    assert table["t_ej"].value[1:] == pytest.approx(born, abs=0.15)


@cache
def core_jet(dark=()):
    """A core, one feature that fades, and flashes that are seen at one date each."""
    years = np.array([0, 0.7, 1.0, 1.5, 2.2, 2.4, 3.0, 4.3, 5.2, 7.4])
    spots = []
    for k, t in enumerate(years):
        at = [(20, 48, 0 if k in dark else 30.0), (34 + 6 * t, 48, 0.2 * 0.8**t)]
        spots.append([*at, (70 + 3 * k, 50 + k, 0.05)] if k in (3, 6, 8) else at)
    return decomposed(years, spots, (20, 48), 3.5, seed=2, detection=5)


@pytest.mark.parametrize("dark", [(3, 4, 5)])
def test_the_core_is_no_feature_and_nothing_jumps_into_it(dark):
    features = FeatureTracker()(*core_jet(dark))
    assert len(features.core) == 10 - len(dark)
    assert np.all(np.hypot(*features.core.place.T) < 0.1)
    assert features.core_error < 0.01
    assert np.all(np.hypot(*features.detections.place.T) > 1)
    (moving,) = features.table
    assert moving["n_epochs"] >= 6
    assert moving["pm"].value == pytest.approx(0.6, abs=0.03)


@pytest.mark.slow
def test_features_of_0003_380_are_those_of_the_survey(shared_data):
    cube = EpochCube.read(str(shared_data / "0003+380" / "*.fits"))
    with pytest.warns(MeasurementWarning, match="the core is blended with the jet"):
        cube = cube.to_common_beam().align("core")
    decompositions = [Decomposer(scales=[1, 2])(d) for d in cube.data]
    features = FeatureTracker()(cube, decompositions)
    table = features.table
    speed, error = table["pm"].value, table["pm_err"].value
    assert len(features.core) == 10
    assert np.all(table["separation"].value > 0.5)
    # One feature at 1.8 mas, 0.316 +- 0.026 mas/yr to 120 degrees.
    near = (np.abs(table["separation"].value - 1.8) < 0.3) & (table["n_epochs"] >= 4)
    assert np.sum(near) == 1
    assert np.all(np.abs(speed[near] - 0.316) < np.hypot(error[near], 0.026))
    assert np.all(np.abs(table["pm_pa"][near].value - 120) < 10)
    # And nothing faster.
    assert np.all(speed < 0.5)


@pytest.mark.parametrize("angle", [290 * u.deg, "radial"])
def test_limits_along_and_across_are_those_of_the_links(angle):
    limits = {"along": [0.95, 1.5] * PM, "across": [-0.3, 0.3] * PM}
    # Displacements may exceed the limits by 0.24 mas, which is 0.47 mas/yr.
    (only,) = FeatureTracker(position_angle=angle, **limits)(*jet()).table
    assert only["pm_ra_cosdec"].value == pytest.approx(-0.6, abs=0.02)
    # Without limits across it is as fast as the largest speed in either direction.
    (alone,) = FeatureTracker(position_angle=angle, along=limits["along"])(*jet()).table
    assert alone["pm_ra_cosdec"] == only["pm_ra_cosdec"]


def test_images_without_beams_and_too_few_epochs(tracker):
    cube, decompositions = jet(beams=False)
    assert len(tracker(cube, decompositions)) == 3
    features = replace(tracker, min_epochs=13)(cube, decompositions)
    assert len(features.table) == len(features.positions) == 0
    assert len(features.detections) == 36
    assert features.table["pm"].unit == PM


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"max_speed": -1 * PM}, "max_speed = -1.0 mas / yr must be"),
        ({"max_speed": 1 * u.mas}, "max_speed = 1.0 mas must"),
        ({"along": [1, 0] * PM}, "along = .* must be a smallest and a"),
        ({"along": [0, 1] * PM}, "along and across need a position_angle"),
        ({"position_angle": "ridge"}, "must be an angle or 'radial'"),
        ({"tolerance": 0}, "tolerance = 0 must be a part of the beam"),
        ({"max_gap": -1}, "max_gap = -1 must be 0 or more"),
        ({"min_epochs": 2}, "min_epochs = 2 must be 3 or more"),
        ({"kappa": 2}, "kappa = .* must be between 0 and 1"),
    ],
)
def test_settings_that_make_no_sense_are_refused(setting, message):
    with pytest.raises(ValueError, match=message):
        FeatureTracker(**setting)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda t, c, d: t(c, [Decomposer([1])(0 * i) for i in c.data]), "no signific"),
        (lambda t, c, d: t(c, d[:2]), "2 decompositions for 3 epochs"),
        (lambda t, c, d: t(c[:1], d[:1]), "tracking needs epochs of two dates"),
    ],
)
def test_what_does_not_go_together_is_refused(tracker, call, message):
    with pytest.raises(ValueError, match=message):
        call(tracker, *jet(n_epochs=3))
