"""The table of references: what the solver gives beside what it should give, on the mesh and time step of a case.

The case's file says which numbers of others there are (`flow.reference` computes them). Fluxes of the inputs, the
force by two methods and the orders of convergence are checked for every case.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from manywake.case import checks as fits
from manywake.case import references as said
from manywake.case.case import Case
from manywake.case.inputs import Gust
from manywake.case.references import Forced, Reference, Twin
from manywake.case.schemes import Scheme
from manywake.flow import exact, forced, problem, readings, reference, twin
from manywake.flow.baseline import Progress
from manywake.flow.batch import FlowBatch
from manywake.flow.problem import Problem
from manywake.flow.reference import Check, Runs
from manywake.flow.space import Space
from manywake.flow.store import Flow
from manywake.machine import disk

STILL = 0.01
"""Smallest force, as a coefficient, that a share is taken of."""


def run(
    flow: Flow,
    references: Sequence[Reference] = (),
    mixing: np.ndarray | None = None,
    kept: Path | None = None,
    progress: Progress | None = None,
    recompute: bool = False,
) -> list[Check]:
    """Return all checks of a flow, in about a minute on one core, and longer where other flows must be spun up.

    mixing: (inputs,), how the first action drives them. kept: file of the fine reference that `Forced` and `Twin`
    compare with; recompute: make that anew first (some ten minutes). ValueError when it is not there, or of another
    flow, or when a reference asks for what the case does not have.
    """
    said.check(flow.case, references)
    report = progress or (lambda what, share: None)
    runs, checks = Runs(flow, report), []
    for number in references:
        if not isinstance(number, Forced | Twin):
            checks += reference.checks(runs, number)
    checks += [viscosity(flow), *fluxes(flow, runs.posed), *forces(flow)]
    for number in references:
        if isinstance(number, Forced) and mixing is not None and kept is not None:
            checks += controlled(flow, number, mixing, kept, report, recompute)
        elif isinstance(number, Twin) and kept is not None:
            checks += twins(flow, number, kept, report, recompute)
    report("orders", 0.0)
    checks += orders(flow.case.scheme)
    report("orders", 1.0)
    return checks


def viscosity(flow: Flow) -> Check:
    """The viscosity that the time loop's friction has, against that of the Reynolds number."""
    ops, scales = flow.operators, flow.case.scales
    tested = ops.velocity_order[: len(ops.tables.linear.start) - 1]
    friction = abs(ops.tables.linear.value[:, 0].astype(float)).sum()
    found = float(friction / abs(ops.space.stiffness[tested]).sum())
    wanted = scales.velocity * scales.length / flow.case.reynolds
    return Check("viscosity of the time loop", found, wanted, 1e-5, "relative", "U L / Re")


def fluxes(flow: Flow, posed: Problem) -> list[Check]:
    """Fluxes of the discrete inputs, as the time loop imposes them: of each through its wall, of a pair through all."""
    tables, space = flow.operators.tables, posed.space
    profiles = np.zeros_like(posed.profiles)
    profiles[:, flow.operators.velocity_order[tables.input_rows]] = tables.input_profile
    return [*_gusts(flow.case, space, profiles), *_jets(flow.case, space, profiles, posed.flux_error)]


def _gusts(case: Case, space: Space, profiles: np.ndarray) -> list[Check]:
    """Fluxes of the agent's gusts against those of their profiles."""
    found = []
    for k, actuator in enumerate(case.actuators):
        if isinstance(actuator, Gust):
            flux, _ = problem.boundary_flux(space, space.facets(actuator.on), profiles[k])
            wanted = fits.flux(case, actuator.profile, (actuator.on,))
            found.append(Check(f"flux of {actuator.on} at amplitude 1", flux, wanted, 1e-9, "absolute", "its profile"))
    return found


def _jets(case: Case, space: Space, profiles: np.ndarray, flux_error: np.ndarray) -> list[Check]:
    blowing = [(k, actuator) for k, actuator in enumerate(case.inputs) if actuator.flux is not None]
    if not blowing:
        return []
    walls = {actuator.on.partition(".")[0] for _, actuator in blowing}
    facets = space.facets(*(name for name in sorted(space.mesh.boundaries) if name.partition(".")[0] in walls))
    checks = []
    for k, actuator in blowing:
        flux, _ = problem.boundary_flux(space, space.facets(actuator.on), profiles[k])
        name = f"flux of {actuator.on} at amplitude 1"
        checks.append(Check(name, flux, actuator.flux or 0.0, 1e-12, "absolute", "exact"))
    if len(blowing) > 1:
        (first, _), (second, _) = blowing[:2]
        net, _ = problem.boundary_flux(space, facets, profiles[first] - profiles[second])
        checks.append(Check("net flux at amplitudes 1, -1", net, 0.0, 1e-12, "absolute", "exact"))
    error = float(abs(flux_error).max())
    return [*checks, Check("flux error before scaling", error, 0.005, 0.0, "at most", "two facets a jet give 0.22 %")]


def forces(flow: Flow) -> list[Check]:
    """C_D and C_L from the momentum residual against the surface integral, of one discrete flow with one input on.

    One jet and not a pair, whose thrusts would cancel: at half its limit the paper's jet has a momentum flux of 0.07 of
    C_L. The tolerances are the surface integral's: slopes on the surface are an order less accurate. On the shipped
    mesh of the paper's flow it is 1.1 % below in C_D and 0.018 away in C_L, on the refined one 0.3 % and 0.006.
    """
    case, ops = flow.case, flow.operators
    if not case.bodies:
        return []
    amplitudes = np.zeros((round(2.0 * case.convective_time / case.dt), len(case.actuators), 1))
    if case.actuators:
        amplitudes[:, 0] = 0.5 * case.actuators[0].limit
    batch = FlowBatch(ops, flow.baseline.start, 1)
    driven = batch.disturbed(amplitudes)
    record = readings.named(ops, batch.advance(driven), driven)
    state, source = batch.state(0), "surface integral of the stress, same flow"
    c_d, c_l = readings.surface_force(case, ops.space, state.u, state.p)
    return [
        Check("residual C_D, one input on", float(record["c_d"][-1, 0]), c_d, 0.02, "relative", source),
        Check("residual C_L, one input on", float(record["c_l"][-1, 0]), c_l, 0.03, "absolute", source),
        forgotten(flow, batch, driven[-1:]),
    ]


def forgotten(flow: Flow, batch: FlowBatch, amplitudes: np.ndarray) -> Check:
    """The force is made with the new pressure: one step finds it again where the old one was forgotten.

    The pressure and its increments are set to zero for one step under `amplitudes` (1, inputs, 1). The step's
    increment is then all of the pressure, and a force that lacks it is off by the share of the pressure in it.
    """
    ops, state = flow.operators, batch.state(0)
    batch.reset([0], replace(state, p=0 * state.p, phi=0 * state.phi, phi_old=0 * state.phi))
    record = readings.named(ops, batch.advance(amplitudes), amplitudes)
    after = batch.state(0)
    wanted = np.array(readings.surface_force(flow.case, ops.space, after.u, after.p))
    off = np.array([record["c_d"][0, 0], record["c_l"][0, 0]]) - wanted
    share = float(np.linalg.norm(off) / max(float(np.linalg.norm(wanted)), STILL))
    name, source = "residual force off, old pressure forgotten", "surface integral of the stress, same flow"
    return Check(name, share, 0.05, 0.0, "at most", source)


def controlled(
    flow: Flow, reference: Forced, mixing: np.ndarray, kept: Path, report: Progress, recompute: bool
) -> list[Check]:
    """The inputs' changes of the forces against those on the fine mesh."""
    if recompute:
        made = json.dumps(forced.fine(flow, reference, mixing, report), indent=1).encode()
        disk.write(kept, lambda file: file.write(made))
    theirs = forced.kept(flow, reference, kept)["changes"]
    record = forced.run(flow.operators, flow.baseline.start, reference, mixing, report, "controlled flows")
    return [
        _change(f"change of {quantity}, {name}", value, theirs[name][quantity], reference)
        for name, quantities in forced.changes(record, reference, flow.case.dt).items()
        for quantity, value in quantities.items()
    ]


def twins(flow: Flow, wanted: Twin, kept: Path, report: Progress, recompute: bool) -> list[Check]:
    """The uncontrolled flow's statistics against those of its twin on the fine mesh."""
    if recompute:
        made = json.dumps(twin.fine(flow, wanted, report), indent=1).encode()
        disk.write(kept, lambda file: file.write(made))
    theirs, ours = twin.kept(flow, wanted, kept), twin.ours(flow, wanted, report)
    checks, source = [], "twin: mesh twice as fine, half the time step, same noise"
    for of in wanted.of:
        name, kind = of.split()
        mine, other = (reference.of_moments(found[name], kind) for found in (ours, theirs))
        share, error = wanted.tolerance * abs(other), theirs[name].error if kind == "mean" else 0.0
        if error > share:
            checks.append(Check(of, mine, other, error, "absolute", f"{source}; its confidence interval"))
        else:
            checks.append(Check(of, mine, other, wanted.tolerance, "relative", source))
    return checks


def _change(name: str, ours: float, theirs: float, reference: Forced) -> Check:
    source = "mesh twice as fine, half the time step"
    if reference.tolerance * abs(theirs) < reference.floor:
        return Check(name, ours, theirs, reference.floor, "absolute", source)
    return Check(name, ours, theirs, reference.tolerance, "relative", source)


def orders(scheme: Scheme) -> list[Check]:
    """Observed orders of convergence of a scheme on a drifting Taylor-Green vortex."""
    velocity, pressure = exact.orders_in_space()
    found = {
        "order of velocity in space": (velocity, 2.8),
        "order of pressure in space": (pressure, 1.8),
        "order of velocity in time": (exact.order_in_time(scheme), scheme.order - 0.1),
    }
    source = "exact Navier-Stokes solution, L2"
    return [Check(name, ours, least, 0.0, "at least", source) for name, (ours, least) in found.items()]
