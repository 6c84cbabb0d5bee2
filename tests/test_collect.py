"""Collection loses no episode and changes none: not by layout, engine, schedule or fault."""

import dataclasses
import threading
import time

import numpy as np
import pytest

from manywake.case.learning import Learning
from manywake.learn import ppo, schedule
from manywake.learn.blocks import Layout, layout
from manywake.learn.collect import MOST_FAILURES, EpisodeFailed
from manywake.learn.engine import Processes, Threads
from manywake.learn.policy import act, sample
from manywake.learn.rollout import context

from .toy import Toy, collector, synced

pytestmark = pytest.mark.alone

LEARNING = Learning(
    update_period=10, episodes=40, learner_threads=1, learning_rate=3e-3, batch_size=50, n_epochs=1, hidden=(8,)
)
HORIZON = 5
SECONDS = schedule.durations(0, LEARNING.episodes, 5.0, 0.05)


def digest(toy=Toy(horizon=HORIZON), **changes) -> str:  # noqa: B008
    model = ppo.build(LEARNING, collector(toy, learning=LEARNING, **changes))
    seen = []
    model.hooks.collected = lambda model, episodes: seen.extend(episode.index for episode in episodes)
    model.learn(LEARNING.episodes * HORIZON)
    assert sorted(seen) == list(range(LEARNING.episodes))
    return ppo.digest(model)


@pytest.fixture(scope="module")
def serial():
    return digest()


@pytest.fixture(scope="module")
def processes():
    engine = Processes(3)
    yield engine
    engine.close()


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 2, 1), (5, 2, 3), (10, 3, 4), (10, 1, 10)])
def test_synced_training_is_the_same_for_any_number_of_environments_and_layout(serial, processes, shape):
    grid = Layout(*shape)
    engine = processes if grid.workers > 1 else Threads(1)
    assert digest(engine=engine, grid=grid, plan=synced(40, grid.environments, 10)) == serial


@pytest.mark.parametrize("asks", [1, HORIZON])
@pytest.mark.parametrize("shape", [(25, 1, 1), (25, 3, 4), (25, 2, 8)])
def test_unsynced_training_on_the_virtual_clock_is_the_same_for_any_layout(processes, shape, asks):
    plan = schedule.unsynced(SECONDS, 25, 10, 2.0, asks)
    assert (plan.update > plan.version[:, 0]).any()
    reference = digest(grid=Layout(25, 1, 25), plan=plan)
    assert digest(engine=processes, grid=Layout(*shape), plan=plan) == reference


def test_unsynced_on_the_real_clock_uses_every_episode_once_with_the_version_it_began_with(processes):
    toy = Toy(horizon=HORIZON, seconds=0.02)
    taken = collector(toy, learning=LEARNING, engine=processes, grid=Layout(12, 3, 4), plan=None)
    model = ppo.build(LEARNING, taken)
    batches = []
    model.hooks.collected = lambda model, episodes: batches.append((model.version, episodes))
    model.learn(LEARNING.episodes * HORIZON)
    assert sorted(e.index for _, episodes in batches for e in episodes) == list(range(40))
    for version, episodes in batches:
        assert all(episode.versions.max() <= version and not np.ptp(episode.versions) for episode in episodes)
        assert [e.index for e in episodes] == sorted(e.index for e in episodes)
    assert taken.pending() == []


@pytest.mark.parametrize("fault", ["raise", "kill", "hang"])
def test_a_fault_costs_time_and_no_bit(tmp_path, serial, fault):
    engine = Processes(2)
    lost = []
    faulty = (3, 17) if fault != "hang" else (17,)
    toy = Toy(horizon=HORIZON, faults=tuple((index, fault) for index in faulty), folder=tmp_path)
    limit = 5.0 if fault == "hang" else None
    try:
        found = digest(toy, engine=engine, grid=Layout(10, 2, 4), time_limit=limit, failed=lost.append)
    finally:
        engine.close()
    assert found == serial
    assert {failure.kind for failure in lost} == {{"raise": "raised", "kill": "died", "hang": "timed out"}[fault]}
    assert all(index in failure.episodes for index, failure in zip(faulty, lost, strict=True))


def test_a_block_of_several_policies_that_is_lost_is_played_again_by_the_same(tmp_path, processes):
    plan = schedule.unsynced(SECONDS, 25, 10, 2.0, HORIZON)
    shape = Layout(25, 2, 8)
    reference = digest(grid=shape, plan=plan)
    (index,) = np.flatnonzero(np.ptp(plan.version, axis=1) > 0)[:1].tolist()
    lost = []
    toy = Toy(horizon=HORIZON, faults=((index, "kill"),), folder=tmp_path)
    assert digest(toy, engine=processes, grid=shape, plan=plan, failed=lost.append) == reference
    assert [index in failure.episodes for failure in lost] == [True]
    assert lost[0].version == min(plan.version[list(lost[0].episodes), 0])


def test_policies_that_play_nothing_more_are_forgotten():
    plan = schedule.unsynced(SECONDS, 25, 10, 2.0, HORIZON)
    taken = collector(Toy(horizon=HORIZON), learning=LEARNING, grid=Layout(25, 1, 8), plan=plan)
    model, held = ppo.build(LEARNING, taken), []
    model.hooks.collected = lambda model, episodes: held.append(sorted(taken._policies))
    model.learn(LEARNING.episodes * HORIZON)
    assert [versions[-1] for versions in held] == [0, 1, 2, 3]
    for newest, versions in enumerate(held):
        later = plan.version[plan.version[:, -1] >= newest]
        assert versions == list(range(min(later.min(initial=newest), newest), newest + 1))


@pytest.mark.parametrize("fault", ["raise", "kill"])
def test_a_fault_on_the_real_clock_loses_no_episode_and_no_environment(tmp_path, processes, fault):
    toy = Toy(horizon=HORIZON, faults=((5, fault),), folder=tmp_path, seconds=0.02)
    taken = collector(toy, learning=LEARNING, engine=processes, grid=Layout(8, 2, 4), plan=None)
    policy = ppo.snapshot(ppo.build(LEARNING, taken))
    used = [episode.index for episode in taken.collect(policy)]
    begun = sorted(used + [index for index, _ in taken.pending()])
    assert len(used) == 10
    assert begun == list(range(len(begun)))
    taken.collect(dataclasses.replace(policy, version=1))


def test_an_episode_that_failed_during_an_update_is_still_on_its_way_for_the_checkpoint(tmp_path):
    """On the real clock nobody else knows of it: a run resumed without it would wait for ever."""
    toy = Toy(horizon=HORIZON, faults=((11, "raise"),), folder=tmp_path, times=99)
    given_up = threading.Event()

    def failed(failure):
        if failure.attempt == MOST_FAILURES:
            given_up.set()

    taken = collector(toy, learning=LEARNING, engine=Threads(1), grid=Layout(1, 1, 1), plan=None, failed=failed)
    policy = ppo.snapshot(ppo.build(LEARNING, taken))
    taken.collect(policy)
    assert given_up.wait(60)  # while the learner would be updating: all of it under version 0
    with pytest.raises(EpisodeFailed):
        taken.collect(dataclasses.replace(policy, version=1))
    assert taken.pending() == [(10, 0), (11, 0)]
    again = collector(Toy(horizon=HORIZON), learning=LEARNING, grid=Layout(1, 1, 1), plan=None)
    again.resume(1, taken.pending(), lambda version: policy)
    assert [e.index for e in again.collect(dataclasses.replace(policy, version=1))] == list(range(10, 20))


def test_an_episode_that_always_fails_stops_the_training_and_is_named(tmp_path, processes):
    toy = Toy(horizon=HORIZON, faults=((13, "raise"),), folder=tmp_path, times=99)
    lost = []
    taken = collector(toy, learning=LEARNING, run_seed=4, engine=processes, grid=Layout(10, 3, 5), failed=lost.append)
    with pytest.raises(EpisodeFailed, match="episode 13 of run seed 4 failed 3 times.*episode 13 is bad") as caught:
        ppo.build(LEARNING, taken).learn(LEARNING.episodes * HORIZON)
    assert caught.value.index == 13
    assert [failure.attempt for failure in lost] == [0, 1, 2, 3]  # once with its block, three times alone
    assert all(failure.kind == "raised" for failure in lost)


def test_blocks_never_mix_versions_and_never_outnumber_the_workers():
    running, most, versions = 0, 0, []
    lock = threading.Lock()

    class Counting(Toy):
        def play(self, driving, contexts):
            nonlocal running, most
            with lock:
                running += 1
                most = max(most, running)
            try:
                episodes = super().play(driving, contexts)
                versions.append({version for episode in episodes for version in episode.versions.tolist()})
                return episodes
            finally:
                with lock:
                    running -= 1

    plan = schedule.unsynced(SECONDS, 25, 10, 0.3)
    digest(toy=Counting(horizon=HORIZON, seconds=0.01), engine=Threads(8), grid=Layout(25, 3, 4), plan=plan)
    assert most <= 3
    assert all(len(found) == 1 for found in versions)


def test_an_action_is_drawn_by_the_policy_that_the_plan_gives_it():
    plan = schedule.unsynced(SECONDS, 25, 10, 2.0, HORIZON)
    taken = collector(Toy(horizon=HORIZON), learning=LEARNING, grid=Layout(25, 1, 8), plan=plan)
    model, policies, episodes = ppo.build(LEARNING, taken), [], []

    def remember(model, batch):
        policies.append(ppo.snapshot(model))
        episodes.extend(batch)

    model.hooks.collected = remember
    model.learn(LEARNING.episodes * HORIZON)
    assert any(len(set(episode.versions)) > 1 for episode in episodes)
    for episode in episodes:
        np.testing.assert_array_equal(episode.versions, plan.version[episode.index])
        noise = context(0, episode.index, HORIZON, 1).noise
        for t, version in enumerate(episode.versions):
            mean = act(policies[version], episode.observations[t : t + 1])
            action, log_prob = sample(policies[version], mean, noise[t : t + 1])
            assert (action[0], log_prob[0]) == (episode.actions[t], episode.log_probs[t])


@pytest.mark.parametrize("asks", [1, HORIZON])
def test_a_collector_that_goes_on_from_the_middle_gives_the_same_episodes(asks):
    plan = schedule.unsynced(SECONDS, 25, 10, 2.0, asks)
    whole = collector(Toy(horizon=HORIZON), learning=LEARNING, grid=Layout(25, 1, 8), plan=plan)
    model = ppo.build(LEARNING, whole)
    policies = [ppo.snapshot(model)]
    batches = []

    def remember(model, episodes):
        policies.append(ppo.snapshot(model))
        batches.append(episodes)

    model.hooks.updated = remember
    model.learn(LEARNING.episodes * HORIZON)
    again = collector(Toy(horizon=HORIZON), learning=LEARNING, grid=Layout(25, 1, 3), plan=plan)
    begun = np.flatnonzero((plan.version[:, -1] < 2) & (plan.update >= 2))
    assert (plan.version[plan.version[:, -1] >= 2, 0] < 2).any() == (asks > 1)  # those ask for old policies again
    again.resume(2, [(int(k), int(plan.version[k, 0])) for k in begun], policies.__getitem__)
    for version in (2, 3):
        for ours, theirs in zip(again.collect(policies[version]), batches[version], strict=True):
            assert ours.index == theirs.index
            np.testing.assert_array_equal(ours.actions, theirs.actions)


@pytest.mark.parametrize(
    ("given", "cores", "wanted"),
    [
        ((20, None, None), 2, (20, 3, 8)),
        ((5, None, None), 2, (5, 2, 3)),
        ((1, None, None), 2, (1, 1, 1)),
        ((20, None, None), 64, (20, 20, 1)),
        ((60, None, None), 4, (60, 5, 8)),
        ((None, None, None), 2, (20, 3, 8)),
        ((None, 2, 4), 2, (8, 2, 4)),
        ((12, 3, None), 2, (12, 3, 4)),
        ((7, None, 7), 2, (7, 1, 7)),
    ],
)
def test_a_layout_is_worked_out_from_what_is_given(given, cores, wanted):
    assert layout(*given, period=20, cores=cores) == Layout(*wanted)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((0, None, None), "envs: got 0, wanted at least 1"),
        ((4, 3, 2), "workers: got 3 of 2 lanes for 4 environments, wanted at most 2"),
    ],
)
def test_a_layout_that_does_not_fit_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        layout(*given, period=20, cores=2)


def test_where_the_time_went_adds_up(processes):
    taken = collector(Toy(horizon=HORIZON, seconds=0.2), learning=LEARNING, engine=processes, grid=Layout(10, 3, 4))
    policy = ppo.snapshot(ppo.build(LEARNING, taken))
    taken.collect(policy)
    start = time.perf_counter()
    episodes = taken.collect(dataclasses.replace(policy, version=1))
    wall = time.perf_counter() - start
    busy = sum(episode.flow_seconds + episode.transport_seconds for episode in episodes)
    assert 3 * 0.2 <= busy <= 3 * wall  # three blocks on three workers
    assert all(0 <= episode.waiting_seconds <= wall for episode in episodes)
