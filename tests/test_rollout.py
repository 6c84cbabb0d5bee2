"""An episode is a function of its arguments: not of its neighbours, its block, or the engine that plays it."""

import dataclasses

import numpy as np
import pytest

from manywake.case.learning import Learning
from manywake.learn import policy as policies
from manywake.learn import ppo, schedule
from manywake.learn.blocks import Layout, Planned
from manywake.learn.collect import Collector
from manywake.learn.engine import Processes, Threads
from manywake.learn.flows import Flows
from manywake.learn.rollout import context, seed
from manywake.suite import load

ACTIONS = 3
LEARNING = Learning(update_period=5, episodes=10, learner_threads=1, batch_size=15, hidden=(16, 16))


@pytest.fixture(scope="module")
def flows(shipped):
    return Flows((shipped,), load.choose("cylinder-jets", actions=ACTIONS))


def taken(flows, engine=None, lanes=5, workers=1) -> Collector:
    grid = Layout(5, workers, lanes)
    return Collector(engine or Threads(1), flows, 7, grid, Planned(schedule.synced(np.ones(10), 5, 5, 0.1), grid))


@pytest.fixture(scope="module")
def processes():
    made = Processes(3)
    yield made
    made.close()


@pytest.fixture(scope="module")
def policy(flows):
    return ppo.snapshot(ppo.build(LEARNING, taken(flows)))


def play(flows, policy, indices, run_seed=7):
    return flows.play([policy], [context(run_seed, index, ACTIONS, 1) for index in indices])


def physics(episode) -> bytes:
    """All of an episode but the clock, as bytes."""
    parts = []
    for field in dataclasses.fields(episode):
        value = getattr(episode, field.name)
        if field.name == "readings":
            parts += [series.tobytes() for series in value.values()]
        elif not field.name.endswith("seconds"):
            parts.append(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    return b"|".join(parts)


@pytest.fixture(scope="module")
def alone(flows, policy):
    return [physics(play(flows, policy, [index])[0]) for index in range(5)]


@pytest.mark.parametrize(("workers", "lanes"), [(1, 5), (1, 2), (2, 3), (3, 2), (3, 1)])
def test_engines_and_blocks_give_the_same_episodes(flows, policy, alone, processes, workers, lanes):
    for engine in (Threads(workers), processes):
        arrived = []
        collector = taken(flows, engine, lanes, workers)
        collector.seen = arrived.extend
        assert [physics(episode) for episode in collector.collect(policy)] == alone
        assert sorted(episode.index for episode in arrived) == [0, 1, 2, 3, 4]


def test_an_episode_s_seed_is_that_of_its_number_among_the_children_of_the_run_s():
    children = np.random.SeedSequence(7).spawn(4)
    assert [seed(7, index) for index in range(4)] == [int(child.generate_state(1)[0]) for child in children]
    assert context(7, 3, 2, 1).seed == seed(7, 3)


def test_another_episode_or_run_seed_explores_differently(flows, policy, alone):
    assert len(set(alone)) == 5
    assert physics(play(flows, policy, [0], run_seed=8)[0]) != alone[0]


def test_training_gives_the_same_policy_for_any_number_of_lanes_and_workers(flows, processes):
    def digest(*how):
        model = ppo.build(LEARNING, taken(flows, *how))
        model.learn(LEARNING.episodes * ACTIONS)
        return ppo.digest(model)

    assert digest() == digest(Threads(2), 3, 2) == digest(processes, 1, 3)


def test_actions_are_stored_as_drawn_and_played_clipped(flows, policy):
    loud = dataclasses.replace(policy, std=np.array([5.0]), log_std=np.log([5.0]))
    episode = play(flows, loud, [0])[0]
    assert np.abs(episode.actions).max() > 1
    assert np.abs(episode.readings["amplitude_rms"]).max() <= 1  # of the jets' limit


def test_a_policy_comes_back_from_its_file_as_it_went(policy, tmp_path):
    policies.write(policy, tmp_path / "policy.npz")
    back = policies.read(tmp_path / "policy.npz")
    assert back.version == policy.version
    for ours, theirs in zip(
        [*sum(back.layers, ()), back.mean, back.deviation, back.log_std, back.std],
        [*sum(policy.layers, ()), policy.mean, policy.deviation, policy.log_std, policy.std],
        strict=True,
    ):
        np.testing.assert_array_equal(ours, theirs)


def test_a_worker_never_assembles(flows, policy, processes):
    """What a worker plays with came from the trainer, with nothing in it that assembly would have left."""
    assert processes.submit(assembled_there, processes.share(flows)).result(60) == (
        True,
        flows.flows[0].operators.digest,
    )


def assembled_there(flows):
    return "space" not in vars(flows.flows[0].operators), flows.flows[0].operators.digest
