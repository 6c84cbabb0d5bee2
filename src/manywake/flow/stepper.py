"""Time stepping: incremental pressure correction (Goda 1979), first order or with BDF2 (Guermond et al. 2006)."""

from dataclasses import dataclass

import numpy as np

from manywake.flow import simd
from manywake.flow.kernels import (
    convection,
    divergence,
    extrapolate,
    extrapolate_row,
    kernel,
    linear_terms,
    solve,
    subtract_rows,
)
from manywake.flow.operators import Operators
from manywake.flow.simd import add, double, fma, high, join, load, low, mul, rounded, splat, store, sub


@dataclass(frozen=True)
class State:
    """The flows of one block of lanes at time t: lane arrays in the solver's order.

    u, u_old: (n, 2) velocity at t and t - dt. p: (m, 1) pressure at t. These are doubles; in the precision of the
    operators are phi, phi_old: (m, 1) the last two increments of p.
    """

    u: np.ndarray
    u_old: np.ndarray
    p: np.ndarray
    phi: np.ndarray
    phi_old: np.ndarray


@kernel
def _advance(ops, u, u_old, p, phi, phi_old, e, d, y, p_star, jets, force):
    """Take len(jets) steps. jets: (steps, jets) lanes. force: (steps, 2) lanes, receives C_D and C_L.

    u, u_old, e, d, y: pairs. e, d, y, p_star: room in the precision of the operators.
    """
    ahead, b1, b2, to_coefficient = ops.numbers[0], ops.numbers[1], ops.numbers[2], ops.numbers[3]
    nf = len(ops.momentum.inverse_diagonal)
    mf = len(ops.poisson.inverse_diagonal)
    tested = len(ops.linear.start) - 1
    extrapolate(ahead, u, u_old, e, d)
    for s in range(len(jets)):
        # minus the residual of the momentum equation at the extrapolated velocity and pressure (eq. 6-9)
        for i in range(mf):
            now = load(p, i, 0)
            guess = fma(b1, double(load(phi, i, 0)), fma(b2, double(load(phi_old, i, 0)), now))
            store(p_star, i, 0, rounded(guess, p_star))
        linear_terms(
            ops.linear.start, ops.linear.column, ops.linear.value, e, d,
            ops.gradient.start, ops.gradient.column, ops.gradient.value, p_star, y,
        )  # fmt: skip
        for i in range(tested, len(y)):
            store(y, i, 0, splat(0.0, y))
        convection(ops.nodes, ops.inverse, e, y)
        convection(ops.curved_nodes, ops.curved_inverse, e, y)

        # what of the force is known before the increment (eq. 14)
        f = splat(0.0, u)
        for i in range(nf, tested):
            f = add(f, double(load(y, i, 0)))
        for j in range(jets.shape[1]):
            q = load(jets, s, j)
            f = add(f, join(mul(ops.jet_thrust[j, 0], mul(q, q)), mul(ops.jet_thrust[j, 1], mul(q, q))))

        # increment of the velocity (eq. 9): boundary values, then the free nodes
        for i in range(len(ops.fixed)):
            g = join(splat(ops.fixed[i, 0], jets), splat(ops.fixed[i, 1], jets))
            store(y, nf + i, 0, rounded(sub(g, _ahead(ahead, u, u_old, nf + i)), y))
        for k in range(len(ops.jet_rows)):
            i = ops.jet_rows[k]
            x, z = splat(ops.fixed[i - nf, 0], jets), splat(ops.fixed[i - nf, 1], jets)
            for j in range(jets.shape[1]):
                q = load(jets, s, j)
                x, z = fma(ops.jet_profile[j, k, 0], q, x), fma(ops.jet_profile[j, k, 1], q, z)
            store(y, i, 0, rounded(sub(join(x, z), _ahead(ahead, u, u_old, i)), y))
        coupling = ops.coupling
        subtract_rows(ops.coupling_rows, coupling.start, coupling.column, coupling.value, y, y)
        m = ops.momentum
        solve(
            m.first, m.row_start, m.row, m.lower_start, m.lower, m.upper, m.lower_corner, m.upper_corner,
            m.inverse_diagonal, y,
        )  # fmt: skip
        for k in range(len(ops.force.column)):
            f = fma(-ops.force.value[k], double(load(y, ops.force.column[k], 0)), f)

        # velocity at t + dt, and what the next step starts from
        u, u_old = u_old, u
        for i in range(len(u)):
            old = load(u_old, i, 0)
            new = add(_ahead(ahead, u_old, u, i), double(load(y, i, 0)))
            store(u, i, 0, new)
            extrapolate_row(ahead, new, old, e, d, i)

        # pressure at t + dt (eq. 10, 11), and its part in the force
        phi, phi_old = phi_old, phi
        divergence(ops.divergence.start, ops.divergence.column, ops.divergence.value, u, phi)
        m = ops.poisson
        solve(
            m.first, m.row_start, m.row, m.lower_start, m.lower, m.upper, m.lower_corner, m.upper_corner,
            m.inverse_diagonal, phi,
        )  # fmt: skip
        for i in range(mf):
            store(p, i, 0, add(load(p, i, 0), double(load(phi, i, 0))))
        x, z = low(f), high(f)
        for k in range(len(ops.force_pressure.column)):
            i = ops.force_pressure.column[k]
            q = sub(load(p, i, 0), double(load(p_star, i, 0)))
            x, z = fma(ops.force_pressure.value[k, 0], q, x), fma(ops.force_pressure.value[k, 1], q, z)
        store(force, s, 0, mul(to_coefficient, x))
        store(force, s, 1, mul(to_coefficient, z))
    return u, u_old, phi, phi_old


@kernel
def _ahead(ahead, u, u_old, i):
    """The extrapolated velocity at a node (eq. 6)."""
    now = load(u, i, 0)
    return fma(ahead, sub(now, load(u_old, i, 0)), now)


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
    e, d, y = (simd.zeros((len(state.u), 1), 2 * width, ops.precision) for _ in range(3))
    p_star = simd.zeros(state.p.shape, width, ops.precision)
    u, u_old = simd.pairs(state.u), simd.pairs(state.u_old)
    new, old, phi, phi_old = _advance(
        ops.tables, u, u_old, state.p, state.phi, state.phi_old, e, d, y, p_star, flow_rates, force
    )
    state = State(new.view(state.u.dtype), old.view(state.u.dtype), state.p, phi, phi_old)
    return state, simd.numbers(force)
