"""Any other simulation behind a Gymnasium environment, played an episode at a time."""

import importlib
import os
import sys
import time
from dataclasses import dataclass, field
from functools import lru_cache

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from manywake.learn import policy as policies
from manywake.learn.policy import Policy
from manywake.learn.rollout import Episode, Exploration


@dataclass(frozen=True)
class External:
    """An environment by name: `module:factory`, or an id registered with Gymnasium.

    horizon: most actions of an episode; an episode that gets there is truncated. folder: where the module is looked
    for besides the installed packages. The environment is made once in each worker, reset with the episode's seed, and
    made anew after an error. To give the same bits everywhere it must depend on that seed and the actions only.
    """

    name: str
    horizon: int
    folder: str = field(default_factory=os.getcwd)

    def spaces(self) -> tuple[Box, Box]:
        """Return the environment's spaces, flattened to vectors."""
        environment = _environment(self.name, self.folder)
        observation, action = environment.observation_space, environment.action_space
        assert isinstance(observation, Box) and isinstance(action, Box)
        return tuple(Box(_flat(space.low), _flat(space.high)) for space in (observation, action))  # type: ignore[return-value]

    def play(self, policy: Policy, explorations: list[Exploration]) -> list[Episode]:
        try:
            return [self._play(policy, exploration) for exploration in explorations]
        except BaseException:
            _environment.cache_clear()
            raise

    def _play(self, policy: Policy, exploration: Exploration) -> Episode:
        environment = _environment(self.name, self.folder)
        space = environment.action_space
        assert isinstance(space, Box)
        observation, _ = environment.reset(seed=exploration.seed)
        observations, actions, log_probs, rewards = [_flat(observation)], [], [], []
        readings: dict[str, list[float]] = {}
        policy_seconds, begin, terminated = 0.0, time.perf_counter(), False
        for noise in exploration.noise:
            start = time.perf_counter()
            mean = policies.act(policy, observations[-1][None])
            action, log_prob = policies.sample(policy, mean, noise[None])
            policy_seconds += time.perf_counter() - start
            played = np.clip(action[0].reshape(space.shape), space.low, space.high).astype(space.dtype)
            observation, reward, terminated, truncated, info = environment.step(played)
            observations.append(_flat(observation))
            actions.append(action[0])
            log_probs.append(log_prob[0])
            rewards.append(float(reward))
            for key, value in info.items():
                if np.ndim(value) == 0 and isinstance(value, int | float | np.number):
                    readings.setdefault(key, []).append(float(value))
            if terminated or truncated:
                break
        if not (np.isfinite(rewards).all() and np.isfinite(observations).all()):
            raise ValueError(f"environment {self.name!r}: got a reward or an observation that is not finite")
        return Episode(
            exploration.index,
            policy.version,
            np.stack(observations[:-1]),
            observations[-1],
            np.stack(actions),
            np.array(log_probs),
            np.array(rewards),
            {key: np.array(values) for key, values in readings.items() if len(values) == len(rewards)},
            bool(terminated),
            time.perf_counter() - begin - policy_seconds,
            policy_seconds,
        )

    def summary(self, episode: Episode) -> dict[str, float]:
        """Return the mean of each scalar that `info` had at every action."""
        return {name: float(series.mean()) for name, series in episode.readings.items()}

    def expected_seconds(self, lanes: int) -> float | None:
        return None


def _flat(observation) -> np.ndarray:
    return np.asarray(observation, np.float32).reshape(-1)


def open_simulation(name: str, horizon: int | None = None) -> External:
    """Return the simulation of an environment's name, after a look at it; ValueError when it cannot be collected.

    horizon: needed when the environment is registered without a limit of its own.
    """
    environment = _environment(name, os.getcwd())
    for kind, space in (("observation", environment.observation_space), ("action", environment.action_space)):
        if not isinstance(space, Box):
            raise ValueError(f"env {name!r}: got the {kind} space {space}, wanted a Box; wrap it in one")
    limit = environment.spec.max_episode_steps if environment.spec is not None else None
    limits = [steps for steps in (limit, horizon) if steps is not None]
    if not limits:
        raise ValueError(
            f"env {name!r}: it has no limit of steps; give one with --actions-per-episode, or register it with "
            "max_episode_steps"
        )
    return External(name, min(limits))


@lru_cache(maxsize=1)
def _environment(name: str, folder: str) -> gymnasium.Env:
    if folder not in sys.path:
        sys.path.insert(0, folder)
    module, colon, factory = name.partition(":")
    if colon:
        try:
            make = getattr(importlib.import_module(module), factory, None)
        except ImportError as error:
            raise ValueError(
                f"env: got {name!r}, but the module {module!r} cannot be loaded ({error}); wanted module:factory, "
                f"with the module installed or in {folder}"
            ) from error
        if callable(make):
            return make()
    try:
        return gymnasium.make(name)
    except gymnasium.error.Error as error:
        raise ValueError(
            f"env: got {name!r} ({error}); wanted module:factory or an id registered with Gymnasium"
        ) from error
