"""An episode is a function of its arguments: not of its neighbours, its block, or the engine that plays it."""

import dataclasses

import numpy as np
import pytest

from manywake.env.env import spaces
from manywake.env.task import Task
from manywake.flow import case
from manywake.learn import ppo
from manywake.learn.collect import Collector
from manywake.learn.engine import Threads
from manywake.learn.rollout import rollout
from manywake.learn.settings import Learning

CASE = case.by_name("cylinder-jets")
TASK = Task(actions_per_episode=3)
LEARNING = Learning(update_period=5, episodes=10, batch_size=15, hidden=(16, 16))


def collector(slots: int, lanes: int) -> Collector:
    return Collector(Threads(slots), CASE, TASK, 7, lanes)


@pytest.fixture(scope="module")
def policy():
    return ppo.snapshot(ppo.build(*spaces(CASE, TASK), LEARNING, collector(1, 8)))


def physics(episode) -> bytes:
    """All of an episode but the clock, as bytes."""
    parts = []
    for field in dataclasses.fields(episode):
        value = getattr(episode, field.name)
        if not field.name.endswith("seconds"):
            parts.append(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    return b"|".join(parts)


@pytest.fixture(scope="module")
def alone(policy):
    return [physics(rollout(CASE, TASK, policy, 7, [index])[0]) for index in range(5)]


@pytest.mark.parametrize(("slots", "lanes"), [(1, 8), (1, 2), (2, 3), (2, 1)])
def test_engines_and_blocks_give_the_same_episodes(policy, alone, slots, lanes):
    arrived = []
    episodes = collector(slots, lanes).collect(policy, range(5), arrived.extend)
    assert [physics(episode) for episode in episodes] == alone
    assert sorted(episode.index for episode in arrived) == [0, 1, 2, 3, 4]


def test_another_episode_or_run_seed_explores_differently(policy, alone):
    assert len(set(alone)) == 5
    assert physics(rollout(CASE, TASK, policy, 8, [0])[0]) != alone[0]


def test_training_gives_the_same_policy_for_any_number_of_lanes_and_threads():
    def digest(slots, lanes):
        model = ppo.build(*spaces(CASE, TASK), LEARNING, collector(slots, lanes))
        model.learn(LEARNING.episodes * TASK.actions_per_episode)
        return ppo.digest(model)

    assert digest(1, 8) == digest(2, 3) == digest(2, 1)


def test_actions_are_stored_as_drawn_and_played_clipped(policy):
    loud = dataclasses.replace(policy, std=np.array([5.0]), log_std=np.log([5.0]))
    episode = rollout(CASE, TASK, loud, 7, [0])[0]
    assert np.abs(episode.actions).max() > 1
    assert np.abs(episode.jets).max() <= TASK.max_flow_rate
