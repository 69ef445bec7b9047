# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.decomposition import Decomposer
from astro_scc.epochs import Beam
from astro_scc.flow import measure_profile
from astro_scc.images.beam import different_beam
from astro_scc.tracking import FeatureTracker


@pytest.mark.parametrize(
    ("major", "minor", "pa"),
    [(np.nan, 1, 0), (1, np.inf, 0), (np.inf, 1, 0), (1, 1, np.nan), (1, 0, 0),
     (-1, -2, 0), (1, 2, 0)],
)  # fmt: skip
def test_no_beam(major, minor, pa):
    with pytest.raises(ValueError, match="is finite with major >= minor > 0, got"):
        Beam(major * u.mas, minor * u.mas, pa * u.deg)


def test_beams_compare_with_beams():
    beam = Beam(2 * u.mas, 1 * u.mas, 30 * u.deg)
    assert beam == Beam(2e-3 * u.arcsec, 1e-3 * u.arcsec, 210 * u.deg)
    assert beam != Beam(2 * u.mas, 1 * u.mas, 31 * u.deg)
    assert beam != "beam"


def with_beams(*beams):
    """A feature that moves a pixel an epoch, with a beam for each epoch."""
    y, x = np.mgrid[:32, :32]
    images = [np.exp(-((x - 12 - k) ** 2 + (y - 16) ** 2) / 8) for k in range(3)]
    return EpochCube.from_arrays(
        np.array(images), ["2000-01-01", "2000-02-01", "2000-03-01"],
        pixel_scale=0.1 * u.mas, noise=0.01 * u.one, beams=beams or None,
    )  # fmt: skip


ROUND, WIDE = (Beam(size * u.mas, 0.5 * u.mas) for size in (0.5, 0.52))


@pytest.mark.parametrize(
    ("other", "differs"),
    [
        (Beam(0.504 * u.mas, 0.5 * u.mas), False),  # rounded in a header
        (Beam(0.506 * u.mas, 0.5 * u.mas), True),
        (Beam(0.5 * u.mas, 0.494 * u.mas, 80 * u.deg), True),
    ],
)
def test_beams_are_the_same_within_one_per_cent_in_any_direction(other, differs):
    assert different_beam(with_beams(ROUND, ROUND, other)) == (2 if differs else None)


def test_beams_of_one_area_differ_by_their_angle():
    long = [Beam(1 * u.mas, 0.5 * u.mas, angle * u.deg) for angle in (0, 180, 5)]
    assert different_beam(with_beams(*long)) == 2
    assert different_beam(with_beams(*long[:2], long[0])) is None


def test_no_beams_do_not_differ():
    assert different_beam(with_beams()) is None


def test_beams_that_differ_are_refused_by_all_that_measures():
    cube = with_beams(ROUND, WIDE, ROUND)
    scc = StackedCrossCorrelation(scales=[2], max_speed=3 * u.mas / u.yr)
    tracker = FeatureTracker(max_speed=3 * u.mas / u.yr)
    decompositions = [Decomposer(scales=[2])(image) for image in cube.data]
    calls = [
        lambda: scc(cube, n_trials=2, rng=1),
        lambda: scc.match(cube),
        lambda: measure_profile(scc, cube, [0, 1] * u.mas, n_trials=2, rng=1),
        lambda: tracker(cube, decompositions),
    ]
    for call in calls:
        with pytest.raises(ValueError, match="the beams differ") as refused:
            call()
        text = str(refused.value)
        assert "\n" not in text
        assert "0.52 x 0.5 mas at 0.0 deg in 2000-02-01" in text
        assert "cube.to_common_beam()" in text
        assert "common_beam=False" in text


def test_beams_that_differ_are_measured_when_that_is_stated(tmp_path):
    cube = with_beams(ROUND, WIDE, ROUND)
    scc = StackedCrossCorrelation(
        scales=[2], max_speed=3 * u.mas / u.yr, common_beam=False
    )
    assert len(scc.match(cube, cache=tmp_path / "m.fits").matches)
    # What was kept is no way around the refusal.
    with pytest.raises(ValueError, match="the beams differ"):
        StackedCrossCorrelation(scales=[2], max_speed=3 * u.mas / u.yr).match(
            cube, cache=tmp_path / "m.fits"
        )
    tracker = FeatureTracker(max_speed=3 * u.mas / u.yr, common_beam=False)
    links = tracker.link(cube, scc.match(cube).decompositions)
    assert (links.kind == "link").sum() == 2


def test_one_call_mends_beams_that_differ():
    cube = with_beams(ROUND, WIDE, ROUND).to_common_beam()
    scc = StackedCrossCorrelation(scales=[2], max_speed=3 * u.mas / u.yr)
    assert len(scc.match(cube).matches)
