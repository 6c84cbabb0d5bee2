"""The steady base flow: Newton's method on the steady Navier-Stokes equations, Taylor-Hood elements."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem
from scipy.sparse.linalg import splu

from manywake.case.case import Case
from manywake.flow.problem import Problem
from manywake.flow.readings import KINDS
from manywake.flow.space import Space


@dataclass(frozen=True)
class SteadyFlow:
    """u: (n, 2), p: (m,) in scikit-fem's order. readings: of the bodies, by name. iterations: Newton steps taken."""

    u: np.ndarray
    p: np.ndarray
    readings: dict[str, float]
    iterations: int


@skfem.BilinearForm
def _advection(u, v, w):
    """(a . grad) u for a given velocity a."""
    return (w.ax * u.grad[0] + w.ay * u.grad[1]) * v


@skfem.BilinearForm
def _reaction(u, v, w):
    """U s for a given slope s."""
    return w.s * u * v


LADDER = (20.0, 50.0)
"""Reynolds numbers at which Newton's method stops on the way to a larger one."""


def solve(case: Case, problem: Problem, tolerance: float = 1e-9, most: int = 30) -> SteadyFlow:
    """Find the steady flow at zero amplitudes, from the Stokes flow on, through growing Reynolds numbers.

    Raises RuntimeError when Newton does not converge within `most` steps at one Reynolds number.
    """
    space = problem.space
    n, m = space.mass.shape[0], space.pressure_stiffness.shape[0]
    pinned = np.empty(0, int) if case.outlet else 2 * n + problem.pressure_fixed
    free = np.setdiff1d(np.arange(2 * n + m), np.concatenate([problem.fixed, n + problem.fixed, pinned]))
    Bx, By = space.divergence
    x = np.concatenate([*problem.steady.T, np.zeros(m)])

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
    ladder = [re for re in LADDER if re < case.reynolds] + [case.reynolds]
    for reynolds, convect in [(1.0, False), *((re, True) for re in ladder)]:
        nu = case.scales.length * case.scales.velocity / reynolds
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
    u = np.stack([x[:n], x[n : 2 * n]], axis=1)
    return SteadyFlow(u, x[2 * n :], _readings(case, problem, np.stack([r[:n], r[n : 2 * n]], axis=1)), taken)


def _readings(case: Case, problem: Problem, residual: np.ndarray) -> dict[str, float]:
    """Return drag, lift and torque in total and of each body, from the momentum residual (n, 2)."""
    found: dict[str, float] = dict.fromkeys(KINDS, 0.0) if case.bodies else {}
    for functional in problem.functionals:
        kind, _, body = functional.name.partition(".")
        if kind in KINDS:
            value = -float((functional.phi * residual).sum()) + case.viscosity * float(functional.wall[-1])
            found[f"{kind}.{body}"] = functional.scale * value
            found[kind] += found[f"{kind}.{body}"]
    return found


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
