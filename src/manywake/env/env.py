"""The Gymnasium environments: a true batch of flows, and a single one, `manywake/CylinderJets-v0`."""

import dataclasses
import sys
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from manywake.env.task import PRESSURE_LIMIT, TASKS, ControlledFlow, Outcome, Task
from manywake.flow import baseline, case
from manywake.flow.case import Case

COEFFICIENTS = "C = 2F / (rho U-bar^2 D), force on the body; drag positive downstream, lift positive up"


def settings(case_or_name: Case | str, task_or_name: Task | str, overrides: dict[str, Any]) -> tuple[Case, Task]:
    """Return case and task with overrides of their fields applied; ValueError for a name that neither has."""
    chosen = case.by_name(case_or_name) if isinstance(case_or_name, str) else case_or_name
    if isinstance(task_or_name, str) and task_or_name not in TASKS:
        raise ValueError(f"task: got {task_or_name!r}, wanted one of {', '.join(TASKS)}")
    task = TASKS[task_or_name] if isinstance(task_or_name, str) else task_or_name
    in_case = {f.name for f in dataclasses.fields(Case)}
    in_task = {f.name for f in dataclasses.fields(Task)}
    for name in overrides:
        if name not in in_case | in_task:
            raise ValueError(f"got the setting {name!r}, wanted one of {', '.join(sorted(in_case | in_task))}")
    return (
        dataclasses.replace(chosen, **{k: v for k, v in overrides.items() if k in in_case}),
        dataclasses.replace(task, **{k: v for k, v in overrides.items() if k in in_task}),
    )


def spaces(chosen: Case, task: Task) -> tuple[Box, Box]:
    """Return the observation and the action space of a single flow."""
    values = len(chosen.probes) * (2 if task.observation == "velocity" else 1)
    return (
        Box(-PRESSURE_LIMIT, PRESSURE_LIMIT, (values,), np.float32),
        Box(-1.0, 1.0, (1,), np.float32),
    )


def _say(what: str, share: float) -> None:
    """Tell on the standard error how far the baseline of a new case is."""
    print(f"\rmanywake: baseline, {what} {share:4.0%}", end="\n" if share >= 1 else "", file=sys.stderr, flush=True)


def _checked(actions: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(actions, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"action: got shape {array.shape}, wanted {shape}; one number in [-1, 1] per flow")
    bad = array[~np.isfinite(array)]
    if bad.size:
        raise ValueError(f"action: got {bad[0]}, wanted finite numbers in [-1, 1]; check the policy's output")
    return array[..., 0]


class CylinderJetsVectorEnv(gymnasium.vector.VectorEnv):
    """B controlled cylinder flows in one process, advanced together.

    Observation (B, 151): pressures at the paper's probes. Action (B, 1) in [-1, 1]: the upper jet blows with flow
    rate Q1 = 0.01 a, the lower with Q2 = -Q1. Reward: see `manywake.env.task.REWARDS`. The horizon is `truncated`;
    a flow that blows up is `terminated` with a finite observation and a penalty. `info` has, for the last action,
    c_d and c_l (means; C = 2F / (rho U-bar^2 D), drag positive downstream, lift positive up; absent before the first
    action, NaN when the flow blew up), jets (flow rates, blowing positive), time and diverged. The convention stands in
    `metadata["coefficients"]` too.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP, "coefficients": COEFFICIENTS}

    def __init__(
        self,
        num_envs: int = 1,
        case: Case | str = "cylinder-jets",
        task: Task | str = "default",
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        **overrides: Any,
    ):
        self.case, self.task = settings(case, task, overrides)
        self.num_envs = num_envs
        self.metadata = {**self.metadata, "autoreset_mode": AutoresetMode(autoreset_mode)}
        self.single_observation_space, self.single_action_space = spaces(self.case, self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.task.steps(self.case.time_step)
        ops, base = baseline.assembled(self.case, _say)
        self._flows = ControlledFlow(ops, base, self.task, num_envs)
        self._ended = np.zeros(num_envs, dtype=bool)
        self._fresh = np.ones(num_envs, dtype=bool)
        self._last = Outcome.none(num_envs, self._flows.steps)

    def reset(self, *, seed=None, options: dict[str, Any] | None = None):
        """Put all flows (or those of options["reset_mask"]) back to the start state."""
        super().reset(seed=seed if not isinstance(seed, list) else seed[0], options=options)
        mask = (options or {}).get("reset_mask")
        mask = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise ValueError(
                f"reset_mask: got {mask}, wanted {self.num_envs} booleans, one per flow, at least one True"
            )
        columns = np.flatnonzero(mask)
        self._flows.reset(columns)
        self._ended[columns] = False
        self._last = _cleared(self._last, columns)
        self._fresh[columns] = True
        return self._flows.observe(), self._info(mask)

    def step(self, actions):
        """Advance every flow by one action interval; what happens at an episode's end is the autoreset mode's."""
        action = _checked(actions, (self.num_envs, 1))
        mode = self.metadata["autoreset_mode"]
        if mode == AutoresetMode.DISABLED and self._ended.any():
            raise ValueError(
                f"step: flow {int(np.flatnonzero(self._ended)[0])} has ended; with autoreset disabled, call "
                'reset(options={"reset_mask": ...}) first'
            )
        resetting = np.flatnonzero(self._ended) if mode == AutoresetMode.NEXT_STEP else np.empty(0, int)
        outcome = self._last = self._flows.act(action)
        self._fresh[:] = False
        if len(resetting):
            self._flows.reset(resetting)
            self._fresh[resetting] = True
            outcome = self._last = _cleared(outcome, resetting)
        terminated, truncated = outcome.diverged.copy(), outcome.truncated.copy()
        observation, info = self._flows.observe(), self._info()
        self._ended = terminated | truncated
        if mode == AutoresetMode.SAME_STEP and self._ended.any():
            columns = np.flatnonzero(self._ended)
            final = np.full(self.num_envs, None, dtype=object)
            for column in columns:
                final[column] = observation[column].copy()
            final_info = info | {key: self._ended.copy() for key in info if key.startswith("_")}
            self._flows.reset(columns)
            observation = self._flows.observe()
            self._last = _cleared(outcome, columns)
            self._fresh[columns] = True
            info = self._info()
            info |= {"final_obs": final, "_final_obs": self._ended.copy()}
            info |= {"final_info": final_info, "_final_info": self._ended.copy()}
            self._ended = np.zeros(self.num_envs, dtype=bool)
        return observation, outcome.reward.copy(), terminated, truncated, info

    def _info(self, mask: np.ndarray | None = None) -> dict[str, Any]:
        """Return the info of the last action, for the flows of `mask`; a fresh flow has no C_D and C_L yet."""
        there = np.ones(self.num_envs, dtype=bool) if mask is None else mask
        flows = self._flows
        info: dict[str, Any] = {
            "c_d": self._last.c_d.copy(),
            "c_l": self._last.c_l.copy(),
            "jets": np.stack([flows.control, -flows.control], axis=1),
            "time": flows.actions * self.task.action_interval,
            "diverged": self._last.diverged.copy(),
        }
        present = {f"_{key}": there & ~self._fresh if key in ("c_d", "c_l") else there.copy() for key in info}
        return info | present


def _cleared(outcome: Outcome, columns: np.ndarray) -> Outcome:
    """Return the outcome with the given columns as just after a reset."""
    parts = {}
    for field in dataclasses.fields(Outcome):
        parts[field.name] = getattr(outcome, field.name).copy()
        parts[field.name][..., columns] = 0
    return Outcome(**parts)


class CylinderJetsEnv(gymnasium.Env):
    """One controlled cylinder flow: `CylinderJetsVectorEnv` with a batch of one."""

    metadata = {"render_modes": [], "coefficients": COEFFICIENTS}

    def __init__(self, case: Case | str = "cylinder-jets", task: Task | str = "default", **overrides: Any):
        self._batch = CylinderJetsVectorEnv(1, case, task, AutoresetMode.DISABLED, **overrides)
        self.case, self.task = self._batch.case, self._batch.task
        self.observation_space = self._batch.single_observation_space
        self.action_space = self._batch.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Return to the start state, the developed Karman street at an upward crossing of C_L."""
        super().reset(seed=seed, options=options)
        observation, info = self._batch.reset()
        return observation[0], _single(info)

    def step(self, action):
        """Hold the action for one action interval."""
        _checked(action, self.action_space.shape)
        observation, reward, terminated, truncated, info = self._batch.step(np.asarray(action)[None])
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), _single(info)


def _single(info: dict[str, Any]) -> dict[str, Any]:
    """Return the info of a batch of one without the batch axis."""
    single = {key: value[0] for key, value in info.items() if not key.startswith("_") and info[f"_{key}"][0]}
    return {key: value.item() if value.ndim == 0 else value for key, value in single.items()}


def register() -> None:
    """Tell Gymnasium of `manywake/CylinderJets-v0`."""
    gymnasium.register(
        "manywake/CylinderJets-v0",
        entry_point="manywake.env.env:CylinderJetsEnv",
        vector_entry_point="manywake.env.env:CylinderJetsVectorEnv",
    )
