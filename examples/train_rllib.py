"""The cylinder's jets under RLlib's PPO (RLModule and Learner), on 16 flows side by side.

    pip install -e . "ray[rllib]==2.60.*"
    python examples/train_rllib.py --runners 2

Two updates with episodes of 8 actions were tried, with ray 2.60.0, gymnasium 1.2.2 and torch 2.13.0. Whether it learns
was not. RLlib wants exactly one version of Gymnasium: give it a virtual environment of its own.

`env_config` becomes keyword arguments of the environment. A runner in another process knows the id by the module before
its colon alone. FlowEnv itself in place of the id does not work: RLlib would call it with one dictionary.
"""

import ray
import torch
import tyro
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.connectors.env_to_module import MeanStdFilter
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig


def train(episodes: int = 256, runners: int = 0, actions: int = 160, interval: float = 0.025, seed: int = 0) -> float:
    """Train; return the mean reward of the last update's episodes.

    Args:
        episodes: In all.
        runners: Processes that the 16 flows are spread over, a divisor of 16; 0 for the learner's own process.
        actions: Horizon of an episode.
        interval: Time between actions.
        seed: Of weights, exploration and episodes.
    """
    torch.set_num_threads(1)  # networks this small are slower on more
    flows, samples, reward = 16, 16 * actions, float("nan")
    given = {"actions": actions, "interval": interval}
    net = DefaultModelConfig(fcnet_activation="relu", vf_share_layers=False, free_log_std=True)  # 256 and 256 units
    settings = PPOConfig().environment("manywake:manywake/CylinderJets-v0", env_config=given)
    settings.rl_module(model_config=net).debugging(seed=seed).reporting(metrics_num_episodes_for_smoothing=flows)
    settings.env_runners(
        num_env_runners=runners,
        num_envs_per_env_runner=flows // max(runners, 1),
        gym_env_vectorize_mode="vector_entry_point",  # FlowVectorEnv, a true batch, and not one flow after the other
        env_to_module_connector=lambda env, spaces, device: MeanStdFilter(),
    )
    settings.training(lr=5e-4, gamma=0.99, lambda_=0.97, clip_param=0.2, num_epochs=5, grad_clip=0.5, use_kl_loss=False)
    # RLlib would clip the critic's squared error, and learn nothing from a larger one
    settings.training(vf_loss_coeff=0.5, vf_clip_param=float("inf"))
    settings.training(train_batch_size_per_learner=samples, minibatch_size=samples // 8)
    ray.init(address="local", include_dashboard=False, logging_level="WARNING")
    try:
        trainer = settings.build_algo()
        for update in range(episodes // flows):
            reward = trainer.train()["env_runners"]["episode_return_mean"]
            print(f"{(update + 1) * flows:4d} episodes, mean reward of an episode {reward:.4g}", flush=True)
        trainer.stop()
    finally:
        ray.shutdown()
    return reward


if __name__ == "__main__":
    tyro.cli(train)
