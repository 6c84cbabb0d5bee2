"""The steady flow: Newton's method on the steady Navier-Stokes equations, along the branch of growing Reynolds number.

Method: docs/numerics.md, "Steady flow".
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem
from scipy.sparse.linalg import splu

from manywake.case.case import Case
from manywake.case.sensors import integrals
from manywake.flow import mesh as meshes
from manywake.flow import problem as problems
from manywake.flow import space as spaces
from manywake.flow.problem import Problem, Wall
from manywake.flow.readings import KINDS
from manywake.flow.space import Space

FIRST, GROWTH, LEAST = math.log(20.0), 1.5, 0.01
"""Steps in log Re: the first, from the Stokes flow on; by how much one may exceed the last; the shortest tried."""
FEW, MOST = 4, 10
"""Iterations of Newton's method after which the next step is longer; after which a shorter one is tried."""
SHORTEST = 1 / 16
"""Share of Newton's step below which the line search gives up."""
TOLERANCE, ON_THE_WAY = 1e-9, 1e-4
"""Relative change of velocity or pressure at which Newton's method ends: at the last flow, and before."""
Report = Callable[[str, float], None]
Branch = list[tuple[float, np.ndarray]]
"""Flows (u, v, p) by the logarithm of their Reynolds number: the last three."""


@dataclass(frozen=True)
class SteadyFlow:
    """u: (n, 2), p: (m,) in scikit-fem's order. readings: of the bodies and of sensors that are integrals, by name."""

    u: np.ndarray
    p: np.ndarray
    readings: dict[str, float]


def solve(case: Case, problem: Problem, report: Report | None = None) -> SteadyFlow:
    """Find the steady flow at zero amplitudes: the branch of the Stokes flow, followed to the case's Reynolds number.

    report: called with "steady flow" and the share of the way that is done. Raises RuntimeError, with the Reynolds
    number that was reached, where Newton's method does not converge by the shortest steps.
    """
    equations, wanted = _Equations(case, problem), math.log(case.reynolds)
    first = min(0.0, wanted - FIRST)  # the Stokes flow stands for this

    def done(what: str, s: float) -> None:
        if report is not None:
            report(what, (s - first) / (wanted - first))

    branch = _follow(equations, [(first, equations.stokes(first))], wanted, FIRST, lambda s: done("steady flow", s))
    x = branch[-1][1] if branch[-1][0] == wanted else _by_a_finer_mesh(case, equations, branch, wanted, done)
    n = equations.n
    residual, u = equations.residual(x, wanted)[0], x[: 2 * n].reshape(2, n).T.copy()
    readings = _readings(case, problem, u, residual[: 2 * n].reshape(2, n).T)
    return SteadyFlow(u, x[2 * n :].copy(), readings)


class _Equations:
    """The discrete steady equations for x = (u, v, p), in which boundary values stand; `free` are the unknowns."""

    def __init__(self, case: Case, problem: Problem):
        self.space, self.n, self.m = problem.space, len(problem.space.x), len(problem.space.mesh.points)
        n, m, self.unit = self.n, self.m, case.scales.length * case.scales.velocity
        pinned = np.empty(0, int) if case.outlet else 2 * n + problem.pressure_fixed
        held = problem.fixed, n + problem.fixed, n * problem.held + problem.slip, pinned
        self.free = np.setdiff1d(np.arange(2 * n + m), np.concatenate(held))
        self.boundary = np.concatenate([*problem.steady.T, np.zeros(m)])
        self.open = Wall(self.space, problem.open) if len(problem.open) else None

    def stokes(self, s: float) -> np.ndarray:
        """Return the flow without inertia."""
        matrix, x = self._matrix(s, sp.csr_matrix((self.n, self.n))), self.boundary.copy()
        x[self.free] -= splu(sp.csc_matrix(matrix[self.free][:, self.free])).solve((matrix @ x)[self.free])
        return x

    def residual(self, x: np.ndarray, s: float) -> tuple[np.ndarray, sp.csr_matrix]:
        """Return the residual at x, and the matrix that makes it from x: advection with the velocity as it is."""
        velocity = self.velocity(x)
        N = spaces.advection(self.space, velocity)
        if self.open is not None:
            N = N + _returning.assemble(self.open.basis, back=np.minimum(self.open.field(velocity)[2], 0.0))
        matrix = self._matrix(s, N)
        return matrix @ x, matrix

    def jacobian(self, x: np.ndarray, matrix: sp.csr_matrix) -> sp.csc_matrix:
        """Return the derivative of the residual among the free unknowns, from the matrix of `residual`."""
        basis, velocity = self.space.velocity, self.velocity(x)
        slopes = [basis.interpolate(component).grad for component in velocity.T]
        reaction = [[_reaction.assemble(basis, s=slope[c]) for c in range(2)] for slope in slopes]
        if self.open is not None:
            *at, through = map(np.asarray, self.open.field(velocity))
            for c in range(2):
                for d, normal in enumerate(self.open.basis.normals):
                    turned = _returning.assemble(self.open.basis, back=(through < 0.0) * at[c] * normal)
                    reaction[c][d] = reaction[c][d] + turned
        none = sp.csr_matrix((self.m, self.m))
        whole = matrix + sp.bmat([[*reaction[0], None], [*reaction[1], None], [None, None, none]], format="csr")
        return sp.csc_matrix(whole[self.free][:, self.free])

    def velocity(self, x: np.ndarray) -> np.ndarray:
        """Return the velocity (n, 2) of a flow."""
        return x[: 2 * self.n].reshape(2, self.n).T

    def moved(self, x: np.ndarray, to: "_Equations") -> np.ndarray:
        """Return a flow on another mesh, with its boundary values there."""
        velocity, pressure = spaces.carrying(self.space, to.space)
        u, p = velocity @ self.velocity(x), pressure @ x[2 * self.n :]
        there = to.boundary.copy()
        there[to.free] = np.concatenate([*u.T, p])[to.free]
        return there

    def _matrix(self, s: float, N: sp.csr_matrix) -> sp.csr_matrix:
        A, (Bx, By) = self.unit * math.exp(-s) * self.space.stiffness + N, self.space.divergence
        return sp.bmat([[A, None, -Bx.T], [None, A, -By.T], [-Bx, -By, None]], format="csr")


@skfem.BilinearForm
def _reaction(u, v, w):
    """U s for a given slope s."""
    return w.s * u * v


@skfem.BilinearForm
def _returning(u, v, w):
    """Minus half of back u: the traction of an open end (docs/numerics.md, eq. 23)."""
    return -0.5 * w.back * u * v


def _follow(equations: _Equations, branch: Branch, end: float, step: float, done: Callable[[float], None]) -> Branch:
    """Follow a branch from its last flow to `end`, or as far as Newton's method comes; return its last flows.

    Where Newton's method fails the step is halved, where it is quick the next one is longer. It begins at the
    polynomial through the flows before.
    """
    while branch[-1][0] != end and step > LEAST:
        here = branch[-1][0]
        there = end if end - here <= step + LEAST else here + step
        tolerance = TOLERANCE if there == end else ON_THE_WAY
        found, iterations = _newton(equations, _extrapolated(branch, there), there, tolerance)
        step = (there - here) * (0.5 if found is None else GROWTH if iterations <= FEW else 1.0)
        if found is not None:
            branch = [*branch[-2:], (there, found)]
            done(there)
    return branch


def _extrapolated(branch: Branch, there: float) -> np.ndarray:
    """Return the polynomial through the flows of a branch at another place."""
    guess = branch[-1][1].copy()
    for s, x in branch[:-1]:
        guess += math.prod((there - t) / (s - t) for t, _ in branch if t != s) * (x - branch[-1][1])
    return guess


def _newton(equations: _Equations, x: np.ndarray, s: float, tolerance: float) -> tuple[np.ndarray | None, int]:
    """Return the flow near x, None where none is found, and the iterations.

    A share of Newton's step is taken if the next step, with the same Jacobian, would be shorter (Deuflhard's natural
    monotonicity test); else half of that share.
    """
    residual, matrix = equations.residual(x, s)
    for k in range(1, MOST + 1):
        try:
            factor = splu(equations.jacobian(x, matrix))
        except RuntimeError:  # the Jacobian is singular
            return None, k
        step, share = _step(equations, factor, residual), 1.0
        if _relative(equations, step, x) < tolerance:
            return x + step, k
        while True:
            tried = x + share * step
            residual, matrix = equations.residual(tried, s)
            if _length(equations, _step(equations, factor, residual)) <= (1 - share / 4) * _length(equations, step):
                break
            share /= 2
            if share < SHORTEST:
                return None, k
        x = tried
    return None, MOST


def _step(equations: _Equations, factor, residual: np.ndarray) -> np.ndarray:
    step = np.zeros_like(residual)
    step[equations.free] = factor.solve(-residual[equations.free])
    return step


def _relative(equations: _Equations, step: np.ndarray, x: np.ndarray) -> float:
    """Return the largest change of velocity or pressure by the largest of it, of the pressure at least U squared."""
    (du, dp), (u, p) = (np.split(np.abs(part), [2 * equations.n]) for part in (step, x))
    speed = max(u.max(), 1e-150)  # a flow at rest changes by nothing
    return float(max(du.max() / speed, dp.max() / max(p.max(), speed**2)))


def _length(equations: _Equations, step: np.ndarray) -> float:
    """Return the length of a step by its velocity."""
    return float(np.linalg.norm(step[: 2 * equations.n]))


def _by_a_finer_mesh(
    case: Case, equations: _Equations, branch: Branch, wanted: float, done: Callable[[str, float], None]
) -> np.ndarray:
    """Return the flow near that of a mesh twice as fine, whose branch goes on where this one ends at a fold.

    A mesh that is coarse for its Reynolds number folds where the flow does not, though it has a flow beyond.
    """
    fine = _Equations(case, problems.pose(case, meshes.refine(equations.space.mesh)))
    reached, (start, x) = branch[-1][0], branch[0]

    def on_the_way(s: float) -> None:
        done("steady flow, finer mesh", s)

    moved = _follow(fine, [(start, equations.moved(x, fine))], wanted, FIRST / 20, on_the_way)
    if moved[-1][0] == wanted:
        found, _ = _newton(equations, fine.moved(moved[-1][1], equations), wanted, TOLERANCE)
        if found is not None:
            return found
    raise RuntimeError(
        f"steady flow: Newton's method came to Re {math.exp(reached):.4g}, on a mesh twice as fine to Re "
        f"{math.exp(moved[-1][0]):.4g}, wanted Re {case.reynolds:g}; make the triangles smaller (sizes), or choose a "
        "smaller reynolds"
    )


def _readings(case: Case, problem: Problem, u: np.ndarray, residual: np.ndarray) -> dict[str, float]:
    """Return drag, lift and torque in total and of each body, from the momentum residual (n, 2), then integrals."""
    found: dict[str, float] = dict.fromkeys(KINDS, 0.0) if case.bodies else {}
    for functional in problem.functionals:
        kind, _, body = functional.name.partition(".")
        if kind in KINDS:
            value = -float((functional.phi * residual).sum()) + case.viscosity * float(functional.wall[-1])
            found[f"{kind}.{body}"] = functional.scale * value
            found[kind] += found[f"{kind}.{body}"]
    slopes = {f.name: f.scale * float((f.load * u).sum()) for f in problem.functionals if f.load is not None}
    return found | {sensor.name: slopes.get(sensor.name, 0.0) for sensor in integrals(case.sensors)}


def pressure_at(space: Space, p: np.ndarray, points: list[tuple[float, float]]) -> np.ndarray:
    """Return the pressure at points; those within 1e-3 of a vertex, as on the cylinder, are read at that vertex."""
    values = []
    for point in np.array(points):
        distance = np.linalg.norm(space.mesh.points - point, axis=1)
        at_vertex = distance.min() < 1e-3
        values.append(p[distance.argmin()] if at_vertex else (space.pressure.probes(point[:, None]) @ p)[0])
    return np.array(values)
