"""Any other simulation behind a Gymnasium environment, played an episode at a time."""

import importlib
import math
import os
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from manywake.learn import policy as policies
from manywake.learn.engine import Engine
from manywake.learn.policy import Policy
from manywake.learn.rollout import Context, Episode, context

KIND = "env"
HORIZON = 160
"""Most actions of an episode, where an environment has no limit of its own and none is given."""
EVALUATED = 16
"""Episodes of an evaluation."""


@dataclass(frozen=True)
class External:
    """An environment by name: `module:factory`, or an id registered with Gymnasium.

    horizon: most actions of an episode; one that gets there is truncated. folder: where the module is looked for
    besides the installed packages. observation, action: its spaces, flattened to vectors. Each worker (and each thread)
    makes the environment once, resets it with the episode's seed, and after an error closes it and makes it anew. To
    give the same bits everywhere it must depend on that seed and the actions only.
    """

    name: str
    horizon: int
    folder: str
    observation: Box
    action: Box

    def spaces(self) -> tuple[Box, Box]:
        return self.observation, self.action

    def play(self, driving: Sequence[Policy], contexts: list[Context]) -> list[Episode]:
        key = self.name, self.folder
        if getattr(_here, "key", None) != key:
            _close()
            _here.environment, _here.key = _make(*key), key
        try:
            return [self._play(_here.environment, driving, each) for each in contexts]
        except BaseException:
            _close()
            raise

    def _play(self, environment: gymnasium.Env, driving: Sequence[Policy], own: Context) -> Episode:
        space = environment.action_space
        assert isinstance(space, Box)
        observation, _ = environment.reset(seed=own.seed)
        observations, actions, log_probs, rewards = [_flat(observation)], [], [], []
        readings: dict[str, dict[int, float]] = {}
        policy_seconds, begin, terminated = 0.0, time.perf_counter(), False
        for which, noise in zip(own.which, own.noise, strict=True):
            start = time.perf_counter()
            action, log_prob = policies.draw(driving, which[None], observations[-1][None], noise[None])
            policy_seconds += time.perf_counter() - start
            played = np.clip(action[0].reshape(space.shape), space.low, space.high).astype(space.dtype)
            observation, reward, terminated, truncated, info = environment.step(played)
            observations.append(_flat(observation))
            actions.append(action[0])
            log_probs.append(log_prob[0])
            rewards.append(float(reward))
            for key, value in info.items():
                if np.ndim(value) == 0 and isinstance(value, int | float | np.number):
                    readings.setdefault(key, {})[len(rewards) - 1] = float(value)
            if terminated or truncated:
                break
        if not (np.isfinite(rewards).all() and np.isfinite(observations).all()):
            raise ValueError(f"environment {self.name!r}: got a reward or an observation that is not finite")
        return Episode(
            own.index,
            np.array([policy.version for policy in driving])[own.which[: len(rewards)]],
            np.stack(observations[:-1]),
            observations[-1],
            np.stack(actions),
            np.array(log_probs),
            np.array(rewards),
            {key: np.array([at.get(t, np.nan) for t in range(len(rewards))]) for key, at in readings.items()},
            bool(terminated),
            time.perf_counter() - begin - policy_seconds,
            policy_seconds,
        )

    def summary(self, episode: Episode) -> dict[str, float]:
        """Return the mean of each scalar of `info`, over the actions that had it, as info_<name>."""
        return {f"info_{name}": float(np.nanmean(series)) for name, series in sorted(episode.readings.items())}

    def gain(self, summary: dict[str, float]) -> float:
        return math.nan

    def variant(self, seed: int) -> int:
        return 0

    def expected_seconds(self, lanes: int) -> float | None:
        return None

    def evaluate(self, policy: Policy, engine: Engine) -> "Returns":
        """Play `EVALUATED` episodes of seeds that no training has, without exploration."""
        quiet = [_quiet(index, self.horizon, self.action.shape[0]) for index in range(EVALUATED)]
        shared = engine.share(self)
        futures = [engine.submit(_play, shared, [own], policy) for own in quiet]
        rewards = [float(episode.rewards.sum()) for future in futures for episode in future.result()]
        return Returns(rewards)

    def describe(self) -> dict[str, Any]:
        return {"kind": KIND, "env": self.name, "folder": self.folder, "horizon": self.horizon}

    def save(self, folder: Path) -> dict[str, Any]:
        return {}


@dataclass(frozen=True)
class Returns:
    """Sums of rewards of a deterministic policy's episodes."""

    rewards: list[float]

    def summary(self) -> dict[str, Any]:
        spread = float(np.std(self.rewards, ddof=1)) if len(self.rewards) > 1 else 0.0
        return {"reward_mean": float(np.mean(self.rewards)), "reward_std": spread, "rewards": self.rewards}

    def table(self) -> list[tuple[str, ...]]:
        numbers = self.summary()
        return [
            ("policy without noise", f"{len(self.rewards)} episodes"),
            ("sum of rewards, mean", f"{numbers['reward_mean']:.4g}"),
            ("standard deviation", f"{numbers['reward_std']:.3g}"),
        ]

    def draw(self, folder: Path, tail: str) -> None:
        """Nothing: what an environment of someone else's looks like is not known."""


def _quiet(index: int, horizon: int, actions: int) -> Context:
    """Return the context of an episode without exploration; its run seed is past those that users give."""
    drawn = context(2**32, index, horizon, actions)
    return replace(drawn, noise=np.zeros_like(drawn.noise))


def _play(simulation: External, contexts: list[Context], policy: Policy) -> list[Episode]:
    return simulation.play([policy], contexts)


def _flat(observation) -> np.ndarray:
    return np.asarray(observation, np.float32).reshape(-1)


def open_simulation(name: str, horizon: int, folder: str) -> External:
    """Return the simulation of an environment's name, after a look at it; ValueError when it cannot be collected.

    horizon: most actions of an episode, where the environment was not registered with a limit of its own.
    """
    environment = _make(name, folder)
    try:
        flat = []
        for kind, space in (("observation", environment.observation_space), ("action", environment.action_space)):
            if not isinstance(space, Box):
                raise ValueError(f"env {name!r}: got the {kind} space {space}, wanted a Box; wrap it in one")
            flat.append(Box(_flat(space.low), _flat(space.high)))
        limit = environment.spec.max_episode_steps if environment.spec is not None else None
        return External(name, limit or horizon, folder, *flat)
    finally:
        environment.close()


def reopen(folder: Path, described: dict[str, Any], name: str | None) -> External:
    """Return what a run played, from the environment's name, which the user gives again.

    described: what `External.describe` wrote. A folder's word alone imports nothing; ValueError without the name.
    """
    if name is None or name != described["env"]:
        raise ValueError(
            f"env: got {name!r} for {folder}, which was made with {described['env']!r}; no module is imported because "
            f"a folder names it; give it again: --env {described['env']}"
        )
    return open_simulation(name, described["horizon"], os.getcwd())


_here = threading.local()
"""The environment of this thread, and its name."""


def _close() -> None:
    """Close this thread's environment, if it has one."""
    environment, _here.environment, _here.key = getattr(_here, "environment", None), None, None
    if environment is not None:
        environment.close()


def _make(name: str, folder: str) -> gymnasium.Env:
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
