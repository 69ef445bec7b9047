# Licensed under a 3-clause BSD style license - see LICENSE.rst
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from astro_scc.correlation.zncc import find_peaks


def slow_peaks(maps, threshold):
    """Pixels that no neighbour exceeds, nor any later one equals."""
    found = []
    for k, plane in enumerate(maps):
        for y in range(1, plane.shape[0] - 1):
            for x in range(1, plane.shape[1] - 1):
                around = plane[y - 1 : y + 2, x - 1 : x + 2].ravel()
                before, centre, after = around[:4], around[4], around[5:]
                if (
                    centre >= threshold
                    and (centre >= before).all()
                    and (centre > after).all()
                ):
                    found.append((k, y, x))
    return found


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 3),
    st.integers(1, 14),
    st.integers(1, 14),
    st.floats(0, 3),
    st.floats(-0.2, 0.9),
    st.booleans(),
    st.floats(0, 0.2),
)
def test_equals_brute_force(seed, n, ny, nx, smooth, threshold, ties, missing):
    rng = np.random.default_rng(seed)
    maps = ndimage.gaussian_filter(
        rng.uniform(-1, 1, (n, ny, nx)), (0, smooth, smooth), mode="wrap"
    )
    if ties:
        maps = np.round(maps, 1)
    maps[rng.random(maps.shape) < missing] = np.nan
    index, y, x, value = find_peaks(maps, threshold)
    expected = slow_peaks(maps, threshold)
    assert len(index) == len(expected)
    for k, (map_, py, px) in enumerate(expected):
        assert index[k] == map_
        assert abs(y[k] - py) <= 0.5
        assert abs(x[k] - px) <= 0.5
        assert maps[map_, py, px] <= value[k] <= max(1, maps[map_, py, px])


def test_plateau_has_one_peak():
    maps = np.zeros((1, 8, 8))
    maps[0, 3:5, 3:6] = 0.9
    assert len(find_peaks(maps, 0.5)[0]) == 1


def test_peaks_beside_what_is_unknown_are_none():
    y, x = np.mgrid[:9, :9]
    maps = (0.9 - 0.01 * ((y - 4) ** 2 + (x - 4) ** 2))[None]
    assert len(find_peaks(maps, 0.5)[0]) == 1
    maps[0, 5, 5] = np.nan
    assert len(find_peaks(maps, 0.5)[0]) == 0


@pytest.mark.parametrize("shape", [(0, 5, 5), (2, 1, 1), (2, 2, 9), (3, 5, 5)])
def test_no_peaks(shape):
    for column in find_peaks(np.zeros(shape), 0.5):
        assert column.shape == (0,)


@pytest.mark.parametrize(
    ("fwhm", "bias"), [(3, 0.06), (5, 0.025), (10, 0.008), (20, 0.002)]
)
def test_sub_pixel_bias_for_beam_shapes(fwhm, bias):
    """Of the nine-point quadratic on a Gaussian, which falls slower than it."""
    sigma = fwhm / np.sqrt(8 * np.log(2))
    y, x = np.mgrid[:41, :41]
    shifts = np.linspace(-0.5, 0.5, 11)[1:-1]
    maps = np.array(
        [
            np.exp(-((x - 20 - dx) ** 2 + (y - 20 - dy) ** 2) / (4 * sigma**2))
            for dy in shifts
            for dx in shifts
        ]
    )
    _, py, px, value = find_peaks(maps, 0.5)
    dy, dx = np.meshgrid(shifts, shifts, indexing="ij")
    assert np.abs(py - 20 - dy.ravel()).max() < bias
    assert np.abs(px - 20 - dx.ravel()).max() < bias
    assert (value <= 1).all()
    assert np.abs(value - 1).max() < 0.15 / fwhm
