"""An environment's state: taken, put back, copied, pickled, carried to another process, to the bit."""

import copy
import pickle
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from manywake import FlowEnv, FlowVectorEnv

from .external import case_file

TASK = {"actions": 4, "delay": 1, "history": 2}
SETTINGS = TASK | {"interval": 0.005, "noise.pressure": 0.01}
CASES = {
    "cylinder-jets": SETTINGS,
    "step": TASK | {"interval": 0.02},
}


def played(env, actions) -> list:
    """Return all that an environment answers to actions, restarts at episodes' ends and what they draw among it."""
    found = []
    for action in actions:
        seen, reward, terminated, truncated, info = env.step(action)
        found.append((seen, reward, terminated, truncated, info["amplitudes"], info.get("power")))
        if not isinstance(env, FlowVectorEnv) and (terminated or truncated):
            found.append(env.reset()[0])
    return found


def same(first, second) -> None:
    np.testing.assert_equal(first, second)


def some_actions(env, count=10):
    rng = np.random.default_rng(1)
    return rng.uniform(-1, 1, (count, *env.action_space.shape)).astype(np.float32)


@pytest.fixture(params=CASES)
def batch(request):
    env = FlowVectorEnv(3, request.param, **CASES[request.param])
    env.reset(seed=5)
    played(env, some_actions(env, 2))
    return env


def test_a_batch_that_is_put_back_goes_on_as_before(batch):
    actions, state = some_actions(batch), batch.get_state()
    first = played(batch, actions)
    batch.set_state(state)
    same(played(batch, actions), first)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copied_batch_goes_on_as_its_model(batch, copied):
    actions, other = some_actions(batch), copied(batch)
    first = played(batch, actions)
    same(played(other, actions), first)


def test_a_state_moves_to_another_environment_by_pickle():
    env, other = (FlowEnv(**SETTINGS) for _ in range(2))
    env.reset(seed=7)
    played(env, some_actions(env, 2))
    state = pickle.dumps(env.get_state())
    first = played(env, some_actions(env))
    other.set_state(pickle.loads(state))
    same(played(other, some_actions(env)), first)


def test_planning_ahead_disturbs_nothing():
    env, twin = (FlowEnv(**SETTINGS) for _ in range(2))
    for each in (env, twin):
        each.reset(seed=7)
    first = []
    for action in some_actions(env, 6):
        state = env.get_state()
        played(env, some_actions(env, 2))  # what if
        env.set_state(state)
        first += played(env, [action])
    same(first, played(twin, some_actions(env, 6)))


def test_a_state_of_another_size_is_refused(batch):
    state = batch.get_state()
    with pytest.raises(ValueError, match="state: got one of 2 flows, wanted one of 3"):
        batch.set_state(replace(state, flows=state.flows[:2]))


def test_a_copy_keeps_what_its_users_file_defined(tmp_path):
    env = FlowEnv(case_file(tmp_path), actions=3)
    env.reset(seed=0)
    other = pickle.loads(pickle.dumps(env))
    same(played(other, some_actions(env, 3)), played(env, some_actions(env, 3)))


@pytest.mark.parametrize("context", ["fork", "forkserver"])
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning", "ignore:.*async_vector_env.*")
def test_other_processes_play_the_same(context):
    def one():
        return gymnasium.make("manywake:manywake/CylinderJets-v0", actions=3, interval=0.005)

    apart = gymnasium.vector.AsyncVectorEnv([one, one], context=context)
    here = gymnasium.vector.SyncVectorEnv([one, one])
    try:
        for env in (apart, here):
            env.reset(seed=3)
        for action in some_actions(here, 5):
            same(apart.step(action)[:4], here.step(action)[:4])
    finally:
        apart.close()
        here.close()
