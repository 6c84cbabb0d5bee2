"""The posed problem: what holds on the boundary of a mesh, what drives it, and what is read from it."""

from dataclasses import dataclass, field

import numpy as np
import skfem

from manywake.case.case import Case
from manywake.case.conditions import Free, FreeSlip, Outflow
from manywake.case.geometry import Body, Side
from manywake.case.inputs import BodyForce, Input
from manywake.case.sensors import Shear
from manywake.flow import space as spaces
from manywake.flow.mesh import Mesh
from manywake.flow.space import Space

LOAD_ORDER = 8
"""Degree to which a force inside the fluid is integrated exactly: a Gaussian is no polynomial."""


@dataclass(frozen=True)
class Functional:
    """A number read at every step: the traction on the boundary tested with phi (docs/numerics.md, eq. 14).

    phi: (n, 2), zero away from boundaries of given velocity. scale: makes it a coefficient. wall: (inputs + 1,), the
    part of the stress that the gradient form lacks, over the viscosity, at unit amplitude of each input and, last, of
    the steady boundary velocity. flux: (inputs, inputs), momentum that amplitudes j and k carry through the wall.
    load: (n, 2), whose product with the new velocity is added: a force inside the fluid, for its power, or what makes
    the shear on a wall; None for none.
    """

    name: str
    phi: np.ndarray
    scale: float
    wall: np.ndarray
    flux: np.ndarray
    load: np.ndarray | None = None


@dataclass(frozen=True)
class Problem:
    """Boundary data in scikit-fem's order: velocity = steady + the sum of amplitude_j profile_j on the fixed nodes.

    fixed: velocity nodes of given velocity, sorted. steady: (n, 2), profiles: (inputs, n, 2), zero elsewhere.
    pressure_fixed: pressure nodes held at zero. functionals: what is read, bodies first. inputs: their names, the
    agent's first. flux_error: relative error of each jet's interpolated flux before it was scaled. kinetic:
    (inputs, 3), flux of kinetic energy into the fluid as a coefficient 2P / (rho U^3 L), that of the amplitude, of its
    square and of its cube. loads: (inputs, n, 2), forces inside the fluid tested with every node's function, at unit
    amplitude; None for none. noise: rms, correlation time and limit of each disturbance, the last inputs. slip:
    velocity nodes, none of them fixed, where the component `held` is zero and the other free. open: scikit-fem's
    numbers of the facets of open ends.
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
    loads: np.ndarray | None = None
    noise: tuple[tuple[float, float, float], ...] = ()
    slip: np.ndarray = field(default_factory=lambda: np.empty(0, int))
    held: int = 1
    open: np.ndarray = field(default_factory=lambda: np.empty(0, int))


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
    open_ends = [name for c in case.conditions if isinstance(c, Outflow) for name in c.on]
    opened = space.facets(*open_ends) if open_ends else np.empty(0, int)
    pressure_fixed = np.unique(space.velocity.mesh.facets[:, opened]) if open_ends else np.array([0])
    steady = _steady(case, space)
    steady[space.boundary_nodes(bodies)] = 0.0
    fixed, inputs = space.boundary_nodes([*given, *bodies]), tuple(given.on for given in case.inputs)
    profiles, flux_error = profiles_of(case, space)
    loads = _loads(case, space)
    slip, held = _slip(case, space)
    for velocity in (steady, *profiles):
        velocity[slip, held] = 0.0  # at the ends of slip sides too, where the rest is given
    functionals = _functionals(case, space, steady, profiles, loads)
    driven = inputs, profiles, flux_error, _kinetic(case, space, steady, profiles)
    noise = tuple((noise.rms, noise.time, noise.by.limit) for noise in case.disturbances)
    posed = fixed, steady, pressure_fixed, functionals, *driven, loads, noise
    return Problem(space, *posed, np.setdiff1d(slip, fixed), held, opened)


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


def profiles_of(case: Case, space: Space) -> tuple[np.ndarray, np.ndarray]:
    """Return the velocity of each input at unit amplitude, and the flux error of the jets before scaling.

    profiles: (inputs, n, 2), scaled so that the flux through the facets is the input's (docs/numerics.md, eq. 12).
    """
    profiles, error = np.zeros((len(case.inputs), *space.x.shape)), np.zeros(len(case.inputs))
    for i, given in enumerate(case.inputs):
        if given.acts == "fluid":
            continue
        if (body := case.body(given.on)) is not None:
            nodes = space.boundary_nodes(_boundaries(space.mesh, given.on))
            x = space.x[nodes]
            profiles[i, nodes] = given.velocity(body, _chart(case, given.on, x), x)
        else:
            nodes, profiles[i] = _along_sides(case, space, given)
            if given.acts == "side":
                profiles[:i, nodes] = 0.0  # of two gusts on sides of one condition the later wins where they meet
        if given.flux is not None:
            wall = Wall(space, _facets(case, space, given))
            share = -wall.integral(wall.field(profiles[i])[2]) / given.flux
            error[i] = share - 1.0
            profiles[i] /= share
    return profiles, error


def _along_sides(case: Case, space: Space, given: Input) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes of an input's sides that no side of a later condition has, and its velocity there (n, 2)."""
    velocity, later = np.zeros_like(space.x), space.boundary_nodes(_winning(case, given.on))
    for side in case.domain.sides():
        if side.name == given.on:
            nodes = _on_side(space, side)
            velocity[nodes] = given.velocity(side, side.chart(space.x[nodes]), space.x[nodes])
    velocity[later] = 0.0
    return np.setdiff1d(space.boundary_nodes([given.on]), later), velocity


def _winning(case: Case, name: str) -> list[str]:
    """Return the sides whose velocity wins where one of them meets the named one: those of later conditions."""
    (mine,) = (k for k, condition in enumerate(case.conditions) if name in condition.on)
    later = [on for c in case.conditions[mine + 1 :] if not isinstance(c, Outflow) for on in c.on]
    return [on for on in later if case.body(on) is None]


def _facets(case: Case, space: Space, given: Input) -> np.ndarray:
    """Return the facets that an input of the boundary moves.

    The ends of a side of the domain are ends of its neighbours too, so those are all that have a given velocity.
    """
    if given.acts != "side":
        return space.facets(*_boundaries(space.mesh, given.on))
    held = {name for c in case.conditions if not isinstance(c, Outflow) for name in c.on}
    return space.facets(*(name for name in space.mesh.boundaries if name in held and case.body(name) is None))


def _kinetic(case: Case, space: Space, steady: np.ndarray, profiles: np.ndarray) -> np.ndarray:
    """Return what each input adds to the flux of kinetic energy into the fluid, as `Problem.kinetic`."""
    kinetic = np.zeros((len(case.inputs), 3))
    for i, given in enumerate(case.inputs):
        if given.acts in ("piece", "side"):
            wall = Wall(space, _facets(case, space, given))
            (u0, v0, through0), (u, v, through) = wall.field(steady), wall.field(profiles[i])
            squared = u0**2 + v0**2, 2 * (u0 * u + v0 * v), u**2 + v**2
            linear = squared[0] * through + squared[1] * through0
            for k, energy in enumerate((linear, squared[1] * through + squared[2] * through0, squared[2] * through)):
                kinetic[i, k] = -wall.integral(energy) / (case.scales.velocity**3 * case.scales.length)
    return kinetic


def _loads(case: Case, space: Space) -> np.ndarray | None:
    """Return the forces inside the fluid, (inputs, n, 2), as `Problem.loads`."""
    if all(given.acts != "fluid" for given in case.inputs):
        return None
    loads = np.zeros((len(case.inputs), *space.x.shape))
    basis = skfem.Basis(space.velocity.mesh, skfem.ElementTriP2(), intorder=LOAD_ORDER)
    x = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
    form = skfem.LinearForm(lambda v, w: w.force * v)
    for i, given in enumerate(case.inputs):
        if isinstance(given, BodyForce):
            force = given.force(x)
            loads[i] = np.stack([form.assemble(basis, force=force[..., c]) for c in range(2)], axis=1)
    return loads


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


def _functionals(
    case: Case, space: Space, steady: np.ndarray, profiles: np.ndarray, loads: np.ndarray | None
) -> tuple[Functional, ...]:
    """Return drag, lift and torque of each body, then what the agent's inputs meet, then the shear on walls."""
    speed, length, count = case.scales.velocity, case.scales.length, len(profiles)
    force, found = 2.0 / (speed**2 * length), []

    def stretching(facets: np.ndarray, phi: np.ndarray) -> np.ndarray:
        wall = Wall(space, facets)
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
            Functional(f"c_m.{body.name}", phi[2], force / length, stretching(space.facets(*names), phi[2]), flux[2]),
        ]
    none, unpushed = np.zeros(count + 1), np.zeros((count, count))
    for k, actuator in enumerate(case.actuators):
        name, scale = f"work.{actuator.on}", force / speed
        if loads is not None and actuator.acts == "fluid":
            found.append(Functional(name, np.zeros_like(space.x), scale, none, unpushed, loads[k]))
        else:
            wall = stretching(_facets(case, space, actuator), profiles[k])
            found.append(Functional(name, profiles[k], -scale, wall, unpushed))
    for sensor in case.sensors:
        if isinstance(sensor, Shear):
            slope = shear(space, space.facets(*_boundaries(space.mesh, sensor.on)))
            found.append(Functional(sensor.name, np.zeros_like(space.x), 1 / speed, none, unpushed, slope))
    return tuple(found)


def shear(space: Space, facets: np.ndarray) -> np.ndarray:
    """Return the (n, 2) whose product with a velocity is the integral over facets of its shear (`sensors.Shear`)."""
    wall = skfem.FacetBasis(space.velocity.mesh, skfem.ElementTriP2(), facets=facets, intorder=4)
    nx, ny = wall.normals  # out of the fluid; with the fluid on the left one walks along (-ny, nx)
    slope = skfem.LinearForm(lambda v, w: -w.along * (v.grad[0] * nx + v.grad[1] * ny))
    return np.stack([slope.assemble(wall, along=along) for along in (-ny, nx)], axis=1)


def _momentum(case: Case, space: Space, body: Body, profiles: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Return the integrals (3, inputs, inputs) of phi . g_j (g_k . n) over a body: along x, y, and with `turn`."""
    flux = np.zeros((3, len(profiles), len(profiles)))
    for k, given in enumerate(case.inputs):
        if given.flux is None or case.body(given.on) is not body:
            continue
        wall = Wall(space, _facets(case, space, given))
        (x, y, _), (_, _, through) = wall.field(turn), wall.field(profiles[k])
        for j, profile in enumerate(profiles):
            u, v, _ = wall.field(profile)
            flux[:, j, k] = [wall.integral(part * through) for part in (u, v, x * u + y * v)]
    return flux
