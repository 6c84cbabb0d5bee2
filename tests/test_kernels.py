"""Every kernel against its slow twin in naive.py, in both precisions, and the same bits for every vector width."""

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from manywake.flow import factors, kernels, stepper
from manywake.flow.factors import Panels, Rows
from manywake.flow.kernels import CORNER, NODE, WEIGHT
from manywake.flow.stepper import State
from manywake.machine import simd

from . import naive
from .conftest import TINY, in_doubles, tiny_mesh

precisions = pytest.mark.parametrize("number", [np.float64, np.float32])
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 12)
few = settings(deadline=None, max_examples=15)

LANES = max(simd.WIDTHS)


def lane_array(values, number):
    array = simd.zeros(values.shape[:-1], values.shape[-1], number)
    simd.numbers(array)[...] = values
    return array


def run(call, *arrays):
    """Call a kernel on lane arrays in blocks of every width; return what is in the arrays after that, as doubles.

    arrays: (rows, columns, 8 lanes) of doubles or singles. The results have the same bits for every width.
    """
    results = []
    for width in simd.WIDTHS:
        blocks = []
        for k in range(0, LANES, width):
            block = [lane_array(values[..., k : k + width], values.dtype) for values in arrays]
            call(*block)
            blocks.append([simd.numbers(array) for array in block])
        results.append([np.concatenate(lanes, axis=-1) for lanes in zip(*blocks, strict=True)])
    for other in results[1:]:
        for ours, twin in zip(other, results[0], strict=True):
            np.testing.assert_array_equal(ours, twin)
    return [array.astype(float) for array in results[0]]


def near(ours, twin, terms, number):
    """Assert that sums of up to 30 terms agree to rounding; `terms` is the sum of their absolute values.

    Each fused multiply-add rounds a partial sum by half an eps of at most `terms`: 16 eps is a proven bound.
    """
    assert (abs(ours - twin) <= 16 * np.finfo(number).eps * terms).all()


def normal(rng, shape, number):
    return rng.normal(size=(*shape, LANES)).astype(number)


def pair_of(rng, rows, columns, number):
    """Return a sparse matrix of pairs, and the two dense matrices it stands for."""
    pattern = factors.rows(naive.random_matrix(rng, rows, columns))
    pair = pattern._replace(value=rng.normal(size=(len(pattern.value), 2)).astype(number))
    return pair, [naive.dense(pair, columns, c) for c in range(2)]


def absolute(*arrays):
    return [[abs(m) for m in array] if isinstance(array, list) else abs(array.astype(float)) for array in arrays]


def rounded(part, number):
    """Return a named tuple of arrays with its numbers in the given precision."""
    return type(part)(*(array.astype(number) if array.dtype == np.float64 else array for array in part))


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


@precisions
def test_convection_is_the_form_that_scikit_fem_assembles(number, tiny):
    space = tiny.space
    rng = np.random.default_rng(2)
    e, out = (normal(rng, (len(space.x), 2), number) for _ in range(2))
    straight = np.setdiff1d(np.arange(len(space.nodes)), space.curved)

    def call(e, out):
        for part, inverse in ((straight, space.inverse[straight, None]), (space.curved, space.curved_inverse)):
            nodes = space.nodes[part].astype(np.uint32)
            kernels.convection(nodes, inverse.astype(number), simd.pairs(e), simd.pairs(out))

    twin = naive.convection(space, e.astype(float), out.astype(float))
    ours = run(call, e, out)[1]
    # measured 1.0 eps in either precision
    np.testing.assert_allclose(ours, twin, rtol=0, atol=5 * np.finfo(number).eps * abs(twin).max())


@precisions
def test_return_flow(number, tiny):
    space, order, tables = tiny.space, tiny.velocity_order, tiny.tables
    rng = np.random.default_rng(3)
    e, out = (normal(rng, (len(space.x), 2), number) for _ in range(2))

    def call(e, out):
        normals = tables.open_normal.astype(number)
        kernels.return_flow(tables.open_nodes, normals, simd.pairs(e), simd.pairs(out))

    ours = run(call, e, out)[1]
    at, twin = np.empty(e.shape), out.astype(float)
    at[order] = e
    for lane in range(LANES):
        pushed = naive.return_flow(space, ["right"], at[..., lane])
        assert pushed.any()
        twin[..., lane] += pushed[order]
    # measured 0.5 eps of singles; the doubles have normals that were rounded to singles
    np.testing.assert_allclose(ours, twin, rtol=0, atol=2 * np.finfo(np.float32).eps * abs(twin).max())


def test_what_leaves_meets_no_traction_to_the_bit(tiny):
    rng = np.random.default_rng(4)
    e, out = (normal(rng, (len(tiny.space.x), 2), np.float32) for _ in range(2))
    # the same at all nodes of the outlet, as between them a parabola may turn back
    e[np.unique(tiny.tables.open_nodes)] = np.array([0.7, -3.0])[:, None]

    def call(e, out):
        kernels.return_flow(tiny.tables.open_nodes, tiny.tables.open_normal, simd.pairs(e), simd.pairs(out))

    np.testing.assert_array_equal(run(call, e, out)[1], out)


@precisions
@given(seeds, sizes, sizes, sizes)
@few
def test_linear_terms(number, seed, tested, more, m):
    rng = np.random.default_rng(seed)
    n = tested + more
    linear, H = pair_of(rng, tested, n, number)
    gradient, G = pair_of(rng, tested, m, number)
    e, d, p, out = (normal(rng, shape, number) for shape in ((n, 2), (n, 2), (m, 1), (n, 2)))

    def call(e, d, p, out):
        kernels.linear_terms(*linear, simd.pairs(e), simd.pairs(d), *gradient, p, simd.pairs(out))

    ours = run(call, e, d, p, out)[3]
    twin = naive.linear_terms(H, e.astype(float), d.astype(float), G, p.astype(float), out.astype(float))
    near(ours, twin, naive.linear_terms(*absolute(H, e, d, G, p, out)), number)


@precisions
@given(seeds, sizes, sizes)
@few
def test_push(number, seed, nodes, inputs):
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.permutation(nodes)[: (nodes + 1) // 2]).astype(np.uint32)
    loads, y = rng.normal(size=(inputs, len(rows), 2)), normal(rng, (nodes, 2), number)
    amplitudes = normal(rng, (3, inputs), np.float64)
    ours = run(lambda q, y: kernels.push(rows, loads, q, 1, simd.pairs(y)), amplitudes, y)[1]
    twin, terms = (
        naive.push(rows, *a)
        for a in ((loads, amplitudes[1], y.astype(float)), (abs(loads), abs(amplitudes[1]), abs(y.astype(float))))
    )
    near(ours, twin, terms, number)


@precisions
@given(seeds, sizes, sizes)
@few
def test_subtract_rows(number, seed, free, fixed):
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.permutation(free)[: (free + 1) // 2]).astype(np.uint32)
    matrix = sp.hstack([sp.csr_matrix((len(rows), free)), naive.random_matrix(rng, len(rows), fixed)])
    matrix = rounded(factors.rows(matrix), number)
    y = normal(rng, (free + fixed, 2), number)

    def call(y):
        kernels.subtract_rows(rows, *matrix, simd.pairs(y), simd.pairs(y))

    dense, start = naive.dense(matrix, free + fixed), y.astype(float)
    twin, terms = (
        naive.subtract_rows(rows, dense, start, start),
        naive.subtract_rows(rows, -abs(dense), *[abs(start)] * 2),
    )
    near(run(call, y)[0], twin, terms, number)


@precisions
@given(seeds, sizes, sizes, sizes)
@few
def test_divergence(number, seed, free, fixed, n):
    rng = np.random.default_rng(seed)
    divergence, D = pair_of(rng, free, n, np.float64)
    u, out = normal(rng, (n, 2), np.float64), normal(rng, (free + fixed, 1), number)

    def call(u, out):
        kernels.divergence(*divergence, simd.pairs(u), out)

    ours, twin = run(call, u, out)[1], naive.divergence(D, u, out.astype(float))
    # summed in doubles, and rounded once by half an eps of the sum, not of its terms
    terms = naive.divergence(*absolute(D, u, out))
    assert (abs(ours - twin) <= np.finfo(number).eps * abs(twin) + 16 * np.finfo(float).eps * terms).all()


@precisions
@given(seeds, sizes, st.sampled_from([0.0, 1.0]))
@few
def test_extrapolate(number, seed, n, ahead):
    rng = np.random.default_rng(seed)
    u, u_old = (normal(rng, (n, 2), np.float64) for _ in range(2))
    e, d = (normal(rng, (n, 2), number) for _ in range(2))

    def call(*arrays):
        kernels.extrapolate(ahead, *(simd.pairs(array) for array in arrays))

    ours = run(call, u, u_old, e, d)
    near(ours[2], naive.blend((1 + ahead, -ahead), u, u_old), abs(u) + abs(u_old), number)
    near(ours[3], naive.blend((1, -1), u, u_old), abs(u) + abs(u_old), number)
    # the increment is a difference of doubles, rounded once, however small beside u
    np.testing.assert_array_equal(ours[3], (u - u_old).astype(number))


@precisions
@given(seeds, sizes, sizes, st.integers(0, 1))
@few
def test_product(number, seed, rows, columns, component):
    rng = np.random.default_rng(seed)
    matrix = rounded(factors.rows(naive.random_matrix(rng, rows, columns)), number)
    x, out = normal(rng, (columns, 2), number), normal(rng, (rows, 1), number)
    ours = run(lambda x, out: kernels.product(*matrix, x, component, out), x, out)[1]
    dense = naive.dense(matrix, columns)
    near(ours, naive.product(dense, x.astype(float), component), naive.product(*absolute(dense, x), component), number)


# ---- factors in panels


def definite(rng, n, density, symmetric):
    """Return a matrix of symmetric structure whose symmetric part is positive definite."""
    half = naive.random_matrix(rng, n, n, density)
    matrix = sp.csr_matrix(half @ half.T + sp.diags(rng.uniform(0.5, 2.0, n)))
    if not symmetric:
        skew = sp.csr_matrix((rng.normal(size=matrix.nnz), matrix.indices, matrix.indptr), matrix.shape)
        matrix = matrix + skew - skew.T
    return sp.csr_matrix(matrix)


matrices = given(seeds, st.integers(1, 30), st.sampled_from([0.05, 0.15, 0.4]), st.booleans())


@matrices
@settings(deadline=None, max_examples=40)
def test_panels_multiply_to_the_permuted_matrix(seed, n, density, symmetric):
    matrix = definite(np.random.default_rng(seed), n, density, symmetric)
    panels, order = factors.factor(matrix)
    assert sorted(order) == list(range(n))
    permuted = matrix[order][:, order].toarray()
    np.testing.assert_allclose(naive.matrix_of(panels), permuted, rtol=0, atol=1e-12 * abs(permuted).max())
    assert len(panels.upper) == (0 if symmetric else len(panels.lower))


@given(seeds, st.integers(2, 30), st.sampled_from([0.05, 0.15, 0.4]), st.booleans(), st.integers(1, 12))
@settings(deadline=None, max_examples=40)
def test_the_last_rows_stay_last_and_begin_a_panel(seed, n, density, symmetric, last):
    last = min(last, n - 1)
    matrix = definite(np.random.default_rng(seed), n, density, symmetric)
    panels, order = factors.factor(matrix, last)
    np.testing.assert_array_equal(order[n - last :], np.arange(n - last, n))
    assert sorted(order) == list(range(n))
    assert n - last in panels.first
    permuted = matrix[order][:, order].toarray()
    np.testing.assert_allclose(naive.matrix_of(panels), permuted, rtol=0, atol=1e-12 * abs(permuted).max())


@precisions
@matrices
@settings(deadline=None, max_examples=40)
def test_solve(number, seed, n, density, symmetric):
    rng = np.random.default_rng(seed)
    panels = rounded(factors.factor(definite(rng, n, density, symmetric))[0], number)
    y = normal(rng, (n + 3, 2), number)
    ours = run(lambda y: kernels.solve(*panels, simd.pairs(y)), y)[0]
    np.testing.assert_array_equal(ours[n:], y[n:])
    # what the solution multiplies to is the right-hand side but for rounding, however ill the matrix; the scale is
    # |L| |D| |U| |y| (Higham 2002, 9.3). Measured 2.1 eps of it in 300 such matrices, 1.4 in singles.
    right, scale = np.tensordot(naive.matrix_of(panels), ours[:n], 1), 1.0
    for part in reversed(naive.triangles(panels)):
        scale = np.tensordot(abs(part), abs(ours[:n]) if np.isscalar(scale) else scale, 1)
    assert (abs(right - y[:n]) <= 8 * np.finfo(number).eps * scale).all()
    if number == np.float64:
        twin = naive.solve(naive.matrix_of(panels), y)
        np.testing.assert_allclose(ours, twin, rtol=0, atol=1e-9 * abs(twin).max())


@precisions
@given(seeds, st.integers(2, 20), st.booleans(), st.integers(0, 8), st.integers(0, 1))
@settings(deadline=None, max_examples=40)
def test_solve_held(number, seed, n, symmetric, last, held):
    rng = np.random.default_rng(seed)
    last = min(last, n - 1)
    panels = rounded(factors.factor(definite(rng, n, 0.15, symmetric), last)[0], number)
    e, y = (normal(rng, (n + 3, 2), number) for _ in range(2))
    count = np.count_nonzero(panels.first[:-1] >= n - last)
    ours = run(lambda e, y: kernels.solve_held(*panels, count, held, simd.pairs(e), simd.pairs(y)), e, y)[1]
    np.testing.assert_array_equal(ours[n:], y[n:])
    np.testing.assert_array_equal(ours[n - last : n, held], -e[n - last : n, held])
    if last == 0:
        plain = run(lambda y: kernels.solve(*panels, simd.pairs(y)), y)[0]
        np.testing.assert_array_equal(ours, plain)
    matrix = naive.matrix_of(panels)
    twin = naive.solve_held(matrix, last, held, e.astype(float), y.astype(float))
    # measured 0.4 eps of this in 300 such matrices of conditions up to 40, so 8e-16 of the largest number in doubles
    scale = np.linalg.cond(matrix) * abs(twin).max()
    np.testing.assert_allclose(ours, twin, rtol=0, atol=4 * np.finfo(number).eps * scale)


@given(seeds, st.integers(1, 12), st.sampled_from([0.0, 0.2, 0.5, 1.0]), st.integers(0, 5))
@settings(deadline=None, max_examples=60)
def test_the_cut_has_every_column_once_and_is_the_cheapest(seed, n, density, last):
    pattern = np.tril(np.random.default_rng(seed).random((n, n)) < density, -1)
    below = [np.flatnonzero(pattern[:, j]) for j in range(n)]
    last = min(last, n)
    first, shared = factors._cut(below, last)
    assert (first[0], first[-1]) == (0, n)
    assert n - last in first
    assert set(np.diff(first)) <= {1, 2, 3, 4}
    total = 0.0
    for p, rows in enumerate(shared):
        price, wanted = naive.cost(below, first[p], first[p + 1])
        np.testing.assert_array_equal(rows, wanted)
        total += price
    assert total == pytest.approx(naive.cheapest_cut(below, last=last), rel=1e-12)


@pytest.fixture(scope="module")
def tiny_in_doubles():
    return in_doubles(TINY, tiny_mesh())


def test_panels_of_the_flow_multiply_to_its_matrices(tiny, tiny_in_doubles):
    case, space = TINY, tiny.space
    A = case.scheme.new / case.time_step * space.mass + case.scheme.implicit * case.viscosity * space.stiffness
    for ops in (tiny, tiny_in_doubles):
        free, inner = ops.velocity_order[: ops.free], ops.pressure_order[: len(ops.tables.poisson.inverse_diagonal)]
        # measured 1.4 eps in doubles, and 0.3 in singles, to which the factors are rounded once they are made
        atol = 4 * np.finfo(ops.precision).eps
        for panels, matrix in (
            (ops.tables.momentum, A[free][:, free].toarray()),
            (ops.tables.poisson, space.pressure_stiffness[inner][:, inner].toarray()),
        ):
            np.testing.assert_allclose(naive.matrix_of(panels), matrix, rtol=0, atol=atol * abs(matrix).max())
            assert len(panels.upper) == 0


def test_panels_of_the_shipped_flow_have_every_width_and_share_what_is_symmetric(ops):
    assert set(np.diff(ops.tables.momentum.first)) == set(np.diff(ops.tables.poisson.first)) == {1, 2, 3, 4}
    assert len(ops.tables.poisson.upper) == 0  # and the mean flow's advection is not symmetric:
    assert len(ops.tables.momentum.upper) == len(ops.tables.momentum.lower)


def test_a_matrix_that_is_not_definite_is_refused():
    with pytest.raises(RuntimeError, match="pivoted|singular"):
        factors.factor(sp.csr_matrix(np.array([[0.0, 1.0], [1.0, 0.0]])))


def test_what_acts_on_rounded_fields_is_rounded_and_nothing_else(tiny, tiny_in_doubles):
    elements = {"inverse", "curved_inverse", "open_normal"}
    single = elements | {"linear", "gradient", "coupling", "momentum", "poisson", "energy"}
    for ops, number in ((tiny, np.float32), (tiny_in_doubles, np.float64)):
        assert ops.precision == number
        for name, part in ops.tables._asdict().items():
            arrays = part if isinstance(part, Rows | Panels) else [part]
            kinds = {array.dtype.type for array in arrays} - {np.uint32}
            assert kinds <= ({number} if name in single else {np.float64}), name


# ---- the whole step


def steps_by_width(ops) -> list[list[np.ndarray]]:
    """Return what is read in five driven steps of rough flows, and their last states, by blocks of every width."""
    rng = np.random.default_rng(4)
    n, m = len(ops.velocity_order), len(ops.pressure_order)
    u, u_old, p = (0.3 * normal(rng, shape, np.float64) for shape in ((n, 2), (n, 2), (m, 1)))
    phi, phi_old = (0.1 * normal(rng, (m, 1), ops.precision) for _ in range(2))
    rates, results = 0.01 * rng.normal(size=(5, 2, LANES)), []
    for width in simd.WIDTHS:
        blocks = []
        for k in range(0, LANES, width):
            lanes = slice(k, k + width)
            state = State(*(lane_array(part[..., lanes], part.dtype) for part in (u, u_old, p, phi, phi_old)))
            state, force = stepper.advance(ops, state, rates[..., lanes])
            blocks.append([force, *(simd.numbers(part) for part in vars(state).values())])
        results.append([np.concatenate(parts, axis=-1) for parts in zip(*blocks, strict=True)])
    return results


@pytest.mark.parametrize("doubles", [False, True])
def test_steps_have_the_same_bits_for_every_width(doubles, tiny, tiny_in_doubles):
    results = steps_by_width(tiny_in_doubles if doubles else tiny)
    assert all(np.isfinite(part).all() for part in results[0])
    for other in results[1:]:
        for ours, twin in zip(other, results[0], strict=True):
            np.testing.assert_array_equal(ours, twin)
