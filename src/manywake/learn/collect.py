"""Collection: blocks of episodes out to the engine, episodes back to the learner, none lost and none changed."""

import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

from manywake.learn.blocks import Block, Layout, Order
from manywake.learn.engine import Engine, TimedOut, WorkerDied
from manywake.learn.policy import Policy
from manywake.learn.rollout import Episode, Simulation, context, play

MOST_FAILURES = 3
"""Failures of one episode, played alone, after which training stops."""
PATIENCE = 10.0
"""A block is given this many times as long as is expected..."""
ALLOWANCE = 120.0
"""...and this many seconds more, which cover compiling on a machine that never did."""
UNKNOWN = 3600.0
"""Seconds a block is given while nobody knows how long one takes."""


def usable_cores() -> int:
    """Return the number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
        often = f"failed {MOST_FAILURES} times, the last time so: {cause}"
        super().__init__(f"episode {index} of run seed {run_seed} {often}")
        self.index = index


class Stopped(RuntimeError):
    """Nothing is collected any more."""


@dataclass
class Collector:
    """Plays the episodes of a training on an engine, in the order that `order` says.

    time_limit: seconds a block may take; None works it out from block_seconds, what a full block takes, and from those
    that come. seen, failed: called with each block that has come or was lost.
    """

    engine: Engine
    simulation: Simulation
    run_seed: int
    grid: Layout
    order: Order
    time_limit: float | None = None
    block_seconds: float | None = None
    seen: Callable[[list[Episode]], None] = lambda episodes: None
    failed: Callable[[Failure], None] = lambda failure: None

    def __post_init__(self) -> None:
        self._shared = self.engine.share(self.simulation)
        self._shape = self.simulation.horizon, self.simulation.spaces()[1].shape[0]
        self._newest = 0
        self._older: Callable[[int], Policy] | None = None  # gives the policies of before a resume
        self._policies: dict[int, Any] = {}  # by version, as they are shared with the workers
        self._queue: deque[tuple[Block, tuple[Any, ...]]] = deque()
        self._flying: dict[Future, tuple[Block, tuple[Any, ...], float]] = {}
        self._arrived: dict[int, tuple[Episode, float]] = {}
        self._attempts: Counter[int] = Counter()
        self._error: BaseException | None = None
        self._change = threading.Condition(threading.RLock())

    def collect(self, policy: Policy) -> list[Episode]:
        """Start what `policy` plays; return the episodes of the update to be made of it, by index; or EpisodeFailed."""
        with self._change:
            self._newest, oldest = policy.version, self.order.oldest(policy.version)
            self._policies[policy.version] = self.engine.share(policy)
            self._policies = {version: kept for version, kept in self._policies.items() if version >= oldest}
            self._enqueue(self.order.policy(policy.version))
            self._fill()
            while (ready := self._ready(policy.version)) is None:
                self._change.wait()
            now = time.perf_counter()
            episodes = [self._arrived.pop(index) for index in sorted(ready)]
            for episode, _ in episodes:
                del self.order.begun[episode.index]
        return [replace(episode, waiting_seconds=now - came) for episode, came in episodes]

    def _ready(self, version: int) -> list[int] | None:
        """Return the episodes of an update if all have come; one that failed is then the next update's matter."""
        ready = self.order.ready(version, self._arrived)
        if self._error is not None and (ready is None or not isinstance(self._error, EpisodeFailed)):
            raise self._error
        return ready

    def stop(self) -> None:
        """Start no more blocks, and count none as lost: a closing engine ends those that are played."""
        with self._change:
            self._error = self._error or Stopped("the training has ended")

    def resume(self, version: int, pending: Iterable[tuple[int, int]], policy_of: Callable[[int], Policy]) -> None:
        """Go on from before the update of `version`: start what was `pending` then. policy_of: policies by version."""
        with self._change:
            self._older = policy_of
            self._enqueue(self.order.resume(version, pending))

    def pending(self) -> list[tuple[int, int]]:
        """Return (episode, version) of all that were begun and are not used yet."""
        with self._change:
            return sorted(self.order.begun.items())

    def _enqueue(self, blocks: list[Block]) -> None:
        """Queue blocks with the policies they are played by, which newer ones may drive out before they start."""
        self._queue.extend((block, self._driving(block)) for block in blocks)

    def _driving(self, block: Block) -> tuple[Any, ...]:
        for version in set(block.versions or ()) - set(self._policies):
            assert self._older is not None
            self._policies[version] = self.engine.share(self._older(version))
        return tuple(self._policies[version] for version in block.versions or ())

    def _fill(self) -> None:
        while self._queue and self._error is None and len(self._flying) < min(self.engine.slots, self.grid.workers):
            block, driving = self._queue.popleft()
            block = self.order.started(block, self._newest)
            driving = driving or self._driving(block)
            contexts = [context(self.run_seed, k, *self._shape, self.order.asks(block, k)) for k in block.indices]
            limit, begun = self.time_limit, time.perf_counter()
            if limit is None:
                limit = UNKNOWN if self.block_seconds is None else ALLOWANCE + PATIENCE * self.block_seconds
            future = self.engine.submit(play, self._shared, contexts, *driving, timeout=limit)
            self._flying[future] = block, driving, begun
            future.add_done_callback(self._done)

    def _done(self, future: Future) -> None:
        """Take what an engine's thread brings; every way out of here leaves the collector able to go on or to stop."""
        with self._change:
            block, driving, begun = self._flying.pop(future)
            try:
                error = future.exception()
                if error is None:
                    self._came(block, begun, future.result())
                elif self._error is None:
                    self._lost(block, driving, error)
                self._fill()
            except BaseException as problem:
                self._error = self._error or problem
            self._change.notify_all()

    def _came(self, block: Block, begun: float, episodes: list[Episode]) -> None:
        now = time.perf_counter()
        busy = sum(episode.flow_seconds + episode.policy_seconds for episode in episodes)
        transport = max(now - begun - busy, 0.0) / len(episodes)
        # as long as it would have been with all lanes and to the horizon: the first to come may be the shortest
        longest = max(len(episode.rewards) for episode in episodes)
        full = (now - begun) * self.grid.lanes / len(episodes) * self.simulation.horizon / longest
        self.block_seconds = max(self.block_seconds or 0.0, full)
        episodes = [replace(episode, transport_seconds=transport) for episode in episodes]
        self._arrived |= {episode.index: (episode, now) for episode in episodes}
        self._enqueue(self.order.came(block, self._newest))
        self.seen(episodes)

    def _lost(self, block: Block, driving: tuple[Any, ...], error: BaseException) -> None:
        """Queue a block that was lost again, split, so that the bad episode is named."""
        kind = "died" if isinstance(error, WorkerDied) else "timed out" if isinstance(error, TimedOut) else "raised"
        cause = f"{type(error).__name__}: {error}" if kind == "raised" else str(error)
        attempt = 0
        if len(block.indices) == 1:
            self._attempts[block.indices[0]] += 1
            attempt = self._attempts[block.indices[0]]
        version = min(map(self.order.begun.__getitem__, block.indices))
        self.failed(Failure(block.indices, version, kind, cause, attempt))
        if attempt >= MOST_FAILURES:
            raise EpisodeFailed(block.indices[0], self.run_seed, cause)
        self._queue.extendleft((alone, driving) for alone in reversed(block.split()))
