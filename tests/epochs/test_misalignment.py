# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""How well epochs lie on one another, of jets whose shifts are known."""

import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from scipy import ndimage

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.alignment.registration import misalignment
from astro_scc.decomposition import Decomposer
from astro_scc.epochs import Beam, read_components, restore
from astro_scc.exceptions import MeasurementWarning
from astro_scc.simulation import (
    simulate_jet,
    simulate_static,
    simulate_two_fluid,
    simulate_unrelated,
)
from astro_scc.tracking import FeatureTracker

BEAM = Beam(0.9 * u.mas, 0.6 * u.mas, -5 * u.deg)


def shifted(cube, x, y=None):
    """Every image moved by its own x and y, in pixels."""
    y = np.zeros(len(cube)) if y is None else y
    moved = [
        ndimage.shift(image, (dy, dx), order=3)
        for image, dx, dy in zip(cube.data, x, y, strict=True)
    ]
    return replace(cube, data=np.array(moved))


@pytest.fixture(scope="module")
def jet():
    """Twelve aligned epochs of a jet with a core."""
    return simulate_jet(n_epochs=12, rng=1).cube


@pytest.mark.slow
@pytest.mark.parametrize("beams", [0.1, 0.3, 0.6])
@pytest.mark.parametrize("standing", [False, True])
def test_the_scatter_of_epochs_is_what_they_were_shifted_by(jet, beams, standing):
    cube = simulate_static(n_epochs=12, core=3.0, rng=1).cube if standing else jet
    width = np.sqrt(cube.beams[0].major * cube.beams[0].minor) / cube.pixel_scale
    x, y = np.random.default_rng(5).normal(size=(2, 12))
    x, y = ((v - v.mean()) / v.std() * beams * float(width) for v in (x, y))
    found = misalignment(shifted(cube, x, y))
    # Each of the ten in the middle tells it to a fifth.
    assert found == pytest.approx(beams, rel=0.3)


def test_epochs_that_are_aligned_are_said_to_be(jet):
    assert misalignment(jet) < 0.05
    assert misalignment(simulate_static(n_epochs=5, core=3.0, rng=1).cube) < 0.01


@pytest.mark.slow
def test_an_alignment_mends_it(jet):
    bad = shifted(jet, *(4 * np.random.default_rng(0).normal(size=(2, 12))))
    assert misalignment(bad) > 0.2
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the core is blended in some
        aligned = bad.align("core")
    assert misalignment(aligned) < 0.05


def test_a_steady_drift_is_motion(jet):
    drift = 12 * jet.years.value
    assert np.std(drift) > 10
    assert (misalignment(shifted(jet, drift)) or 0) < 0.1


@pytest.mark.slow
def test_brightness_that_goes_from_feature_to_feature_is_no_misalignment():
    y, x = np.mgrid[:48, :96]

    def spot(at):
        return np.exp(-((x - at) ** 2 + (y - 24) ** 2) / 30)

    fluxes = [(1.0, 0.4), (0.5, 1.2), (1.1, 0.6), (0.6, 0.9), (1.0, 0.5), (0.7, 1.1)]
    rng = np.random.default_rng(0)
    images = [
        core * spot(25) + other * spot(50) + rng.normal(0, 1e-3, x.shape)
        for core, other in fluxes
    ]
    brightest = [np.argmax(image) % 96 for image in images]
    assert np.std(brightest) > 10
    cube = EpochCube.from_arrays(
        np.array(images), [f"200{k}-01-01" for k in range(6)],
        pixel_scale=0.1 * u.mas, beams=Beam(1.29 * u.mas, 1.29 * u.mas),
    )  # fmt: skip
    scatter = misalignment(cube)
    assert scatter is None or scatter < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("simulate", [simulate_two_fluid, simulate_unrelated])
def test_epochs_that_do_not_resemble_one_another_do_not_tell(simulate):
    assert misalignment(simulate(n_epochs=6, rng=1).cube) is None


def test_what_cannot_be_told(jet):
    for cube in (
        jet[:2],
        replace(jet, beams=None),
        replace(jet, data=0 * jet.data, noise=None),
        replace(jet[:4], times=["2000-01-01"] * 4),
    ):
        assert misalignment(cube) is None


def test_masked_epochs_are_compared_where_all_are_there(jet):
    bad = shifted(jet, *(4 * np.random.default_rng(0).normal(size=(2, 12))))
    data, mask = bad.data.copy(), np.zeros(bad.shape, dtype=bool)
    mask[::2, :, 100:130] = True
    data[mask] = 1e3
    found = misalignment(replace(bad, data=data, mask=mask))
    assert found == pytest.approx(misalignment(bad), rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "1308+326",
        pytest.param("0430+052", marks=pytest.mark.slow),
        pytest.param("1226+023", marks=pytest.mark.slow),
        pytest.param("2200+420", marks=pytest.mark.slow),
    ],
)
def test_jets_that_are_aligned_by_their_cores(shared_data, name):
    lists = read_components(shared_data / "mojave_xviii" / f"{name}.ecsv")
    cube = restore(
        lists, beam=BEAM, pixel_scale=0.1 * u.mas, noise=0.3 * u.mJy / u.beam, rng=1
    )
    for part in (cube[:12], cube[12:24]):
        # What moves by beams between epochs does not tell.
        assert (misalignment(part) or 0) < 0.2
    assert misalignment(cube[:12]) is not None


@pytest.mark.slow
def test_a_jet_whose_core_is_not_its_brightest_pixel(shared_data):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the reader
        cube = EpochCube.read(f"{shared_data}/0003+380/*.fits").to_common_beam()
    assert misalignment(cube) < 0.05
    x = np.random.default_rng(1).normal(size=10) * 3
    assert misalignment(shifted(cube, x)) == pytest.approx(
        np.std(x) * 0.1 / 0.98 / np.sqrt(2), rel=0.35
    )


# -- those who say it --------------------------------------------------------------


@pytest.fixture(scope="module")
def unaligned():
    """A jet that stands still, with 0.4 beams of scatter."""
    return simulate_jet(
        n_epochs=6, n_features=0, standing=6, length=8.0, alignment_error=0.5, rng=3
    ).cube


LINE = (
    r"^the epochs are aligned to 0\.\d\d beams only, where 0\.2 or more "
    r"adds to every error of a speed: align them, with --align core or "
    r"cube\.align\('core'\), or if they were, in another way$"
)


@pytest.mark.slow
def test_the_call_says_it_and_what_mends_it(unaligned):
    scc = StackedCrossCorrelation(scales=[2], max_speed=5 * u.mas / u.yr)
    with pytest.warns(MeasurementWarning, match=LINE):
        result = scc(unaligned, n_trials=2, rng=1)
    meta = result.components.meta
    assert meta["misalignment_beams"] == unaligned.misalignment > 0.2
    aligned = unaligned.align("core")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        meta = scc(aligned, n_trials=2, rng=1).components.meta
    assert meta["misalignment_beams"] < 0.05


def test_tracking_says_it(unaligned):
    decompositions = [Decomposer(scales=[2])(image) for image in unaligned.data]
    with pytest.warns(MeasurementWarning, match=LINE):
        FeatureTracker(max_speed=5 * u.mas / u.yr)(unaligned, decompositions)


def test_it_is_measured_once(unaligned):
    cube = replace(unaligned)
    measured = cube.misalignment
    assert vars(cube)["misalignment"] is measured
    assert cube.misalignment is measured
