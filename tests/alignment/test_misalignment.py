# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""How well epochs lie on one another, of jets whose shifts are known."""

import numpy as np
import pytest
from scipy import ndimage

from astro_scc.alignment.registration import misalignment, warn_of_misalignment
from astro_scc.exceptions import MeasurementWarning
from astro_scc.simulation import simulate_jet, simulate_static


def shifted(cube, x, y=None):
    """Every image moved by its own x and y, in pixels."""
    steps = zip(cube.data, x, np.zeros(len(cube)) if y is None else y, strict=True)
    moved = [ndimage.shift(image, (dy, dx), order=3) for image, dx, dy in steps]
    return cube.with_step("shifted", data=np.array(moved))


@pytest.fixture(scope="module")
def jet():
    """Twelve aligned epochs of a jet with a core."""
    return simulate_jet(n_epochs=12, rng=1).cube


@pytest.mark.slow
@pytest.mark.parametrize("beams", [0.1, 0.6])
@pytest.mark.parametrize("standing", [False, True])
def test_the_scatter_of_epochs_is_what_they_were_shifted_by(jet, beams, standing):
    cube = simulate_static(n_epochs=12, core=3.0, rng=1).cube if standing else jet
    width = np.sqrt(cube.beams[0].major * cube.beams[0].minor) / cube.pixel_scale
    x, y = np.random.default_rng(5).normal(size=(2, 12))
    x, y = ((v - v.mean()) / v.std() * beams * float(width) for v in (x, y))
    found = misalignment(shifted(cube, x, y))
    # Each of the ten in the middle tells it to a fifth.
    assert found == pytest.approx(beams, rel=0.3)


def test_epochs_that_are_aligned_or_drift_steadily(jet):
    assert misalignment(jet) < 0.05
    drift = 12 * jet.years.value
    assert np.std(drift) > 10
    assert (misalignment(shifted(jet, drift)) or 0) < 0.1


@pytest.mark.parametrize(
    "change",
    [
        lambda jet: jet[:2],
        lambda jet: jet.with_step("", beams=None),
        lambda jet: jet.with_step("", data=0 * jet.data, noise=None),
        lambda jet: jet[:4].with_step("", times=jet.times[[0, 0, 0, 0]]),
    ],
)
def test_what_cannot_be_told(jet, change):
    assert misalignment(change(jet)) is None


@pytest.fixture(scope="module")
def unaligned():
    """A jet that stands still, with 0.4 beams of scatter."""
    jet = {"n_features": 0, "standing": 6, "length": 8.0, "alignment_error": 0.5}
    return simulate_jet(n_epochs=6, **jet, rng=3).cube


LINE = (
    r"^the epochs are aligned to 0\.\d\d beams only, where 0\.2 or more "
    r"adds to every error of a speed: align them, with --align core or "
    r"cube\.align\('core'\), or if they were, in another way$"
)


def test_it_is_said_and_measured_once(unaligned):
    with pytest.warns(MeasurementWarning, match=LINE):
        warn_of_misalignment(unaligned)
    assert vars(unaligned)["misalignment"] is unaligned.misalignment
