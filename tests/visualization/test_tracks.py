# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Figures of features: separations, paths, ejections and published ones."""

import itertools
from dataclasses import replace
from functools import partial

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time
from matplotlib.figure import Figure

from astro_scc.visualization.tracks import ejections, plot_separation, plot_tracks

MODULE = "astro_scc.visualization.tracks"


@pytest.fixture(scope="module")
def features(result):
    """Features of which one is not secure, and one is accelerated."""
    found = replace(result.tracked_features)
    vars(found)["secure"] = np.arange(len(found)) != 1
    first, *others = result.tracked_features.motions
    bent = replace(first, acceleration=np.array([1.0, 0.0]))
    vars(found)["motions"] = (bent, *others)
    return found


def dots(ax):
    """Positions that are drawn, shape (2, n)."""
    own = [line for line in ax.lines if line.get_marker() == "o"]
    return np.concatenate([line.get_xydata() for line in own]).T


def lines_of(ax, gid):
    return [line for line in ax.lines if line.get_gid() == gid]


def test_separations_fits_and_residuals(features):
    ax, lower = plot_separation(features, unit=u.uas, beta_per_pm=10.0).axes
    table, d = features.positions, features.detections
    time, distance = dots(ax)
    wanted = np.hypot(table["ra_offset"], table["dec_offset"]).to_value(u.uas)
    assert distance == pytest.approx(wanted)
    assert time == pytest.approx(table["date"].jyear)
    fits = [k for k in ax.lines if k.get_marker() == "None" and not k.get_gid()]

    def separation(m, time):
        dt = (np.asarray(time) - m.date)[..., None]
        path = m.velocity * dt + np.nan_to_num(m.acceleration) * dt**2 / 2
        return 1000 * np.hypot(*np.moveaxis(m.place + path, -1, 0))

    left = []
    for line, track, m in zip(fits, features.tracks, features.motions, strict=True):
        own, (time, distance) = track.detection, line.get_data()
        assert distance[-1] == pytest.approx(separation(m, time[-1]))
        left.extend(1000 * np.hypot(*d.place[own].T) - separation(m, d.time[own]))
    assert dots(lower)[1] == pytest.approx(np.array(left), abs=1e-6)
    assert plot_separation(features, ax=Figure().add_subplot()).axes[1:] == []


def test_paths_over_the_mean_image_and_published_ones(features):
    cube = features.cube
    (ax,) = plot_tracks(features, unit=u.mas).axes
    x, y = dots(ax)
    assert x == pytest.approx(features.positions["ra_offset"].value)
    assert y == pytest.approx(features.positions["dec_offset"].value)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert np.all((x < left) & (x > right) & (y > bottom) & (y < top))
    later = Time([*cube.times[:3].jyear, cube.times[-1].jyear + 9], format="jyear")
    published = QTable({"published": [7] * 4, "date": later})
    for name in ("separation", "ra_offset", "dec_offset"):
        published[name] = np.arange(1.0, 5.0) * u.mas
    # Of the time of the images.
    ax = plot_tracks(features, published=published, unit=u.mas).axes[0]
    assert list(lines_of(ax, "published 7")[0].get_xdata()) == [1, 2, 3]
    plot_separation(features, published=published)
    nothing = features.detections.select(np.zeros(len(features.detections), bool))
    core = features.core.select(np.zeros(len(features.core), bool))
    for plot in (plot_separation, plot_tracks):
        plot(replace(features, detections=nothing, core=core, tracks=()))


def test_dashes_lead_to_the_ejections(features, monkeypatch):
    all_of_them = partial(ejections, earlier=20.0)
    monkeypatch.setattr(f"{MODULE}.ejections", all_of_them)
    upper, _ = plot_separation(features).axes
    years, fwhm = features.cube.times.jyear, features.detections.fwhm
    secure = itertools.compress(features.motions, features.secure)
    known = sorted(m.ejection(features.core_error, fwhm)[0] for m in secure)
    known = [date for date in known if date >= years[0] - 20 * np.ptp(years)]
    drawn = [line.get_data() for line in lines_of(upper, "ejection")]
    assert sorted(x[0] for x, _ in drawn) == pytest.approx(known)
    assert all(y[0] == 0 for _, y in drawn)
    assert drawn
