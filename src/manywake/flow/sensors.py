"""What is measured: pressure and velocity at the probes, recirculation area, and statistics of a force signal."""

from dataclasses import dataclass

import numpy as np
import skfem

from manywake.flow import simd
from manywake.flow.kernels import product
from manywake.flow.operators import Operators
from manywake.flow.stepper import State


def pressure(ops: Operators, state: State) -> np.ndarray:
    """Return the pressure at the probes, (lanes, probes), in units of rho U-bar^2."""
    return _read(ops.probe_pressure, state.p, 0)


def velocity(ops: Operators, state: State) -> np.ndarray:
    """Return the velocity at the probes, (lanes, 2 probes), ordered u0, v0, u1, v1, ..."""
    parts = [_read(ops.probe_velocity, state.u, c) for c in range(2)]
    return np.stack(parts, axis=2).reshape(parts[0].shape[0], -1)


OBSERVATIONS = {"pressure": pressure, "velocity": velocity}
"""The observations a task can name."""


def _read(rows, x: np.ndarray, component: int) -> np.ndarray:
    width = simd.numbers(x).shape[-1]
    out = simd.zeros((len(rows.start) - 1, 1), width)
    product(*rows, x, component, out)
    return np.ascontiguousarray(simd.numbers(out)[:, 0].T)


def recirculation_area(ops: Operators, u: np.ndarray) -> float:
    """Return the summed area of triangles with at least one node where u_x < 0, for one velocity field (n, 2).

    As in the released code of the paper: no threshold, no restriction to the wake. `u` is in scikit-fem's order.
    """
    space = ops.space
    area = space.velocity.dx.sum(axis=1)
    return float(area[(u[space.nodes, 0] < 0).any(axis=1)].sum())


@dataclass(frozen=True)
class Shedding:
    """Statistics of C_D and C_L over whole shedding periods; C = 2F / (rho U-bar^2 D)."""

    cd_mean: float
    cd_max: float
    cd_min: float
    cl_mean: float
    cl_max: float
    cl_min: float
    cl_rms: float
    period: float
    periods: int

    def strouhal(self, diameter: float) -> float:
        """St = D / (U-bar T) of a cylinder of the given diameter."""
        return diameter / self.period


def shedding(c_d: np.ndarray, c_l: np.ndarray, time_step: float) -> Shedding:
    """Return the statistics of a signal (steps,) between the first and the last upward crossing of C_L's mid-range.

    cl_rms is the root mean square about zero. Raises ValueError when there are fewer than two whole periods.
    """
    level = 0.5 * (c_l.max() + c_l.min())
    above = c_l >= level
    up = np.flatnonzero(~above[:-1] & above[1:])
    if len(up) < 3:
        raise ValueError(f"shedding: got {max(len(up) - 1, 0)} whole periods, wanted at least 2; record for longer")
    crossing = up + (level - c_l[up]) / (c_l[up + 1] - c_l[up])
    first, last = int(up[0]) + 1, int(up[-1]) + 1
    d, lift = c_d[first:last], c_l[first:last]
    return Shedding(
        float(d.mean()),
        float(d.max()),
        float(d.min()),
        float(lift.mean()),
        float(lift.max()),
        float(lift.min()),
        float(np.sqrt(np.mean(lift**2))),
        float((crossing[-1] - crossing[0]) / (len(up) - 1) * time_step),
        len(up) - 1,
    )


def surface_force(ops: Operators, u: np.ndarray, p: np.ndarray) -> tuple[float, float]:
    """Return C_D and C_L of one flow, u (n, 2) and p (m,) in scikit-fem's order, by the integral over the surface.

    Force on the body = -integral of (sigma n - u (u . n)) over cylinder and jets, n out of the fluid (the jets'
    momentum flux included, rho = 1). Slopes of P2 and P1 pressure on the surface are less accurate than the momentum
    residual that the time loop uses (docs/numerics.md, eq. 13): this is its check, not another choice.
    """
    space, nu = ops.space, ops.case.viscosity
    names = ["cylinder", *(f"jet{i}" for i in range(len(ops.case.jets)))]
    facets = np.concatenate([space.facets(name) for name in names])
    basis = skfem.FacetBasis(space.velocity.mesh, skfem.ElementTriP2(), facets=facets, intorder=4)
    a, b = (basis.interpolate(u[:, c]) for c in range(2))
    q = basis.with_element(skfem.ElementTriP1()).interpolate(p)
    nx, ny = basis.normals
    flux = a * nx + b * ny
    shear = nu * (a.grad[1] + b.grad[0])
    x = 2 * nu * a.grad[0] * nx + shear * ny - q * nx - a * flux
    y = shear * nx + 2 * nu * b.grad[1] * ny - q * ny - b * flux
    scale = -2.0 / ops.case.diameter
    return float(scale * np.sum(x * basis.dx)), float(scale * np.sum(y * basis.dx))
