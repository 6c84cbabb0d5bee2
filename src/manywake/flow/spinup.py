"""The uncontrolled flow: several side by side from kicked starts, until their means have settled."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from manywake.case.case import Case
from manywake.case.geometry import outline
from manywake.flow import batch as batches
from manywake.flow import readings, statistics
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.operators import Operators
from manywake.flow.statistics import Kind

Progress = Callable[[str, float], None]
"""progress(what, share done): called now and then by work that takes long."""
FLOWS = 8
"""Flows side by side: four kicks, and each in the mirror."""
KICKS = (0.3, 0.2, 0.4, 0.1)
"""Their strengths, in units of U."""
BLOCK = 40.0
"""Time over which a flow is judged, in L / U: a dozen shedding periods of a cylinder."""
MOST = 800.0
"""A flow whose means have not settled by this time, in L / U, is taken as it is."""
_CHUNK, _SAMPLE = 50, 10
UNSTEADINESS = "unsteadiness"
"""The reading by which a flow without bodies is judged: rms over the domain of u - u_steady, in units of U."""


class BlewUp(RuntimeError):
    """An uncontrolled flow that is no longer finite."""


class FreeFlows:
    """Uncontrolled flows of one case side by side. steady: (n, 2), the velocity they are compared with."""

    def __init__(self, case: Case, ops: Operators, starts: list[Start], steady: np.ndarray):
        self.case, self.ops, self.steady = case, ops, steady
        self.batch = batches.started(ops, starts, len(starts))
        self.clock = clock(case)
        self.flows = len(starts)

    def states(self) -> list[Start]:
        return [self.batch.state(column) for column in range(self.flows)]

    def velocities(self) -> list[np.ndarray]:
        return [self.batch.velocity(column) for column in range(self.flows)]

    def advance(self, steps: int) -> dict[str, np.ndarray]:
        """Return the readings (steps, B) by name; without bodies, how unsteady the flow is too."""
        record = free_run(self.batch, steps)
        if not self.case.bodies:
            record |= {UNSTEADINESS: np.tile(self._unsteadiness(), (steps, 1))}
        return record

    def run(self, duration: float, report: Progress, what: str, done: float = 0.0, of: float = 0.0) -> dict:
        """Advance for some time, in L / U; return the readings of it. BlewUp where they are not finite.

        done, of: time before this run and of all runs, for the report.
        """
        unit, dt, record = self.case.convective_time, self.ops.time_step, []
        steps, chunk = max(round(duration * unit / dt), 1), _CHUNK if self.case.bodies else _SAMPLE
        for at in range(0, steps, chunk):
            record.append(self.advance(min(chunk, steps - at)))
            if not all(np.isfinite(series[-1]).all() for series in record[-1].values()):
                time = done * unit + (at + chunk) * dt
                raise BlewUp(
                    f"baseline: the flow blew up by time {time:g} of its {what}; halve the time step {dt:g}, or take "
                    "finer sizes: Sizes.at(reynolds)"
                )
            report(what, min((done + duration * min((at + chunk) / steps, 1.0)) / (of or duration), 1.0))
        return readings.joined(record)

    def _unsteadiness(self) -> np.ndarray:
        mass, area = self.ops.space.mass, self.ops.space.velocity.dx.sum()
        off = [u - self.steady for u in self.velocities()]
        return np.array([np.sqrt(np.sum(u * (mass @ u)) / area) for u in off]) / self.case.scales.velocity


def clock(case: Case) -> str:
    """Return the reading that tells the periods: the lift of the first body, as the sum of several may be steady."""
    return f"c_l.{case.bodies[0].name}" if case.bodies else UNSTEADINESS


def free_run(flow: FlowBatch, steps: int) -> dict[str, np.ndarray]:
    """Advance uncontrolled flows, with their disturbances; return their readings by name, (steps, B)."""
    still = flow.disturbed(np.zeros((steps, flow.ops.actuators, flow.flows)))
    return readings.named(flow.ops, flow.advance(still), still)


def settle(flows: FreeFlows, least: float, report: Progress, what: str) -> tuple[Kind, dict[str, np.ndarray]]:
    """Advance until the means of blocks have settled, for the time `least` at least; return kind and last block.

    A flow that is neither steady nor periodic has settled when two blocks differ from the two before by no more than
    their flows differ among themselves, or at `MOST`.
    """
    means: list[dict[str, np.ndarray]] = []
    for k in range(round(MOST / BLOCK)):
        record = flows.run(BLOCK, report, what, k * BLOCK, max(least, (k + 1) * BLOCK))
        means.append({name: series.mean(axis=0) for name, series in record.items()})
        if (k + 1) * BLOCK < least:
            continue
        found = kind(record, flows.clock)
        if found != "aperiodic" or _trendless(means[-4:]):
            break
    return found, record


def kind(record: dict[str, np.ndarray], clock: str) -> Kind:
    """Return of which kind flows (steps, B) are: aperiodic where they are not alike."""
    flows = range(record[clock].shape[1])
    kinds = {statistics.kind({name: series[:, b] for name, series in record.items()}, clock) for b in flows}
    return kinds.pop() if len(kinds) == 1 else "aperiodic"


def _trendless(means: list[dict[str, np.ndarray]]) -> bool:
    if len(means) < 4:
        return False
    for name in means[0]:
        before, after = (np.concatenate([part[name] for part in half]) for half in (means[:2], means[2:]))
        error = np.sqrt((before.var(ddof=1) + after.var(ddof=1)) / len(before))
        if abs(after.mean() - before.mean()) > max(2 * error, statistics.STEADY):
            return False
    return True


def apart(record: dict[str, np.ndarray]) -> list[int]:
    """Return which of flows (steps, B) are in states of their own, the first of each: two where there are mirrors."""
    means = np.stack([series.mean(axis=0) for series in record.values()])
    size = np.stack([np.ptp(series, axis=0) for series in record.values()]).max(axis=1)
    kept = [0]
    for b in range(1, means.shape[1]):
        if all((abs(means[:, b] - means[:, a]) > 0.1 * size + statistics.STEADY).any() for a in kept):
            kept.append(b)
    return kept


def kicked(case: Case, ops: Operators, strength: float, still: Start | None = None) -> Start:
    """Return fluid at rest but for a gust behind the bodies, upwards if positive, so that shedding sets in at once.

    strength: in units of U. still: the flow that is kicked in the place of rest, amid the domain if it has no bodies.
    """
    (x, y), length = ops.space.x.T, case.scales.length
    if case.bodies:
        around = np.concatenate([outline(body) for body in case.bodies])
        (_, low), (back, high) = around.min(axis=0), around.max(axis=0)
        centre = back + length, 0.5 * (low + high)
    else:
        centre = 0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max())
    distance = (x - centre[0]) ** 2 + (y - centre[1]) ** 2
    gust = strength * case.scales.velocity * np.exp(-distance / (0.5 * length) ** 2)
    u = np.stack([np.zeros_like(x), gust], axis=1)
    u[ops.velocity_order[ops.free :]] = 0.0
    u[ops.slip] = 0.0
    rest = still or Start(np.zeros_like(u), np.zeros_like(u), *np.zeros((3, len(ops.pressure_order))))
    return replace(rest, u=rest.u + u, u_old=rest.u_old + u)


def kicks(case: Case, ops: Operators, still: Start | None = None) -> list[Start]:
    """Return `FLOWS` kicked starts, each before its mirror."""
    return [kicked(case, ops, sign * strength, still) for strength in KICKS for sign in (1.0, -1.0)]


def rescaled(start: Start, ratio: float) -> Start:
    """Return a state to go on from at another time step, `ratio` times that which it was reached with."""
    increments = {name: ratio * getattr(start, name) for name in ("phi", "phi_old")}
    return replace(start, u_old=start.u + ratio * (start.u_old - start.u), **increments)


def average(flows: FreeFlows, duration: float, report: Progress, what: str) -> np.ndarray:
    """Advance for some time, in units of time; return the mean velocity (n, 2) over it and over all flows."""
    samples = max(round(duration / flows.ops.time_step / _SAMPLE), 1)
    total = np.zeros_like(flows.steady)
    for k in range(samples):
        flows.advance(_SAMPLE)
        total += sum(flows.velocities()) / flows.flows
        report(what, (k + 1) / samples)
    return total / samples
