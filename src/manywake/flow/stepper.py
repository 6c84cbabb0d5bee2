"""Time stepping: incremental pressure correction (Goda 1979), first order or with BDF2 (Guermond et al. 2006)."""

from dataclasses import dataclass

import numpy as np

from manywake.flow import kernels
from manywake.flow.operators import Operators
from manywake.machine import simd
from manywake.machine.compile import kernel
from manywake.machine.simd import add, double, fma, high, join, load, low, mul, rounded, splat, store, sub


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
def _advance(ops, u, u_old, p, phi, phi_old, e, d, y, parts, p_star, amplitudes, readings):
    """Take len(amplitudes) steps; readings: (steps, functionals) lanes, receives what is read at each.

    amplitudes: (steps, inputs) lanes. u, u_old, e, d, y: pairs. e, d, y, p_star: room in the precision of the
    operators. parts: (2 n, 1), the memory of y by components.
    """
    # numba spreads plain tuples, not named ones: hence the [:] below
    ahead, b1, b2 = ops.numbers[0], ops.numbers[1], ops.numbers[2]
    nf, mf, tested = len(ops.momentum.inverse_diagonal), len(ops.poisson.inverse_diagonal), len(ops.linear.start) - 1
    kernels.extrapolate(ahead, u, u_old, e, d)
    for s in range(len(amplitudes)):
        # minus the residual of the momentum equation at the extrapolated velocity and pressure (eq. 6-9)
        for i in range(mf):
            now = load(p, i, 0)
            guess = fma(b1, double(load(phi, i, 0)), fma(b2, double(load(phi_old, i, 0)), now))
            store(p_star, i, 0, rounded(guess, p_star))
        kernels.linear_terms(*ops.linear[:], e, d, *ops.gradient[:], p_star, y)
        for i in range(tested, len(y)):
            store(y, i, 0, splat(0.0, y))
        kernels.convection(ops.nodes, ops.inverse, e, y)
        kernels.convection(ops.curved_nodes, ops.curved_inverse, e, y)
        kernels.return_flow(ops.open_nodes, ops.open_normal, e, y)
        kernels.push(ops.force_rows, ops.force_loads, amplitudes, s, y)
        _read_residual(ops, s, parts, amplitudes, readings)

        # increment of the velocity (eq. 9): boundary values, then the free nodes, those that slip last
        for i in range(len(ops.fixed)):
            g = join(splat(ops.fixed[i, 0], amplitudes), splat(ops.fixed[i, 1], amplitudes))
            store(y, nf + i, 0, rounded(sub(g, _ahead(ahead, u, u_old, nf + i)), y))
        for k in range(len(ops.input_rows)):
            i = ops.input_rows[k]
            x, z = splat(ops.fixed[i - nf, 0], amplitudes), splat(ops.fixed[i - nf, 1], amplitudes)
            for j in range(amplitudes.shape[1]):
                q = load(amplitudes, s, j)
                x, z = fma(ops.input_profile[j, k, 0], q, x), fma(ops.input_profile[j, k, 1], q, z)
            store(y, i, 0, rounded(sub(join(x, z), _ahead(ahead, u, u_old, i)), y))
        kernels.subtract_rows(ops.coupling_rows, *ops.coupling[:], y, y)
        kernels.solve_held(*ops.momentum[:], ops.slip[0], ops.slip[1], e, y)

        # velocity at t + dt, and what the next step starts from
        u, u_old = u_old, u
        for i in range(len(u)):
            old = load(u_old, i, 0)
            new = add(_ahead(ahead, u_old, u, i), double(load(y, i, 0)))
            store(u, i, 0, new)
            kernels.extrapolate_row(ahead, new, old, e, d, i)

        # pressure at t + dt (eq. 10, 11), and what is read
        phi, phi_old = phi_old, phi
        kernels.divergence(*ops.divergence[:], u, phi)
        kernels.solve(*ops.poisson[:], phi)
        for i in range(mf):
            store(p, i, 0, add(load(p, i, 0), double(load(phi, i, 0))))
        _read_increments(ops, s, parts, u, p, p_star, readings)
        if len(ops.still) > 0:
            kernels.energy(ops.still, *ops.energy[:], u, y, readings, s, len(ops.scale))
    return u, u_old, phi, phi_old


@kernel
def _read_residual(ops, s, parts, amplitudes, readings):
    """What of the readings is known before the increment (eq. 14): residual, momentum and stretching of the wall."""
    (start, column, value), inputs = ops.residual, amplitudes.shape[1]
    for r in range(len(ops.scale)):
        f = splat(0.0, readings)
        for k in range(start[r], start[r + 1]):
            f = fma(value[k], double(load(parts, column[k], 0)), f)
        for j in range(inputs):
            q = load(amplitudes, s, j)
            for k in range(inputs):
                if ops.flux[r, j, k] != 0.0:
                    f = add(f, mul(ops.flux[r, j, k], mul(q, load(amplitudes, s, k))))
            f = fma(ops.wall[r, j], q, f)
        store(readings, s, r, add(f, splat(ops.wall[r, inputs], readings)))


@kernel
def _read_increments(ops, s, parts, u, p, p_star, readings):
    """What the increments, and the new velocity, add to the readings, which are then scaled to coefficients."""
    (start, column, value), (p_start, p_column, p_value) = ops.increment, ops.read_pressure
    u_start, u_column, u_value = ops.read_velocity
    for r in range(len(ops.scale)):
        f = load(readings, s, r)
        for k in range(start[r], start[r + 1]):
            f = fma(-value[k], double(load(parts, column[k], 0)), f)
        for k in range(p_start[r], p_start[r + 1]):
            i = p_column[k]
            f = fma(p_value[k], sub(load(p, i, 0), double(load(p_star, i, 0))), f)
        for k in range(u_start[r], u_start[r + 1]):
            new = load(u, u_column[k], 0)
            f = fma(u_value[k, 0], low(new), fma(u_value[k, 1], high(new), f))
        store(readings, s, r, mul(ops.scale[r], f))


@kernel
def _ahead(ahead, u, u_old, i):
    """The extrapolated velocity at a node (eq. 6)."""
    now = load(u, i, 0)
    return fma(ahead, sub(now, load(u_old, i, 0)), now)


def advance(ops: Operators, state: State, amplitudes: np.ndarray) -> tuple[State, np.ndarray]:
    """Advance every flow of a block by len(amplitudes) time steps.

    amplitudes: (steps, inputs, lanes), held during each step. Consumes `state` (its arrays are reused). Returns the new
    state and what is read, (steps, functionals, lanes), in the order of `ops.functionals`; `readings` names it. A flow
    that is no longer finite stays in its lane and harms nobody. Method: docs/numerics.md, eq. 4-14.
    """
    steps, count, width = amplitudes.shape
    given = simd.zeros((steps, count), width)
    simd.numbers(given)[...] = amplitudes
    found = simd.zeros((steps, len(ops.functionals)), width)
    e, d = (simd.zeros((len(state.u), 1), 2 * width, ops.precision) for _ in range(2))
    y = simd.zeros((len(state.u), 2), width, ops.precision)
    p_star = simd.zeros(state.p.shape, width, ops.precision)
    u, u_old, room = simd.pairs(state.u), simd.pairs(state.u_old), (e, d, simd.pairs(y), y.reshape(-1, 1), p_star)
    new, old, phi, phi_old = _advance(ops.tables, u, u_old, state.p, state.phi, state.phi_old, *room, given, found)
    state = State(new.view(state.u.dtype), old.view(state.u.dtype), state.p, phi, phi_old)
    return state, simd.numbers(found)
