# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Alignment of epochs by core, correlation, tables and coordinates."""

import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time
from numpy.testing import assert_allclose, assert_array_equal
from regions import CirclePixelRegion, PixCoord
from scipy import ndimage

from astro_scc.epochs import Beam, EpochCube, registration
from astro_scc.epochs.align import align, offsets_from_table
from astro_scc.epochs.restoring import correlated_noise
from astro_scc.exceptions import MeasurementWarning
from astro_scc.images.positions import offset_wcs
from astro_scc.simulation import simulate_jet, simulate_static

DATES = ["2000-01-01", "2000-07-01", "2001-01-01", "2001-07-01"]
BEAM = Beam(0.9 * u.mas, 0.6 * u.mas, -10 * u.deg)
SHAPE = (90, 100)
MAS = u.mas.to(u.deg)


def grid(turn=0.0, crval=(187.0, 12.0)):
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    wcs = offset_wcs(0.1 * u.mas, (49, 39), SkyCoord(*crval, unit="deg"))
    wcs.wcs.pc = [[c, -s], [s, c]]
    return wcs


def images(epochs, turn=0.0, noise=0.0, **fields):
    """Epochs of point sources, (east, north, flux) with offsets in mas."""
    wcs, rng = grid(turn), np.random.default_rng(5)
    empty = EpochCube(np.zeros((1, *SHAPE)), DATES[:1], wcs)
    e, n = (v.to_value(u.mas) for v in empty.offsets())
    precision = np.linalg.inv(BEAM.covariance.to_value(u.mas**2))
    data = np.zeros((len(epochs), *SHAPE))
    for image, sources in zip(data, epochs, strict=True):
        for east, north, flux in sources:
            d = np.stack([e - east, n - north])
            image += flux * np.exp(-0.5 * np.einsum("iyx,ij,jyx->yx", d, precision, d))
        if noise:
            how = {"beam": BEAM, "pixel_scale": 0.1 * u.mas, "rng": rng}
            image += correlated_noise(SHAPE, rms=noise, **how)
    fields = {"beams": BEAM, "noise": (noise or 1e-6) * u.one, **fields}
    return EpochCube(data, DATES[: len(epochs)], wcs, **fields)


JET = [(0.5, -0.25, 0.4), (1.8, -0.9, 0.15)]
HOLE = np.zeros(SHAPE, dtype=bool)
HOLE[:8, :8] = True
OFFSETS = np.array([[0.0, 0.0], [0.23, 0.47], [-0.31, 0.12], [0.06, -0.52]])


def shifted_jets(core=1.0, **options):
    """The same jet, each epoch displaced by OFFSETS (east, north)."""
    jet = [(0, 0, core), *JET]
    epochs = [[(a + e, b + n, f) for a, b, f in jet] for e, n in OFFSETS]
    return images(epochs, **options)


def offset_table(offsets=OFFSETS):
    east, north = np.array(offsets).T * u.mas
    return QTable({"date": DATES[: len(offsets)], "east": east, "north": north})


def shifts(cube):
    records = cube.meta["alignment"]
    return np.array([[r["shift_east_mas"], r["shift_north_mas"]] for r in records])


def positions(found):
    return np.stack([found["east"].value, found["north"].value], axis=1)


def test_a_table_brings_sources_to_the_reference_pixel(tmp_path):
    cube = shifted_jets(turn=40)
    result = align(cube, "table", table=offset_table())
    reference = images([[(0, 0, 1.0), *JET]], turn=40).data[0]
    for image, mask in zip(result.data, result.mask, strict=True):
        assert_allclose(image[~mask], reference[~mask], atol=2e-3)
    assert_allclose(shifts(result), -OFFSETS, atol=1e-9)
    assert result.noise is None
    offset_table().write(tmp_path / "cores.ecsv")
    assert len(align(result, str(tmp_path / "cores.ecsv")).meta["alignment"]) == 8
    record = result.meta["alignment"][1]
    assert (record["epoch"], record["date"]) == (cube.labels[1], "2000-07-01")
    assert (record["method"], record["shift_east_err_mas"]) == ("table", None)


def test_tables_that_cannot_be_used(tmp_path):
    for text, message in [
        ("date,east_mas,north_mas\n2000-01-05,1,2\n", "no row within 1 d of"),
        ("date,east_mas,north_mas\n2000-01-01,,2\n", "2000-01-01 .a.fits. has no numb"),
        ("date,east_mas\n2000-01-01,1\n", "0 columns have 'north'.* 'east_mas'$"),
        ("date,east,north_mas\n2000-01-01,1,2\n", "'east' has no unit"),
        ("date,east_mas,north_mas\n2000-01-01,1,2\n2000-01-01,1,3\n", "that differ"),
        ("date,east_mas,north_mas\n2000-01-01,1,x\n", "'north_mas' is not numeric"),
        ("when,east_mas,north_mas\n2000-01-01,1,2\n", "0 columns of dates"),
        ("date,east_mas,north_mas\n1 May 2000,1,2\n", "'date' are not understood"),
        ("date,east_mas,north_mas\n2000-01-01,1,2\n,1,2\n", "that of row 2 is missing"),
        (QTable({"time": Time(np.ma.masked_invalid([np.nan]), format="mjd"),
                 "east": [1] * u.mas, "north": [1] * u.mas}), "of row 1 is missing"),
        (3, "table must be a path or a Table, got int"),
    ]:  # fmt: skip
        table = text
        if isinstance(text, str):
            table = tmp_path / "cores.csv"
            table.write_text(text)
        with pytest.raises((ValueError, TypeError, OSError), match=message) as caught:
            offsets_from_table(table, Time(["2000-01-01"]), ["a.fits"])
        assert str(table) in str(caught.value) or not hasattr(table, "name")
        assert "\n" not in str(caught.value)


def test_the_core_is_found_though_it_is_blended_and_not_the_brightest():
    """0.56 mas to the next feature, about 0.7 of the beam."""
    cube = shifted_jets(core=0.25, turn=40, noise=2e-4)
    found = registration.core_positions(cube)
    assert_allclose(positions(found), OFFSETS, atol=0.01)
    with pytest.warns(MeasurementWarning, match="blended with the jet in 4 of 4"):
        result = align(cube, "core")
    assert_allclose(shifts(result), -OFFSETS, atol=0.01)


def test_a_core_stands_still_where_the_brightest_point_does():
    """East of the brightest point is more light than in the jet, west of it."""
    for speed, east in ((0, 3.0), (-0.5, 0.0)):
        epochs = [[(0, 0, 1.0), (3 + speed * k, 0, 0.5)] for k in range(4)]
        cube = images([[*one, (-1.2 - k, 0, 0.15)] for k, one in enumerate(epochs)])
        with warnings.catch_warnings(record=True, action="always") as said:
            found = registration.core_positions(cube)
        assert_allclose(found["east"].value, east, atol=0.02)
        assert ["point stands still and is taken" in str(w.message) for w in said] == (
            [True] if speed else []
        )


def test_a_lonely_core_and_its_errors():
    """Residuals are as large as the errors say."""
    found = registration.core_positions(images([[(0.13, -0.08, 0.05)]] * 4, noise=1e-3))
    assert not found["blended"].any()
    errors = np.stack([found["east_err"].value, found["north_err"].value], axis=1)
    pulls = (positions(found) - [0.13, -0.08]) / errors
    assert 0.3 < np.sqrt(np.mean(pulls**2)) < 2
    # Fomalont 1999: half the beam over the signal-to-noise ratio, times 1.2.
    assert_allclose(errors[:, 1], 0.9 / 2 / 50 * 1.2, rtol=0.2)


@pytest.mark.slow
def test_the_cores_of_0003_380(shared_data):
    """Against model fits in the visibilities; the brightest pixel is 0.11 mas off."""
    path = shared_data / "0003+380" / "core_offsets.csv"
    table = Table.read(path)
    truth = np.stack([table["core_x_mas_east"], table["core_y_mas_north"]], axis=1)
    cube = EpochCube.read(str(shared_data / "0003+380" / "*.fits"))
    for own, limit in ((cube, 0.022), (cube.to_common_beam(), 0.032)):
        residual = positions(registration.core_positions(own)) - truth
        assert np.hypot(*residual.T).max() < limit, residual
    left = positions(registration.core_positions(align(cube, path)))
    assert np.hypot(*left.T).max() < 0.022


def test_a_known_shift_is_recovered():
    """The case on which scikit-image was wrong by 0.7 px."""
    rng, (y, x) = np.random.default_rng(2), np.indices((128, 128))
    spots = [(*rng.uniform(30, 98, 2), rng.exponential()) for _ in range(12)]

    def image(dx, dy):
        r2 = [(f, (x - x0 - dx) ** 2 + (y - y0 - dy) ** 2) for x0, y0, f in spots]
        total = sum(f * np.exp(-r / (2 * 4.2**2)) for f, r in r2)
        return total + rng.normal(size=(128, 128)) * 1e-3

    mask = (np.abs(y - 62) < 2) & (np.abs(x - 60) < 20)
    moved = np.where(mask, np.nan, 3 * image(-2.30, -4.70) + 0.5)
    arguments = moved, mask, image(0, 0), np.ones((128, 128), dtype=bool), 15
    shift, covariance = registration.displacement(*arguments)
    assert_allclose(shift, [-2.30, -4.70], atol=3e-3)
    assert np.all(np.sqrt(np.diag(covariance)) < 5e-3)
    mask = x + y > 3
    with pytest.raises(ValueError, match="too few good pixels"):
        registration.displacement(moved, mask, *arguments[2:], start=(0, 0))
    with pytest.raises(ValueError, match="nothing in the image correlates"):
        registration.displacement(-moved, *arguments[1:4], 1)


@pytest.mark.parametrize(("turn", "fields"), [(40, {}), (0, {"beams": None})])
def test_correlation_undoes_displacements(turn, fields):
    cube = shifted_jets(turn=turn, noise=1e-4, **fields)
    result = align(cube, "correlate")
    assert_allclose(shifts(result), OFFSETS.mean(axis=0) - OFFSETS, atol=3e-3)
    error = [r["shift_east_err_mas"] for r in result.meta["alignment"]]
    assert 0 <= min(error) <= max(error) < 0.01
    assert "aligned on their mean" in result.meta["history"][-1]


def test_a_region_that_stands_still_is_not_dragged_along():
    """A bright feature moves away; the rest of the source stands."""
    still = [(0, 0, 1.0), (0.9, -0.4, 0.3)]
    cube = images([[*still, (3.0 + 0.2 * k, -1.5, 3.0)] for k in range(4)])
    region = CirclePixelRegion(PixCoord(46, 38), 12)
    result = align(cube, "correlate", region=region)
    assert np.abs(shifts(result)).max() < 0.01
    assert np.ptp(shifts(align(cube, "correlate"))[:, 0]) > 0.2


def test_absolute_coordinates():
    """Each header gives its own position to the reference pixel."""
    cube, cos = shifted_jets(), np.cos(np.radians(12))
    own = [grid(crval=(187 - e * MAS / cos, 12 - n * MAS)) for e, n in OFFSETS]
    cube = EpochCube(cube.data, cube.times, cube.wcs, epoch_wcs=own, beams=BEAM)
    result = align(cube, "wcs")
    assert_allclose(shifts(result), -OFFSETS, atol=1e-5)
    reference = images([[(0, 0, 1.0), *JET]]).data[0]
    for i, wcs in enumerate(result.epoch_wcs):
        good = ~result.mask[i]
        assert_allclose(result.data[i][good], reference[good], atol=2e-3)
        assert_array_equal(wcs.wcs.crval, cube.wcs.wcs.crval)
    # Done once, there is nothing left to do.
    assert_array_equal(align(result, "wcs").data, result.data)
    assert align(result, "none").data is result.data


NOISE = np.random.default_rng(0).normal(size=(2, 40, 40))
NO_CORE = EpochCube.from_arrays(NOISE, DATES[:2], pixel_scale=0.1 * u.mas, beams=BEAM)


def test_alignments_that_are_refused():
    for method, options, message in [
        ("core", {"cube": NO_CORE}, "2000-01-01: nothing is bright enough"),
        ("core", {"cube": NO_CORE.with_step("", beams=None)}, "and the epochs have no"),
        ("wcs", {"cube": NO_CORE}, "no absolute coordinates"),
        ("correlate", {"region": HOLE}, "no good pixel in the region"),
        ("wcs", {}, "2000-07-01: is turned or stretched .* frame='absolute'"),
        ("table", {"table": offset_table(OFFSETS + 50)},
         "2000-01-01: its shift .* off the grid"),
        (offset_table(OFFSETS), {"table": "x.csv"}, "give one table, as method or as"),
        ("core", {"table": "x.csv", "region": HOLE}, "'core' has no option region, ta"),
        ("table", {}, "needs table="),
        (3, {}, "is none of"),
    ]:  # fmt: skip
        cube = shifted_jets(epoch_wcs=[grid(), grid(turn=30), grid(), grid()])
        mask = cube.mask | HOLE
        cube = cube.with_step("", data=np.where(mask, np.nan, cube.data), mask=mask)
        with pytest.raises(ValueError, match=message):
            align(**{"cube": cube, "method": method, **options})


@pytest.mark.parametrize("distance", [0.6, 1.08])
def test_a_core_before_a_brighter_feature_that_hides_its_maximum(distance):
    """Up to 1.4 beams there is but one maximum, four times as bright."""
    cube = images([[(0, 0, 1.0), (distance, 0, 4.0)]], noise=1e-3)
    found = registration.core_positions(cube, jet_pa=90 * u.deg)
    assert_allclose(found["east"].value, 0, atol=0.02)


def test_dates_of_many_sorts():
    for name, dates in (
        ("MJD", [51544.2, 51726.0]),
        ("time", Time(["2000-01-01", "2000-07-01"])),
        ("Date-Obs", ["2000-01-01", "2000-07-01"]),
    ):
        table = QTable({name: dates, "east": [1, 2] * u.mas, "north": [3, 4] * u.mas})
        offsets, _ = offsets_from_table(table, Time(["2000-07-01"]), ["a"])
        assert_allclose(offsets.value, [[2, 4]])


@pytest.fixture(scope="module")
def jet():
    """Twelve aligned epochs of a jet with a core."""
    return simulate_jet(n_epochs=12, rng=1).cube


def scattered(cube, x, y):
    """Every image moved by its own x and y, in pixels."""
    steps = zip(cube.data, x, np.broadcast_to(y, len(cube)), strict=True)
    moved = [ndimage.shift(image, (dy, dx), order=3) for image, dx, dy in steps]
    return cube.with_step("shifted", data=np.array(moved))


@pytest.mark.slow
@pytest.mark.parametrize("beams", [0.1, 0.6])
@pytest.mark.parametrize("standing", [False, True])
def test_the_scatter_of_epochs_is_what_they_were_shifted_by(jet, beams, standing):
    cube = simulate_static(n_epochs=12, core=3.0, rng=1).cube if standing else jet
    width = np.sqrt(cube.beams[0].major * cube.beams[0].minor) / cube.pixel_scale
    x, y = np.random.default_rng(5).normal(size=(2, 12))
    x, y = ((v - v.mean()) / v.std() * beams * float(width) for v in (x, y))
    # Each of the ten in the middle tells it to a fifth.
    assert registration.misalignment(scattered(cube, x, y)) == pytest.approx(
        beams, rel=0.3
    )


def test_epochs_that_are_aligned_or_drift_steadily(jet):
    assert registration.misalignment(jet) < 0.05
    drift = 12 * jet.years.value
    assert np.std(drift) > 10
    assert (registration.misalignment(scattered(jet, drift, 0)) or 0) < 0.1
    # Two epochs, and images without beams, without anything or of one date.
    for cube in (
        jet[:2],
        jet.with_step("", beams=None),
        jet.with_step("", data=0 * jet.data, noise=None),
        jet[:4].with_step("", times=jet.times[[0, 0, 0, 0]]),
    ):
        assert registration.misalignment(cube) is None


def test_misalignment_is_said_and_measured_once():
    jet = {"n_features": 0, "standing": 6, "length": 8.0, "alignment_error": 0.5}
    cube = simulate_jet(n_epochs=6, **jet, rng=3).cube
    with pytest.warns(
        MeasurementWarning,
        match=r"^the epochs are aligned to 0\.\d\d beams only, .* adds to every error "
        r"of a speed: align them, with --align core or cube\.align\('core'\), or if",
    ):
        registration.warn_of_misalignment(cube)
    assert vars(cube)["misalignment"] is cube.misalignment
