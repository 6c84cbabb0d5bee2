"""The Gymnasium environments of any flow: a true batch, and a single one."""

import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from manywake.case.case import Case
from manywake.case.task import Task
from manywake.env.control import ControlledFlows, spaces
from manywake.flow import store
from manywake.suite import load

COEFFICIENTS = "C = 2F / (rho U^2 L), force on the body; drag positive downstream, lift positive up"


def _say(what: str, share: float) -> None:
    """Tell on the standard error how far the baseline of a new case is."""
    print(f"\rmanywake: baseline, {what} {share:4.0%}", end="\n" if share >= 1 else "", file=sys.stderr, flush=True)


def _checked(actions: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(actions, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"action: got shape {array.shape}, wanted {shape}; numbers in [-1, 1], flows first")
    for bad in array[~np.isfinite(array)]:
        raise ValueError(f"action: got {bad}, wanted finite numbers in [-1, 1]; check the policy's output")
    return array


class FlowVectorEnv(gymnasium.vector.VectorEnv):
    """B flows of one case in one process, advanced together.

    case: a shipped one by name, the path of a case file, or a `Case` (then with task=Task(...)). task: a protocol of
    the file by name, or a `Task`. Every other setting of the case and its task is an option, see `suite.load`.

    Observation (B, values): what `Task.observe` names. Action (B, actions) in [-1, 1]: mixed to amplitudes in units of
    their limits (`Task.mixing`). The horizon is `truncated`; a flow that blows up is `terminated` with a finite
    observation and a charge. `info` has, for the last action, every reading by name (means, absent before the first
    action, NaN when the flow blew up; their convention stands in `metadata["coefficients"]`), amplitudes (inputs), time
    and diverged.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP, "coefficients": COEFFICIENTS}

    def __init__(
        self,
        num_envs: int = 1,
        case: str | Path | Case = load.DEFAULT,
        task: Task | str | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        **overrides: Any,
    ):
        chosen = load.choose(case, task, **overrides)
        self.case, self.task, self.num_envs = chosen.case, chosen.task, num_envs
        self.metadata = {**self.metadata, "autoreset_mode": AutoresetMode(autoreset_mode)}
        self.single_observation_space, self.single_action_space = spaces(self.case, self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._flows = ControlledFlows(store.flow(self.case, _say), self.task, num_envs)
        self._ended, self._diverged, self._fresh = np.zeros((3, num_envs), dtype=bool)
        self._restart(~self._fresh)

    def _restart(self, which: np.ndarray) -> None:
        """Put the flows of a mask back to the start state; a fresh flow has no readings yet."""
        self._flows.reset(np.flatnonzero(which))
        self._fresh[which], self._ended[which], self._diverged[which] = True, False, False

    def reset(self, *, seed=None, options: dict[str, Any] | None = None):
        """Put all flows (or those of options["reset_mask"]) back to the start state."""
        super().reset(seed=seed if not isinstance(seed, list) else seed[0], options=options)
        mask = (options or {}).get("reset_mask")
        mask = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise ValueError(
                f"reset_mask: got {mask}, wanted {self.num_envs} booleans, one per flow, at least one True"
            )
        self._restart(mask)
        return self._flows.observe(), self._info(mask)

    def step(self, actions):
        """Advance every flow by one action interval; what happens at an episode's end is the autoreset mode's."""
        action = _checked(actions, (self.num_envs, *self.single_action_space.shape))
        mode, ended = self.metadata["autoreset_mode"], self._ended.copy()
        if mode == AutoresetMode.DISABLED and ended.any():
            raise ValueError(
                f"step: flow {ended.argmax()} has ended; with autoreset disabled, call "
                'reset(options={"reset_mask": ...}) first'
            )
        outcome = self._flows.act(action)
        reward, truncated, self._diverged = outcome.reward, outcome.truncated, outcome.diverged
        self._fresh[:] = False
        if ended.any():  # with NEXT_STEP: their step is the reset
            self._restart(ended)
            reward[ended], truncated[ended] = 0.0, False
        terminated = self._diverged.copy()
        self._ended = terminated | truncated
        observation, info = self._flows.observe(), self._info()
        if mode == AutoresetMode.SAME_STEP and self._ended.any():
            observation, info = self._restarted(observation, info)
        return observation, reward, terminated, truncated, info

    def _restarted(self, last: np.ndarray, info: dict[str, Any]) -> tuple[np.ndarray, dict[str, Any]]:
        """Start ended flows anew in the same step; return the new observation and info, with the last ones in it."""
        ended = self._ended.copy()
        final = np.full(self.num_envs, None, dtype=object)
        for column in np.flatnonzero(ended):
            final[column] = last[column].copy()
        final_info = info | {key: ended.copy() for key in info if key.startswith("_")}
        self._restart(ended)
        also = {"final_obs": final, "_final_obs": ended, "final_info": final_info, "_final_info": ended.copy()}
        return self._flows.observe(), self._info() | also

    def _info(self, there: np.ndarray | bool = True) -> dict[str, Any]:
        """Return the info of the last action, for the flows that are `there`."""
        there = np.full(self.num_envs, there)
        means = {name: np.where(self._fresh, 0.0, part) for name, part in self._flows.means.items()}
        now = {
            "amplitudes": self._flows.amplitude.T.copy(),
            "time": self._flows.actions * self.task.interval,
            "diverged": self._diverged.copy(),
        }
        present = {f"_{name}": there & ~self._fresh for name in means} | {f"_{name}": there.copy() for name in now}
        return means | now | present


class FlowEnv(gymnasium.Env):
    """One flow under control: `FlowVectorEnv` with a batch of one."""

    metadata = {"render_modes": [], "coefficients": COEFFICIENTS}

    def __init__(self, case: str | Path | Case = load.DEFAULT, task: Task | str | None = None, **overrides: Any):
        self._batch = FlowVectorEnv(1, case, task, AutoresetMode.DISABLED, **overrides)
        self.case, self.task = self._batch.case, self._batch.task
        self.observation_space, self.action_space = spaces(self.case, self.task)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Return to the start state, the developed flow at an upward crossing of C_L."""
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
    """Tell Gymnasium of `manywake/Flow-v0`, any case, and of an id for each shipped flow."""
    ids: dict[str, dict[str, Any]] = {"Flow": {}, "CylinderJets": {"case": "cylinder-jets"}}
    for name, settings in ids.items():
        single, vector = f"{__name__}:FlowEnv", f"{__name__}:FlowVectorEnv"
        gymnasium.register(f"manywake/{name}-v0", single, vector_entry_point=vector, kwargs=settings)
