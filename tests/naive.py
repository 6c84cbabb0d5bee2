"""The slow, obvious twin of every kernel: plain NumPy on dense matrices, scikit-fem forms, one flow at a time.

A lane array becomes an ordinary one here, the lane as its last axis. `step` is the whole time step of
docs/numerics.md, eq. 4-14, in scikit-fem's numbering and with dense solves.
"""

import numpy as np
import scipy.sparse as sp
import skfem
from scipy.linalg import solve_triangular


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


def damping(case, space):
    """Return the stiffness for the viscosity of eq. 15."""
    basis = skfem.Basis(space.velocity.mesh, skfem.ElementTriP2(), intorder=5)
    viscosity = np.zeros(basis.dx.shape)
    x, y = np.asarray(basis.global_coordinates())
    for jet in case.jets:
        angle, width = np.radians(jet.angle), np.radians(jet.width) * case.radius
        peak = np.pi * 0.01 / (2 * width)
        squared = (x - case.radius * np.cos(angle)) ** 2 + (y - case.radius * np.sin(angle)) ** 2
        viscosity += case.scheme.damping * case.time_step * peak**2 * np.exp(-squared / (2 * width) ** 2)
    form = skfem.BilinearForm(lambda u, v, w: w.nu * (u.grad[0] * v.grad[0] + u.grad[1] * v.grad[1]))
    return form.assemble(basis, nu=viscosity)


def convection(space, e, mean, out):
    """Subtract `convection_form` of every lane from out (n, 2, lanes)."""
    return out - np.stack([convection_form(space, e[:, :, b], mean) for b in range(e.shape[-1])], axis=-1)


def blend(weights, u, u_old):
    """Return the combination of two velocities: w or e."""
    return weights[0] * u + weights[1] * u_old


def momentum_forward(R, u, u_old, G, p, L, y):
    """Return y with its first rows replaced by L^-1 (y + R0 u + R1 u_old + G p).

    R, G: pairs of matrices, L: strict lower part.
    """
    rows, y = len(L), y.copy()
    for b in range(y.shape[-1]):
        for c in range(2):
            right = y[:rows, c, b] + R[0] @ u[:, c, b] + R[1] @ u_old[:, c, b] + G[c] @ p[:, 0, b]
            y[:rows, c, b] = solve_triangular(L + np.eye(rows), right, lower=True, unit_diagonal=True)
    return y


def momentum_backward(U, inverse_diagonal, y):
    """Return y with its first rows replaced by (D (I + U))^-1 y; U: strict upper part."""
    rows, y = len(U), y.copy()
    matrix = np.diag(1.0 / inverse_diagonal) @ (np.eye(rows) + U)
    for b in range(y.shape[-1]):
        y[:rows, :, b] = np.linalg.solve(matrix, y[:rows, :, b])
    return y


def pressure_solve(D, u, L, U, inverse_diagonal):
    """Return the solution (rows, lanes) of (I + L) D (I + U) phi = D_x u_x + D_y u_y."""
    one = np.eye(len(L))
    matrix = (one + L) @ np.diag(1.0 / inverse_diagonal) @ (one + U)
    return np.linalg.solve(matrix, D[0] @ u[:, 0] + D[1] @ u[:, 1])


def product(matrix, x, component):
    """Return matrix times one component of x, (rows, 1, lanes)."""
    return (matrix @ x[:, component])[:, None]


def add_product(column, factor, value, x, row, out):
    """Return out with factor times the sums over k of value[k, c] x[column[k], c] added to out[row, c]."""
    out = out.copy()
    for k, j in enumerate(column):
        for c in range(2):
            out[row, c] = out[row, c] + factor * value[k, c] * x[j, c]
    return out


def add_scaled(rows, value, x, step, jet, out):
    """Return out with value[k, c] x[step, jet] added to out[rows[k], c]."""
    out = out.copy()
    for k, i in enumerate(rows):
        for c in range(2):
            out[i, c] = out[i, c] + value[k, c] * x[step, jet]
    return out


def fill(value, out):
    """Return out with its first rows set to `value` in every lane."""
    out = out.copy()
    out[: len(value)] = value[:, :, None]
    return out


def step(case, space, start, jets, profiles, boundaries, mean):
    """Advance one flow by one step in scikit-fem's order; return u, p, phi and (C_D, C_L).

    jets: (2,) flow rates. profiles: (2, n, 2) velocity of the jets at unit flow rate. boundaries: dict with the
    velocity nodes `fixed` and `body`, the inlet data `steady` (n, 2), the pressure nodes `pressure`, and `thrust`
    (2, 2), the momentum flux of the jets at unit flow rate. mean: (n, 2), zero where the scheme has none.
    """
    scheme, dt, nu = case.scheme, case.time_step, case.viscosity
    M, K = space.mass, space.stiffness
    n, m = M.shape[0], space.pressure_stiffness.shape[0]
    a, theta = scheme.new, scheme.implicit

    w = blend(scheme.history, start.u, start.u_old)
    e = blend(scheme.extrapolation, start.u, start.u_old)
    p_star = start.p + scheme.pressure[0] * start.phi + scheme.pressure[1] * start.phi_old
    S = damping(case, space)
    C = convection_form(space, e, mean) - S @ e
    A = a / dt * M + theta * nu * K + advection(space, mean) + S

    u = boundaries["steady"] + np.einsum("j,jnc->nc", jets, profiles)
    fixed = boundaries["fixed"]
    free = np.setdiff1d(np.arange(n), fixed)
    for c in range(2):
        right = M @ w[:, c] / dt - (1 - theta) * nu * (K @ w[:, c]) - C[:, c] + space.divergence[c].T @ p_star
        right = right - A[:, fixed] @ u[fixed, c]
        u[free, c] = np.linalg.solve(A[free][:, free].toarray(), right[free])

    phi = np.zeros(m)
    inner = np.setdiff1d(np.arange(m), boundaries["pressure"])
    divergence = sum(space.divergence[c] @ u[:, c] for c in range(2))
    phi[inner] = np.linalg.solve(space.pressure_stiffness[inner][:, inner].toarray(), -a / dt * divergence[inner])
    p = start.p + phi

    force = np.zeros(2)
    for c in range(2):
        residual = A @ u[:, c] - M @ w[:, c] / dt + (1 - theta) * nu * (K @ w[:, c]) + C[:, c]
        residual = residual - space.divergence[c].T @ p
        flux = sum(boundaries["thrust"][j, c] * jets[j] ** 2 for j in range(len(jets)))
        force[c] = -residual[boundaries["body"]].sum() + flux
    return u, p, phi, 2.0 * force / case.diameter


def matrix_of(factors):
    """Return (I + L) D (I + U) as a dense matrix."""
    rows = len(factors.inverse_diagonal)
    L, U = dense(factors.lower, rows), dense(factors.upper, rows)
    return (np.eye(rows) + L) @ np.diag(1.0 / factors.inverse_diagonal) @ (np.eye(rows) + U)


def random_matrix(rng, rows, columns, density=0.3):
    """Return a random sparse matrix with a sorted CSR structure."""
    return sp.csr_matrix(rng.normal(size=(rows, columns)) * (rng.random((rows, columns)) < density))
