"""Flows under a task: actions become amplitudes, readings become rewards. One loop drives a batch."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from manywake.case import sensors
from manywake.case import task as tasks
from manywake.case.case import Case
from manywake.case.case import readings as kinds
from manywake.case.task import Task
from manywake.env.errors import Errors
from manywake.flow import readings, stability
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.store import Flow

OBSERVATION_LIMIT = 100.0
"""Bound of the observation space. The paper's uncontrolled pressures stay within 3, under full jets within 10."""


def spaces(case: Case, task: Task) -> tuple[Box, Box]:
    """Return the observation and the action space of a single flow."""
    actions = tasks.matrix(task, len(case.actuators)).shape[1]
    seen = Box(-OBSERVATION_LIMIT, OBSERVATION_LIMIT, (task.history * _values(case, task),), np.float32)
    return seen, Box(-1.0, 1.0, (actions,), np.float32)


def _values(case: Case, task: Task) -> int:
    """Return how many numbers one observation has."""
    counts = {sensor.name: sensors.values(sensor) for sensor in case.sensors} | {"amplitudes": len(case.actuators)}
    return sum(counts.get(name, 1) for name in task.observe)


@dataclass(frozen=True)
class Outcome:
    """What one action brought.

    reward, diverged, truncated: (B,). means: every reading by name, averaged over the action, (B,), NaN for a flow that
    blew up. series: every reading by name at every solver step, (steps, B). amplitudes: (steps, actuators, B).
    """

    reward: np.ndarray
    means: dict[str, np.ndarray]
    diverged: np.ndarray
    truncated: np.ndarray
    series: dict[str, np.ndarray]
    amplitudes: np.ndarray


@dataclass(frozen=True)
class Snapshot:
    """All that one flow's future depends on: its state, its random numbers, and what the task remembers of it."""

    start: Start
    chance: list[tuple[float, dict[str, Any]]]
    errors: list[dict[str, Any]]
    amplitude: np.ndarray
    wanted: np.ndarray
    actions: int
    pending: np.ndarray
    frames: np.ndarray
    means: dict[str, float]


class ControlledFlows:
    """B flows under one task: acts on all of them at once, and keeps what each of the agent's inputs does.

    An episode is a function of its seed and of the actions. It is seed b in column b until `reset` gives another.
    """

    def __init__(self, flow: Flow, task: Task, flows: int):
        stability.check(flow.case, flow.baseline.withstood, task.law)
        self.flow, self.task, self.count = flow, task, flows
        self.steps = task.steps(flow.case.dt)
        self.batch = FlowBatch(flow.operators, flow.baseline.start, flows)
        self.mixing = tasks.matrix(task, len(flow.case.actuators))
        self.limits = np.array([actuator.limit for actuator in flow.case.actuators])
        known, free = kinds(flow.case), flow.baseline.free
        self.free = {name: float(value) for name, value in free.items() if name in known}
        self.charge = task.charge(task.reward, flow.baseline.withstood.readings(), self.free)
        self.amplitude, self.wanted = np.zeros((2, len(self.limits), flows))
        self.actions = np.zeros(flows, dtype=np.int64)
        self.means = {name: np.full(flows, value) for name, value in self.free.items()}
        self._errors = Errors(flow.case, flows)
        self._pending = np.zeros((task.delay, flows, self.mixing.shape[1]))
        self._frames = np.zeros((flows, task.history, _values(flow.case, task)), np.float32)
        self.reset(range(flows), range(flows))

    def reset(self, columns: Sequence[int] | np.ndarray, seeds: Sequence[int], start: Start | None = None) -> None:
        """Begin an episode in each of some columns, with amplitudes and action count 0.

        seeds: of the episodes, one for each column. start: where all begin, if not where their seeds say.
        """
        for column, seed in zip(columns, seeds, strict=True):
            self.batch.reset([column], self._start(seed) if start is None else start, [seed])
            self._errors.reset(column, seed)
        self.amplitude[:, columns] = self.wanted[:, columns] = 0.0
        self._pending[:, columns] = 0.0
        self.actions[columns] = 0
        for name, value in self.free.items():
            self.means[name][columns] = value
        self._frames[columns] = self._look(columns)[:, None]

    def _start(self, seed: int) -> Start:
        """Return the state that an episode of this seed begins from."""
        if self.task.starts == "first":
            return self.flow.baseline.start
        return self.flow.starts[tasks.begun(self.task, seed, len(self.flow.starts))]

    def snapshot(self, column: int) -> Snapshot:
        """Return all that one flow's future depends on."""
        return Snapshot(
            self.batch.state(column),
            self.batch.chance(column),
            self._errors.state(column),
            self.amplitude[:, column].copy(),
            self.wanted[:, column].copy(),
            int(self.actions[column]),
            self._pending[:, column].copy(),
            self._frames[column].copy(),
            {name: float(part[column]) for name, part in self.means.items()},
        )

    def restore(self, column: int, kept: Snapshot) -> None:
        """Put a flow back to where a snapshot of this task was taken, in whichever column or batch that was."""
        self.batch.reset([column], kept.start)
        self.batch.resume(column, kept.chance)
        self._errors.resume(column, kept.errors)
        self.amplitude[:, column], self.wanted[:, column] = kept.amplitude, kept.wanted
        self.actions[column] = kept.actions
        self._pending[:, column], self._frames[column] = kept.pending, kept.frames
        for name, value in kept.means.items():
            self.means[name][column] = value

    def observe(self) -> np.ndarray:
        """Return what the task observes, (B, history x values) float32, finite and within the observation space.

        Sensors read the flow as it is now, integrals too. Other readings are means over the last action, those of the
        uncontrolled flow before the first. Amplitudes are in units of their limits.
        """
        return self._frames.reshape(self.count, -1).copy()

    def _look(self, columns: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return what is to be observed now of some flows, (columns, values); sensors draw their errors."""
        measured = {sensor.name for sensor in self.flow.case.sensors}
        known = {name: part[:, None] for name, part in self.means.items() if name not in measured}
        known["amplitudes"] = (self.amplitude / self.limits[:, None]).T
        parts = [
            known[name][columns] if name in known else self._errors.added(name, self.batch.read(name)[columns], columns)
            for name in self.task.observe
        ]
        raw = np.nan_to_num(np.concatenate(parts, axis=1), nan=0.0, posinf=0.0, neginf=0.0)
        return np.clip(raw, -OBSERVATION_LIMIT, OBSERVATION_LIMIT).astype(np.float32)

    def act(self, actions: np.ndarray, parts: int = 1, seen: Callable[[np.ndarray], None] | None = None) -> Outcome:
        """Hold actions (B, actions), clipped to [-1, 1], for one action interval: these, or what the delay lets act.

        seen: called with the amplitudes (inputs, B) after each of the parts that the interval is cut into, for pictures
        in between; no bit depends on them.
        """
        queue = np.concatenate([self._pending, np.clip(actions.astype(np.float64), -1.0, 1.0)[None]])
        clipped, self._pending = queue[0], queue[1:]
        # summed in order, so that no bit depends on B
        mixed = sum(self.mixing[:, k, None] * clipped[None, :, k] for k in range(clipped.shape[1]))
        wanted = self.limits[:, None] * mixed
        amplitudes = self.task.law.series(self.steps, self.flow.case.dt, self.amplitude, self.wanted, wanted)
        found = []
        for part in np.array_split(self.batch.disturbed(amplitudes), parts):
            found.append(self.batch.advance(part))
            if seen is not None:
                seen(part[-1, : len(self.limits)])
        read = np.concatenate(found)
        self.amplitude, self.wanted = amplitudes[-1].copy(), wanted
        self.actions += 1
        series = readings.named(self.flow.operators, read, amplitudes)
        diverged = readings.blown(self.flow.operators, read)
        means = readings.means({name: np.where(diverged, np.nan, part) for name, part in series.items()})
        self.means = {name: part.copy() for name, part in means.items()}
        newest = self._look(range(self.count))[:, None]
        self._frames = np.concatenate([self._frames[:, 1:], newest], axis=1)
        truncated = (self.actions >= self.task.actions) & ~diverged
        reward = np.array([self._reward(means, b, bool(diverged[b])) for b in range(self.count)])
        return Outcome(reward, means, diverged, truncated, series, amplitudes)

    def _reward(self, means: dict[str, np.ndarray], b: int, diverged: bool) -> float:
        """Return one flow's reward: of its readings as plain numbers, or, where it blew up, what its task charges."""
        if diverged:
            left = int(self.task.actions - self.actions[b]) + 1
            return left * self.charge
        now = {name: float(part[b]) for name, part in means.items()}
        try:
            return float(self.task.reward(now, self.free))
        except Exception as error:
            raise ValueError(f"reward: fails ({type(error).__name__}: {error}) on the readings {now}") from error


@dataclass(frozen=True)
class Step:
    """One action of `drive`: what was seen before it (B, values), what was done, what it brought, what is seen now."""

    observation: np.ndarray
    action: np.ndarray
    outcome: Outcome
    after: np.ndarray


def drive(flows: ControlledFlows, choose: Callable[[int, np.ndarray], np.ndarray], actions: int) -> Iterator[Step]:
    """Advance flows by a number of actions; choose(t, observations (B, values)) -> actions (B, actions)."""
    seen = flows.observe()
    for t in range(actions):
        action = choose(t, seen)
        step = Step(seen, action, flows.act(action), flows.observe())
        yield step
        seen = step.after
