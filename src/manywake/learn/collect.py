"""Collection: blocks of episodes out to the engine, episodes back to the learner, none lost and none changed."""

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Any

from manywake.learn.blocks import Block, Layout, Order
from manywake.learn.engine import Engine, TimedOut, WorkerDied
from manywake.learn.policy import Policy
from manywake.learn.rollout import Context, Episode, Simulation, context

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
        super().__init__(
            f"episode {index} of run seed {run_seed} failed {MOST_FAILURES} times, the last time so: {cause}"
        )
        self.index = index


def play(simulation: Simulation, contexts: list[Context], *driving: Policy) -> list[Episode]:
    """Play a block in a worker."""
    return simulation.play(driving, contexts)


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
    _queue: deque[tuple[Block, tuple[Any, ...]]] = field(default_factory=deque)
    _flying: dict[Future, tuple[Block, tuple[Any, ...], float]] = field(default_factory=dict)
    _arrived: dict[int, tuple[Episode, float]] = field(default_factory=dict)
    _attempts: dict[int, int] = field(default_factory=dict)
    _error: BaseException | None = None

    def __post_init__(self) -> None:
        self._shared = self.engine.share(self.simulation)
        self._actions = self.simulation.spaces()[1].shape[0]
        self._change = threading.Condition(threading.RLock())
        self._policies = _Policies(self.engine)

    def collect(self, policy: Policy) -> list[Episode]:
        """Return the episodes of the update to be made of `policy`, by index, and start what it is to play.

        Raises EpisodeFailed when an episode cannot be played.
        """
        with self._change:
            self._policies.take(policy, self.order.oldest(policy.version))
            self._enqueue(self.order.policy(policy.version))
            self._fill()
            while self._error is None and (ready := self.order.ready(policy.version, self._arrived)) is None:
                self._change.wait()
            if self._error is not None:
                raise self._error
            now = time.perf_counter()
            episodes = [self._arrived.pop(index) for index in sorted(ready or [])]
            for episode, _ in episodes:
                del self.order.begun[episode.index]
        return [replace(episode, waiting_seconds=now - came) for episode, came in episodes]

    def resume(self, version: int, pending: Iterable[tuple[int, int]], policy_of: Callable[[int], Policy]) -> None:
        """Go on from a checkpoint made before the update of `version`: start what was on its way then.

        pending: pairs of episode and version it was begun with, of those begun and not used. policy_of: by version.
        """
        with self._change:
            self._policies.older = policy_of
            self._enqueue(self.order.resume(version, pending))

    def pending(self) -> list[tuple[int, int]]:
        """Return (episode, version) of all that were begun and are not used yet."""
        with self._change:
            return sorted(self.order.begun.items())

    def _enqueue(self, blocks: list[Block]) -> None:
        """Queue blocks with the policies they are played by, which newer ones may drive out before they start."""
        self._queue.extend((block, self._driving(block)) for block in blocks)

    def _driving(self, block: Block) -> tuple[Any, ...]:
        return tuple(self._policies.shared(version) for version in block.versions or ())

    def _fill(self) -> None:
        while self._queue and self._error is None and len(self._flying) < min(self.engine.slots, self.grid.workers):
            block, driving = self._queue.popleft()
            block = self.order.started(block, self._policies.newest)
            driving = driving or self._driving(block)
            horizon = self.simulation.horizon
            contexts = [
                context(self.run_seed, index, horizon, self._actions, self.order.asks(block, index))
                for index in block.indices
            ]
            begun = time.perf_counter()
            future = self.engine.submit(play, self._shared, contexts, *driving, timeout=self._limit())
            self._flying[future] = block, driving, begun
            future.add_done_callback(self._done)

    def _limit(self) -> float | None:
        if self.time_limit is not None:
            return self.time_limit
        return UNKNOWN if self.block_seconds is None else ALLOWANCE + PATIENCE * self.block_seconds

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
        for episode in episodes:
            self._arrived[episode.index] = episode, now
        self._enqueue(self.order.came(block, self._policies.newest))
        self.seen(episodes)

    def _lost(self, block: Block, driving: tuple[Any, ...], error: BaseException) -> None:
        """Queue a block that was lost again, split, so that the bad episode is named."""
        kind = "died" if isinstance(error, WorkerDied) else "timed out" if isinstance(error, TimedOut) else "raised"
        cause = f"{type(error).__name__}: {error}" if kind == "raised" else str(error)
        attempt = 0
        if len(block.indices) == 1:
            index = block.indices[0]
            attempt = self._attempts[index] = self._attempts.get(index, 0) + 1
        version = min(map(self.order.begun.__getitem__, block.indices))
        self.failed(Failure(block.indices, version, kind, cause, attempt))
        if attempt >= MOST_FAILURES:
            raise EpisodeFailed(block.indices[0], self.run_seed, cause)
        self._queue.extendleft((alone, driving) for alone in reversed(block.split()))


class _Policies:
    """The policies that episodes are played by, as they are shared with the workers.

    newest: the last version taken. older: gives those of before a resume.
    """

    def __init__(self, engine: Engine):
        self.engine, self.newest = engine, 0
        self.older: Callable[[int], Policy] | None = None
        self.kept: dict[int, Any] = {}

    def take(self, policy: Policy, oldest: int) -> None:
        """Share the newest policy, and forget those that no episode still to be started is played by."""
        self.newest = policy.version
        self.kept[policy.version] = self.engine.share(policy)
        self.kept = {version: shared for version, shared in self.kept.items() if version >= oldest}

    def shared(self, version: int) -> Any:
        """Return what stands for a version in a call."""
        if version not in self.kept:
            assert self.older is not None
            self.kept[version] = self.engine.share(self.older(version))
        return self.kept[version]
