# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A strong stream is found, a faint one is not, and what is wrong is said."""

import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import beta

from astro_scc.columns import Column
from astro_scc.exceptions import MeasurementWarning
from astro_scc.kinematics import RidgeLine
from astro_scc.recovery import completeness, draw_paths, inject
from astro_scc.recovery.completeness import epochs_needed, run_all, share, smallest_p
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


def test_warnings_are_not_repeated_and_generators_are_those_of_each_cell():
    def work(cell, rng):
        warnings.warn("the data do not support this", MeasurementWarning, stacklevel=2)
        return cell, rng.random()

    how = work, [1, 2], 2
    one, two = (run_all(*how, np.random.default_rng(1), n) for n in (1, 2))
    assert one == two
    assert [[cell for cell, _ in found] for found in one] == [[1, 1], [2, 2]]
    assert len({number for found in one for _, number in found}) == 4


def run(cube, settings, **changes):
    return completeness(
        cube, settings, **{"speeds": FAST, "fluxes": 5.0, **QUICK, **changes}
    )


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
        ({"n_workers": 0}, "n_workers must be at least 1, got 0"),
        ({"scatter": -1}, "scatter must be zero or positive, got -1"),
        ({"n_trials": 1}, "n_trials must be at least 2, got 1"),
        ({"n_trials": 18}, "18 trials allow no p_global below 0.053, so nothing"),
        ({"fwhm": 0 * u.mas}, "fwhm = 0.0 mas must be finite and above 0"),
        ({"tolerance": -1 * PM}, "tolerance = -1.0 mas / yr must be finite and"),
        ({"position_angle": "radial"}, "either both are 'radial', or none"),
    ],
)
def test_arguments_that_are_refused(sky, settings, changes, message):
    with pytest.raises(ValueError, match=message):
        run(sky, settings, **changes)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("speeds", u.mas), ("fluxes", u.K), ("fwhm", u.s), ("tolerance", u.s),
     ("position_angle", u.s)],
)  # fmt: skip
def test_units_that_are_refused(sky, settings, name, unit):
    with pytest.raises(u.UnitConversionError, match=f"{name} = .* must be"):
        run(sky, settings, **{name: 1 * unit})


CORNER = np.zeros((48, 96), dtype=bool)
CORNER[:20, :20] = True


@pytest.mark.parametrize(
    ("cube", "changes", "message"),
    [
        (lambda sky: sky[:2], {}, "2 epochs allow no .* 5 epochs or more are needed"),
        (lambda sky: sky[:4], {}, "4 epochs allow no .* 5 epochs or more are needed"),
        (lambda sky: replace(sky, beams=None), {}, "has no beams: give fwhm"),
        (
            lambda sky: replace(sky, noise=np.zeros(6) * sky.unit),
            {},
            "multiples of the noise need epochs with",
        ),
        (
            lambda sky: replace(sky, mask=np.broadcast_to(CORNER, sky.shape)),
            {"region": CORNER},
            "region holds masked pixels only",
        ),
    ],
)
def test_epochs_that_are_refused(sky, settings, cube, changes, message):
    with pytest.raises(ValueError, match=message):
        run(cube(sky), settings, **changes)


def test_axes_without_a_direction_are_refused(sky, settings):
    for axes, message in (
        (None, "position_angle is missing: give the"),
        (RidgeLine([0, -5] * u.mas, [0, 0] * u.mas), "or 'radial', not .*: give"),
    ):
        with pytest.raises(ValueError, match=message):
            run(sky, replace(settings, position_angle=axes))


def test_the_largest_speed_is_that_of_the_axes_that_are_searched(sky, settings):
    bare = replace(settings, position_angle=None)
    diagonal = {"position_angle": 45 * u.deg, "n_injections": 1, "fluxes": 0.1}
    # All directions are searched, each to the largest speed.
    with pytest.raises(ValueError, match="speed 25 mas/yr is beyond the largest"):
        run(sky, bare, speeds=25 * PM, **diagonal)
    assert run(sky, bare, speeds=24 * PM, **diagonal)["n_found"][0] == 0
    # Along the one that is given it is slower.
    diagonal["position_angle"] = 250 * u.deg
    assert run(sky, settings, speeds=25 * PM, **diagonal)["n_found"][0] == 0


def test_without_noise_there_is_no_ratio_to_it(sky, settings):
    clean = replace(sky, noise=np.zeros(6) * sky.unit)
    assert run(clean, settings, n_injections=1, fluxes=1e-9 * u.Jy)["snr"].mask.all()


@pytest.mark.parametrize(
    ("n_epochs", "p"), [(2, 1.0), (3, 1 / 3), (4, 1 / 12), (5, 1 / 60), (400, 0.0)]
)
def test_the_smallest_p_is_that_of_the_permutations(n_epochs, p):
    assert smallest_p(n_epochs) == pytest.approx(p, abs=1e-12)


@given(level=st.floats(1e-9, 0.9))
def test_as_many_epochs_as_a_level_needs(level):
    n = epochs_needed(level)
    assert smallest_p(n) <= level
    assert n == 2 or smallest_p(n - 1) > level


@given(of=st.integers(1, 200), part=st.floats(0, 1))
def test_intervals_are_those_of_jeffreys(of, part):
    number = round(part * of)
    fraction, low, high = share(number, of)
    assert fraction == number / of
    assert 0 <= low <= fraction <= high <= 1
    own = beta(number + 0.5, of - number + 0.5)
    if 0 < number < of:
        np.testing.assert_allclose([low, high], own.ppf([0.025, 0.975]))


def test_what_is_not_known_is_masked():
    known, some = (Column(u.mas).values(v) for v in ([1.0, 2.0], [None, 2.0]))
    number = Column().values([1, None])
    assert isinstance(known, u.Quantity)
    assert not hasattr(known, "mask")
    assert some.mask.tolist() == [True, False]
    assert some.unit == u.mas
    assert number.mask.tolist() == [False, True]
