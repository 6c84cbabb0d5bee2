"""Every kernel against its slow twin in naive.py, for every vector width."""

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from manywake.flow import kernels, operators, simd
from manywake.flow import space as spaces
from manywake.flow.kernels import CORNER, NODE, WEIGHT
from manywake.flow.operators import Rows

from . import naive

widths = pytest.mark.parametrize("width", simd.WIDTHS)
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 12)
few = settings(deadline=None, max_examples=15)


def lane_array(rng, shape, width):
    array = simd.zeros(shape, width)
    simd.numbers(array)[...] = rng.normal(size=(*shape, width))
    return array, simd.numbers(array).copy()


def rows_of(matrix):
    matrix = sp.csr_matrix(matrix)
    return Rows(matrix.indptr.astype(np.uint32), matrix.indices.astype(np.uint32), matrix.data)


def pair_of(rng, rows, columns):
    """Return a sparse matrix of pairs, and the two dense matrices it stands for."""
    pattern = rows_of(naive.random_matrix(rng, rows, columns))
    pair = pattern._replace(value=rng.normal(size=(len(pattern.value), 2)))
    return pair, [naive.dense(pair, columns, c) for c in range(2)]


def triangle(rng, rows, lower):
    """Return a strictly triangular matrix, and its dense twin."""
    matrix = naive.random_matrix(rng, rows, rows)
    strict = rows_of(sp.tril(matrix, -1) if lower else sp.triu(matrix, 1))
    return strict, naive.dense(strict, rows)


def close(ours, twin):
    np.testing.assert_allclose(ours, twin, rtol=1e-9, atol=1e-9 * max(1.0, abs(twin).max(initial=0.0)))


def test_quadrature_is_exact_to_degree_5():
    x, y = CORNER[:, 1], CORNER[:, 2]
    factorial = np.array([1, 1, 2, 6, 24, 120, 720, 5040])
    for i in range(6):
        for j in range(6 - i):
            exact = factorial[i] * factorial[j] / factorial[i + j + 2]
            assert WEIGHT @ (x**i * y**j) == pytest.approx(exact, rel=1e-14)


def test_p2_functions_are_1_at_their_node_and_sum_to_1():
    np.testing.assert_allclose(NODE.sum(axis=1), 1.0, rtol=1e-14)
    x, y = CORNER[:, 1], CORNER[:, 2]
    at_nodes = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]])
    for f in (lambda x, y: x * x, lambda x, y: x * y, lambda x, y: y * y - x):
        np.testing.assert_allclose(NODE @ f(*at_nodes.T), f(x, y), atol=1e-15)


@widths
def test_convection_is_the_form_that_scikit_fem_assembles(width, tiny):
    space = tiny.space
    rng = np.random.default_rng(2)
    (u, u_twin), (old, old_twin), (out, out_twin) = (lane_array(rng, (len(space.x), 2), width) for _ in range(3))
    mean = rng.normal(size=(len(space.x), 2))
    straight = np.setdiff1d(np.arange(len(space.nodes)), space.curved)
    for part, inverse in ((straight, space.inverse[straight, None]), (space.curved, space.curved_inverse)):
        nodes = space.nodes[part]
        wind = spaces.wind(inverse, NODE @ mean[nodes])
        kernels.convection(nodes.astype(np.uint32), inverse, wind, 1.7, u, -0.6, old, out)
    close(simd.numbers(out), naive.convection(space, naive.blend((1.7, -0.6), u_twin, old_twin), mean, out_twin))


@widths
@given(seeds, sizes, sizes, sizes)
@few
def test_momentum_forward(width, seed, free, fixed, m):
    rng = np.random.default_rng(seed)
    n = free + fixed
    history, R = pair_of(rng, free, n)
    gradient, G = pair_of(rng, free, m)
    lower, L = triangle(rng, free, lower=True)
    shapes = ((n, 2), (n, 2), (m, 1), (n, 2))
    (u, u_twin), (old, old_twin), (p, p_twin), (y, y_twin) = (lane_array(rng, shape, width) for shape in shapes)
    kernels.momentum_forward(*history, u, old, *gradient, p, *lower, y)
    close(simd.numbers(y), naive.momentum_forward(R, u_twin, old_twin, G, p_twin, L, y_twin))


@widths
@given(seeds, sizes, sizes)
@few
def test_momentum_backward(width, seed, free, fixed):
    rng = np.random.default_rng(seed)
    upper, U = triangle(rng, free, lower=False)
    inverse = rng.uniform(0.5, 2.0, free)
    y, y_twin = lane_array(rng, (free + fixed, 2), width)
    kernels.momentum_backward(*upper, inverse, y)
    close(simd.numbers(y), naive.momentum_backward(U, inverse, y_twin))


@widths
@given(seeds, sizes, sizes, sizes)
@few
def test_pressure_solve(width, seed, free, fixed, n):
    rng = np.random.default_rng(seed)
    divergence, D = pair_of(rng, free, n)
    (lower, L), (upper, U) = triangle(rng, free, lower=True), triangle(rng, free, lower=False)
    inverse = rng.uniform(0.5, 2.0, free)
    (u, u_twin), (phi, phi_twin) = lane_array(rng, (n, 2), width), lane_array(rng, (free + fixed, 1), width)
    kernels.pressure_solve(*divergence, u, *lower, *upper, inverse, phi)
    phi_twin[:free, 0] = naive.pressure_solve(D, u_twin, L, U, inverse)
    close(simd.numbers(phi), phi_twin)


@widths
@given(seeds, sizes, sizes, st.integers(0, 1))
@few
def test_product(width, seed, rows, columns, component):
    rng = np.random.default_rng(seed)
    matrix = naive.random_matrix(rng, rows, columns)
    x, x_twin = lane_array(rng, (columns, 2), width)
    out, _ = lane_array(rng, (rows, 1), width)
    kernels.product(*rows_of(matrix), x, component, out)
    close(simd.numbers(out), naive.product(matrix.toarray(), x_twin, component))


@widths
@given(seeds, sizes, sizes)
@few
def test_add_product(width, seed, terms, n):
    rng = np.random.default_rng(seed)
    column, value = rng.integers(0, n, terms).astype(np.uint32), rng.normal(size=(terms, 2))
    (x, x_twin), (out, out_twin) = lane_array(rng, (n, 2), width), lane_array(rng, (3, 2), width)
    kernels.add_product(column, -1.3, value, x, 1, out)
    close(simd.numbers(out), naive.add_product(column, -1.3, value, x_twin, 1, out_twin))


@widths
@given(seeds, sizes)
@few
def test_add_scaled(width, seed, n):
    rng = np.random.default_rng(seed)
    rows = rng.permutation(n)[: (n + 1) // 2].astype(np.uint32)
    value = rng.normal(size=(len(rows), 2))
    (x, x_twin), (out, out_twin) = lane_array(rng, (3, 2), width), lane_array(rng, (n, 2), width)
    kernels.add_scaled(rows, value, x, 2, 1, out)
    close(simd.numbers(out), naive.add_scaled(rows, value, x_twin, 2, 1, out_twin))


@widths
@given(seeds, sizes, sizes)
@few
def test_fill(width, seed, rows, more):
    rng = np.random.default_rng(seed)
    value = rng.normal(size=(rows, 2))
    out, out_twin = lane_array(rng, (rows + more, 2), width)
    kernels.fill(value, out)
    np.testing.assert_array_equal(simd.numbers(out), naive.fill(value, out_twin))


def test_kernels_give_the_same_bits_for_every_width(tiny):
    space = tiny.space
    rng = np.random.default_rng(4)
    values, jets = rng.normal(size=(3, len(space.x), 2, 8)), rng.normal(size=(2, 2, 8))

    def run(lanes):
        width = lanes.stop - lanes.start
        u, old, y = (simd.zeros(values.shape[1:3], width) for _ in range(3))
        for array, value in zip((u, old, y), values, strict=True):
            simd.numbers(array)[...] = value[..., lanes]
        rates, phi = simd.zeros((2, 2), width), simd.zeros((space.pressure_stiffness.shape[0], 1), width)
        simd.numbers(rates)[...] = jets[..., lanes]
        tables = tiny.tables
        kernels.add_scaled(tables.jet_lift_rows, tables.jet_lift[0], rates, 1, 0, y)
        kernels.convection(tables.nodes, tables.inverse, tables.wind, 2.0, u, -1.0, old, y)
        kernels.convection(tables.curved_nodes, tables.curved_inverse, tables.curved_wind, 2.0, u, -1.0, old, y)
        kernels.momentum_forward(*tables.history, u, old, *tables.gradient, phi, *tables.momentum.lower, y)
        kernels.momentum_backward(*tables.momentum.upper, tables.momentum.inverse_diagonal, y)
        poisson = tables.poisson
        kernels.pressure_solve(*tables.divergence, y, *poisson.lower, *poisson.upper, poisson.inverse_diagonal, phi)
        kernels.add_product(tables.force_new.column, 1.0, tables.force_new.value, y, 0, rates)
        return [simd.numbers(array).copy() for array in (y, phi, rates)]

    wide = run(slice(0, 8))
    for width in (4, 1):
        narrow = [run(slice(k, k + width)) for k in range(0, 8, width)]
        for k, whole in enumerate(wide):
            np.testing.assert_array_equal(np.concatenate([part[k] for part in narrow], axis=-1), whole)


@given(seeds, st.integers(1, 25))
@settings(deadline=None, max_examples=25)
def test_factors_multiply_to_the_permuted_matrix(seed, n):
    rng = np.random.default_rng(seed)
    half = naive.random_matrix(rng, n, n, 0.2)
    matrix = sp.csr_matrix(half @ half.T + sp.diags(rng.uniform(0.5, 2.0, n)))
    factors, order = operators.factor(matrix)
    assert sorted(order) == list(range(n))
    close(naive.matrix_of(factors), matrix[order][:, order].toarray())


def test_factors_of_the_flow_multiply_to_its_matrices(tiny):
    case, space = tiny.case, tiny.space
    A = case.scheme.new / case.time_step * space.mass + case.scheme.implicit * case.viscosity * space.stiffness
    free = tiny.velocity_order[: tiny.free]
    close(naive.matrix_of(tiny.tables.momentum), A[free][:, free].toarray())
    inner = tiny.pressure_order[: len(tiny.tables.poisson.inverse_diagonal)]
    close(naive.matrix_of(tiny.tables.poisson), space.pressure_stiffness[inner][:, inner].toarray())


def test_a_matrix_that_is_not_definite_is_refused():
    with pytest.raises(RuntimeError, match="pivoted|singular"):
        operators.factor(sp.csr_matrix(np.array([[0.0, 1.0], [1.0, 0.0]])))
