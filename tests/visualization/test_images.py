# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images and their SSPs: what is drawn where, in which unit and how bright."""

import re
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
from astro_scc.units import offset_unit, speed_unit
from astro_scc.visualization.images import epoch_names, image_limits, ticks_of


def small_cube(**kwargs):
    data = np.random.default_rng(1).standard_normal((3, 20, 30))
    data[:, 5, 7] = 100
    times = ["2000-01-01", "2000-07-01", "2001-01-01"]
    values = {"data": data, "times": times, "pixel_scale": 0.1 * u.mas, **kwargs}
    return EpochCube.from_arrays(**values)


def labels(ax):
    return ax.get_xlabel(), ax.get_ylabel()


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_a_pixel_is_drawn_at_its_offset():
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval = ["RA---SIN", "DEC--SIN"], [10, 20]
    wcs.wcs.crpix = [12, 8]
    c, s = np.cos(np.radians(37)), np.sin(np.radians(37))
    wcs.wcs.cd = np.array([[-c, s], [s, c]]) * 2e-8
    cube = replace(small_cube(), wcs=wcs)
    ax = cube.plot(0, unit="uas").axes[0]
    to_axes = ax.images[0].get_transform() - ax.transData
    offsets = u.Quantity(cube.pixel_to_offset([7, 0], [5, 0])).to_value(u.uas)
    drawn = to_axes.transform([(7, 5), (0, 0)])
    np.testing.assert_allclose(drawn, offsets.T, atol=1e-6)
    # Nothing of the image is cut off.
    corners = to_axes.transform([(-0.5, -0.5), (29.5, -0.5), (29.5, 19.5)])
    left, right = ax.get_xlim()
    assert right - 1e-6 <= corners[:, 0].min() < corners[:, 0].max() <= left + 1e-6
    assert labels(ax) == ("Relative R.A. (uas)", "Relative Decl. (uas)")


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
    ssps, here = result.ssps.copy(), result.ssps["epoch"] == 2
    ssps["in_region"] = ssps["east"] > -8 * u.mas
    ax = result.cube.plot(2, ssps, zoom=False).axes[0]

    def east(lines):
        return np.sort(np.concatenate([line.get_xdata() for line in lines]))

    for scale in (1.0, 2.0, 3.0):
        drawn = east(x for x in ax.lines if x.get_gid() == f"ssps {scale:g}")
        own = ssps["east"][here & (ssps["scale"] == scale)].value
        np.testing.assert_allclose(drawn, np.sort(own))
    pale = east(x for x in ax.lines if x.get_gid() and x.get_alpha() < 1)
    own = ssps["east"][here & ~ssps["in_region"]].value
    np.testing.assert_allclose(pale, np.sort(own))
    assert legend(ax) == ["SSPs of scale 0.2", "0.4", "0.8 mas", "not used"]


def test_outlines_are_the_edges_of_the_pixels():
    cube, one, pixels = small_cube(), np.ones(1), np.array([[5, 7], [5, 8], [6, 7]])
    ssps = SSPs(
        scale=one, y=5 * one, x=7 * one, y_centroid=5 * one, x_centroid=7 * one,
        peak=one, flux=one, snr=9 * one, bbox=np.array([[5, 7, 7, 9]]),
        starts=np.array([0, 3]), pixels=pixels @ [30, 1], values=np.ones(3),
        epoch=np.zeros(1, int),
    )  # fmt: skip
    ax = cube.plot(0, ssps, zoom=False).axes[0]
    (edges,) = (c for c in ax.collections if c.get_gid() == "outlines")
    middles = np.mean(edges.get_segments(), axis=1)
    y, x = np.array([[4.5, 7], [4.5, 8], [5, 6.5], [5, 8.5], [5.5, 8], [6, 6.5],
                     [6, 7.5], [6.5, 7]]).T  # fmt: skip
    wanted = np.stack([axis.value for axis in cube.pixel_to_offset(x, y)], axis=-1)
    order = [np.lexsort(places.round(6).T) for places in (middles, wanted)]
    np.testing.assert_allclose(middles[order[0]], wanted[order[1]], atol=1e-9)


def test_brightness_has_limits_unit_and_ticks_that_fit():
    mask = np.zeros((3, 20, 30), bool)
    mask[0, :5, :5] = True
    data = np.where(mask, 1e6, 1.0)
    ax = small_cube(data=data, mask=mask, unit="Jy / beam").plot(0).axes[0]
    # Masked pixels are no data, and named.
    (drawn,) = ax.images
    assert np.ma.getmaskarray(drawn.get_array()).sum() == 25
    assert drawn.norm.vmin < drawn.norm.vmax < 1e6
    assert legend(ax) == ["masked"]
    # The bar is laid beside the axes as their child.
    assert ax.child_axes[0].get_ylabel() == "Brightness (Jy/beam)"
    for value in (0.0, -1.0):
        (drawn,) = small_cube(data=np.full(mask.shape, value)).plot(0).axes[0].images
        assert drawn.norm.vmin < drawn.norm.vmax
    ax = small_cube().plot(0, norm=LogNorm(vmin=0.5), colorbar=False).axes[0]
    assert (ax.images[0].norm.vmin, ax.images[0].norm.vmax) == (0.5, 100)
    with pytest.raises(TypeError, match="norm must be one of matplotlib.colors, got"):
        small_cube().plot(0, norm="log")
    assert not ax.child_axes
    assert ticks_of(AsinhNorm(0.004, vmin=-1e-3, vmax=3)) == [0, 0.01, 0.1, 1]
    assert ticks_of(AsinhNorm(0.4, vmin=-1, vmax=3)) is None


def test_of_many_epochs_some_are_chosen_evenly():
    dates = [f"20{k:02d}-01-01" for k in range(40)]
    cube = small_cube(data=np.zeros((40, 16, 16)), times=dates)
    columns = []
    for size in ((3, 9), (9, 2)):
        figure = cube.plot(max_panels=7, figure=Figure(figsize=size))
        panels = [ax for ax in figure.axes if ax.images]
        columns.append(len({ax.get_subplotspec().colspan.start for ax in panels}))
    assert columns[0] < columns[1]
    years = [int(ax.texts[0].get_text()[:4]) for ax in panels]
    assert (len(years), years[0], years[-1]) == (7, 2000, 2039)
    assert np.ptp(np.diff(years)) <= 1
    # In the same colours.
    assert len({id(ax.images[0].norm) for ax in panels}) == 1
    assert figure.get_supxlabel() == "Relative R.A. (mas)"


SSP = st.tuples(st.floats(-3, 3), st.floats(-2, 2), st.floats(4, 1e4))


@settings(max_examples=10, deadline=None)
@given(st.lists(SSP, min_size=1))
def test_limits_are_a_part_of_the_image_that_is_not_empty(ssps):
    cube = small_cube(pixel_scale=0.3 * u.mas)
    east, north, snr = np.array(ssps).T
    weight = 0.05 + np.log(snr / snr.min())
    points = {"place": np.stack([east, north]), "weight": weight}
    whole, near = image_limits(cube), image_limits(cube, points)
    assert np.all(near[:, 1] > near[:, 0])
    assert np.all((near >= whole[:, :1] - 1e-9) & (near <= whole[:, 1:] + 1e-9))


def test_the_sun_has_west_to_the_right(jet_results):
    sky, wcs = jet_results["sky"], jet_results["sky"].cube.wcs.deepcopy()
    wcs.wcs.ctype = "HPLN-TAN", "HPLT-TAN"
    decomposed = replace(sky.decomposed, cube=replace(sky.cube, wcs=wcs))
    decomposed._followed.append(sky.tracked_features)
    sun = replace(sky, decomposed=decomposed)
    ax = sun.cube.plot(0, sun.ssps).axes[0]
    assert labels(ax) == ("Offset to solar west (mas)", "Offset to solar north (mas)")
    assert not ax.xaxis_inverted()
    shown = np.concatenate([line.get_xdata() for line in ax.lines])
    own = sun.ssps["lon_offset"][sun.ssps["epoch"] == 0].value
    assert sorted(shown) == pytest.approx(sorted(own))
    ax, other = (result.plot("velocity_map").axes[0] for result in (sun, sky))
    assert ax.get_xlabel() == "Proper motion to solar west (mas/yr)"
    assert (ax.xaxis_inverted(), other.xaxis_inverted()) == (False, True)
    # The arrow points where the features go.
    arrows = [next(t for t in k.texts if t.get_gid() == "jet") for k in (ax, other)]
    assert np.prod([arrow.xy[0] - arrow.xyann[0] for arrow in arrows]) < 0
    label = sun.plot("diagram").axes[0].get_ylabel()
    assert re.match(r"Displacement 2\d\d° from north to solar west", label)
    assert list(sun.velocity_map().wcs.wcs.ctype) == ["LON", "LAT"]


def test_units_and_dates_are_easily_read():
    units = {1e-4: "uas", 0.1: "mas", 300: "arcsec", 2e4: "arcmin", 2e6: "deg"}
    assert {scale: offset_unit(20 * scale) for scale in units} == units
    for span, resolution, interval, unit in (
        (12 * u.yr, 0.1 * u.arcsec, 2 * u.yr, u.mas / u.yr),
        (12 * u.yr, 2 * u.arcsec, 1 * u.yr, u.arcsec / u.yr),
        (11 * u.d, 30 * u.mas, 1 * u.d, u.mas / u.d),
        (8 * u.h, 20 * u.uas, 2 * u.min, u.mas / u.h),
    ):
        assert speed_unit(span, resolution, interval) == unit
    for days, names in (
        ([0, 1], ["2000-01-01", "2000-01-02"]),
        ([0, 0.25], ["2000-01-01 00:00", "2000-01-01 06:00"]),
        ([0, 0], ["2000-01-01 00:00:00.000 (0)", "2000-01-01 00:00:00.000 (1)"]),
    ):
        assert epoch_names(Time("2000-01-01", scale="utc") + days * u.day) == names
