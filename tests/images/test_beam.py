# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Beams, those that differ, a common one, and the one of an image among several."""

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.epochs import Beam, inspect_epochs
from astro_scc.images.beam import parse_beam, smallest_common_beam
from astro_scc.images.grid import common_beam
from astro_scc.images.positions import offset_wcs

DATES = ["2000-01-01", "2000-02-01", "2000-03-01"]
PIXEL = 0.1 * u.mas
JY_BEAM = u.Jy / u.beam


def beam(major, minor, pa=0.0):
    return Beam(major * u.mas, minor * u.mas, pa * u.deg)


ROUND, WIDE = beam(0.5, 0.5), beam(0.52, 0.5)


def test_beams_of_radio_beam():
    radio_beam = pytest.importorskip("radio_beam")
    beams = radio_beam.Beams([3] * 3 * u.mas, [1, 2, 3] * u.mas, [10, 20, 30] * u.deg)
    data = np.random.default_rng(1).normal(size=(3, 8, 8))
    cube = EpochCube.from_arrays(data, DATES, pixel_scale=PIXEL, beams=beams)
    assert [one.minor.value for one in cube.beams] == [1, 2, 3]


def with_beams(*beams):
    """A feature that moves a pixel an epoch, with a beam for each epoch."""
    y, x = np.mgrid[:32, :32]
    images = [np.exp(-((x - 12 - k) ** 2 + (y - 16) ** 2) / 8) for k in range(3)]
    fields = {"noise": 0.01 * u.one, "beams": beams or None}
    return EpochCube.from_arrays(np.array(images), DATES, pixel_scale=PIXEL, **fields)


def test_beams_that_differ_are_refused_until_that_is_stated():
    cube, fast = with_beams(ROUND, WIDE, ROUND), 3 * u.mas / u.yr
    scc = StackedCrossCorrelation(scales=[2], max_speed=fast)
    stated = StackedCrossCorrelation(scales=[2], max_speed=fast, common_beam=False)
    assert len(stated.match(cube).matches)
    words = r"0.52 x 0.5 mas at 0.0 deg in 2000-02-01: give cube.to_common_beam\(\), or"
    with pytest.raises(ValueError, match=f"the beams differ, .*{words}"):
        scc.match(cube)


CHANNELS = np.linspace(4.0, 1.0, 4)
ONE = [{"CHAN": 0, "POL": 0, "BMAJ": 2.0}]
FOUR = [{"CHAN": k, "POL": 0, "BMAJ": width} for k, width in enumerate(CHANNELS)]
FROM_1 = [row | {"CHAN": row["CHAN"] + 1} for row in FOUR]
STOKES = [{"CHAN": 0, "POL": k, "BMAJ": width} for k, width in enumerate(CHANNELS)]
BOTH = [row | {"POL": k, "BMAJ": row["BMAJ"] + 5 * k} for k in (0, 1) for row in FOUR]
BLANK = [row | {"BMAJ": 2.0 * (row["CHAN"] == 2)} for row in FOUR]
VELOCITY = {"CTYPE3": "VRAD", "CUNIT3": "m/s", "CDELT3": 1e3}
#: Forms and units of the columns of a table BEAMS, by the starts of their names.
KINDS = {"CHA": ("1J",), "POL": ("1J",), "BPA": ("1E", "deg")}
KINDS |= dict.fromkeys(("BMA", "BMI"), ("1E", "arcsec"))
#: Rows of such a table (0.1 mas), changes of the header, and the major axis.
BEAMS = [
    (ONE, {}, 2.0),
    (FOUR, {"CRPIX3": -1.0, **VELOCITY}, 2.0),
    (FROM_1, {"CRPIX3": -2.0}, 1.0),
    (STOKES, {}, 4.0),
    (BOTH, {"CRPIX3": -2.0, "CRPIX4": 0.0}, 6.0),
    (BLANK, {}, 2.0),
    # What the header says counts.
    (FOUR, {"BMAJ": 5 / 3.6e7, "BMIN": 1 / 3.6e7, "BPA": 0.0}, 5.0),
]
UNKNOWN = [
    (FOUR, {"CRPIX3": -7.0}),
    (FOUR, {"CTYPE3": None}),
    (BOTH, {}),
    ([{"BMAJ": width} for width in CHANNELS], {"CRPIX3": 0.0}),
]


@pytest.fixture
def with_table(make_fits):
    """Write an image with a table of beams."""

    def make(rows, changes, name="a.fits"):
        own = dict.fromkeys(("BMAJ", "BMIN", "BPA")) | changes
        path = make_fits(name, **own)
        columns = {"BMIN": np.full(len(rows), 1e-4), "BPA": np.zeros(len(rows))}
        columns |= {key: [row[key] for row in rows] for key in rows[0]}
        columns["BMAJ"] = np.divide(columns["BMAJ"], 1e4)
        table = fits.BinTableHDU.from_columns(
            [fits.Column(key, *KINDS[key[:3]], array=values)
             for key, values in columns.items()], name="BEAMS"
        )  # fmt: skip
        fits.append(path, table.data, table.header)
        return path

    return make


@pytest.mark.parametrize(("rows", "changes", "major"), BEAMS)
def test_the_beam_of_the_channel(with_table, rows, changes, major):
    cube = EpochCube.read(with_table(rows, changes))
    assert cube.beams[0].major.to_value(u.mas) == pytest.approx(major / 10, rel=1e-6)


@pytest.mark.parametrize(("rows", "changes"), UNKNOWN)
def test_which_channel_it_is_cannot_be_told(with_table, rows, changes):
    path = with_table(rows, changes)
    words = f"its table BEAMS has {len(rows)} beams, and which one is that of its chan"
    with pytest.raises(ValueError, match=f"a.fits: {words}"):
        EpochCube.read(path)
    assert words in inspect_epochs(path)["problem"][0]
    given = Beam(1 * u.mas, 1 * u.mas)
    assert EpochCube.read(path, beams=given).beams == (given,)


def source(cube, covariance):
    """A Gaussian of peak 1 on the grid of a cube, from sky covariances."""
    e, n = (v.to_value(u.mas) for v in cube.offsets())
    d = np.stack([e - 0.33, n + 0.21])
    inverse = np.linalg.inv(covariance.to_value(u.mas**2))
    return np.exp(-0.5 * np.einsum("iyx,ij,jyx->yx", d, inverse, d))


def point_sources(*beams, unit=JY_BEAM, turn=0.0, **fields):
    """Images of one point source of 1 Jy by several beams, on turned axes."""
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    wcs = offset_wcs(PIXEL, (39, 47))
    wcs.wcs.pc = [[c, -s], [s, c]]
    dates = DATES[: len(beams)]
    empty = EpochCube(np.zeros((len(beams), 96, 80)), dates, wcs)
    data = np.array([source(empty, b.covariance) for b in beams])
    return EpochCube(data, dates, wcs, unit=unit, beams=beams, **fields)


def test_point_sources_come_out_as_the_common_beam():
    cube = point_sources(beam(1, 0.6, -20), beam(0.9, 0.7, 40), beam(0.8, 0.55, 80),
                         turn=35)  # fmt: skip
    result = common_beam(cube)
    expected = source(cube, result.beams[0].covariance)
    for image in result.data:
        assert_allclose(image, expected, atol=5e-6)
    assert (result.unit, result.noise) == (cube.unit, None)
    assert "3 of 3 epochs" in result.meta["history"][-1]
    # A beam that grows by 0.05 px only grows exactly by that.
    wider = beam(1.0006, 0.6006, -20)
    grown = common_beam(cube[:1], wider)
    assert_allclose(grown.data[0], source(cube, wider.covariance), atol=5e-6)
    assert np.abs(grown.data[0] - cube.data[0]).max() > 3e-4


@pytest.mark.parametrize("unit", [JY_BEAM, u.Jy / u.pix])
def test_flux_density_and_intensities_per_pixel_are_conserved(unit):
    cube = point_sources(beam(1.0, 0.6, -20), beam(0.7, 0.7), unit=unit)
    result = common_beam(cube, beam(1.5, 1.2, 10))
    before, after = (
        [image.sum() / (b.area if unit == JY_BEAM else 1 * u.mas**2)
         for image, b in zip(c.data, c.beams, strict=True)] for c in (cube, result)
    )  # fmt: skip
    assert u.allclose(before, after, rtol=1e-6)


def test_bad_pixels_and_edges_do_not_darken():
    data, mask = np.full((1, 40, 50), 7.0), np.zeros((1, 40, 50), dtype=bool)
    data[0, 10:14, 20], mask[0, 30, 5:9] = np.nan, True
    data[mask] = 1e9
    fields = {"mask": mask, "beams": beam(0.2, 0.2), "unit": u.Jy / u.pix}
    cube = EpochCube.from_arrays(data, DATES[:1], pixel_scale=PIXEL, **fields)
    result = common_beam(cube, beam(1.0, 0.7))
    assert_array_equal(result.mask, cube.mask)
    assert_array_equal(np.isnan(result.data), cube.mask)
    assert_allclose(result.data[~result.mask], 7, rtol=1e-9)


def least_area(beams):
    """Major times minor axis of the least ellipse, by a grid that closes in."""
    others = np.array([b.covariance.value for b in beams]) * 8 * np.log(2)
    steps = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 2), axis=-1).reshape(-1, 2)
    centre, width, least = np.zeros(2), 3.0, np.inf
    for _ in range(40):
        # Ellipses of area 1: logarithm of the axis ratio along two directions.
        points = centre + width * steps
        r = np.hypot(*points.T)
        a, b = (points * (np.sinh(r) / np.maximum(r, 1e-12))[:, None]).T
        inverse = np.array([[np.cosh(r) - a, -b], [-b, np.cosh(r) + a]])
        products = np.moveaxis(inverse, -1, 0)[:, None] @ others
        largest = np.linalg.eigvals(products).real.max(axis=(1, 2))
        centre, width = points[np.argmin(largest)], 0.75 * width
        least = min(least, largest.min())
    return least


SHAPES = st.tuples(st.floats(0.3, 3), st.floats(0.2, 1), st.floats(-90, 90))


@pytest.mark.slow
@settings(max_examples=20)
@given(st.lists(SHAPES, min_size=1, max_size=6))
@example([(1.0, 1.0, 0.0), (2.0, 0.21875, 45.0)])
def test_the_smallest_common_beam_contains_all(shapes):
    beams = [beam(major, major * ratio, pa) for major, ratio, pa in shapes]
    result = smallest_common_beam(beams)
    left = [(result.covariance - b.covariance).value for b in beams]
    assert np.linalg.eigvalsh(left).min() >= -2e-6 * result.major.value**2
    area = float(result.major * result.minor / u.mas**2)
    assert area <= least_area(beams) * (1 + 1e-5)


CUBE = point_sources(beam(0.5, 0.5), beam(1.0, 0.6))


def test_what_is_no_beam_or_no_common_one():
    for call, words in [
        (lambda: beam(1, 2), "is finite with major >= minor > 0, got"),
        (lambda: parse_beam("1 mas 0.5 mas"), "is no beam: .*; give major axis, min"),
        (lambda: common_beam(CUBE, beam(0.9, 0.9)),
         r"2000-02-01: its beam 1 x 0.6 mas at .* fit"),
        (lambda: Beam([1, 2] * u.mas, 1 * u.mas), "are single angles, got 2; make a"),
        (lambda: common_beam(CUBE, 3.0), "a beam has major, minor and pa, got float"),
        (lambda: common_beam(CUBE.with_step("", beams=None)), "have no beams"),
    ]:  # fmt: skip
        with pytest.raises((ValueError, TypeError), match=words):
            call()
