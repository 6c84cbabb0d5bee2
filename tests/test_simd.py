"""The vector type: loads, stores and arithmetic of every width, one rounding each, lanes apart."""

import os
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manywake.flow import simd
from manywake.flow.kernels import kernel
from manywake.flow.simd import add, fma, load, mul, splat, store, sub

finite = st.floats(min_value=-1e6, max_value=1e6, allow_nan=False, allow_subnormal=False)


@kernel
def _all_operations(x, number, out):
    a, b, c = load(x, 0, 0), load(x, 0, 1), load(x, 1, 0)
    store(out, 0, 0, fma(a, b, c))
    store(out, 0, 1, add(mul(a, b), c))
    store(out, 1, 0, sub(a, b))
    store(out, 1, 1, fma(number, b, c))
    store(out, 2, 0, splat(number, out))
    store(out, 2, 1, sub(number, add(number, mul(number, a))))


def _operate(values, number, width):
    x, out = simd.zeros((2, 2), width), simd.zeros((3, 2), width)
    simd.numbers(x)[...] = values
    _all_operations(x, number, out)
    return simd.numbers(out).copy()


def _once(a, b, c):
    """a b + c with one rounding, by exact arithmetic."""
    return float(Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c)))


@pytest.mark.parametrize("width", simd.WIDTHS)
@given(st.lists(finite, min_size=3, max_size=3), finite)
@settings(deadline=None, max_examples=40)
def test_fma_rounds_once_and_mul_then_add_rounds_twice(width, abc, number):
    values = np.empty((2, 2, width))
    values[...] = np.array([[abc[0], abc[1]], [abc[2], 0.0]])[:, :, None]
    values *= 1.0 + np.arange(width) / 7.0
    a, b, c = values[0, 0], values[0, 1], values[1, 0]
    out = _operate(values, number, width)
    np.testing.assert_array_equal(out[0, 0], [_once(*abc) for abc in zip(a, b, c, strict=True)])
    np.testing.assert_array_equal(out[0, 1], a * b + c)
    np.testing.assert_array_equal(out[1, 0], a - b)
    np.testing.assert_array_equal(out[1, 1], [_once(number, *bc) for bc in zip(b, c, strict=True)])
    np.testing.assert_array_equal(out[2, 0], np.full(width, number))
    np.testing.assert_array_equal(out[2, 1], number - (number + number * a))


def test_every_width_gives_the_same_bits():
    values = np.random.default_rng(0).normal(size=(2, 2, 8))
    wide = _operate(values, 0.1, 8)
    for width in (4, 1):
        narrow = [_operate(values[:, :, k : k + width], 0.1, width) for k in range(0, 8, width)]
        np.testing.assert_array_equal(np.concatenate(narrow, axis=-1), wide)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_lane_that_is_not_finite_stays_alone(bad):
    values = np.random.default_rng(1).normal(size=(2, 2, 8))
    good = _operate(values, 0.1, 8)
    values[:, :, 3] = bad
    others = np.arange(8) != 3
    np.testing.assert_array_equal(_operate(values, 0.1, 8)[..., others], good[..., others])


@pytest.mark.parametrize("width", simd.WIDTHS)
def test_lane_arrays_are_zero_aligned_and_seen_as_numbers(width):
    array = simd.zeros((5, 2), width)
    assert array.shape == (5, 2)
    assert array.ctypes.data % 64 == 0
    assert simd.numbers(array).shape == (5, 2, width)
    assert not simd.numbers(array).any()
    simd.numbers(array)[4, 1, width - 1] = 3.0
    assert array.view(np.float64)[4, 2 * width - 1] == 3.0


CALL = """
import sys
import numpy as np
from manywake.flow import simd
from manywake.flow.kernels import product

for width in map(int, sys.argv[1:]):
    x, out = simd.zeros((2, 1), width), simd.zeros((1, 1), width)
    simd.numbers(x)[...] = [[[3.0]], [[4.0]]]
    product(np.array([0, 2], np.uint32), np.array([0, 1], np.uint32), np.array([1.0, 2.0]), x, 0, out)
    assert (simd.numbers(out) == 11.0).all(), (width, simd.numbers(out))
"""


def test_kernels_cached_by_different_processes_are_not_mistaken_for_one_another(tmp_path):
    """Each process caches one width; a third takes both from the cache. Compiled names must tell them apart."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    for widths in (["8"], ["1"], ["8", "1", "8"], ["1", "8"]):
        subprocess.run([sys.executable, "-c", CALL, *widths], check=True, env=environment)
