"""The vector type: loads, stores and arithmetic of every width and precision, one rounding each, lanes apart."""

import os
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manywake.machine import simd
from manywake.machine.compile import kernel
from manywake.machine.simd import add, double, fma, high, join, load, low, mul, rounded, splat, store, sub

pytestmark = pytest.mark.alone

widths = pytest.mark.parametrize("width", simd.WIDTHS)
precisions = pytest.mark.parametrize("number", [np.float64, np.float32])
finite = st.floats(min_value=-1e6, max_value=1e6, allow_nan=False, allow_subnormal=False)


@kernel
def _all_operations(x, scalar, out):
    a, b, c = load(x, 0, 0), load(x, 0, 1), load(x, 1, 0)
    store(out, 0, 0, fma(a, b, c))
    store(out, 0, 1, add(mul(a, b), c))
    store(out, 1, 0, sub(a, b))
    store(out, 1, 1, fma(scalar, b, c))
    store(out, 2, 0, splat(scalar, out))
    store(out, 2, 1, sub(scalar, add(scalar, mul(scalar, a))))


@kernel
def _all_conversions(x, wide, back, both, halves):
    a, b = load(x, 0, 0), load(x, 0, 1)
    store(wide, 0, 0, double(a))
    store(wide, 0, 1, add(mul(1.0 / 3.0, double(a)), double(b)))
    store(back, 0, 0, rounded(load(wide, 0, 0), back))
    store(back, 0, 1, rounded(load(wide, 0, 1), back))
    store(both, 0, 0, join(a, b))
    store(halves, 0, 0, low(load(both, 0, 0)))
    store(halves, 0, 1, high(load(both, 0, 0)))


def _lane_array(values, number=np.float64):
    array = simd.zeros(values.shape[:-1], values.shape[-1], number)
    simd.numbers(array)[...] = values
    return array


def _operate(values, scalar, number=np.float64):
    """Return what `_all_operations` makes of values (2, 2, width)."""
    out = simd.zeros((3, 2), values.shape[-1], number)
    _all_operations(_lane_array(values, number), scalar, out)
    return simd.numbers(out).copy()


def _convert(values, number):
    """Return the results of `_all_conversions` of values (1, 2, width), joined rows last."""
    width = values.shape[-1]
    x, wide, both = _lane_array(values, number), simd.zeros((1, 2), width), simd.zeros((1, 1), 2 * width, number)
    back, halves = (simd.zeros((1, 2), width, number) for _ in range(2))
    _all_conversions(x, wide, back, both, halves)
    return [simd.numbers(array).copy() for array in (wide, back, halves, both)]


def _once(a, b, c, number):
    """a b + c with one rounding, by exact arithmetic: the nearest number, and the even one of two."""
    exact = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c))
    near = number(float(exact))
    around = [np.nextafter(near, number(-np.inf)), near, np.nextafter(near, number(np.inf))]
    bits = np.uint64 if number == np.float64 else np.uint32
    return min(around, key=lambda x: (abs(Fraction(float(x)) - exact), int(x.view(bits)) & 1))


@precisions
@widths
@given(st.lists(finite, min_size=3, max_size=3), finite)
@settings(deadline=None, max_examples=40)
def test_fma_rounds_once_and_mul_then_add_rounds_twice(width, number, abc, scalar):
    values = np.empty((2, 2, width))
    values[...] = np.array([[abc[0], abc[1]], [abc[2], 0.0]])[:, :, None]
    values = (values * (1.0 + np.arange(width) / 7.0)).astype(number)
    a, b, c = values[0, 0], values[0, 1], values[1, 0]
    out, s = _operate(values, scalar, number), number(scalar)
    assert out.dtype == number
    np.testing.assert_array_equal(out[0, 0], [_once(*abc, number) for abc in zip(a, b, c, strict=True)])
    np.testing.assert_array_equal(out[0, 1], a * b + c)
    np.testing.assert_array_equal(out[1, 0], a - b)
    np.testing.assert_array_equal(out[1, 1], [_once(s, *bc, number) for bc in zip(b, c, strict=True)])
    np.testing.assert_array_equal(out[2, 0], np.full(width, s))
    np.testing.assert_array_equal(out[2, 1], s - (s + s * a))


@precisions
@widths
def test_conversions_round_once_and_halves_are_where_they_were(width, number):
    values = np.random.default_rng(5).normal(size=(1, 2, width)).astype(number)
    a, b = values[0]
    wide, back, halves, both = _convert(values, number)
    assert (wide.dtype, back.dtype) == (np.float64, number)
    np.testing.assert_array_equal(wide[0, 0], a)
    third = (1.0 / 3.0) * a.astype(float) + b.astype(float)
    np.testing.assert_array_equal(wide[0, 1], third)
    np.testing.assert_array_equal(back[0], np.stack([a, third.astype(number)]))
    np.testing.assert_array_equal(both[0, 0], np.concatenate([a, b]))
    np.testing.assert_array_equal(halves, values)


@precisions
def test_every_width_gives_the_same_bits(number):
    values = np.random.default_rng(0).normal(size=(2, 2, 8)).astype(number)
    wide = [_operate(values, 0.1, number), *_convert(values[:1], number)[:3]]
    for width in simd.WIDTHS:
        parts = [values[:, :, k : k + width] for k in range(0, 8, width)]
        narrow = [[_operate(part, 0.1, number), *_convert(part[:1], number)[:3]] for part in parts]
        for ours, twin in zip(zip(*narrow, strict=True), wide, strict=True):
            np.testing.assert_array_equal(np.concatenate(ours, axis=-1), twin)


@precisions
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_lane_that_is_not_finite_stays_alone(bad, number):
    values = np.random.default_rng(1).normal(size=(2, 2, 8)).astype(number)
    good, converted = _operate(values, 0.1, number), _convert(values[:1], number)
    values[:, :, 3] = bad
    others = np.arange(8) != 3
    np.testing.assert_array_equal(_operate(values, 0.1, number)[..., others], good[..., others])
    *ours, both = _convert(values[:1], number)
    for array, twin in zip(ours, converted, strict=False):
        np.testing.assert_array_equal(array[..., others], twin[..., others])
    np.testing.assert_array_equal(both[..., np.tile(others, 2)], converted[3][..., np.tile(others, 2)])


@precisions
@widths
def test_lane_arrays_are_zero_aligned_and_seen_as_numbers(width, number):
    array = simd.zeros((5, 2), width, number)
    assert array.shape == (5, 2)
    assert array.dtype == simd.lanes(width, number)
    assert array.ctypes.data % 64 == 0
    seen = simd.numbers(array)
    assert (seen.shape, seen.dtype) == ((5, 2, width), number)
    assert not seen.any()
    seen[4, 1, width - 1] = 3.0
    assert array.view(np.uint8).reshape(-1).view(number)[10 * width - 1] == 3.0
    # both components in one row: the first half of its lanes, and the second
    pairs = simd.pairs(array)
    assert (pairs.shape, pairs.dtype) == ((5, 1), simd.lanes(2 * width, number))
    assert simd.numbers(pairs)[4, 0, 2 * width - 1] == 3.0
    simd.numbers(pairs)[2, 0, 0] = 4.0
    assert seen[2, 0, 0] == 4.0


CALL = """
import sys
import numpy as np
from manywake.flow.kernels import product
from manywake.machine import simd

for name in sys.argv[1:]:
    number, width = getattr(np, name.split(":")[0]), int(name.split(":")[1])
    x, out = simd.zeros((2, 1), width, number), simd.zeros((1, 1), width, number)
    simd.numbers(x)[...] = [[[3.0]], [[4.0]]]
    product(np.array([0, 2], np.uint32), np.array([0, 1], np.uint32), np.array([1.0, 2.0]), x, 0, out)
    assert (simd.numbers(out) == 11.0).all(), (name, simd.numbers(out))
"""


def test_kernels_cached_by_different_processes_are_not_mistaken_for_one_another(tmp_path):
    """Each process caches one kind of row; a last one takes all from the cache. Compiled names must tell them apart."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    kinds = [f"{number}:{width}" for number in ("float64", "float32") for width in simd.WIDTHS]
    for names in (*([kind] for kind in kinds), [*kinds, *reversed(kinds)]):
        subprocess.run([sys.executable, "-c", CALL, *names], check=True, env=environment)
