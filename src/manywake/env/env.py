"""The Gymnasium environments of any flow: a true batch, and a single one."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from manywake.case.case import Case
from manywake.case.task import Task
from manywake.env.control import spaces
from manywake.env.several import SeveralFlows
from manywake.flow import store
from manywake.suite import load

COEFFICIENTS = "C = 2F / (rho U^2 L), force on the body; drag positive downstream, lift positive up"


def _say(what: str, share: float) -> None:
    """Tell on the standard error how far the baseline of a new case is."""
    print(f"\rmanywake: baseline, {what} {share:4.0%}", end="\n" if share >= 1 else "", file=sys.stderr, flush=True)


def _drawn(random: np.random.Generator) -> int:
    """Return the seed of the next episode of a flow whose generator this is."""
    return int(random.integers(2**32))


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
    observation and a charge. An episode is a function of its seed and of the actions. After reset(seed=s) flow i has
    the episodes of a single environment that was reset with s + i: that of the seed, then those of seeds drawn from a
    generator of its own. `info` has, for the last action, every reading by name (means, absent before the first
    action, NaN when the flow blew up; their convention stands in `metadata["coefficients"]`), amplitudes (inputs), the
    Reynolds number, time and diverged.
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
        flows = [store.flow(case, _say) for case in chosen.cases]
        self._flows = SeveralFlows(flows, self.task, num_envs)
        self._ended, self._diverged = np.zeros((2, num_envs), dtype=bool)
        self._fresh = ~self._ended
        self._random = [seeding.np_random()[0] for _ in range(num_envs)]

    def _restart(self, which: np.ndarray, given: Sequence[int | None] | None = None) -> None:
        """Begin the next episodes of the flows of a mask, of seeds that are given; a fresh flow has no readings yet."""
        columns, seeds = np.flatnonzero(which), []
        for column in columns.tolist():
            seed = None if given is None else given[column]
            if seed is not None:
                self._random[column] = seeding.np_random(seed)[0]
            seeds.append(_drawn(self._random[column]) if seed is None else seed)
        self._flows.reset(columns, seeds)
        self._fresh[which], self._ended[which], self._diverged[which] = True, False, False

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None):
        """Begin an episode in all flows, or in those of options["reset_mask"].

        seed: of the first flow's episode, the others' being those that follow; or a seed, or None, for each flow. A
        flow without one goes on to the seed that its own generator draws.
        """
        if isinstance(seed, np.ndarray):
            seed = seed.tolist()
        if seed is None:
            given: list[int | None] = [None] * self.num_envs
        else:
            given = list(seed) if isinstance(seed, Sequence) else [seed + k for k in range(self.num_envs)]
        if len(given) != self.num_envs:
            raise ValueError(
                f"seed: got {len(given)}, wanted one for each of the {self.num_envs} flows, or one for all"
            )
        super().reset(seed=given[0], options=options)
        mask = (options or {}).get("reset_mask")
        mask = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise ValueError(
                f"reset_mask: got {mask}, wanted {self.num_envs} booleans, one per flow, at least one True"
            )
        self._restart(mask, given)
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
        reward, self._diverged, truncated = self._flows.act(action)
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
            "amplitudes": self._flows.amplitude,
            "reynolds": self._flows.reynolds(),
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
        self._under_way = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Begin the episode of a seed; without one, that of a seed drawn from `np_random`."""
        super().reset(seed=seed, options=options)
        observation, info = self._batch.reset(seed=_drawn(self.np_random) if seed is None else seed)
        self._under_way = True
        return observation[0], _single(info)

    def step(self, action):
        """Hold the action for one action interval."""
        if not self._under_way:
            raise ValueError("step: got an action while no episode is under way, wanted reset() first")
        _checked(action, self.action_space.shape)
        observation, reward, terminated, truncated, info = self._batch.step(np.asarray(action)[None])
        self._under_way = not (terminated[0] or truncated[0])
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), _single(info)

    def close(self):
        """End what is under way."""
        self._under_way = False


def _single(info: dict[str, Any]) -> dict[str, Any]:
    """Return the info of a batch of one without the batch axis."""
    single = {key: value[0] for key, value in info.items() if not key.startswith("_") and info[f"_{key}"][0]}
    return {key: value.item() if value.ndim == 0 else value for key, value in single.items()}


def register() -> None:
    """Tell Gymnasium of `manywake/Flow-v0`, any case, and of an id for each shipped flow."""
    shipped = (
        "cylinder-jets",
        "fluidgym-cylinder",
        "free-cylinder-jets",
        "free-cylinder-rotation",
        "pinball",
        "square-jets",
        "step",
    )
    ids: dict[str, dict[str, Any]] = {"Flow": {}}
    ids |= {name.title().replace("-", ""): {"case": name} for name in shipped}
    for name, settings in ids.items():
        single, vector = f"{__name__}:FlowEnv", f"{__name__}:FlowVectorEnv"
        gymnasium.register(f"manywake/{name}-v0", single, vector_entry_point=vector, kwargs=settings)
