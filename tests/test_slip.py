"""Free slip: exact flows between slip sides, half a symmetric flow and the whole, corners, and starts."""

import dataclasses

import numpy as np
import pytest
import skfem

from manywake.case import BDF2, BDF2_MEAN, Box, Case, Circle, FreeSlip, Jet, NoSlip, Outflow, Parabola, Stream
from manywake.flow import archive, baseline, exact, forced, operators, problem, spinup, steady
from manywake.flow import mesh as meshes
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.mesh import Mesh

from .conftest import TINY, in_doubles, in_singles, tiny_mesh
from .test_kernels import steps_by_width

# ---- a vortex that drifts along two slip sides

SPEED = 1.0
STRIP = Case(
    reynolds=1 / exact.VISCOSITY,
    domain=Box(x=(0.0, 1.0), y=(0.25, 0.75)),
    conditions=(FreeSlip("bottom", "top"), Stream("left", "right", x=SPEED)),
)
"""On y = 1/4 and 3/4 the vortex of flow/exact.py has no v and no du/dy when it drifts along x alone."""


def rectangle(domain: Box, level: int) -> Mesh:
    """Return a box in 8 triangles, none with two sides on the boundary, `level` times cut into four."""
    made = skfem.MeshTri.init_sqsymmetric().refined(level)
    (x0, x1), (y0, y1) = domain.x, domain.y
    points, facets = made.p.T * [x1 - x0, y1 - y0] + [x0, y0], made.facets.T[made.boundary_facets()]
    x, y = points[facets].mean(axis=1).T
    on = {"left": x - x0, "right": x - x1, "bottom": y - y0, "top": y - y1}
    boundaries = {name: facets[abs(off) < 1e-9] for name, off in on.items()}
    return Mesh(points, made.t.T.astype(np.int64), boundaries)


def vortex(x, t):
    """Return the exact velocity (n, 2) and pressure (n,) at points (n, 2)."""
    (X, Y), decay = exact.K * (x - [SPEED * t, 0.0]).T, np.exp(-2 * exact.VISCOSITY * exact.K**2 * t)
    u = np.stack([SPEED - decay * np.cos(X) * np.sin(Y), decay * np.sin(X) * np.cos(Y)], axis=1)
    return u, -0.25 * decay**2 * (np.cos(2 * X) + np.cos(2 * Y))


def drifted(level, dt, scheme):
    """Step the vortex from exact data at time 0 to exact.DURATION; return the operators and the last state.

    Left and right are driven by the vortex: cos and sin of K c t times the fields that `exact.profiles` has for them.
    """
    posed = problem.pose(STRIP, rectangle(STRIP.domain, level))
    x, fixed = posed.space.x, posed.fixed
    profiles = np.zeros((2, len(x), 2))
    profiles[:, fixed] = exact.profiles(x[fixed])[[0, 2]]
    none = np.zeros(2)
    driven = {"inputs": ("cos", "sin"), "profiles": profiles, "flux_error": none, "kinetic": none}
    posed = dataclasses.replace(posed, **driven)
    ops = operators.assemble(posed, scheme, dt, exact.VISCOSITY, np.tile([SPEED, 0.0], (len(x), 1)))
    (u, _), (u_old, _) = vortex(x, 0.0), vortex(x, -dt)
    for part in (u, u_old):
        part[ops.slip] = 0.0
    p = [vortex(posed.space.mesh.points, -k * dt)[1] for k in range(3)]
    p = [q - q[0] for q in p]
    flow = FlowBatch(ops, Start(u, u_old, p[0], p[0] - p[1], p[1] - p[2]), 1)
    t = dt * np.arange(1, round(exact.DURATION / dt) + 1)
    waves = np.exp(-2 * exact.VISCOSITY * exact.K**2 * t) * [np.cos(exact.K * SPEED * t), np.sin(exact.K * SPEED * t)]
    flow.advance(waves.T[:, :, None])
    return ops, flow.state(0)


def l2_errors(ops, state):
    """Return the L2 errors of velocity and pressure, of which a constant is free."""
    basis = skfem.Basis(ops.space.velocity.mesh, skfem.ElementTriP2(), intorder=8)
    points, weight = np.asarray(basis.global_coordinates()).reshape(2, -1).T, basis.dx
    u, p = vortex(points, exact.DURATION)
    off = [np.asarray(basis.interpolate(state.u[:, c])) - u[:, c].reshape(weight.shape) for c in range(2)]
    q = np.asarray(basis.with_element(skfem.ElementTriP1()).interpolate(state.p)) - p.reshape(weight.shape)
    q = q - np.sum(q * weight) / np.sum(weight)
    return np.sqrt(np.sum((off[0] ** 2 + off[1] ** 2) * weight)), np.sqrt(np.sum(q**2 * weight))


def test_velocity_converges_with_rate_3_and_pressure_with_2_along_slip_sides():
    (u0, p0), (u1, p1) = (l2_errors(*drifted(level, 3e-4, BDF2)) for level in (3, 4))
    assert u1 < 1e-4
    assert np.log2(u0 / u1) > 2.9
    assert np.log2(p0 / p1) > 1.9


@pytest.mark.parametrize("scheme", [BDF2, BDF2_MEAN], ids=lambda scheme: scheme.name)
def test_velocity_converges_with_rate_2_in_time_along_slip_sides(scheme):
    runs = [drifted(3, 6e-4 / 2**k, scheme) for k in range(3)]
    mass, (a, b, c) = runs[0][0].space.mass, (state.u for _, state in runs)
    first, second = (float(np.sum(d * (mass @ d))) ** 0.5 for d in (a - b, b - c))
    assert np.log2(first / second) > 1.9


def test_nothing_flows_through_a_slip_side():
    ops, state = drifted(3, 6e-4, BDF2)
    nodes, held = ops.slip
    assert held == 1 and len(nodes) > 20
    assert not state.u[nodes, 1].any()
    assert abs(state.u[nodes, 0]).min() > 0.0
    for side in ("bottom", "top"):
        assert problem.boundary_flux(ops.space, ops.space.facets(side), state.u)[0] == pytest.approx(0.0, abs=1e-15)


# ---- a stream that slips on both sides stays as it is


@pytest.mark.parametrize(("assemble", "bound"), [(in_doubles, 1e-13), (in_singles, 1e-6)], ids=["doubles", "singles"])
def test_plug_flow_is_exact_to_rounding(assemble, bound):
    chosen = dataclasses.replace(
        STRIP, conditions=(FreeSlip("bottom", "top"), Stream("left", x=1.0), Outflow("right")), scheme=BDF2
    )
    ops = assemble(chosen, rectangle(chosen.domain, 2))
    u, p = np.tile([1.0, 0.0], (len(ops.velocity_order), 1)), np.zeros((3, len(ops.pressure_order)))
    flow = FlowBatch(ops, Start(u, u, *p), 1)
    flow.advance(np.zeros((100, 0, 1)))
    assert abs(flow.state(0).u - u).max() < bound
    assert abs(flow.state(0).p).max() < bound
    found = steady.solve(chosen, problem.pose(chosen, ops.mesh))
    np.testing.assert_allclose(found.u, u, atol=1e-12)
    np.testing.assert_allclose(found.p, 0.0, atol=1e-12)


# ---- half of a symmetric flow is the half of the whole


HALF = dataclasses.replace(
    TINY,
    reynolds=40,
    conditions=(FreeSlip("bottom"), NoSlip("top"), Stream("left", x=1.0), Outflow("right")),
)
"""A cylinder between a wall, at y = 0.21, and a line of symmetry, at y = -0.2."""
MIRRORED = Circle("mirrored", (0.0, -0.4), 0.05, parts={"top": (265, 275), "bottom": (85, 95)})
WHOLE = dataclasses.replace(
    HALF,
    domain=Box(x=HALF.domain.x, y=(-0.61, 0.21)),
    bodies=(*HALF.bodies, MIRRORED),
    actuators=(*HALF.actuators, Jet("mirrored.top", limit=0.01), Jet("mirrored.bottom", limit=0.01)),
    conditions=(NoSlip("bottom", "top"), Stream("left", x=1.0), Outflow("right")),
)
"""Two cylinders beside each other; jets of one name mirror each other."""


def with_mirror_image(half: Mesh) -> Mesh:
    """Return a mesh and its mirror image, joined where the side "bottom" was."""
    seam = np.unique(half.boundaries["bottom"])
    line, n = half.points[seam[0], 1], len(half.points)
    image = np.arange(n, 2 * n)
    image[seam] = seam
    points = np.concatenate([half.points, half.points * [1, -1] + [0, 2 * line]])
    used, triangles = np.unique([*half.triangles, *image[half.triangles[:, [0, 2, 1]]]], return_inverse=True)
    boundaries = {name: half.boundaries[name] for name in half.boundaries if name != "bottom"}
    for side in ("left", "right"):
        boundaries[side] = np.concatenate([boundaries[side], image[boundaries[side]]])
    for name in ("cylinder", "cylinder.top", "cylinder.bottom"):
        boundaries[name.replace("cylinder", "mirrored")] = image[half.boundaries[name]]
    boundaries["bottom"] = image[half.boundaries["top"]]
    boundaries = {name: np.searchsorted(used, facets) for name, facets in boundaries.items()}
    return Mesh(points[used], triangles.reshape(-1, 3), boundaries, meshes.curves(WHOLE, list(boundaries)))


@pytest.fixture(scope="module")
def halves():
    """The half and the whole domain: cases, posed problems, and the steady flows in them."""
    mesh = tiny_mesh(HALF)
    posed = [problem.pose(case, of) for case, of in ((HALF, mesh), (WHOLE, with_mirror_image(mesh)))]
    return posed, [steady.solve(case, each) for case, each in zip((HALF, WHOLE), posed, strict=True)]


def upper(posed_half, posed_whole, field):
    """Return a field of the whole domain at the nodes of its upper half."""
    rows = {tuple(np.round(x, 9)): k for k, x in enumerate(posed_whole.space.x)}
    return field[[rows[tuple(np.round(x, 9))] for x in posed_half.space.x]]


def test_the_steady_flow_in_half_the_domain_is_half_of_the_whole(halves):
    (half, whole), (one, two) = halves
    np.testing.assert_allclose(one.u, upper(half, whole, two.u), atol=1e-10)
    assert abs(one.u[half.slip, 0]).min() > 0.1 and not one.u[half.slip, 1].any()
    assert one.readings["c_d"] > 1.0
    assert two.readings["c_d"] == pytest.approx(2 * one.readings["c_d"], rel=1e-10)
    assert two.readings["c_l.cylinder"] == pytest.approx(one.readings["c_l"], rel=1e-9)
    assert abs(two.readings["c_l"]) < 1e-9 < 0.1 < abs(one.readings["c_l"])


def test_time_steps_in_half_the_domain_are_half_of_the_whole(halves):
    (half, whole), found = halves
    rates = 0.01 * np.random.default_rng(0).uniform(-1, 1, size=(40, 2, 1))
    read, states = [], []
    for case, posed, flow in zip((HALF, WHOLE), (half, whole), found, strict=True):
        ops = baseline.assemble(case, posed, None, precision=np.float64)
        batch = FlowBatch(ops, Start(flow.u, flow.u, flow.p, 0 * flow.p, 0 * flow.p), 1)
        series = batch.advance(np.tile(rates, (1, len(posed.inputs) // 2, 1)))[:, :, 0]
        read.append(dict(zip(ops.functionals, series.T, strict=True)))
        states.append(batch.state(0))
    np.testing.assert_allclose(states[0].u, upper(half, whole, states[1].u), atol=1e-9)
    for name in ("c_d.cylinder", "c_l.cylinder", "c_m.cylinder", "work.cylinder.top"):
        scale = abs(read[0][name]).max()
        np.testing.assert_allclose(read[0][name], read[1][name], rtol=0, atol=1e-8 * scale)
    np.testing.assert_allclose(read[1]["c_l.mirrored"], -read[1]["c_l.cylinder"], atol=1e-8)


# ---- where a slip side ends


def corners(*conditions):
    chosen = dataclasses.replace(TINY, conditions=conditions)
    return problem.pose(chosen, tiny_mesh(chosen))


def at(posed, x, y):
    (node,) = np.flatnonzero(abs(posed.space.x - [x, y]).max(axis=1) < 1e-9)
    return node


@pytest.mark.parametrize("first", [True, False])
def test_a_corner_takes_the_given_velocity_but_what_flows_through_the_slip_side(first):
    slip, stream = FreeSlip("bottom", "top"), Stream("left", x=1.0, y=0.3)
    posed = corners(*((slip, stream) if first else (stream, slip)), Outflow("right"))
    for y in TINY.domain.y:
        node = at(posed, -0.2, y)
        assert node in posed.fixed and node not in posed.slip
        assert tuple(posed.steady[node]) == (1.0, 0.0)
    assert tuple(posed.steady[at(posed, -0.2, 0.0)]) == (1.0, 0.3)
    assert all(at(posed, 0.5, y) in posed.slip for y in TINY.domain.y)  # beside the outflow it slips


def test_slip_sides_along_y_hold_the_other_component():
    chosen = dataclasses.replace(
        TINY, conditions=(FreeSlip("left", "right"), Stream("bottom", x=0.0, y=1.0), Outflow("top")), actuators=()
    )
    ops = in_singles(chosen, tiny_mesh(chosen))
    nodes, held = ops.slip
    assert held == 0
    np.testing.assert_allclose(abs(ops.space.x[nodes, 0] - 0.15), 0.35)
    rest = np.zeros((len(ops.velocity_order), 2))
    flow = FlowBatch(ops, Start(rest, rest, *np.zeros((3, len(ops.pressure_order)))), 1)
    flow.advance(np.zeros((20, 0, 1)))
    assert not flow.state(0).u[nodes, 0].any()
    assert abs(flow.state(0).u[nodes, 1]).min() > 1e-3


# ---- bits, starts, files


SLIPPING = dataclasses.replace(TINY, conditions=(FreeSlip("bottom", "top"), Parabola("left"), Outflow("right")))


@pytest.fixture(scope="module")
def slipping():
    return in_singles(SLIPPING, tiny_mesh())


def test_steps_with_slip_have_the_same_bits_for_every_width(slipping):
    results = steps_by_width(slipping)
    assert all(np.isfinite(part).all() for part in results[0])
    for other in results[1:]:
        for ours, twin in zip(other, results[0], strict=True):
            np.testing.assert_array_equal(ours, twin)


def test_a_flow_that_slips_has_the_same_bits_in_every_batch(slipping):
    start = spinup.kicked(SLIPPING, slipping, 0.3)
    rates = 0.01 * np.sin(np.arange(10)[:, None, None] + np.arange(2)[:, None] + np.arange(13))
    alone = FlowBatch(slipping, start, 1)
    read = alone.advance(rates[:, :, 7:8])
    for flows in (8, 12, 13):
        batch = FlowBatch(slipping, start, flows)
        np.testing.assert_array_equal(batch.advance(rates[:, :, :flows])[:, :, 7:8], read)
        np.testing.assert_array_equal(batch.state(7).u, alone.state(0).u)


def test_starts_have_no_velocity_through_slip_sides(slipping):
    nodes, _ = slipping.slip
    low = dataclasses.replace(SLIPPING, bodies=(dataclasses.replace(SLIPPING.bodies[0], centre=(0.0, -0.1)),))
    start = spinup.kicked(low, slipping, 0.3)  # the gust reaches the side
    assert start.u[:, 1].max() > 0.2 and not start.u[nodes, 1].any()
    fine = in_singles(SLIPPING, meshes.refine(tiny_mesh()))
    rough = np.random.default_rng(0).normal(size=start.u.shape)
    moved = forced.interpolate(slipping.space, dataclasses.replace(start, u=rough, u_old=rough), fine)
    nodes, _ = fine.slip
    assert not moved.u[nodes, 1].any() and not moved.u_old[nodes, 1].any()
    assert abs(moved.u[nodes, 0]).min() > 0.0


def test_a_velocity_through_a_slip_side_is_gone_after_a_few_steps(slipping):
    nodes, _ = slipping.slip
    u = np.zeros((len(slipping.velocity_order), 2))
    u[nodes, 1] = 1e-3
    flow = FlowBatch(slipping, Start(u, u, *np.zeros((3, len(slipping.pressure_order)))), 1)
    flow.advance(np.zeros((1, 2, 1)))
    assert abs(flow.state(0).u[nodes, 1]).max() < 1e-10
    flow.advance(np.zeros((4, 2, 1)))
    assert abs(flow.state(0).u[nodes, 1]).max() < 1e-18


def test_operators_with_slip_survive_writing_and_reading(slipping, tmp_path):
    archive.save(slipping, tmp_path / "operators.npz")
    again = archive.load(tmp_path / "operators.npz", slipping.mesh)
    assert again.digest == slipping.digest
    np.testing.assert_array_equal(again.slip[0], slipping.slip[0])
    assert again.slip[1] == slipping.slip[1] == 1
    posed = problem.pose(SLIPPING, slipping.mesh)
    np.testing.assert_array_equal(np.sort(again.slip[0]), posed.slip)
    assert len(posed.slip) > 10
