"""Speed-up of collection with the number of environments, on stand-ins that sleep for an episode's time.

Run: manywake bench scaling --json

An environment here sleeps and then returns an episode of real size, so that many fit on few cores; what is left is what
the collector, the engine and the transport cost. Synced up to the 20 episodes of an update, unsynced beyond. Speed-up
is of episodes per second of whole updates, start-up excluded, against the mean of what N = 1 took. overhead: wall time
beyond what the schedule gives for the very durations that were slept, by episode. latency: of one episode, from the end
of its sleep to the learner and from the collector to the worker, median.
"""

import json
import statistics
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from gymnasium.spaces import Box

from manywake.cli.show import say
from manywake.learn import schedule
from manywake.learn.blocks import AsTheyCome, Layout, Planned
from manywake.learn.collect import Collector
from manywake.learn.engine import Processes
from manywake.learn.policy import Policy
from manywake.learn.rollout import Episode

PERIOD = 20
HORIZON = 80
SECONDS = 5.0


@dataclass(frozen=True)
class Sleeper:
    """Sleeps for `seconds`[episode] and returns an episode as long as the paper's: what a collector asks of one."""

    seconds: np.ndarray
    horizon: int = HORIZON

    def spaces(self):
        return Box(-1, 1, (151,), np.float32), Box(-1, 1, (1,), np.float32)

    def play(self, driving, contexts):
        index = contexts[0].index
        time.sleep(self.seconds[index])
        zero = np.zeros(HORIZON)
        observations = np.random.default_rng(index).standard_normal((HORIZON, 151)).astype(np.float32)
        readings = {name: zero for name in ("c_d", "c_l", "jets")}
        return [
            Episode(
                index,
                np.full(HORIZON, driving[0].version),
                observations,
                observations[-1],
                contexts[0].noise.astype(np.float32),
                zero,
                zero,
                readings,
                False,
                self.seconds[index],
                0.0,
            )  # fmt: skip
        ]


def policy(version: int) -> Policy:
    """A policy of the size of the paper's: 151 probes, 2 x 512, one action."""
    shapes = ((512, 151), (512, 512), (1, 512))
    layers = tuple((np.full(shape, version / 7, np.float32), np.zeros(shape[0], np.float32)) for shape in shapes)
    return Policy(version, np.zeros(151), np.ones(151), layers, np.zeros(1), np.ones(1))


def collected(environments: int, unsynced: bool, updates: int, spread: float, learner: float, seed: int) -> dict:
    """Collect `updates` updates with a learner that sleeps `learner` seconds; return seconds an episode and latency."""
    total = updates * PERIOD
    seconds = schedule.durations(seed, total, SECONDS, spread)
    grid = Layout(environments, environments, 1)
    if unsynced:
        order = AsTheyCome(grid, PERIOD, total)
    else:
        order = Planned(schedule.synced(seconds, environments, PERIOD, learner), grid)
    engine = Processes(environments)
    try:
        warm = [engine.submit(time.sleep, 1.0) for _ in range(environments)]
        for future in warm:
            future.result()
        collector = Collector(engine, Sleeper(seconds), seed, grid, order)
        # every worker takes the simulation once, as it does in a training before its first episode
        for future in [engine.submit(id, collector._shared) for _ in range(environments)]:
            future.result()
        start = time.perf_counter()
        latency = []
        for version in range(updates):
            episodes = collector.collect(policy(version))
            latency += [episode.transport_seconds for episode in episodes]
            time.sleep(learner)
        wall = time.perf_counter() - start
    finally:
        engine.close()
    return {"seconds_per_episode": wall / total, "latency_ms": 1e3 * float(np.median(latency))}


def predicted(environments: int, unsynced: bool, updates: int, spread: float, learner: float, seed: int) -> float:
    """Return the seconds an episode takes by the schedule alone, with the very durations that were slept."""
    seconds = schedule.durations(seed, updates * PERIOD, SECONDS, spread)
    make = schedule.unsynced if unsynced else schedule.synced
    return float(make(seconds, environments, PERIOD, learner).ready[-1]) / (updates * PERIOD)


def table(cases: list[tuple[int, bool, int]], spread: float, learner: float, repeats: int) -> tuple[dict, dict]:
    """Return the medians over the repeats for each case (environments, unsynced, updates), synced and unsynced.

    Repeats of up to five environments run side by side: they sleep, and one after the other they would take an hour.
    """
    found: tuple[dict, dict] = ({}, {})
    one = None
    for environments, unsynced, updates in cases:
        how = [(environments, unsynced, updates, spread, learner, seed) for seed in range(repeats)]
        with ThreadPoolExecutor(repeats if environments <= 5 else 1) as threads:
            runs = list(threads.map(lambda arguments: collected(*arguments), how))
        model = [predicted(*arguments) for arguments in how]
        each = [run["seconds_per_episode"] for run in runs]
        if one is None:
            one = statistics.mean(each)
        extra = [1e3 * (e - m) for e, m in zip(each, model, strict=True)]
        found[unsynced][str(environments)] = {
            "speedup": one / statistics.median(each),
            "spread": [one / max(each), one / min(each)],
            "efficiency": one / statistics.median(each) / environments,
            "measured_over_predicted": statistics.median(e / m for m, e in zip(model, each, strict=True)),
            "overhead_ms_per_episode": statistics.median(extra),
            "latency_ms": statistics.median(run["latency_ms"] for run in runs),
        }
        row = json.dumps(found[unsynced][str(environments)])
        say(f"{'unsynced' if unsynced else 'synced'} {environments} {row}")
    return found


def measure(repeats: int = 3) -> dict:
    """Return speed-ups without a learner, and beside a model with one of 0.3 % and a spread of 3 %."""
    synced = [(environments, False, 5) for environments in (1, 2, 5, 10, 20)]
    unsynced = [(32, True, 16), (60, True, 30)]
    plain = table(synced + unsynced, 0.005, 0.0, repeats)
    learner = 0.003 * SECONDS * PERIOD
    modelled = table([*synced[3:], *unsynced], 0.03, learner, 1)
    overhead = [case["overhead_ms_per_episode"] for part in plain for case in part.values()]
    return {
        "episode_seconds": SECONDS,
        "synced": plain[0],
        "unsynced": plain[1],
        "overhead_ms_per_episode": max(overhead),
        "with_learner_measured_over_predicted": [
            {environments: case["measured_over_predicted"] for environments, case in part.items()} for part in modelled
        ],
    }
