"""The loops of the solver, on plain arrays: convection, sparse products, triangular solves.

Every kernel advances all lanes of a lane array (`simd.lanes`) at once; lanes never meet, sums have one fixed order,
and each has its slow, obvious twin in tests/naive.py. Sparse rows are (`start`, `column`, `value`) as in CSR.
A velocity array is (n, 2) rows of lanes, a pressure array (m, 1). Equation numbers: docs/numerics.md.
"""

import hashlib
from pathlib import Path
from typing import Any

import numba
import numpy as np
from platformdirs import user_cache_path

from manywake.flow import simd
from manywake.flow.simd import fma, load, mul, splat, store


def _cache_folder() -> str:
    """Return a folder of the user's cache that is keyed by the code that every kernel is made of.

    numba's own cache notices a change in the file of a kernel, but none in the files of what the kernel calls.
    """
    sources = [Path(__file__), Path(simd.__file__)]
    key = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
    return str(user_cache_path("manywake") / "kernels" / key)


def kernel(function) -> Any:
    """Compile a function with numba on first use, without the interpreter lock, cached on disk."""
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = before or _cache_folder()
    try:
        return numba.njit(error_model="numpy", nogil=True, cache=True)(function)
    except RuntimeError:  # no folder to write to: compile in every process
        return numba.njit(error_model="numpy", nogil=True)(function)
    finally:
        config.CACHE_DIR = before


def _quadrature() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return barycentric coordinates (q, 3), P2 values (q, 6) and weights (q,) of Radon's rule, exact to degree 5."""
    root = np.sqrt(15.0)
    points, weights = [(1 / 3, 1 / 3, 1 / 3)], [9 / 80]
    for a, w in (((6 - root) / 21, (155 - root) / 2400), ((6 + root) / 21, (155 + root) / 2400)):
        points += [(1 - 2 * a, a, a), (a, 1 - 2 * a, a), (a, a, 1 - 2 * a)]
        weights += [w] * 3
    corner = np.array(points)
    l0, l1, l2 = corner.T
    node = np.stack(
        [l0 * (2 * l0 - 1), l1 * (2 * l1 - 1), l2 * (2 * l2 - 1), 4 * l0 * l1, 4 * l1 * l2, 4 * l0 * l2], axis=1
    )
    return corner, node, np.array(weights)


CORNER, NODE, WEIGHT = _quadrature()
TEST = NODE * WEIGHT[:, None]


@kernel
def _at(table, q, a, b, c, d, e, f):
    """The P2 function with nodal values a ... f, at quadrature point q."""
    return fma(
        table[q, 5],
        f,
        fma(table[q, 4], e, fma(table[q, 3], d, fma(table[q, 2], c, fma(table[q, 1], b, mul(table[q, 0], a))))),
    )


@kernel
def _mix(q, a, b, c):
    """The P1 function with corner values a, b, c, at quadrature point q."""
    return fma(CORNER[q, 2], c, fma(CORNER[q, 1], b, mul(CORNER[q, 0], a)))


@kernel
def _slopes(a, b, c, d, e, f):
    """Derivatives of a P2 function along the two reference directions, at the three corners."""
    xi0 = fma(4.0, d, fma(-3.0, a, mul(-1.0, b)))
    xi1 = fma(-4.0, d, fma(3.0, b, a))
    xi2 = fma(-4.0, f, fma(4.0, e, fma(-1.0, b, a)))
    eta0 = fma(4.0, f, fma(-3.0, a, mul(-1.0, c)))
    eta1 = fma(4.0, e, fma(-4.0, d, fma(-1.0, c, a)))
    eta2 = fma(-4.0, f, fma(3.0, c, a))
    return xi0, xi1, xi2, eta0, eta1, eta2


@kernel
def _blend(a, x, b, y, i, c):
    """The blend a x + b y at row (i, c)."""
    return fma(a, load(x, i, c), mul(b, load(y, i, c)))


@kernel
def convection(nodes, inverse, wind, e0, u_now, e1, u_old, out):
    """Subtract (((e - U) . grad) e, v) from `out`, for e = e0 u_now + e1 u_old and every P2 test function v (eq. 6, 8).

    nodes: (elements, 6). inverse: (elements, q, 4), the inverse Jacobian times its determinant, row by row, at each
    quadrature point of curved triangles (q = 7), once for straight ones (q = 1). wind: (elements, 7, 2), the same
    times U at the quadrature points.
    """
    curved = 1 if inverse.shape[1] > 1 else 0
    for t in range(len(nodes)):
        i0, i1, i2 = nodes[t, 0], nodes[t, 1], nodes[t, 2]
        i3, i4, i5 = nodes[t, 3], nodes[t, 4], nodes[t, 5]
        u0, v0 = (
            _blend(e0, u_now, e1, u_old, i0, 0),
            _blend(e0, u_now, e1, u_old, i0, 1),
        )
        u1, v1 = (
            _blend(e0, u_now, e1, u_old, i1, 0),
            _blend(e0, u_now, e1, u_old, i1, 1),
        )
        u2, v2 = (
            _blend(e0, u_now, e1, u_old, i2, 0),
            _blend(e0, u_now, e1, u_old, i2, 1),
        )
        u3, v3 = (
            _blend(e0, u_now, e1, u_old, i3, 0),
            _blend(e0, u_now, e1, u_old, i3, 1),
        )
        u4, v4 = (
            _blend(e0, u_now, e1, u_old, i4, 0),
            _blend(e0, u_now, e1, u_old, i4, 1),
        )
        u5, v5 = (
            _blend(e0, u_now, e1, u_old, i5, 0),
            _blend(e0, u_now, e1, u_old, i5, 1),
        )
        ux0, ux1, ux2, ue0, ue1, ue2 = _slopes(u0, u1, u2, u3, u4, u5)
        vx0, vx1, vx2, ve0, ve1, ve2 = _slopes(v0, v1, v2, v3, v4, v5)
        a0, a1, a2, a3, a4, a5 = (
            load(out, i0, 0), load(out, i1, 0), load(out, i2, 0), load(out, i3, 0), load(out, i4, 0), load(out, i5, 0),
        )  # fmt: skip
        b0, b1, b2, b3, b4, b5 = (
            load(out, i0, 1), load(out, i1, 1), load(out, i2, 1), load(out, i3, 1), load(out, i4, 1), load(out, i5, 1),
        )  # fmt: skip
        for q in range(7):
            u = _at(NODE, q, u0, u1, u2, u3, u4, u5)
            v = _at(NODE, q, v0, v1, v2, v3, v4, v5)
            g = curved * q
            along_xi = fma(-inverse[t, g, 1], v, fma(-inverse[t, g, 0], u, wind[t, q, 0]))
            along_eta = fma(-inverse[t, g, 3], v, fma(-inverse[t, g, 2], u, wind[t, q, 1]))
            cu = fma(along_eta, _mix(q, ue0, ue1, ue2), mul(along_xi, _mix(q, ux0, ux1, ux2)))
            cv = fma(along_eta, _mix(q, ve0, ve1, ve2), mul(along_xi, _mix(q, vx0, vx1, vx2)))
            a0, b0 = fma(TEST[q, 0], cu, a0), fma(TEST[q, 0], cv, b0)
            a1, b1 = fma(TEST[q, 1], cu, a1), fma(TEST[q, 1], cv, b1)
            a2, b2 = fma(TEST[q, 2], cu, a2), fma(TEST[q, 2], cv, b2)
            a3, b3 = fma(TEST[q, 3], cu, a3), fma(TEST[q, 3], cv, b3)
            a4, b4 = fma(TEST[q, 4], cu, a4), fma(TEST[q, 4], cv, b4)
            a5, b5 = fma(TEST[q, 5], cu, a5), fma(TEST[q, 5], cv, b5)
        store(out, i0, 0, a0)
        store(out, i1, 0, a1)
        store(out, i2, 0, a2)
        store(out, i3, 0, a3)
        store(out, i4, 0, a4)
        store(out, i5, 0, a5)
        store(out, i0, 1, b0)
        store(out, i1, 1, b1)
        store(out, i2, 1, b2)
        store(out, i3, 1, b3)
        store(out, i4, 1, b4)
        store(out, i5, 1, b5)


@kernel
def momentum_forward(
    r_start, r_column, r_value, u, u_old, g_start, g_column, g_value, p, l_start, l_column, l_value, y
):
    """Add R0 u + R1 u_old + G p to the first rows of y, and solve L y = y on the way (eq. 9).

    r_value: (nnz, 2), the entries of R0 and R1.
    """
    for i in range(len(r_start) - 1):
        sx, sy = load(y, i, 0), load(y, i, 1)
        for k in range(r_start[i], r_start[i + 1]):
            j, now, old = r_column[k], r_value[k, 0], r_value[k, 1]
            sx = fma(now, load(u, j, 0), fma(old, load(u_old, j, 0), sx))
            sy = fma(now, load(u, j, 1), fma(old, load(u_old, j, 1), sy))
        for k in range(g_start[i], g_start[i + 1]):
            q = load(p, g_column[k], 0)
            sx, sy = fma(g_value[k, 0], q, sx), fma(g_value[k, 1], q, sy)
        for k in range(l_start[i], l_start[i + 1]):
            j, m = l_column[k], -l_value[k]
            sx, sy = fma(m, load(y, j, 0), sx), fma(m, load(y, j, 1), sy)
        store(y, i, 0, sx)
        store(y, i, 1, sy)


@kernel
def momentum_backward(start, column, value, inverse_diagonal, y):
    """Solve D U y = y for the first rows of y, U of unit diagonal (eq. 9)."""
    for back in range(len(inverse_diagonal)):
        i = len(inverse_diagonal) - 1 - back
        u, v = mul(inverse_diagonal[i], load(y, i, 0)), mul(inverse_diagonal[i], load(y, i, 1))
        for k in range(start[i], start[i + 1]):
            j, m = column[k], -value[k]
            u, v = fma(m, load(y, j, 0), u), fma(m, load(y, j, 1), v)
        store(y, i, 0, u)
        store(y, i, 1, v)


@kernel
def pressure_solve(d_start, d_column, d_value, u, l_start, l_column, l_value, u_start, u_column, u_value, inv, phi):
    """Solve the Poisson equation L D U phi = d u for the pressure increment (eq. 10)."""
    n = len(inv)
    for i in range(n):
        s = splat(0.0, phi)
        for k in range(d_start[i], d_start[i + 1]):
            j = d_column[k]
            s = fma(d_value[k, 0], load(u, j, 0), fma(d_value[k, 1], load(u, j, 1), s))
        for k in range(l_start[i], l_start[i + 1]):
            s = fma(-l_value[k], load(phi, l_column[k], 0), s)
        store(phi, i, 0, s)
    for back in range(n):
        i = n - 1 - back
        s = mul(inv[i], load(phi, i, 0))
        for k in range(u_start[i], u_start[i + 1]):
            s = fma(-u_value[k], load(phi, u_column[k], 0), s)
        store(phi, i, 0, s)


@kernel
def product(start, column, value, x, component, out):
    """Out (rows, 1) = sparse matrix times one component of x."""
    for i in range(len(start) - 1):
        s = splat(0.0, out)
        for k in range(start[i], start[i + 1]):
            s = fma(value[k], load(x, column[k], component), s)
        store(out, i, 0, s)


@kernel
def add_product(column, factor, value, x, row, out):
    """Add factor times the sum over k of value[k, c] x[column[k], c] to out[row, c], for c = 0, 1."""
    s, t = load(out, row, 0), load(out, row, 1)
    for k in range(len(column)):
        j = column[k]
        s = fma(factor * value[k, 0], load(x, j, 0), s)
        t = fma(factor * value[k, 1], load(x, j, 1), t)
    store(out, row, 0, s)
    store(out, row, 1, t)


@kernel
def add_scaled(rows, value, x, step, jet, out):
    """Add value[k, c] x[step, jet] to out[rows[k], c], for c = 0, 1."""
    q = load(x, step, jet)
    for k in range(len(rows)):
        i = rows[k]
        store(out, i, 0, fma(value[k, 0], q, load(out, i, 0)))
        store(out, i, 1, fma(value[k, 1], q, load(out, i, 1)))


@kernel
def fill(value, out):
    """Set out[i, c] = value[i, c] in every lane, for the rows of `value`."""
    for i in range(len(value)):
        for c in range(2):
            store(out, i, c, splat(value[i, c], out))
