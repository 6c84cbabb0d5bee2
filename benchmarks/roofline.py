"""Where a time step goes: each kernel's time beside the least time that its arithmetic or its memory traffic takes.

Run: manywake bench roofline --json

One core, one block of lanes, arrays as in a step. Peak and bandwidth are measured here too, by loops that do nothing
else: independent fused multiply-adds in registers, and reads of an array as large as what the kernel reads. Arithmetic
counts an add, a multiply and each half of a fused multiply-add as one; traffic counts every array of a kernel once for
each pass over it, which is the least it can be while the arrays do not fit the nearest cache.
"""

import os
import statistics
import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from manywake.flow import store as flows
from manywake.flow.batch import FlowBatch
from manywake.flow.kernels import convection, divergence, extrapolate, linear_terms, solve
from manywake.flow.operators import Operators
from manywake.machine import simd
from manywake.machine.simd import fma, load, splat, store
from manywake.suite import cylinder_jets

REPEATS = 15
INNER = 20
ELEMENT_FLOPS = 370
"""Of `kernels.convection`, a triangle and flow; counted in its text."""

repeated = numba.njit(error_model="numpy", nogil=True)


@repeated
def _multiply_add(times, x, out):
    # twelve sums: enough to fill two units of a latency of four or five, few enough for sixteen registers
    a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = a8 = a9 = a10 = a11 = load(x, 0, 0)
    f = load(x, 1, 0)
    for _ in range(times):
        a0, a1, a2, a3 = fma(f, a0, f), fma(f, a1, f), fma(f, a2, f), fma(f, a3, f)
        a4, a5, a6, a7 = fma(f, a4, f), fma(f, a5, f), fma(f, a6, f), fma(f, a7, f)
        a8, a9, a10, a11 = fma(f, a8, f), fma(f, a9, f), fma(f, a10, f), fma(f, a11, f)
    for i, a in enumerate((a0, a1, a2, a3, a4, a5, a6, a7, a8, a9, a10, a11)):
        store(out, i, 0, a)


@repeated
def _read(times, x, out):
    for _ in range(times):
        a = b = c = d = splat(0.0, x)
        for i in range(0, len(x) - 3, 4):
            a, b = fma(1.0, load(x, i, 0), a), fma(1.0, load(x, i + 1, 0), b)
            c, d = fma(1.0, load(x, i + 2, 0), c), fma(1.0, load(x, i + 3, 0), d)
        store(out, 0, 0, fma(1.0, a, fma(1.0, b, fma(1.0, c, d))))


@repeated
def _convection(times, t, e, y):
    for _ in range(times):
        convection(t.nodes, t.inverse, e, y)
        convection(t.curved_nodes, t.curved_inverse, e, y)


@repeated
def _linear(times, t, e, d, p, y):
    for _ in range(times):
        linear_terms(
            t.linear.start, t.linear.column, t.linear.value, e, d,
            t.gradient.start, t.gradient.column, t.gradient.value, p, y,
        )  # fmt: skip


@repeated
def _solve(times, m, y):
    for _ in range(times):
        solve(
            m.first, m.row_start, m.row, m.lower_start, m.lower, m.upper, m.lower_corner, m.upper_corner,
            m.inverse_diagonal, y,
        )  # fmt: skip


@repeated
def _divergence(times, t, u, phi):
    for _ in range(times):
        divergence(t.divergence.start, t.divergence.column, t.divergence.value, u, phi)


@repeated
def _extrapolate(times, u, u_old, e, d):
    for _ in range(times):
        extrapolate(1.0, u, u_old, e, d)


def _seconds(work: Callable[[int], Any], inner: int = INNER) -> float:
    """Return the median time of one pass."""
    work(1)
    samples = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work(inner)
        samples.append((time.perf_counter() - start) / inner)
    return statistics.median(samples)


def _size(*parts) -> int:
    return sum(part.nbytes if isinstance(part, np.ndarray) else _size(*part) for part in parts)


def _multiply_adds(wide: int) -> float:
    """Return the operations a second of twelve independent sums of vectors of so many singles."""
    x, out = simd.zeros((2, 1), wide, np.float32), simd.zeros((12, 1), wide, np.float32)
    simd.numbers(x)[...] = 0.5
    return 12 * 2 * wide * 10_000 / _seconds(lambda k: _multiply_add(10_000 * k, x, out), 5)


def peak(width: int) -> float:
    """Return GFLOP/s of multiply-adds on singles, at the best of three widths."""
    return max(_multiply_adds(wide) for wide in (width, 2 * width, 4 * width)) / 1e9


def bandwidth(width: int, size: int) -> float:
    """Return GB/s of reading `size` bytes again and again."""
    wide, one = (simd.zeros((rows, 1), 2 * width, np.float32) for rows in (size // (8 * width), 1))
    return wide.nbytes / _seconds(lambda k: _read(k, wide, one)) / 1e9


def work(ops: Operators, width: int) -> dict[str, tuple[Callable[[int], Any], int, int]]:
    """Return for each kernel: a pass over it, its arithmetic, its traffic in bytes."""
    t, n, m = ops.tables, len(ops.velocity_order), len(ops.pressure_order)
    rng = np.random.default_rng(0)

    def lanes(rows, wide, number=np.float32):
        array = simd.zeros((rows, 1), wide, number)
        simd.numbers(array)[...] = rng.normal(size=simd.numbers(array).shape)
        return array

    e, d, y = (lanes(n, 2 * width) for _ in range(3))
    u, u_old = (lanes(n, 2 * width, np.float64) for _ in range(2))
    p, phi = lanes(m, width), lanes(m, width)
    elements = len(t.nodes) + len(t.curved_nodes)

    def entries(panels):
        return 2 * (len(panels.lower) + np.count_nonzero(panels.lower_corner))

    return {
        "convection": (
            lambda k: _convection(k, t, e, y),
            elements * ELEMENT_FLOPS * width,
            _size(t.nodes, t.inverse, t.curved_nodes, t.curved_inverse, e, y, y),
        ),
        "linear terms": (
            lambda k: _linear(k, t, e, d, p, y),
            (8 * len(t.linear.column) + 4 * len(t.gradient.column)) * width,
            _size(t.linear, t.gradient, e, d, p, y),
        ),
        "velocity solve": (
            lambda k: _solve(k, t.momentum, y),
            (4 * entries(t.momentum) + 2 * n) * width,
            _size(t.momentum, t.momentum.row, y, y, y, y),
        ),
        "divergence": (
            lambda k: _divergence(k, t, u, phi),
            4 * len(t.divergence.column) * width,
            _size(t.divergence, u, phi),
        ),
        "pressure solve": (
            lambda k: _solve(k, t.poisson, phi),
            (2 * entries(t.poisson) + m) * width,
            _size(t.poisson, t.poisson.row, phi, phi, phi, phi),
        ),
        "extrapolation": (
            lambda k: _extrapolate(k, u, u_old, e, d),
            2 * 3 * n * width,
            _size(u, u_old, e, d),
        ),
    }


def measure() -> dict[str, Any]:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    flow, width = flows.flow(cylinder_jets.CASE), simd.WIDTHS[0]
    ops = flow.operators
    passes = work(ops, width)
    flops, rows = peak(width), {}
    for name, (run, arithmetic, traffic) in passes.items():
        took, speed = _seconds(run), bandwidth(width, traffic)
        least = max(arithmetic / flops, traffic / speed) / 1e9
        rows[name] = {
            "ms": took * 1e3,
            "mflop": arithmetic / 1e6,
            "mbyte": traffic / 1e6,
            "ms_by_arithmetic": arithmetic / flops / 1e6,
            "bandwidth_gbytes": speed,
            "ms_by_traffic": traffic / speed / 1e6,
            "share_of_roof": least / took,
        }
    batch, still = FlowBatch(ops, flow.baseline.start, width), np.zeros((25, len(ops.inputs), width))
    step = _seconds(lambda k: [batch.advance(still) for _ in range(k)], 4) / len(still)
    return {
        "case": "cylinder-jets",
        "lanes": width,
        "peak_gflops": flops,
        "kernels": rows,
        "sum_ms": sum(row["ms"] for row in rows.values()),
        "step_ms": step * 1e3,
        "share_of_roof": sum(max(r["ms_by_arithmetic"], r["ms_by_traffic"]) for r in rows.values()) / (step * 1e3),
    }
