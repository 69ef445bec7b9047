# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What is measured: alignment, direction and scales."""

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st

from astro_scc import Beam, EpochCube, plan
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.epochs.restoring import add_gaussians
from astro_scc.images.beam import FWHM_TO_SIGMA
from astro_scc.simulation import simulate_jet

PIXEL = 0.1 * u.mas
BEAM = Beam(0.8 * u.mas, 0.8 * u.mas)
DATES = ["2000-01-01", "2001-01-01"]


def cube_of(days=(0, 30, 90), shape=(40, 60), beams=None):
    """Epochs without anything in them."""
    data, times = np.zeros((len(days), *shape)), Time("2010-01-01") + days * u.day
    return EpochCube.from_arrays(data, times, pixel_scale=PIXEL, beams=beams)


SMALL = cube_of(shape=(8, 8))


@given(st.integers(1, 16), st.floats(0.84, 1.19))
def test_angles_name_the_scale_that_they_are_near(half, factor):
    number = half / 2
    size = factor * scale_size(number)
    (found,) = plan.scale_numbers(SMALL, [size * 0.1] * u.mas)
    # Between two scales the nearer one.
    assert abs(np.log(scale_size(found) / size)) <= abs(np.log(factor)) + 1e-9
    if 0.9 < factor < 1.1:
        assert found == number


def test_what_cannot_be_meant_is_refused():
    # Midway between 1 and 1.5 pixels.
    words = r"^scale 0.122 mas is 1.2 px, not near 2\^j or 1.5 x 2\^j px$"
    with pytest.raises(ValueError, match=words):
        plan.scale_numbers(SMALL, [0.122, 0.4] * u.mas)
    with pytest.raises(ValueError, match="1e-09 mas .*: give a larger one$"):
        plan.motion_of(cube_of((0, 365.25)), 1e-9, np.ones(1))


def gaussians(x, y, peak, fwhm, shape):
    """Two equal images of round Gaussians, of a width in pixels."""
    sizes = np.array([(FWHM_TO_SIGMA * fwhm) ** 2 * np.eye(2)] * len(x))
    return np.stack([add_gaussians(np.zeros(shape), x, y, peak, sizes)] * 2)


def spots(*places, beams=BEAM):
    """Two epochs of a core and of fainter spots, (east, north) in mas."""
    east, north = np.transpose([(0, 0), *places]) / 0.1
    peak = [1.0] + [0.1] * len(places)
    return EpochCube.from_arrays(
        gaussians(60 - east, 60 + north, peak, 8, (121, 121)), DATES, beams=beams,
        pixel_scale=PIXEL, reference_pixel=(60, 60), noise=1e-3 * u.one,
    )  # fmt: skip


def aside(place):
    """A jet to the west whose core is at a place (east, north) in mas."""
    cube = spots((-1, 0.1), (-2, -0.1), (-3, 0))
    wcs = cube.wcs.deepcopy()
    wcs.wcs.crpix += np.array([place[0], -place[1]]) / 0.1
    return cube.with_step("moved", wcs=wcs)


@pytest.mark.parametrize("angle", [60, 270])
def test_the_direction_is_that_of_the_jet(angle):
    way = np.array([np.sin(np.radians(angle)), np.cos(np.radians(angle))])
    found, _ = plan.choose_direction(spots(1.5 * way, 3 * way))
    assert abs(found.value - angle) <= 1
    # Where the other side is not seen, and the sky is not zero.
    cube = spots(1.5 * way, 3 * way).crop((slice(15, 106), slice(0, 108)))
    found, _ = plan.choose_direction(cube.with_step("a sky", data=cube.data + 3))
    assert abs(found.value - angle) <= 1


@pytest.mark.parametrize("angle", [60, 270])
@pytest.mark.parametrize("core", [True, False])
def test_the_direction_of_a_jet_with_an_equal_counter_jet_is_its_axis(angle, core):
    way = np.array([np.sin(np.radians(angle)), np.cos(np.radians(angle))])
    cube = spots(*(r * way for r in (-3, -1.5, 1.5, 3)))
    if not core:
        data = cube.data.copy()
        data[:, 50:71, 50:71] = 0
        cube = cube.with_step("no core", data=data)
    found, said = plan.choose_direction(cube)
    assert (found is not None) == ("on both sides of the core" in said) == core
    assert found is None or min(abs(found.value % 180 - angle % 180), 180) <= 1


@pytest.mark.parametrize(
    ("cube", "reason"),
    [
        (lambda: spots((2, 0), beams=None), "without a beam"),
        (lambda: spots(), "nothing is seen beyond a beam"),
        (lambda: spots((2, 0), (-2, 0), (0, 2), (0, -2)), "on one side alone"),
        (lambda: aside((1.2, -1.2)), "lies beside the reference pixel"),
        (lambda: spots((0, 4.8)), "does not begin"),
        (lambda: spots((2, 0), (0, 2), (-1.5, -1.5)), "not on one side"),
    ],
)
def test_no_direction_has_a_reason(cube, reason):
    found, said = plan.choose_direction(cube())
    assert found is None
    assert reason in said


@pytest.mark.parametrize(
    ("cube", "align", "reason"),
    [
        (lambda: simulate_jet(n_epochs=6, rng=1).cube, "none", "are aligned to 0.0"),
        (lambda: spots((2, 0), beams=None), "none", "do not show how well they are"),
        pytest.param(
            lambda: simulate_jet(n_epochs=12, alignment_error=0.4, rng=2).cube,
            "core", "the epochs scatter by 0.", marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_epochs_are_aligned_on_the_core_if_they_scatter(cube, align, reason):
    found, said = plan.choose_alignment(cube())
    assert found == align
    assert reason in said


def test_a_core_that_is_not_found_aligns_nothing():
    cube = spots(beams=None)
    object.__setattr__(cube, "misalignment", 0.3)
    text = "the epochs scatter by 0.30 beams, no less on the core"
    assert plan.choose_alignment(cube) == ("none", text)


def field(fwhm, *, noise=0.02, shape=(128, 160), beam=None):
    """Two epochs of Gaussians of a width in pixels, with noise."""
    rng = np.random.default_rng(3)
    x, y = (rng.uniform(0, 1, (30, 2)) * shape[::-1]).T
    images = gaussians(x, y, [1] * 30, fwhm, shape) + rng.normal(0, noise, (2, *shape))
    width = None if beam is None else Beam(beam * PIXEL, beam * PIXEL)
    return EpochCube.from_arrays(images, DATES, pixel_scale=PIXEL, beams=width)


@pytest.mark.parametrize(("fwhm", "noise"), [(3, 0.0), (8, 0.3)])
def test_the_size_of_structures(fwhm, noise):
    assert plan.structure_size(field(fwhm, noise=noise)) == pytest.approx(fwhm, rel=0.2)


@pytest.mark.parametrize(
    ("fwhm", "beam", "scales"),
    [
        # From a quarter of the beam to two; none larger than half of the image.
        (2, 2, (1, 2)), (6, 6, (1, 2, 3, 4)), (9, 60, (4, 5, 6)),
        # Without a beam up to half of the size of the structures.
        (3, None, (1,)), (7, None, (1, 2)), (24, None, (1, 2, 3)),
    ],
)  # fmt: skip
def test_scales_that_suit_the_resolution(fwhm, beam, scales):
    found, reason = plan.choose_scales(field(fwhm, beam=beam))
    assert found == scales
    assert beam is None or f"({beam}.0 px)" in reason
