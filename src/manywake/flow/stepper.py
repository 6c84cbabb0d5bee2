"""Time stepping: incremental pressure correction (Goda 1979), first order or with BDF2 (Guermond et al. 2006)."""

from dataclasses import dataclass

import numpy as np

from manywake.flow import simd
from manywake.flow.kernels import (
    add_product,
    add_scaled,
    convection,
    fill,
    kernel,
    momentum_backward,
    momentum_forward,
    pressure_solve,
)
from manywake.flow.operators import Operators
from manywake.flow.simd import add, fma, load, mul, splat, store, sub


@dataclass(frozen=True)
class State:
    """The flows of one block of lanes at time t: lane arrays in the solver's order.

    u, u_old: (n, 2) velocity at t and t - dt. p, phi, phi_old: (m, 1) pressure at t, its last two increments.
    """

    u: np.ndarray
    u_old: np.ndarray
    p: np.ndarray
    phi: np.ndarray
    phi_old: np.ndarray


@kernel
def _advance(ops, u, u_old, p, phi, phi_old, y, jets, force):
    """Take len(jets) steps. jets: (steps, jets) lanes. force: (steps, 2) lanes, receives C_D and C_L."""
    e0, e1, q1, q2, to_coefficient = ops.numbers[0], ops.numbers[1], ops.numbers[2], ops.numbers[3], ops.numbers[4]
    nf = len(ops.momentum.inverse_diagonal)
    mf = len(ops.poisson.inverse_diagonal)
    for s in range(len(jets)):
        # right-hand side: lifts of the boundary data, then convection (eq. 8)
        fill(ops.lift, y)
        for j in range(jets.shape[1]):
            add_scaled(ops.jet_lift_rows, ops.jet_lift[j], jets, s, j, y)
        convection(ops.nodes, ops.inverse, ops.wind, e0, u, e1, u_old, y)
        convection(ops.curved_nodes, ops.curved_inverse, ops.curved_wind, e0, u, e1, u_old, y)

        # what of the force is known before u at t + dt (eq. 14)
        fx, fy = splat(0.0, force), splat(0.0, force)
        for k in range(len(ops.body)):
            fx, fy = sub(fx, load(y, ops.body[k], 0)), sub(fy, load(y, ops.body[k], 1))
        for j in range(jets.shape[1]):
            q = load(jets, s, j)
            fx, fy = fma(mul(-ops.jet_thrust[j, 0], q), q, fx), fma(mul(-ops.jet_thrust[j, 1], q), q, fy)
        store(force, s, 0, fx)
        store(force, s, 1, fy)
        add_product(ops.force_now.column, 1.0, ops.force_now.value, u, s, force)
        add_product(ops.force_old.column, 1.0, ops.force_old.value, u_old, s, force)

        # velocity at t + dt (eq. 9): boundary values, then the free nodes
        fill(ops.fixed, y[nf:])
        for j in range(jets.shape[1]):
            add_scaled(ops.jet_rows, ops.jet_profile[j], jets, s, j, y)
        for i in range(mf):
            old = load(p, i, 0)
            store(phi_old, i, 0, fma(q1, load(phi, i, 0), fma(q2, load(phi_old, i, 0), old)))
        momentum_forward(
            ops.history.start, ops.history.column, ops.history.value, u, u_old,
            ops.gradient.start, ops.gradient.column, ops.gradient.value, phi_old,
            ops.momentum.lower.start, ops.momentum.lower.column, ops.momentum.lower.value, y,
        )  # fmt: skip
        upper = ops.momentum.upper
        momentum_backward(upper.start, upper.column, upper.value, ops.momentum.inverse_diagonal, y)

        # pressure at t + dt (eq. 10, 11)
        phi, phi_old = phi_old, phi
        pressure_solve(
            ops.divergence.start, ops.divergence.column, ops.divergence.value, y,
            ops.poisson.lower.start, ops.poisson.lower.column, ops.poisson.lower.value,
            ops.poisson.upper.start, ops.poisson.upper.column, ops.poisson.upper.value,
            ops.poisson.inverse_diagonal, phi,
        )  # fmt: skip
        for i in range(mf):
            store(p, i, 0, add(load(p, i, 0), load(phi, i, 0)))

        add_product(ops.force_new.column, 1.0, ops.force_new.value, y, s, force)
        for c in range(2):
            f = load(force, s, c)
            for k in range(len(ops.force_pressure.column)):
                f = fma(-ops.force_pressure.value[k, c], load(p, ops.force_pressure.column[k], 0), f)
            store(force, s, c, mul(-to_coefficient, f))

        u, u_old, y = y, u, u_old
    return u, u_old, phi, phi_old


def advance(ops: Operators, state: State, jets: np.ndarray) -> tuple[State, np.ndarray]:
    """Advance every flow of a block by len(jets) time steps.

    jets: (steps, jets, lanes) flow rates held during each step, blowing positive. Consumes `state` (its arrays are
    reused). Returns the new state and the coefficients (steps, 2, lanes): C_D and C_L = 2F / (rho U^2 D) of the force
    on the body, drag positive downstream, lift positive up. A flow that is no longer finite stays in its lane and
    harms nobody. Method: docs/numerics.md, eq. 4-14.
    """
    steps, count, width = jets.shape
    expected = (len(ops.case.jets), simd.numbers(state.u).shape[-1])
    if (count, width) != expected:
        raise ValueError(f"jets: expected (steps, {expected[0]}, {expected[1]}), got {jets.shape}; lanes are last")
    flow_rates = simd.zeros((steps, count), width)
    simd.numbers(flow_rates)[...] = jets
    force = simd.zeros((steps, 2), width)
    y = simd.zeros(state.u.shape, width)
    u, u_old, phi, phi_old = _advance(
        ops.tables, state.u, state.u_old, state.p, state.phi, state.phi_old, y, flow_rates, force
    )
    return State(u, u_old, state.p, phi, phi_old), simd.numbers(force)
