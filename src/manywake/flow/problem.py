"""The posed problem: what holds on the boundary of a mesh, what drives it, and what is read from it.

Made once, from case and mesh. Operators, steady flow, exact solutions and validation all take it.
"""

from dataclasses import dataclass, field

import numpy as np
import skfem

from manywake.case.case import Case
from manywake.case.conditions import Outflow
from manywake.case.geometry import Body
from manywake.case.inputs import Input, Jet
from manywake.flow import space as spaces
from manywake.flow.mesh import Mesh
from manywake.flow.space import Space


@dataclass(frozen=True)
class Functional:
    """A number read at every step: the traction on the boundary tested with phi (docs/numerics.md, eq. 14).

    phi: (n, 2), zero away from boundaries of given velocity. scale: makes it a coefficient. wall: (inputs + 1,), the
    part of the stress that the gradient form lacks, over the viscosity, at unit amplitude of each input and, last, of
    the steady boundary velocity. flux: (inputs, inputs), momentum that amplitudes j and k carry through the wall.
    """

    name: str
    phi: np.ndarray
    scale: float
    wall: np.ndarray
    flux: np.ndarray


@dataclass(frozen=True)
class Problem:
    """Boundary data in scikit-fem's order: velocity = steady + the sum of amplitude_j profile_j on the fixed nodes.

    fixed: velocity nodes of given velocity, sorted. steady: (n, 2), profiles: (inputs, n, 2), zero elsewhere. inputs:
    their names. pressure_fixed: pressure nodes held at zero. functionals: what is read, bodies first. bells: (jets, 4),
    centre, width and peak velocity of each jet at a flow rate of U L / 10, where `Scheme.damping` acts. flux_error:
    relative error of each jet's interpolated flux before it was scaled. kinetic: (inputs,), flux of kinetic energy into
    the fluid at unit amplitude, as a coefficient 2P / (rho U^3 L).
    """

    space: Space
    fixed: np.ndarray
    steady: np.ndarray
    inputs: tuple[str, ...]
    profiles: np.ndarray
    pressure_fixed: np.ndarray
    functionals: tuple[Functional, ...] = ()
    bells: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    flux_error: np.ndarray = field(default_factory=lambda: np.empty(0))
    kinetic: np.ndarray = field(default_factory=lambda: np.empty(0))


def pose(case: Case, mesh: Mesh) -> Problem:
    """Return the problem that a case states on a mesh."""
    space = spaces.build(mesh)
    of_bodies = [name for name in mesh.boundaries if case.body(name) is not None]
    held = [name for c in case.conditions if not isinstance(c, Outflow) for name in c.on]
    fixed = space.boundary_nodes([*held, *of_bodies])
    steady = _steady(case, space)
    steady[space.boundary_nodes(of_bodies)] = 0.0
    outlets = [name for c in case.conditions if isinstance(c, Outflow) for name in c.on]
    open_end = [space.boundary_vertices(name) for name in outlets]
    pressure_fixed = np.unique(np.concatenate(open_end)) if outlets else np.array([0])
    profiles, error, kinetic = profiles_of(case, space)
    return Problem(
        space,
        fixed,
        steady,
        tuple(actuator.on for actuator in case.actuators),
        profiles,
        pressure_fixed,
        _functionals(case, space, steady, profiles),
        _bells(case),
        error,
        kinetic,
    )


def _steady(case: Case, space: Space) -> np.ndarray:
    """Return the velocity (n, 2) that the conditions give, the later one's where two meet."""
    steady = np.zeros_like(space.x)
    for condition in case.conditions:
        if isinstance(condition, Outflow):
            continue
        for side in case.domain.sides():
            if side.name in condition.on:
                nodes = _on_side(space, side)
                steady[nodes] = condition.velocity(side, space.x[nodes])
    return steady


def _on_side(space: Space, side) -> np.ndarray:
    """Return the velocity nodes of one side; several sides may share a name."""
    nodes = space.boundary_nodes([side.name])
    chart, x = side.chart(space.x[nodes]), space.x[nodes] - np.array(side.start)
    off = abs((x * chart.outward).sum(axis=1))
    return nodes[(off < 1e-9 * chart.length) & (abs(chart.offset) < (0.5 + 1e-9) * chart.length)]


def pieces_of(case: Case, mesh: Mesh, actuator: Input) -> list[str]:
    """Return the boundaries that an input acts on: a piece, or a body with all its parts."""
    if case.body(actuator.on) is None or "." in actuator.on:
        return [actuator.on]
    return [name for name in mesh.boundaries if name.partition(".")[0] == actuator.on]


def profiles_of(case: Case, space: Space) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the velocity of each input at unit amplitude, the flux error of its jets before scaling, and `kinetic`.

    profiles: (inputs, n, 2), scaled so that the flux through the facets is the input's (docs/numerics.md, eq. 12).
    """
    profiles = np.zeros((len(case.actuators), *space.x.shape))
    error, kinetic = np.zeros(len(case.actuators)), np.zeros(len(case.actuators))
    for i, actuator in enumerate(case.actuators):
        names = pieces_of(case, space.mesh, actuator)
        nodes, body = space.boundary_nodes(names), case.body(actuator.on)
        profiles[i, nodes] = actuator.velocity(body, _chart(case, actuator.on, space.x[nodes]), space.x[nodes])
        if actuator.flux is None:
            continue
        facets = np.concatenate([space.facets(name) for name in names])
        flux, _ = boundary_flux(space, facets, profiles[i])
        error[i] = flux / actuator.flux - 1.0
        profiles[i] /= flux / actuator.flux
        basis = _facet_basis(space, facets)
        u = [np.asarray(basis.interpolate(profiles[i, :, c])) for c in range(2)]
        through = u[0] * basis.normals[0] + u[1] * basis.normals[1]
        energy = -0.5 * float(np.sum((u[0] ** 2 + u[1] ** 2) * through * basis.dx))
        kinetic[i] = 2.0 * energy / (case.scales.velocity**3 * case.scales.length)
    return profiles, error, kinetic


def _chart(case: Case, name: str, x: np.ndarray):
    body = case.body(name)
    if body is None:
        return next(side for side in case.domain.sides() if side.name == name).chart(x)
    piece = next((piece for piece in body.pieces() if piece.name == name and name != body.name), None)
    return None if piece is None else body.chart(piece, x)


def _facet_basis(space: Space, facets: np.ndarray) -> skfem.FacetBasis:
    return skfem.FacetBasis(space.velocity.mesh, skfem.ElementTriP2(), facets=facets, intorder=6)


def boundary_flux(space: Space, facets: np.ndarray, velocity: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the volume flux into the fluid through facets, and the integral of u (u . n), n out of the fluid."""
    basis = _facet_basis(space, facets)
    u = basis.interpolate(velocity[:, 0]), basis.interpolate(velocity[:, 1])
    normal = u[0] * basis.normals[0] + u[1] * basis.normals[1]
    momentum = np.array([np.sum(component * normal * basis.dx) for component in u])
    return -float(np.sum(normal * basis.dx)), momentum


def _functionals(case: Case, space: Space, steady: np.ndarray, profiles: np.ndarray) -> tuple[Functional, ...]:
    """Return drag, lift and torque of each body, then what each input meets."""
    length, speed, count = case.scales.length, case.scales.velocity, len(case.actuators)
    force = 2.0 / (speed**2 * length)
    found = []
    for body in case.bodies:
        names = [name for name in space.mesh.boundaries if name.partition(".")[0] == body.name]
        nodes, facets = space.boundary_nodes(names), np.concatenate([space.facets(name) for name in names])
        phi = np.zeros((3, *space.x.shape))
        phi[0, nodes, 0] = phi[1, nodes, 1] = 1.0
        phi[2, nodes] = _turned(space.x[nodes] - np.array(body.centre))
        flux = _momentum(case, space, body, profiles, phi[2])
        none = np.zeros(count + 1)  # phi is constant on a closed body: the gradient form has the whole force
        for k, name in enumerate(("c_d", "c_l")):
            found.append(Functional(f"{name}.{body.name}", phi[k], force, none, flux[k]))
        wall = _wall(space, facets, phi[2], steady, profiles)
        found.append(Functional(f"c_m.{body.name}", phi[2], force / length, wall, flux[2]))
    for actuator, profile in zip(case.actuators, profiles, strict=True):
        names = pieces_of(case, space.mesh, actuator)
        wall = _wall(space, np.concatenate([space.facets(name) for name in names]), profile, steady, profiles)
        name, scale = f"work.{actuator.on}", -force / speed
        found.append(Functional(name, profile, scale, wall, np.zeros((count, count))))
    return tuple(found)


def _turned(r: np.ndarray) -> np.ndarray:
    """Return e_z x r."""
    return np.stack([-r[:, 1], r[:, 0]], axis=1)


def _momentum(case: Case, space: Space, body: Body, profiles: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return the integrals (3, inputs, inputs) of phi . g_j (g_k . n) over a body: along x, y, and with `turn`."""
    count = len(case.actuators)
    flux = np.zeros((3, count, count))
    mine = [k for k, actuator in enumerate(case.actuators) if case.body(actuator.on) is body]
    for k in mine:
        if case.actuators[k].flux is None:
            continue
        facets = np.concatenate([space.facets(name) for name in pieces_of(case, space.mesh, case.actuators[k])])
        basis = _facet_basis(space, facets)
        g = [basis.interpolate(profiles[k, :, c]) for c in range(2)]
        through = g[0] * basis.normals[0] + g[1] * basis.normals[1]
        r = [basis.interpolate(turn[:, c]) for c in range(2)]
        for j in mine:
            u = [basis.interpolate(profiles[j, :, c]) for c in range(2)]
            for i, part in enumerate((u[0], u[1], r[0] * u[0] + r[1] * u[1])):
                flux[i, j, k] = np.sum(part * through * basis.dx)
    return flux


def _wall(space: Space, facets: np.ndarray, phi: np.ndarray, steady: np.ndarray, profiles: np.ndarray) -> np.ndarray:
    """Return minus the integral of phi_i n_j d u_j / d x_i for each boundary velocity (inputs + 1,).

    For a velocity free of divergence that is an integral of its derivative along the wall, D, alone: with the tangent
    t, of phi . (t (n . D) - n (t . D)).
    """
    basis = _facet_basis(space, facets)
    nx, ny = basis.normals
    tx, ty = -ny, nx
    f = [np.asarray(basis.interpolate(phi[:, c])) for c in range(2)]
    found = []
    for velocity in (*profiles, steady):
        slopes = [basis.interpolate(velocity[:, c]).grad for c in range(2)]
        along = [tx * slope[0] + ty * slope[1] for slope in slopes]
        through, stretch = nx * along[0] + ny * along[1], tx * along[0] + ty * along[1]
        found.append(-np.sum((f[0] * (tx * through - nx * stretch) + f[1] * (ty * through - ny * stretch)) * basis.dx))
    return np.array(found)


def _bells(case: Case) -> np.ndarray:
    """Return centre, width and peak velocity of each jet at a flow rate of U L / 10, (jets, 4)."""
    rate, rows = case.scales.velocity * case.scales.length / 10, []
    for actuator in case.actuators:
        body = case.body(actuator.on)
        if not isinstance(actuator, Jet):
            continue
        if body is None:
            side = next(side for side in case.domain.sides() if side.name == actuator.on)
            middle, width = 0.5 * (np.array(side.start) + side.end), side.chart(np.zeros((1, 2))).length
        else:
            piece = next(piece for piece in body.pieces() if piece.name == actuator.on)
            middle = body.point(np.array([0.5 * (piece.start + piece.end)]))[0]
            width = body.chart(piece, middle[None]).length
        rows.append([*middle, width, np.pi * rate / (2 * width)])
    return np.array(rows).reshape(-1, 4)
