"""The steady base flow: Newton's method on the steady Navier-Stokes equations, Taylor-Hood elements."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem
from scipy.sparse.linalg import splu

from manywake.case.case import Case
from manywake.flow import space as spaces
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


_reaction = skfem.BilinearForm(lambda u, v, w: w.s * u * v)
"""U s for a given slope s."""
LADDER = (20.0, 50.0)
"""Reynolds numbers at which Newton's method stops on the way to a larger one."""


def solve(case: Case, problem: Problem, tolerance: float = 1e-9, most: int = 30) -> SteadyFlow:
    """Find the steady flow at zero amplitudes, from the Stokes flow on, through growing Reynolds numbers.

    Raises RuntimeError when Newton does not converge within `most` steps at one Reynolds number.
    """
    space, basis = problem.space, problem.space.velocity
    n, m = len(space.x), len(space.mesh.points)
    pinned = np.empty(0, int) if case.outlet else 2 * n + problem.pressure_fixed
    slipping = n * problem.held + problem.slip
    free = np.setdiff1d(np.arange(2 * n + m), np.concatenate([problem.fixed, n + problem.fixed, slipping, pinned]))
    Bx, By = space.divergence
    x = np.concatenate([*problem.steady.T, np.zeros(m)])

    def residual_and_jacobian(x, nu, convect):
        u = x[: 2 * n].reshape(2, n)
        A = nu * space.stiffness + (spaces.advection(space, u.T) if convect else sp.csr_matrix((n, n)))
        stokes = sp.bmat([[A, None, -Bx.T], [None, A, -By.T], [-Bx, -By, None]], format="csr")
        if not convect:
            return stokes @ x, stokes
        slopes = [basis.interpolate(component).grad for component in u]
        reaction = [[*(_reaction.assemble(basis, s=slope[c]) for c in range(2)), None] for slope in slopes]
        return stokes @ x, stokes + sp.bmat([*reaction, [None, None, sp.csr_matrix((m, m))]], format="csr")

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
    u, residual = (part[: 2 * n].reshape(2, n).T.copy() for part in (x, r))
    return SteadyFlow(u, x[2 * n :], _readings(case, problem, residual), taken)


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
    values = []
    for point in np.array(points):
        distance = np.linalg.norm(space.mesh.points - point, axis=1)
        at_vertex = distance.min() < 1e-3
        values.append(p[distance.argmin()] if at_vertex else (space.pressure.probes(point[:, None]) @ p)[0])
    return np.array(values)
