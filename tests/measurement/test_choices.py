# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Alignment, scales and direction are found in the images."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc import Beam, EpochCube
from astro_scc.measurement.plan import (
    choose_alignment,
    choose_direction,
    choose_scales,
    structure_size,
)
from astro_scc.simulation import simulate_jet, simulate_static

BEAM = Beam(0.8 * u.mas, 0.8 * u.mas)


def spots(*places, beams=BEAM, bright=0.1):
    """Two epochs of a core and of fainter spots, (east, north) in mas."""
    y, x = np.mgrid[:121, :121]
    image = np.zeros(x.shape)
    for east, north, flux in [(0, 0, 1.0), *((*place, bright) for place in places)]:
        r2 = (x - 60 + east / 0.1) ** 2 + (y - 60 - north / 0.1) ** 2
        image += flux * np.exp(-4 * np.log(2) * r2 / 8**2)
    return EpochCube.from_arrays(
        np.stack([image] * 2), ["2000-01-01", "2001-01-01"], pixel_scale=0.1 * u.mas,
        reference_pixel=(60, 60), beams=beams, noise=1e-3 * u.one,
    )  # fmt: skip


@pytest.mark.parametrize("angle", [0, 60, 145, 270])
def test_the_direction_is_that_of_the_jet(angle):
    way = np.array([np.sin(np.radians(angle)), np.cos(np.radians(angle))])
    found, reason = choose_direction(spots(1.5 * way, 3 * way))
    assert abs((found.value - angle + 180) % 360 - 180) <= 1
    assert reason == "that of the mean image"


@pytest.mark.parametrize(
    ("cube", "reason"),
    [
        (lambda: spots((2, 0), beams=None), "without a beam"),
        (lambda: spots(), "nothing is seen beyond a beam"),
        (lambda: spots((0, 4.8)), "does not begin"),
        (lambda: spots((2, 0), (-2, 0.2)), "not on one side"),
        (lambda: spots((2, 0), (0, 2), (-1.5, -1.5)), "not on one side"),
    ],
)
def test_no_direction_has_a_reason(cube, reason):
    cube = cube()
    found, said = choose_direction(cube)
    assert found is None
    assert reason in said


def test_aligned_epochs_are_left_alone():
    align, reason = choose_alignment(simulate_jet(n_epochs=6, rng=1).cube)
    assert align == "none"
    assert reason.startswith("the epochs are aligned to 0.0")


@pytest.mark.slow
def test_epochs_that_scatter_are_aligned_on_the_core():
    cube = simulate_jet(n_epochs=12, alignment_error=0.4, rng=2).cube
    align, reason = choose_alignment(cube)
    assert align == "core"
    assert reason.startswith("the epochs scatter by 0.")


def test_epochs_without_a_beam_do_not_tell():
    align, reason = choose_alignment(spots((2, 0), beams=None))
    assert align == "none"
    assert reason == "the images do not show how well they are aligned"


def test_a_core_that_is_not_found_aligns_nothing(monkeypatch):
    def fail(self, *args, **kwargs):
        raise ValueError("no core")

    cube = simulate_static(n_epochs=4, rng=1).cube
    object.__setattr__(cube, "misalignment", 0.3)
    monkeypatch.setattr(EpochCube, "align", fail)
    assert choose_alignment(cube) == (
        "none", "the epochs scatter by 0.30 beams, no less on the core"
    )  # fmt: skip


def field(fwhm, *, noise=0.02, shape=(128, 160), beam=None, gradient=0.0, mask=None):
    """Two epochs of Gaussians of a width in pixels, on a gradient, with noise."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[: shape[0], : shape[1]]
    image = gradient * x / shape[1]
    for x0, y0 in rng.uniform(0, 1, (30, 2)) * shape[::-1]:
        r2 = (x - x0) ** 2 + (y - y0) ** 2
        image = image + np.exp(-4 * np.log(2) * r2 / fwhm**2)
    images = image + rng.normal(0, noise, (2, *shape))
    width = None if beam is None else Beam(*(0.1 * beam * u.mas,) * 2)
    return EpochCube.from_arrays(
        images, ["2000-01-01", "2001-01-01"], pixel_scale=0.1 * u.mas, beams=width,
        mask=mask,
    )  # fmt: skip


@pytest.mark.parametrize("fwhm", [3, 5, 8])
@pytest.mark.parametrize("noise", [0.0, 0.05, 0.3])
def test_the_size_of_structures(fwhm, noise):
    assert structure_size(field(fwhm, noise=noise)) == pytest.approx(fwhm, rel=0.2)


@pytest.mark.parametrize(
    ("beam", "scales"),
    [
        (2, (1, 2)),
        (4, (1, 2, 3)),
        (6, (1, 2, 3, 4)),
        (11, (1, 2, 3, 4)),
        (16, (2, 3, 4, 5)),
        # No scale is larger than half of the image.
        (60, (4, 5, 6)),
    ],
)
def test_scales_from_a_quarter_of_the_beam_to_two_beams(beam, scales):
    found, reason = choose_scales(field(beam, beam=beam))
    assert found == scales
    assert f"({beam}.0 px)" in reason


@pytest.mark.parametrize(("fwhm", "scales"), [(3, (1,)), (7, (1, 2)), (24, (1, 2, 3))])
def test_scales_up_to_half_of_the_structures(fwhm, scales):
    assert choose_scales(field(fwhm))[0] == scales
