"""Stock PPO of Stable-Baselines3 that asks for whole episodes: one method overridden, the normaliser in the policy."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import gymnasium
import numpy as np
import torch
from gymnasium import Space
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.utils import obs_as_tensor
from stable_baselines3.common.vec_env import DummyVecEnv

from manywake.case.learning import Learning
from manywake.learn.collect import Collector
from manywake.learn.policy import NORMALISED_LIMIT, Policy
from manywake.learn.rollout import Episode
from manywake.machine import disk

VARIANCE_FLOOR = 1e-8
"""Added to the variance of an observation before it is divided by its root."""


class RunningNorm(BaseFeaturesExtractor):
    """Normalises observations by running statistics that are buffers of the policy: frozen while it plays."""

    mean: torch.Tensor
    variance: torch.Tensor
    count: torch.Tensor

    def __init__(self, observation_space: Space):
        super().__init__(observation_space, features_dim=math.prod(observation_space.shape or ()))
        self.register_buffer("mean", torch.zeros(self.features_dim, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(self.features_dim, dtype=torch.float64))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        scaled = (observations.double() - self.mean) / torch.sqrt(self.variance + VARIANCE_FLOOR)
        return scaled.clamp(-NORMALISED_LIMIT, NORMALISED_LIMIT).float()

    @torch.no_grad()
    def update(self, observations: np.ndarray) -> None:
        """Take a batch (samples, values) into the statistics."""
        batch = observations.astype(np.float64)
        count, mean, variance = len(batch), batch.mean(axis=0), batch.var(axis=0)
        old, new = float(self.count), float(self.count) + count
        delta = torch.from_numpy(mean) - self.mean
        spread = old * self.variance + count * torch.from_numpy(variance) + delta**2 * (old * count / new)
        self.mean += delta * (count / new)
        self.variance.copy_(spread / new)
        self.count.fill_(new)


class RateSchedule:
    """The learning rate of an update, linear in the episodes collected before it: the first has all of it.

    SB3 asks after the update's own episodes have been counted, so their share is added back to what is left.
    """

    def __init__(self, learning: Learning):
        self.start, self.end = learning.learning_rate, learning.learning_rate_end
        self.share = learning.update_period / learning.episodes

    def __call__(self, progress_remaining: float) -> float:
        return self.end + (self.start - self.end) * min(progress_remaining + self.share, 1.0)


class SpacesOnly(gymnasium.Env):
    """Tells SB3 the spaces. It cannot be stepped: episodes come from the collector."""

    def __init__(self, observation_space: Space, action_space: Space):
        self.observation_space, self.action_space = observation_space, action_space

    def reset(self, *, seed=None, options=None):
        return np.zeros(self.observation_space.shape or (), self.observation_space.dtype), {}


@dataclass
class Hooks:
    """Called with a batch before and after the update made of it. converged: True before a batch ends the training."""

    collected: Callable[["EpisodicPPO", list[Episode]], None] = lambda model, episodes: None
    updated: Callable[["EpisodicPPO", list[Episode]], None] = lambda model, episodes: None
    converged: Callable[["EpisodicPPO"], bool] = lambda model: False


class EpisodicPPO(PPO):
    """PPO whose rollouts are whole episodes from a collector. `num_timesteps` counts full horizons.

    version: updates made. clipped_before: share of the samples whose probability ratio lies outside the clip range
    before the update: nought when all were drawn by the policy that is updated.
    """

    collector: Collector
    hooks: Hooks
    learning: Learning
    version: int = 0
    clipped_before: float = 0.0
    _batch: list[Episode]

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "collector", "hooks", "_batch"]

    def collect_rollouts(self, env, callback, rollout_buffer, n_rollout_steps) -> bool:
        """Collect one update's episodes, join them in index order in one column, and bootstrap at the horizon."""
        if self.hooks.converged(self):
            return False
        callback.on_rollout_start()
        self.policy.set_training_mode(False)
        self._batch = episodes = self.collector.collect(snapshot(self))
        self.hooks.collected(self, episodes)
        observations = np.concatenate([episode.observations for episode in episodes])
        actions = np.concatenate([episode.actions for episode in episodes])
        log_probs = torch.from_numpy(np.concatenate([episode.log_probs for episode in episodes]).astype(np.float32))
        ends = np.stack([episode.last_observation for episode in episodes])
        with torch.no_grad():
            ratio = torch.exp(self._log_probs(observations, actions) - log_probs)
            self.clipped_before = float((abs(ratio - 1) > self.learning.clip_range).float().mean())
            normaliser(self).update(observations)
            if self.learning.ratio_to == "current":
                log_probs = self._log_probs(observations, actions)
            values = self.policy.predict_values(obs_as_tensor(observations, self.device)).cpu()
            end_values = self.policy.predict_values(obs_as_tensor(ends, self.device)).cpu().numpy()[:, 0]
        rewards, starts = [], []
        for episode, end_value in zip(episodes, end_values, strict=True):
            rewards.append(episode.rewards.astype(np.float32))
            if not episode.terminated:
                rewards[-1][-1] += self.gamma * end_value
            starts.append(np.arange(len(episode.rewards)) == 0)
        reward, start = np.concatenate(rewards), np.concatenate(starts)
        spaces = self.observation_space, self.action_space
        buffer = RolloutBuffer(len(observations), *spaces, self.device, self.gae_lambda, self.gamma, n_envs=1)
        for k in range(len(observations)):
            at = slice(k, k + 1)
            buffer.add(observations[at], actions[at], reward[at], start[at], values[k], log_probs[at])
        buffer.compute_returns_and_advantage(last_values=torch.zeros(1), dones=np.ones(1))
        self.rollout_buffer = buffer
        self.num_timesteps += len(episodes) * self.collector.simulation.horizon
        assert self.ep_info_buffer is not None
        for episode in episodes:
            self.ep_info_buffer.append({"r": float(episode.rewards.sum()), "l": len(episode.rewards)})
        whole = [self.collector.simulation.summary(e) for e in episodes if not e.terminated]
        for name in whole[0] if whole else ():
            self.logger.record(f"episode/{name}", np.mean([numbers.get(name, np.nan) for numbers in whole]))
        self.logger.record("episode/terminated", len(episodes) - len(whole))
        self.logger.record("train/clipped_before", self.clipped_before)
        callback.update_locals(locals())
        callback.on_rollout_end()
        return True

    def _log_probs(self, observations: np.ndarray, actions: np.ndarray) -> torch.Tensor:
        distribution = self.policy.get_distribution(obs_as_tensor(observations, self.device))
        return distribution.log_prob(torch.from_numpy(actions))

    def train(self) -> None:
        """Update as PPO does, from a generator state that depends on (run seed, version) only."""
        words = np.random.SeedSequence(self.collector.run_seed, spawn_key=(self.version, 2)).generate_state(2)
        np.random.seed(int(words[0]))  # noqa: NPY002 - SB3 shuffles its minibatches with NumPy's global generator
        torch.manual_seed(int(words[1]))
        super().train()
        self.version += 1
        self.hooks.updated(self, self._batch)


def digest(model: PPO) -> str:
    """Return the hash of the policy: weights of actor and critic, and the normaliser."""
    return disk.digest({name: tensor.cpu().numpy() for name, tensor in model.policy.state_dict().items()})


def build(learning: Learning, collector: Collector) -> EpisodicPPO:
    """Make the learner; its first weights depend on the run seed only."""
    torch.set_num_threads(learning.learner_threads)
    samples, hidden = learning.update_period * collector.simulation.horizon, list(learning.hidden)
    alike = ("n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef", "vf_coef", "max_grad_norm")
    model = EpisodicPPO(
        "MlpPolicy",
        DummyVecEnv([lambda: SpacesOnly(*collector.simulation.spaces())]),
        learning_rate=RateSchedule(learning),
        n_steps=samples,
        batch_size=min(learning.batch_size, samples),
        **{name: getattr(learning, name) for name in alike},
        policy_kwargs={
            "net_arch": {"pi": hidden, "vf": hidden},
            "activation_fn": torch.nn.ReLU,
            "features_extractor_class": RunningNorm,
            "log_std_init": learning.log_std_init,
        },
        seed=collector.run_seed,
        device="cpu",
    )
    model.collector, model.learning, model.hooks = collector, learning, Hooks()
    return model


def normaliser(model: PPO) -> RunningNorm:
    """Return the observation normaliser of a model."""
    extractor = model.policy.features_extractor
    assert isinstance(extractor, RunningNorm)
    return extractor


def snapshot(model: PPO) -> Policy:
    """Return the policy of a model as plain arrays."""
    return from_state(model.policy.state_dict(), getattr(model, "version", 0))


def from_state(state: dict[str, torch.Tensor], version: int = 0) -> Policy:
    """Return the policy as plain arrays, from the tensors of `policy.pth` in a checkpoint."""
    values = {name: tensor.detach().cpu().numpy().copy() for name, tensor in state.items()}
    hidden = [name for name in values if name.startswith("mlp_extractor.policy_net") and name.endswith(".weight")]
    layers = [name.removesuffix(".weight") for name in [*hidden, "action_net.weight"]]
    weights = tuple((values[f"{layer}.weight"], values[f"{layer}.bias"]) for layer in layers)
    deviation = np.sqrt(values["features_extractor.variance"] + VARIANCE_FLOOR)
    log_std = values["log_std"].astype(np.float64)
    return Policy(version, values["features_extractor.mean"], deviation, weights, log_std, np.exp(log_std))
