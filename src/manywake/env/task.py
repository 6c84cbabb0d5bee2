"""The control task on a flow: when to act, how the jets follow, what is observed and what is rewarded."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from manywake.flow import sensors
from manywake.flow.baseline import Baseline
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.operators import Operators

REFERENCE_STEP = 5e-4
"""The time step that `alpha` is quoted for (the paper's)."""


def exponential(task: "Task", time_step: float, control: np.ndarray, previous: np.ndarray, action: np.ndarray):
    """The paper's eq. 2, c += alpha (a - c) at every solver step; the same law in continuous time for any step."""
    ratio = time_step / REFERENCE_STEP
    # twelve digits: the same on every libm, and exactly alpha at the paper's step
    alpha = round(1.0 - (1.0 - task.alpha) ** ratio, 12)
    series = np.empty((task.steps(time_step), len(action)))
    for s in range(len(series)):
        control = control + alpha * (action - control)
        series[s] = control
    return series


def linear(task: "Task", time_step: float, control: np.ndarray, previous: np.ndarray, action: np.ndarray):
    """The released code's ramp: from the previous action to this one, reached at the last step."""
    steps = task.steps(time_step)
    share = (np.arange(steps) + 1.0)[:, None] / steps
    return (1.0 - share) * previous + share * action


def step_change(task: "Task", time_step: float, control: np.ndarray, previous: np.ndarray, action: np.ndarray):
    """No smoothing: the jets are at the action's flow rate from its first step on."""
    return np.repeat(action[None], task.steps(time_step), axis=0)


CONTROL_LAWS: dict[str, Callable] = {"exponential": exponential, "linear": linear, "step": step_change}

REWARDS: dict[str, Callable[[np.ndarray, np.ndarray, float], np.ndarray]] = {
    "paper": lambda c_d, c_l, cd0: -c_d - abs(c_l),
    "paper-offset": lambda c_d, c_l, cd0: cd0 - c_d - abs(c_l),
    "code": lambda c_d, c_l, cd0: 0.159 - c_d / 20 - 0.2 * abs(c_l) / 20,
    "drag": lambda c_d, c_l, cd0: -c_d,
    "drag-offset": lambda c_d, c_l, cd0: cd0 - c_d,
    "reduction": lambda c_d, c_l, cd0: cd0 - c_d - 0.5 * abs(c_l),
}
"""Rewards of an action from C_D and C_L averaged over it, and the uncontrolled mean C_D0.

paper: eq. 1. code: the released code's, in its units (force = C / 20). drag: no lift penalty (appendix B).
-offset: the same with C_D0 added, so that no control is worth about nothing. reduction: the default, with a weight of
the lift between the two; with 0.2 two of three seeds kept a biased jet (docs/results.md).
"""


@dataclass(frozen=True)
class Task:
    """Settings of the control task. The defaults learn a policy that holds; `PAPER` has the paper's protocol."""

    action_interval: float = 0.025
    """Time between actions: 50 steps of 5e-4, 7.5 % of a shedding period (paper, section 2.2)."""
    actions_per_episode: int = 160
    """Horizon of an episode. 160 and not the paper's 80, so that the policy sees wakes controlled for long."""
    control: str = "exponential"
    """How the jets follow the action: exponential (paper, eq. 2), linear (released code) or step."""
    alpha: float = 0.1
    """Smoothing of the exponential law per 5e-4 of time (paper, eq. 2)."""
    max_flow_rate: float = 0.01
    """Flow rate Q of a jet at action 1, per unit depth; 6.8 % of the flow through the cylinder's frontal height."""
    reward: str = "reduction"
    """Which reward: paper, paper-offset, code, drag, drag-offset or reduction."""
    observation: str = "pressure"
    """What the probes measure: pressure (probes values) or velocity (2 x probes values)."""

    def __post_init__(self) -> None:
        for name, known in (
            ("control", CONTROL_LAWS),
            ("reward", REWARDS),
            ("observation", sensors.OBSERVATIONS),
        ):
            if getattr(self, name) not in known:
                raise ValueError(f"{name}: got {getattr(self, name)!r}, wanted one of {', '.join(known)}")
        if not 0 < self.alpha <= 1:
            raise ValueError(f"alpha: got {self.alpha:g}, wanted a value in (0, 1]")
        if self.actions_per_episode < 2:
            raise ValueError(f"actions_per_episode: got {self.actions_per_episode}, wanted at least 2")
        if not 0 < self.max_flow_rate <= 0.05:
            raise ValueError(
                f"max_flow_rate: got {self.max_flow_rate:g}, wanted a value in (0, 0.05]; the paper has 0.01"
            )

    def steps(self, time_step: float) -> int:
        """Return the solver steps of an action; ValueError when the interval is no multiple of the time step."""
        ratio = self.action_interval / time_step
        steps = round(ratio) if math.isfinite(ratio) else 0
        if steps < 1 or not math.isclose(ratio, steps, rel_tol=1e-9):
            raise ValueError(
                f"action_interval: got {self.action_interval:g}, wanted a multiple of the time step {time_step:g}; "
                f"the nearest is {max(steps, 1) * time_step:g}"
            )
        return steps


PAPER = Task(actions_per_episode=80, reward="paper")
"""The paper's protocol: 80 actions from always the same start, reward of eq. 1."""
CODE = dataclasses.replace(PAPER, control="linear", reward="code")
"""What the paper's released code does instead: linear ramp, offset, lift weight 0.2."""
TASKS = {"default": Task(), "paper": PAPER, "code": CODE}

PRESSURE_LIMIT = 100.0
"""Bound of the observation space; the uncontrolled flow stays within 3, full jets within 10 (units of rho U-bar^2)."""


class ControlledFlow:
    """B flows under one task: acts on all of them at once, and keeps what each jet does."""

    def __init__(self, ops: Operators, baseline: Baseline, task: Task, flows: int):
        if len(ops.case.jets) != 2:
            raise ValueError(f"jets: got {len(ops.case.jets)}, wanted 2; the task drives one pair of zero net flux")
        self.task = task
        self.ops = ops
        self.cd_uncontrolled = baseline.shedding.cd_mean
        self.steps = task.steps(ops.case.time_step)
        self.flow = FlowBatch(ops, baseline.start, flows)
        self.control = np.zeros(flows)
        self.previous = np.zeros(flows)
        self.actions = np.zeros(flows, dtype=np.int64)
        self._law = CONTROL_LAWS[task.control]
        self._reward = REWARDS[task.reward]
        self._sensor = sensors.OBSERVATIONS[task.observation]

    def reset(self, columns, start: Start | None = None) -> None:
        """Put columns back to their start state (or to `start`), jets off, action count 0."""
        self.flow.reset(columns, start)
        for kept in (self.control, self.previous, self.actions):
            kept[columns] = 0

    def observe(self) -> np.ndarray:
        """Return what the probes measure, (B, values) float32, finite and within the observation space."""
        raw = np.nan_to_num(self.flow.read(self._sensor), nan=0.0, posinf=0.0, neginf=0.0)
        return np.clip(raw, -PRESSURE_LIMIT, PRESSURE_LIMIT).astype(np.float32)

    def act(self, action: np.ndarray) -> "Outcome":
        """Hold actions (B,), clipped to [-1, 1], for one action interval."""
        wanted = self.task.max_flow_rate * np.clip(action.astype(np.float64), -1.0, 1.0)
        series = self._law(self.task, self.ops.case.time_step, self.control, self.previous, wanted)
        coefficients = self.flow.advance(np.stack([series, -series], axis=1))
        self.control, self.previous = series[-1].copy(), wanted
        self.actions += 1
        # divergence shows in the forces first: a coefficient past 1000 is no flow any more
        diverged = ~(np.abs(coefficients) < 1e3).all(axis=(0, 1))
        c_d, c_l = _means(np.where(diverged, np.nan, coefficients))
        reward = self._reward(c_d, c_l, self.cd_uncontrolled)
        # a flow that blows up is charged twice the uncontrolled drag to the end of its episode: it never pays
        left = self.task.actions_per_episode - self.actions + 1
        charge = left * self._reward(np.array(2 * self.cd_uncontrolled), np.array(0.0), self.cd_uncontrolled)
        truncated = (self.actions >= self.task.actions_per_episode) & ~diverged
        reward = np.where(diverged, charge, reward)
        return Outcome(reward, c_d, c_l, self.control.copy(), diverged, truncated, coefficients, series)


@dataclass(frozen=True)
class Outcome:
    """What one action brought.

    reward, c_d, c_l, jet, diverged, truncated: (B,), with C_D and C_L averaged over the action (NaN for a flow that
    blew up) and the flow rate of the first jet at its end. coefficients: (steps, 2, B), C_D and C_L of every solver
    step. jets: (steps, B), the first jet's flow rate.
    """

    reward: np.ndarray
    c_d: np.ndarray
    c_l: np.ndarray
    jet: np.ndarray
    diverged: np.ndarray
    truncated: np.ndarray
    coefficients: np.ndarray
    jets: np.ndarray

    @staticmethod
    def none(flows: int, steps: int) -> "Outcome":
        """Return the outcome before any action: all zero."""
        zero, no = np.zeros(flows), np.zeros(flows, dtype=bool)
        return Outcome(zero, zero, zero, zero, no, no, np.zeros((steps, 2, flows)), np.zeros((steps, flows)))


def _means(coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the means over the steps, summed in order so that they do not depend on the batch's shape."""
    total = np.zeros(coefficients.shape[1:])
    for row in coefficients:
        total = total + row
    mean = total / len(coefficients)
    return mean[0], mean[1]
