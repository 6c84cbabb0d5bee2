"""One flow twice from the same start: without control, and beside it driven by a hand or a controller."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from manywake.env.control import ControlledFlows
from manywake.flow.batch import Start
from manywake.learn import controllers
from manywake.learn.controllers import Choose, Controller, Learnt
from manywake.learn.flows import Flows
from manywake.learn.policy import Policy

HAND, POLICY, NONE = "hand", "policy", "none"
TOUCH = 0.1
"""Time between actions of the hand, in L/U, so that it is felt at once; not longer than the task's."""
WINDOW = 10.0
"""About how long the mean is taken for what is saved, in L/U: whole shedding periods where there are any."""
KEPT = 600
"""Readings that are kept for traces."""


@dataclass(frozen=True)
class Reading:
    """What one action brought: means over it. time: at its end, in L/U. now, beside: of the readings that are shown."""

    time: float
    steps: int
    now: tuple[float, ...]
    beside: tuple[float, ...]
    power: float


class Pair:
    """Two lanes: the first is never driven, the second by whoever `by` names.

    policy: one that may drive. shipped: without one, the policy that ships with the case may.
    """

    def __init__(self, simulation: Flows, policy: Policy | None = None, shipped: bool = True):
        self.simulation, self.flow = simulation, simulation.flows[0]
        self.task = replace(simulation.task, starts="first")  # the others take seconds to make
        case, base = self.flow.case, self.flow.baseline
        self.unit, self.shown = case.convective_time, base.shown
        self._flows = ControlledFlows(self.flow, self.task, 2)
        touch = max(1, min(self._flows.steps, round(TOUCH * self.unit / case.dt)))
        self._touched = replace(self.task, interval=touch * case.dt)
        self.actions = self._flows.mixing.shape[1]
        self.hand = np.zeros(self.actions)
        self.controllers = _known(simulation, policy, shipped)
        period = base.statistics.period
        cycles = WINDOW * self.unit / period if period else 1.0
        self.window = max(round(cycles), 1) * period / self.unit if period else WINDOW
        self.readings: deque[Reading] = deque(maxlen=KEPT)
        self.time, self._t = 0.0, 0
        self.by = NONE
        self._choose: Choose | None = self._chosen(NONE)

    @property
    def mixing(self) -> np.ndarray:
        """From actions to amplitudes in units of their limits, (inputs, actions)."""
        return self._flows.mixing

    @property
    def interval(self) -> float:
        """Time of an action, in L/U."""
        return self._flows.task.interval / self.unit

    @property
    def states(self) -> list[Start]:
        return [self._flows.batch.state(lane) for lane in (0, 1)]

    @property
    def steps(self) -> int:
        """How many solver steps an action has."""
        return self._flows.steps

    def drive(self, by: str) -> None:
        """Let another drive from the next action on; KeyError where there is no such controller."""
        choose = None if by == HAND else self.controllers[by]
        task = self._touched if by == HAND else self.task
        if task is not self._flows.task:
            moved = ControlledFlows(self.flow, task, 2)
            for lane in (0, 1):
                moved.restore(lane, self._flows.snapshot(lane))
            self._flows = moved
        self.by, self._t = by, 0
        self._choose = None if choose is None else choose.on(self._flows)

    def learnt(self, policy: Policy) -> None:
        """Take a newer policy, at once where a policy drives; ValueError where it is one of another task."""
        wanted = self.simulation.spaces()[0].shape[0]
        if len(policy.mean) != wanted:
            raise ValueError(f"policy: got one of {len(policy.mean)} observed values, wanted one of {wanted}")
        self.controllers[POLICY] = Learnt(policy)
        if self.by == POLICY:
            self._choose = self._chosen(POLICY)

    def reset(self) -> None:
        """Begin both flows anew, from the same start."""
        self._flows.reset([0, 1], [0, 0])
        self.readings.clear()
        self.hand[:] = 0.0
        self.time = 0.0
        self.drive(self.by)

    def act(self, parts: int, seen: Callable[[np.ndarray], None]) -> bool:
        """Take one action; return whether a flow blew up, then `reset` is due.

        seen: called after each of the parts that the action is cut into, with the amplitudes of the driven flow in
        units of their limits, (inputs,).
        """
        flows, actions = self._flows, np.zeros((2, self.actions))
        actions[1] = self.hand if self._choose is None else self._choose(self._t, flows.observe())[1]
        outcome = flows.act(actions, parts, lambda amplitudes: seen(amplitudes[:, 1] / flows.limits))
        self._t += 1
        self.time += self.interval
        now, beside = (tuple(float(outcome.means[name][lane]) for name in self.shown) for lane in (1, 0))
        power = float(outcome.means["power"][1])
        self.readings.append(Reading(self.time, flows.steps, now, beside, power))
        return bool(outcome.diverged.any())

    def saved(self, length: float | None = None) -> tuple[float, float]:
        """Return what control saves of the first reading that is shown, and the power it takes for that.

        Both as shares of the uncontrolled mean, from means over the last `length` L/U (`window` when not given), as an
        evaluation has them: (free - now) / free. NaN before the first action.
        """
        wanted = round((self.window if length is None else length) * self.unit / self.flow.case.dt)
        steps, now, power = 0, 0.0, 0.0
        for reading in reversed(self.readings):
            part = min(reading.steps, wanted - steps)
            steps, now, power = steps + part, now + part * reading.now[0], power + part * reading.power
            if steps == wanted:
                break
        free = self.flow.baseline.free[self.shown[0]]
        if not steps or not free:
            return math.nan, math.nan
        return (free - now / steps) / abs(free), power / steps / abs(free)

    def numbers(self, amplitudes: Sequence[float]) -> list[float]:
        """Return what a frame says beside its fields, NaN before the first action.

        The time, that of the last reading, what is saved and the power spent for it as `saved`, the power C_P; the
        readings that are shown, with control and without; amplitudes (inputs,) in units of their limits.
        """
        gap = (math.nan,) * len(self.shown)
        last = self.readings[-1] if self.readings else Reading(0.0, 0, gap, gap, math.nan)
        return [self.time, last.time, *self.saved(), last.power, *last.now, *last.beside, *amplitudes]

    def _chosen(self, by: str) -> Choose:
        return self.controllers[by].on(self._flows)


def _known(simulation: Flows, policy: Policy | None, shipped: bool) -> dict[str, Controller]:
    """Return the controllers that a case has by name, the policy last."""
    definition, (seen, acted) = simulation.chosen.definition, simulation.spaces()
    found: dict[str, Controller] = {NONE: controllers.simple(NONE, (), acted.shape[0])}
    for name in controllers.FAMILIES:
        if name in definition.controllers:
            found[name] = controllers.simple(name, definition.controllers[name], acted.shape[0])
    if policy is not None:
        found[POLICY] = Learnt(policy)
    elif shipped and definition.policy is not None:
        try:
            found[POLICY] = controllers.shipped(definition.policy, definition.name, seen.shape[0])
        except ValueError:  # another protocol's observations: it is not offered
            pass
    return found
