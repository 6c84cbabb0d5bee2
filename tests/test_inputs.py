"""Inputs against exact solutions: gusts and moving walls, forces inside the fluid, jets on straight pieces; power."""

import dataclasses

import numpy as np
import pytest
import skfem

from manywake.case import (
    BDF2,
    BDF2_MEAN,
    GODA,
    BodyForce,
    Box,
    Case,
    Gust,
    Jet,
    NoSlip,
    Outflow,
    Outline,
    Parabola,
    Scales,
    Stream,
)
from manywake.flow import baseline, exact, operators, problem, readings
from manywake.flow import space as spaces
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.mesh import Mesh
from manywake.flow.operators import Operators
from manywake.flow.problem import Functional, Problem

from . import naive
from .test_readings import SQUARES, grid_mesh

SCHEMES = pytest.mark.parametrize("scheme", [BDF2, BDF2_MEAN], ids=lambda scheme: scheme.name)
UNIT = Box((0.0, 1.0), (0.0, 1.0))
SLOT = (0.25, 0.5)
FLOOR = ("floor", 0, 0), ("slot", SLOT[0], 0), ("floor", SLOT[1], 0)
WITH_SLOT = Outline((*FLOOR, ("rest", 1, 0), ("rest", 1, 1), ("rest", 0, 1)))


def unit_square(level: int, name=lambda side, middle: side) -> Mesh:
    """Return a mesh of the unit square; name(side, middle of a facet) is what a facet's boundary is called."""
    mesh, boundaries = exact.square(level), {}
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    for ends in edges[count == 1]:
        x, y = mesh.points[ends].mean(axis=0)
        off = {"left": x, "right": 1 - x, "bottom": y, "top": 1 - y}
        side = min(off, key=lambda side: abs(off[side]))
        boundaries.setdefault(name(side, (x, y)), []).append(ends)
    return Mesh(mesh.points, mesh.triangles, {name: np.array(facets) for name, facets in boundaries.items()})


def size(space, velocity: np.ndarray) -> float:
    """Return the L2 norm of a velocity (n, 2)."""
    return float(np.sqrt(np.sum(velocity * (space.mass @ velocity))))


def rate(coarse: float, fine: float) -> float:
    """Return the observed order between two errors, the second at half the size."""
    return float(np.log2(coarse / fine))


# ---- a box that moves as a whole: u = q(t), p = -q'(t) x

SWING = 9.0


def moving_box(time_step: float, scheme=BDF2, level=2) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Move all four walls by q = sin(9 t); return the largest errors of u and p, power, and what it should be."""
    case = Case(
        reynolds=20.0,
        domain=Outline((("wall", 0.0, 0.0), ("wall", 1.0, 0.0), ("wall", 1.0, 1.0), ("wall", 0.0, 1.0))),
        conditions=(NoSlip("wall"),),
        actuators=(Gust("wall", 1.0),),
        scheme=scheme,
        time_step=time_step,
    )
    posed = problem.pose(case, unit_square(level, lambda side, middle: "wall"))
    one, x = np.tile([1.0, 0.0], (len(posed.space.x), 1)), posed.space.mesh.points[:, 0]
    x = x - x[posed.pressure_fixed]
    t = time_step * np.arange(-2, round(0.24 / time_step) + 1)
    q, slope = np.sin(SWING * t), SWING * np.cos(SWING * t)
    p = [-slope[2 - k] * x for k in range(3)]
    ops = baseline.assemble(case, posed, 0.0 * one)
    flow = FlowBatch(ops, Start(q[2] * one, q[1] * one, p[0], p[0] - p[1], p[1] - p[2]), 1)
    amplitudes = q[3:, None, None]
    power = readings.named(ops, flow.advance(amplitudes), amplitudes)["power"][:, 0]
    state = flow.state(0)
    return abs(state.u - q[-1] * one).max(), abs(state.p + slope[-1] * x).max(), power, 2 * q[3:] * slope[3:]


@SCHEMES
def test_a_box_that_moves_as_a_whole_takes_its_fluid_along_at_order_2_in_time(scheme):
    # measured errors of u: 2.9e-3, 7.1e-4 of 1; of p: 1.0e-2, 2.4e-3 of 9; rates 2.0 and 2.1
    (u, p, _, _), (finer_u, finer_p, _, _) = (moving_box(dt, scheme) for dt in (6e-3, 3e-3))
    assert finer_u < 2e-3 and finer_p < 5e-3
    assert rate(u, finer_u) > 1.9
    assert rate(p, finer_p) > 1.9


def test_the_power_of_a_box_that_moves_is_what_its_fluid_gains_and_nothing_when_it_gives_back():
    _, _, power, gained = moving_box(1.5e-3)
    assert abs(power - np.maximum(gained, 0.0)).max() < 5e-4 * gained.max()  # measured 7e-5
    assert (power >= 0).all() and (power == 0).sum() > 0.2 * len(power)


# ---- a wall that swings above one at rest, over a shear that its steady motion makes: Stokes' second problem in a gap

SWINGS, SHEAR, VISCOSITY = 2 * np.pi, 0.7, 0.05
ROOT = np.sqrt(1j * SWINGS / VISCOSITY)


def layer(y: np.ndarray, t: float) -> np.ndarray:
    """Return the exact velocity (n, 2) at heights (n,)."""
    swinging = np.real(np.exp(1j * SWINGS * t) * np.sinh(ROOT * y) / np.sinh(ROOT))
    return np.stack([SHEAR * y + swinging, 0.0 * y], axis=1)


def swinging_wall(level: int, time_step: float, scheme=BDF2) -> tuple[float, float]:
    """Return the error of u (L2) at time 0.4, and the relative error of the power that the wall then needs."""
    case = Case(
        reynolds=1 / VISCOSITY,
        domain=UNIT,
        conditions=(NoSlip("bottom"), Stream("top", x=SHEAR), Outflow("left", "right")),
        actuators=(Gust("top", 1.0),),
        scheme=scheme,
        time_step=time_step,
    )
    # the exact flow comes in through an open end, without the traction that slows what does (eq. 23)
    posed = dataclasses.replace(problem.pose(case, unit_square(level)), open=np.empty(0, int))
    y, rest = posed.space.x[:, 1], np.zeros(len(posed.space.mesh.points))
    ops = baseline.assemble(case, posed, np.stack([SHEAR * y, 0.0 * y], axis=1))
    flow = FlowBatch(ops, Start(layer(y, 0.0), layer(y, -time_step), rest, rest, rest), 1)
    t = time_step * np.arange(1, round(0.4 / time_step) + 1)
    amplitudes = np.cos(SWINGS * t)[:, None, None]
    power = readings.named(ops, flow.advance(amplitudes), amplitudes)["power"][-1, 0]
    slope = SHEAR + np.real(np.exp(1j * SWINGS * t[-1]) * ROOT / np.tanh(ROOT))
    wanted = 2 * max(VISCOSITY * slope * np.cos(SWINGS * t[-1]), 0.0)
    return size(posed.space, flow.state(0).u - layer(y, t[-1])), abs(power / wanted - 1)


def test_a_wall_that_swings_drags_its_fluid_along_at_order_3_in_space():
    # measured 6.8e-4, 5.3e-5: rate 3.7, as the flow depends on one coordinate; power off by 3.0e-3, 1.8e-4
    (coarse, power), (fine, finer_power) = (swinging_wall(level, 1e-3) for level in (2, 3))
    assert fine < 1e-4
    assert rate(coarse, fine) > 2.9
    assert finer_power < 1e-3 and rate(power, finer_power) > 1.9


@SCHEMES
def test_a_wall_that_swings_drags_its_fluid_along_at_order_2_in_time(scheme):
    # the mesh's own error is 4e-6; measured 1.16e-4, 3.1e-5 with the mean, 3.1e-5, 9e-6 without
    step = 1e-2 if scheme.mean else 5e-3
    coarse, fine = (swinging_wall(4, dt, scheme)[0] for dt in (step, step / 2))
    assert rate(coarse, fine) > (1.85 if scheme.mean else 1.65)


# ---- corners


def walls(conditions, *gusts, domain=UNIT, level=1, name=lambda side, middle: side) -> tuple[Problem, dict]:
    """Return the problem of gusts on the unit square, and the profiles of each at its corners, by (x, y)."""
    posed = problem.pose(
        Case(reynolds=10.0, domain=domain, conditions=conditions, actuators=gusts), unit_square(level, name)
    )
    corner = {(x, y): int(abs(posed.space.x - (x, y)).sum(axis=1).argmin()) for x in (0, 1) for y in (0, 1)}
    return posed, {at: posed.profiles[:, node].tolist() for at, node in corner.items()}


def test_a_gust_ends_where_a_later_condition_begins_and_not_where_an_earlier_one_does():
    lid, still = Gust("top", 1.0), [[0.0, 0.0]]
    _, ends = walls((NoSlip("top"), NoSlip("left", "right", "bottom")), lid)
    assert ends == {(0, 0): still, (1, 0): still, (0, 1): still, (1, 1): still}
    _, ends = walls((NoSlip("left", "right", "bottom"), NoSlip("top")), lid)
    assert ends[0, 1] == ends[1, 1] == [[1.0, 0.0]]
    _, ends = walls((NoSlip("left"), NoSlip("top", "bottom"), NoSlip("right")), lid)
    assert (ends[0, 1], ends[1, 1]) == ([[1.0, 0.0]], still)
    # an open end gives no velocity, so it takes none
    _, ends = walls((NoSlip("top", "bottom"), Outflow("left", "right")), lid)
    assert ends[0, 1] == ends[1, 1] == [[1.0, 0.0]]


def test_of_two_gusts_under_one_condition_the_later_has_the_corner():
    across, along, still = Gust("left", 1.0, Stream(x=0.0, y=2.0)), Gust("top", 1.0), [0.0, 0.0]
    for given, at_corner in (((across, along), [still, [1.0, 0.0]]), ((along, across), [still, [0.0, 2.0]])):
        _, ends = walls((NoSlip("left", "right", "bottom", "top"),), *given)
        assert ends[0, 1] == at_corner


def test_a_gust_has_its_profile_on_its_side_alone():
    flow = (NoSlip("top", "bottom"), Parabola("left", mean=2.0), Outflow("right"))
    posed, _ = walls(flow, Gust("left", 0.5, Parabola(mean=1.0)), level=2)
    np.testing.assert_allclose(posed.profiles[0], 0.5 * posed.steady, atol=1e-15)
    assert abs(posed.profiles[0]).max() == 1.5
    (left,) = posed.profiles[:, posed.space.boundary_nodes(["left"])]
    assert np.count_nonzero(posed.profiles[0]) == np.count_nonzero(left)


def test_a_gust_acts_on_all_sides_of_its_name():
    posed, _ = walls(
        (NoSlip("rest", "slot"), NoSlip("floor")), Gust("floor", 1.0), domain=WITH_SLOT, level=3, name=segment
    )
    x, y = posed.space.x.T
    moves = (y == 0) & ((x <= SLOT[0]) | (x >= SLOT[1]))
    np.testing.assert_array_equal(posed.profiles[0], np.stack([1.0 * moves, 0.0 * moves], axis=1))


def segment(side: str, middle) -> str:
    if side != "bottom":
        return "rest"
    return "slot" if SLOT[0] < middle[0] < SLOT[1] else "floor"


def test_a_gust_at_an_inflow_brings_the_kinetic_energy_that_the_stream_had_not():
    # (1 + q)^3 - 1 through a height of 1
    case = Case(
        reynolds=10.0,
        scales=Scales(length=0.5, velocity=2.0),
        domain=UNIT,
        conditions=(NoSlip("bottom", "top"), Stream("left"), Outflow("right")),
        actuators=(Gust("left", 1.0),),
    )
    posed = problem.pose(case, unit_square(2))
    np.testing.assert_allclose(posed.kinetic, [[3 / 4, 3 / 4, 1 / 4]], rtol=1e-12)
    ops, amplitude = baseline.assemble(case, posed, posed.steady), 0.2
    read, q = np.zeros((1, len(ops.functionals), 1)), np.full((1, 1, 1), amplitude)
    assert readings.named(ops, read, q)["power"][0, 0] == pytest.approx(((1 + amplitude) ** 3 - 1) / 4)


# ---- jets on straight pieces


def assert_blows(posed: Problem, i: int, name: str, start, end, inwards):
    """Assert that jet i has flux 1, half a cosine between two points, and the direction `inwards`."""
    space, start, end = posed.space, np.array(start), np.array(end)
    flux, _ = problem.boundary_flux(space, space.facets(name), posed.profiles[i])
    assert flux == pytest.approx(1.0, abs=1e-13)
    width, along = np.linalg.norm(end - start), (end - start) / np.linalg.norm(end - start)
    offset = (space.x - 0.5 * (start + end)) @ along
    on = (abs((space.x - start) @ np.array(inwards)) < 1e-12) & (abs(offset) < 0.5 * width * (1 - 1e-9))
    speed = np.where(on, np.pi / (2 * width) * np.cos(np.pi * offset / width), 0.0) / (1 + posed.flux_error[i])
    np.testing.assert_allclose(posed.profiles[i], speed[:, None] * np.array(inwards), atol=1e-13 / width)
    assert on.sum() > 2
    assert abs(posed.flux_error[i]) < 0.05  # one facet a jet is off by 4 %


def test_a_jet_on_a_polygon_s_side_blows_its_flow_rate_out_of_that_side():
    posed, a, middle = problem.pose(SQUARES, grid_mesh()), 0.1, -0.3
    assert_blows(posed, 0, "front.high", (middle, a), (middle + a, a), (0.0, 1.0))
    assert_blows(posed, 1, "front.low", (middle, -a), (middle + a, -a), (0.0, -1.0))


def test_a_jet_on_a_side_of_the_domain_blows_its_flow_rate_into_it():
    case = Case(
        reynolds=10.0,
        domain=WITH_SLOT,
        conditions=(NoSlip("floor", "slot"), Outflow("rest")),
        actuators=(Jet("slot", 1.0),),
    )
    posed = problem.pose(case, unit_square(3, segment))
    assert_blows(posed, 0, "slot", (SLOT[0], 0.0), (SLOT[1], 0.0), (0.0, 1.0))
    whole = dataclasses.replace(
        case, domain=UNIT, conditions=(NoSlip("top", "left", "bottom"), Outflow("right")), actuators=(Jet("top", 1.0),)
    )
    assert_blows(problem.pose(whole, unit_square(3)), 0, "top", (1.0, 1.0), (0.0, 1.0), (0.0, -1.0))


# ---- forces inside the fluid: a swirl that they hold up, u = a(t) g(x), p = b(t) h(x), g = 0 on the walls

PI, VISCOUS, PULSE, END = np.pi, 0.05, 7.0, 0.128


def swirl(x: np.ndarray) -> list[np.ndarray]:
    """Return g, (g . grad) g, the Laplacian of g, and the slope of h = cos(pi x) cos(pi y), each (..., 2)."""
    X, Y = PI * x[..., 0], PI * x[..., 1]
    square_x, square_y, sine_x, sine_y = np.sin(X) ** 2, np.sin(Y) ** 2, np.sin(2 * X), np.sin(2 * Y)
    u, v = square_x * sine_y, -sine_x * square_y
    u_x, u_y = PI * sine_x * sine_y, 2 * PI * square_x * np.cos(2 * Y)
    v_x, v_y = -2 * PI * np.cos(2 * X) * square_y, -PI * sine_x * sine_y
    bent_u = 2 * PI**2 * np.cos(2 * X) * sine_y - 4 * PI**2 * square_x * sine_y
    bent_v = 4 * PI**2 * sine_x * square_y - 2 * PI**2 * sine_x * np.cos(2 * Y)
    h_x, h_y = -PI * np.sin(X) * np.cos(Y), -PI * np.cos(X) * np.sin(Y)
    pairs = (u, v), (u * u_x + v * u_y, u * v_x + v * v_y), (bent_u, bent_v), (h_x, h_y)
    return [np.stack(pair, axis=-1) for pair in pairs]


def bump(x: np.ndarray) -> np.ndarray:
    return np.cos(PI * x[..., 0]) * np.cos(PI * x[..., 1])


def strength(t):
    return 1.0 + 0.5 * np.sin(PULSE * t)


def quadrature(space) -> tuple[skfem.Basis, np.ndarray]:
    """Return a basis of high order and its points (e, q, 2)."""
    basis = skfem.Basis(space.velocity.mesh, skfem.ElementTriP2(), intorder=8)
    return basis, np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)


def held_up(level: int, time_step: float, scheme=BDF2) -> tuple[float, float]:
    """Step the swirl from exact data to END by a' g + a^2 (g . grad) g - nu a lap g + b grad h; return L2 errors."""
    dt, space = time_step, spaces.build(exact.square(level))
    (basis, x), form = quadrature(space), skfem.LinearForm(lambda v, w: w.f * v)
    loads = [[form.assemble(basis, f=force[..., c]) for c in range(2)] for force in swirl(x)]
    names, rest = ("inertia", "convection", "friction", "pressure"), np.zeros_like(space.x)
    posed = Problem(
        space=space,
        fixed=np.unique(space.velocity.get_dofs().all()),
        steady=rest,
        pressure_fixed=np.array([0]),
        functionals=(),
        inputs=names,
        profiles=np.zeros((4, *rest.shape)),
        flux_error=np.zeros(4),
        kinetic=np.zeros((4, 3)),
        loads=np.moveaxis(np.array(loads), 1, 2),
    )
    g, h = swirl(space.x)[0], bump(space.mesh.points) - bump(space.mesh.points[0])
    p = [np.cos(-PULSE * k * dt) * h for k in range(3)]
    ops = operators.assemble(posed, scheme, dt, VISCOUS, g)
    flow = FlowBatch(ops, Start(strength(0.0) * g, strength(-dt) * g, p[0], p[0] - p[1], p[1] - p[2]), 1)
    t = dt * np.arange(1, round(END / dt) + 1)
    slope, a = 0.5 * PULSE * np.cos(PULSE * t), strength(t)
    flow.advance(np.stack([slope, a**2, -VISCOUS * a, np.cos(PULSE * t)], axis=1)[:, :, None])
    state, wanted = flow.state(0), strength(END) * swirl(x)[0]
    off = [np.asarray(basis.interpolate(state.u[:, c])) - wanted[..., c] for c in range(2)]
    q = np.asarray(basis.with_element(skfem.ElementTriP1()).interpolate(state.p)) - np.cos(PULSE * END) * bump(x)
    q = q - np.sum(q * basis.dx) / np.sum(basis.dx)
    return tuple(float(np.sqrt(np.sum(squared * basis.dx))) for squared in (off[0] ** 2 + off[1] ** 2, q**2))


def test_a_swirl_that_forces_hold_up_converges_with_rate_3_and_its_pressure_with_2():
    # measured 4.7e-3, 5.9e-4 and 4.3e-3, 9.2e-4: rates 3.0 and 2.2
    (u, p), (finer_u, finer_p) = (held_up(level, 1e-3) for level in (2, 3))
    assert rate(u, finer_u) > 2.9
    assert rate(p, finer_p) > 1.9


@pytest.mark.parametrize("scheme", [BDF2, BDF2_MEAN, GODA], ids=lambda scheme: scheme.name)
def test_a_swirl_that_forces_hold_up_converges_with_the_order_of_the_scheme_in_time(scheme):
    # measured 2.26e-3, 5.9e-4 (both second-order schemes) and 3.8e-3, 1.4e-3; the mesh's own error is 7e-5
    (coarse, _), (fine, _) = (held_up(4, dt, scheme) for dt in (1.6e-2, 8e-3))
    assert rate(coarse, fine) > scheme.order - 0.1


# ---- a Gaussian force in a closed box

PUSH = BodyForce("push", 1.0, at=(0.55, 0.45), radius=0.08, along=(0.6, -0.8))
CLOSED = Case(
    reynolds=50.0, domain=UNIT, conditions=(NoSlip("left", "right", "bottom", "top"),), actuators=(PUSH,), scheme=BDF2
)


@pytest.fixture(scope="module")
def closed() -> Problem:
    """The box, with readings of the force on all its walls."""
    posed = problem.pose(CLOSED, unit_square(3))
    phi, count = np.zeros((2, *posed.space.x.shape)), len(posed.inputs)
    phi[0, posed.fixed, 0] = phi[1, posed.fixed, 1] = 1.0
    none = np.zeros(count + 1), np.zeros((count, count))
    on_walls = tuple(Functional(f"walls {c}", phi[c], 1.0, *none) for c in range(2))
    return dataclasses.replace(posed, functionals=(*posed.functionals, *on_walls))


@pytest.fixture(scope="module")
def boxed(closed) -> Operators:
    return baseline.assemble(CLOSED, closed, None)


def at_rest(ops: Operators) -> Start:
    return Start(*np.zeros((2, len(ops.velocity_order), 2)), *np.zeros((3, len(ops.pressure_order))))


def test_a_gaussian_force_is_where_and_as_large_as_it_says(closed):
    (load,), total = closed.loads, np.pi * PUSH.radius**2
    np.testing.assert_allclose(load.sum(axis=0), total * np.array(PUSH.along), rtol=1e-3)
    middle = (load * (closed.space.x @ [[1.0], [1.0]])).sum(axis=0) / load.sum(axis=0)
    np.testing.assert_allclose(middle, sum(PUSH.at), rtol=1e-3)


def test_the_momentum_that_a_fluid_gains_is_the_force_on_it_less_what_walls_take(closed):
    ops = baseline.assemble(CLOSED, closed, None, precision=np.float64)
    space, dt, (load,), (b1, b2) = closed.space, CLOSED.dt, closed.loads, BDF2.pressure
    flow, taken = FlowBatch(ops, at_rest(ops), 1), [ops.functionals.index(f"walls {c}") for c in range(2)]
    for q in 0.5 * np.sin(0.3 * np.arange(40)):
        old = flow.state(0)
        read, new = flow.advance(np.full((1, 1, 1), q))[0, taken, 0], flow.state(0)
        gained = (space.mass @ (1.5 * new.u - 2.0 * old.u + 0.5 * old.u_old)).sum(axis=0) / dt
        carried = naive.convection_form(space, 2.0 * old.u - old.u_old, 0.0).sum(axis=0)
        # walls are read with the new pressure, which the step knew as far as it could be extrapolated
        lacked = new.p - (old.p + b1 * old.phi + b2 * old.phi_old)
        late = np.array([(B.T @ lacked)[closed.fixed].sum() for B in space.divergence])
        np.testing.assert_allclose(gained + carried, q * load.sum(axis=0) - (read - late), atol=1e-13)
    assert abs(read).min() > 1e-4 and abs(gained).min() > 1e-5


def test_a_small_force_moves_a_fluid_at_rest_in_proportion_and_a_larger_one_does_not(boxed):
    q = np.array([1e-3, 2e-3, -1e-3, 10.0])
    flow = FlowBatch(boxed, at_rest(boxed), 4)
    flow.advance(np.broadcast_to(q, (40, 1, 4)))
    one, two, back, large = (flow.state(b).u for b in range(4))
    assert abs(one).max() > 1e-6
    assert abs(two - 2 * one).max() < 1e-3 * abs(one).max()
    assert abs(back + one).max() < 1e-3 * abs(one).max()
    assert abs(large - 1e4 * one).max() > 1e-2 * abs(large).max()


def test_the_power_of_a_force_is_the_energy_that_its_fluid_gains_and_dissipates(boxed, closed):
    space, nu = closed.space, CLOSED.viscosity
    flow, q, energy = FlowBatch(boxed, at_rest(boxed), 1), 0.8, []
    flow.advance(np.full((200, 1, 1), q))
    for _ in range(3):
        amplitudes = np.full((1, 1, 1), q)
        read = readings.named(boxed, flow.advance(amplitudes), amplitudes)
        u = flow.state(0).u
        energy.append((0.5 * size(space, u) ** 2, nu * np.sum(u * (space.stiffness @ u)), read["power"][0, 0]))
    (before, _, _), (_, lost, power), (after, _, last) = energy
    (load,) = closed.loads
    assert last == pytest.approx(2 * q * np.sum(load * u), rel=1e-12)
    gained = (after - before) / (2 * CLOSED.dt)
    assert min(lost, gained) > 0.02 * power
    assert power == pytest.approx(2 * (gained + lost), rel=1e-3)  # measured 2e-5
    # a force against the flow takes energy out, and is not credited
    against = np.full((1, 1, 1), -0.1)
    assert readings.named(boxed, flow.advance(against), against)["power"][0, 0] == 0.0


def test_a_case_without_a_force_has_no_row_for_one(ops):
    assert len(ops.tables.force_rows) == len(ops.tables.read_velocity.column) == 0


def test_only_nodes_that_a_force_reaches_are_pushed(boxed, closed):
    reached = np.zeros(len(closed.space.x), bool)
    reached[boxed.velocity_order[boxed.tables.force_rows]] = True
    distance = np.linalg.norm(closed.space.x - np.array(PUSH.at), axis=1)
    assert reached[distance < 4 * PUSH.radius].all()
    free = np.setdiff1d(np.arange(len(distance)), closed.fixed)
    assert not reached[free][distance[free] > 7 * PUSH.radius].any()


# ---- the names of inputs


def test_inputs_are_the_agent_s_first_and_power_is_theirs(closed):
    assert closed.inputs == ("push",)
    assert [f.name for f in closed.functionals] == ["work.push", "walls 0", "walls 1"]
    blown = dataclasses.replace(SQUARES, actuators=(Jet("back.high", 0.01), Jet("front.low", 0.01)))
    posed = problem.pose(blown, grid_mesh())
    assert posed.inputs == ("back.high", "front.low")
    assert [f.name for f in posed.functionals if f.name.startswith("work.")] == ["work.back.high", "work.front.low"]
