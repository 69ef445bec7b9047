# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A strong stream is found, a faint one is not, and what is wrong is said."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

from astro_scc.epochs import Beam
from astro_scc.exceptions import MeasurementWarning
from astro_scc.recovery import completeness, draw_paths, inject
from astro_scc.recovery.completeness import _peaks, run_all
from astro_scc.recovery.injection import area_for_features

PM = u.mas / u.yr
FAST = 10 * PM
QUICK = {"n_features": 8, "n_injections": 2, "n_trials": 60, "rng": 1}


@pytest.fixture(scope="module")
def table(sky, settings):
    """Two fluxes, far above and below the noise."""
    return completeness(sky, settings, speeds=FAST, fluxes=[0.5, 100], **QUICK)


def test_a_strong_stream_is_found_and_one_below_the_noise_is_not(table):
    assert table["n_found"].tolist() == [0, 2]
    assert table["fraction"].tolist() == [0.0, 1.0]
    assert table["fraction_low"][0] == 0
    assert table["fraction_high"][1] == 1
    assert abs(table["bias"][1]) < table.meta["tolerance"]
    assert 0 <= table["coverage"][1] <= 1
    # Nothing is known of the speed of what is not found.
    for name in ("bias", "bias_err", "scatter", "coverage"):
        assert table[name].mask.tolist() == [True, False]
    assert not table["own"].any()


def test_fluxes_are_multiples_of_the_noise_or_have_a_unit(table, sky):
    noise = np.median(sky.noise_rms())
    assert table["snr"].tolist() == pytest.approx([0.5, 100])
    assert u.isclose(table["flux"][1], 100 * noise)
    assert noise.value == pytest.approx(0.01, rel=0.3)
    for flux in (
        noise * 100,
        (noise * 100).to(u.mJy / u.beam),
        noise.value * 100e3 * u.mJy,
    ):
        assert _peaks(flux, sky.unit, 1.0) == pytest.approx([100 * noise.value])


@pytest.mark.slow
def test_the_same_seed_gives_the_same_table_whatever_the_workers(sky, settings):
    how = {**QUICK, "speeds": FAST, "fluxes": 20.0, "n_trials": 20}
    one, two = (completeness(sky, settings, n_workers=n, **how) for n in (1, 3))
    assert one.colnames == two.colnames
    for name in one.colnames:
        a, b = np.ma.asarray(one[name]), np.ma.asarray(two[name])
        np.testing.assert_array_equal(np.ma.getmaskarray(a), np.ma.getmaskarray(b))
        np.testing.assert_array_equal(a.data, b.data)
    assert one.meta["seed"] == 1


def test_the_table_survives_a_file(table, tmp_path):
    table.write(tmp_path / "table.ecsv")
    read = QTable.read(tmp_path / "table.ecsv")
    assert read.colnames == table.colnames
    assert read["bias"].unit == PM
    assert read["bias"].mask.tolist() == [True, False]
    assert read.meta["settings"]["scales"] == [2.0]
    assert read.meta["tolerance"] == table.meta["tolerance"]
    assert read["fraction"].info.description == table["fraction"].info.description


@pytest.mark.slow
def test_components_of_the_epochs_themselves_are_no_recoveries(sky, settings):
    area = np.ones(sky.shape[1:], dtype=bool)
    paths = draw_paths(
        sky, area, speed=FAST, position_angle=270 * u.deg, n_features=8,
        scatter=0.1 * u.mas, rng=4,
    )  # fmt: skip
    jet = inject(sky, paths, 1.0 * u.Jy / u.beam)
    how = {**QUICK, "region": area, "n_injections": 1}
    # What is put in cannot be seen: all that moves is of the epochs.
    table = completeness(jet, settings, speeds=[10, 10.3] * PM, fluxes=1e-6, **how)
    assert table["own"].all()
    assert len(table.meta["own_velocities"]) == 1
    assert u.isclose(table.meta["own_velocities"][0, 0], FAST, rtol=0.1)
    assert table["n_found"].tolist() == [0, 0]


def test_features_are_put_where_the_epochs_have_ssps(sky, settings):
    where = np.zeros(sky.shape[1:], dtype=bool)
    where[20:30, 30:60] = True
    paths = draw_paths(
        sky, where, speed=1 * PM, position_angle=270 * u.deg, n_features=3, rng=1
    )
    matched = settings.match(inject(sky, paths, 1.0))
    area = area_for_features(matched, None)
    assert 0 < area.sum() < 0.6 * area.size
    assert area[20:30, 30:60].any()
    np.testing.assert_array_equal(area_for_features(matched, where), where)
    # Without any SSP they may be anywhere.
    assert area_for_features(settings.match(sky), None).all()


@pytest.mark.slow
def test_masked_pixels_uneven_dates_and_changing_beams(noise_cube, settings):
    beams = [
        Beam((1.1 + 0.05 * k) * u.mas, 0.9 * u.mas, 30 * k * u.deg) for k in range(6)
    ]
    mask = np.zeros((6, 48, 96), dtype=bool)
    mask[2:4, :, 40:55] = True
    cube = noise_cube(beams=beams, mask=mask)
    region = np.zeros((48, 96), dtype=bool)
    region[8:40, 5:91] = True
    as_they_are = replace(settings, common_beam=False)
    table = completeness(
        cube, as_they_are, speeds=FAST, fluxes=100.0, region=region, **QUICK
    )
    assert table["n_found"][0] == 2


@pytest.mark.slow
def test_radial_motion_of_a_cube_without_beams(noise_cube, settings):
    cube = noise_cube(beams=(), shape=(80, 80))
    radial = replace(settings, position_angle="radial")
    table = completeness(
        cube, radial, speeds=6 * PM, fluxes=100.0, fwhm=1 * u.mas,
        **{**QUICK, "n_features": 12},
    )  # fmt: skip
    assert table["n_found"][0] == 2
    median = np.median(np.diff(cube.years))
    assert u.isclose(table.meta["tolerance"], 0.2 * u.mas / median)


def test_warnings_are_not_repeated_and_generators_are_those_of_each_cell():
    def work(cell, rng):
        warnings.warn("the data do not support this", MeasurementWarning, stacklevel=2)
        return cell, rng.random()

    how = work, [1, 2], 2
    one, two = (run_all(*how, np.random.default_rng(1), n) for n in (1, 2))
    assert one == two
    assert [[cell for cell, _ in found] for found in one] == [[1, 1], [2, 2]]
    assert len({number for found in one for _, number in found}) == 4


def test_work_needs_a_worker():
    with pytest.raises(ValueError, match="n_workers must be at least 1, got 0"):
        run_all(abs, [1], 1, np.random.default_rng(1), n_workers=0)


class TestMessages:
    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"speeds": 0 * PM}, "speeds = 0.0 mas / yr must be positive and finite"),
            ({"speeds": [] * PM}, "speeds = .* must be positive and finite, with a"),
            ({"speeds": 30 * PM}, "speed 30 mas/yr is beyond .* 24 mas/yr: give"),
            ({"fluxes": -1.0}, "fluxes must be one or more numbers from 0"),
            ({"fluxes": []}, "fluxes must be one or more numbers from 0"),
            ({"n_injections": 0}, "n_injections must be at least 1, got 0"),
            ({"n_features": 0}, "n_features must be at least 1, got 0"),
            ({"scatter": -1}, "scatter must be zero or positive, got -1"),
            ({"n_trials": 1}, "n_trials must be at least 2, got 1"),
            ({"n_trials": 18}, "18 trials allow no p_global below 0.053, so nothing"),
            ({"fwhm": 0 * u.mas}, "fwhm = 0.0 mas must be finite and above 0"),
            ({"tolerance": -1 * PM}, "tolerance = -1.0 mas / yr must be finite and"),
            ({"position_angle": "radial"}, "either both are 'radial', or none"),
        ],
    )
    def test_arguments(self, sky, settings, changes, message):
        with pytest.raises(ValueError, match=message):
            completeness(
                sky, settings, **{"speeds": FAST, "fluxes": 5.0, **QUICK, **changes}
            )

    @pytest.mark.parametrize(
        "changes",
        [
            {"speeds": 1 * u.mas},
            {"fluxes": 1 * u.K},
            {"fwhm": 1 * u.s},
            {"tolerance": 1 * u.s},
            {"position_angle": 1 * u.s},
        ],
    )
    def test_units(self, sky, settings, changes):
        (name,) = changes
        with pytest.raises(u.UnitConversionError, match=f"{name} = .* must be"):
            completeness(
                sky, settings, **{"speeds": FAST, "fluxes": 5.0, **QUICK, **changes}
            )

    @pytest.mark.parametrize("n", [2, 4])
    def test_few_epochs(self, sky, settings, n):
        with pytest.raises(
            ValueError,
            match=rf"{n} epochs allow no p_global below .* 5 epochs or more are needed",
        ):
            completeness(sky[:n], settings, speeds=FAST, fluxes=5.0, **QUICK)

    def test_no_beam(self, noise_cube, settings):
        with pytest.raises(ValueError, match="has no beams: give fwhm"):
            completeness(
                noise_cube(beams=()), settings, speeds=FAST, fluxes=5.0, **QUICK
            )

    def test_no_direction(self, sky, settings):
        bare = replace(settings, position_angle=None)
        with pytest.raises(ValueError, match="position_angle is missing: give the"):
            completeness(sky, bare, speeds=FAST, fluxes=5.0, **QUICK)
        diagonal = {**QUICK, "position_angle": 45 * u.deg, "n_injections": 1}
        # All directions are searched, each to the largest speed.
        with pytest.raises(ValueError, match="speed 25 mas/yr is beyond the largest"):
            completeness(sky, bare, speeds=25 * PM, fluxes=0.1, **diagonal)
        table = completeness(sky, bare, speeds=24 * PM, fluxes=0.1, **diagonal)
        assert table["n_found"][0] == 0
        # Along the one that is given it is slower.
        table = completeness(sky, settings, speeds=25 * PM, fluxes=0.1,
                             **{**diagonal, "position_angle": 250 * u.deg})  # fmt: skip
        assert table["n_found"][0] == 0

    def test_axes_without_a_direction(self, sky, settings):
        class Bent:
            """Axes along a line that bends."""

            def __repr__(self):
                return "Bent()"

        bent = SimpleNamespace(
            **{**settings.to_dict(), "position_angle": Bent()},
            date_pairs=settings.date_pairs,
        )
        with pytest.raises(ValueError, match=r"or 'radial', not Bent\(\): give"):
            completeness(sky, bent, speeds=FAST, fluxes=5.0, **QUICK)

    def test_no_noise(self, sky, settings):
        clean = replace(sky, noise=np.zeros(6) * sky.unit)
        with pytest.raises(ValueError, match="multiples of the noise need epochs with"):
            completeness(clean, settings, speeds=FAST, fluxes=5.0, **QUICK)
        how = {**QUICK, "n_injections": 1, "fluxes": 1e-9 * u.Jy}
        table = completeness(clean, settings, speeds=FAST, **how)
        assert table["snr"].mask.all()

    def test_a_region_without_pixels(self, noise_cube, settings):
        mask = np.zeros((6, 48, 96), dtype=bool)
        mask[:, :20, :20] = True
        region = mask[0].copy()
        with pytest.raises(ValueError, match="region holds masked pixels only"):
            completeness(
                noise_cube(mask=mask), settings, speeds=FAST, fluxes=5.0, region=region,
                **QUICK,
            )  # fmt: skip
