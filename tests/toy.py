"""A task that is learnt in seconds: push a drifting point back to zero. Played by the real policy code."""

from types import SimpleNamespace

import numpy as np
from gymnasium.spaces import Box

from manywake.learn import policy as policies
from manywake.learn.rollout import Episode, seed_sequence
from manywake.learn.settings import Learning

HORIZON = 20


class ToyCollector:
    """Collects episodes of the toy task; one in `terminate_every` ends early, as a flow that blows up would."""

    spaces = (Box(-10, 10, (3,), np.float32), Box(-1, 1, (1,), np.float32))
    learning = Learning(update_period=10, episodes=100, learning_rate=3e-3, batch_size=50, hidden=(32, 32))

    def __init__(self, run_seed: int = 0, terminate_every: int | None = None):
        self.run_seed = run_seed
        self.terminate_every = terminate_every
        self.task = SimpleNamespace(actions_per_episode=HORIZON)

    def collect(self, policy, indices, arrived) -> list[Episode]:
        episodes = [self._play(policy, index) for index in indices]
        arrived(episodes)
        return episodes

    def _play(self, policy, index: int) -> Episode:
        rng = np.random.default_rng(seed_sequence(self.run_seed, index))
        early = self.terminate_every is not None and index % self.terminate_every == 0
        length = HORIZON // 2 if early else HORIZON
        x, drift = rng.uniform(-1, 1), 0.1
        observations, actions, log_probs, rewards = [], [], [], []
        for _ in range(length):
            observation = np.array([5 + x, x * x, 1.0], np.float32)
            mean = policies.act(policy, observation[None])
            action, log_prob = policies.sample(policy, mean, rng.standard_normal((1, 1)))
            x += drift + 0.5 * float(np.clip(action[0, 0], -1, 1))
            observations.append(observation)
            actions.append(action[0])
            log_probs.append(log_prob[0])
            rewards.append(-abs(x))
        series = np.array(rewards)
        return Episode(
            index, policy.version, np.stack(observations), np.array([5 + x, x * x, 1.0], np.float32),
            np.stack(actions), np.array(log_probs), series, series, series, np.stack(actions)[:, 0],
            early, 0.0, 0.0,
        )  # fmt: skip
