"""Observed orders of convergence on an exact Navier-Stokes solution, through the very same compiled stepper.

The solution is a Taylor-Green vortex that decays and drifts with a uniform stream (c, d), on the unit square, with
X = k (x - c t), Y = k (y - d t), k = 2 pi and F = exp(-2 nu k^2 t):

    u = c - F cos X sin Y,   v = d + F sin X cos Y,   p = -F^2 (cos 2X + cos 2Y) / 4.

Its boundary data are a steady part plus four products of a time and a space function, which is what the solver's
inputs are: so the square has four of them around all its boundary, and nothing in the time loop is special.
"""

import numpy as np
import skfem

from manywake.case.schemes import BDF2, Scheme
from manywake.flow import operators, space
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.mesh import Mesh
from manywake.flow.operators import Operators
from manywake.flow.problem import Problem

K = 2 * np.pi
STREAM = np.array([1.0, 0.7])
DURATION = 0.06
"""A hundred steps of 6e-4."""
VISCOSITY = 0.01
"""So that convection, pressure and friction all matter on the square."""
FLUCTUATION = 30.0
"""Damping acts at the corner of the square, up to this velocity and as in small triangles, so that its order shows."""


def velocity(x: np.ndarray, t: float) -> np.ndarray:
    """Return the exact velocity (n, 2) at points (n, 2)."""
    return STREAM + np.tensordot(rates(np.array([t]))[0], profiles(x), 1)


def pressure(x: np.ndarray, t: float) -> np.ndarray:
    """Return the exact pressure (n,) at points (n, 2), of zero mean over the square."""
    X, Y = (K * (x - STREAM * t)).T
    return -0.25 * np.exp(-4 * VISCOSITY * K**2 * t) * (np.cos(2 * X) + np.cos(2 * Y))


def profiles(x: np.ndarray) -> np.ndarray:
    """Return the space functions (4, n, 2) at points (n, 2) of which the vortex is made."""
    (cx, cy), (sx, sy) = np.cos(K * x.T), np.sin(K * x.T)
    pairs = [(-cx * sy, sx * cy), (cx * cy, sx * sy), (-sx * sy, -cx * cy), (sx * cy, -cx * sy)]
    return np.array([np.stack(pair, axis=1) for pair in pairs])


def rates(t: np.ndarray) -> np.ndarray:
    """Return the time functions (steps, 4) that go with `profiles`."""
    (ca, cb), (sa, sb) = np.cos(K * np.outer(STREAM, t)), np.sin(K * np.outer(STREAM, t))
    return (np.exp(-2 * VISCOSITY * K**2 * t) * np.array([ca * cb, ca * sb, sa * cb, sa * sb])).T


def square(level: int) -> Mesh:
    """Return the unit square in 8 triangles (none with two sides on the boundary), `level` times cut into four."""
    mesh = skfem.MeshTri.init_sqsymmetric().refined(level)
    return Mesh(mesh.p.T.copy(), mesh.t.T.astype(np.int64), {})


def solve(level: int, time_step: float, scheme: Scheme = BDF2) -> tuple[Operators, Start]:
    """Step the vortex from exact data at time 0 to DURATION; return the operators and the last state.

    The pressure is pinned at one vertex, where its increments are zero: what is stepped is p - p(pin). Boundary data
    are those of opposite sides alike, so that their interpolant has no net flux for the pin to swallow.
    """
    dt, spaces = time_step, space.build(square(level))
    fixed = np.unique(spaces.velocity.get_dofs().all())
    steady, shapes = np.zeros_like(spaces.x), np.zeros((4, *spaces.x.shape))
    steady[fixed] = STREAM
    shapes[:, fixed] = profiles(spaces.x[fixed])
    inputs, none = tuple(f"vortex {k}" for k in range(4)), (np.zeros(4), np.zeros((4, 3)))
    posed = Problem(spaces, fixed, steady, np.array([0]), (), inputs, shapes, *none)
    mean, corner = np.tile(STREAM, (len(spaces.x), 1)), np.exp(-np.sum((spaces.x / 0.1) ** 2, axis=1))
    ops = operators.assemble(posed, scheme, dt, VISCOSITY, mean, FLUCTUATION * corner)
    p = [pressure(spaces.mesh.points, -k * dt) for k in range(3)]
    p = [q - q[0] for q in p]
    start = Start(velocity(spaces.x, 0.0), velocity(spaces.x, -dt), p[0], p[0] - p[1], p[1] - p[2])
    flow = FlowBatch(ops, start, 1)
    flow.advance(rates(dt * np.arange(1, round(DURATION / dt) + 1))[:, :, None])
    return ops, flow.state(0)


def errors(ops: Operators, state: Start) -> tuple[float, float]:
    """Return the L2 errors of velocity and pressure (up to a constant) at DURATION."""
    fine = skfem.Basis(ops.space.velocity.mesh, skfem.ElementTriP2(), intorder=8)
    points, weight = np.asarray(fine.global_coordinates()).reshape(2, -1).T, fine.dx
    exact = velocity(points, DURATION).T.reshape(2, *weight.shape)
    squares = sum((np.asarray(fine.interpolate(u)) - wanted) ** 2 for u, wanted in zip(state.u.T, exact, strict=True))
    e = np.asarray(fine.with_element(skfem.ElementTriP1()).interpolate(state.p))
    e = e - pressure(points, DURATION).reshape(weight.shape)
    e = e - np.sum(e * weight) / np.sum(weight)
    return float(np.sqrt(np.sum(squares * weight))), float(np.sqrt(np.sum(e**2 * weight)))


def orders_in_space() -> tuple[float, float]:
    """Return the observed orders of velocity and pressure (L2) between two meshes at one small time step."""
    (u0, p0), (u1, p1) = (errors(*solve(level, 3e-4)) for level in (3, 4))
    return float(np.log2(u0 / u1)), float(np.log2(p0 / p1))


def order_in_time(scheme: Scheme) -> float:
    """Return the observed order of velocity (L2) from three runs at dt, dt/2 and dt/4 on one mesh."""
    runs = [solve(3, (1.2e-3 if scheme.mean else 6e-4) / 2**k, scheme) for k in range(3)]
    mass, (a, b, c) = runs[0][0].space.mass, (state.u for _, state in runs)
    first, second = (float(np.sum(d * (mass @ d))) ** 0.5 for d in (a - b, b - c))
    return float(np.log2(first / second))
