"""The order of blocks by itself, without engine and clock. Whatever comes when, no episode is lost or played twice."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manywake.learn import schedule
from manywake.learn.blocks import AsTheyCome, Block, Layout, Planned, cut

PERIOD, UPDATES = 6, 5
TOTAL = PERIOD * UPDATES
SECONDS = schedule.durations(0, TOTAL, 5.0, 0.2)
PLANS = {
    "synced": lambda n: schedule.synced(SECONDS, min(n, PERIOD), PERIOD, 1.0),
    "unsynced": lambda n: schedule.unsynced(SECONDS, n, PERIOD, 2.0),
    "for every action": lambda n: schedule.unsynced(SECONDS, n, PERIOD, 2.0, 4),
}


def alike(index: int) -> int:
    return 0


def thirds(index: int) -> int:
    """Three variants, in no pattern that blocks could follow."""
    return (7 * index + index * index // 5) % 3


def order(kind: str, grid: Layout, variant=alike) -> Planned | AsTheyCome:
    if kind == "as they come":
        return AsTheyCome(grid, PERIOD, TOTAL, variant)
    return Planned(PLANS[kind](grid.environments), grid, variant)


KINDS = [*PLANS, "as they come"]
grids = st.builds(Layout, st.integers(1, 14), st.just(1), st.integers(1, 5))


@dataclass
class Game:
    """Plays blocks in an order that is drawn, at most `slots` at a time, and loses some of them on the way.

    begun: every block that was started. arrived: episodes not used yet, in the order they came. used: by update.
    """

    order: Planned | AsTheyCome
    rng: np.random.Generator
    slots: int = 3
    losses: float = 0.0
    version: int = 0
    queue: list[Block] = field(default_factory=list)
    flying: list[Block] = field(default_factory=list)
    begun: list[Block] = field(default_factory=list)
    arrived: list[int] = field(default_factory=list)
    used: dict[int, list[int]] = field(default_factory=dict)
    most: int = 0

    def step(self) -> None:
        """One block starts, or one comes or is lost."""
        if self.queue and len(self.flying) < self.slots:
            block = self.order.started(self.queue.pop(0), self.version)
            self.begun.append(block)
            self.flying.append(block)
            self.most = max(self.most, sum(len(flying.indices) for flying in self.flying))
            return
        block = self.flying.pop(self.rng.integers(len(self.flying)))
        if self.rng.random() < self.losses:
            self.queue[:0] = block.split()
            return
        self.arrived.extend(block.indices)
        self.queue.extend(self.order.came(block, self.version))

    def update(self) -> list[int]:
        """Play until the update of this version can be made; return its episodes."""
        self.queue.extend(self.order.policy(self.version))
        while (ready := self.order.ready(self.version, self.arrived)) is None:
            assert self.queue or self.flying, "nothing is on its way, and yet an update waits"
            self.step()
        for index in ready:
            self.arrived.remove(index)
            del self.order.begun[index]
        self.used[self.version] = ready
        for _ in range(self.rng.integers(4)):  # the learner takes its time
            if self.flying or self.queue:
                self.step()
        self.version += 1
        return ready

    def play(self, updates: int = UPDATES) -> "Game":
        while self.version < updates:
            self.update()
        return self


@pytest.mark.parametrize("variant", [alike, thirds])
@pytest.mark.parametrize("kind", KINDS)
@given(grids, st.integers(0, 99), st.integers(1, 4), st.sampled_from([0.0, 0.3]))
def test_every_episode_is_given_and_used_exactly_once(kind, variant, grid, seed, slots, losses):
    game = Game(order(kind, grid, variant), np.random.default_rng(seed), slots, losses).play()
    assert sorted(index for ready in game.used.values() for index in ready) == list(range(TOTAL))
    assert all(len(ready) == PERIOD for ready in game.used.values())
    assert not (game.queue or game.flying or game.arrived or game.order.begun)
    if not losses:
        assert sorted(index for block in game.begun for index in block.indices) == list(range(TOTAL))


@pytest.mark.parametrize("kind", KINDS)
@given(grids, st.integers(0, 99))
def test_a_block_is_of_one_variant_and_no_wider_than_the_lanes(kind, grid, seed):
    game = Game(order(kind, grid, thirds), np.random.default_rng(seed)).play()
    assert {thirds(block.indices[0]) for block in game.begun} == {0, 1, 2}
    for block in game.begun:
        assert len({thirds(index) for index in block.indices}) == 1
        assert 1 <= len(block.indices) <= grid.lanes
        assert block.group == block.indices


@given(st.lists(st.integers(0, 500), unique=True, max_size=60), grids)
def test_a_cut_keeps_the_episodes_of_a_round_together_and_their_order_in_a_variant(indices, grid):
    blocks = cut(indices, grid, thirds)
    assert sorted(index for block in blocks for index in block) == sorted(indices)
    position = {index: k for k, index in enumerate(indices)}
    rounds = [{position[index] // grid.environments for index in block} for block in blocks]
    assert all(len(each) == 1 for each in rounds)
    assert [min(each) for each in rounds] == sorted(min(each) for each in rounds)
    for variant in range(3):
        mine = [index for block in blocks for index in block if thirds(index) == variant]
        assert mine == [index for index in indices if thirds(index) == variant]
    full = sum(-(-sum(thirds(i) == v for i in indices[k : k + grid.environments]) // grid.lanes)
               for k in range(0, len(indices), grid.environments) for v in range(3))  # fmt: skip
    assert len(blocks) == full  # no more blocks than their variants ask for


@pytest.mark.parametrize("kind", PLANS)
@given(grids, st.integers(0, 99), st.sampled_from([0.0, 0.3]))
def test_what_is_planned_is_played_by_the_policies_of_the_plan_and_used_when_it_says(kind, grid, seed, losses):
    given_order = order(kind, grid, thirds)
    plan = given_order.plan
    game = Game(given_order, np.random.default_rng(seed), losses=losses).play()
    for version, ready in game.used.items():
        assert ready == np.flatnonzero(plan.update == version).tolist()
    for block in game.begun:
        assert block.versions == tuple(sorted(set(block.versions)))
        for index in block.indices:
            asked = np.array(block.versions)[given_order.asks(block, index)]
            np.testing.assert_array_equal(asked, plan.version[index])


@given(grids, st.integers(0, 99), st.integers(1, 4), st.sampled_from([0.0, 0.3]))
def test_as_they_come_no_more_episodes_are_on_their_way_than_there_are_environments(grid, seed, slots, losses):
    wanted = AsTheyCome(grid, PERIOD, TOTAL, thirds)
    game = Game(wanted, np.random.default_rng(seed), slots, losses)
    while game.version < UPDATES:
        game.update()
        on_the_way = [index for block in (*game.queue, *game.flying) for index in block.indices]
        assert len(on_the_way) <= grid.environments
    assert game.most <= grid.environments


@given(grids, st.integers(0, 99))
def test_as_they_come_a_block_starts_with_the_newest_policy(grid, seed):
    game = Game(AsTheyCome(grid, PERIOD, TOTAL, thirds), np.random.default_rng(seed))
    while game.version < UPDATES:
        started, before = len(game.begun), game.version
        game.update()
        for block in game.begun[started:]:
            assert block.versions == (before,)
            assert all(game.order.begun.get(index, before) == before for index in block.indices)


@pytest.mark.parametrize("variant", [alike, thirds])
@pytest.mark.parametrize("kind", KINDS)
@given(grids, grids, st.integers(0, 99), st.integers(0, UPDATES), st.sampled_from([0.0, 0.3]))
def test_resuming_gives_back_what_was_on_its_way_and_loses_nothing(kind, variant, grid, other, seed, updates, losses):
    if kind != "as they come":  # a plan is one of its number of environments
        other = Layout(grid.environments, 1, other.lanes)
    rng = np.random.default_rng(seed)
    before = Game(order(kind, grid, variant), rng, losses=losses).play(updates)
    pending = sorted(before.order.begun.items())
    after = Game(order(kind, other, variant), rng, losses=losses, version=updates)
    given_back = after.order.resume(updates, pending)
    assert sorted(index for block in given_back for index in block.indices) == [index for index, _ in pending]
    assert sorted(after.order.begun.items()) == pending
    for block in given_back:
        assert len({variant(index) for index in block.indices}) == 1
        assert len(block.indices) <= other.lanes
        for index in block.indices:  # by the policies it was begun with, whatever the newest is now
            assert block.versions is not None
            assert after.order.started(block, updates).versions == block.versions
            assert block.versions[after.order.asks(block, index)[0]] == dict(pending)[index]
    after.queue.extend(given_back)
    after.play()
    every = [index for game in (before, after) for ready in game.used.values() for index in ready]
    assert sorted(every) == list(range(TOTAL))
    if kind != "as they come":
        whole = Game(order(kind, grid, variant), rng).play()
        assert before.used | after.used == whole.used


def test_a_run_that_is_done_begins_nothing_when_it_is_resumed():
    for kind in KINDS:
        done = order(kind, Layout(6, 1, 2))
        assert done.resume(UPDATES, []) == [] and done.policy(UPDATES) == []


def test_a_lost_block_is_split_into_single_episodes_of_its_group():
    block = Block((4, 9, 11), (1, 2), (4, 9, 11))
    assert block.split() == [Block((k,), (1, 2), (4, 9, 11)) for k in (4, 9, 11)]
    assert block.split()[1].split() == [Block((9,), (1, 2), (4, 9, 11))]


def test_a_lost_block_gives_its_environments_free_when_all_of_its_group_have_come():
    wanted = AsTheyCome(Layout(6, 2, 3), PERIOD, TOTAL)
    first, second = (wanted.started(block, 0) for block in wanted.policy(0))
    assert (first.indices, second.indices) == ((0, 1, 2), (3, 4, 5))
    one, two, three = first.split()
    assert wanted.came(two, 0) == [] and wanted.came(one, 1) == []
    follow = wanted.came(three, 1)
    assert [block.indices for block in follow] == [(6, 7, 8)]
    assert [wanted.started(block, 1).versions for block in follow] == [(1,)]
    assert [block.indices for block in wanted.came(second, 1)] == [(9, 10, 11)]


def test_a_planned_block_that_was_lost_asks_its_policies_as_before():
    plan = schedule.unsynced(SECONDS, 12, PERIOD, 2.0, 4)
    mixed = int(np.flatnonzero(np.ptp(plan.version, axis=1) > 0)[0])
    wanted = Planned(plan, Layout(12, 1, 4))
    blocks = [block for version in range(UPDATES) for block in wanted.policy(version)]
    (block,) = [block for block in blocks if mixed in block.indices]
    (alone,) = [part for part in block.split() if part.indices == (mixed,)]
    assert len(block.indices) > 1 and alone.group == block.indices
    np.testing.assert_array_equal(wanted.asks(alone, mixed), wanted.asks(block, mixed))


def test_the_oldest_policy_that_is_still_needed_is_that_of_the_episodes_to_begin():
    plan = schedule.unsynced(SECONDS, 12, PERIOD, 2.0, 4)
    wanted = Planned(plan, Layout(12, 1, 4))
    for version in range(UPDATES):
        later = plan.version[plan.version[:, -1] >= version]
        assert wanted.oldest(version) == min(later.min(initial=version), version)
    assert any(wanted.oldest(version) < version for version in range(UPDATES))
    assert AsTheyCome(Layout(6, 1, 6), PERIOD, TOTAL).oldest(3) == 3
