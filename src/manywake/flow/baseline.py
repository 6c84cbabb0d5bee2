"""The baseline of a case, what every run starts from: mesh, start state, time-mean flow, uncontrolled statistics."""

import json
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from manywake.case import describe
from manywake.case.case import Case
from manywake.case.geometry import outline
from manywake.flow import mesh as meshes
from manywake.flow import operators, problem, readings, statistics, steady
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.mesh import Mesh
from manywake.flow.operators import Operators
from manywake.flow.problem import Problem
from manywake.flow.statistics import Shedding
from manywake.machine import disk

FORMAT = 2
MEAN_PERIODS = 12
SETTLE = 40.0
"""Time for which a street goes on once it is advected with its mean, in L / U."""
_CHUNK, _SAMPLE = 50, 10
_RECENT = 50.0
"""Time over which the spin-up knows its own C_L, in L / U: a few shedding periods."""
_NUMBERS = ("flow_digest", "geometry_digest", "free", "steady", "recipe")
Progress = Callable[[str, float], None]
"""progress(what, share done): called now and then by work that takes long."""


@dataclass(frozen=True)
class Baseline:
    """The uncontrolled flow of one case; fields are in scikit-fem's order.

    start: the developed street at an upward crossing of C_L. mean: (n, 2) velocity averaged over whole periods, with
    which `Scheme.mean` advects. free: mean of each reading by name, without control. steady: readings of the steady
    base flow, the drag that remains with all shedding gone.
    """

    flow_digest: str
    geometry_digest: str
    mesh: Mesh
    start: Start
    mean: np.ndarray
    shedding: Shedding
    free: dict[str, float]
    steady: dict[str, float]
    recipe: str

    def arrays(self) -> dict[str, np.ndarray]:
        named = {f"start_{name}": part for name, part in vars(self.start).items()}
        named |= {f"boundary_{name}": facets.astype(np.int32) for name, facets in self.mesh.boundaries.items()}
        named |= {"points": self.mesh.points, "triangles": self.mesh.triangles.astype(np.int32)}
        return named | {"mean": self.mean}

    def numbers(self) -> dict[str, Any]:
        """Return everything that is no array, as plain data."""
        return {name: getattr(self, name) for name in _NUMBERS} | {"shedding": vars(self.shedding)}

    def digest(self) -> str:
        """Return a hash: two baselines with the same start every run from the same bits."""
        numbers = json.dumps(self.numbers(), sort_keys=True).encode()
        return disk.digest(self.arrays() | {"numbers": np.frombuffer(numbers, np.uint8)})


def assemble(case: Case, posed: Problem, mean: np.ndarray | None, precision: type = np.float32) -> Operators:
    """Return the operators of a case's problem that advect with a mean flow."""
    return operators.assemble(posed, case.scheme, case.dt, case.viscosity, mean, case.sensors, precision)


def make(case: Case, mesh: Mesh | None = None, progress: Progress | None = None) -> Baseline:
    """Compute the baseline of a case: mesh it (unless given), solve for the steady flow, spin up, and average.

    A scheme that advects with the mean flow has the steady flow in its place until there is a street to average.
    """
    if not case.bodies:
        raise ValueError("baseline: got a case without a body, wanted one whose lift tells how far its shedding is")
    report, unit = progress or (lambda what, share: None), case.convective_time
    report("mesh", 0.0)
    posed = problem.pose(case, meshes.build(case) if mesh is None else mesh)
    report("steady flow", 0.0)
    base = steady.solve(case, posed, report)
    ops = assemble(case, posed, base.u)
    flow, advecting = FlowBatch(ops, kicked(case, ops), 1), None
    recent = min(_RECENT, 2 / 3 * case.spin_up)  # before that it is the kick that dies down
    c_l = _develop(flow, case.spin_up * unit, recent * unit, report, "spin-up")
    recipe = f"format {FORMAT}; kicked rest, over {case.spin_up:g} L/U in steps of {case.dt:g} ({case.scheme.name})"
    if case.scheme.mean:
        advecting, _ = _average(flow, c_l, report, "mean flow")
        flow = FlowBatch(assemble(case, posed, advecting), flow.state(0), 1)
        c_l = _develop(flow, SETTLE * unit, _RECENT * unit, report, "spin-up about the mean")
        recipe += f" about the steady flow, mean over {MEAN_PERIODS} periods, over {SETTLE:g} L/U more about that mean"
    _to_crossing(flow, c_l)
    start = flow.state(0)
    mean, record = _average(flow, c_l, report, "mean flow" if advecting is None else "statistics")
    recipe += f", stopped at an upward crossing of C_L; means sample every {_SAMPLE}th step; steady flow by Newton"
    statistic, free = uncontrolled(record, case.dt)
    kept = mean if advecting is None else advecting
    still, digests = base.readings | {"power": 0.0}, (describe.flow_digest(case), describe.geometry_digest(case))
    return Baseline(*digests, posed.space.mesh, start, kept, statistic, free, still, recipe)


def uncontrolled(record: dict[str, np.ndarray], time_step: float) -> tuple[Shedding, dict[str, float]]:
    """Return the statistics of uncontrolled readings (steps,), and the mean of each, over whole periods."""
    whole = statistics.whole_periods(clock(record))
    found = statistics.shedding(record["c_d"], record["c_l"], time_step, clock(record))
    return found, {name: float(series[whole].mean()) for name, series in record.items()}


def clock(record: dict[str, np.ndarray]) -> np.ndarray:
    """Return the lift of the first body, by which periods are told: the sum of several may be steady."""
    return next(series for name, series in record.items() if name.startswith("c_l."))


def _develop(flow: FlowBatch, duration: float, recent: float, report: Progress, what: str) -> np.ndarray:
    """Advance an uncontrolled flow; return its C_L over the time `recent`, the last."""
    steps, c_l = round(duration / flow.ops.time_step), np.zeros(0)
    for done in range(0, steps, _CHUNK):
        c_l = np.concatenate([c_l, clock(free_run(flow, _CHUNK))])[-int(recent / flow.ops.time_step) :]
        if not np.isfinite(c_l[-1]):
            at, dt = (done + _CHUNK) * flow.ops.time_step, flow.ops.time_step
            raise RuntimeError(f"baseline: the flow blew up by time {at:g} of its {what}; halve the time step {dt:g}")
        report(what, min((done + _CHUNK) / steps, 1.0))
    return c_l


def _to_crossing(flow: FlowBatch, c_l: np.ndarray) -> None:
    """Advance to the next upward crossing of the middle of C_L, step by step: a state of defined phase."""
    level, previous = 0.5 * (c_l.max() + c_l.min()), c_l[-1]
    for _ in range(5 * len(c_l)):
        now = clock(free_run(flow, 1))[0]
        if previous < level <= now:
            return
        previous = now
    raise RuntimeError("baseline: C_L does not oscillate; is the flow steady at this Reynolds number?")


def _average(flow: FlowBatch, c_l: np.ndarray, report: Progress, what: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Advance over MEAN_PERIODS; return the mean velocity (n, 2), and the readings (steps,) of a little more."""
    period = statistics.shedding(c_l, c_l, flow.ops.time_step).period
    samples = round(MEAN_PERIODS * period / flow.ops.time_step / _SAMPLE)
    total, series = np.zeros((len(flow.ops.velocity_order), 2)), []
    for k in range(samples + 2):
        series.append(free_run(flow, _SAMPLE))
        if k < samples:
            total += flow.state(0).u
        report(what, min(k / samples, 1.0))
    return total / samples, readings.joined(series)


def free_run(flow: FlowBatch, steps: int) -> dict[str, np.ndarray]:
    """Advance a single uncontrolled flow; return its readings by name, (steps,)."""
    still = np.zeros((steps, len(flow.ops.inputs), 1))
    return {name: part[:, 0] for name, part in readings.named(flow.ops, flow.advance(still), still).items()}


def kicked(case: Case, ops: Operators) -> Start:
    """Return fluid at rest but for an upward gust behind the bodies, so that shedding sets in at once."""
    (x, y), length = ops.space.x.T, case.scales.length
    around = np.concatenate([outline(body) for body in case.bodies])
    (_, low), (back, high) = around.min(axis=0), around.max(axis=0)
    distance = (x - back - length) ** 2 + (y - 0.5 * (low + high)) ** 2
    u = np.stack([np.zeros_like(x), 0.3 * case.scales.velocity * np.exp(-distance / (0.5 * length) ** 2)], axis=1)
    u[ops.velocity_order[ops.free :]] = 0.0
    return Start(u, u.copy(), *np.zeros((3, len(ops.pressure_order))))


def phases(ops: Operators, baseline: Baseline, count: int) -> list[Start]:
    """Return `count` states of the uncontrolled flow, spread evenly over one shedding period from the start state."""
    flow, period, states = FlowBatch(ops, baseline.start, 1), baseline.shedding.period / ops.time_step, []
    for steps in np.diff([round(k * period / count) for k in range(count)], prepend=0):
        free_run(flow, steps)
        states.append(flow.state(0))
    return states


def save(baseline: Baseline, path: Path) -> None:
    """Write a baseline atomically: either the whole file is there or none."""
    named = disk.packed(baseline.numbers() | {"digest": baseline.digest()}, baseline.arrays())
    disk.write(path, lambda file: np.savez_compressed(file, **named))


def load(path: Path, case: Case) -> Baseline:
    """Read a case's baseline; ValueError when the file is damaged, is not what its hash says, or is of another flow."""
    found = read(path, case)
    if found.flow_digest != describe.flow_digest(case):
        raise ValueError(
            f"baseline: {path} is of another flow than this case; make it anew with: manywake baseline --make FILE"
        )
    return found


def read(path: Path, case: Case) -> Baseline:
    """Read a baseline on the geometry of a case, of whichever flow it is."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
            about = disk.description(data)
            names = [key.removeprefix("boundary_") for key in data.files if key.startswith("boundary_")]
            boundaries = {name: data[f"boundary_{name}"].astype(np.int64) for name in names}
            found = Baseline(
                mesh=Mesh(data["points"], data["triangles"].astype(np.int64), boundaries, meshes.curves(case, names)),
                start=Start(**{f.name: data[f"start_{f.name}"] for f in fields(Start)}),
                mean=data["mean"],
                shedding=Shedding(**about["shedding"]),
                **{name: about[name] for name in _NUMBERS},
            )
    except disk.DAMAGE as error:
        raise ValueError(f"baseline: {path} is damaged ({error}); delete the file and run again") from error
    if found.digest() != about["digest"]:
        raise ValueError(f"baseline: the content of {path} does not match its hash; delete the file and run again")
    return found


def description(path: Path) -> dict[str, Any]:
    """Return the numbers of a baseline file, without its arrays; empty when it is damaged."""
    try:
        with np.load(path, allow_pickle=False) as data:
            return disk.description(data)
    except disk.DAMAGE:
        return {}
