"""The cylinder's jets under plain Stable-Baselines3, PPO or SAC: its own loop and buffers, on 16 flows side by side.

    python examples/train_sb3.py --algorithm sac --seed 1

Expect 7 to 8 % of the drag saved at the end; the steady flow has 8 % less. PPO saved 7.8, 7.9 and 7.7 % after 256
episodes (seeds 0, 1, 2; 145 s on one core). SAC saved 7.7, 7.4 and 7.3 % after 192 (225 s).
The model is saved as SB3's zip, the running mean and deviation of the observations beside it (`VecNormalize.load`).
`manywake train` uses two cores and gives the same bits for any number of them; this does neither.
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
import tyro
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from manywake.sb3 import FlowVecEnv


def train(algorithm: str, total: int | None = None, flows: int = 16, seed: int = 0, **settings: Any) -> BaseAlgorithm:
    """Train for a number of actions, all flows counted, on the paper's case with single settings of it replaced."""
    torch.set_num_threads(1)  # networks this small are many times slower on more
    environment = VecNormalize(VecMonitor(FlowVecEnv(flows, **settings)), norm_reward=False)
    episode = flows * environment.get_attr("task")[0].actions  # of all flows together
    networks: dict[str, Any] = {"net_arch": [256, 256], "activation_fn": torch.nn.ReLU}
    alike: dict[str, Any] = {"seed": seed, "device": "cpu", "verbose": 1}
    if algorithm == "ppo":  # an update is one episode of each flow; the settings are those of `manywake train`
        return PPO(
            "MlpPolicy",
            environment,
            learning_rate=lambda left: 5e-4 * left,
            n_steps=episode // flows,
            batch_size=max(episode // 8, 2),
            n_epochs=5,
            gae_lambda=0.97,
            policy_kwargs=networks | {"log_std_init": -1.5},
            **alike,
        ).learn(total or 16 * episode)
    return SAC(  # half a gradient step for each action, once each flow has had a quarter of an episode of random ones
        "MlpPolicy",
        environment,
        learning_rate=lambda left: 1e-3 * left,
        learning_starts=episode // 4,
        gradient_steps=max(flows // 2, 1),
        gamma=0.98,
        ent_coef="auto_0.02",
        policy_kwargs=networks | {"net_arch": [128, 128]},
        **alike,
    ).learn(total or 12 * episode, log_interval=flows)


def drag_saved(model: BaseAlgorithm, **settings: Any) -> float:
    """Return the share of the drag that a policy saves without noise, in the second half of an episode."""
    pair, normaliser, drag = FlowVecEnv(2, **settings), model.get_vec_normalize_env(), []
    assert normaliser is not None
    seen, done = pair.reset(), np.zeros(2, dtype=bool)
    while not done.any():
        action, _ = model.predict(normaliser.normalize_obs(seen), deterministic=True)
        seen, _, done, infos = pair.step(action * [[1.0], [0.0]])  # the second flow is left alone
        drag.append([info["c_d"] for info in infos])
    controlled, free = np.mean(drag[len(drag) // 2 :], axis=0)
    return float(1.0 - controlled / free)


def main(
    algorithm: Literal["ppo", "sac"] = "ppo", total: int | None = None, seed: int = 0, folder: Path = Path("runs")
) -> None:
    """Train, save the model, and say what the policy achieves.

    Args:
        algorithm: PPO or SAC.
        total: Actions in all; by default 256 episodes of PPO, 192 of SAC.
        seed: Of weights and exploration.
        folder: Where the model is saved.
    """
    model, path = train(algorithm, total, seed=seed), folder / f"sb3-{algorithm}-{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    model.save(path)
    normaliser = model.get_vec_normalize_env()
    assert normaliser is not None
    normaliser.save(f"{path}.pkl")
    print(f"saved {path}.zip; without noise the policy saves {drag_saved(model):.1%} of the drag")


if __name__ == "__main__":
    tyro.cli(main)
