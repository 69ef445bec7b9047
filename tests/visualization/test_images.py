# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images and their SSPs: what is drawn where, and how bright."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
from astropy.wcs import WCS
from matplotlib.colors import AsinhNorm, LogNorm

from astro_scc import EpochCube
from astro_scc.units import offset_unit, speed_unit
from astro_scc.visualization.images import epoch_names, ticks_of


def small_cube(**kwargs):
    data = np.random.default_rng(1).standard_normal((3, 20, 30))
    data[:, 5, 7] = 100
    times = ["2000-01-01", "2000-07-01", "2001-01-01"]
    values = {"data": data, "times": times, "pixel_scale": 0.1 * u.mas, **kwargs}
    return EpochCube.from_arrays(**values)


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


def test_brightness_has_limits_unit_and_ticks_that_fit():
    mask = np.zeros((3, 20, 30), bool)
    mask[0, :5, :5] = True
    data = np.where(mask, 1e6, 1.0)
    ax = small_cube(data=data, mask=mask, unit="Jy / beam").plot(0).axes[0]
    (drawn,) = ax.images
    assert np.ma.getmaskarray(drawn.get_array()).sum() == 25
    assert drawn.norm.vmin < drawn.norm.vmax < 1e6
    for value in (0.0, -1.0):
        (drawn,) = small_cube(data=np.full(mask.shape, value)).plot(0).axes[0].images
        assert drawn.norm.vmin < drawn.norm.vmax
    ax = small_cube().plot(0, norm=LogNorm(vmin=0.5), colorbar=False).axes[0]
    assert ax.images[0].norm.vmax == 100
    with pytest.raises(TypeError, match="norm must be one of matplotlib.colors, got"):
        small_cube().plot(0, norm="log")
    assert ticks_of(AsinhNorm(0.004, vmin=-1e-3, vmax=3)) == [0, 0.01, 0.1, 1]
    assert ticks_of(AsinhNorm(0.4, vmin=-1, vmax=3)) is None


def test_the_sun_has_west_to_the_right(jet_results):
    sky, wcs = jet_results["sky"], jet_results["sky"].cube.wcs.deepcopy()
    wcs.wcs.ctype = "HPLN-TAN", "HPLT-TAN"
    decomposed = replace(sky.decomposed, cube=replace(sky.cube, wcs=wcs))
    decomposed._followed.append(sky.tracked_features)
    sun = replace(sky, decomposed=decomposed)
    ssps = sun.ssps.copy()
    ssps["in_region"] = ssps["lat_offset"].value > 0
    ax = sun.cube.plot(0, ssps).axes[0]
    assert not ax.xaxis_inverted()
    shown = np.concatenate([line.get_xdata() for line in ax.lines])
    own = sun.ssps["lon_offset"][sun.ssps["epoch"] == 0].value
    assert sorted(shown) == pytest.approx(sorted(own))
    ax, other = (result.plot("velocity_map").axes[0] for result in (sun, sky))
    assert (ax.xaxis_inverted(), other.xaxis_inverted()) == (False, True)
    # The arrow points where the features go.
    arrows = [next(t for t in k.texts if t.get_gid() == "jet") for k in (ax, other)]
    assert np.prod([arrow.xy[0] - arrow.xyann[0] for arrow in arrows]) < 0
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
        ([0, 0.25], ["2000-01-01 00:00:00", "2000-01-01 06:00:00"]),
        ([0, 0], ["2000-01-01 (0)", "2000-01-01 (1)"]),
    ):
        assert epoch_names(Time("2000-01-01", scale="utc") + days * u.day) == names
