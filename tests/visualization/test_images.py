# Licensed under a 3-clause BSD style license - see LICENSE.rst

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.collections import LineCollection
from matplotlib.colors import AsinhNorm, LogNorm
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D

from astro_scc import Beam, EpochCube
from astro_scc.visualization.drawing import image_limits, ssp_points, ticks_of
from astro_scc.visualization.epochs import plot_epoch, plot_epochs


def image_of(figure):
    return figure.axes[0].images[0]


def beam_of(figure):
    found = [p for p in figure.axes[0].patches if p.get_gid() == "beam"]
    return found[0] if found else None


def small_cube(**kwargs):
    rng = np.random.default_rng(1)
    data = rng.standard_normal((3, 20, 30))
    data[:, 5, 7] = 100
    values = {
        "data": data,
        "times": ["2000-01-01", "2000-07-01", "2001-01-01"],
        "pixel_scale": 0.1 * u.mas,
        **kwargs,
    }
    return EpochCube.from_arrays(**values)


def turned_wcs(angle, scale):
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---SIN", "DEC--SIN"]
    wcs.wcs.crval = [10, 20]
    wcs.wcs.crpix = [12, 8]
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    wcs.wcs.cd = np.array([[-c, s], [s, c]]) * scale
    return wcs


def test_plot_of_a_cube():
    cube = small_cube()
    assert cube.plot(1).axes[0].get_title() == "2000-07-01"
    assert len(cube.plot().axes) >= 3


def test_east_is_left_and_north_is_up(result):
    figure = plot_epoch(result.cube, 1, result.ssps)
    ax = figure.axes[0]
    left, right = ax.get_xlim()
    bottom, top = ax.get_ylim()
    assert left > right
    assert bottom < top
    assert ax.get_aspect() == 1
    assert ax.get_xlabel() == "Relative R.A. (mas)"
    assert ax.get_ylabel() == "Relative Decl. (mas)"
    assert ax.get_title() == "2000-01-31"


@pytest.mark.parametrize("angle", [0, 37, 180])
def test_a_pixel_is_drawn_at_its_offset(angle):
    cube = small_cube()
    cube = replace(cube, wcs=turned_wcs(angle, 2e-8))
    figure = plot_epoch(cube, 0, unit="uas")
    image = image_of(figure)
    to_axes = image.get_transform() - figure.axes[0].transData
    drawn = to_axes.transform([(7, 5), (0, 0)])
    east, north = cube.pixel_to_offset([7, 0], [5, 0])
    np.testing.assert_allclose(drawn[:, 0], east.to_value(u.uas), atol=1e-6)
    np.testing.assert_allclose(drawn[:, 1], north.to_value(u.uas), atol=1e-6)
    # Nothing of the image is cut off.
    corners = to_axes.transform([(-0.5, -0.5), (29.5, -0.5), (29.5, 19.5)])
    left, right = figure.axes[0].get_xlim()
    assert corners[:, 0].max() <= left + 1e-6
    assert corners[:, 0].min() >= right - 1e-6


@pytest.mark.parametrize(
    ("scale", "unit"),
    [(1e-4, "uas"), (0.1, "mas"), (300, "arcsec"), (2e4, "arcmin"), (2e6, "deg")],
)
def test_offsets_have_a_readable_unit(scale, unit):
    cube = small_cube(pixel_scale=scale * u.mas)
    assert f"({unit})" in plot_epoch(cube, 0).axes[0].get_xlabel()


def test_offsets_have_the_unit_that_was_asked_for():
    ax = plot_epoch(small_cube(), 0, unit=u.arcsec).axes[0]
    assert ax.get_xlim()[0] == pytest.approx(1.5e-3)


def test_the_beam_is_as_long_and_turned_as_it_is():
    beam = Beam(0.8 * u.mas, 0.3 * u.mas, 30 * u.deg)
    ellipse = beam_of(plot_epoch(small_cube(beams=beam), 0))
    # Curves are made polygons to a tenth of a unit or so: a thousand a mas.
    to_large = ellipse.get_patch_transform() + Affine2D().scale(1000)
    (outline,) = to_large.transform_path(ellipse.get_path()).to_polygons()
    outline = outline / 1000 - ellipse.get_center()
    # Smallest and largest radius, and the direction of the largest.
    radius = np.hypot(*outline.T)
    assert radius.max() == pytest.approx(0.4, rel=1e-2)
    far = outline[radius.argmax()]
    assert np.degrees(np.arctan2(*far)) % 180 == pytest.approx(30, abs=2)


def test_no_beam_draws_no_beam():
    assert beam_of(plot_epoch(small_cube(), 0)) is None


def test_all_ssps_of_the_epoch_are_drawn_by_scale(result):
    ssps = result.ssps
    ax = plot_epoch(result.cube, 2, ssps, zoom=False).axes[0]
    for scale in (1.0, 2.0, 3.0):
        lines = [x for x in ax.lines if x.get_gid() == f"ssps {scale:g}"]
        east = np.concatenate([line.get_xdata() for line in lines])
        here = (ssps["epoch"] == 2) & (ssps["scale"] == scale)
        np.testing.assert_allclose(np.sort(east), np.sort(ssps["east"][here].value))
    colors = {x.get_markeredgecolor() for x in ax.lines if x.get_gid()}
    assert len(colors) == 3
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["SSPs of scale 0.2", "0.4", "0.8 mas"]


def test_ssps_outside_the_region_are_pale(result):
    ssps = result.ssps.copy()
    ssps["in_region"] = ssps["east"] > -8 * u.mas
    ax = plot_epoch(result.cube, 2, ssps).axes[0]
    pale = [x for x in ax.lines if x.get_gid() and x.get_alpha() < 1]
    east = np.concatenate([line.get_xdata() for line in pale])
    assert len(east) == np.sum((ssps["epoch"] == 2) & ~ssps["in_region"])
    assert np.all(east <= -8)
    assert ax.get_legend().get_texts()[-1].get_text() == "not used"


def test_outlines_are_the_edges_of_the_pixels(result):
    cube, ssps = result.cube, result.matched.ssps
    figure = plot_epoch(cube, 0, ssps, zoom=False)
    drawn = {
        tuple(color): len(c.get_segments())
        for c in figure.axes[0].collections
        if isinstance(c, LineCollection)
        for color in c.get_colors()
    }
    expected = []
    for scale in np.unique(ssps.scale):
        label = np.zeros(cube.shape[1:], int)
        for k in np.flatnonzero((ssps.epoch == 0) & (ssps.scale == scale)):
            label.ravel()[ssps.pixels_of(k)] = k + 1
        label = np.pad(label, 1)
        expected.append(sum(np.sum(np.diff(label, axis=a) != 0) for a in (0, 1)))
    assert sorted(drawn.values()) == sorted(expected)


def test_the_edge_of_one_pixel_is_where_the_pixel_is(result):
    from astro_scc.decomposition import SSPs

    cube = small_cube()
    one = np.ones(1)
    ssps = SSPs(
        scale=one, y=5 * one, x=7 * one, y_centroid=5 * one, x_centroid=7 * one,
        peak=one, flux=one, snr=9 * one, bbox=np.array([[5, 7, 6, 8]]),
        starts=np.array([0, 1]), pixels=np.array([5 * 30 + 7]),
        epoch=np.zeros(1, int),
    )  # fmt: skip
    ax = plot_epoch(cube, 0, ssps).axes[0]
    (edges,) = (c for c in ax.collections if c.get_gid() == "outlines")
    corners = np.unique(np.concatenate(edges.get_segments()).round(6), axis=0)
    east, north = cube.pixel_to_offset([6.5, 6.5, 7.5, 7.5], [4.5, 5.5, 4.5, 5.5])
    expected = np.stack([east.value, north.value], axis=-1).round(6)
    np.testing.assert_allclose(corners, np.unique(expected, axis=0), atol=1e-9)


def test_masked_pixels_are_no_data_and_named():
    mask = np.zeros((3, 20, 30), bool)
    mask[0, :5, :5] = True
    data = np.ones((3, 20, 30))
    data[0, :5, :5] = 1e6
    figure = plot_epoch(small_cube(data=data, mask=mask), 0)
    drawn = image_of(figure)
    assert np.ma.getmaskarray(drawn.get_array()).sum() == 25
    assert drawn.norm.vmax < 1e6
    (text,) = figure.axes[0].get_legend().get_texts()
    assert text.get_text() == "masked"
    assert plot_epoch(small_cube(), 0).axes[0].get_legend() is None


@pytest.mark.parametrize("value", [0.0, -1.0, 5.0])
@pytest.mark.parametrize("stretch", ["asinh", "log", "linear"])
def test_flat_images_are_drawn(value, stretch):
    data = np.full((3, 20, 30), value)
    norm = image_of(plot_epoch(small_cube(data=data), 0, stretch=stretch)).norm
    assert norm.vmin < norm.vmax


def test_the_limits_of_brightness_are_those_asked_for():
    norm = image_of(plot_epoch(small_cube(), 0, vmin=-2, vmax=50)).norm
    assert isinstance(norm, AsinhNorm)
    assert (norm.vmin, norm.vmax) == (-2, 50)
    norm = image_of(plot_epoch(small_cube(), 0, stretch="log", vmin=0.5)).norm
    assert isinstance(norm, LogNorm)
    assert norm.vmin == 0.5


def test_ticks_of_a_wide_range_are_zero_and_powers_of_ten():
    assert ticks_of(AsinhNorm(0.004, vmin=-1e-3, vmax=3)) == [0, 0.01, 0.1, 1]
    assert ticks_of(AsinhNorm(0.4, vmin=-1, vmax=3)) is None


def test_epochs_are_counted_from_the_end_too():
    cube = small_cube()
    assert plot_epoch(cube, -1).axes[0].get_title() == "2001-01-01"


def test_epochs_of_one_day_have_their_time():
    cube = small_cube(times=["2000-01-01", "2000-01-01T12:00", "2000-01-02"])
    assert plot_epoch(cube, 1).axes[0].get_title() == "2000-01-01 12:00"
    assert plot_epoch(cube, 2).axes[0].get_title() == "2000-01-02"


def test_the_brightness_has_its_unit():
    def label(figure):
        # The bar is laid beside the axes as their child.
        return figure.axes[0].child_axes[0].get_ylabel()

    assert label(plot_epoch(small_cube(), 0)) == "Brightness"
    assert label(plot_epoch(small_cube(unit="Jy / beam"), 0)) == "Brightness (Jy/beam)"
    assert not plot_epoch(small_cube(), 0, colorbar=False).axes[0].child_axes


def dates_of(figure):
    return [ax.texts[0].get_text() for ax in figure.axes if ax.images and ax.texts]


def test_all_epochs_have_a_panel_of_the_same_colours(result):
    figure = plot_epochs(result.cube, result.ssps)
    assert dates_of(figure) == list(result.cube.times.strftime("%Y-%m-%d"))
    norms = {id(ax.images[0].norm) for ax in figure.axes if ax.images}
    assert len(norms) == 1
    assert figure.get_supxlabel() == "Relative R.A. (mas)"


@pytest.mark.slow
def test_of_many_epochs_some_are_chosen_evenly():
    n = 40
    cube = EpochCube.from_arrays(
        np.zeros((n, 16, 16)),
        [f"20{k:02d}-01-01" for k in range(n)],
        pixel_scale=0.1 * u.mas,
    )
    dates = dates_of(plot_epochs(cube, max_panels=7))
    assert len(dates) == 7
    assert dates[0] == "2000-01-01"
    assert dates[-1] == "2039-01-01"
    steps = np.diff([int(date[:4]) for date in dates])
    assert steps.max() - steps.min() <= 1
    assert len(dates_of(plot_epochs(cube))) == 12
    assert len(dates_of(plot_epochs(cube, max_panels=1))) == 1


def test_one_epoch_is_one_panel(cube):
    assert len(dates_of(plot_epochs(cube[:1]))) == 1


def test_figures_show_where_ssps_are(result):
    cube = result.cube
    whole = image_limits(cube)
    near = image_limits(cube, ssp_points(cube, result.ssps))
    assert np.all(near[:, 0] >= whole[:, 0])
    assert np.all(near[:, 1] <= whole[:, 1])
    assert np.prod(np.ptp(near, axis=1)) < 0.8 * np.prod(np.ptp(whole, axis=1))
    inside = (result.ssps["east"] > near[0, 0] * u.mas) & (
        result.ssps["east"] < near[0, 1] * u.mas
    )
    assert inside.mean() > 0.95


@settings(max_examples=30, deadline=None)
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


def test_panels_are_laid_out_for_the_figure(result):
    def columns(figure):
        panels = plot_epochs(result.cube, result.ssps, figure=figure).axes
        return len({round(ax.get_position().x0, 2) for ax in panels if ax.images})

    assert columns(Figure(figsize=(9, 2))) > columns(Figure(figsize=(3, 9))) == 1
