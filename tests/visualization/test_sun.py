# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""On the Sun longitude grows to the west, which figures show to the right."""

from dataclasses import replace

import astropy.units as u
import pytest

from astro_scc.visualization import (
    plot_epoch,
    plot_epochs,
    plot_members,
    plot_velocity_map,
)
from astro_scc.visualization.style import speed_unit


@pytest.fixture(scope="module")
def of_the_sun(results):
    cube = results["sky"].cube
    wcs = cube.wcs.deepcopy()
    wcs.wcs.ctype = ["HPLN-TAN", "HPLT-TAN"]
    return replace(
        results["sky"],
        matched=replace(results["sky"].matched, cube=replace(cube, wcs=wcs)),
    )


def test_images_have_west_to_the_right(of_the_sun):
    cube = of_the_sun.cube
    ax = plot_epoch(cube, 0).axes[0]
    assert ax.get_xlabel() == "Offset to solar west (mas)"
    assert not ax.xaxis_inverted()
    for figure in (plot_epochs(cube), plot_members(of_the_sun)):
        assert figure.get_supxlabel() == "Offset to solar west (mas)"
        assert not figure.axes[0].xaxis_inverted()


def test_velocities_have_west_to_the_right(of_the_sun, results):
    ax, sky = (plot_velocity_map(r).axes[0] for r in (of_the_sun, results["sky"]))
    assert ax.get_xlabel() == "Proper motion to solar west (mas/yr)"
    assert sky.get_xlabel() == "Proper motion to the east (mas/yr)"
    assert not ax.xaxis_inverted()
    assert sky.xaxis_inverted()


def jet_arrow(ax):
    """Head minus tail of the arrow in the direction of the jet."""
    arrow = next(a for a in ax.texts if getattr(a, "arrowprops", None))
    return arrow.xy[0] - arrow.xyann[0]


def test_the_arrow_points_where_features_go(of_the_sun, results):
    ax, sky = (plot_velocity_map(r).axes[0] for r in (of_the_sun, results["sky"]))
    assert jet_arrow(ax) * jet_arrow(sky) < 0


@pytest.mark.parametrize(
    ("speed", "unit"),
    [
        (20 * u.mas / u.yr, u.mas / u.yr),
        (0.2 * u.arcsec / u.h, u.arcsec / u.yr),
        (20 * u.arcsec / u.h, u.arcsec / u.h),
    ],
)
def test_speeds_have_units_that_are_easily_read(speed, unit):
    assert speed_unit(speed.to_value(u.mas / u.yr)) == unit
