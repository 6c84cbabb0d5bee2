"""Controlled against uncontrolled: a deterministic policy, for one episode, for the long run, from every phase."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from manywake.env.task import ControlledFlow, Task
from manywake.flow import baseline
from manywake.flow.baseline import Baseline
from manywake.flow.batch import Start
from manywake.learn import policy as policies
from manywake.learn.engine import Engine
from manywake.learn.policy import Policy
from manywake.learn.rollout import JetFlows

LONG_RUN = 4
"""Episode lengths of the long run, without reset."""
PHASES = 8
"""Phases of shedding the long run is started from."""


@dataclass(frozen=True)
class Control:
    """What a controller achieves over a window. C = 2F / (rho U-bar^2 D).

    cd_uncontrolled: mean over whole periods of the same mesh and time step. cd_steady: C_D of the steady base flow.
    drag_reduction: (cd_uncontrolled - cd_controlled) / cd_uncontrolled. share_of_shedding_drag: (cd_uncontrolled -
    cd_controlled) / (cd_uncontrolled - cd_steady). cl_rms, jet_rms: root mean squares about zero, the jet's in units
    of its limit. diverged: the flow blew up, and the numbers mean nothing.
    """

    cd_uncontrolled: float
    cd_controlled: float
    cd_steady: float
    drag_reduction: float
    share_of_shedding_drag: float
    cl_mean: float
    cl_rms: float
    jet_rms: float
    diverged: bool


@dataclass(frozen=True)
class Trajectory:
    """c_d, c_l, jets: (steps, B), every solver step; jets is the first jet's flow rate. ends: the final states."""

    c_d: np.ndarray
    c_l: np.ndarray
    jets: np.ndarray
    ends: list[Start]


@dataclass(frozen=True)
class Evaluation:
    """episode: second half of one episode from the start state. long_run: second half of four episode lengths.

    phases: the long run from eight phases of shedding, the start state first. trajectory: of all of them.
    """

    episode: Control
    long_run: Control
    phases: list[Control]
    trajectory: Trajectory

    def summary(self) -> dict[str, Any]:
        """Return the numbers: the episode's at the top, the others by name."""
        return {
            **_plain(self.episode),
            "long_run": _plain(self.long_run),
            "phases": [_plain(control) for control in self.phases],
        }


def _plain(control: Control) -> dict[str, Any]:
    """Return the fields with None for what is not a number, as JSON wants it."""
    return {key: value if np.isfinite(value) else None for key, value in asdict(control).items()}


def play(simulation: JetFlows, policy: Policy, starts: list[Start], actions: int) -> Trajectory:
    """Run the deterministic policy from each start for a number of actions, without reset."""
    flows = ControlledFlow(simulation.operators, simulation.baseline, simulation.task, len(starts))
    for column, start in enumerate(starts):
        flows.reset([column], start)
    return drive(flows, lambda seen: policies.act(policy, seen)[:, 0], actions)


def drive(
    flows: ControlledFlow,
    act: Callable[[np.ndarray], np.ndarray],
    actions: int,
    look: Callable[[ControlledFlow], None] = lambda flows: None,
) -> Trajectory:
    """Advance flows by a number of actions; act: observations (B, values) -> actions (B,). look: called after each."""
    coefficients, jets = [], []
    for _ in range(actions):
        outcome = flows.act(act(flows.observe()))
        coefficients.append(outcome.coefficients)
        jets.append(outcome.jets)
        look(flows)
    record = np.concatenate(coefficients)
    ends = [flows.flow.state(column) for column in range(flows.flow.flows)]
    return Trajectory(record[:, 0], record[:, 1], np.concatenate(jets), ends)


def control(base: Baseline, task: Task, c_d: np.ndarray, c_l: np.ndarray, jets: np.ndarray) -> Control:
    """Return the statistics of one window of C_D, C_L and jet flow rate, each (steps,)."""
    cd0, steady, cd = base.shedding.cd_mean, base.cd_steady, float(np.mean(c_d))
    return Control(
        cd_uncontrolled=cd0,
        cd_controlled=cd,
        cd_steady=steady,
        drag_reduction=(cd0 - cd) / cd0,
        share_of_shedding_drag=(cd0 - cd) / (cd0 - steady),
        cl_mean=float(np.mean(c_l)),
        cl_rms=float(np.sqrt(np.mean(c_l**2))),
        jet_rms=float(np.sqrt(np.mean(jets**2)) / task.max_flow_rate),
        diverged=not np.isfinite(c_d).all(),
    )


def evaluate(simulation: JetFlows, policy: Policy, engine: Engine) -> Evaluation:
    """Evaluate a policy: `PHASES` long runs side by side, spread over the engine's slots."""
    ops, base, task = simulation.operators, simulation.baseline, simulation.task
    shared = engine.share(simulation)
    starts = baseline.phases(ops, base, PHASES)
    actions = LONG_RUN * task.actions_per_episode
    share = -(-PHASES // engine.slots)
    futures = [engine.submit(play, shared, policy, starts[k : k + share], actions) for k in range(0, PHASES, share)]
    parts = [future.result() for future in futures]
    trajectory = Trajectory(
        np.concatenate([part.c_d for part in parts], axis=1),
        np.concatenate([part.c_l for part in parts], axis=1),
        np.concatenate([part.jets for part in parts], axis=1),
        [end for part in parts for end in part.ends],
    )

    def window(first: int, last: int, column: int) -> Control:
        rows = slice(first, last)
        return control(
            base,
            task,
            trajectory.c_d[rows, column],
            trajectory.c_l[rows, column],
            trajectory.jets[rows, column],
        )

    steps, total = task.actions_per_episode * task.steps(ops.case.time_step), len(trajectory.c_d)
    phases = [window(total // 2, total, column) for column in range(PHASES)]
    return Evaluation(window(steps // 2, steps, 0), phases[0], phases, trajectory)
