# Licensed under a 3-clause BSD style license - see LICENSE.rst
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.correlation import Correlator, all_pairs, correlate, zncc
from astro_scc.correlation.zncc import Template
from astro_scc.decomposition import Decomposer, SSPs

compiled = pytest.importorskip("astro_scc.correlation.compiled")
# Compiling takes longer than all of them.
pytestmark = pytest.mark.slow


def blob(shape, rng):
    """A footprint with holes and gaps in its rows."""
    footprint = rng.random(shape) < 0.7
    footprint[shape[0] // 2, shape[1] // 2] = True
    footprint[0, 0] = True
    return footprint


@settings(deadline=None, max_examples=25)
@given(
    height=st.integers(1, 9),
    width=st.integers(2, 11),
    reach=st.tuples(st.integers(0, 5), st.integers(0, 5)),
    seed=st.integers(0, 2**32 - 1),
)
def test_sums_are_the_definition(height, width, reach, seed):
    rng = np.random.default_rng(seed)
    footprint = blob((height, width), rng)
    values = rng.normal(size=footprint.shape)
    shape = 3, height + 2 * reach[0] + 4, width + 2 * reach[1] + 3
    stack = rng.normal(size=shape).astype(np.float32)
    stack[:, shape[1] // 2 :] = 0  # as a segmented plane is
    template = Template(values, footprint, reach)
    corner = 3, 2
    got = compiled.compiled_coefficients(stack, [2, 0], corner, template)
    y, x = np.nonzero(footprint)
    for own, target in zip(got, (2, 0), strict=True):
        for dy in range(2 * reach[0] + 1):
            for dx in range(2 * reach[1] + 1):
                seen = stack[target, y + dy + corner[0], x + dx + corner[1]]
                expected = zncc(values[footprint], seen)
                assert own[dy, dx] == pytest.approx(expected, abs=1e-9)


def test_beside_a_core_that_is_a_million_times_brighter():
    rng = np.random.default_rng(3)
    stack = rng.normal(size=(1, 40, 40)).astype(np.float32)
    stack[0, 20, 33] = 1e6
    values = stack[0, 12:18, 10:17].astype(float)
    template = Template(values, np.ones(values.shape, bool), (6, 6))
    got = compiled.compiled_coefficients(stack, [0], (6, 4), template)
    assert got[0, 6, 6] == pytest.approx(1, abs=1e-6)


def test_where_nothing_varies_the_coefficient_is_zero():
    stack = np.ones((1, 20, 20), dtype=np.float32)
    values = np.arange(9.0).reshape(3, 3)
    template = Template(values, np.ones((3, 3), bool), (4, 4))
    got = compiled.compiled_coefficients(stack, [0], (2, 2), template)
    np.testing.assert_array_equal(got, 0)


def test_large_patterns_are_transformed():
    side = 70
    small = Template(np.eye(5), np.ones((5, 5), bool), (10, 10))
    large = Template(np.eye(side), np.ones((side, side), bool), (40, 40))
    assert compiled.worth_it(small)
    assert not compiled.worth_it(large)


@pytest.fixture(scope="module")
def epochs():
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:80, :120]

    def image(shift):
        places = np.random.default_rng(5).uniform(20, 60, size=(9, 2))
        result = rng.normal(scale=0.02, size=x.shape)
        for y0, x0 in places:
            result += np.exp(-((x - 1.5 * x0 - shift) ** 2 + (y - y0) ** 2) / 12)
        return result

    decompose = Decomposer(scales=[1, 2])
    masks = [None, None, x > 100]
    return [decompose(image(4.0 * k), mask=m) for k, m in enumerate(masks)]


@pytest.mark.parametrize("target", ["segments", "plane"])
def test_matches_are_those_of_transforms(epochs, target):
    # Two pixels always agree, so that all their maxima tie.
    select = SSPs.of_epochs(epochs).n_pixels > 2
    one, other = (
        Correlator(target=target, compiled=compiled)(
            epochs, all_pairs(3), 15, select=select
        )
        for compiled in (True, False)
    )
    assert len(one) == len(other) > 50
    for name in ("ssp", "target"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in ("dy", "dx", "coefficient", "overlap", "target_snr"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-5)


def test_compiled_where_there_is_enough_to_do(epochs, monkeypatch):
    def compiles(**settings):
        blocks = Correlator(**settings).blocks(epochs, all_pairs(3), 15)
        return {block.settings.compiled for block in blocks}

    assert compiles() == {False}
    monkeypatch.setattr(correlate, "COMPILE_FROM", 10)
    assert compiles() == {True}
    assert compiles(compiled=False) == {False}
    monkeypatch.setattr(correlate, "find_spec", lambda name: None)
    assert compiles() == {False}


def test_without_numba_a_clear_message(monkeypatch):
    monkeypatch.setattr(correlate, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"astro_scc\[fast\]"):
        Correlator(compiled=True)


def test_where_nothing_can_be_kept_it_is_compiled_all_the_same(monkeypatch):
    def njit(**options):
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: (function, options)

    monkeypatch.setattr(compiled, "njit", njit)
    function, options = compiled._kept(len)
    assert function is len
    assert options == {"error_model": "numpy"}
