"""Which episode is played by which policy and enters which update: the paper's two schedules.

Synced: the T_L episodes of an update are played by one policy and all waited for. Unsynced: every environment starts
its next episode at once with the newest policy, and an update is made as soon as T_L episodes have come; the newest
policy is asked for once an episode, or for every action, as the paper's runner does.
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Plan:
    """Episodes of a whole training, known beforehand.

    version: (episodes, asks) the policy versions each is played by, one after the other for equal parts of its
    actions, never falling. update: (episodes,) the version it is used at, none below its last. time: (episodes,) when
    it comes, in seconds of the virtual clock. ready: (updates,) when each update has been made.
    """

    version: np.ndarray
    update: np.ndarray
    time: np.ndarray
    ready: np.ndarray

    def first(self, episodes: Sequence[int]) -> dict[int, int]:
        """Return the versions that episodes are begun with."""
        return dict(zip(episodes, self.version[episodes, 0].tolist(), strict=True))

    def versions(self, episodes: Sequence[int]) -> tuple[int, ...]:
        """Return all versions that play any of some episodes, rising."""
        return tuple(np.unique(self.version[list(episodes)]).tolist())


def durations(run_seed: int, episodes: int, mean: float, spread: float) -> np.ndarray:
    """Return the modelled durations of episodes (episodes,), in seconds; spread is relative to the mean."""
    draw = [
        np.random.default_rng(np.random.SeedSequence(run_seed, spawn_key=(k, 1))).standard_normal()
        for k in range(episodes)
    ]
    # nine digits: the same on every libm; never shorter than a tenth, whatever the spread
    return np.round(mean * np.maximum(1.0 + spread * np.array(draw), 0.1), 9)


def synced(seconds: np.ndarray, environments: int, period: int, update_seconds: float) -> Plan:
    """Return the plan in which an update's `period` episodes are spread over the environments and waited for."""
    count = len(seconds)
    version = np.arange(count) // period
    time, ready, now = np.zeros(count), np.zeros(count // period), 0.0
    for update in range(count // period):
        free = [now] * environments
        for k in range(update * period, (update + 1) * period):
            time[k] = heapq.heappop(free) + seconds[k]
            heapq.heappush(free, time[k])
        now = time[update * period : (update + 1) * period].max() + update_seconds
        ready[update] = now
    return Plan(version[:, None], version, time, ready)


def unsynced(seconds: np.ndarray, environments: int, period: int, update_seconds: float, asks: int = 1) -> Plan:
    """Return the plan in which nobody waits.

    Completions are ordered by (time, index). Update v takes the next `period` of them, starts when the last of these
    has come and update v - 1 is done, and takes update_seconds. An environment that ends meanwhile goes on with the
    newest finished version, and asks for it anew `asks` times an episode, at equal distances.
    """
    count = len(seconds)
    begun, update, time = np.zeros(count), np.zeros(count, int), np.zeros(count)
    ready = np.zeros(count // period)
    running = [(seconds[k], k) for k in range(min(environments, count))]
    heapq.heapify(running)
    started = len(running)
    for arrived in range(count):
        now, k = heapq.heappop(running)
        time[k], update[k] = now, arrived // period
        if (arrived + 1) % period == 0:
            v = arrived // period
            ready[v] = max(now, ready[v - 1] if v else 0.0) + update_seconds
        if started < count:
            begun[started] = now
            heapq.heappush(running, (now + seconds[started], started))
            started += 1
    asked = begun[:, None] + (time - begun)[:, None] * (np.arange(asks) / asks)
    return Plan(np.searchsorted(ready, asked, side="right"), update, time, ready)
