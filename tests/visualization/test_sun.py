# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Axes of figures and columns of tables are named by the celestial frame."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from matplotlib.figure import Figure

from astro_scc.images.positions import axis_words, sky_columns
from astro_scc.report.tables import component_tables
from astro_scc.units import speed_unit
from astro_scc.visualization.epochs import plot_epoch, plot_epochs
from astro_scc.visualization.tracks import plot_members
from astro_scc.visualization.velocity import plot_velocity_map


def in_frame(result, *ctype):
    wcs = result.cube.wcs.deepcopy()
    wcs.wcs.ctype = ctype
    cube = replace(result.cube, wcs=wcs)
    return replace(result, matched=replace(result.matched, cube=cube))


@pytest.fixture(scope="module")
def of_the_sun(results):
    return in_frame(results["sky"], "HPLN-TAN", "HPLT-TAN")


def test_images_have_west_to_the_right(of_the_sun):
    cube = of_the_sun.cube
    ax = plot_epoch(cube, 0).axes[0]
    assert ax.get_xlabel() == "Offset to solar west (mas)"
    assert not ax.xaxis_inverted()
    assert ax.get_ylabel() == "Offset to solar north (mas)"
    for figure in (plot_epochs(cube), plot_members(of_the_sun)):
        assert figure.get_supxlabel() == "Offset to solar west (mas)"
        assert not figure.axes[0].xaxis_inverted()


def test_velocities_have_west_to_the_right(of_the_sun, results):
    ax, sky = (plot_velocity_map(r).axes[0] for r in (of_the_sun, results["sky"]))
    assert ax.get_xlabel() == "Proper motion to solar west (mas/yr)"
    assert ax.get_ylabel() == "Proper motion to solar north (mas/yr)"
    assert sky.get_ylabel() == "Proper motion to the north (mas/yr)"
    assert sky.get_xlabel() == "Proper motion to the east (mas/yr)"
    assert not ax.xaxis_inverted()
    assert sky.xaxis_inverted()


def test_other_frames_are_named(results):
    galactic = in_frame(results["sky"], "GLON-SIN", "GLAT-SIN")
    ax = plot_epoch(galactic.cube, 0).axes[0]
    assert ax.get_xlabel() == "Offset to galactic east (mas)"
    assert ax.get_ylabel() == "Offset to galactic north (mas)"
    assert ax.xaxis_inverted()
    label = plot_velocity_map(galactic).axes[0].get_xlabel()
    assert label == "Proper motion to galactic east (mas/yr)"
    mars = in_frame(results["sky"], "MALN-TAN", "MALT-TAN").cube
    assert axis_words(mars) == ("larger longitude", "larger latitude", True)


def test_columns_are_named_by_the_frame(of_the_sun, results):
    theirs, ours = of_the_sun.components, results["sky"].components
    assert len(theirs) > 0
    for name, own in (("pm_lon_coslat", "pm_ra_cosdec"), ("pm_lat", "pm_dec")):
        assert np.array_equal(theirs[name], ours[own])
        assert np.array_equal(theirs[f"{name}_err"], ours[f"{own}_err"])
        assert own not in theirs.colnames
        assert sky_columns(ours)[name == "pm_lat"] == own
    assert sky_columns(theirs) == ("pm_lon_coslat", "pm_lat")
    described = {name: theirs[name].info.description for name in theirs.colnames}
    assert described["pm_lon_coslat"] == "proper motion to solar west"
    assert described["pm_lat_err"] == "standard error of pm_lat"
    assert described["pm_pa"].endswith("north through solar west")
    assert ours["pm_ra_cosdec"].info.description == "proper motion to the east"
    ssps = of_the_sun.ssps
    assert np.array_equal(ssps["lon_offset"], results["sky"].ssps["east"])
    for name in ("lat_offset", "lon_offset_err", "lat_offset_centroid"):
        assert ssps[name].unit == u.mas
    assert not {"east", "north", "east_err"} & set(ssps.colnames)
    lines = plot_epoch(of_the_sun.cube, 0, ssps).axes[0].lines
    shown = np.concatenate([line.get_xdata() for line in lines])
    here = ssps["epoch"] == 0
    assert sorted(shown) == pytest.approx(sorted(ssps["lon_offset"][here].value))


def test_axes_of_the_map_are_named_by_the_frame(of_the_sun, results):
    theirs, ours = of_the_sun.velocity_map(), results["sky"].velocity_map()
    assert list(theirs.wcs.wcs.ctype) == ["LON", "LAT"]
    assert theirs.meta["axes"] == ("lon", "lat")
    assert list(ours.wcs.wcs.ctype) == ["EAST", "NORTH"]


def test_the_page_of_the_report_has_the_columns(of_the_sun):
    tables = component_tables(of_the_sun.components)
    heads = [heading for columns in tables for heading, *_ in columns]
    assert {"longitude (mas/yr)", "latitude (mas/yr)"} <= set(heads)


def test_axes_of_a_wcs_are_refused(results):
    ax = Figure().add_subplot(projection=results["sky"].cube.wcs)
    with pytest.raises(TypeError, match="ax is a WCSAxes, .* without projection="):
        plot_epoch(results["sky"].cube, 0, ax=ax)
    with pytest.raises(TypeError, match="ax is a WCSAxes, .* without projection="):
        plot_velocity_map(results["sky"], ax=ax)


def jet_arrow(ax):
    """Head minus tail of the arrow in the direction of the jet."""
    arrow = next(a for a in ax.texts if getattr(a, "arrowprops", None))
    return arrow.xy[0] - arrow.xyann[0]


def test_the_arrow_points_where_features_go(of_the_sun, results):
    ax, sky = (plot_velocity_map(r).axes[0] for r in (of_the_sun, results["sky"]))
    assert jet_arrow(ax) * jet_arrow(sky) < 0


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
