# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The search for streams on matches whose streams are known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import combine_pvalues

import astro_scc.streams.search as module
from astro_scc.streams import SearchSettings, find_streams
from astro_scc.streams.chains import Feature
from astro_scc.streams.dispersion import Population, feature_speeds, random_effects
from astro_scc.streams.permutations import EpochPermutations
from astro_scc.streams.search import P_SECURE, classify, with_secure

SEARCH = SearchSettings()
#: Ten uneven dates.
YEARS = np.cumsum([0, 1.0, 0.7, 1.3, 0.9, 1.4, 0.6, 1.1, 1.0, 0.8])


def search(d, angles=(0.0,), *, seed=0, n_trials=99, **options):
    """Find streams; ``d`` are matches along the axis, or a function of the angle."""
    project = d if callable(d) else lambda angle: d
    rng = np.random.default_rng(seed)
    return find_streams(project, angles, 1.5, n_trials=n_trials, rng=rng, **options)


def kinds(found):
    return [stream.kind for stream in found.streams]


@pytest.fixture(scope="module")
def one(jet):
    """A stream of ten features among four that stand still."""
    rng = np.random.default_rng(2)
    return jet(rng, YEARS, [(10, 0.5, 0.1)], still=4, chance=2, length=20.0, seen=0.9)


@pytest.fixture(scope="module")
def two(jet):
    rng = np.random.default_rng(1)
    streams = [(8, 0.3, 0.05), (6, 1.0, 0.05)]
    return jet(rng, YEARS, streams, chance=1, length=16.0, seen=0.95)


def feature(speed, motion=2.0, n_epochs=5):
    return Feature(
        *[np.arange(n_epochs)] * 2, speed, 0.02, 0.0, 0.02, np.zeros(2), 2000.0, motion,
        np.zeros(n_epochs),
    )  # fmt: skip


SHORT, FAST, BACK = feature(0.5, n_epochs=4), feature(0.5, 1.2), feature(-0.4, 1.4)
FOLLOWED = replace(SHORT, detection=np.arange(4), motion=0.5)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({}, ""),
        ({"mean": -0.17}, ""),
        # Alpha itself is small enough.
        ({"p_global": 0.05, "smallest_p": 0.05}, ""),
        ({"features": [feature(0.5, 1.75)]}, ""),
        ({"features": [feature(0.5, 1.1)] * 3}, ""),
        ({"smallest_p": 1 / 12}, "too few epochs or trials: no p_global below 0.083"),
        ({"p_global": 0.06}, "(p_global 0.06); if it is real, 4.0 times as many"),
        *(({"p_global": 0.06, "z": z}, "(p_global 0.06)") for z in (-1, 0, 1.2, 4)),
        ({"features": []}, "no single feature is seen to move at this speed"),
        ({"features": [feature(0.5, m) for m in (0.6, 0.8, 1)]}, "1.3 times as long"),
        ({"features": [SHORT]}, "it rests on a single feature in 4 epochs"),
        *(({"features": f}, "") for f in ([SHORT] * 2, [FOLLOWED], [feature(0.5)])),
        ({"features": [SHORT], "beside": True}, ""),
        ({"p_keeps": 0.2}, "do not keep this speed"),
        ({"mean": -0.16}, "rest is within 1.645 errors of the speed"),
        # Features that diffuse need twice the distance from rest.
        ({"features": [FAST, BACK], "mean": 0.32}, "rest is within 3.29 errors"),
        ({"features": [FAST, BACK], "mean": 0.34}, ""),
        # The first reason is given.
        ({"smallest_p": 1 / 12, "p_global": 0.5, "features": []}, "too few epochs"),
        ({"p_global": 0.06, "z": 0, "features": [], "mean": 0}, "permuted epochs"),
    ],
)  # fmt: skip
def test_kinds_and_reasons(change, reason):
    """Of what is significant in every respect, one thing after the other is not."""
    own = {"mean": 0.5, "z": 2.0, "p_global": 0.01, "smallest_p": 0.01,
           "features": [FAST, feature(0.5, 1.3)]} | change  # fmt: skip
    along = Population(own.pop("mean"), 0.1, 0.05, 0.02)
    smallest_p, p_global = own.pop("smallest_p"), own["p_global"]
    test = SimpleNamespace(smallest_p=smallest_p, maxima=np.full(99, 4.0))
    found = classify(along, **own, permutations=test, alpha=0.05, settings=SEARCH)
    passes = "not confirmed" if max(p_global, smallest_p) <= 0.05 else "not significant"
    assert found[0] == (passes if reason else "moving")
    assert reason in found[1]
    assert bool(reason) == bool(found[1])
    if change == {"p_global": 0.06, "z": 4}:
        assert "times as many" not in found[1]


@pytest.mark.parametrize(
    ("followed", "n_fast", "groups"),
    [(False, 1, [8, 1]), (True, 1, [9]), (True, 2, [8, 2])],
)
def test_one_feature_that_was_followed_is_no_second_stream(followed, n_fast, groups):
    features = [feature(v) for v in [0.49, 0.5, 0.51, 0.52] * 2 + [1.5] * n_fast]
    if followed:
        features = [replace(f, detection=f.epoch) for f in features]
    axis = SimpleNamespace(
        rays=SimpleNamespace(settings=SEARCH),
        moving=lambda own, speed: own,
        z=lambda speed: 1.0,
        p_values=lambda own, mean: (0.01, 0.01),
        permutations=SimpleNamespace(smallest_p=0.01),
    )
    rng = np.random.default_rng(1)
    found = module._feature_groups(axis, features, 0.5, 0.05, 199, rng)
    assert [len(group) for group, _ in found] == groups


@pytest.mark.parametrize(
    ("p_global", "n_secure", "note"),
    [
        (0.2, 2, "alone give p_global 0.2, but 2 secure features moved"),
        (0.5, 1, "but a secure feature moved"),
        *((p, n, "") for p, n in [(0.05, 3), (0.2, 0), (0.95, 3), (1.0, 1)]),
    ],
)
def test_secure_features_count_where_permutations_do_not_decide(
    p_global, n_secure, note
):
    found, about = with_secure(p_global, n_secure, 0.05)
    both = combine_pvalues([p_global, P_SECURE]).pvalue
    assert found == pytest.approx(both if note else p_global)
    assert about.endswith(note)
    assert bool(note) == bool(about)


class TestOneStream:
    def test_it_is_found_with_its_speed(self, one):
        found = search(one)
        first, still = found.streams
        assert (first.kind, first.reason) == ("moving", "")
        assert first.along.mean == pytest.approx(0.5, abs=3 * first.along.error)
        assert 0 < first.along.error < 0.05
        assert first.along.dispersion == pytest.approx(0.05, abs=0.03)
        assert abs(first.across.mean) < 3 * first.across.error
        assert len(first.features) >= 6
        assert first.p_global == first.p_distinct == 0.01
        assert first.p_local <= first.p_global
        assert still.kind == "stationary"
        assert abs(still.along.mean) < 3 * still.along.error
        assert np.isnan(still.z)
        assert len(still.features) >= 3

        # Its numbers are those of its features at the speed quoted.
        for stream in found.streams:
            assert stream.along == random_effects(*feature_speeds(stream.features))
            across = [[f.across, f.across_error] for f in stream.features]
            assert stream.across == random_effects(*np.transpose(across))
            assert (stream.angle, found.angle) == (0, 0)
        test, mean = found.permutations, first.along.mean
        assert (first.p_local, first.p_global) == test.p_values(0, mean)
        assert first.z == test.significance(0, mean)


class TestTwoStreams:
    def test_both_are_found(self, two):
        found = search(two)
        slow, fast = sorted(found.streams, key=lambda s: s.along.mean)
        for stream, speed, least in ((slow, 0.3, 5), (fast, 1.0, 3)):
            assert stream.kind == "moving"
            assert stream.along.mean == pytest.approx(speed, rel=0.1)
            assert len(stream.features) >= least
        first, second = found.streams
        assert first.p_distinct == first.p_global
        assert 0.01 <= second.p_distinct <= 0.05

    def test_the_one_with_more_features_is_first(self, jet):
        streams = [(4, 0.3, 0.05), (12, 1.0, 0.05)]
        found = search(jet(np.random.default_rng(0), YEARS, streams, length=16.0))
        assert kinds(found)[:2] == ["moving", "moving"]
        assert found.streams[0].along.mean == pytest.approx(1.0, rel=0.1)

    def test_only_the_first_has_to_keep_its_speed(self, monkeypatch, two):
        first = search(two).streams[0].along.mean
        for keep, kind in (((first,), "moving"), ((), "not confirmed")):
            monkeypatch.setattr(
                module, "persistence", lambda d, v, s, keep=keep: float(v not in keep)
            )
            assert kinds(search(two))[:2] == [kind] * 2

    def test_speeds_whose_mean_is_none_of_theirs(self, monkeypatch, two):
        """Where they cannot be told apart those near the largest z are the stream."""
        monkeypatch.setattr(
            module.dispersion,
            "separate_streams",
            lambda f, n, rng, _: (1.0, np.zeros(len(f), bool)),
        )
        test = search(two).permutations
        axis, speed = test.largest()
        p_values = EpochPermutations.p_values

        def only_there(self, axis, v):
            return p_values(self, axis, v) if abs(v / speed - 1) < 0.2 else (1.0, 1.0)

        monkeypatch.setattr(EpochPermutations, "p_values", only_there)
        (found,) = search(two).streams
        assert found.kind == "moving"
        assert found.along.mean == pytest.approx(speed, rel=0.2)
        assert all(abs(f.speed / speed - 1) <= 0.35 for f in found.features)


class TestNotSignificant:
    def test_four_epochs(self, lines, axis_matches):
        years = YEARS[:4]
        d = axis_matches(*lines([0.6] * 6, 3.0 * np.arange(6), years), years)
        (stream,) = search(d, n_trials=999).streams
        assert stream.kind == "not significant"
        # The numbers are given all the same.
        assert stream.along.mean == pytest.approx(0.6, abs=0.01)
        assert len(stream.features) == 6

    def test_matches_without_ssps_have_no_features(self, one):
        d = replace(one, target_ssp=np.full(len(one), -1))
        found = search(d)
        (stream,) = found.streams
        assert (stream.kind, stream.features) == ("not confirmed", ())
        _, speed = found.permutations.largest()
        assert stream.along.mean == speed == pytest.approx(0.5, rel=0.15)
        p_values = found.permutations.p_values(0, speed)
        assert (stream.p_local, stream.p_global) == p_values
        assert stream.p_distinct == stream.p_global
        assert np.isnan(stream.along.error)

    def test_without_matches_there_is_no_stream(self, one):
        found = search(one.select(np.zeros(len(one), dtype=bool)))
        assert found.streams == ()
        assert not found.diagram.excess.any()


class TestRestrictions:
    def test_outward_only(self, one):
        both, forth = (search(one, outward=k).permutations for k in (False, True))
        np.testing.assert_allclose(forth.z, both.z[:, both.speed > 0])
        assert kinds(search(one, outward=True))[0] == "moving"
        inward = replace(one, d1=-one.d1, position=one.position * (-1, 1))
        assert search(inward).streams[0].along.mean < 0
        outward = search(inward, outward=True)
        assert (outward.permutations.speed > 0).all()
        assert "moving" not in kinds(outward)

    def test_the_largest_speed(self, two):
        found = search(two, fastest=0.6)
        assert found.permutations.speed.max() == pytest.approx(0.6)
        first = found.streams[0]
        assert first.kind == "moving"
        assert first.along.mean == pytest.approx(0.3, rel=0.1)
        assert all(f.speed < 1.1 * 0.6 for f in first.features)


class TestDirection:
    """Where the direction of the flow is not known several axes are searched."""

    @staticmethod
    def turned(lines, axis_matches, angle, speed):
        rng = np.random.default_rng(1)
        starts = 2.0 * np.arange(8)
        position, epoch = lines([speed] * 8, starts, YEARS, scatter=0.03, rng=rng)

        def project(axis):
            turn = angle - axis
            matrix = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
            return axis_matches(position @ np.transpose(matrix), epoch, YEARS)

        return project

    @pytest.mark.parametrize(
        ("degrees", "speed", "n_axes"),
        [(0, 0.6, 12), (20, -0.6, 12), (90, 0.6, 12), (128, -0.6, 12), (173, 0.6, 12),
         # Three axes, and a flow that is far from them.
         (88, 0.3, 3), (140, 0.3, 3)],
    )  # fmt: skip
    def test_it_is_that_of_the_features(
        self, lines, axis_matches, degrees, speed, n_axes
    ):
        angle = np.radians(degrees)
        project = self.turned(lines, axis_matches, angle, speed)
        found = search(project, np.arange(n_axes) * np.pi / n_axes)
        stream = found.streams[0]
        assert stream.kind == "moving"
        east = stream.along.mean * np.exp(1j * stream.angle)
        assert abs(east - speed * np.exp(1j * angle)) < 0.03
        assert abs((stream.angle - angle + np.pi / 2) % np.pi - np.pi / 2) < 0.035
        assert found.angle == stream.angle
        assert found.permutations.z.shape[0] == n_axes


def turned_round(d):
    """The same matches with time running backwards."""
    last, names = len(d.years) - 1, ("reference", "target", "epoch")
    turned = {name: last - getattr(d, name) for name in names}
    return replace(d, years=-d.years[::-1], **turned)


#: The same motion in another form, and what becomes of a speed of one.
FORMS = {
    "days": (lambda d: replace(d, years=365.25 * d.years), 1 / 365.25),
    "weights in any unit": (lambda d: replace(d, weight=1e6 * d.weight), 1),
    "the other direction": (
        lambda d: replace(d, d1=-d.d1, position=d.position * (-1, 1)),
        -1,
    ),
    "time turned round": (turned_round, -1),
    "matches in another order": (
        lambda d: d.select(np.random.default_rng(1).permutation(len(d))),
        1,
    ),
}


@pytest.mark.parametrize("form", FORMS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=2)
def test_the_same_motion_in_another_form(lines, axis_matches, form, seed):
    """Eight noisy features of one speed in eight epochs."""
    change, unit = FORMS[form]
    rng = np.random.default_rng(seed)
    years = np.cumsum(rng.uniform(0.7, 1.3, 8))
    starts = 3.0 * np.arange(8)
    d = axis_matches(*lines([0.6] * 8, starts, years, scatter=0.03, rng=rng), years)
    a, b = search(d).streams[0], search(change(d)).streams[0]
    assert a.kind == b.kind == "moving"
    assert b.along.mean == pytest.approx(unit * a.along.mean)
    assert b.along.error == pytest.approx(abs(unit) * a.along.error)
    assert abs(b.across.mean) == pytest.approx(abs(unit * a.across.mean))
    if form != "time turned round":
        # There the permutations drawn are others.
        assert (b.p_global, b.p_local) == (a.p_global, a.p_local)
