"""The slow, obvious twin of every kernel: plain NumPy on dense matrices, scikit-fem forms, one flow at a time.

A lane array becomes an ordinary one here, the lane as its last axis. `step` is the whole time step of
docs/numerics.md, eq. 4-14, in scikit-fem's numbering, with dense solves, in doubles, and for the new velocity itself
and not for its increment.
"""

import numpy as np
import scipy.sparse as sp
import skfem


def dense(rows, columns, component=None):
    """Return (start, column, value) as a dense matrix; `component` picks one of two values."""
    matrix = np.zeros((len(rows.start) - 1, columns))
    for i in range(len(rows.start) - 1):
        for k in range(rows.start[i], rows.start[i + 1]):
            matrix[i, rows.column[k]] = rows.value[k] if component is None else rows.value[k, component]
    return matrix


def convection_form(space, e, mean):
    """Return (((e - U) . grad) e, v) for every P2 test function v, (n, 2): scikit-fem, quadrature of degree 5.

    That degree is exact on straight triangles; on curved ones its points are part of the definition.
    """
    basis = skfem.Basis(space.velocity.mesh, skfem.ElementTriP2(), intorder=5)
    u, v, a, b = (basis.interpolate(f) for f in (*e.T, *(e - mean).T))

    def along(field):
        form = skfem.LinearForm(lambda test, w: (w.a * w.f.grad[0] + w.b * w.f.grad[1]) * test)
        return form.assemble(basis, a=a, b=b, f=field)

    return np.stack([along(u), along(v)], axis=1)


def advection(space, mean):
    """Return ((U . grad) psi_k, psi_i) as a matrix: its columns are the convection of one node's function."""
    basis = skfem.Basis(space.velocity.mesh, skfem.ElementTriP2(), intorder=5)
    a, b = basis.interpolate(mean[:, 0]), basis.interpolate(mean[:, 1])
    return skfem.BilinearForm(lambda u, v, w: (w.a * u.grad[0] + w.b * u.grad[1]) * v).assemble(basis, a=a, b=b)


def damping(case, space, fluctuation):
    """Return the stiffness for the viscosity of eq. 15, quadrature point by quadrature point."""
    basis = skfem.Basis(space.velocity.mesh, skfem.ElementTriP2(), intorder=5)
    viscosity, V = np.zeros(basis.dx.shape), np.asarray(basis.interpolate(fluctuation))
    for e, weights in enumerate(basis.dx):
        size = (2 * sum(weights)) ** 0.5
        for q in range(len(weights)):
            crossed = V[e, q] * case.time_step / size
            share = min(max((crossed - 0.15) / (0.25 - 0.15), 0.0), 1.0)
            viscosity[e, q] = case.scheme.damping * case.time_step * V[e, q] ** 2 * share**2 * (3 - 2 * share)
    form = skfem.BilinearForm(lambda u, v, w: w.nu * (u.grad[0] * v.grad[0] + u.grad[1] * v.grad[1]))
    return form.assemble(basis, nu=viscosity)


def convection(space, e, out):
    """Subtract `convection_form` of every lane, advected with itself, from out (n, 2, lanes)."""
    return out - np.stack([convection_form(space, e[:, :, b], 0.0) for b in range(e.shape[-1])], axis=-1)


def blend(weights, u, u_old):
    """Return the combination of two velocities: w or e."""
    return weights[0] * u + weights[1] * u_old


def linear_terms(H, e, d, G, p, out):
    """Return out with its first rows replaced by H0 e + H1 d + G p. H, G: pairs of matrices."""
    out = out.copy()
    for b in range(out.shape[-1]):
        for c in range(2):
            out[: len(H[0]), c, b] = H[0] @ e[:, c, b] + H[1] @ d[:, c, b] + G[c] @ p[:, 0, b]
    return out


def subtract_rows(rows, matrix, x, out):
    """Return out with the rows of matrix times x subtracted from the rows of those numbers."""
    out = out.copy()
    for r, i in enumerate(rows):
        for j in range(len(x)):
            out[i] = out[i] - matrix[r, j] * x[j]
    return out


def solve(matrix, y):
    """Return y with its first rows replaced by the solution for them."""
    rows, y = len(matrix), y.copy()
    for b in range(y.shape[-1]):
        y[:rows, :, b] = np.linalg.solve(matrix, y[:rows, :, b])
    return y


def solve_held(matrix, last, held, e, y):
    """Return y as `solve`, but with the component `held` of the `last` rows given: minus that of e."""
    rows, y = len(matrix), y.copy()
    for b in range(y.shape[-1]):
        for c in range(2):
            inner = rows - last if c == held else rows
            y[inner:rows, c, b] = -e[inner:rows, c, b]
            right = y[:inner, c, b] - matrix[:inner, inner:] @ y[inner:rows, c, b]
            y[:inner, c, b] = np.linalg.solve(matrix[:inner, :inner], right)
    return y


def divergence(D, u, out):
    """Return out with its first rows replaced by D_x u_x + D_y u_y. D: pair of matrices."""
    out = out.copy()
    out[: len(D[0]), 0] = D[0] @ u[:, 0] + D[1] @ u[:, 1]
    return out


def product(matrix, x, component):
    """Return matrix times one component of x, (rows, 1, lanes)."""
    return (matrix @ x[:, component])[:, None]


def around(space, names):
    """Yield the facets of named boundaries one by one, at the points of a Gauss rule that is exact to degree 7.

    A facet is its three nodes, the values of their functions at the points (3, 4), the slopes of these along the facet
    (3, 4), times ds, and n ds (4, 2), out of the fluid; with the weights (4,) of the points. A facet is run through so
    that n is on its right.
    """
    points, weights = np.polynomial.legendre.leggauss(4)
    s, weights = 0.5 + 0.5 * points, 0.5 * weights
    values = np.stack([(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)])
    slopes = np.stack([4 * s - 3, 4 - 8 * s, 4 * s - 1])
    wanted = {frozenset(facet) for name in names for facet in space.mesh.boundaries[name].tolist()}
    for element in space.nodes.tolist():
        for a, b, third, middle in ((0, 1, 2, 3), (1, 2, 0, 4), (2, 0, 1, 5)):
            ends = element[a], element[b]
            if frozenset(ends) not in wanted:
                continue
            nodes = [ends[0], element[middle], ends[1]]
            x = space.x[nodes]
            inwards, along = space.x[element[third]] - x[1], x[2] - x[0]
            if along[0] * inwards[1] - along[1] * inwards[0] < 0:  # the fluid is on the right
                nodes, x = nodes[::-1], x[::-1]
            tangent = slopes.T @ x
            yield nodes, values, slopes, np.stack([tangent[:, 1], -tangent[:, 0]], axis=1), weights


def wall(space, names, phi, u):
    """Return minus the integral of phi_i n_j d u_j / d x_i over boundaries, u free of divergence.

    There n_j d u_j / d x_i is e_z x du/ds, with s along the facet: it turns x into y, and y into -x.
    """
    total = 0.0
    for nodes, values, slopes, _, weights in around(space, names):
        f, du = values.T @ phi[nodes], slopes.T @ u[nodes]
        total -= np.sum(weights * (f[:, 1] * du[:, 0] - f[:, 0] * du[:, 1]))
    return total


def momentum(space, names, phi, u):
    """Return the integral of phi . u (u . n) over boundaries."""
    total = 0.0
    for nodes, values, _, normal, weights in around(space, names):
        f, at = values.T @ phi[nodes], values.T @ u[nodes]
        total += np.sum(weights * (f * at).sum(axis=1) * (at * normal).sum(axis=1))
    return total


def functionals(case, space, profiles):
    """Return what is read by name: where, the field phi that the traction is tested with, its scale, and whether the
    fluid's momentum through the wall counts."""
    (body,) = case.bodies
    pieces = ["cylinder", "cylinder.top", "cylinder.bottom"]
    nodes, shape = space.boundary_nodes(pieces), space.x.shape
    along_x, along_y, turn = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    along_x[nodes, 0] = along_y[nodes, 1] = 1.0
    turn[nodes, 0], turn[nodes, 1] = -(space.x[nodes, 1] - body.centre[1]), space.x[nodes, 0] - body.centre[0]
    length, speed = case.scales.length, case.scales.velocity
    force = 2.0 / (length * speed**2)
    return {
        "c_d.cylinder": (pieces, along_x, force, True),
        "c_l.cylinder": (pieces, along_y, force, True),
        "c_m.cylinder": (pieces, turn, force / length, True),
        "work.cylinder.top": (["cylinder.top"], profiles[0], -force / speed, False),
        "work.cylinder.bottom": (["cylinder.bottom"], profiles[1], -force / speed, False),
    }


def return_flow(space, names, e):
    """Return half of ((e . n)_- e, v) over open ends, (n, 2), facet by facet and point by point."""
    pushed = np.zeros_like(e)
    for nodes, values, _, normal, weights in around(space, names):
        for q, weight in enumerate(weights):
            at = values[:, q] @ e[nodes]
            for k, node in enumerate(nodes):
                pushed[node] += 0.5 * weight * min(at @ normal[q], 0.0) * at * values[k, q]
    return pushed


def load(force, space):
    """Return (f, psi_i) for every node's function, (n, 2), for a force f inside the fluid; quadrature of degree 8."""
    basis = skfem.Basis(space.velocity.mesh, skfem.ElementTriP2(), intorder=8)
    squared = sum((x - at) ** 2 for x, at in zip(np.asarray(basis.global_coordinates()), force.at, strict=True))
    bell = np.exp(-squared / force.radius**2)
    tested = skfem.LinearForm(lambda v, w: w.bell * v).assemble(basis, bell=bell)
    return np.stack([component * tested for component in force.along], axis=1)


def push(rows, loads, amplitudes, out):
    """Return out with forces added to rows of those numbers. loads: (inputs, rows, 2). amplitudes: (inputs, lanes)."""
    out = out.copy()
    for r, i in enumerate(rows):
        for q, pushed in zip(amplitudes, loads[:, r], strict=True):
            out[i] += pushed[:, None] * q
    return out


def step(case, space, start, jets, profiles, boundaries, mean, fluctuation, forces=()):
    """Advance one flow by one step in scikit-fem's order; return u, p, phi and what is read, by name.

    jets: (2,) flow rates. profiles: (2, n, 2) velocity of the jets at unit flow rate. boundaries: dict with the
    velocity nodes `fixed` and `slip`, the inlet data `steady` (n, 2), the pressure nodes `pressure`, and the names of
    boundaries that are `open`. mean: (n, 2), zero where the scheme has none. fluctuation: (n,). forces: (force inside
    the fluid, amplitude) each.
    """
    scheme, dt, nu = case.scheme, case.time_step, case.viscosity
    M, K = space.mass, space.stiffness
    n, m = M.shape[0], space.pressure_stiffness.shape[0]
    a, theta = scheme.new, scheme.implicit

    w = blend(scheme.history, start.u, start.u_old)
    e = blend((1 + scheme.ahead, -scheme.ahead), start.u, start.u_old)
    p_star = start.p + scheme.pressure[0] * start.phi + scheme.pressure[1] * start.phi_old
    S = damping(case, space, fluctuation)
    C = convection_form(space, e, mean) - S @ e
    A = a / dt * M + theta * nu * K + advection(space, mean) + S

    loads = {force.on: load(force, space) for force, _ in forces}
    pushed = sum((q * loads[force.on] for force, q in forces), return_flow(space, boundaries["open"], e))
    u = boundaries["steady"] + np.einsum("j,jnc->nc", jets, profiles)
    for c in range(2):
        fixed = np.union1d(boundaries["fixed"], boundaries["slip"]) if c == 1 else boundaries["fixed"]
        free = np.setdiff1d(np.arange(n), fixed)
        right = M @ w[:, c] / dt - (1 - theta) * nu * (K @ w[:, c]) - C[:, c] + space.divergence[c].T @ p_star
        right = right + pushed[:, c] - A[:, fixed] @ u[fixed, c]
        u[free, c] = np.linalg.solve(A[free][:, free].toarray(), right[free])

    phi = np.zeros(m)
    inner = np.setdiff1d(np.arange(m), boundaries["pressure"])
    divergence = sum(space.divergence[c] @ u[:, c] for c in range(2))
    phi[inner] = np.linalg.solve(space.pressure_stiffness[inner][:, inner].toarray(), -a / dt * divergence[inner])
    p = start.p + phi

    residual = np.empty((n, 2))
    for c in range(2):
        residual[:, c] = A @ u[:, c] - M @ w[:, c] / dt + (1 - theta) * nu * (K @ w[:, c]) + C[:, c]
        residual[:, c] -= space.divergence[c].T @ p + pushed[:, c]
    blown = np.einsum("j,jnc->nc", jets, profiles)
    read = {}
    for name, (pieces, tested, scale, counts) in functionals(case, space, profiles).items():
        value = -(tested * residual).sum() + nu * wall(space, pieces, tested, u)
        read[name] = scale * (value + momentum(space, pieces, tested, blown) * counts)
    for name, on in loads.items():
        read[f"work.{name}"] = 2.0 / (case.scales.velocity**3 * case.scales.length) * (on * u).sum()
    return u, p, phi, read


def triangles(panels):
    """Return L, D and U of panels as dense matrices, unit diagonals included."""
    rows = len(panels.inverse_diagonal)
    L, U = np.eye(rows), np.eye(rows)
    upper = panels.upper if len(panels.upper) else panels.lower
    for p in range(len(panels.first) - 1):
        columns = range(int(panels.first[p]), int(panels.first[p + 1]))
        k = int(panels.lower_start[p])
        for i in panels.row[panels.row_start[p] : panels.row_start[p + 1]]:
            for j in columns:
                L[i, j], U[j, i] = -panels.lower[k], -upper[k]
                k += 1
        assert k == panels.lower_start[p + 1]
        k = 0
        for i in range(1, 4):
            for j in range(i):
                if i < len(columns):
                    L[columns[i], columns[j]] = -panels.lower_corner[p, k]
                    U[columns[j], columns[i]] = -panels.upper_corner[p, k]
                k += 1
    return L, np.diag(1.0 / panels.inverse_diagonal.astype(float)), U


def matrix_of(panels):
    """Return L D U as a dense matrix."""
    L, D, U = triangles(panels)
    return L @ D @ U


def cost(below, first, end):
    """Return what a panel of the columns first ... end costs, and the rows below it."""
    rows = sorted({int(i) for column in below[first:end] for i in column if i >= end})
    return len(rows) * (1.4 + 0.65 * (end - first)) + 10 + 4 * (end - first), rows


def cheapest_cut(below, first=0, last=0):
    """Return the least cost of cutting the columns from `first` on into panels of up to four: all cuts are tried.

    last: so many columns at the end are in no panel with others.
    """
    n = len(below)
    if first == n:
        return 0.0
    ends = range(first + 1, min(first + 4, n - last if first < n - last else n) + 1)
    return min(cost(below, first, end)[0] + cheapest_cut(below, end, last) for end in ends)


def random_matrix(rng, rows, columns, density=0.3):
    """Return a random sparse matrix with a sorted CSR structure."""
    return sp.csr_matrix(rng.normal(size=(rows, columns)) * (rng.random((rows, columns)) < density))


def energy(still, start, column, value, u):
    """The kernel's energy, for one flow: u (n, 2)."""
    d, total = u - still, 0.0
    for i in range(len(start) - 1):
        for k in range(start[i], start[i + 1]):
            total += value[k] * float(d[i] @ d[column[k]])
    return total
