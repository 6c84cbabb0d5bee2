"""Controlled flows against the same on a mesh twice as fine at half the time step: the change that the inputs make."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from manywake.case.references import Forced
from manywake.case.schemes import BDF2, GODA
from manywake.flow import baseline, problem
from manywake.flow import batch as batches
from manywake.flow import mesh as meshes
from manywake.flow import space as spaces
from manywake.flow.baseline import Progress
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.operators import Operators
from manywake.flow.space import Space
from manywake.flow.store import Flow

FREE = "no control"
RISE = 1 / 60
"""Share of the time before the averages in which held amplitudes rise."""


def risen(t: np.ndarray, settle: float) -> np.ndarray:
    """Return the share of a held amplitude that is there at times t (steps,), after which `settle` is not averaged."""
    return np.minimum(t / (RISE * settle), 1.0)


def names(reference: Forced) -> list[str]:
    """Return what the forcings are called, no control first."""
    return list(_forcings(reference, np.zeros(1)))


def _forcings(reference: Forced, t: np.ndarray) -> dict[str, list[np.ndarray]]:
    """Return the amplitudes (steps,) of the first input under each forcing by name, a flow each."""
    share = risen(t, reference.settle)
    found = {FREE: [0.0 * t]} | {f"Q = {a:g}": [a * share] for a in reference.steady}
    for a, f, phases in reference.harmonic:
        sines = [a * np.sin(2 * np.pi * (f * t + k / phases)) for k in range(phases)]
        found[f"Q = {a:g} sin(2 pi {f:g} t)"] = sines
    return found


def run(
    ops: Operators, start: Start, reference: Forced, mixing: np.ndarray, report: Progress, what: str
) -> dict[str, np.ndarray]:
    """Run all forcings side by side; return the readings by name, (steps, B). mixing: (inputs,) of the first action."""
    dt = ops.time_step
    t = dt * np.arange(1, round(reference.duration / dt) + 1)
    first = np.stack([series for columns in _forcings(reference, t).values() for series in columns], axis=1)
    amplitudes = np.stack([share / mixing[0] * first for share in mixing], axis=1)
    flow = FlowBatch(ops, start, first.shape[1])
    flow.reset(range(flow.flows), seeds=[0] * flow.flows)  # the same disturbances, if any, under all forcings
    return batches.recorded(flow, amplitudes, report, what)


def changes(record: dict[str, np.ndarray], reference: Forced, time_step: float) -> dict[str, dict[str, float]]:
    """Return the change by each forcing of mean C_D and of C_L: its mean where the amplitude is held, else its rms.

    Means are over all that follows `settle`, weighted by sin^4, and over the columns of a forcing: the window's ends
    are smooth, so that no shedding period need be known.
    """
    c_d, c_l = (record[name][round(reference.settle / time_step) :] for name in ("c_d", "c_l"))
    w = np.sin(np.pi * (np.arange(len(c_d)) + 0.5) / len(c_d)) ** 4
    w /= w.sum()
    drag, lift, square = w @ c_d, w @ c_l, w @ c_l**2
    table, column = {}, 0
    for name, columns in _forcings(reference, np.zeros(1)).items():
        mine = slice(column, column + len(columns))
        column += len(columns)
        means = drag[mine].mean(), lift[mine].mean(), np.sqrt(square[mine].mean())
        table[name] = dict(zip(("mean C_D", "mean C_L", "rms C_L"), map(float, means), strict=True))
    free = table.pop(FREE)
    return {
        name: {key: values[key] - free[key] for key in ("mean C_D", "rms C_L" if "sin" in name else "mean C_L")}
        for name, values in table.items()
    }


def fine(flow: Flow, reference: Forced, mixing: np.ndarray, report: Progress) -> dict[str, Any]:
    """Compute the controlled flows on the refined mesh at half the time step, second order in time (10 minutes)."""
    case, space, base = flow.case, flow.operators.space, flow.baseline
    scheme = BDF2 if case.scheme == GODA else case.scheme
    chosen = replace(case, time_step=case.dt / 2, scheme=scheme)
    posed = problem.pose(chosen, meshes.refine(base.mesh))
    onto, _ = spaces.carrying(space, posed.space)
    refined = baseline.assemble(chosen, posed, *(onto @ part for part in base.advecting))
    record = run(refined, interpolate(space, base.start, refined), reference, mixing, report, "fine reference")
    recipe = (
        f"manywake.flow.forced.fine: every triangle of the mesh cut into four ({len(refined.mesh.triangles)} triangles)"
        f", time step {chosen.dt:g}, {scheme.name}; the case's start state interpolated, then {reference.duration:g} "
        f"units of time; changes are means with a sin^4 window over all but the first {reference.settle:g}"
    )
    return {"recipe": recipe, **_identity(flow, reference), "changes": changes(record, reference, chosen.dt)}


def kept(flow: Flow, reference: Forced, path: Path) -> dict[str, Any]:
    """Read a fine reference that was kept; ValueError when there is none, or not one of this flow."""
    if not path.exists():
        raise ValueError(f"fine reference: {path} is not there; add --recompute, which makes one")
    found = json.loads(path.read_text())
    for key, wanted in _identity(flow, reference).items():
        if found[key] != wanted:
            raise ValueError(
                f"fine reference: got one for {key} {found[key]}, wanted {wanted}; "
                "add --recompute, which makes one for this flow (some ten minutes)"
            )
    return found


def _identity(flow: Flow, reference: Forced) -> dict[str, Any]:
    found = {"mesh": flow.baseline.mesh.digest(), "reynolds": flow.case.reynolds, "time_step": flow.case.dt}
    return found | {"duration": reference.duration, "settle": reference.settle, "forcings": names(reference)}


def interpolate(space: Space, start: Start, fine: Operators) -> Start:
    """Return a state on the refined mesh at half the time step, with the fine mesh's boundary values, no control."""
    velocity, pressure = spaces.carrying(space, fine.space)
    u, u_old = velocity @ start.u, velocity @ (0.5 * (start.u + start.u_old))
    for part in (u, u_old):
        part[fine.velocity_order[fine.free :]] = fine.tables.fixed
        part[fine.slip] = 0.0
    return Start(u, u_old, pressure @ start.p, pressure @ start.phi / 2, pressure @ start.phi_old / 2)
