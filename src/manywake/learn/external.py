"""Any other simulation behind a Gymnasium environment, played an episode at a time."""

import importlib
import os
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypedDict

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from manywake.learn import policy as policies
from manywake.learn.engine import Engine
from manywake.learn.policy import Policy
from manywake.learn.rollout import Context, Episode, Evaluated, Simulation, context, play

KIND = "env"
HORIZON = 160
"""Most actions of an episode, where an environment has no limit of its own and none is given."""
EVALUATED = 16
"""Episodes of an evaluation."""


class Described(TypedDict):
    """What `External.describe` says."""

    kind: str
    env: str
    folder: str
    horizon: int


@dataclass(frozen=True)
class External(Simulation):
    """An environment by name: `module:factory`, or an id registered with Gymnasium.

    folder: where the module is looked for besides the installed packages. observation, action: its spaces, flattened.
    Each thread of each worker makes the environment once, resets it with the episode's seed, and after an error makes
    it anew. To give the same bits everywhere it must depend on that seed and the actions only.
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
        infos: list[dict[str, float]] = []
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
            infos.append({key: float(x) for key, x in info.items() if isinstance(x, int | float | np.number)})
            if terminated or truncated:
                break
        if not (np.isfinite(rewards).all() and np.isfinite(observations).all()):
            raise ValueError(f"environment {self.name!r}: got a reward or an observation that is not finite")
        seconds = time.perf_counter() - begin - policy_seconds, policy_seconds
        versions = np.array([policy.version for policy in driving])[own.which[: len(rewards)]]
        names = dict.fromkeys(name for each in infos for name in each)
        readings = {name: np.array([each.get(name, np.nan) for each in infos]) for name in names}
        seen = np.stack(observations[:-1]), observations[-1]
        done = np.stack(actions), np.array(log_probs), np.array(rewards)
        return Episode(own.index, versions, *seen, *done, readings, bool(terminated), *seconds)

    def summary(self, episode: Episode) -> dict[str, float]:
        """Return the mean of each scalar of `info`, over the actions that had it, as info_<name>."""
        return {f"info_{name}": float(np.nanmean(series)) for name, series in sorted(episode.readings.items())}

    def evaluate(self, policy: Policy, engine: Engine) -> "Returns":
        """Play `EVALUATED` episodes of seeds that no training has, without exploration."""
        shared, futures = engine.share(self), []
        for index in range(EVALUATED):
            drawn = context(2**32, index, self.horizon, self.action.shape[0])  # a run seed past those that users give
            quiet = replace(drawn, noise=np.zeros_like(drawn.noise))
            futures.append(engine.submit(play, shared, [quiet], policy))
        return Returns([float(episode.rewards.sum()) for future in futures for episode in future.result()])

    def describe(self) -> dict[str, Any]:
        return {"kind": KIND, "env": self.name, "folder": self.folder, "horizon": self.horizon}


@dataclass(frozen=True)
class Returns(Evaluated):
    """Sums of rewards of a deterministic policy's episodes. What they look like is not known."""

    rewards: list[float]

    def summary(self) -> dict[str, Any]:
        mean, spread = float(np.mean(self.rewards)), float(np.std(self.rewards, ddof=1))
        return {"reward_mean": mean, "reward_std": spread, "rewards": self.rewards}

    def table(self) -> list[tuple[str, ...]]:
        numbers, heads = self.summary(), ("policy without noise", f"{len(self.rewards)} episodes")
        mean, spread = f"{numbers['reward_mean']:.4g}", f"{numbers['reward_std']:.3g}"
        return [heads, ("sum of rewards, mean", mean), ("standard deviation", spread)]


def _flat(observation) -> np.ndarray:
    return np.asarray(observation, np.float32).reshape(-1)


def open_simulation(name: str, horizon: int, folder: str) -> External:
    """Return an environment by its name, after a look at it; ValueError when it cannot be collected.

    horizon: most actions of an episode, where it was not registered with a limit of its own.
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


def reopen(folder: Path, described: Described, name: str | None) -> External:
    """Return what a run played, as `External.describe` wrote it; ValueError unless the user gives its name again."""
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
            got = f"env: got {name!r}, but the module {module!r} cannot be loaded ({error})"
            raise ValueError(f"{got}; wanted module:factory, with the module installed or in {folder}") from error
        if callable(make):
            return make()
    try:
        return gymnasium.make(name)
    except gymnasium.error.Error as error:
        wanted = "wanted module:factory or an id registered with Gymnasium"
        raise ValueError(f"env: got {name!r} ({error}); {wanted}") from error
