"""The baseline of a case, what every run starts from: mesh, start states, mean flow, statistics, what it withstands."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from manywake.case import describe
from manywake.case.case import Case
from manywake.case.sensors import Energy
from manywake.flow import batch as batches
from manywake.flow import mesh as meshes
from manywake.flow import operators, problem, spinup, stability, statistics, steady
from manywake.flow.batch import Start
from manywake.flow.mesh import Mesh
from manywake.flow.operators import Operators
from manywake.flow.problem import Problem
from manywake.flow.spinup import FreeFlows, Progress
from manywake.flow.stability import Withstood
from manywake.flow.statistics import Kind, Statistics
from manywake.flow.steady import SteadyFlow
from manywake.machine import disk

FORMAT = 5
MEAN_PERIODS = 12
AVERAGED = 200.0
"""Time over which a flow that is not periodic is averaged, in L / U."""
LATER = 20.0
"""Time from one of the states that `phases` gives of a flow that is not periodic to the next, in L / U."""
PHASES = 4
"""Start states of a periodic flow for each that is kept, evenly spread over a period from it on."""
APART = 4
"""Start states that are kept of an aperiodic flow: those of two kicks and of their mirrors."""
SPIN_UPS = ((1, "rest"), (2, "rest"), (2, "the steady flow"), (4, "the steady flow"))
"""How a spin-up is tried, one way after another where it blows up: parts that the step is cut into, and from what."""
_NUMBERS = ("flow_digest", "geometry_digest", "steady", "recipe")


@dataclass(frozen=True)
class Baseline:
    """The uncontrolled flow of one case; fields are in scikit-fem's order, doubles that singles can hold when made.

    starts: states of the developed flow, far apart; of a periodic one those that are no phases of each other. The first
    is the start state. mean: (n, 2) velocity, with which `Scheme.mean` advects. fluctuation: (n,) largest deviation
    from it under full forcing, with which `Scheme.damping` damps. statistics: of the uncontrolled flow. steady:
    readings of the steady flow, the drag that remains with all shedding gone. withstood: what the stability run found.
    still: (n, 2) velocity of the steady flow, kept where a sensor measures the energy about it, else None.
    """

    flow_digest: str
    geometry_digest: str
    mesh: Mesh
    starts: tuple[Start, ...]
    mean: np.ndarray
    fluctuation: np.ndarray
    statistics: Statistics
    steady: dict[str, float]
    withstood: Withstood
    recipe: str
    still: np.ndarray | None = None

    @property
    def start(self) -> Start:
        return self.starts[0]

    @property
    def free(self) -> dict[str, float]:
        """Mean of each reading by name, without control."""
        return self.statistics.means

    @property
    def shown(self) -> tuple[str, ...]:
        """Readings that pictures show: drag and lift, or at most two of what else the case measures."""
        if "c_d" in self.free:
            return "c_d", "c_l"
        return tuple([name for name in self.steady if name != "power"][::-1][:2]) or ("power",)

    @property
    def advecting(self) -> tuple[np.ndarray, ...]:
        """Mean flow and fluctuation, and the steady flow where it is kept: what `assemble` makes operators with."""
        return (self.mean, self.fluctuation, *(() if self.still is None else (self.still,)))

    def arrays(self) -> dict[str, np.ndarray]:
        parts = {f"start_{name}": np.stack([getattr(start, name) for start in self.starts]) for name in _parts()}
        parts |= {"mean": self.mean, "fluctuation": self.fluctuation}
        parts |= {} if self.still is None else {"still": self.still}
        named = {
            name: part.astype(np.float32) if (part == _single(part)).all() else part for name, part in parts.items()
        }
        named |= {f"boundary_{name}": facets.astype(np.int32) for name, facets in self.mesh.boundaries.items()}
        named |= {"points": self.mesh.points, "triangles": self.mesh.triangles.astype(np.int32)}
        return named | {"samples": self.withstood.samples}

    def numbers(self) -> dict[str, Any]:
        """Return everything that is no array, as plain data."""
        plain = {name: getattr(self, name) for name in _NUMBERS}
        return plain | {"statistics": self.statistics.plain(), "withstood": self.withstood.plain()}

    def digest(self) -> str:
        """Return a hash: two baselines with the same start every run from the same bits."""
        numbers = json.dumps(self.numbers(), sort_keys=True).encode()
        return disk.digest(self.arrays() | {"numbers": np.frombuffer(numbers, np.uint8)})


def assemble(
    case: Case,
    posed: Problem,
    mean: np.ndarray | None,
    fluctuation: np.ndarray | None = None,
    still: np.ndarray | None = None,
    *,
    precision: type = np.float32,
) -> Operators:
    """Return the operators of a case's problem that advect with a mean flow and damp where the flow departs from it.

    still: (n, 2) velocity of the steady flow, for a sensor that measures the energy about it.
    """
    how = case.scheme, case.dt, case.viscosity, mean, fluctuation
    return operators.assemble(posed, *how, case.sensors, still, precision)


def make(case: Case, mesh: Mesh | None = None, progress: Progress | None = None) -> Baseline:
    """Compute the baseline of a case: mesh it (unless given), solve for the steady flow, spin up, average, force.

    A scheme that advects with the mean flow has the steady flow in its place until there is a street to average.
    """
    report = progress or (lambda what, share: None)
    report("mesh", 0.0)
    posed = problem.pose(case, meshes.build(case) if mesh is None else mesh)
    report("mesh", 1.0)
    base = steady.solve(case, posed, report)
    found, mean, states, recipe = _street(case, posed, base, report)
    mean, still, states = _single(mean), _kept(case, base.u), [_rounded(state) for state in states]
    report("fluctuation", 0.0)
    largest = _fluctuation(case, posed, mean, still, states, found)
    report("fluctuation", 1.0)
    ops = assemble(case, posed, mean, largest, still)
    flows = FreeFlows(case, ops, states, base.u)
    kind, record = spinup.settle(flows, spinup.BLOCK, report, "spin-up about the mean")
    starts, free = _recorded(flows, kind, record, report)
    starts = tuple(_rounded(start) for start in starts)
    tried = stability.withstood(case, ops, spread(ops, starts, free.period), free.period, report)
    digests = describe.flow_digest(case), describe.geometry_digest(case)
    recipe += f"; {spinup.BLOCK:g} L/U and more about that mean; {kind}; steady flow by Newton"
    without = base.readings | {"power": 0.0}
    return Baseline(*digests, posed.space.mesh, starts, mean, largest, free, without, tried, recipe, still)


def _kept(case: Case, u: np.ndarray) -> np.ndarray | None:
    """Return the velocity of the steady flow as it is kept, None where no sensor asks for it."""
    return _single(u) if any(isinstance(sensor, Energy) for sensor in case.sensors) else None


def _street(case: Case, posed: Problem, base: SteadyFlow, report: Progress):
    """Spin up about the steady flow: from rest, or from that flow and at a smaller step where the spin-up blows up.

    Returns the period if there is one, the mean flow (n, 2), the last states, and how that was done.
    """
    still = Start(base.u, base.u, base.p, *np.zeros((2, len(base.p))))
    ways = SPIN_UPS if case.bodies else dict.fromkeys((parts, "the steady flow") for parts, _ in SPIN_UPS)
    for parts, begin in ways:
        chosen = replace(case, time_step=case.dt / parts)
        ops = assemble(chosen, posed, base.u, still=_kept(case, base.u))
        kicks = spinup.kicks(case, ops, None if begin == "rest" else still)
        flows = FreeFlows(chosen, ops, kicks, base.u)
        try:
            kind, record = spinup.settle(flows, case.spin_up, report, "spin-up")
            break
        except spinup.BlewUp:
            if (parts, begin) == SPIN_UPS[-1]:
                raise
    period = statistics.period(record[flows.clock][:, 0], ops.time_step) if kind == "periodic" else None
    mean = base.u
    if kind != "steady":
        over = MEAN_PERIODS * period if period else AVERAGED * case.convective_time
        mean = spinup.average(flows, over, report, "mean flow")
    recipe = f"format {FORMAT}; {flows.flows} flows from {begin}, kicked, {case.scheme.name} in steps of {chosen.dt:g}"
    return period, mean, [spinup.rescaled(state, parts) for state in flows.states()], recipe


def _fluctuation(
    case: Case,
    posed: Problem,
    mean: np.ndarray,
    still: np.ndarray | None,
    states: list[Start],
    period: float | None,
) -> np.ndarray:
    """Return the largest departure from the mean flow (n,) under forcing, at half the step or less."""
    if not case.scheme.damping:
        return np.zeros(len(mean))
    for parts in (2, 4, 8):
        ops = assemble(replace(case, time_step=case.dt / parts), posed, mean, still=still)
        starts = [spinup.rescaled(state, 1 / parts) for state in states]
        largest = stability.fluctuation(case, ops, starts, mean, period)
        if np.isfinite(largest).all():
            return _single(largest)
    raise RuntimeError(
        f"baseline: the flow blows up under its inputs at steps of {case.dt / parts:g}; lower their limits, or the step"
    )


def _recorded(flows: FreeFlows, kind: Kind, last: dict[str, np.ndarray], report: Progress):
    """Advance to the start states; return a list of them and the statistics of what follows. last: record so far."""
    dt, unit = flows.ops.time_step, flows.case.convective_time
    if kind == "steady":
        return flows.states()[:1], statistics.uncontrolled(last, flows.clock, dt, kind)
    if kind == "aperiodic":
        starts = flows.states()[:APART]
        return starts, statistics.uncontrolled(flows.run(AVERAGED, report, "statistics"), flows.clock, dt, kind)
    kept = spinup.apart(last)
    period = statistics.period(last[flows.clock][:, 0], dt) / unit
    _to_crossing(flows, last[flows.clock][:, 0])
    starts = [flows.batch.state(column) for column in kept]
    record = flows.run((1 + MEAN_PERIODS) * period, report, "statistics")
    kept_record = {name: series[:, kept] for name, series in record.items()}
    return starts, statistics.uncontrolled(kept_record, flows.clock, dt, kind)


def _to_crossing(flows: FreeFlows, signal: np.ndarray) -> None:
    """Advance to the next upward crossing of the middle of the first flow's lift: a state of defined phase."""
    level, previous = 0.5 * (signal.max() + signal.min()), signal[-1]
    for _ in range(5 * len(signal)):
        now = flows.advance(1)[flows.clock][0, 0]
        if previous < level <= now:
            return
        previous = now
    raise RuntimeError(f"baseline: {flows.clock} stopped oscillating; spin up for longer (spin_up)")


def _single(x: np.ndarray) -> np.ndarray:
    """Return numbers rounded to singles, as they are kept."""
    return x.astype(np.float32).astype(np.float64)


def _rounded(start: Start) -> Start:
    return Start(**{name: _single(part) for name, part in vars(start).items()})


def phases(ops: Operators, baseline: Baseline, count: int, unit: float) -> list[Start]:
    """Return `count` states of the uncontrolled flow: of a periodic one spread evenly over a period from the start on.

    Of others they are states that the start states come to without control, 20 L / U later, 40 and so on. unit: L / U.
    """
    period = baseline.statistics.period
    if period is not None:
        return spread(ops, [baseline.start], period, count)
    later = batches.started(ops, baseline.starts, min(len(baseline.starts), count))
    states: list[Start] = []
    while len(states) < count:
        spinup.free_run(later, round(LATER * unit / ops.time_step))
        states += [later.state(column) for column in range(later.flows)]
    return states[:count]


def spread(ops: Operators, starts: Sequence[Start], period: float | None, count: int = PHASES) -> list[Start]:
    """Return the states that periodic flows come to at `count` phases of a period, those of one phase together.

    Without a period they are the starts as they are.
    """
    if period is None:
        return list(starts)
    flow, states = batches.started(ops, starts, len(starts)), []
    for steps in np.diff([round(k * period / ops.time_step / count) for k in range(count)], prepend=0):
        spinup.free_run(flow, steps)
        states += [flow.state(column) for column in range(flow.flows)]
    return states


def save(baseline: Baseline, path: Path) -> None:
    """Write a baseline atomically: either the whole file is there or none."""
    named = disk.packed(baseline.numbers() | {"digest": baseline.digest()}, baseline.arrays())
    disk.write(path, lambda file: disk.save(file, named))


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
            parts = [data[f"start_{name}"].astype(np.float64) for name in _parts()]
            tried = about["withstood"]
            found = Baseline(
                mesh=Mesh(data["points"], data["triangles"].astype(np.int64), boundaries, meshes.curves(case, names)),
                starts=tuple(Start(*part) for part in zip(*parts, strict=True)),
                mean=data["mean"].astype(np.float64),
                fluctuation=data["fluctuation"].astype(np.float64),
                statistics=statistics.restored(about["statistics"]),
                withstood=Withstood(tried["held"], tried["smooth"], tuple(tried["names"]), data["samples"]),
                still=data["still"].astype(np.float64) if "still" in data.files else None,
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


def _parts() -> list[str]:
    return [field.name for field in fields(Start)]
