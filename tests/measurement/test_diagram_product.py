# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The displacement-interval diagram as an image, and in the FITS file."""

import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc import StackedCrossCorrelation
from astro_scc.measurement import write_products
from astro_scc.simulation import simulate_two_fluid

WEST = 270 * u.deg


@pytest.fixture(scope="module")
def uneven():
    """Epochs at dates of which no two intervals are alike."""
    dates = Time("2001-03-01") + np.cumsum([0, 31, 43, 29, 90]) * u.d
    scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    return scc.match(simulate_two_fluid(dates=dates, rng=1).cube)


@pytest.fixture(scope="module")
def results(uneven):
    def of(**settings):
        scc = StackedCrossCorrelation(
            scales=[2], max_speed=36 * u.mas / u.yr, **settings
        )
        return scc.stack(uneven, n_trials=20, rng=1)

    return {
        "jet": of(position_angle=WEST),
        "sky": of(),
        "radial": of(position_angle="radial"),
        "baseline": of(position_angle=WEST, baseline=(35, 110) * u.day),
    }


def pairs_of_columns(result, wcs, n, shortest=0.0, longest=np.inf):
    """Count the pairs of dates whose interval falls in each column."""
    years = result.cube.years.to_value(u.yr)
    first, second = np.triu_indices(len(years), 1)
    interval = years[second] - years[first]
    interval = interval[(interval >= shortest) & (interval <= longest)]
    # The first interval is the edge of the first column.
    columns = wcs.world_to_pixel_values(interval * (1 + 1e-9), 0 * interval)[0]
    return np.bincount(np.rint(columns).astype(int), minlength=n)


@pytest.mark.parametrize("name", ["jet", "sky", "radial", "baseline"])
def test_each_column_is_of_the_pairs_with_its_interval(name, results):
    image = results[name].diagram()
    limits = (35 / 365.25, 110 / 365.25) if name == "baseline" else ()
    n = image.data.shape[1]
    count = pairs_of_columns(results[name], image.wcs, n, *limits)
    np.testing.assert_array_equal(count, image.meta["n_pairs"])
    blank = np.isnan(image.data)
    np.testing.assert_array_equal(blank.all(axis=0), count == 0)
    np.testing.assert_array_equal(blank.any(axis=0), count == 0)
    assert (count == 0).any()
    interval, _ = image.wcs.pixel_to_world(np.arange(n), np.zeros(n))
    assert interval.unit == u.yr
    # Bins are 8% wide.
    np.testing.assert_allclose(interval[1:] / interval[:-1], np.exp(0.08))
    seen = count > 0
    np.testing.assert_allclose(
        image.meta["interval"][seen] / interval[seen], 1, atol=0.041
    )


def test_values_are_the_excess_per_pattern_and_beam(results):
    result = results["jet"]
    image, diagram = result.diagram(), result.search.diagram
    seen = image.meta["n_pairs"] > 0
    assert image.unit == 1 / u.beam
    # Two epochs have this number of patterns, and each match the area of a Gaussian.
    patterns = 2 * result.ssps["in_region"].sum() / len(result.cube)
    area = np.sqrt(2 * np.pi) * 0.2
    total = patterns * area * (image.data * image.meta["n_pairs"])[:, seen]
    np.testing.assert_allclose(total, diagram.excess.T, atol=1e-12)
    np.testing.assert_array_equal(
        image.meta["interval"][seen].to_value(u.yr), diagram.interval
    )
    # One beam is 1 mas, and the diagram is in beams.
    assert image.meta["beam"].to_value(u.mas) == pytest.approx(1)
    _, displacement = image.wcs.pixel_to_world(0, np.arange(len(image.data)))
    assert displacement.unit == u.mas
    np.testing.assert_allclose(
        displacement.value, diagram.displacement, rtol=1e-9, atol=1e-9
    )
    assert image.meta["axes"] == ("interval", "displacement")


def test_the_other_end_of_an_axis_turns_the_diagram(results):
    result = results["sky"]
    image = result.diagram()
    other = replace(result, position_angle=result.position_angle + 180 * u.deg)
    turned = other.diagram()
    np.testing.assert_array_equal(turned.data, image.data[::-1])
    np.testing.assert_array_equal(turned.meta["direction"], -image.meta["direction"])
    away = turned.meta["position_angle"] - image.meta["position_angle"]
    assert abs(away.to_value(u.deg)) == pytest.approx(180)


@pytest.mark.parametrize("name", ["jet", "sky", "radial"])
def test_the_fits_file_holds_the_diagram(name, results, tmp_path):
    result = results[name]
    image = result.diagram()
    write_products(result, result.components, tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with fits.open(tmp_path / "scc.fits") as hdus:
            hdus.verify("exception")
            names = [hdu.name for hdu in hdus]
            assert names == [
                "COEFFICIENT",
                "ZSCORE",
                "DIAGRAM",
                "INTERVALS",
                "FEATURES",
            ]
            header = hdus["DIAGRAM"].header
            np.testing.assert_array_equal(hdus["DIAGRAM"].data, image.data)
            wcs = WCS(header)
            table = QTable.read(hdus["INTERVALS"])
    assert list(wcs.wcs.ctype) == ["INTV-LOG", "DISPLACE"]
    assert [header["CNAME1"], header["CNAME2"]] == ["interval", "displacement"]
    x, y = np.indices(image.data.T.shape)
    for own, read in zip(
        image.wcs.pixel_to_world_values(x, y),
        wcs.pixel_to_world_values(x, y),
        strict=True,
    ):
        np.testing.assert_allclose(read, own, rtol=1e-9, atol=1e-9)
    # The equation that the comments give, for readers that know no -LOG.
    step = header["CDELT1"] / header["CRVAL1"]
    np.testing.assert_allclose(
        wcs.pixel_to_world_values(x, y)[0],
        header["CRVAL1"] * np.exp(step * (x + 1 - header["CRPIX1"])),
    )
    np.testing.assert_array_equal(table["interval"], image.meta["interval"])
    assert table["interval"].unit == u.yr
    np.testing.assert_array_equal(table["n_pairs"], image.meta["n_pairs"])
    assert header["BEAM"] == image.meta["beam"].value
    if name == "radial":
        assert "DISPPA" not in header
        assert "radial" in header.comments["CNAME2"]
    else:
        assert header["DISPPA"] == image.meta["position_angle"].value
