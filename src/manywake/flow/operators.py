"""Everything a time step multiplies with or solves by: assembled once per case and mesh, shared by all flows.

Inside, velocity nodes are renumbered: the free ones first, in the elimination order of the momentum matrix, then
those of given velocity; pressure nodes likewise. So the factors need no permutation while stepping.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
import skfem
from skfem.helpers import dot, grad

from manywake.case.schemes import Scheme
from manywake.case.sensors import Sensor
from manywake.flow import factors
from manywake.flow import space as spaces
from manywake.flow.factors import Panels, Rows
from manywake.flow.mesh import Mesh
from manywake.flow.problem import Problem
from manywake.flow.space import Space
from manywake.machine import disk


class Tables(NamedTuple):
    """The arrays the compiled time loop reads, in the solver's order. Coefficients of the scheme stand in `numbers`.

    What acts on rounded fields is float32 as they are: elements, linear, gradient, coupling and factors.
    fixed: (nodes of given velocity, 2), their values at zero amplitude. residual, increment: rows of the functionals,
    whose columns count both components of a node, x first; of phi and of A^T phi. read_pressure: of B phi. wall, flux,
    scale: (functionals, ...), as in `problem.Functional`.
    """

    nodes: np.ndarray
    inverse: np.ndarray
    curved_nodes: np.ndarray
    curved_inverse: np.ndarray
    linear: Rows
    gradient: Rows
    coupling_rows: np.ndarray
    coupling: Rows
    momentum: Panels
    divergence: Rows
    poisson: Panels
    fixed: np.ndarray
    input_rows: np.ndarray
    input_profile: np.ndarray
    residual: Rows
    increment: Rows
    read_pressure: Rows
    wall: np.ndarray
    flux: np.ndarray
    scale: np.ndarray
    numbers: np.ndarray


@dataclass(frozen=True)
class Operators:
    """What `assemble` makes of a problem.

    velocity_order, pressure_order: numbers of scikit-fem's nodes in the solver's order: velocity nodes that are free,
    those that are read, other fixed ones. free: count of the free ones. inputs, functionals: their names in the order
    of amplitudes and of what a step gives. kinetic: (inputs,), as in `Problem`. sensors: name -> field and rows, acting
    on the solver's order.
    """

    mesh: Mesh
    tables: Tables
    velocity_order: np.ndarray
    pressure_order: np.ndarray
    free: int
    time_step: float
    inputs: tuple[str, ...]
    functionals: tuple[str, ...]
    kinetic: np.ndarray
    sensors: dict[str, tuple[str, Rows]]

    @cached_property
    def space(self) -> Space:
        """The finite-element spaces. Stepping needs none of it, so it is built when asked for and travels nowhere."""
        return spaces.build(self.mesh)

    @property
    def precision(self) -> type:
        """NumPy type of increments and residuals."""
        return self.tables.inverse.dtype.type

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "space"}

    @property
    def digest(self) -> str:
        """Hash of every number a step uses."""
        return disk.digest(flatten("tables", self.tables))


def flatten(name: str, part) -> dict[str, np.ndarray]:
    """Return the arrays of nested named tuples by dotted names."""
    if isinstance(part, np.ndarray):
        return {name: part}
    return {
        key: array for child in part._fields for key, array in flatten(f"{name}.{child}", getattr(part, child)).items()
    }


def assemble(
    problem: Problem,
    scheme: Scheme,
    time_step: float,
    viscosity: float,
    mean: np.ndarray | None = None,
    sensors: Sequence[Sensor] = (),
    precision: type = np.float32,
) -> Operators:
    """Assemble and factor the operators of a problem (docs/numerics.md, eq. 4-14).

    mean: (n, 2) velocity in scikit-fem's order that advects implicitly; ValueError where the scheme wants one and
    there is none. precision: of increments and residuals; the fields themselves are doubles always. float64 is for
    comparison.
    """
    space, dt, nu = problem.space, time_step, viscosity
    n, m = space.mass.shape[0], space.pressure_stiffness.shape[0]
    A = _momentum_matrix(problem, scheme, dt, nu, mean)
    read = np.flatnonzero(sum((f.phi.any(axis=1) for f in problem.functionals), np.zeros(n, bool)))

    free = np.setdiff1d(np.arange(n), problem.fixed)
    momentum, order = factors.factor(A[free][:, free])
    free = free[order]
    velocity_order = np.concatenate([free, read, np.setdiff1d(problem.fixed, read)])
    p_free = np.setdiff1d(np.arange(m), problem.pressure_fixed)
    poisson, order = factors.factor(space.pressure_stiffness[p_free][:, p_free])
    p_free = p_free[order]
    pressure_order = np.concatenate([p_free, problem.pressure_fixed])

    place = np.empty(n, int)
    place[velocity_order] = np.arange(n)
    to_fixed = sp.csr_matrix(A[free][:, velocity_order[len(free) :]])
    coupling_rows = np.flatnonzero(np.diff(to_fixed.indptr))
    to_fixed = factors.rows(to_fixed[coupling_rows])
    driven = np.flatnonzero(abs(problem.profiles).max(axis=(0, 2), initial=0.0)[velocity_order])
    acting = {
        **_elements(space, place),
        **_linear(space, scheme, dt, nu, velocity_order, pressure_order, len(free) + len(read)),
        "coupling_rows": coupling_rows.astype(np.uint32),
        "coupling": to_fixed._replace(column=to_fixed.column + np.uint32(len(free))),
        "momentum": momentum,
        "poisson": poisson,
    }
    tables = Tables(
        **{name: _rounded(part, precision) for name, part in acting.items()},
        divergence=factors.pair(*(-scheme.new / dt * B[p_free][:, velocity_order] for B in space.divergence)),
        fixed=problem.steady[velocity_order[len(free) :]],
        input_rows=driven.astype(np.uint32),
        input_profile=np.ascontiguousarray(problem.profiles[:, velocity_order[driven]]),
        **_readings(problem, A, nu, velocity_order, pressure_order),
        numbers=np.array([scheme.ahead, *scheme.pressure]),
    )
    return Operators(
        space.mesh,
        tables,
        velocity_order,
        pressure_order,
        len(free),
        dt,
        problem.inputs,
        tuple(functional.name for functional in problem.functionals),
        problem.kinetic,
        {sensor.name: (sensor.field, _sensor(space, sensor, velocity_order, pressure_order)) for sensor in sensors},
    )


def _momentum_matrix(problem: Problem, scheme: Scheme, dt: float, nu: float, mean: np.ndarray | None) -> sp.csr_matrix:
    """Return A (n, n) of eq. 9."""
    space = problem.space
    if scheme.mean and mean is None:
        raise ValueError(f"mean: got none, wanted the velocity (n, 2) that scheme {scheme.name!r} advects with")
    A = scheme.new / dt * space.mass + scheme.implicit * nu * space.stiffness + damping(problem, scheme, dt)
    if scheme.mean and mean is not None:
        A = sp.csr_matrix(A + spaces.advection(space, mean))
    return A


def _elements(space: Space, place: np.ndarray) -> dict[str, Any]:
    curved = space.curved
    # in the order of the solver's numbering of their nodes, for the cache's sake
    straight = np.argsort(np.median(place[space.nodes], axis=1), kind="stable")
    straight = straight[~np.isin(straight, curved)]
    return {
        "nodes": place[space.nodes[straight]].astype(np.uint32),
        "inverse": np.ascontiguousarray(space.inverse[straight, None]),
        "curved_nodes": place[space.nodes[curved]].astype(np.uint32),
        "curved_inverse": space.curved_inverse,
    }


def _linear(space: Space, scheme: Scheme, dt: float, nu: float, velocity_order, pressure_order, count: int) -> dict:
    """Return the rows of the linear terms, for the nodes whose residual is needed: the first `count`."""
    tested = velocity_order[:count]
    old = scheme.history[0] * scheme.ahead + scheme.history[1] * (scheme.ahead + 1)
    M, K = space.mass, space.stiffness
    return {
        "linear": factors.pair(-nu * K[tested][:, velocity_order], -old / dt * M[tested][:, velocity_order]),
        "gradient": factors.pair(*(B[:, tested][pressure_order].T for B in space.divergence)),
    }


def _readings(problem: Problem, A: sp.csr_matrix, nu: float, velocity_order, pressure_order) -> dict[str, Any]:
    """Return the rows of all functionals, and their constants."""
    found, (Bx, By) = problem.functionals, problem.space.divergence
    inputs = len(problem.profiles)

    def both(parts: list[np.ndarray]) -> Rows:
        """Return rows over nodes and components from fields (n, 2)."""
        flat = [part[velocity_order].ravel() for part in parts]
        return factors.rows(sp.csr_matrix(np.array(flat).reshape(len(parts), 2 * len(velocity_order))))

    pressure = np.array([(Bx @ f.phi[:, 0] + By @ f.phi[:, 1])[pressure_order] for f in found])
    return {
        "residual": both([f.phi for f in found]),
        "increment": both([np.stack([A.T @ f.phi[:, c] for c in range(2)], axis=1) for f in found]),
        "read_pressure": factors.rows(sp.csr_matrix(pressure.reshape(len(found), len(pressure_order)))),
        "wall": np.array([nu * f.wall for f in found]).reshape(len(found), inputs + 1),
        "flux": np.array([f.flux for f in found]).reshape(len(found), inputs, inputs),
        "scale": np.array([f.scale for f in found]),
    }


def _sensor(space: Space, sensor: Sensor, velocity_order, pressure_order) -> Rows:
    pressure = sensor.field == "pressure"
    basis, order = (space.pressure, pressure_order) if pressure else (space.velocity, velocity_order)
    return factors.rows(spaces.probe_matrix(basis, np.array(sensor.points).reshape(-1, 2))[:, order])


def _rounded(part, precision) -> Any:
    """Return an array or a named tuple of arrays with its numbers, not its indices, in the given precision."""
    if not isinstance(part, np.ndarray):
        return type(part)(*(_rounded(child, precision) for child in part))
    return part.astype(precision) if part.dtype == np.float64 else part


REACH = 2.0
"""How far `damping` reaches around a jet, in widths of the jet."""


def damping(problem: Problem, scheme: Scheme, time_step: float) -> sp.csr_matrix:
    """Return S (n, n), the stiffness for a viscosity that falls off around each jet as a Gaussian (eq. 15)."""

    def viscosity(x):
        total = 0.0 * x[0]
        for *centre, width, peak in problem.bells:
            distance = ((x[0] - centre[0]) ** 2 + (x[1] - centre[1]) ** 2) / (REACH * width) ** 2
            total = total + scheme.damping * time_step * peak**2 * np.exp(-distance)
        return total

    form = skfem.BilinearForm(lambda u, v, w: viscosity(w.x) * dot(grad(u), grad(v)))
    return sp.csr_matrix(form.assemble(problem.space.velocity))
