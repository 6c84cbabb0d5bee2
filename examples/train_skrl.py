"""The cylinder's jets under skrl's PPO: another library's loop on the same batch of flows.

    python examples/train_skrl.py --seed 1

skrl takes a Gymnasium vector environment as it is. It records every step, so the step that Gymnasium's autoreset spends
on the reset (reward 0, action without effect) is in its samples too: one in `actions` + 1.
"""

import numpy as np
import skrl
import torch
import tyro
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.trainers.torch import SequentialTrainer, SequentialTrainerCfg
from torch import nn

from manywake import FlowVectorEnv


def layers(inputs: int, outputs: int) -> nn.Sequential:
    """Return a network of two hidden layers whose first answers are near 0."""
    last = nn.Linear(256, outputs)
    nn.init.orthogonal_(last.weight, 0.01)
    return nn.Sequential(nn.Linear(inputs, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), last)


class Actor(GaussianMixin, Model):
    """A Gaussian whose mean depends on the observation."""

    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.network = layers(self.num_observations, self.num_actions)
        self.log_std = nn.Parameter(torch.full((self.num_actions,), -1.5))

    def compute(self, inputs, role):
        return self.network(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    """The value of an observation."""

    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.network = layers(self.num_observations, 1)

    def compute(self, inputs, role):
        return self.network(inputs["observations"]), {}


def train(
    total: int = 40960,
    flows: int = 16,
    actions: int = 160,
    interval: float = 0.025,
    seed: int = 0,
) -> PPO:
    """Train for a number of actions, all flows counted; return the agent.

    Args:
        total: Actions in all.
        flows: Flows advanced side by side, at least 2: skrl resets a single environment itself.
        actions: Horizon of an episode.
        interval: Time between actions.
        seed: Of weights and exploration.
    """
    skrl.config.torch.device = "cpu"
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # networks this small are slower on more
    batch = FlowVectorEnv(flows, actions=actions, interval=interval)
    watched = RecordEpisodeStatistics(batch)
    environment = wrap_env(watched, wrapper="gymnasium", verbose=False)
    spaces = {
        "observation_space": environment.observation_space,
        "action_space": environment.action_space,
        "device": environment.device,
    }
    rollout = actions + 1
    settings = PPO_CFG(
        rollouts=rollout,
        learning_epochs=5,
        mini_batches=8,
        learning_rate=5e-4,
        gae_lambda=0.97,
        time_limit_bootstrap=True,
        observation_preprocessor=RunningStandardScaler,
        observation_preprocessor_kwargs={"size": environment.observation_space, "device": environment.device},
    )
    settings.experiment.write_interval = settings.experiment.checkpoint_interval = 0
    agent = PPO(
        models={"policy": Actor(**spaces), "value": Critic(**spaces)},
        memory=RandomMemory(memory_size=rollout, num_envs=flows, device=environment.device),
        cfg=settings,
        **spaces,
    )
    steps = SequentialTrainerCfg(timesteps=total // flows, headless=True, close_environment_at_exit=False)
    try:
        SequentialTrainer(cfg=steps, env=environment, agents=agent).train()
    finally:
        environment.close()
    print(f"mean reward of the last {len(watched.return_queue)} episodes {np.mean(watched.return_queue):.4g}")
    return agent


def saved(agent: PPO, **given) -> float:
    """Return the share of the drag that the policy without noise saves, in the second half of an episode."""
    pair, drag = FlowVectorEnv(2, **given), []
    seen, _ = pair.reset(seed=0)
    for _ in range(pair.task.actions):
        with torch.no_grad():
            scaled = agent._observation_preprocessor(torch.as_tensor(seen))
            action = agent.models["policy"].network(scaled).numpy()
        seen, _, _, _, info = pair.step(action * [[1.0], [0.0]])  # the second flow is left alone
        drag.append(info["c_d"])
    controlled, free = np.mean(drag[len(drag) // 2 :], axis=0)
    return float(1 - controlled / free)


def main(total: int = 40960, seed: int = 0) -> None:
    """Train, and say what the policy achieves.

    Args:
        total: Actions in all.
        seed: Of weights and exploration.
    """
    print(f"drag saved: {saved(train(total, seed=seed)):.2%}")


if __name__ == "__main__":
    tyro.cli(main)
