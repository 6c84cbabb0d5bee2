"""Readings by name, from what a step gives and the amplitudes it was driven by; and a force by another method."""

import numpy as np
import skfem

from manywake.case.case import Case
from manywake.flow.operators import Operators
from manywake.flow.space import Space

KINDS = ("c_d", "c_l", "c_m")


def named(ops: Operators, read: np.ndarray, amplitudes: np.ndarray) -> dict[str, np.ndarray]:
    """Return the series (steps, B) of every reading by name (`case.readings`).

    read: (steps, functionals, B). amplitudes: (steps, inputs, B), of which those of disturbances may be left out. Sums
    run in one order, so that no bit depends on B. Power is the work of the agent's inputs on the fluid, by pressure,
    friction and force, and as kinetic energy blown in (docs/numerics.md, eq. 17). An input that takes energy out counts
    as 0 at that step. The sensors' integrals come last.
    """
    parts = {name: read[:, k] for k, name in enumerate(ops.functionals)}
    bodies = [name for name in parts if name.partition(".")[0] in KINDS]
    totals: dict[str, np.ndarray] = {}
    for name in bodies:
        kind = name.partition(".")[0]
        totals[kind] = totals[kind] + parts[name] if kind in totals else parts[name]
    power = np.zeros((len(read), read.shape[2]))
    for k, name in enumerate(ops.inputs[: ops.actuators]):
        q, (first, second, third) = amplitudes[:, k], ops.kinetic[k]
        blown = third * q * q * q + second * q * q + first * q
        power = power + np.maximum(q * parts[f"work.{name}"] + blown, 0.0)
    integrals = {name: part for name, part in parts.items() if name.partition(".")[0] not in (*KINDS, "work")}
    return totals | {name: parts[name] for name in bodies} | {"power": power} | integrals


NO_FLOW = 1e3
"""A force coefficient past this is no flow any more: divergence shows in the forces first."""


def blown(ops: Operators, read: np.ndarray) -> np.ndarray:
    """Return which flows blew up, (B,), from what was read of them, (steps, functionals, B)."""
    forces = [k for k, name in enumerate(ops.functionals) if name.startswith(("c_d.", "c_l."))]
    return ~((np.abs(read[:, forces]) < NO_FLOW).all(axis=(0, 1)) & np.isfinite(read).all(axis=(0, 1)))


def joined(parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return readings recorded part by part, one after the other in time."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def means(series: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the mean over the steps of every reading, (B,), summed in order so that it depends on no batch's shape."""
    stacked = np.stack(list(series.values()))
    total = np.zeros((len(stacked), stacked.shape[2]))
    for s in range(stacked.shape[1]):
        total = total + stacked[:, s]
    return dict(zip(series, total / stacked.shape[1], strict=True))


def surface_force(case: Case, space: Space, u: np.ndarray, p: np.ndarray) -> tuple[float, float]:
    """Return C_D and C_L of all bodies of one flow, u (n, 2) and p (m,) in scikit-fem's order, by a surface integral.

    Force on the body = -integral of (sigma n - u (u . n)), n out of the fluid, rho = 1. Slopes on the surface are less
    accurate than the momentum residual of the time loop (docs/numerics.md, eq. 13): this is its check.
    """
    nu, scales = case.viscosity, case.scales
    facets = space.facets(*(name for name in space.mesh.boundaries if case.body(name) is not None))
    basis = skfem.FacetBasis(space.velocity.mesh, skfem.ElementTriP2(), facets=facets, intorder=4)
    a, b = (basis.interpolate(u[:, c]) for c in range(2))
    q = basis.with_element(skfem.ElementTriP1()).interpolate(p)
    nx, ny = basis.normals
    flux = a * nx + b * ny
    shear = nu * (a.grad[1] + b.grad[0])
    x = 2 * nu * a.grad[0] * nx + shear * ny - q * nx - a * flux
    y = shear * nx + 2 * nu * b.grad[1] * ny - q * ny - b * flux
    scale = -2.0 / (scales.velocity**2 * scales.length)
    return float(scale * np.sum(x * basis.dx)), float(scale * np.sum(y * basis.dx))


def recirculation_area(space: Space, u: np.ndarray) -> float:
    """Return the summed area of triangles with at least one node where u_x < 0, for one velocity field (n, 2).

    As in the released code of the paper: no threshold, no restriction to the wake. `u` is in scikit-fem's order.
    """
    area = space.velocity.dx.sum(axis=1)
    return float(area[(u[space.nodes, 0] < 0).any(axis=1)].sum())
