# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Lines and parabolas, errors, dates of ejection, and probabilities of tracks."""

from dataclasses import replace

import numpy as np
import pytest

from astro_scc.features.motion import FAR, Motion, are_secure, fit_motion, properties

TIME = 2000 + np.array([0.0, 0.7, 1.5, 3.0, 3.4, 5.1, 6.0, 7.7])
ERROR = np.full((8, 2), 0.01)


def on_line(time, place, velocity):
    return np.add(place, np.multiply.outer(time - time.mean(), velocity))


def test_a_straight_line_and_a_parabola():
    fit = fit_motion(TIME, on_line(TIME, (3.0, -1.0), (0.4, -0.2)), ERROR, 1.0)
    assert fit.date == pytest.approx(TIME.mean())
    np.testing.assert_allclose([fit.place, fit.velocity], [[3, -1], [0.4, -0.2]])
    np.testing.assert_allclose(fit.residual, 0, atol=1e-12)
    assert not fit.accelerated
    assert np.isnan([fit.acceleration, fit.acceleration_err]).all()
    dt = TIME - TIME.mean()
    place = on_line(TIME, (3.0, 0.0), (0.4, 0.0))
    place += 0.5 * np.multiply.outer(dt**2, (0.1, -0.2))
    fit = fit_motion(TIME, place, ERROR, 1.0)
    assert fit.accelerated
    np.testing.assert_allclose(fit.acceleration, [0.1, -0.2])
    np.testing.assert_allclose(fit.residual, 0, atol=1e-9)
    # Date, place, velocity and acceleration are those of one parabola.
    since = (TIME - fit.date)[:, None]
    path = fit.place + fit.velocity * since + 0.5 * fit.acceleration * since**2
    np.testing.assert_allclose(path, place, atol=1e-9)
    assert (fit.acceleration_err > 0).all()
    # The velocity is the mean one over the dates, that of a line.
    line = np.polyfit(dt, place, 1)[0]
    np.testing.assert_allclose(fit.velocity, line, atol=1e-9)
    # Six positions are too few, and one date has no motion.
    assert not fit_motion(TIME[:6], place[:6], ERROR[:6], 1.0).accelerated
    with pytest.raises(ValueError, match="at least two dates"):
        fit_motion(TIME[[0, 0, 0]], place[:3], ERROR[:3], 1.0)


def test_accelerations_are_rare_where_there_is_none():
    rng = np.random.default_rng(1)
    time = np.linspace(2000, 2008, 15)
    place = on_line(time, (3, 0), (0.4, 0)) + rng.normal(0, 0.06, (80, 15, 2))
    fits = [fit_motion(time, one, np.zeros((15, 2)), 1.0) for one in place]
    assert np.mean([fit.accelerated for fit in fits]) < 0.07


def motion(place=(4.0, 3.0), velocity=(0.4, 0.3), **changes):
    """A motion that was at the core ten years ago."""
    nan, small = np.full(2, np.nan), np.array([0.01, 0.01])
    made = Motion(
        date=2010.0, place=np.array(place), place_err=np.array([0.05, 0.1]),
        velocity=np.array(velocity), velocity_err=small, acceleration=nan,
        acceleration_err=nan, span=1.0, residual=np.zeros((4, 2)),
        used=np.ones(4, dtype=bool),
    )  # fmt: skip
    return replace(made, **changes)


@pytest.mark.parametrize("core_error", [0.0, 0.2])
def test_its_error_is_that_of_many_draws(core_error):
    rng = np.random.default_rng(5)
    one = motion()
    place = one.place + one.place_err * rng.normal(size=(20000, 2))
    place += core_error * rng.normal(size=place.shape)
    velocity = one.velocity + one.velocity_err * rng.normal(size=place.shape)
    dates = one.date - (place * velocity).sum(axis=1) / (velocity**2).sum(axis=1)
    date, error = one.ejection(core_error, 1.0)
    assert date == pytest.approx(2000)
    # Half the range of the middle 68%, as dates have long tails.
    low, high = np.quantile(dates, [0.1587, 0.8413])
    assert error == pytest.approx((high - low) / 2, rel=0.04)


#: Why a motion has no date of ejection.
DATELESS = {
    "not radial": {"velocity": np.array([0.3, 0.4])},
    "inwards": {"velocity": -np.array([0.4, 0.3])},
    "slow": {"velocity_err": np.array([0.2, 0.2])},
    "direction unsure": {"velocity_err": np.array([0.08, 0.08])},
    "radius unsure": {"place_err": np.array([0.8, 0.8])},
    "accelerated": {"acceleration": np.array([0.01, 0.0])},
    "at the core": {"place": np.zeros(2)},
    "misses the core": {"place": 4 * np.array([4.3, 2.6])},
}


@pytest.mark.parametrize("why", DATELESS)
def test_dates_without_meaning_are_not_given(why):
    assert np.isnan(motion(**DATELESS[why]).ejection(0.0, 1.0)).all()
    # The core may be missed by one beam.
    aside = {"place": 4 * np.array([4.3, 2.6]), "place_err": np.zeros(2)}
    assert np.isfinite(motion(**aside).ejection(0.0, 2.0)[0])


@pytest.fixture(scope="module")
def track_of(series):
    """Make a track of the first detection of each epoch, and its motion."""

    def make(rows):
        d = series(rows)
        track = np.flatnonzero(d.number == 0)
        args = (part[track] for part in (d.time, d.place, d.place_error))
        return d, track, fit_motion(*args, d.fwhm)

    return make


def straight(n, *, speed=0.5, start=2.0, others=(), flux=(1.0, 1.0), step=1):
    """A feature that moves out, and others beside it."""
    rows = []
    for t in range(n):
        x = start + speed * t
        rows.append((step * t, x, 0.0, flux[t % 2]))
        rows += [(step * t, x, y) for y in others]
    return rows


def test_properties(track_of):
    rows = straight(6, others=[0.7], step=2, flux=(1.0, np.e))
    d, track, motion = track_of(rows)
    found = properties(d, track, motion)
    # It moves by 2.5 mas and is at 3.25 mas in the middle.
    expected = [np.log(6), np.log(2.5), np.log(3.55), 1.0, 6 / 11, 0.7]
    assert found[:6] == pytest.approx(expected)
    assert found[6] == pytest.approx(np.std([1, -1, 1, -1, 1]))
    assert found[7] == pytest.approx(0, abs=1e-9)
    # Others far away do not count, nor does having none.
    for others in ((), [50.0]):
        assert properties(*track_of(straight(6, others=others)))[5] == FAR


@pytest.mark.parametrize(
    ("p_false", "same_speed", "moved", "errors", "n_epochs", "secure"),
    [
        (0.301, 1.0, 1.0, 3.0, 8, False),
        (0.3, 0.5, 1.0, 3.0, 8, True),
        (0.3, 0.499, 1.0, 3.0, 8, False),
        (0.3, 1.0, 0.5, 5.0, 5, True),
        (0.3, 1.0, 0.499, 9.0, 8, False),
        (0.0, 1.0, 9.0, 9.0, 3, False),
        (0.0, 1.0, 9.0, 2.99, 4, False),
    ],
)
def test_what_is_vouched_for(p_false, same_speed, moved, errors, n_epochs, secure):
    assert are_secure(p_false, same_speed, moved, errors, n_epochs) == secure
