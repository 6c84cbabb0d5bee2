"""The steady base flow: Newton's method on the steady Navier-Stokes equations, Taylor-Hood elements."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem
from scipy.sparse.linalg import splu

from manywake.flow.case import Case
from manywake.flow.space import Space


@dataclass(frozen=True)
class SteadyFlow:
    """u: (n, 2), p: (m,) in scikit-fem's order. c_d, c_l: 2F / (rho U-bar^2 D). iterations: Newton steps taken."""

    u: np.ndarray
    p: np.ndarray
    c_d: float
    c_l: float
    iterations: int


@skfem.BilinearForm
def _advection(u, v, w):
    """(a . grad) u for a given velocity a."""
    return (w.ax * u.grad[0] + w.ay * u.grad[1]) * v


@skfem.BilinearForm
def _reaction(u, v, w):
    """U s for a given slope s."""
    return w.s * u * v


def solve(case: Case, space: Space, tolerance: float = 1e-9, most: int = 30) -> SteadyFlow:
    """Find the steady flow without jets, from the Stokes flow on, through growing Reynolds numbers.

    Raises RuntimeError when Newton does not converge within `most` steps at one Reynolds number.
    """
    n, m = space.mass.shape[0], space.pressure_stiffness.shape[0]
    body = space.boundary_nodes(["cylinder", *(f"jet{i}" for i in range(len(case.jets)))])
    inlet = space.boundary_nodes(["inlet"])
    fixed = np.union1d(np.union1d(space.boundary_nodes(["wall"]), body), inlet)
    free = np.setdiff1d(np.arange(2 * n + m), np.concatenate([fixed, n + fixed]))
    Bx, By = space.divergence
    x = np.zeros(2 * n + m)
    x[inlet] = case.inflow(space.x[inlet, 1])

    basis = skfem.Basis(space.velocity.mesh, skfem.ElementTriP2(), intorder=5)

    def residual_and_jacobian(x, nu, convect):
        u, v = x[:n], x[n : 2 * n]
        ux, vx = basis.interpolate(u), basis.interpolate(v)
        C = _advection.assemble(basis, ax=ux, ay=vx) if convect else sp.csr_matrix((n, n))
        A = nu * space.stiffness + C
        stokes = sp.bmat([[A, None, -Bx.T], [None, A, -By.T], [-Bx, -By, None]], format="csr")
        residual = stokes @ x
        if not convect:
            return residual, stokes
        S = [[_reaction.assemble(basis, s=g.grad[c]) for c in range(2)] for g in (ux, vx)]
        newton = sp.bmat(
            [[S[0][0], S[0][1], None], [S[1][0], S[1][1], None], [None, None, sp.csr_matrix((m, m))]], format="csr"
        )
        return residual, stokes + newton

    taken = 0
    ladder = [re for re in (20.0, 50.0) if re < case.reynolds] + [case.reynolds]
    for reynolds, convect in [(1.0, False), *((re, True) for re in ladder)]:
        nu = case.diameter / reynolds
        for _ in range(most):
            r, J = residual_and_jacobian(x, nu, convect)
            taken += 1
            step = splu(sp.csc_matrix(J[free][:, free])).solve(-r[free])
            x[free] += step
            if np.abs(step).max() < tolerance or not convect:
                break
        else:
            raise RuntimeError(f"steady: Newton did not converge at Re {reynolds:g} in {most} steps")
    r, _ = residual_and_jacobian(x, case.viscosity, True)
    coefficient = -2.0 / case.diameter
    force = coefficient * np.array([r[body].sum(), r[n + body].sum()])
    return SteadyFlow(np.stack([x[:n], x[n : 2 * n]], axis=1), x[2 * n :], float(force[0]), float(force[1]), taken)


def pressure_at(space: Space, p: np.ndarray, points: list[tuple[float, float]]) -> np.ndarray:
    """Return the pressure at points; those within 1e-3 of a vertex, as on the cylinder, are read at that vertex."""
    vertices = space.mesh.points
    values = []
    for point in points:
        distance = np.linalg.norm(vertices - np.asarray(point), axis=1)
        nearest = int(distance.argmin())
        if distance[nearest] < 1e-3:
            values.append(p[nearest])
        else:
            values.append(float((space.pressure.probes(np.array([point]).T) @ p)[0]))
    return np.array(values)
