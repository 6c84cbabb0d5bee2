"""A task that is learnt in seconds: push a drifting point back to zero. Played by the real policy code."""

import os
import signal
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from gymnasium.spaces import Box

from manywake.learn import policy as policies
from manywake.learn import schedule
from manywake.learn.collect import Collector, Layout
from manywake.learn.engine import Threads
from manywake.learn.rollout import Episode
from manywake.learn.schedule import Plan
from manywake.learn.settings import Learning

LEARNING = Learning(
    update_period=10, episodes=100, learner_threads=1, learning_rate=3e-3, batch_size=50, hidden=(32, 32)
)


@dataclass(frozen=True)
class Toy:
    """Every `terminate_every`-th episode ends early, as a flow that blows up would.

    faults: pairs of an episode and what its worker does the first `times` times it is to play it: raise, kill (itself),
    hang. What was done is counted by files in `folder`, which outlive the worker.
    """

    terminate_every: int | None = None
    faults: tuple[tuple[int, str], ...] = ()
    folder: Path | None = None
    times: int = 1
    seconds: float = 0.0
    horizon: int = 20

    def spaces(self):
        return Box(-10, 10, (3,), np.float32), Box(-1, 1, (1,), np.float32)

    def summary(self, episode: Episode) -> dict[str, float]:
        return {name: float(series.mean()) for name, series in episode.readings.items()}

    def expected_seconds(self, lanes: int) -> float | None:
        return None

    def play(self, driving, explorations) -> list[Episode]:
        for exploration in explorations:
            self._fail(exploration.index)
        time.sleep(self.seconds)
        share = self.seconds / len(explorations)
        return [replace(self._play(driving, exploration), flow_seconds=share) for exploration in explorations]

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

    def _play(self, driving, exploration) -> Episode:
        rng = np.random.default_rng(exploration.seed)
        early = self.terminate_every is not None and exploration.index % self.terminate_every == 0
        length = self.horizon // 2 if early else self.horizon
        x, drift = rng.uniform(-1, 1), 0.1
        observations, actions, log_probs, rewards = [], [], [], []
        for which, noise in zip(exploration.which[:length], exploration.noise[:length], strict=True):
            observation = np.array([5 + x, x * x, 1.0], np.float32)
            action, log_prob = policies.draw(driving, which[None], observation[None], noise[None])
            x += drift + 0.5 * float(np.clip(action[0, 0], -1, 1))
            observations.append(observation)
            actions.append(action[0])
            log_probs.append(log_prob[0])
            rewards.append(-abs(x))
        versions = np.array([policy.version for policy in driving])[exploration.which[:length]]
        return Episode(
            exploration.index, versions, np.stack(observations), np.array([5 + x, x * x, 1.0], np.float32),
            np.stack(actions), np.array(log_probs), np.array(rewards), {"x": -np.array(rewards)}, early, 0.0, 0.0,
        )  # fmt: skip


def synced(episodes: int, environments: int, period: int) -> Plan:
    return schedule.synced(np.ones(episodes), environments, period, 0.1)


def collector(toy: Toy = Toy(), run_seed: int = 0, learning: Learning = LEARNING, **changes) -> Collector:  # noqa: B008
    """A synced collector of the toy task in this thread's process, or with the given fields changed."""
    period, total = learning.update_period, learning.episodes
    fields = {
        "engine": Threads(1), "simulation": toy, "run_seed": run_seed, "layout": Layout(period, 1, period),
        "period": period, "total": total, "plan": synced(total, period, period),
    }  # fmt: skip
    return Collector(**(fields | changes))
