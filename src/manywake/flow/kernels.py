"""The loops of the solver, on plain arrays: convection, sparse products, triangular solves.

Every kernel advances all lanes of a lane array (`simd.lanes`) at once; lanes never meet, sums have one fixed order,
and each has its slow, obvious twin in tests/naive.py. Sparse rows are (`start`, `column`, `value`) as in CSR.
A velocity array is `pairs` here, (n, 1) rows that hold the lanes of both components; a pressure array is (m, 1).
Every kernel works in the precision of the arrays it is given. Equation numbers: docs/numerics.md.
"""

import numpy as np

from manywake.machine.compile import kernel
from manywake.machine.simd import add, double, fma, high, join, load, low, maximum, mul, rounded, splat, store, sub


def _quadrature() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return barycentric coordinates (q, 3), P2 values (q, 6) and weights (q,) of Radon's rule, exact to degree 5."""
    root = np.sqrt(15.0)
    points, weights = [(1 / 3, 1 / 3, 1 / 3)], [9 / 80]
    for a, w in (((6 - root) / 21, (155 - root) / 2400), ((6 + root) / 21, (155 + root) / 2400)):
        points += [(1 - 2 * a, a, a), (a, 1 - 2 * a, a), (a, a, 1 - 2 * a)]
        weights += [w] * 3
    corner = np.array(points)
    l0, l1, l2 = corner.T
    vertices, edges = [at * (2 * at - 1) for at in corner.T], [4 * l0 * l1, 4 * l1 * l2, 4 * l0 * l2]
    return corner, np.stack([*vertices, *edges], axis=1), np.array(weights)


CORNER, NODE, WEIGHT = _quadrature()

_C_CORNER, _C_EDGE, _C_WEIGHT = (float(x) for x in (NODE[0, 0], NODE[0, 3], WEIGHT[0]))


def _orbit_rule(q: int) -> tuple[float, ...]:
    """Return what `_orbit` needs of three points that differ by a turn of the triangle, the first of which is q.

    P2 function of the corners that the point does not belong to, what that of its own has beyond it; that of the edges
    at that corner, what that of the opposite edge has beyond it; P1 function of the other corners, what that of its own
    has beyond it; weight.
    """
    other, near, slope = NODE[q, 1], NODE[q, 3], CORNER[q, 1]
    values = other, NODE[q, 0] - other, near, NODE[q, 4] - near, slope, CORNER[q, 0] - slope, WEIGHT[q]
    return tuple(float(x) for x in values)


_A, _B = _orbit_rule(1), _orbit_rule(4)

_POINT, _SHARE = np.polynomial.legendre.leggauss(4)
_S = 0.5 + 0.5 * _POINT
FACET = np.stack([(1 - _S) * (1 - 2 * _S), _S * (2 * _S - 1), 4 * _S * (1 - _S)], axis=1)
"""P2 values (q, 3) of a facet's ends and its middle at the points of Gauss's rule, exact to degree 7."""
FACET_SLOPE = np.stack([4 * _S - 3, 4 * _S - 1, 4 - 8 * _S], axis=1)
FACET_WEIGHT = 0.5 * _SHARE


@kernel
def _along(inverse, t, q, weight, value, slope_xi, slope_eta):
    """Minus the weight times (value . grad) of the field with these slopes, at one quadrature point."""
    u, v = low(value), high(value)
    xi = fma(-weight * inverse[t, q, 1], v, mul(-weight * inverse[t, q, 0], u))
    eta = fma(-weight * inverse[t, q, 3], v, mul(-weight * inverse[t, q, 2], u))
    return fma(join(eta, eta), slope_eta, mul(join(xi, xi), slope_xi))


@kernel
def _orbit(inverse, t, q0, q1, q2, rule, nodal, xi, eta):
    """What `_along` is at the three points of an orbit; nodal, xi, eta: see `convection`, sums last."""
    other, own, near, far, slope, turn, weight = rule
    a, b, c, ab, bc, ca, corners, edges = nodal
    base = fma(near, edges, mul(other, corners))
    base_xi, base_eta = mul(slope, xi[3]), mul(slope, eta[3])
    at_a = fma(far, bc, fma(own, a, base)), fma(turn, xi[0], base_xi), fma(turn, eta[0], base_eta)
    at_b = fma(far, ca, fma(own, b, base)), fma(turn, xi[1], base_xi), fma(turn, eta[1], base_eta)
    at_c = fma(far, ab, fma(own, c, base)), fma(turn, xi[2], base_xi), fma(turn, eta[2], base_eta)
    fa, fb = _along(inverse, t, q0, weight, *at_a), _along(inverse, t, q1, weight, *at_b)
    return fa, fb, _along(inverse, t, q2, weight, *at_c)


@kernel
def convection(nodes, inverse, e, out):
    """Subtract ((e . grad) e, v) from `out` for every P2 test function v (eq. 8).

    nodes: (elements, 6). inverse: (elements, q, 4), the inverse Jacobian times its determinant, row by row, at each
    quadrature point of curved triangles (q = 7), once for straight ones (q = 1). e, out: (n, 1) pairs. The three
    points of an orbit share the sums over corners and over edges, which is a third of the arithmetic.
    """
    curved = 1 if inverse.shape[1] > 1 else 0
    for t in range(len(nodes)):
        i0, i1, i2 = nodes[t, 0], nodes[t, 1], nodes[t, 2]
        i3, i4, i5 = nodes[t, 3], nodes[t, 4], nodes[t, 5]
        a, b, c = load(e, i0, 0), load(e, i1, 0), load(e, i2, 0)
        ab, bc, ca = load(e, i3, 0), load(e, i4, 0), load(e, i5, 0)
        corners, edges = add(add(a, b), c), add(add(ab, bc), ca)

        # derivatives along the two reference directions: at the three corners, and their sums
        xi_a = fma(4.0, ab, fma(-3.0, a, mul(-1.0, b)))
        xi_b = fma(-4.0, ab, fma(3.0, b, a))
        xi_c = fma(-4.0, ca, fma(4.0, bc, sub(a, b)))
        eta_a = fma(4.0, ca, fma(-3.0, a, mul(-1.0, c)))
        eta_b = fma(4.0, bc, fma(-4.0, ab, sub(a, c)))
        eta_c = fma(-4.0, ca, fma(3.0, c, a))
        xi = xi_a, xi_b, xi_c, add(add(xi_a, xi_b), xi_c)
        eta = eta_a, eta_b, eta_c, add(add(eta_a, eta_b), eta_c)
        nodal = a, b, c, ab, bc, ca, corners, edges

        value = fma(_C_EDGE, edges, mul(_C_CORNER, corners))
        f = _along(inverse, t, 0, _C_WEIGHT, value, mul(1.0 / 3.0, xi[3]), mul(1.0 / 3.0, eta[3]))
        at_corners, at_edges = mul(_C_CORNER, f), mul(_C_EDGE, f)

        fa, fb, fc = _orbit(inverse, t, curved * 1, curved * 2, curved * 3, _A, nodal, xi, eta)
        f = add(add(fa, fb), fc)
        other, own, near, far = _A[0], _A[1], _A[2], _A[3]
        at_corners, at_edges = fma(other, f, at_corners), fma(near, f, at_edges)
        ya, yb, yc = mul(own, fa), mul(own, fb), mul(own, fc)
        ybc, yca, yab = mul(far, fa), mul(far, fb), mul(far, fc)

        fa, fb, fc = _orbit(inverse, t, curved * 4, curved * 5, curved * 6, _B, nodal, xi, eta)
        f = add(add(fa, fb), fc)
        other, own, near, far = _B[0], _B[1], _B[2], _B[3]
        at_corners, at_edges = fma(other, f, at_corners), fma(near, f, at_edges)

        store(out, i0, 0, add(load(out, i0, 0), fma(own, fa, add(ya, at_corners))))
        store(out, i1, 0, add(load(out, i1, 0), fma(own, fb, add(yb, at_corners))))
        store(out, i2, 0, add(load(out, i2, 0), fma(own, fc, add(yc, at_corners))))
        store(out, i3, 0, add(load(out, i3, 0), fma(far, fc, add(yab, at_edges))))
        store(out, i4, 0, add(load(out, i4, 0), fma(far, fa, add(ybc, at_edges))))
        store(out, i5, 0, add(load(out, i5, 0), fma(far, fb, add(yca, at_edges))))


@kernel
def return_flow(nodes, normal, e, out):
    """Add half of ((e . n)_- e, v) over the open ends to `out` for every P2 test function v (eq. 23).

    nodes: (facets, 3), ends and middle. normal: (facets, q, 2), out of the fluid, times the weight of each point of
    the rule. e, out: pairs.
    """
    for f in range(len(nodes)):
        i, j, k = nodes[f, 0], nodes[f, 1], nodes[f, 2]
        a, b, c = load(e, i, 0), load(e, j, 0), load(e, k, 0)
        ya, yb, yc = load(out, i, 0), load(out, j, 0), load(out, k, 0)
        for q in range(len(FACET)):
            value = fma(FACET[q, 2], c, fma(FACET[q, 1], b, mul(FACET[q, 0], a)))
            inwards = fma(-normal[f, q, 0], low(value), mul(-normal[f, q, 1], high(value)))
            inwards = mul(-0.5, maximum(0.0, inwards))
            pushed = mul(join(inwards, inwards), value)
            ya, yb, yc = fma(FACET[q, 0], pushed, ya), fma(FACET[q, 1], pushed, yb), fma(FACET[q, 2], pushed, yc)
        store(out, i, 0, ya)
        store(out, j, 0, yb)
        store(out, k, 0, yc)


@kernel
def linear_terms(start, column, value, e, d, g_start, g_column, g_value, p, out):
    """Set the first rows of `out` to H0 e + H1 d + G p (eq. 9).

    value: (nnz, 2), the entries of H0 and H1. g_value: (nnz, 2), those of the two components of G. e, d, out: pairs.
    """
    for i in range(len(start) - 1):
        s, t = splat(0.0, out), splat(0.0, out)
        for k in range(start[i], start[i + 1]):
            j = column[k]
            s, t = fma(value[k, 0], load(e, j, 0), s), fma(value[k, 1], load(d, j, 0), t)
        x, y = splat(0.0, p), splat(0.0, p)
        for k in range(g_start[i], g_start[i + 1]):
            q = load(p, g_column[k], 0)
            x, y = fma(g_value[k, 0], q, x), fma(g_value[k, 1], q, y)
        store(out, i, 0, add(add(s, t), join(x, y)))


@kernel
def push(rows, loads, amplitudes, s, out):
    """Add the sum over inputs j of amplitudes[s, j] loads[j, k] to out[rows[k]] (eq. 19).

    loads: (inputs, rows, 2). amplitudes: (steps, inputs) lanes of doubles. out: pairs.
    """
    for k in range(len(rows)):
        x, y = splat(0.0, amplitudes), splat(0.0, amplitudes)
        for j in range(amplitudes.shape[1]):
            q = load(amplitudes, s, j)
            x, y = fma(loads[j, k, 0], q, x), fma(loads[j, k, 1], q, y)
        store(out, rows[k], 0, add(load(out, rows[k], 0), rounded(join(x, y), out)))


@kernel
def subtract_rows(rows, start, column, value, x, out):
    """Subtract the sum over k of value[k] x[column[k]] of sparse row r from out[rows[r]]."""
    for r in range(len(rows)):
        s = load(out, rows[r], 0)
        for k in range(start[r], start[r + 1]):
            s = fma(-value[k], load(x, column[k], 0), s)
        store(out, rows[r], 0, s)


@kernel
def solve(first, row_start, row, lower_start, lower, upper, lower_corner, upper_corner, inverse_diagonal, y):
    """Solve L D U y = y in place, by panels of up to four columns (eq. 9, 10; layout: `factors.Panels`).

    Forward, a panel is solved and pushed to the rows below it; backward, those rows are pulled into it: each row of y
    that is loaded serves as many entries as the panel has columns, and there is a sum for each of them.
    """
    where = first, row_start, row, lower_start
    _forward(*where, lower, lower_corner, y)
    _backward(*where, lower, upper, upper_corner, inverse_diagonal, 0, len(first) - 1, y)


@kernel
def solve_held(
    first, row_start, row, lower_start, lower, upper, lower_corner, upper_corner, inverse_diagonal, last, held, e, y
):
    """Solve as `solve` does, but in the rows of the `last` panels the component `held` of y becomes minus that of e.

    Both components share the factor: what the rows above see of those below comes in with the sweep backward, so there
    the held component is overwritten (eq. 18). e, y: pairs.
    """
    where, panels = (first, row_start, row, lower_start), len(first) - 1
    split = panels - last
    _forward(*where, lower, lower_corner, y)
    _backward(*where, lower, upper, upper_corner, inverse_diagonal, split, panels, y)
    for i in range(first[split], first[panels]):
        x, z, against = low(load(y, i, 0)), high(load(y, i, 0)), mul(-1.0, load(e, i, 0))
        store(y, i, 0, join(x, high(against)) if held else join(low(against), z))
    _backward(*where, lower, upper, upper_corner, inverse_diagonal, 0, split, y)


@kernel
def _forward(first, row_start, row, lower_start, lower, lower_corner, y):
    """Solve L y = y in place."""
    for p in range(len(first) - 1):
        c, width, o = first[p], first[p + 1] - first[p], lower_start[p]
        begin, end = row_start[p], row_start[p + 1]
        if width == 1:
            x0 = load(y, c, 0)
            for r in range(begin, end):
                i = row[r]
                store(y, i, 0, fma(lower[o], x0, load(y, i, 0)))
                o += 1
        elif width == 2:
            x0 = load(y, c, 0)
            x1 = fma(lower_corner[p, 0], x0, load(y, c + 1, 0))
            store(y, c + 1, 0, x1)
            for r in range(begin, end):
                i = row[r]
                store(y, i, 0, fma(lower[o + 1], x1, fma(lower[o], x0, load(y, i, 0))))
                o += 2
        elif width == 3:
            x0 = load(y, c, 0)
            x1 = fma(lower_corner[p, 0], x0, load(y, c + 1, 0))
            x2 = fma(lower_corner[p, 2], x1, fma(lower_corner[p, 1], x0, load(y, c + 2, 0)))
            store(y, c + 1, 0, x1)
            store(y, c + 2, 0, x2)
            for r in range(begin, end):
                i = row[r]
                store(y, i, 0, fma(lower[o + 2], x2, fma(lower[o + 1], x1, fma(lower[o], x0, load(y, i, 0)))))
                o += 3
        else:
            x0 = load(y, c, 0)
            x1 = fma(lower_corner[p, 0], x0, load(y, c + 1, 0))
            x2 = fma(lower_corner[p, 2], x1, fma(lower_corner[p, 1], x0, load(y, c + 2, 0)))
            x3 = fma(lower_corner[p, 3], x0, load(y, c + 3, 0))
            x3 = fma(lower_corner[p, 5], x2, fma(lower_corner[p, 4], x1, x3))
            store(y, c + 1, 0, x1)
            store(y, c + 2, 0, x2)
            store(y, c + 3, 0, x3)
            for r in range(begin, end):
                i = row[r]
                s = fma(lower[o + 1], x1, fma(lower[o], x0, load(y, i, 0)))
                store(y, i, 0, fma(lower[o + 3], x3, fma(lower[o + 2], x2, s)))
                o += 4


@kernel
def _backward(first, row_start, row, lower_start, lower, upper, upper_corner, inverse_diagonal, from_p, to_p, y):
    """Solve D U y = y in place for the columns of panels from_p ... to_p, from what y is in the rows below them."""
    if len(upper) == 0:
        upper = lower
    for back in range(to_p - from_p):
        p = to_p - 1 - back
        c, width, o = first[p], first[p + 1] - first[p], lower_start[p]
        begin, end = row_start[p], row_start[p + 1]
        s0 = mul(inverse_diagonal[c], load(y, c, 0))
        if width == 1:
            for r in range(begin, end):
                s0 = fma(upper[o], load(y, row[r], 0), s0)
                o += 1
        elif width == 2:
            s1 = mul(inverse_diagonal[c + 1], load(y, c + 1, 0))
            for r in range(begin, end):
                x = load(y, row[r], 0)
                s0, s1 = fma(upper[o], x, s0), fma(upper[o + 1], x, s1)
                o += 2
            s0 = fma(upper_corner[p, 0], s1, s0)
            store(y, c + 1, 0, s1)
        elif width == 3:
            s1 = mul(inverse_diagonal[c + 1], load(y, c + 1, 0))
            s2 = mul(inverse_diagonal[c + 2], load(y, c + 2, 0))
            for r in range(begin, end):
                x = load(y, row[r], 0)
                s0, s1, s2 = fma(upper[o], x, s0), fma(upper[o + 1], x, s1), fma(upper[o + 2], x, s2)
                o += 3
            s1 = fma(upper_corner[p, 2], s2, s1)
            s0 = fma(upper_corner[p, 1], s2, fma(upper_corner[p, 0], s1, s0))
            store(y, c + 1, 0, s1)
            store(y, c + 2, 0, s2)
        else:
            s1 = mul(inverse_diagonal[c + 1], load(y, c + 1, 0))
            s2 = mul(inverse_diagonal[c + 2], load(y, c + 2, 0))
            s3 = mul(inverse_diagonal[c + 3], load(y, c + 3, 0))
            for r in range(begin, end):
                x = load(y, row[r], 0)
                s0, s1 = fma(upper[o], x, s0), fma(upper[o + 1], x, s1)
                s2, s3 = fma(upper[o + 2], x, s2), fma(upper[o + 3], x, s3)
                o += 4
            s2 = fma(upper_corner[p, 5], s3, s2)
            s1 = fma(upper_corner[p, 4], s3, fma(upper_corner[p, 2], s2, s1))
            s0 = fma(upper_corner[p, 3], s3, fma(upper_corner[p, 1], s2, fma(upper_corner[p, 0], s1, s0)))
            store(y, c + 1, 0, s1)
            store(y, c + 2, 0, s2)
            store(y, c + 3, 0, s3)
        store(y, c, 0, s0)


@kernel
def divergence(start, column, value, u, out):
    """Set the first rows of `out` to Dx u_x + Dy u_y (eq. 10). value: (nnz, 2). u: pairs.

    u and value are doubles, and out is rounded from them: the sum is 2e-5 of its terms.
    """
    for i in range(len(start) - 1):
        s = double(splat(0.0, out))
        for k in range(start[i], start[i + 1]):
            x = load(u, column[k], 0)
            s = fma(value[k, 0], low(x), fma(value[k, 1], high(x), s))
        store(out, i, 0, rounded(s, out))


@kernel
def extrapolate(ahead, u, u_old, e, d):
    """Set e = u + ahead (u - u_old) and d = u - u_old, rounded to the precision of e and d (eq. 5, 6). All pairs."""
    for i in range(len(u)):
        extrapolate_row(ahead, load(u, i, 0), load(u_old, i, 0), e, d, i)


@kernel
def extrapolate_row(ahead, now, old, e, d, i):
    """What `extrapolate` does at one node, from its velocity now and a step before."""
    step = sub(now, old)
    store(d, i, 0, rounded(step, d))
    store(e, i, 0, rounded(fma(ahead, step, now), e))


@kernel
def energy(still, start, column, value, u, d, out, r, c):
    """Set out[r, c] to the energy of u - still: of d, that difference in singles, times the rows, times d (eq. 22).

    still: (n, 2). u, d: pairs, d room in any precision. out: doubles. Rows are the upper half of a symmetric matrix.
    """
    for i in range(len(still)):
        at_rest = join(splat(still[i, 0], out), splat(still[i, 1], out))
        store(d, i, 0, rounded(sub(load(u, i, 0), at_rest), d))
    total = splat(0.0, out)
    for i in range(len(start) - 1):
        s = splat(0.0, d)
        for k in range(start[i], start[i + 1]):
            s = fma(value[k], load(d, column[k], 0), s)
        both = mul(s, load(d, i, 0))
        total = add(total, add(double(low(both)), double(high(both))))
    store(out, r, c, total)


@kernel
def product(start, column, value, x, component, out):
    """Out (rows, 1) = sparse matrix times one component of x."""
    for i in range(len(start) - 1):
        s = splat(0.0, out)
        for k in range(start[i], start[i + 1]):
            s = fma(value[k], load(x, column[k], component), s)
        store(out, i, 0, s)
