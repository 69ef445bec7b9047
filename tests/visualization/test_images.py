# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images and their SSPs: what is drawn where, and how bright."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.time import Time
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


def test_the_sun_has_west_to_the_right(jet_results, with_cube):
    sky, wcs = jet_results["sky"], jet_results["sky"].cube.wcs.deepcopy()
    wcs.wcs.ctype = "HPLN-TAN", "HPLT-TAN"
    sun = with_cube(sky, replace(sky.cube, wcs=wcs))
    ssps = sun.ssps.copy()
    ssps["in_region"] = ssps["lat_offset"].value > 0
    assert not sun.cube.plot(0, ssps).axes[0].xaxis_inverted()
    ax, other = (result.plot("velocity_map").axes[0] for result in (sun, sky))
    assert (ax.xaxis_inverted(), other.xaxis_inverted()) == (False, True)
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
