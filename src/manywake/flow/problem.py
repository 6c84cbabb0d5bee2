"""The posed problem: what holds on the boundary of a mesh, what drives it, and what is read from it."""

from dataclasses import dataclass, field

import numpy as np
import skfem

from manywake.case.case import Case
from manywake.case.conditions import Free, FreeSlip, Outflow
from manywake.case.geometry import Body, Side
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

    fixed: velocity nodes of given velocity, sorted. steady: (n, 2), profiles: (inputs, n, 2), zero elsewhere.
    pressure_fixed: pressure nodes held at zero. functionals: what is read, bodies first. inputs: their names.
    flux_error: relative error of each jet's interpolated flux before it was scaled. kinetic: (inputs,), flux of kinetic
    energy into the fluid at unit amplitude, as a coefficient 2P / (rho U^3 L). slip: velocity nodes, none of them
    fixed, where the component `held` is zero and the other free.
    """

    space: Space
    fixed: np.ndarray
    steady: np.ndarray
    pressure_fixed: np.ndarray
    functionals: tuple[Functional, ...]
    inputs: tuple[str, ...]
    profiles: np.ndarray
    flux_error: np.ndarray
    kinetic: np.ndarray
    slip: np.ndarray = field(default_factory=lambda: np.empty(0, int))
    held: int = 1


class Wall:
    """Integrals over facets of the boundary; n points out of the fluid."""

    def __init__(self, space: Space, facets: np.ndarray):
        self.basis = skfem.FacetBasis(space.velocity.mesh, skfem.ElementTriP2(), facets=facets, intorder=6)

    def field(self, nodal: np.ndarray) -> tuple:
        """Return both components of a field (n, 2) at the quadrature points, and its component along n."""
        u, v = (self.basis.interpolate(component) for component in nodal.T)
        return u, v, u * self.basis.normals[0] + v * self.basis.normals[1]

    def integral(self, values) -> float:
        return float(np.sum(values * self.basis.dx))

    def stretching(self, phi: np.ndarray, velocity: np.ndarray) -> float:
        """Return minus the integral of phi_i n_j d u_j / d x_i, for a velocity (n, 2) free of divergence.

        Of its slopes only that along the wall counts, D: this is minus the integral of phi . (e_z x D).
        """
        (x, y, _), (u, v, _), (nx, ny) = self.field(phi), self.field(velocity), self.basis.normals
        return self.integral(x * (nx * v.grad[1] - ny * v.grad[0]) - y * (nx * u.grad[1] - ny * u.grad[0]))


def pose(case: Case, mesh: Mesh) -> Problem:
    """Return the problem that a case states on a mesh."""
    space = spaces.build(mesh)
    bodies = [name for name in mesh.boundaries if case.body(name) is not None]
    given = [name for c in case.conditions if not isinstance(c, Free) for name in c.on]
    open_ends = [mesh.boundaries[name] for c in case.conditions if isinstance(c, Outflow) for name in c.on]
    pressure_fixed = np.unique(np.concatenate(open_ends)) if open_ends else np.array([0])
    steady = _steady(case, space)
    steady[space.boundary_nodes(bodies)] = 0.0
    fixed, inputs = space.boundary_nodes([*given, *bodies]), tuple(actuator.on for actuator in case.actuators)
    driven = profiles_of(case, space)
    slip, held = _slip(case, space)
    for velocity in (steady, *driven[0]):
        velocity[slip, held] = 0.0  # at the ends of slip sides too, where the rest is given
    functionals = _functionals(case, space, steady, driven[0])
    posed = fixed, steady, pressure_fixed, functionals, inputs, *driven
    return Problem(space, *posed, np.setdiff1d(slip, fixed), held)


def _slip(case: Case, space: Space) -> tuple[np.ndarray, int]:
    """Return the velocity nodes of all slip sides, ends included, and the component of the velocity through them."""
    names = [name for c in case.conditions if isinstance(c, FreeSlip) for name in c.on]
    nodes = space.boundary_nodes(names)
    if not names:
        return nodes, 1
    side = next(side for side in case.domain.sides() if side.name in names)
    return nodes, int(np.abs(np.subtract(side.end, side.start)).argmin())


def _steady(case: Case, space: Space) -> np.ndarray:
    """Return the velocity (n, 2) that the conditions give, the later one's where two meet."""
    steady = np.zeros_like(space.x)
    for condition in case.conditions:
        for side in case.domain.sides():
            if side.name in condition.on and not isinstance(condition, Free):
                nodes = _on_side(space, side)
                steady[nodes] = condition.velocity(side, space.x[nodes])
    return steady


def _on_side(space: Space, side: Side) -> np.ndarray:
    """Return the velocity nodes of one side; several sides may share a name."""
    nodes = space.boundary_nodes([side.name])
    chart, x = side.chart(space.x[nodes]), space.x[nodes] - np.array(side.start)
    off = abs((x * chart.outward).sum(axis=1))
    return nodes[(off < 1e-9 * chart.length) & (abs(chart.offset) < (0.5 + 1e-9) * chart.length)]


def _boundaries(mesh: Mesh, on: str) -> list[str]:
    """Return the boundaries that a name stands for: one piece, or a body with all its parts."""
    return [name for name in mesh.boundaries if on in (name, name.partition(".")[0])]


def profiles_of(case: Case, space: Space) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the velocity of each input at unit amplitude, the flux error of its jets before scaling, and `kinetic`.

    profiles: (inputs, n, 2), scaled so that the flux through the facets is the input's (docs/numerics.md, eq. 12).
    """
    profiles = np.zeros((len(case.actuators), *space.x.shape))
    error, kinetic = np.zeros((2, len(case.actuators)))
    for i, actuator in enumerate(case.actuators):
        names = _boundaries(space.mesh, actuator.on)
        nodes = space.boundary_nodes(names)
        x = space.x[nodes]
        profiles[i, nodes] = actuator.velocity(case.body(actuator.on), _chart(case, actuator.on, x), x)
        if actuator.flux is None:
            continue
        wall = Wall(space, space.facets(*names))
        share = -wall.integral(wall.field(profiles[i])[2]) / actuator.flux
        error[i] = share - 1.0
        profiles[i] /= share
        u, v, through = wall.field(profiles[i])
        kinetic[i] = -wall.integral((u**2 + v**2) * through) / (case.scales.velocity**3 * case.scales.length)
    return profiles, error, kinetic


def _chart(case: Case, name: str, x: np.ndarray):
    """Return where points (k, 2) of a side or of a part of a body are; None on a whole body."""
    body = case.body(name)
    if body is None:
        return _named(case.domain.sides(), name).chart(x)
    return None if name == body.name else body.chart(_named(body.pieces(), name), x)


def _named(pieces: list, name: str):
    return next(piece for piece in pieces if piece.name == name)


def boundary_flux(space: Space, facets: np.ndarray, velocity: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the volume flux into the fluid through facets, and the integral of u (u . n), n out of the fluid."""
    wall = Wall(space, facets)
    u, v, through = wall.field(velocity)
    return -wall.integral(through), np.array([wall.integral(u * through), wall.integral(v * through)])


def _functionals(case: Case, space: Space, steady: np.ndarray, profiles: np.ndarray) -> tuple[Functional, ...]:
    """Return drag, lift and torque of each body, then what each input meets."""
    speed, length, count = case.scales.velocity, case.scales.length, len(profiles)
    force, found = 2.0 / (speed**2 * length), []

    def stretching(names: list[str], phi: np.ndarray) -> np.ndarray:
        wall = Wall(space, space.facets(*names))
        return np.array([wall.stretching(phi, velocity) for velocity in (*profiles, steady)])

    for body in case.bodies:
        names = _boundaries(space.mesh, body.name)
        nodes = space.boundary_nodes(names)
        x, y = (space.x[nodes] - np.array(body.centre)).T
        phi = np.zeros((3, *space.x.shape))
        phi[0, nodes, 0] = phi[1, nodes, 1] = 1.0
        phi[2, nodes] = np.stack([-y, x], axis=1)
        flux = _momentum(case, space, body, profiles, phi[2])
        none = np.zeros(count + 1)  # phi is constant on a closed body: the gradient form has the whole force
        found += [
            Functional(f"c_d.{body.name}", phi[0], force, none, flux[0]),
            Functional(f"c_l.{body.name}", phi[1], force, none, flux[1]),
            Functional(f"c_m.{body.name}", phi[2], force / length, stretching(names, phi[2]), flux[2]),
        ]
    for actuator, profile in zip(case.actuators, profiles, strict=True):
        wall = stretching(_boundaries(space.mesh, actuator.on), profile)
        found.append(Functional(f"work.{actuator.on}", profile, -force / speed, wall, np.zeros((count, count))))
    return tuple(found)


def _momentum(case: Case, space: Space, body: Body, profiles: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return the integrals (3, inputs, inputs) of phi . g_j (g_k . n) over a body: along x, y, and with `turn`."""
    flux = np.zeros((3, len(profiles), len(profiles)))
    for k, actuator in enumerate(case.actuators):
        if actuator.flux is None or case.body(actuator.on) is not body:
            continue
        wall = Wall(space, space.facets(*_boundaries(space.mesh, actuator.on)))
        (x, y, _), (_, _, through) = wall.field(turn), wall.field(profiles[k])
        for j, profile in enumerate(profiles):
            u, v, _ = wall.field(profile)
            flux[:, j, k] = [wall.integral(part * through) for part in (u, v, x * u + y * v)]
    return flux
