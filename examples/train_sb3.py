"""The cylinder's jets under plain Stable-Baselines3, PPO or SAC: its own loop, its own buffers, a batch of flows.

    python examples/train_sb3.py --algorithm sac --total 20000

No engine, no whole episodes and no promise of bits: this shows that the environment is like any other. Neither SB3 nor
Gymnasium has an adapter from a Gymnasium vector environment to SB3's VecEnv, so a small one is here.
"""

from typing import Any, Literal

import gymnasium
import numpy as np
import torch
import tyro
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

from manywake import FlowVectorEnv


class Batch(VecEnv):
    """A Gymnasium vector environment with autoreset in the same step, as SB3 wants it.

    SB3 resets in the step that ends an episode, and looks in the info of that environment for the observation before
    the reset and for whether a time limit was the only reason. Attributes and methods are the whole batch's.
    """

    def __init__(self, flows: gymnasium.vector.VectorEnv):
        mode = flows.metadata["autoreset_mode"]
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f"flows: got autoreset {mode}, wanted SAME_STEP; make them with that autoreset_mode")
        self.flows = flows
        super().__init__(flows.num_envs, flows.single_observation_space, flows.single_action_space)

    def reset(self) -> np.ndarray:
        observation, info = self.flows.reset(seed=self._seeds[0])
        self.reset_infos = [_of(info, b) for b in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self):
        observation, reward, terminated, truncated, info = self.flows.step(self._actions)
        done, infos = terminated | truncated, []
        for b in range(self.num_envs):
            if done[b]:
                infos.append(_of(info["final_info"], b) | {"terminal_observation": info["final_obs"][b]})
                self.reset_infos[b] = _of(info, b)
            else:
                infos.append(_of(info, b))
            infos[b]["TimeLimit.truncated"] = bool(truncated[b] and not terminated[b])
        return observation, reward.astype(np.float32), done, infos

    def close(self) -> None:
        self.flows.close()

    def get_attr(self, attr_name: str, indices=None) -> list[Any]:
        return [getattr(self.flows, attr_name)] * self._count(indices)

    def set_attr(self, attr_name: str, value: Any, indices=None) -> None:
        setattr(self.flows, attr_name, value)

    def env_method(self, method_name: str, *args, indices=None, **kwargs) -> list[Any]:
        return [getattr(self.flows, method_name)(*args, **kwargs)] * self._count(indices)

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        return [False] * self._count(indices)

    def _count(self, indices) -> int:
        return len(list(self._get_indices(indices)))


def _of(info: dict[str, Any], b: int) -> dict[str, Any]:
    """Return what the info of a batch says of environment b."""
    return {
        key: value[b]
        for key, value in info.items()
        if not key.startswith(("_", "final_")) and info.get(f"_{key}", np.ones(b + 1))[b]
    }


def train(
    algorithm: Literal["ppo", "sac"] = "ppo",
    total: int = 20480,
    flows: int = 8,
    actions: int = 160,
    interval: float = 0.025,
    seed: int = 0,
) -> BaseAlgorithm:
    """Train for a number of actions, all flows counted; return the model.

    Args:
        algorithm: PPO or SAC.
        total: Actions in all.
        flows: Flows advanced side by side.
        actions: Horizon of an episode.
        interval: Time between actions.
        seed: Of weights and exploration.
    """
    torch.set_num_threads(1)  # networks this small are slower on more
    batch = FlowVectorEnv(flows, autoreset_mode=AutoresetMode.SAME_STEP, actions=actions, interval=interval)
    environment = VecMonitor(Batch(batch))
    model: BaseAlgorithm
    if algorithm == "ppo":
        # an update of two episodes a flow, in minibatches of a fifth of an episode
        steps, size = 2 * actions, max(flows * actions // 5, 2)
        model = PPO("MlpPolicy", environment, n_steps=steps, batch_size=size, seed=seed, device="cpu", verbose=1)
    else:
        # one gradient step a flow and action; what came before an episode of each flow was over is random
        begin = flows * actions
        model = SAC(
            "MlpPolicy", environment, learning_starts=begin, gradient_steps=-1, seed=seed, device="cpu", verbose=1
        )
    try:
        return model.learn(total, log_interval=1 if algorithm == "ppo" else flows)
    finally:
        environment.close()


if __name__ == "__main__":
    tyro.cli(train)
