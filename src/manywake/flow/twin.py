"""A disturbed flow against its twin, on a mesh twice as fine at half the time step: the same noise, other errors.

Chance would hide a small difference of two runs. So the twin hears the very series of the flow, straight between its
steps, and begins at its start states.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from manywake.case import describe
from manywake.case.references import Twin
from manywake.flow import baseline, forced, problem, readings, statistics
from manywake.flow import batch as batches
from manywake.flow import mesh as meshes
from manywake.flow import space as spaces
from manywake.flow.baseline import Progress
from manywake.flow.batch import FlowBatch
from manywake.flow.disturb import Disturbances
from manywake.flow.statistics import Moments
from manywake.flow.store import Flow

CHUNK = 200
"""Steps of the flow for which its twin is advanced at once."""


def ours(flow: Flow, reference: Twin, report: Progress) -> dict[str, Moments]:
    """Return the statistics of the flow over the last of a run from its start states, by reading."""
    starts, steps = flow.baseline.starts, round(reference.duration / flow.case.dt)
    batch = batches.started(flow.operators, starts, len(starts))
    still = np.zeros((steps, len(flow.case.actuators), len(starts)))
    record = batches.recorded(batch, still, report, "uncontrolled flow")
    return judged(record, reference, flow.case.dt)


def fine(flow: Flow, reference: Twin, report: Progress) -> dict[str, Any]:
    """Compute the twin (a quarter of an hour), its energy about its own steady flow.

    That is what the twin comes to without noise: so there is no factor of the fine mesh's Jacobian.
    """
    case, space, base = flow.case, flow.operators.space, flow.baseline
    steps = round(reference.duration / case.dt)
    chosen = replace(case, time_step=case.dt / 2)
    posed = problem.pose(chosen, meshes.refine(base.mesh))
    onto, _ = spaces.carrying(space, posed.space)
    advecting = [onto @ part for part in base.advecting]
    ops = baseline.assemble(chosen, posed, *advecting)
    if base.still is not None:
        calm = replace(base.start, u=base.still, u_old=base.still)
        batch = FlowBatch(ops, forced.interpolate(space, calm, ops), 1)
        for k in range(0, 2 * steps, CHUNK):
            report("twin's steady flow", k / (2 * steps))
            batch.advance(np.zeros((CHUNK, len(ops.inputs), 1)))
        advecting[-1] = batch.velocity(0)
        ops = baseline.assemble(chosen, posed, *advecting)
    starts = [forced.interpolate(space, start, ops) for start in base.starts]
    batch, noise = batches.started(ops, starts, len(starts)), Disturbances(flow.operators, range(len(starts)))
    before, record = None, []
    for k in range(0, steps, CHUNK):
        report("twin", k / steps)
        heard = noise.series(min(CHUNK, steps - k))
        amplitudes = np.zeros((2 * len(heard), len(ops.inputs), len(starts)))
        amplitudes[:, ops.actuators :] = halved(heard, heard[0] if before is None else before)
        before = heard[-1]
        record.append(readings.named(ops, batch.advance(amplitudes), amplitudes))
    found = judged(readings.joined(record), reference, chosen.dt)
    recipe = (
        f"manywake.flow.twin.fine: every triangle of the mesh cut into four ({len(ops.mesh.triangles)} triangles), "
        f"time step {chosen.dt:g}; {len(starts)} start states interpolated, then {reference.duration:g} units of time, "
        f"of which the first {reference.settle:g} are not averaged; the flow's noise, straight between its steps"
    )
    return {"recipe": recipe, **_identity(flow, reference), "readings": {n: vars(of) for n, of in found.items()}}


def halved(series: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return a series (steps, ...) at half the step, (2 steps, ...); before: the value that it follows."""
    middle = 0.5 * (np.concatenate([before[None], series[:-1]]) + series)
    return np.stack([middle, series], axis=1).reshape(2 * len(series), *series.shape[1:])


def judged(record: dict[str, np.ndarray], reference: Twin, time_step: float) -> dict[str, Moments]:
    """Return the statistics of readings by name, (steps, B), over what follows `settle`."""
    after = {name: series[round(reference.settle / time_step) :] for name, series in record.items()}
    return statistics.uncontrolled(after, next(iter(after)), time_step, "aperiodic").readings


def kept(flow: Flow, reference: Twin, path: Path) -> dict[str, Moments]:
    """Read a twin that was kept; ValueError when there is none, or not one of this flow."""
    if not path.exists():
        raise ValueError(f"twin: {path} is not there; add --recompute, which makes one")
    found = json.loads(path.read_text())
    for key, wanted in _identity(flow, reference).items():
        if found.get(key) != wanted:
            raise ValueError(
                f"twin: got one for {key} {found.get(key)}, wanted {wanted}; add --recompute, which makes one for this "
                "flow"
            )
    return {name: Moments(**of) for name, of in found["readings"].items()}


def _identity(flow: Flow, reference: Twin) -> dict[str, Any]:
    found = {"mesh": flow.baseline.mesh.digest(), "flow": describe.flow_digest(flow.case)}
    return found | {"duration": reference.duration, "settle": reference.settle}
