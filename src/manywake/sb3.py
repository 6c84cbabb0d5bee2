"""A batch of flows as Stable-Baselines3 wants it: a `VecEnv` for its algorithms and wrappers, and for sb3-contrib's.

    model = PPO("MlpPolicy", FlowVecEnv(16), device="cpu").learn(40960)

Call torch.set_num_threads(1) before: networks this small are many times slower on several threads.
"""

from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from manywake.case.case import Case
from manywake.case.task import Task
from manywake.env.env import FlowVectorEnv
from manywake.suite import load


class FlowVecEnv(VecEnv):
    """B flows of one case in one process, advanced together: `flows`, a `FlowVectorEnv`, with the same bits.

    num_envs: B. case, task and every other setting: as of `FlowVectorEnv`. After seed(s) flow i has, from the next
    reset on, the episodes of a single environment that was reset with s + i.

    A flow is reset in the step that ends its episode. Its info then has the last observation of the episode
    (`terminal_observation`), and whether the horizon was the only reason (`TimeLimit.truncated`). The info of the new
    episode stands in `reset_infos`. All flows share one environment: an attribute or a method is that of the batch.
    """

    def __init__(
        self,
        num_envs: int = 16,
        case: str | Path | Case = load.DEFAULT,
        task: Task | str | None = None,
        **overrides: Any,
    ):
        self.flows = FlowVectorEnv(num_envs, case, task, autoreset_mode=AutoresetMode.SAME_STEP, **overrides)
        super().__init__(num_envs, self.flows.single_observation_space, self.flows.single_action_space)
        self.metadata = self.flows.metadata

    def reset(self) -> np.ndarray:
        """Begin an episode in all flows, of the seeds that `seed` gave, if it did since the last reset."""
        observation, info = self.flows.reset(seed=self._seeds)
        self.reset_infos = [_of(info, b) for b in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Hold the actions (B, actions) for one action interval; the info has the readings of each flow by name."""
        observation, reward, terminated, truncated, info = self.flows.step(self._actions)
        done, infos = terminated | truncated, []
        last, final = info.pop("final_info", None), info.pop("final_obs", None)
        for b in range(self.num_envs):
            now = _of(info, b)
            if done[b]:
                self.reset_infos[b] = now
                now = _of(last, b) | {"terminal_observation": final[b]}
            infos.append(now | {"TimeLimit.truncated": bool(truncated[b])})
        return observation, reward.astype(np.float32), done, infos

    def close(self) -> None:
        self.flows.close()

    def get_images(self) -> list[np.ndarray | None]:
        """Return a picture of each flow (H, W, 3), or None for each when made without render_mode="rgb_array"."""
        frames: Any = self.flows.render() if self.render_mode == "rgb_array" else [None] * self.num_envs
        return list(frames)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the batch for each of some flows; a space is that of a single flow."""
        single = f"single_{attr_name}"
        return self._each(getattr(self.flows, single if hasattr(self.flows, single) else attr_name), indices)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the batch, hence of all flows; ValueError when only some are meant."""
        self._all(attr_name, indices)
        setattr(self.flows, attr_name, value)

    def env_method(self, method_name: str, *method_args, indices: VecEnvIndices = None, **method_kwargs) -> list[Any]:
        """Call a method of the batch once; return what it returns for each flow. ValueError for some flows only."""
        self._all(method_name, indices)
        return self._each(getattr(self.flows, method_name)(*method_args, **method_kwargs), indices)

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Return False for each of some flows: none has a wrapper of its own."""
        return self._each(False, indices)

    def _each(self, value: Any, indices: VecEnvIndices) -> list[Any]:
        return [value for _ in self._get_indices(indices)]

    def _all(self, name: str, indices: VecEnvIndices) -> None:
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise ValueError(f"{name}: got indices={indices}, wanted None; all flows share one environment")


def _of(info: dict[str, Any], b: int) -> dict[str, Any]:
    """Return what the info of a batch says of flow b."""
    return {key: value[b] for key, value in info.items() if not key.startswith("_") and info[f"_{key}"][b]}
