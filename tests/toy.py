"""A task that is learnt in seconds: push a drifting point back to zero. Played by the real policy code."""

import dataclasses
import json
import os
import signal
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from gymnasium.spaces import Box

from manywake.case.learning import Learning
from manywake.learn import policy as policies
from manywake.learn import rollout, schedule
from manywake.learn.blocks import AsTheyCome, Layout, Planned
from manywake.learn.collect import Collector
from manywake.learn.engine import Threads
from manywake.learn.rollout import Episode, context
from manywake.learn.schedule import Plan

LEARNING = Learning(
    update_period=10, episodes=100, learner_threads=1, learning_rate=3e-3, batch_size=50, hidden=(32, 32)
)


DRIFT = 0.1
"""How far the point goes by itself in an action, in its first variant."""


@dataclass(frozen=True)
class Toy:
    """Every `terminate_every`-th episode ends early, as a flow that blows up would.

    faults: pairs of an episode and what its worker does the first `times` times it is to play it: raise, kill (itself),
    hang. What was done is counted by files in `folder`, which outlive the worker. variants: how many there are; each
    drifts faster than the one before.
    """

    terminate_every: int | None = None
    faults: tuple[tuple[int, str], ...] = ()
    folder: Path | None = None
    times: int = 1
    seconds: float = 0.0
    horizon: int = 20
    variants: int = 1

    def spaces(self):
        return Box(-10, 10, (3,), np.float32), Box(-1, 1, (1,), np.float32)

    def variant(self, seed: int) -> int:
        return seed % self.variants

    def summary(self, episode: Episode) -> dict[str, float]:
        return {name: float(series.mean()) for name, series in episode.readings.items()}

    def gain(self, summary: dict[str, float]) -> float:
        """How much nearer to zero the point was than one that drifts from there, which is half its way off."""
        return 1.0 - summary["x"] / (0.5 * DRIFT * self.horizon)

    def expected_seconds(self, lanes: int) -> float | None:
        return None

    def evaluate(self, policy, engine) -> "Distances":
        """Play four episodes of a run seed of their own, without noise."""
        still = [context(2**32, index, self.horizon, 1) for index in range(4)]
        still = [replace(each, noise=np.zeros_like(each.noise)) for each in still]
        shared = engine.share(self)
        futures = [engine.submit(_play, shared, [each], policy) for each in still]
        return Distances([float(episode.readings["x"].mean()) for future in futures for episode in future.result()])

    def describe(self) -> dict:
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {"kind": "toy", **fields, "folder": None if self.folder is None else str(self.folder)}

    def save(self, folder: Path) -> dict:
        (folder / "toy.json").write_text(json.dumps(self.describe()))
        return {"drift": str(DRIFT)}

    def play(self, driving, contexts) -> list[Episode]:
        assert len({self.variant(each.seed) for each in contexts}) == 1
        for each in contexts:
            self._fail(each.index)
        time.sleep(self.seconds)
        share = self.seconds / len(contexts)
        return [replace(self._play(driving, each), flow_seconds=share) for each in contexts]

    def _fail(self, index: int) -> None:
        fault = dict(self.faults).get(index)
        if fault is None:
            return
        for k in range(self.times):
            try:
                (self.folder / f"{index}-{k}").touch(exist_ok=False)
            except FileExistsError:
                continue
            if fault == "raise":
                raise ArithmeticError(f"episode {index} is bad")
            if fault == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            while True:
                time.sleep(60)

    def _play(self, driving, own) -> Episode:
        rng = np.random.default_rng(own.seed)
        early = self.terminate_every is not None and own.index % self.terminate_every == 0
        length = self.horizon // 2 if early else self.horizon
        x, drift = rng.uniform(-1, 1), DRIFT * (1 + self.variant(own.seed))
        observations, actions, log_probs, rewards = [], [], [], []
        for which, noise in zip(own.which[:length], own.noise[:length], strict=True):
            observation = np.array([5 + x, x * x, 1.0], np.float32)
            action, log_prob = policies.draw(driving, which[None], observation[None], noise[None])
            x += drift + 0.5 * float(np.clip(action[0, 0], -1, 1))
            observations.append(observation)
            actions.append(action[0])
            log_probs.append(log_prob[0])
            rewards.append(-abs(x))
        versions = np.array([policy.version for policy in driving])[own.which[:length]]
        return Episode(
            own.index, versions, np.stack(observations), np.array([5 + x, x * x, 1.0], np.float32),
            np.stack(actions), np.array(log_probs), np.array(rewards), {"x": -np.array(rewards)}, early, 0.0, 0.0,
        )  # fmt: skip


def _play(toy: Toy, contexts, policy) -> list[Episode]:
    return toy.play([policy], contexts)


@dataclass(frozen=True)
class Distances:
    """Mean distances from zero of a deterministic policy's episodes."""

    found: list[float]

    def summary(self) -> dict:
        return {"x": float(np.mean(self.found)), "found": self.found}

    def table(self) -> list[tuple[str, ...]]:
        return [("policy without noise", "all episodes"), ("distance", f"{np.mean(self.found):.3f}")]

    def draw(self, folder: Path, tail: str) -> None:
        (folder / f"distances{tail}.txt").write_text(str(self.found))


def synced(episodes: int, environments: int, period: int) -> Plan:
    return schedule.synced(np.ones(episodes), environments, period, 0.1)


def collector(toy: Toy = Toy(), run_seed: int = 0, learning: Learning = LEARNING, **changes) -> Collector:  # noqa: B008
    """A synced collector of the toy task in this thread's process, or with the given fields changed.

    plan: another one than the synced; None takes episodes as they come.
    """
    period, total = learning.update_period, learning.episodes
    grid = changes.setdefault("grid", Layout(period, 1, period))
    plan = changes.pop("plan", synced(total, period, period))

    def variant(index: int) -> int:
        return toy.variant(rollout.seed(run_seed, index))

    order = AsTheyCome(grid, period, total, variant) if plan is None else Planned(plan, grid, variant)
    fields = {"engine": Threads(1), "simulation": toy, "run_seed": run_seed, "order": order}
    return Collector(**(fields | changes))
