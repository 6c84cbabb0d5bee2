"""The rows of a run's tables, from episodes and clocks: functions of their arguments only."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from manywake.learn.collect import Failure
from manywake.learn.rollout import Episode, Simulation
from manywake.learn.schedule import Plan


@dataclass
class Shares:
    """Where the time of the slots and of the learner went, in seconds; for the progress display."""

    flow: float = 0.0
    policy: float = 0.0
    transport: float = 0.0
    waiting: float = 0.0
    learner: float = 0.0

    def count(self, episodes: list[Episode], slots: int, clocks: "Clocks") -> None:
        """Add what an update took."""
        flow = sum(episode.flow_seconds for episode in episodes)
        policy = sum(episode.policy_seconds for episode in episodes)
        transport = sum(episode.transport_seconds for episode in episodes)
        self.flow, self.policy, self.transport = self.flow + flow, self.policy + policy, self.transport + transport
        self.waiting += max(slots * clocks.collecting - flow - policy - transport, 0.0)
        self.learner += clocks.learning


@dataclass(frozen=True)
class Clocks:
    """Of one update, in seconds: collecting its episodes, learning from them, and when, since the training began.

    collected: when all episodes had come. done: when the update was made.
    """

    collecting: float
    learning: float
    collected: float
    done: float


def played(simulation: Simulation, episode: Episode) -> dict[str, float]:
    """Return what an episode's row has of the episode itself: all but who used it when, and the times."""
    return {
        "length": len(episode.rewards),
        "reward": float(episode.rewards.sum()),
        "terminated": int(episode.terminated),
        **simulation.summary(episode),
    }


def came(episodes: list[Episode], collected: float, plan: Plan | None, virtual: bool) -> dict[int, float]:
    """Return when each episode came, by the run's clock."""
    if plan is not None and virtual:
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
        "flow_s": round(one.flow_seconds, 4),
        "policy_s": round(one.policy_seconds, 4),
        "transport_s": round(one.transport_seconds, 4),
        "waiting_s": round(one.waiting_seconds, 4),
        "learner_s": round(learner, 4),
        "wall_s": round(clocks.collected, 3),
        "clock_s": round(clock, 3),
    }


def update(
    number: int, episodes: list[Episode], logged: dict[str, Any], burst: int, clocks: Clocks, clock: float
) -> dict[str, Any]:
    """Return the row of one update in updates.csv. logged: what the learner recorded. clock: of the last episode."""
    staleness = [round(float(np.mean(number - one.versions)), 3) for one in episodes]
    return {
        "update": number,
        "episodes": (number + 1) * len(episodes),
        "learning_rate": float(logged.get("train/learning_rate", np.nan)),
        "staleness_mean": float(np.mean(staleness)),
        "staleness_max": max(int(number - one.versions[0]) for one in episodes),
        "clipped_before": float(logged.get("train/clipped_before", np.nan)),
        "clip_fraction": float(logged.get("train/clip_fraction", np.nan)),
        "approx_kl": float(logged.get("train/approx_kl", np.nan)),
        "burst": burst,
        "collect_s": round(clocks.collecting, 3),
        "learner_s": round(clocks.learning, 3),
        "wall_s": round(clocks.done, 3),
        "clock_s": round(clock, 3),
    }


def failure(lost: Failure, wall: float) -> dict[str, Any]:
    """Return the row of a lost block in failures.csv."""
    return {"wall_s": round(wall, 3), **asdict(lost), "episodes": " ".join(map(str, lost.episodes))}
