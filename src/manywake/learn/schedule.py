"""Which episode is played by which policy and enters which update: the paper's two schedules.

Synced: the T_L episodes of an update are played by one policy and all waited for. Unsynced: every environment starts
its next episode at once with the newest policy, and an update is made as soon as T_L episodes have come; the newest
policy is asked for once an episode, or for every action, as the paper's runner does.
"""

import heapq
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Plan:
    """Episodes of a whole training, known beforehand.

    version: (episodes, asks) the policy versions that play equal parts of each, never falling. update: (episodes,) the
    version it is used at, none below its last. time: (episodes,) when it comes, in seconds of the virtual clock. ready:
    (updates,) when each update has been made.
    """

    version: np.ndarray
    update: np.ndarray
    time: np.ndarray
    ready: np.ndarray


def durations(run_seed: int, episodes: int, mean: float, spread: float) -> np.ndarray:
    """Return the modelled durations of episodes (episodes,), in seconds; spread is relative to the mean."""
    seeds = [np.random.SeedSequence(run_seed, spawn_key=(k, 1)) for k in range(episodes)]
    draw = [np.random.default_rng(seed).standard_normal() for seed in seeds]
    # nine digits: the same on every libm; never shorter than a tenth, whatever the spread
    return np.round(mean * np.maximum(1.0 + spread * np.array(draw), 0.1), 9)


def synced(seconds: np.ndarray, environments: int, period: int, update_seconds: float) -> Plan:
    """Return the plan in which an update's `period` episodes are spread over the environments and waited for."""
    version, now = np.arange(len(seconds)) // period, 0.0
    time, ready = np.zeros(len(seconds)), np.zeros(len(seconds) // period)
    for update in range(len(ready)):
        free = [now] * environments
        for k in range(update * period, (update + 1) * period):
            time[k] = heapq.heappop(free) + seconds[k]
            heapq.heappush(free, time[k])
        ready[update] = now = max(free) + update_seconds
    return Plan(version[:, None], version, time, ready)


def unsynced(seconds: np.ndarray, environments: int, period: int, update_seconds: float, asks: int = 1) -> Plan:
    """Return the plan in which nobody waits.

    Completions are ordered by (time, index). Update v takes the next `period` of them, once update v - 1 is done. An
    environment that ends meanwhile goes on with the newest version that is made, and asks for it anew `asks` times an
    episode, at equal distances.
    """
    count = len(seconds)
    begun, update, time, ready = np.zeros(count), np.zeros(count, int), np.zeros(count), np.zeros(count // period)
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
