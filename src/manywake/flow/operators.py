"""Everything a time step multiplies with or solves by: assembled once per case and mesh, shared by all flows.

Inside, velocity nodes are renumbered: the free ones first, in the elimination order of the momentum matrix, then
those on Dirichlet boundaries; pressure nodes likewise. So the factors need no permutation while stepping.
"""

import zipfile
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np
import scipy.sparse as sp
import skfem
from skfem.helpers import dot, grad

from manywake.flow import disk, factors
from manywake.flow import space as spaces
from manywake.flow.case import FULL_RATE, Case
from manywake.flow.factors import Panels, Rows
from manywake.flow.mesh import Mesh
from manywake.flow.space import Space


class Tables(NamedTuple):
    """The arrays the compiled time loop reads, in the solver's order. Coefficients of the scheme stand in `numbers`.

    What acts on rounded fields is float32 as they are: elements, linear, gradient, coupling and factors.
    fixed: (nodes on Dirichlet boundaries, 2), their values without jets. force: columns and weights of A^T phi.
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
    jet_rows: np.ndarray
    jet_profile: np.ndarray
    force: Rows
    force_pressure: Rows
    jet_thrust: np.ndarray
    numbers: np.ndarray


@dataclass(frozen=True)
class Operators:
    """What `assemble` makes of a case and a mesh.

    velocity_order, pressure_order: numbers of scikit-fem's nodes in the solver's order: velocity nodes that are free,
    those of the body, other Dirichlet nodes. free: count of the free ones. jet_flux_error: relative flux error of each
    jet's interpolated profile before it is scaled to the exact flux. probe_pressure: (probes, m), probe_velocity:
    (probes, n), acting on the solver's order.
    """

    case: Case
    mesh: Mesh
    tables: Tables
    velocity_order: np.ndarray
    pressure_order: np.ndarray
    free: int
    jet_flux_error: np.ndarray
    probe_pressure: Rows
    probe_velocity: Rows

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
        return disk.digest(_flatten("tables", self.tables))


def _flatten(name: str, part) -> dict[str, np.ndarray]:
    """Return the arrays of nested named tuples by dotted names."""
    if isinstance(part, np.ndarray):
        return {name: part}
    return {
        key: array for child in part._fields for key, array in _flatten(f"{name}.{child}", getattr(part, child)).items()
    }


def _gather(name: str, kind, arrays) -> Any:
    """Return the nested named tuples of type `kind` from their arrays, as `_flatten` names them."""
    if kind is np.ndarray:
        return arrays[name]
    return kind(*(_gather(f"{name}.{child}", of, arrays) for child, of in get_type_hints(kind).items()))


_PLAIN = ("velocity_order", "pressure_order", "jet_flux_error")
_READINGS = ("probe_pressure", "probe_velocity")


def arrays(ops: Operators) -> dict[str, np.ndarray]:
    """Return every array of the operators by its dotted name."""
    named = _flatten("tables", ops.tables) | {name: getattr(ops, name) for name in _PLAIN}
    for name in _READINGS:
        named |= _flatten(name, getattr(ops, name))
    return named


def save(ops: Operators, path: Path) -> None:
    """Write operators, so that a run can go on with these very bits on any machine."""
    named: dict[str, Any] = {"free": np.array(ops.free), "digest": np.array(ops.digest), **arrays(ops)}
    disk.write(path, lambda file: np.savez(file, **named))


def load(path: Path, case: Case, mesh: Mesh) -> Operators:
    """Read operators of a case on a mesh; ValueError when the file is damaged."""
    try:
        with np.load(path, allow_pickle=False) as data:
            ops = Operators(
                case,
                mesh,
                _gather("tables", Tables, data),
                free=int(data["free"]),
                **{name: data[name] for name in _PLAIN},
                **{name: _gather(name, Rows, data) for name in _READINGS},
            )
            whole = ops.digest == str(data["digest"])
    except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, ValueError) as error:
        raise ValueError(f"operators: {path} is damaged ({error})") from error
    if not whole:
        raise ValueError(f"operators: the content of {path} does not match its hash")
    return ops


def assemble(case: Case, mesh: Mesh, mean: np.ndarray | None = None) -> Operators:
    """Assemble and factor the operators of `case` on `mesh` (docs/numerics.md, eq. 4-14).

    mean: (n, 2) velocity in scikit-fem's order that advects implicitly where the scheme wants one.
    """
    space = spaces.build(mesh)
    jet_names = [f"jet{i}" for i in range(len(case.jets))]
    body_names = ["cylinder", *jet_names]
    nodes_fixed = space.boundary_nodes(["wall", "inlet", *body_names])
    inflow = np.zeros_like(space.x)
    inlet = space.boundary_nodes(["inlet"])
    inflow[inlet, 0] = case.inflow(space.x[inlet, 1])
    profiles, flux_error, thrust = jet_profiles(case, space)
    return from_boundary_data(
        case,
        space,
        nodes_fixed,
        inflow,
        profiles,
        body=space.boundary_nodes(body_names),
        pressure_fixed=space.boundary_vertices("outlet"),
        jet_flux_error=flux_error,
        jet_thrust=thrust,
        mean=mean,
    )


def jet_profiles(case: Case, space: Space) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the velocity of each jet at unit flow rate, the flux error before scaling, and the thrust.

    profiles: (jets, n, 2), radial, cosine across the jet (eq. 12), scaled so that the flux through the jet's facets is
    exactly 1. thrust: (jets, 2), the integral of u (u . n).
    """
    profiles = np.zeros((len(case.jets), *space.x.shape))
    error, thrust = np.zeros(len(case.jets)), np.zeros((len(case.jets), 2))
    for i, jet in enumerate(case.jets):
        nodes = space.boundary_nodes([f"jet{i}"])
        theta0, w = np.radians(jet.angle), np.radians(jet.width)
        x = space.x[nodes]
        theta = np.angle(np.exp(1j * (np.arctan2(x[:, 1], x[:, 0]) - theta0)))
        shape = np.maximum(np.cos(np.pi * theta / w), 0.0) * np.pi / (2 * w * case.radius)
        shape[abs(abs(theta) - w / 2) < 1e-9] = 0.0
        profiles[i, nodes] = shape[:, None] * x / np.linalg.norm(x, axis=1)[:, None]
        flux, _ = boundary_flux(space, space.facets(f"jet{i}"), profiles[i])
        error[i] = flux - 1.0
        profiles[i] /= flux
        _, thrust[i] = boundary_flux(space, space.facets(f"jet{i}"), profiles[i])
    return profiles, error, thrust


def boundary_flux(space: Space, facets: np.ndarray, velocity: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the volume flux into the fluid through facets, and the integral of u (u . n), n out of the fluid."""
    basis = skfem.FacetBasis(space.velocity.mesh, skfem.ElementTriP2(), facets=facets, intorder=6)
    u = basis.interpolate(velocity[:, 0]), basis.interpolate(velocity[:, 1])
    normal = u[0] * basis.normals[0] + u[1] * basis.normals[1]
    momentum = np.array([np.sum(component * normal * basis.dx) for component in u])
    return -float(np.sum(normal * basis.dx)), momentum


def from_boundary_data(
    case: Case,
    space: Space,
    fixed: np.ndarray,
    steady: np.ndarray,
    profiles: np.ndarray,
    *,
    body: np.ndarray,
    pressure_fixed: np.ndarray,
    jet_flux_error: np.ndarray,
    jet_thrust: np.ndarray,
    mean: np.ndarray | None = None,
    precision: type = np.float32,
) -> Operators:
    """Assemble for any Dirichlet data of the form steady + sum over jets of Q_j(t) profile_j.

    fixed: velocity nodes with Dirichlet data. steady: (n, 2), profiles: (jets, n, 2), zero away from `fixed`.
    body: nodes whose momentum residual is the force. pressure_fixed: pressure nodes held at zero.
    mean: (n, 2) velocity that advects implicitly; ValueError where the scheme wants one and there is none.
    precision: of increments and residuals; the fields themselves are doubles always. float64 is for comparison.
    """
    scheme, dt, nu = case.scheme, case.time_step, case.viscosity
    n, m = space.mass.shape[0], space.pressure_stiffness.shape[0]
    M, K = space.mass, space.stiffness
    if scheme.mean and mean is None:
        raise ValueError(f"mean: got none, wanted the velocity (n, 2) that scheme {scheme.name!r} advects with")
    A = scheme.new / dt * M + scheme.implicit * nu * K + damping(case, space)
    if scheme.mean and mean is not None:
        A = sp.csr_matrix(A + spaces.advection(space, mean))

    free = np.setdiff1d(np.arange(n), fixed)
    momentum, order = factors.factor(A[free][:, free])
    free = free[order]
    velocity_order = np.concatenate([free, body, np.setdiff1d(fixed, body)])
    p_free = np.setdiff1d(np.arange(m), pressure_fixed)
    poisson, order = factors.factor(space.pressure_stiffness[p_free][:, p_free])
    p_free = p_free[order]
    pressure_order = np.concatenate([p_free, pressure_fixed])

    place = np.empty(n, int)
    place[velocity_order] = np.arange(n)
    Bx, By = space.divergence
    tested = velocity_order[: len(free) + len(body)]
    old = scheme.history[0] * scheme.ahead + scheme.history[1] * (scheme.ahead + 1)
    to_fixed = sp.csr_matrix(A[free][:, velocity_order[len(free) :]])
    coupling_rows = np.flatnonzero(np.diff(to_fixed.indptr))
    to_fixed = factors.rows(to_fixed[coupling_rows])
    jet_rows = np.flatnonzero(abs(profiles).max(axis=(0, 2), initial=0.0)[velocity_order])

    test = np.zeros(n)
    test[body] = 1.0
    curved = space.curved
    straight = _locality(space, place)
    straight = straight[~np.isin(straight, curved)]
    acting = {
        "nodes": place[space.nodes[straight]].astype(np.uint32),
        "inverse": np.ascontiguousarray(space.inverse[straight, None]),
        "curved_nodes": place[space.nodes[curved]].astype(np.uint32),
        "curved_inverse": space.curved_inverse,
        "linear": factors.pair(-nu * K[tested][:, velocity_order], -old / dt * M[tested][:, velocity_order]),
        "gradient": factors.pair(*(B[:, tested][pressure_order].T for B in (Bx, By))),
        "coupling_rows": coupling_rows.astype(np.uint32),
        "coupling": to_fixed._replace(column=to_fixed.column + np.uint32(len(free))),
        "momentum": momentum,
        "poisson": poisson,
    }
    tables = Tables(
        **{name: _rounded(part, precision) for name, part in acting.items()},
        divergence=factors.pair(*(-scheme.new / dt * B[p_free][:, velocity_order] for B in (Bx, By))),
        fixed=steady[velocity_order[len(free) :]],
        jet_rows=jet_rows.astype(np.uint32),
        jet_profile=np.ascontiguousarray(profiles[:, velocity_order[jet_rows]]),
        force=factors.rows(sp.csr_matrix((A.T @ test)[None, velocity_order])),
        force_pressure=factors.pair(*(sp.csr_matrix((B @ test)[None, pressure_order]) for B in (Bx, By))),
        jet_thrust=jet_thrust,
        numbers=np.array([scheme.ahead, *scheme.pressure, 2.0 / case.diameter]),
    )
    points = np.array(case.probes).reshape(-1, 2)
    return Operators(
        case,
        space.mesh,
        tables,
        velocity_order,
        pressure_order,
        len(free),
        jet_flux_error,
        factors.rows(spaces.probe_matrix(space.pressure, points)[:, pressure_order]),
        factors.rows(spaces.probe_matrix(space.velocity, points)[:, velocity_order]),
    )


def _rounded(part, precision) -> Any:
    """Return an array or a named tuple of arrays with its numbers, not its indices, in the given precision."""
    if not isinstance(part, np.ndarray):
        return type(part)(*(_rounded(child, precision) for child in part))
    return part.astype(precision) if part.dtype == np.float64 else part


REACH = 2.0
"""How far `damping` reaches around a jet, in widths of the jet."""


def damping(case: Case, space: Space) -> sp.csr_matrix:
    """Return S (n, n), the stiffness for a viscosity that falls off around each jet as a Gaussian (eq. 15)."""
    centres = [case.radius * np.array([np.cos(a), np.sin(a)]) for a in np.radians([jet.angle for jet in case.jets])]
    widths = [case.radius * np.radians(jet.width) for jet in case.jets]

    def viscosity(x):
        total = 0.0 * x[0]
        for centre, width in zip(centres, widths, strict=True):
            peak = np.pi * FULL_RATE / (2 * width)
            distance = ((x[0] - centre[0]) ** 2 + (x[1] - centre[1]) ** 2) / (REACH * width) ** 2
            total = total + case.scheme.damping * case.time_step * peak**2 * np.exp(-distance)
        return total

    form = skfem.BilinearForm(lambda u, v, w: viscosity(w.x) * dot(grad(u), grad(v)))
    return sp.csr_matrix(form.assemble(space.velocity))


def _locality(space: Space, place: np.ndarray) -> np.ndarray:
    """Return the order of elements that follows the solver's numbering of their nodes, for the cache's sake."""
    return np.argsort(np.median(place[space.nodes], axis=1), kind="stable")
