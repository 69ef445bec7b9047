# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images, their SSPs and dates: what is drawn where, in which unit and how bright."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.colors import AsinhNorm, LogNorm
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D

from astro_scc import Beam, EpochCube
from astro_scc.decomposition import SSPs
from astro_scc.images.positions import sky_columns
from astro_scc.report.page import component_tables
from astro_scc.stacking.velocities import baseline_pairs
from astro_scc.units import speed_unit
from astro_scc.visualization.drawing import image_limits, ssp_points, ticks_of
from astro_scc.visualization.epochs import plot_intervals


def small_cube(**kwargs):
    rng = np.random.default_rng(1)
    data = rng.standard_normal((3, 20, 30))
    data[:, 5, 7] = 100
    times = ["2000-01-01", "2000-07-01", "2001-01-01"]
    values = {"data": data, "times": times, "pixel_scale": 0.1 * u.mas, **kwargs}
    return EpochCube.from_arrays(**values)


def test_east_is_left_and_north_is_up(cube):
    ax = cube.plot(1).axes[0]
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert left > right
    assert bottom < top
    assert ax.get_aspect() == 1
    labels = ax.get_xlabel(), ax.get_ylabel()
    assert labels == ("Relative R.A. (mas)", "Relative Decl. (mas)")


@pytest.mark.parametrize("angle", [0, 37, 180])
def test_a_pixel_is_drawn_at_its_offset(angle):
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval = ["RA---SIN", "DEC--SIN"], [10, 20]
    wcs.wcs.crpix = [12, 8]
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    wcs.wcs.cd = np.array([[-c, s], [s, c]]) * 2e-8
    cube = replace(small_cube(), wcs=wcs)
    ax = cube.plot(0, unit="uas").axes[0]
    to_axes = ax.images[0].get_transform() - ax.transData
    drawn = to_axes.transform([(7, 5), (0, 0)])
    offsets = u.Quantity(cube.pixel_to_offset([7, 0], [5, 0])).to_value(u.uas)
    np.testing.assert_allclose(drawn, offsets.T, atol=1e-6)
    # Nothing of the image is cut off.
    corners = to_axes.transform([(-0.5, -0.5), (29.5, -0.5), (29.5, 19.5)])
    left, right = ax.get_xlim()
    assert right - 1e-6 <= corners[:, 0].min() < corners[:, 0].max() <= left + 1e-6


@pytest.mark.parametrize(
    ("scale", "unit", "label"),
    [
        (1e-4, None, "uas"),
        (0.1, None, "mas"),
        (300, None, "arcsec"),
        (2e4, None, "arcmin"),
        (2e6, None, "deg"),
        (0.1, u.arcsec, "arcsec"),
    ],
)
def test_offsets_have_a_readable_unit_or_that_asked_for(scale, unit, label):
    cube = small_cube(pixel_scale=scale * u.mas)
    assert f"({label})" in cube.plot(0, unit=unit).axes[0].get_xlabel()


def test_the_beam_is_as_long_and_turned_as_it_is():
    def beam_of(cube):
        patches = cube.plot(0).axes[0].patches
        return [patch for patch in patches if patch.get_gid() == "beam"]

    beam = Beam(0.8 * u.mas, 0.3 * u.mas, 30 * u.deg)
    (ellipse,) = beam_of(small_cube(beams=beam))
    # Curves are made polygons to a tenth of a unit or so: a thousand a mas.
    to_large = ellipse.get_patch_transform() + Affine2D().scale(1000)
    (outline,) = to_large.transform_path(ellipse.get_path()).to_polygons()
    outline = outline / 1000 - ellipse.get_center()
    radius = np.hypot(*outline.T)
    assert radius.max() == pytest.approx(0.4, rel=1e-2)
    far = outline[radius.argmax()]
    assert np.degrees(np.arctan2(*far)) % 180 == pytest.approx(30, abs=2)
    assert not beam_of(small_cube())


def test_ssps_of_the_epoch_are_drawn_by_scale_and_pale_outside_the_region(result):
    ssps = result.ssps.copy()
    ssps["in_region"] = ssps["east"] > -8 * u.mas
    ax = result.cube.plot(2, ssps, zoom=False).axes[0]
    for scale in (1.0, 2.0, 3.0):
        lines = [x for x in ax.lines if x.get_gid() == f"ssps {scale:g}"]
        east = np.concatenate([line.get_xdata() for line in lines])
        here = (ssps["epoch"] == 2) & (ssps["scale"] == scale)
        np.testing.assert_allclose(np.sort(east), np.sort(ssps["east"][here].value))
    pale = [x for x in ax.lines if x.get_gid() and x.get_alpha() < 1]
    east = np.concatenate([line.get_xdata() for line in pale])
    assert len(east) == np.sum((ssps["epoch"] == 2) & ~ssps["in_region"])
    assert np.all(east <= -8)
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["SSPs of scale 0.2", "0.4", "0.8 mas", "not used"]


def test_outlines_are_the_edges_of_the_pixels(result):
    def outlines(cube, ssps):
        ax = cube.plot(0, ssps, zoom=False).axes[0]
        return [c.get_segments() for c in ax.collections if c.get_gid() == "outlines"]

    cube, ssps, expected = result.cube, result.matched.ssps, []
    for scale in np.unique(ssps.scale):
        label = np.zeros(cube.shape[1:], int)
        for k in np.flatnonzero((ssps.epoch == 0) & (ssps.scale == scale)):
            label.ravel()[ssps.pixels_of(k)] = k + 1
        label = np.pad(label, 1)
        expected.append(sum(np.sum(np.diff(label, axis=a) != 0) for a in (0, 1)))
    assert list(map(len, outlines(cube, ssps))) == expected
    # And one of a single pixel is where the pixel is.
    cube, one = small_cube(), np.ones(1)
    ssps = SSPs(
        scale=one, y=5 * one, x=7 * one, y_centroid=5 * one, x_centroid=7 * one,
        peak=one, flux=one, snr=9 * one, bbox=np.array([[5, 7, 6, 8]]),
        starts=np.array([0, 1]), pixels=np.array([5 * 30 + 7]),
        epoch=np.zeros(1, int),
    )  # fmt: skip
    (edges,) = outlines(cube, ssps)
    offsets = cube.pixel_to_offset([6.5, 6.5, 7.5, 7.5], [4.5, 5.5, 4.5, 5.5])
    expected = np.stack([axis.value for axis in offsets], axis=-1).round(6)
    corners = np.unique(np.concatenate(edges).round(6), axis=0)
    np.testing.assert_allclose(corners, np.unique(expected, axis=0), atol=1e-9)


def test_masked_pixels_are_no_data_and_named():
    mask = np.zeros((3, 20, 30), bool)
    mask[0, :5, :5] = True
    ax = small_cube(data=np.where(mask, 1e6, 1.0), mask=mask).plot(0).axes[0]
    (drawn,) = ax.images
    assert np.ma.getmaskarray(drawn.get_array()).sum() == 25
    assert drawn.norm.vmax < 1e6
    (text,) = ax.get_legend().get_texts()
    assert text.get_text() == "masked"


@pytest.mark.parametrize("value", [0.0, -1.0, 5.0])
@pytest.mark.parametrize("stretch", ["asinh", "log", "linear"])
def test_flat_images_are_drawn(value, stretch):
    cube = small_cube(data=np.full((3, 20, 30), value))
    norm = cube.plot(0, stretch=stretch).axes[0].images[0].norm
    assert norm.vmin < norm.vmax


def test_brightness_has_the_limits_unit_and_ticks_that_fit():
    figure = small_cube(unit="Jy / beam").plot(0, vmin=-2, vmax=50)
    norm = figure.axes[0].images[0].norm
    assert isinstance(norm, AsinhNorm)
    assert (norm.vmin, norm.vmax) == (-2, 50)
    # The bar is laid beside the axes as their child.
    assert figure.axes[0].child_axes[0].get_ylabel() == "Brightness (Jy/beam)"
    ax = small_cube().plot(0, stretch="log", vmin=0.5, colorbar=False).axes[0]
    assert isinstance(ax.images[0].norm, LogNorm)
    assert ax.images[0].norm.vmin == 0.5
    assert not ax.child_axes
    assert ticks_of(AsinhNorm(0.004, vmin=-1e-3, vmax=3)) == [0, 0.01, 0.1, 1]
    assert ticks_of(AsinhNorm(0.4, vmin=-1, vmax=3)) is None


def test_epochs_have_their_date_and_of_one_day_their_time():
    cube = small_cube(times=["2000-01-01", "2000-01-01T12:00", "2000-01-02"])
    titles = [cube.plot(k).axes[0].get_title() for k in (1, -1)]
    assert titles == ["2000-01-01 12:00", "2000-01-02"]


def dates_of(figure):
    return [ax.texts[0].get_text() for ax in figure.axes if ax.images and ax.texts]


def test_epochs_have_panels_of_the_same_colours(result):
    figure = result.plot("epochs")
    assert dates_of(figure) == list(result.cube.times.strftime("%Y-%m-%d"))
    assert len({id(ax.images[0].norm) for ax in figure.axes if ax.images}) == 1
    assert figure.get_supxlabel() == "Relative R.A. (mas)"

    def columns(size):
        panels = result.plot("epochs", figure=Figure(figsize=size)).axes
        return len({round(ax.get_position().x0, 2) for ax in panels if ax.images})

    assert columns((9, 2)) > columns((3, 9)) == 1


def test_of_many_epochs_some_are_chosen_evenly():
    dates = [f"20{k:02d}-01-01" for k in range(40)]
    cube = small_cube(data=np.zeros((40, 16, 16)), times=dates)
    years = [int(date[:4]) for date in dates_of(cube.plot(max_panels=7))]
    assert (len(years), years[0], years[-1]) == (7, 2000, 2039)
    assert np.ptp(np.diff(years)) <= 1
    assert len(dates_of(cube.plot(max_panels=1))) == 1


def test_the_beam_and_the_date_lie_where_there_is_no_light():
    data = np.full((2, 40, 40), 1e-3)
    data[:, :9, :9] = data[:, -9:, -9:] = 1.0
    data += np.random.default_rng(1).normal(0, 1e-4, data.shape)
    cube = small_cube(
        data=data, times=["2000-01-01", "2001-01-01"], pixel_scale=1 * u.mas,
        beams=Beam(2 * u.mas, 2 * u.mas),
    )  # fmt: skip
    for ax in cube.plot().axes[:2]:
        (beam,), (text,) = ax.patches, ax.texts
        x, y = ax.transAxes.inverted().transform(ax.transData.transform(beam.center))
        a, b = text.get_position()
        # East is to the left: light is in the lower left and the upper right.
        corners = {(x > 0.5, y > 0.5), (a > 0.5, b > 0.5)}
        assert corners == {(True, False), (False, True)}


def test_figures_show_where_ssps_are(result):
    whole = image_limits(result.cube)
    near = image_limits(result.cube, ssp_points(result.cube, result.ssps))
    assert np.prod(np.ptp(near, axis=1)) < 0.8 * np.prod(np.ptp(whole, axis=1))
    east = result.ssps["east"].value
    assert np.mean((east > near[0, 0]) & (east < near[0, 1])) > 0.95


@settings(max_examples=20, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-3, 3), st.floats(-2, 2), st.floats(4, 1e4)), min_size=1
    )
)
def test_limits_are_a_part_of_the_image_that_is_not_empty(ssps):
    cube = small_cube(pixel_scale=0.3 * u.mas)
    east, north, snr = np.array(ssps).T
    weight = 0.05 + np.log(snr / snr.min())
    points = {"place": np.stack([east, north]), "weight": weight}
    whole, near = image_limits(cube), image_limits(cube, points)
    assert np.all(near[:, 1] > near[:, 0])
    assert np.all((near >= whole[:, :1] - 1e-9) & (near <= whole[:, 1:] + 1e-9))


# -- dates ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("days", "unit", "longest"),
    [
        ([0, 100, 900], "yr", 800 / 365.25),
        ([0, 10, 40], "d", 30),
        ([0, 0.1, 0.4], "h", 7.2),
        ([0, 0.01, 0.02], "min", 14.4),
        (np.arange(30) * 20, "d", 280),
    ],
)
def test_pairs_of_epochs_are_bars_as_high_as_their_interval(days, unit, longest):
    times = Time("2000-01-01") + np.asarray(days) * u.day
    cube = small_cube(data=np.ones((len(days), 8, 8)), times=times)
    pairs, many = None, len(days) > 3
    first, second = np.arange(len(days) - 1), np.arange(1, len(days))
    if many:
        pairs = baseline_pairs(cube.years.value, 0.2, 0.8)
        first, second = pairs.first, pairs.second
    ax = plot_intervals(cube, pairs).axes[0]
    (bars,) = (c.get_segments() for c in ax.collections if c.get_gid() == "pairs")
    bars, dates = np.array(bars), cube.times.plot_date
    assert bars[:, :, 1].max() == pytest.approx(longest)
    np.testing.assert_allclose(bars[:, 0, 0], dates[first])
    np.testing.assert_allclose(bars[:, 1, 0], dates[second])
    assert ax.get_ylabel() == f"Time between epochs ({unit})"


# -- other frames on the sky ---------------------------------------------------------


def in_frame(result, *ctype):
    wcs = result.cube.wcs.deepcopy()
    wcs.wcs.ctype = ctype
    cube = replace(result.cube, wcs=wcs)
    return replace(result, matched=replace(result.matched, cube=cube))


@pytest.fixture(scope="module")
def of_the_sun(jet_results):
    return in_frame(jet_results["sky"], "HPLN-TAN", "HPLT-TAN")


def test_the_sun_has_west_to_the_right(of_the_sun, jet_results):
    ax = of_the_sun.cube.plot(0).axes[0]
    labels = ax.get_xlabel(), ax.get_ylabel()
    assert labels == ("Offset to solar west (mas)", "Offset to solar north (mas)")
    assert not ax.xaxis_inverted()
    for kind in ("epochs", "members"):
        figure = of_the_sun.plot(kind)
        assert figure.get_supxlabel() == "Offset to solar west (mas)"
        assert not figure.axes[0].xaxis_inverted()
    ax, sky = (result.plot().axes[0] for result in (of_the_sun, jet_results["sky"]))
    assert ax.get_xlabel() == "Proper motion to solar west (mas/yr)"
    assert (ax.xaxis_inverted(), sky.xaxis_inverted()) == (False, True)
    # The arrow points where the features go.
    arrows = [next(t for t in k.texts if t.get_gid() == "jet") for k in (ax, sky)]
    assert np.prod([arrow.xy[0] - arrow.xyann[0] for arrow in arrows]) < 0
    label = of_the_sun.plot("diagram").axes[0].get_ylabel()
    assert label.startswith("Displacement 2")
    assert "from north to solar west" in label


def test_other_frames_are_named(jet_results):
    galactic = in_frame(jet_results["sky"], "GLON-SIN", "GLAT-SIN")
    ax = galactic.cube.plot(0).axes[0]
    labels = ax.get_xlabel(), ax.get_ylabel()
    assert labels == ("Offset to galactic east (mas)", "Offset to galactic north (mas)")
    assert ax.xaxis_inverted()
    label = galactic.plot().axes[0].get_xlabel()
    assert label == "Proper motion to galactic east (mas/yr)"


def test_columns_and_maps_are_named_by_the_frame(of_the_sun, jet_results):
    theirs, ours = of_the_sun.components, jet_results["sky"].components
    assert sky_columns(theirs) == ("pm_lon_coslat", "pm_lat")
    for name in ("", "_err"):
        assert np.array_equal(theirs[f"pm_lat{name}"], ours[f"pm_dec{name}"])
    assert theirs["pm_pa"].info.description.endswith("north through solar west")
    tables = component_tables(theirs)
    heads = {heading for columns in tables for heading, *_ in columns}
    assert {"longitude (mas/yr)", "latitude (mas/yr)"} <= heads
    ssps = of_the_sun.ssps
    lines = of_the_sun.cube.plot(0, ssps).axes[0].lines
    shown = np.concatenate([line.get_xdata() for line in lines])
    here = ssps["epoch"] == 0
    assert sorted(shown) == pytest.approx(sorted(ssps["lon_offset"][here].value))
    image = of_the_sun.velocity_map()
    assert list(image.wcs.wcs.ctype) == ["LON", "LAT"]
    assert image.meta["axes"] == ("lon", "lat")


@pytest.mark.parametrize(
    ("span", "resolution", "interval", "unit"),
    [
        (20 * u.yr, 1 * u.mas, 0.2 * u.yr, u.mas / u.yr),
        (12 * u.yr, 0.1 * u.arcsec, 2 * u.yr, u.mas / u.yr),
        (12 * u.yr, 2 * u.arcsec, 1 * u.yr, u.arcsec / u.yr),
        (11 * u.d, 30 * u.mas, 1 * u.d, u.mas / u.d),
        (8 * u.h, 20 * u.uas, 2 * u.min, u.mas / u.h),
        (8 * u.h, 1.2 * u.arcsec, 12 * u.min, u.arcsec / u.h),
    ],
)
def test_speeds_have_units_that_are_easily_read(span, resolution, interval, unit):
    assert speed_unit(span, resolution, interval) == unit
