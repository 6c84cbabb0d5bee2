"""How each kind of reference is computed. Several references of one flow share its run."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np

from manywake.case import references
from manywake.case.references import (
    Driven,
    Extremum,
    Growth,
    Length,
    Number,
    Response,
    Settled,
    Statistic,
    Steady,
)
from manywake.flow import baseline, forced, probe, problem, readings, spinup, statistics, steady, store
from manywake.flow import batch as batches
from manywake.flow.baseline import Progress
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.probe import Field
from manywake.flow.problem import Problem
from manywake.flow.statistics import Moments, Statistics
from manywake.flow.steady import SteadyFlow
from manywake.flow.store import Flow

STEADY = 1e-5
"""The flow is steady when C_D moved less than this during ten L / U; rounding to singles moves it by 3e-6..."""
STEADY_MOST = 600.0
"""...which must be so before this time, in L / U."""
PERIODIC = 120.0
"""How long the uncontrolled flow runs for its statistics, in L / U: about 36 shedding periods of a cylinder."""
SMALL = 0.01
"""A disturbance of the steady flow is a gust of this strength, in U..."""
FOLLOWED = 200.0
"""...that is followed for this time, in L / U, ..."""
LARGE, FADED = 0.01, 1e-4
"""...or until its rms over the domain exceeds this, in U, or is less than this share of the first, ..."""
SAMPLED = 0.5
"""...and that is measured every so often, in L / U."""
CHUNK = 1000
Record = dict[str, np.ndarray]


@dataclass(frozen=True)
class Check:
    """One line of the table. `tolerance` is relative or absolute as `kind` says; for others it is 0.

    kind: "reported" passes whatever it is.
    """

    name: str
    ours: float
    reference: float
    tolerance: float
    kind: Literal["relative", "absolute", "at least", "at most", "reported"]
    source: str

    @property
    def passed(self) -> bool:
        """Whether ours agrees with the reference; never when ours is not a number, but for what is reported only."""
        if self.kind == "reported":
            return True
        if self.kind in ("at least", "at most"):
            return bool(self.ours >= self.reference if self.kind == "at least" else self.ours <= self.reference)
        scale = abs(self.reference) if self.kind == "relative" else 1.0
        return bool(abs(self.ours - self.reference) <= self.tolerance * scale)


def agrees(name: str, ours: float, value: float, tolerance: float | None, source: str) -> Check:
    """Return the check of a number against its reference: relative, or reported where there is no tolerance."""
    if tolerance is None:
        return Check(name, ours, value, 0.0, "reported", source)
    return Check(name, ours, value, tolerance, "relative", source)


class Runs:
    """The flows that references are of, each run once, when it is first asked for."""

    def __init__(self, flow: Flow, report: Progress):
        self.flow, self.case, self.report = flow, flow.case, report
        self.posed: Problem = problem.pose(flow.case, flow.baseline.mesh)
        self.record, self.growth = cache(self._record), cache(self._growth)
        self.statistics, self.steady = cache(self._statistics), cache(self._steady)
        self.response, self.driven = cache(self._response), cache(self._driven)

    def _at(self, reynolds: float | None, time_step: float | None) -> Flow:
        """Return the flow of another Reynolds number or time step, without actuators; made if need be, and cached."""
        if reynolds in (None, self.case.reynolds) and time_step in (None, self.case.dt):
            return self.flow
        re, dt = reynolds or self.case.reynolds, time_step or self.case.time_step
        case = replace(self.case, reynolds=re, time_step=dt, actuators=(), sensors=())
        return store.flow(case, lambda what, share: self.report(f"Re {re:g}, {what}", share))

    def _record(self, reynolds: float | None, time_step: float | None) -> tuple[Record, statistics.Kind, float]:
        """Return readings of the uncontrolled flow over `PERIODIC`, (steps, flows) by name, its kind and time step.

        An aperiodic flow is several flows, from all start states.
        """
        flow = self._at(reynolds, time_step)
        base, case, kind = flow.baseline, flow.case, flow.baseline.statistics.kind
        starts = base.starts if kind == "aperiodic" else base.starts[:1]
        batch = batches.started(flow.operators, starts, len(starts))
        steps = round(PERIODIC * case.convective_time / case.dt)
        amplitudes = np.zeros((steps, len(case.actuators), len(starts)))
        record = batches.recorded(batch, amplitudes, self.report, f"uncontrolled flow, Re {case.reynolds:g}")
        return record, kind, case.dt

    def _statistics(self, reynolds: float | None, time_step: float | None) -> Statistics:
        """Return the statistics of the uncontrolled flow, of all its flows together."""
        return self.judged(*self.record(reynolds, time_step))

    def lift(self, reynolds: float | None, time_step: float | None) -> float:
        """Return how far a flow's mean C_L is from zero, on average over flows: their mirror states do not cancel."""
        record, kind, dt = self.record(reynolds, time_step)
        each = [{name: series[:, [b]] for name, series in record.items()} for b in range(record["c_l"].shape[1])]
        return float(np.mean([abs(self.judged(flow, kind, dt)["c_l"].mean) for flow in each]))

    def judged(self, record: Record, kind: statistics.Kind, dt: float) -> Statistics:
        clock = spinup.clock(self.case)
        if clock not in record:  # without bodies nothing tells periods
            clock, kind = next(iter(record)), "aperiodic" if kind == "periodic" else kind
        return statistics.uncontrolled(record, clock, dt, kind)

    def _steady(self, reynolds: float | None) -> SteadyFlow:
        re = reynolds or self.case.reynolds
        told = replace(self.case, reynolds=re)
        return steady.solve(told, self.posed, lambda what, share: self.report(f"Re {re:g}, {what}", share))

    def _growth(self, reynolds: float | None, time_step: float | None) -> float:
        """Return the rate, in U / L, at which two flows part that begin at the steady flow, kicked up and down.

        Half their difference is a disturbance to second order, whatever the time loop itself changes in the steady
        flow. The logarithm of its rms is fitted by a line over the last half of the run.
        """
        case = replace(self.case, actuators=(), disturbances=(), sensors=())
        case = replace(case, reynolds=reynolds or case.reynolds, time_step=time_step or case.time_step)
        base, posed = self.steady(reynolds), problem.pose(case, self.flow.baseline.mesh)
        ops, still = baseline.assemble(case, posed, base.u), Start(base.u, base.u, base.p, *np.zeros((2, len(base.p))))
        batch = batches.started(ops, [spinup.kicked(case, ops, sign * SMALL, still) for sign in (1.0, -1.0)], 2)
        steps, mass = max(round(SAMPLED * case.convective_time / case.dt), 1), posed.space.mass

        def size() -> float:
            u = (batch.velocity(0) - batch.velocity(1)) / (2 * case.scales.velocity)
            return float(np.sqrt(np.sum(u * (mass @ u)) / posed.space.velocity.dx.sum()))

        every = [size()]
        while len(every) < FOLLOWED / SAMPLED and FADED * every[0] < every[-1] < LARGE:  # ends where it blew up, too
            spinup.free_run(batch, steps)
            every.append(size())
            self.report(f"disturbance, Re {case.reynolds:g}", len(every) * SAMPLED / FOLLOWED)
        last = np.log(every[len(every) // 2 :])
        time = case.dt / case.convective_time * steps * np.arange(len(last))
        return float(np.polyfit(time, last, 1)[0]) if np.isfinite(last).all() else np.nan

    def _batch(self, time_step: float | None, start: Start | None = None) -> FlowBatch:
        """Return one flow at some time step, from a start at that step, else from the start state."""
        dt, base = time_step or self.case.dt, self.flow.baseline
        ops = self.flow.operators
        if dt != self.case.dt:
            ops = baseline.assemble(replace(self.case, time_step=dt), self.posed, *base.advecting)
        return FlowBatch(ops, start or spinup.rescaled(base.start, dt / self.case.dt), 1)

    def _response(self, amplitudes: tuple[float, ...], settle: float, duration: float, time_step: float | None):
        """Return the readings by name, (steps, 1), with the actuators held, and the time step."""
        batch, unit = self._batch(time_step), self.case.convective_time
        dt = batch.ops.time_step
        t = dt * np.arange(1, round(duration * unit / dt) + 1)
        series = forced.risen(t, settle * unit)[:, None, None] * np.array(amplitudes)[None, :, None]
        held = f"held at {', '.join(f'{a:g}' for a in amplitudes)}"
        return batches.recorded(batch, series, self.report, held), dt

    def _driven(self, driving: Callable, duration: float, time_step: float | None) -> tuple[Record, Start]:
        """Return the readings by name, (steps, 1), of a flow from rest whose inputs are driven, and its last state."""
        n, m = len(self.posed.space.x), len(self.posed.space.mesh.points)
        batch = self._batch(time_step, Start(*np.zeros((2, n, 2)), *np.zeros((3, m))))
        dt, inputs, record = batch.ops.time_step, len(self.case.inputs), []
        series = np.array([driving(k * dt) for k in range(1, round(duration / dt) + 1)], dtype=float)
        if series.shape[1:] != (inputs,):
            raise ValueError(f"driving: got {series.shape[1:]} amplitudes, wanted {inputs}, one for each input")
        for k in range(0, len(series), CHUNK):
            self.report("driven flow", k / len(series))
            chunk = series[k : k + CHUNK, :, None]
            record.append(readings.named(batch.ops, batch.advance(chunk), chunk))
        self.report("driven flow", 1.0)
        return readings.joined(record), batch.state(0)


def checks(runs: Runs, reference: Number | Settled) -> list[Check]:
    """Return the checks of one reference, but for `Forced` and `Twin`."""
    if isinstance(reference, Settled):
        return settled(runs, reference)
    ours = number(runs, reference)
    if isinstance(reference, Statistic | Response | Growth) and reference.of in references.JUDGED:
        return [Check(reference.name, ours, reference.value, 0.0, "absolute", reference.source)]
    return [agrees(reference.name, ours, reference.value, reference.tolerance, reference.source)]


def number(runs: Runs, reference: Number) -> float:
    """Return our value of a reference."""
    case, speed = runs.case, runs.case.scales.velocity
    match reference:
        case Statistic() if reference.of == "lifts":
            return float(runs.lift(reference.reynolds, reference.time_step) > references.LIFTS)
        case Statistic():
            found = runs.statistics(reference.reynolds, reference.time_step)
            return statistic(found, reference.of, case.convective_time)
        case Steady():
            return runs.steady(reference.reynolds).readings[reference.of]
        case Growth():
            rate = runs.growth(reference.reynolds, reference.time_step)
            return rate if reference.of == "rate" or np.isnan(rate) else float(rate > 0)
        case Extremum():
            component, kind = reference.of.split()
            field = Field(runs.posed.space, runs.steady(reference.reynolds).u)
            along = reference.start, reference.end, "uv".index(component), 1.0 if kind == "max" else -1.0
            return probe.extremum(field, *along) / speed
        case Length():
            field = Field(runs.posed.space, runs.steady(reference.reynolds).u)
            side = references.wall(case, reference)
            lengths = probe.changes(field, side, reference.start, reference.end) / case.scales.length
            there = -len(lengths) <= reference.change < len(lengths)
            return float(lengths[reference.change]) if there else np.nan
        case Response():
            return _response(runs, reference)
        case Driven():
            record, last = runs.driven(reference.driving, reference.duration, reference.time_step)
            if reference.points is not None:
                front, back = steady.pressure_at(runs.posed.space, last.p, list(reference.points))
                return float(front - back) / speed**2
            reading, kind = reference.of.split()
            return moment(record[reading], kind)


def statistic(found: Statistics, of: str, convective_time: float) -> float:
    """Return a statistic by what a reference calls it; not a number where there is no period."""
    if of == "St":
        return convective_time / found.period if found.period else np.nan
    reading, kind = of.split()
    return of_moments(found[reading], kind)


def of_moments(moments: Moments, kind: str) -> float:
    """Return a number of a reading: its mean, max, min, rms or amplitude."""
    if kind == "amplitude":
        return 0.5 * (moments.high - moments.low)
    return getattr(moments, {"max": "high", "min": "low"}.get(kind, kind))


def moment(series: np.ndarray, kind: str) -> float:
    """Return the mean, max, min, rms or amplitude of a series."""
    if kind == "amplitude":
        return float(0.5 * np.ptp(series))
    return float(np.sqrt(np.mean(series**2)) if kind == "rms" else getattr(series, kind)())


def _response(runs: Runs, reference: Response) -> float:
    unit = runs.case.convective_time
    how = tuple(reference.amplitudes), reference.settle, reference.duration, reference.time_step
    record, dt = runs.response(*how)
    if not all(np.isfinite(series).all() for series in record.values()):
        return np.nan
    if reference.of == "sheds":
        last = record["c_l"][-round(references.SHEDDING * unit / dt) :]
        return float(moment(last, "amplitude") > references.SHEDS)
    after = {name: series[round(reference.settle * unit / dt) :] for name, series in record.items()}
    kind = spinup.kind(after, spinup.clock(runs.case)) if runs.case.bodies else "aperiodic"
    return statistic(runs.judged(after, kind, dt), reference.of, unit)


def settled(runs: Runs, reference: Settled) -> list[Check]:
    """The start state must settle to the steady flow at the reference's Reynolds number."""
    flow, posed, case = runs.flow, runs.posed, runs.case
    ops = baseline.assemble(replace(case, reynolds=reference.reynolds), posed, *flow.baseline.advecting)
    batch, unit = FlowBatch(ops, flow.baseline.start, 1), round(10.0 * case.convective_time / case.dt)
    wanted, found = {f"{reference.name} {_symbol(name)}": both for name, both in reference.values.items()}, []
    if reference.pressure_drop is not None:
        front, back, factor, wanted[f"{reference.name} pressure difference"] = reference.pressure_drop
    for k in range(round(STEADY_MOST / 10.0)):
        runs.report(reference.name, 10.0 * k / STEADY_MOST)
        record = spinup.free_run(batch, unit)
        if np.ptp(record["c_d"]) < STEADY:
            found = [float(record[name].mean()) for name in reference.values]
            if reference.pressure_drop is not None:
                p = steady.pressure_at(posed.space, batch.state(0).p, [front, back])
                found.append(float(factor * (p[0] - p[1])))
            break
    return [
        agrees(name, ours, value, tolerance, reference.source)
        for (name, (value, tolerance)), ours in zip(wanted.items(), found or [np.nan] * len(wanted), strict=True)
    ]


def _symbol(reading: str) -> str:
    """Return c_D for c_d."""
    kind, dot, body = reading.partition(".")
    return kind[:-1] + kind[-1].upper() + dot + body
