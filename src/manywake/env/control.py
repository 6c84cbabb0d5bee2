"""Flows under a task: actions become amplitudes, readings become rewards. One loop drives a batch."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium.spaces import Box

from manywake.case import sensors
from manywake.case import task as tasks
from manywake.case.case import Case
from manywake.case.case import readings as kinds
from manywake.case.task import Task
from manywake.flow import readings, stability
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.store import Flow

OBSERVATION_LIMIT = 100.0
"""Bound of the observation space. The paper's uncontrolled pressures stay within 3, under full jets within 10."""


def spaces(case: Case, task: Task) -> tuple[Box, Box]:
    """Return the observation and the action space of a single flow."""
    counts = {sensor.name: sensors.values(sensor) for sensor in case.sensors} | {"amplitudes": len(case.actuators)}
    values = sum(counts.get(name, 1) for name in task.observe)
    actions = tasks.matrix(task, len(case.actuators)).shape[1]
    seen = Box(-OBSERVATION_LIMIT, OBSERVATION_LIMIT, (values,), np.float32)
    return seen, Box(-1.0, 1.0, (actions,), np.float32)


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

    def reset(self, columns: Sequence[int] | np.ndarray, seeds: Sequence[int], start: Start | None = None) -> None:
        """Begin an episode in each of some columns, with amplitudes and action count 0.

        seeds: of the episodes, one for each column. start: where all begin, if not where their seeds say.
        """
        for column, seed in zip(columns, seeds, strict=True):
            self.batch.reset([column], self._start(seed) if start is None else start, [seed])
        self.amplitude[:, columns] = self.wanted[:, columns] = 0.0
        self.actions[columns] = 0
        for name, value in self.free.items():
            self.means[name][columns] = value

    def _start(self, seed: int) -> Start:
        """Return the state that an episode of this seed begins from."""
        starts = self.flow.baseline.starts
        if self.task.starts == "first":
            return starts[0]
        return starts[int(np.random.SeedSequence(seed, spawn_key=(0,)).generate_state(1)[0]) % len(starts)]

    def observe(self) -> np.ndarray:
        """Return what the task observes, (B, values) float32, finite and within the observation space.

        Sensors read the flow as it is now, integrals too. Other readings are means over the last action, those of the
        uncontrolled flow before the first. Amplitudes are in units of their limits.
        """
        measured = {sensor.name for sensor in self.flow.case.sensors}
        known = {name: part[:, None] for name, part in self.means.items() if name not in measured}
        known["amplitudes"] = (self.amplitude / self.limits[:, None]).T
        parts = [known[name] if name in known else self.batch.read(name) for name in self.task.observe]
        raw = np.nan_to_num(np.concatenate(parts, axis=1), nan=0.0, posinf=0.0, neginf=0.0)
        return np.clip(raw, -OBSERVATION_LIMIT, OBSERVATION_LIMIT).astype(np.float32)

    def act(self, actions: np.ndarray) -> Outcome:
        """Hold actions (B, actions), clipped to [-1, 1], for one action interval."""
        clipped = np.clip(actions.astype(np.float64), -1.0, 1.0)
        # summed in order, so that no bit depends on B
        mixed = sum(self.mixing[:, k, None] * clipped[None, :, k] for k in range(clipped.shape[1]))
        wanted = self.limits[:, None] * mixed
        amplitudes = self.task.law.series(self.steps, self.flow.case.dt, self.amplitude, self.wanted, wanted)
        read = self.batch.advance(self.batch.disturbed(amplitudes))
        self.amplitude, self.wanted = amplitudes[-1].copy(), wanted
        self.actions += 1
        series = readings.named(self.flow.operators, read, amplitudes)
        diverged = readings.blown(self.flow.operators, read)
        means = readings.means({name: np.where(diverged, np.nan, part) for name, part in series.items()})
        self.means = {name: part.copy() for name, part in means.items()}
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
