"""The table of references: what the solver gives beside what it should give, on the mesh and time step of a case.

Sources: DFG 2D-1 and 2D-2 are the benchmarks of Schafer & Turek (1996) with FeatFlow's converged numbers; the steady
flow at Re 100 is Newton on a much finer mesh; the controlled flows are this solver's own on a mesh twice as fine at
half the time step (`fine_reference`, shipped as data/controlled-reference.json); the orders are on an exact solution.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import numpy as np

from manywake.flow import baseline, exact, operators, sensors, steady
from manywake.flow import mesh as meshes
from manywake.flow import space as spaces
from manywake.flow.baseline import Baseline, Progress
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.case import BDF2, CASES, GODA, Case
from manywake.flow.operators import Operators

DURATION = 12.0
"""How long the controlled flows run from the start state, about 36 shedding periods."""
SETTLE = 4.0
"""What of it is not averaged: the start-up of the jets, and on the fine mesh the interpolated start state."""
TOLERANCE = 0.02
"""Of the changes of C_D and C_L by the jets against those on the fine mesh."""
STEADY = 1e-5
"""The flow is steady when C_D moved less than this during one unit of time; rounding to singles moves it by 3e-6..."""
STEADY_MOST = 60.0
"""...which must be so before this time."""

Forcing = Callable[[np.ndarray], np.ndarray]


def _harmonic(frequency: float, phases: int) -> list[Forcing]:
    return [lambda t, k=k: 0.003 * np.sin(2 * np.pi * (frequency * t + k / phases)) for k in range(phases)]  # type: ignore[misc]


FORCINGS: dict[str, list[Forcing]] = {
    "no jets": [lambda t: 0.0 * t],
    "Q = 0.001": [lambda t: 0.0 * t + 0.001],
    "Q = 0.004": [lambda t: 0.0 * t + 0.004],
    "Q = 0.003 sin(2 pi 2.5 t)": _harmonic(2.5, 1),
    "Q = 0.003 sin(2 pi 3.6 t)": _harmonic(3.6, 4),
}
"""The flow rate of the first jet, the second has its negative: one column of the batch each.

At 3.6 per unit of time shedding does not lock to the jets: the flow has two frequencies, and five of one almost meet
six of the other. Four columns whose forcing is a quarter of a cycle apart meet that beat at four phases at once. What
their mean still has is the start-up, common to all four, which swings by a third of the change with a period of two
units: hence a window of eight.
"""

REFERENCE = Path(str(files("manywake") / "data" / "controlled-reference.json"))


@dataclass(frozen=True)
class Check:
    """One line of the table. `tolerance` is relative or absolute as `kind` says; for bounds it is 0."""

    name: str
    ours: float
    reference: float
    tolerance: float
    kind: Literal["relative", "absolute", "at least", "at most"]
    source: str

    @property
    def passed(self) -> bool:
        """Whether ours agrees with the reference; never when ours is not a number."""
        error = abs(self.ours - self.reference)
        return {
            "relative": error <= self.tolerance * abs(self.reference),
            "absolute": error <= self.tolerance,
            "at least": self.ours >= self.reference,
            "at most": self.ours <= self.reference,
        }[self.kind]


def run(case: Case = CASES["cylinder-jets"], progress: Progress | None = None, recompute: bool = False) -> list[Check]:
    """Return all checks of a case with two jets, in about a minute on one core.

    recompute: make the fine reference anew (some ten minutes) instead of reading the shipped one. Raises
    ValueError when the shipped one is of another mesh, Reynolds number or time step.
    """
    report = progress or (lambda what, share: None)
    ops, base = baseline.assembled(case)
    reference = fine_reference(case, progress) if recompute else shipped_reference(case, base)
    record = forced(ops, base.start, report, "controlled flows")
    checks = [
        *dfg_steady(case, base, report),
        *dfg_periodic(record[:, :, 0], case),
        *base_flow(ops),
        *jets(ops),
        *forces(ops, base.start),
        *controlled(changes(record, case.time_step), reference["changes"]),
    ]
    report("orders", 0.0)
    return checks + orders(case)


def dfg_steady(case: Case, base: Baseline, report: Progress) -> list[Check]:
    """DFG 2D-1: at Re 20 the Karman street we start from must die and leave the steady flow."""
    ops = operators.assemble(replace(case, reynolds=20.0), base.mesh, base.mean)
    flow = FlowBatch(ops, base.start, 1)
    unit = round(1.0 / case.time_step)
    c_d, c_l, dp = np.nan, np.nan, np.nan
    for k in range(round(STEADY_MOST)):
        report("DFG 2D-1", k / STEADY_MOST)
        record = flow.advance(np.zeros((unit, len(case.jets), 1)))[:, :, 0]
        if np.ptp(record[:, 0]) < STEADY:
            c_d, c_l = record.mean(axis=0)
            front, back = steady.pressure_at(ops.space, flow.state(0).p, [(-case.radius, 0.0), (case.radius, 0.0)])
            dp = 0.2**2 * (front - back)  # the benchmark's mean inflow is 0.2, ours is 1
            break
    source = "Schafer & Turek 1996, FeatFlow"
    return [
        Check("DFG 2D-1 c_D", float(c_d), 5.5795, 0.005, "relative", source),
        Check("DFG 2D-1 c_L", float(c_l), 0.010619, 0.05, "relative", source),
        Check("DFG 2D-1 pressure difference", float(dp), 0.11752, 0.01, "relative", source),
    ]


def dfg_periodic(record: np.ndarray, case: Case) -> list[Check]:
    """DFG 2D-2: statistics of the uncontrolled flow's C_D and C_L (steps, 2) over whole periods."""
    ours = sensors.shedding(record[:, 0], record[:, 1], case.time_step)
    source = "FeatFlow Q2/P1 level 6, dt 1/1600"
    return [
        Check("DFG 2D-2 c_D max", ours.cd_max, 3.2274, 0.005, "relative", source),
        Check("DFG 2D-2 c_D mean", ours.cd_mean, 3.1959, 0.005, "relative", source),
        Check("DFG 2D-2 c_L max", ours.cl_max, 0.9866, 0.015, "relative", source),
        Check("DFG 2D-2 St", ours.strouhal(case.diameter), 0.3018, 0.005, "relative", source),
    ]


def base_flow(ops: Operators) -> list[Check]:
    """The steady flow that is unstable at Re 100: the drag that remains with all shedding gone."""
    ours = steady.solve(ops.case, ops.space)
    return [Check("steady base flow C_D", ours.c_d, 2.942, 0.005, "relative", "Newton, converged in the mesh")]


def jets(ops: Operators) -> list[Check]:
    """Fluxes of the discrete jets, as the time loop imposes them, through all of the body."""
    tables, space, count = ops.tables, ops.space, len(ops.case.jets)
    body = np.concatenate([space.facets(name) for name in ["cylinder", *(f"jet{i}" for i in range(count))]])
    profiles = np.zeros((count, *space.x.shape))
    profiles[:, ops.velocity_order[tables.jet_rows]] = tables.jet_profile
    checks = []
    for i, profile in enumerate(profiles):
        flux, _ = operators.boundary_flux(space, body, profile)
        checks.append(Check(f"jet {i} flux at Q = 1", flux, 1.0, 1e-12, "absolute", "exact"))
    net, _ = operators.boundary_flux(space, body, profiles[0] - profiles[1])
    error = float(abs(ops.jet_flux_error).max())
    return [
        *checks,
        Check("jets' net flux at Q = 1, -1", net, 0.0, 1e-12, "absolute", "exact"),
        Check("jets' flux error before scaling", error, 0.005, 0.0, "at most", "two facets a jet give 0.22 %"),
    ]


def forces(ops: Operators, start: Start) -> list[Check]:
    """C_D and C_L from the momentum residual against the surface integral, of one discrete flow with one jet on.

    One jet and not the pair, whose thrusts would cancel: at Q = 0.005 the jet's momentum flux is 0.07 of C_L. The
    tolerances are the surface integral's: slopes on the surface are an order less accurate. On the shipped mesh it
    is 1.1 % below in C_D and 0.018 away in C_L, on the refined one 0.3 % and 0.006.
    """
    rates = np.zeros((round(0.2 / ops.case.time_step), len(ops.case.jets), 1))
    rates[:, 0] = 0.005
    flow = FlowBatch(ops, start, 1)
    c_d, c_l = flow.advance(rates)[-1, :, 0]
    state = flow.state(0)
    surface = sensors.surface_force(ops, state.u, state.p)
    source = "surface integral of the stress, same flow"
    return [
        Check("residual C_D, one jet on", float(c_d), surface[0], 0.02, "relative", source),
        Check("residual C_L, one jet on", float(c_l), surface[1], 0.03, "absolute", source),
    ]


def controlled(ours: dict[str, dict[str, float]], reference: dict[str, dict[str, float]]) -> list[Check]:
    """The jets' changes of the forces against those on the fine mesh."""
    source = "mesh twice as fine, half the time step"
    return [
        Check(f"change of {quantity}, {name}", value, reference[name][quantity], TOLERANCE, "relative", source)
        for name, quantities in ours.items()
        for quantity, value in quantities.items()
    ]


def orders(case: Case) -> list[Check]:
    """Observed orders of convergence of the case's scheme on a drifting Taylor-Green vortex."""
    velocity, pressure = exact.orders_in_space()
    in_time = exact.order_in_time(case.scheme)
    source = "exact Navier-Stokes solution, L2"
    return [
        Check("order of velocity in space", velocity, 2.8, 0.0, "at least", source),
        Check("order of pressure in space", pressure, 1.8, 0.0, "at least", source),
        Check("order of velocity in time", in_time, 0.9 if case.scheme == GODA else 1.9, 0.0, "at least", source),
    ]


def forced(ops: Operators, start: Start, report: Progress, what: str, duration: float = DURATION) -> np.ndarray:
    """Run all FORCINGS side by side; return C_D and C_L, (steps, 2, B)."""
    dt = ops.case.time_step
    t = dt * np.arange(1, round(duration / dt) + 1)
    first = np.stack([rate(t) for columns in FORCINGS.values() for rate in columns], axis=1)
    rates = np.stack([first, -first], axis=1)
    flow = FlowBatch(ops, start, first.shape[1])
    record = []
    for k in range(0, len(t), 1000):
        report(what, k / len(t))
        record.append(flow.advance(rates[k : k + 1000]))
    return np.concatenate(record)


def changes(record: np.ndarray, time_step: float) -> dict[str, dict[str, float]]:
    """Return the change by each forcing of mean C_D and of C_L: its mean where Q is constant, else its rms.

    Means are over all that follows SETTLE, weighted by sin^4, and over the columns of a forcing: the window's ends are
    smooth, so that no shedding period need be known.
    """
    c_d, c_l = record[round(SETTLE / time_step) :].transpose(1, 0, 2)
    w = np.sin(np.pi * (np.arange(len(c_d)) + 0.5) / len(c_d)) ** 4
    w /= w.sum()
    drag, lift, square = w @ c_d, w @ c_l, w @ c_l**2
    table, column = {}, 0
    for name, columns in FORCINGS.items():
        mine = slice(column, column + len(columns))
        column += len(columns)
        values = {"mean C_D": float(drag[mine].mean()), "mean C_L": float(lift[mine].mean())}
        values["rms C_L"] = float(np.sqrt(square[mine].mean()))
        table[name] = values
    free = table.pop("no jets")
    return {
        name: {key: values[key] - free[key] for key in ("mean C_D", "rms C_L" if "sin" in name else "mean C_L")}
        for name, values in table.items()
    }


def fine_reference(case: Case = CASES["cylinder-jets"], progress: Progress | None = None) -> dict[str, Any]:
    """Compute the controlled flows on the refined mesh at half the time step, second order in time (10 minutes).

    What is shipped was written by `validate.REFERENCE.write_text(json.dumps(validate.fine_reference(), indent=1))`.
    """
    report = progress or (lambda what, share: None)
    ops, base = baseline.assembled(case)
    mesh = meshes.refine(base.mesh, case)
    scheme = BDF2 if case.scheme == GODA else case.scheme
    chosen = replace(case, time_step=case.time_step / 2, scheme=scheme)
    fine = operators.assemble(chosen, mesh, _moved(ops, spaces.build(mesh).x) @ base.mean)
    record = forced(fine, interpolate(ops, base.start, fine), report, "fine reference")
    return {
        "recipe": (
            f"manywake.flow.validate.fine_reference: every triangle of the mesh cut into four ({len(mesh.triangles)} "
            f"triangles), time step {fine.case.time_step:g}, {scheme.name}; the case's start state interpolated, then "
            f"{DURATION:g} units of time; changes are means with a sin^4 window over all but the first {SETTLE:g}"
        ),
        **_identity(case, base),
        "changes": changes(record, fine.case.time_step),
    }


def shipped_reference(case: Case, base: Baseline) -> dict[str, Any]:
    """Read the shipped fine reference; ValueError when it is not one of this case."""
    reference = json.loads(REFERENCE.read_text())
    for key, wanted in _identity(case, base).items():
        if reference[key] != wanted:
            raise ValueError(
                f"controlled reference: got one for {key} {reference[key]}, wanted {wanted}; "
                "make one for this case with recompute=True (some ten minutes)"
            )
    return reference


def _identity(case: Case, base: Baseline) -> dict[str, Any]:
    return {
        "mesh": base.mesh.digest(),
        "reynolds": case.reynolds,
        "time_step": case.time_step,
        "duration": DURATION,
        "settle": SETTLE,
        "forcings": list(FORCINGS),
    }


def interpolate(ops: Operators, start: Start, fine: Operators) -> Start:
    """Return a state on the refined mesh at half the time step, with the fine mesh's boundary values, jets off."""
    velocity = _moved(ops, fine.space.x)
    pressure = spaces.probe_matrix(ops.space.pressure, _inside(ops, fine.space.mesh.points))
    u, u_old = velocity @ start.u, velocity @ (0.5 * (start.u + start.u_old))
    for part in (u, u_old):
        part[fine.velocity_order[fine.free :]] = fine.tables.fixed
    return Start(u, u_old, pressure @ start.p, pressure @ start.phi / 2, pressure @ start.phi_old / 2)


def _moved(ops: Operators, points: np.ndarray):
    """Return the matrix that interpolates velocities at the nodes of a refined mesh, (k, 2)."""
    return spaces.probe_matrix(ops.space.velocity, _inside(ops, points))


def _inside(ops: Operators, points: np.ndarray) -> np.ndarray:
    """Return points (k, 2) with those on the cylinder moved off it, where rounding cannot put them into the body."""
    distance = np.linalg.norm(points, axis=1)
    return points * (np.maximum(distance, (1 + 1e-6) * ops.case.radius) / distance)[:, None]
