"""Which episodes start together, by which policies, and which come next: bookkeeping without futures and clocks."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np

from manywake.learn.schedule import Plan
from manywake.machine import simd


@dataclass(frozen=True)
class Layout:
    """`environments` spread over `workers` processes that advance blocks of `lanes` environments each."""

    environments: int
    workers: int
    lanes: int

    def __str__(self) -> str:
        return f"{self.environments} environments: {self.workers} workers, blocks of up to {self.lanes} lanes"


def layout(environments: int | None, workers: int | None, lanes: int | None, period: int, cores: int) -> Layout:
    """Return a layout from what is given of it; ValueError when that does not fit together.

    With nothing given: an environment for each of the `period` episodes of an update. With their number only: full
    vectors of eight as soon as every core has one, else spread over the cores; and one worker more than cores where
    there are blocks for it, so that blocks of unequal width, 8, 8 and 4 of twenty say, share the cores evenly.
    """
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
    workers = workers or min(blocks, cores + 1)
    if workers > blocks:
        raise ValueError(
            f"workers: got {workers} of {lanes} lanes for {environments} environments, wanted at most {blocks}; "
            "the others would have nothing to do"
        )
    return Layout(environments, workers, lanes)


@dataclass(frozen=True)
class Block:
    """Episodes that start and end together. group: those of the block it was split from, when that was lost.

    versions: of the policies that play them, rising; None takes the newest when it starts.
    """

    indices: tuple[int, ...]
    versions: tuple[int, ...] | None
    group: tuple[int, ...]

    def split(self) -> list["Block"]:
        """Return a block for each episode."""
        return [replace(self, indices=(index,)) for index in self.indices]


Variant = Callable[[int], int]
"""Which variant of the simulation an episode is of, by its index; a block has one only."""


def cut(indices: list[int], grid: Layout, variant: Variant) -> list[tuple[int, ...]]:
    """Cut episodes into rounds of the environments, and each of these into blocks of lanes of one variant."""
    blocks = []
    for first in range(0, len(indices), grid.environments):
        alike: dict[int, list[int]] = {}
        for index in indices[first : first + grid.environments]:
            alike.setdefault(variant(index), []).append(index)
        for group in alike.values():
            blocks += [tuple(group[k : k + grid.lanes]) for k in range(0, len(group), grid.lanes)]
    return blocks


def _by_version(pending: Iterable[tuple[int, int]]) -> list[tuple[int, list[int]]]:
    """Return versions, rising, with the episodes that were begun with each."""
    alike = groupby(sorted((version, index) for index, version in pending), lambda pair: pair[0])
    return [(version, [index for _, index in pairs]) for version, pairs in alike]


@dataclass
class Planned:
    """Follows a plan: an episode is played once its policies exist, an update waits for its episodes.

    begun: episodes that were begun and not used yet, with the version each was begun with.
    """

    plan: Plan
    grid: Layout
    variant: Variant = lambda index: 0
    begun: dict[int, int] = field(default_factory=dict)

    def policy(self, version: int) -> list[Block]:
        """Return the blocks that can start now that there is a policy."""
        return self._begin(np.flatnonzero(self.plan.version[:, -1] == version).tolist())

    def _begin(self, indices: list[int]) -> list[Block]:
        self.begun |= {index: int(self.plan.version[index, 0]) for index in indices}
        blocks = cut(indices, self.grid, self.variant)
        return [Block(block, tuple(np.unique(self.plan.version[list(block)]).tolist()), block) for block in blocks]

    def oldest(self, version: int) -> int:
        """Return the oldest version that what is not started needs, once the newest is `version`."""
        return min(self.plan.version[self.plan.version[:, -1] >= version, 0], default=version)

    def started(self, block: Block, newest: int) -> Block:
        """Return a block with its versions, as it starts."""
        return block

    def asks(self, block: Block, index: int) -> np.ndarray:
        """Return which of a block's policies play the equal parts of an episode."""
        return np.searchsorted(np.array(block.versions), self.plan.version[index])

    def came(self, block: Block, newest: int) -> list[Block]:
        """Return the blocks that can start now that one has come."""
        return []

    def ready(self, version: int, arrived: Iterable[int]) -> list[int] | None:
        """Return the episodes of the update to be made of `version` when all have arrived, else None."""
        wanted = np.flatnonzero(self.plan.update == version).tolist()
        return wanted if set(wanted) <= set(arrived) else None

    def resume(self, version: int, pending: Iterable[tuple[int, int]]) -> list[Block]:
        """Return the blocks of the (episode, version) that were on their way before the update of `version`."""
        return [block for _, indices in _by_version(pending) for block in self._begin(indices)]


@dataclass
class AsTheyCome:
    """Every environment goes on at once with the newest policy; the first `period` episodes to come make an update."""

    grid: Layout
    period: int
    total: int
    variant: Variant = lambda index: 0
    begun: dict[int, int] = field(default_factory=dict)
    _next: int = 0
    _outstanding: dict[tuple[int, ...], int] = field(default_factory=dict)

    def policy(self, version: int) -> list[Block]:
        return self._begin(self.grid.environments, version) if self._next == 0 else []

    def _begin(self, count: int, newest: int) -> list[Block]:
        first, self._next = self._next, min(self._next + max(count, 0), self.total)
        return self._queue(list(range(first, self._next)), newest, None)

    def _queue(self, indices: list[int], version: int, bound: tuple[int, ...] | None) -> list[Block]:
        self.begun |= dict.fromkeys(indices, version)
        blocks = [Block(block, bound, block) for block in cut(indices, self.grid, self.variant)]
        self._outstanding |= {block.group: len(block.group) for block in blocks}
        return blocks

    def oldest(self, version: int) -> int:
        return version

    def started(self, block: Block, newest: int) -> Block:
        if block.versions is not None:
            return block
        self.begun |= dict.fromkeys(block.indices, newest)
        return replace(block, versions=(newest,))

    def asks(self, block: Block, index: int) -> np.ndarray:
        return np.zeros(1, int)

    def came(self, block: Block, newest: int) -> list[Block]:
        self._outstanding[block.group] -= len(block.indices)
        if self._outstanding[block.group]:
            return []
        del self._outstanding[block.group]
        return self._begin(self.grid.environments - sum(self._outstanding.values()), newest)

    def ready(self, version: int, arrived: Iterable[int]) -> list[int] | None:
        first = list(arrived)[: self.period]
        return first if len(first) == self.period else None

    def resume(self, version: int, pending: Iterable[tuple[int, int]]) -> list[Block]:
        pending = list(pending)
        self._next = version * self.period + len(pending)  # those used and those on their way are all that were begun
        return [block for by, indices in _by_version(pending) for block in self._queue(indices, by, (by,))]


Order = Planned | AsTheyCome
"""What tells the collector which block comes next."""
