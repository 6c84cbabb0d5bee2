"""The rows of a run's tables, from episodes and clocks: functions of their arguments only."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from manywake.learn.rollout import Episode, Simulation
from manywake.learn.schedule import Plan

WAYS = ("flow", "policy", "transport", "waiting")
"""What an episode's seconds went to."""


@dataclass(frozen=True)
class Clocks:
    """Of one update, in seconds: collecting its episodes, learning from them, and when, since the training began.

    collected: when all episodes had come. done: when the update was made.
    """

    collecting: float
    learning: float
    collected: float
    done: float


@dataclass
class Shares:
    """Where the time of the slots and of the learner went, in seconds; for the progress display."""

    flow: float = 0.0
    policy: float = 0.0
    transport: float = 0.0
    waiting: float = 0.0
    learner: float = 0.0

    def count(self, episodes: list[Episode], slots: int, clocks: Clocks) -> None:
        """Add what an update took."""
        flow, policy, transport = (sum(getattr(one, f"{way}_seconds") for one in episodes) for way in WAYS[:3])
        self.flow, self.policy, self.transport = self.flow + flow, self.policy + policy, self.transport + transport
        self.waiting += max(slots * clocks.collecting - flow - policy - transport, 0.0)
        self.learner += clocks.learning


def played(simulation: Simulation, episode: Episode) -> dict[str, float]:
    """Return what an episode's row has of the episode itself: all but who used it when, and the times."""
    reward, terminated = float(episode.rewards.sum()), int(episode.terminated)
    return {"length": len(episode.rewards), "reward": reward, "terminated": terminated} | simulation.summary(episode)


def came(episodes: list[Episode], collected: float, plan: Plan | None) -> dict[int, float]:
    """Return when each episode came, by the clock of the plan, or by the machine's without one."""
    if plan is not None:
        return {episode.index: float(plan.time[episode.index]) for episode in episodes}
    return {episode.index: collected - episode.waiting_seconds for episode in episodes}


def at_once(update: int, collecting: float, plan: Plan | None) -> bool:
    """Return whether an update's episodes had all come before the one before it was done."""
    if plan is None:
        return update > 0 and collecting < 0.01
    return update > 0 and bool(plan.time[plan.update == update].max() <= plan.ready[update - 1])


def episode(
    simulation: Simulation, one: Episode, update: int, learner: float, clocks: Clocks, clock: float
) -> dict[str, Any]:
    """Return the row of one episode in episodes.csv. learner: its share of the update's seconds."""
    return {
        "episode": one.index,
        "version": one.versions[0],
        "update": update,
        "staleness": round(float(np.mean(update - one.versions)), 3),
        **played(simulation, one),
        **{f"{way}_s": round(getattr(one, f"{way}_seconds"), 4) for way in WAYS},
        "learner_s": round(learner, 4),
        "wall_s": round(clocks.collected, 3),
        "clock_s": round(clock, 3),
    }


def update(
    number: int, episodes: list[Episode], logged: dict[str, Any], burst: int, clocks: Clocks, clock: float
) -> dict[str, Any]:
    """Return the row of one update in updates.csv. logged: what the learner recorded. clock: of the last episode."""
    learnt = ("clipped_before", "clip_fraction", "approx_kl")
    return {
        "update": number,
        "episodes": (number + 1) * len(episodes),
        "learning_rate": float(logged.get("train/learning_rate", np.nan)),
        "staleness_mean": float(np.mean([round(float(np.mean(number - one.versions)), 3) for one in episodes])),
        "staleness_max": max(int(number - one.versions[0]) for one in episodes),
        **{name: float(logged.get(f"train/{name}", np.nan)) for name in learnt},
        "burst": burst,
        "collect_s": round(clocks.collecting, 3),
        "learner_s": round(clocks.learning, 3),
        "wall_s": round(clocks.done, 3),
        "clock_s": round(clock, 3),
    }
