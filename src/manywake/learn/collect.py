"""Collection: blocks of episodes out to the engine, episodes back to the learner, none lost and none changed."""

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from manywake.flow import simd
from manywake.learn.engine import Engine, TimedOut, WorkerDied
from manywake.learn.policy import Policy
from manywake.learn.rollout import Episode, Exploration, Simulation, explore
from manywake.learn.schedule import Plan

MOST_FAILURES = 3
"""Failures of one episode, played alone, after which training stops."""
PATIENCE = 10.0
"""A block is given this many times as long as is expected..."""
ALLOWANCE = 120.0
"""...and this many seconds more, which cover compiling on a machine that never did."""
UNKNOWN = 3600.0
"""Seconds a block is given while nobody knows how long one takes."""


@dataclass(frozen=True)
class Layout:
    """`environments` spread over `workers` processes that advance blocks of `lanes` environments each."""

    environments: int
    workers: int
    lanes: int

    def __str__(self) -> str:
        return f"{self.environments} environments: {self.workers} workers, blocks of up to {self.lanes} lanes"


def usable_cores() -> int:
    """Return the number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def layout(
    environments: int | None, workers: int | None, lanes: int | None, period: int, cores: int | None = None
) -> Layout:
    """Return a layout from what is given of it; ValueError when that does not fit together.

    With nothing given: an environment for each of the `period` episodes of an update.

    With only the number of environments: full vectors of eight as soon as every core has one, else the environments
    spread over the cores; and one worker more than cores where there are blocks for it, so that blocks of unequal
    width, 8, 8 and 4 of twenty say, share the cores evenly.
    """
    cores = cores or usable_cores()
    for name, value in (("envs", environments), ("workers", workers), ("lanes", lanes)):
        if value is not None and value < 1:
            raise ValueError(f"{name}: got {value}, wanted at least 1")
    if environments is None:
        environments = min((workers or cores) * lanes if lanes is not None else period, period)
    if lanes is None:
        full = simd.WIDTHS[0]
        lanes = -(-environments // workers) if workers else full if environments >= full * cores else 0
        lanes = lanes or -(-environments // cores)
    blocks = -(-environments // lanes)
    if workers is None:
        workers = min(blocks, cores + 1)
    if workers > blocks:
        raise ValueError(
            f"workers: got {workers} of {lanes} lanes for {environments} environments, wanted at most {blocks}; "
            "the others would have nothing to do"
        )
    return Layout(environments, workers, lanes)


@dataclass(frozen=True)
class Failure:
    """A block that was lost, and is played again. kind: raised, died or timed out. attempt: of an episode alone."""

    episodes: tuple[int, ...]
    version: int
    kind: str
    cause: str
    attempt: int


class EpisodeFailed(RuntimeError):
    """The same episode failed too often; `index` names it."""

    def __init__(self, index: int, run_seed: int, cause: str):
        super().__init__(
            f"episode {index} of run seed {run_seed} failed {MOST_FAILURES} times, the last time so: {cause}"
        )
        self.index = index


@dataclass(frozen=True)
class _Block:
    """Episodes that start and end together, and the policies that play them, as these are shared with the workers.

    versions: of the policies, rising. group: the episodes the block was cut from, should it have been lost and split.
    bound: whether its versions stand; else it takes the newest when it starts.
    """

    indices: tuple[int, ...]
    versions: tuple[int, ...]
    policies: tuple[Any, ...]
    group: tuple[int, ...]
    bound: bool
    begun: float = 0.0


def play(simulation: Simulation, explorations: list[Exploration], *driving: Policy) -> list[Episode]:
    """Play a block in a worker."""
    return simulation.play(driving, explorations)


@dataclass
class Collector:
    """Plays the episodes of a training run on an engine.

    plan: which episode is played by which version and used when (`schedule`); None is the unsynced schedule on the
    real clock, where it shows. period: T_L, episodes of an update. total: of the whole run. time_limit: seconds a block
    may take; None works it out from block_seconds, what a full block takes, and from those that come.
    seen, failed: called with each block that has come or was lost.
    """

    engine: Engine
    simulation: Simulation
    run_seed: int
    layout: Layout
    period: int
    total: int
    plan: Plan | None
    time_limit: float | None = None
    block_seconds: float | None = None
    seen: Callable[[list[Episode]], None] = lambda episodes: None
    failed: Callable[[Failure], None] = lambda failure: None
    _queue: deque[_Block] = field(default_factory=deque)
    _flying: dict[Future, _Block] = field(default_factory=dict)
    _arrived: dict[int, tuple[Episode, float]] = field(default_factory=dict)
    _attempts: dict[int, int] = field(default_factory=dict)
    _next: int = 0
    _newest: int = 0
    _policies: dict[int, Any] = field(default_factory=dict)
    _policy_of: Callable[[int], Policy] | None = None
    _begun: dict[int, int] = field(default_factory=dict)
    _outstanding: dict[tuple[int, ...], int] = field(default_factory=dict)
    _error: BaseException | None = None

    def __post_init__(self) -> None:
        self._shared = self.engine.share(self.simulation)
        self._actions = self.simulation.spaces()[1].shape[0]
        self._change = threading.Condition(threading.RLock())

    def collect(self, policy: Policy) -> list[Episode]:
        """Return the episodes of the update to be made of `policy`, by index, and start what it is to play.

        Raises EpisodeFailed when an episode cannot be played.
        """
        with self._change:
            self._take(policy)
            if self.plan is not None:
                last = self.plan.version[:, -1]
                self._start(np.flatnonzero(last == policy.version).tolist(), policy.version, bound=True)
            elif self._next == 0:
                self._start(self._indices(self.layout.environments), policy.version, bound=False)
            self._fill()
            while self._error is None and (wanted := self._wanted(policy.version)) is None:
                self._change.wait()
            if self._error is not None:
                raise self._error
            now = time.perf_counter()
            episodes = [self._arrived.pop(index) for index in sorted(wanted or [])]
            for episode, _ in episodes:
                del self._begun[episode.index]
        return [replace(episode, waiting_seconds=now - came) for episode, came in episodes]

    def resume(self, version: int, pending: Iterable[tuple[int, int]], policy_of: Callable[[int], Policy]) -> None:
        """Go on from a checkpoint made before the update of `version`: start what was on its way then.

        pending: pairs of episode and version it was begun with, of those begun and not used. policy_of: by version.
        """
        by_version: dict[int, list[int]] = {}
        for index, played_by in pending:
            by_version.setdefault(played_by, []).append(index)
        with self._change:
            self._policy_of = policy_of
            for played_by, indices in sorted(by_version.items()):
                self._start(sorted(indices), played_by, bound=True)
            begun = [index for indices in by_version.values() for index in indices]
            self._next = max([version * self.period - 1, *begun]) + 1

    def pending(self) -> list[tuple[int, int]]:
        """Return (episode, version) of all that were begun and are not used yet."""
        with self._change:
            return sorted(self._begun.items())

    def _indices(self, count: int) -> list[int]:
        indices = list(range(self._next, min(self._next + count, self.total)))
        self._next += len(indices)
        return indices

    def _take(self, policy: Policy) -> None:
        """Share the newest policy, and forget those that no episode still to be started is played by."""
        self._newest = policy.version
        self._policies[policy.version] = self.engine.share(policy)
        oldest = policy.version
        if self.plan is not None:
            oldest = min(self.plan.version[self.plan.version[:, -1] >= policy.version, 0], default=oldest)
        self._policies = {version: shared for version, shared in self._policies.items() if version >= oldest}

    def _shared_policies(self, versions: tuple[int, ...]) -> tuple[Any, ...]:
        for version in versions:
            if version not in self._policies:  # only after resuming
                assert self._policy_of is not None
                self._policies[version] = self.engine.share(self._policy_of(version))
        return tuple(self._policies[version] for version in versions)

    def _start(self, indices: list[int], version: int, bound: bool) -> None:
        """Queue episodes in rounds of the environments, each cut into blocks of lanes.

        version: the one they are played by where there is no plan.
        """
        self._begun |= dict.fromkeys(indices, version) if self.plan is None else self.plan.first(indices)
        environments, lanes = self.layout.environments, self.layout.lanes
        for first in range(0, len(indices), environments):
            in_round = indices[first : first + environments]
            for k in range(0, len(in_round), lanes):
                block = tuple(in_round[k : k + lanes])
                versions = (version,) if self.plan is None else self.plan.versions(block)
                self._queue.append(_Block(block, versions, self._shared_policies(versions), block, bound))
                self._outstanding[block] = len(block)

    def _wanted(self, version: int) -> list[int] | None:
        """Return the episodes of an update if all have come, else None."""
        if self.plan is not None:
            wanted = np.flatnonzero(self.plan.update == version).tolist()
            return wanted if all(index in self._arrived for index in wanted) else None
        first = list(self._arrived)[: self.period]  # a dictionary keeps the order of arrival
        return first if len(first) == self.period else None

    def _fill(self) -> None:
        while self._queue and self._error is None and len(self._flying) < min(self.engine.slots, self.layout.workers):
            block = self._queue.popleft()
            if not block.bound:
                newest = (self._newest,)
                block = replace(block, versions=newest, policies=self._shared_policies(newest))
                self._begun |= dict.fromkeys(block.indices, self._newest)
            block = replace(block, begun=time.perf_counter(), bound=True)
            horizon = self.simulation.horizon
            explorations = [
                explore(self.run_seed, index, horizon, self._actions, self._asks(block, index))
                for index in block.indices
            ]
            limit = self._limit()
            future = self.engine.submit(play, self._shared, explorations, *block.policies, timeout=limit)
            self._flying[future] = block
            future.add_done_callback(self._done)

    def _asks(self, block: _Block, index: int) -> np.ndarray:
        """Return which of a block's policies play the parts of an episode."""
        return np.zeros(1, int) if self.plan is None else np.searchsorted(block.versions, self.plan.version[index])

    def _limit(self) -> float | None:
        if self.time_limit is not None:
            return self.time_limit
        return UNKNOWN if self.block_seconds is None else ALLOWANCE + PATIENCE * self.block_seconds

    def _done(self, future: Future) -> None:
        """Take what an engine's thread brings; every way out of here leaves the collector able to go on or to stop."""
        with self._change:
            block = self._flying.pop(future)
            try:
                error = future.exception()
                if error is None:
                    self._came(block, future.result())
                elif self._error is None:
                    self._lost(block, error)
                self._fill()
            except BaseException as problem:
                self._error = self._error or problem
            self._change.notify_all()

    def _came(self, block: _Block, episodes: list[Episode]) -> None:
        now = time.perf_counter()
        busy = sum(episode.flow_seconds + episode.policy_seconds for episode in episodes)
        transport = max(now - block.begun - busy, 0.0) / len(episodes)
        # as long as it would have been with all lanes and to the horizon: the first to come may be the shortest
        longest = max(len(episode.rewards) for episode in episodes)
        full = (now - block.begun) * self.layout.lanes / len(episodes) * self.simulation.horizon / longest
        self.block_seconds = max(self.block_seconds or 0.0, full)
        episodes = [replace(episode, transport_seconds=transport) for episode in episodes]
        for episode in episodes:
            self._arrived[episode.index] = episode, now
        self._outstanding[block.group] -= len(block.indices)
        if not self._outstanding[block.group]:
            del self._outstanding[block.group]
            if self.plan is None:
                free = self.layout.environments - sum(self._outstanding.values())
                self._start(self._indices(max(free, 0)), self._newest, bound=False)
        self.seen(episodes)

    def _lost(self, block: _Block, error: BaseException) -> None:
        """Queue a block that was lost again, split, so that the bad episode is named."""
        kind = "died" if isinstance(error, WorkerDied) else "timed out" if isinstance(error, TimedOut) else "raised"
        cause = f"{type(error).__name__}: {error}" if kind == "raised" else str(error)
        attempt = 0
        if len(block.indices) == 1:
            index = block.indices[0]
            attempt = self._attempts[index] = self._attempts.get(index, 0) + 1
        self.failed(Failure(block.indices, min(map(self._begun.__getitem__, block.indices)), kind, cause, attempt))
        if attempt >= MOST_FAILURES:
            raise EpisodeFailed(block.indices[0], self.run_seed, cause)
        self._queue.extendleft(replace(block, indices=(index,)) for index in reversed(block.indices))
