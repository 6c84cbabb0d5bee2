"""Everything a time step multiplies with or solves by: assembled once per case and mesh, shared by all flows.

Inside, velocity nodes are renumbered: the free ones first, in the elimination order of the momentum matrix (at its end
those that slip), then those of given velocity; pressure nodes likewise. So the factors need no permutation while
stepping.
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
from manywake.case.sensors import Energy, Probes, Sensor
from manywake.flow import factors, kernels
from manywake.flow import space as spaces
from manywake.flow.factors import Panels, Rows
from manywake.flow.mesh import Mesh
from manywake.flow.problem import Problem
from manywake.flow.space import Space
from manywake.machine import disk


class Tables(NamedTuple):
    """The arrays the compiled time loop reads, in the solver's order. Coefficients of the scheme stand in `numbers`.

    What acts on rounded fields is float32 as they are: elements, linear, gradient, coupling and factors.
    fixed: (nodes of given velocity, 2), their values at zero amplitude. slip: how many panels of `momentum` at its end
    are of nodes that slip, and which component is held there. residual, increment: rows of the functionals,
    whose columns count both components of a node, x first; of phi and of A^T phi. read_pressure: of B phi.
    read_velocity: of forces inside the fluid and of walls. wall, flux, scale: (functionals, ...), as in
    `problem.Functional`. still, energy: the steady velocity (n, 2), and rows of the mass matrix, for `kernels.energy`;
    empty where that is not read.
    open_nodes, open_normal: facets of open ends, as in `kernels.return_flow`.
    force_rows, force_loads: nodes that forces inside the fluid push, and how, (inputs, nodes, 2).
    """

    nodes: np.ndarray
    inverse: np.ndarray
    curved_nodes: np.ndarray
    curved_inverse: np.ndarray
    open_nodes: np.ndarray
    open_normal: np.ndarray
    linear: Rows
    gradient: Rows
    coupling_rows: np.ndarray
    coupling: Rows
    momentum: Panels
    slip: np.ndarray
    divergence: Rows
    poisson: Panels
    fixed: np.ndarray
    input_rows: np.ndarray
    input_profile: np.ndarray
    force_rows: np.ndarray
    force_loads: np.ndarray
    residual: Rows
    increment: Rows
    read_pressure: Rows
    read_velocity: Rows
    still: np.ndarray
    energy: Rows
    wall: np.ndarray
    flux: np.ndarray
    scale: np.ndarray
    numbers: np.ndarray


@dataclass(frozen=True)
class Operators:
    """What `assemble` makes of a problem.

    velocity_order, pressure_order: numbers of scikit-fem's nodes in the solver's order: velocity nodes that are free,
    those that are read, other fixed ones. free: count of the free ones, the last of which slip. inputs, functionals:
    their names in the order of amplitudes and of what a step gives, the energy last. kinetic: (inputs, 3), noise:
    (disturbances, 3), as in `Problem`. sensors: name -> field and rows of probes, acting on the solver's order.
    precision: of increments and residuals.
    digest: hash of every number a step uses.
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
    noise: np.ndarray
    sensors: dict[str, tuple[str, Rows]]

    @cached_property
    def space(self) -> Space:
        """The finite-element spaces. Stepping needs none of it, so it is built when asked for and travels nowhere."""
        return spaces.build(self.mesh)

    @property
    def slip(self) -> tuple[np.ndarray, int]:
        """The nodes that slip, in scikit-fem's numbers, and the component of their velocity that is zero."""
        panels, held = self.tables.slip
        first = self.tables.momentum.first
        return self.velocity_order[first[len(first) - 1 - panels] : self.free], int(held)

    @property
    def actuators(self) -> int:
        """How many of the inputs are the agent's: the first; the others are disturbances."""
        return len(self.inputs) - len(self.noise)

    @property
    def precision(self) -> type:
        return self.tables.inverse.dtype.type

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "space"}

    @property
    def digest(self) -> str:
        return disk.digest(flatten("tables", self.tables))


def flatten(name: str, part) -> dict[str, np.ndarray]:
    """Return the arrays of nested named tuples by dotted names."""
    if isinstance(part, np.ndarray):
        return {name: part}
    parts = [flatten(f"{name}.{child}", of) for child, of in part._asdict().items()]
    return {key: array for flat in parts for key, array in flat.items()}


def assemble(
    problem: Problem,
    scheme: Scheme,
    time_step: float,
    viscosity: float,
    mean: np.ndarray | None = None,
    fluctuation: np.ndarray | None = None,
    sensors: Sequence[Sensor] = (),
    still: np.ndarray | None = None,
    precision: type = np.float32,
) -> Operators:
    """Assemble and factor the operators of a problem (docs/numerics.md, eq. 4-14).

    mean: (n, 2) velocity in scikit-fem's order that advects implicitly; ValueError where the scheme wants one and there
    is none. fluctuation: (n,) largest departure from the mean, by which the scheme damps; none: it does not. still:
    (n, 2) velocity of the steady flow, for the sensor that is about it. precision: of increments and residuals, float64
    for comparison; the fields are doubles always.
    """
    space, dt, nu = problem.space, time_step, viscosity
    n, m = len(space.x), len(space.mesh.points)
    A = _momentum_matrix(space, scheme, dt, nu, mean) + damping(space, scheme, dt, fluctuation)
    inside = np.setdiff1d(np.arange(n), np.concatenate([problem.fixed, problem.slip]))
    momentum, free = _factor(A, np.concatenate([inside, problem.slip]), len(problem.slip))
    slipping = np.count_nonzero(momentum.first[:-1] >= len(free) - len(problem.slip))
    read = np.flatnonzero(sum((f.phi.any(axis=1) for f in problem.functionals), np.zeros(n, bool)))
    velocity = np.concatenate([free, read, np.setdiff1d(problem.fixed, read)])
    poisson, p_free = _factor(space.pressure_stiffness, np.setdiff1d(np.arange(m), problem.pressure_fixed))
    pressure = np.concatenate([p_free, problem.pressure_fixed])

    to_fixed = sp.csr_matrix(A[free][:, velocity[len(free) :]])
    coupling_rows = np.flatnonzero(np.diff(to_fixed.indptr))
    coupling = factors.rows(to_fixed[coupling_rows])
    driven = np.flatnonzero(abs(problem.profiles).max(axis=(0, 2), initial=0.0)[velocity])
    place = np.argsort(velocity)
    acting = {
        **_elements(space, place),
        **_open_ends(problem, place),
        **_linear(space, scheme, dt, nu, velocity, pressure, len(free) + len(read)),
        "coupling_rows": coupling_rows.astype(np.uint32),
        "coupling": coupling._replace(column=coupling.column + np.uint32(len(free))),
        "momentum": momentum,
        "poisson": poisson,
        **_energy(space, sensors, still, velocity),
    }
    tables = Tables(
        **{name: part if name == "still" else _rounded(part, precision) for name, part in acting.items()},
        slip=np.array([slipping, problem.held], np.uint32),
        divergence=factors.pair(*(-scheme.new / dt * B[p_free][:, velocity] for B in space.divergence)),
        fixed=problem.steady[velocity[len(free) :]],
        input_rows=driven.astype(np.uint32),
        input_profile=np.ascontiguousarray(problem.profiles[:, velocity[driven]]),
        **_forces(problem, velocity[: len(free) + len(read)]),
        **_readings(problem, A, nu, velocity, pressure),
        numbers=np.array([scheme.ahead, *scheme.pressure]),
    )
    energies = [sensor.name for sensor in sensors if isinstance(sensor, Energy)]
    names = problem.inputs, (*(functional.name for functional in problem.functionals), *energies)
    probes = {s.name: _sensor(space, s, velocity, pressure) for s in sensors if isinstance(s, Probes)}
    by_input = problem.kinetic, np.array(problem.noise).reshape(-1, 3)
    return Operators(space.mesh, tables, velocity, pressure, len(free), dt, *names, *by_input, probes)


def _momentum_matrix(space: Space, scheme: Scheme, dt: float, nu: float, mean: np.ndarray | None) -> sp.csr_matrix:
    """Return A (n, n) of eq. 9, without damping."""
    A = scheme.new / dt * space.mass + scheme.implicit * nu * space.stiffness
    if not scheme.mean:
        return A
    if mean is None:
        raise ValueError(f"mean: got none, wanted the velocity (n, 2) that scheme {scheme.name!r} advects with")
    return sp.csr_matrix(A + spaces.clean(spaces.advection(space, mean)))


def _factor(matrix: sp.csr_matrix, free: np.ndarray, last: int = 0) -> tuple[Panels, np.ndarray]:
    """Return the factors of a matrix among free nodes, and those in the order of elimination; the last ones stay so."""
    panels, order = factors.factor(matrix[free][:, free], last)
    return panels, free[order]


def _elements(space: Space, place: np.ndarray) -> dict[str, Any]:
    """Return the elements' nodes and maps; place: (n,), where scikit-fem's nodes are in the solver's order."""
    # in the order of the solver's numbering of their nodes, for the cache's sake
    straight = np.argsort(np.median(place[space.nodes], axis=1), kind="stable")
    straight = straight[~np.isin(straight, space.curved)]
    return {
        "nodes": place[space.nodes[straight]].astype(np.uint32),
        "inverse": np.ascontiguousarray(space.inverse[straight, None]),
        "curved_nodes": place[space.nodes[space.curved]].astype(np.uint32),
        "curved_inverse": space.curved_inverse,
    }


def _open_ends(problem: Problem, place: np.ndarray) -> dict[str, Any]:
    """Return the facets of open ends, and their normals out of the fluid times the weights of the rule on them."""
    space, facets, mesh = problem.space, problem.open, problem.space.velocity.mesh
    nodes = np.vstack([mesh.facets[:, facets], space.velocity.facet_dofs[:, facets]]).T
    ends = space.x[nodes]
    along = kernels.FACET_SLOPE @ ends
    normal = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    inside = space.x[mesh.t[:, mesh.f2t[0, facets]]].mean(axis=0)
    outwards = np.sign(((ends[:, 2] - inside)[:, None] * normal).sum(axis=2, keepdims=True))
    return {
        "open_nodes": place[nodes].astype(np.uint32),
        "open_normal": outwards * normal * kernels.FACET_WEIGHT[:, None],
    }


def _linear(space: Space, scheme: Scheme, dt: float, nu: float, velocity, pressure, count: int) -> dict[str, Any]:
    """Return the rows of the linear terms, for the nodes whose residual is needed: the first `count`."""
    tested = velocity[:count]
    old = scheme.history[0] * scheme.ahead + scheme.history[1] * (scheme.ahead + 1)
    K, M = (matrix[tested][:, velocity] for matrix in (space.stiffness, space.mass))
    gradient = factors.pair(*(B[:, tested][pressure].T for B in space.divergence))
    return {"linear": factors.pair(-nu * K, -old / dt * M), "gradient": gradient}


NEGLIGIBLE = 1e-12
"""Share of the largest entry of a load below which a node is not pushed."""


def _forces(problem: Problem, tested: np.ndarray) -> dict[str, Any]:
    """Return the rows that forces inside the fluid push, of the nodes whose residual is needed, and their loads."""
    if problem.loads is None:
        return {"force_rows": np.zeros(0, np.uint32), "force_loads": np.zeros((len(problem.inputs), 0, 2))}
    size = abs(problem.loads)
    pushed = (size > NEGLIGIBLE * size.max(axis=(1, 2), keepdims=True)).any(axis=(0, 2))[tested]
    loads = np.ascontiguousarray(problem.loads[:, tested[pushed]])
    return {"force_rows": np.flatnonzero(pushed).astype(np.uint32), "force_loads": loads}


def _readings(problem: Problem, A: sp.csr_matrix, nu: float, velocity, pressure) -> dict[str, Any]:
    """Return the rows of all functionals, and their constants."""
    found, (Bx, By), inputs = problem.functionals, problem.space.divergence, len(problem.profiles)

    def rows(fields: list[np.ndarray], order: np.ndarray) -> Rows:
        """Return rows over nodes, and components of these, from fields (n,) or (n, 2)."""
        flat = [field[order].ravel() for field in fields]
        return factors.rows(sp.csr_matrix(np.array(flat).reshape(len(fields), -1 if fields else len(order))))

    still = np.zeros_like(problem.space.x)
    loads = np.array([still if f.load is None else f.load for f in found]).reshape(len(found), *still.shape)
    moved = (sp.csr_matrix(loads[:, velocity, c]) for c in range(2))
    return {
        "residual": rows([f.phi for f in found], velocity),
        "increment": rows([A.T @ f.phi for f in found], velocity),
        "read_pressure": rows([Bx @ f.phi[:, 0] + By @ f.phi[:, 1] for f in found], pressure),
        "read_velocity": factors.pair(*moved),
        "wall": np.array([nu * f.wall for f in found]).reshape(len(found), inputs + 1),
        "flux": np.array([f.flux for f in found]).reshape(len(found), inputs, inputs),
        "scale": np.array([f.scale for f in found]),
    }


def _energy(space: Space, sensors: Sequence[Sensor], still: np.ndarray | None, velocity) -> dict[str, Any]:
    """Return the steady velocity, and the half of the mass matrix that makes an energy; empty without that sensor."""
    names = [sensor.name for sensor in sensors if isinstance(sensor, Energy)]
    if not names:
        return {"still": np.zeros((0, 2)), "energy": factors.rows(sp.csr_matrix((0, len(velocity))))}
    if still is None:
        raise ValueError(f"still: got none, wanted the steady velocity (n, 2) that the sensor {names[0]!r} is about")
    M = space.mass[velocity][:, velocity]
    return {"still": still[velocity], "energy": factors.rows(sp.triu(M, 1) + 0.5 * sp.diags(M.diagonal()))}


def _sensor(space: Space, sensor: Probes, velocity, pressure) -> tuple[str, Rows]:
    basis, order = (space.pressure, pressure) if sensor.field == "pressure" else (space.velocity, velocity)
    matrix = spaces.probe_matrix(basis, np.array(sensor.points).reshape(-1, 2))
    return sensor.field, factors.rows(matrix[:, order])


def _rounded(part, precision) -> Any:
    """Return an array or a named tuple of arrays with its numbers, not its indices, in the given precision."""
    if not isinstance(part, np.ndarray):
        return type(part)(*(_rounded(child, precision) for child in part))
    return part.astype(precision) if part.dtype == np.float64 else part


LOW, HIGH = 0.15, 0.25
"""Damping sets in where the fluctuation crosses this share of a triangle in a time step, and is whole at that."""


def damping(space: Space, scheme: Scheme, time_step: float, fluctuation: np.ndarray | None) -> sp.csr_matrix:
    """Return S (n, n), the stiffness for a viscosity where the fluctuation V (n,) is too fast for the step (eq. 15)."""
    if fluctuation is None or not scheme.damping:
        return sp.csr_matrix((len(space.x), len(space.x)))
    V = np.asarray(space.velocity.interpolate(fluctuation))
    h = np.sqrt(2 * space.velocity.dx.sum(axis=1))[:, None]
    w = np.clip((V * time_step / h - LOW) / (HIGH - LOW), 0.0, 1.0)
    viscosity = scheme.damping * time_step * V**2 * w**2 * (3 - 2 * w)
    form = skfem.BilinearForm(lambda u, v, at: at.viscosity * dot(grad(u), grad(v)))
    return sp.csr_matrix(form.assemble(space.velocity, viscosity=viscosity))
