"""What other libraries and Gymnasium's own wrappers ask of the environments."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO

from manywake import FlowEnv, FlowVectorEnv

pytestmark = pytest.mark.filterwarnings("ignore:.*precision lowered by casting")  # of Gymnasium's own boxes
ID = "manywake/CylinderJets-v0"
SHORT = {"interval": 0.005, "actions": 3}


def test_stable_baselines_takes_the_id_alone():
    assert PPO("MlpPolicy", ID, n_steps=4, batch_size=4, device="cpu").env.num_envs == 1


def test_a_library_that_tries_a_keyword_sees_that_it_is_not_there():
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):  # TorchRL looks for these words
        gymnasium.make(ID, frameskip=1)


def test_no_render_mode_is_a_render_mode():
    assert gymnasium.make(ID, render_mode=None, **SHORT).render_mode is None
    assert gymnasium.make_vec(ID, num_envs=2, render_mode=None, **SHORT).render_mode is None


def test_every_value_of_info_has_a_type_and_a_shape():
    env = FlowEnv(**SHORT)
    env.reset(seed=0)
    info = env.step(np.zeros(1))[4]
    assert {"c_d", "diverged", "reynolds", "time", "amplitudes"} <= set(info)
    assert all(hasattr(value, "dtype") and hasattr(value, "shape") for value in info.values())


@pytest.mark.parametrize("mode", AutoresetMode)
def test_the_batch_says_how_it_resets(mode):
    assert FlowVectorEnv(2, autoreset_mode=mode, **SHORT).autoreset_mode is mode


SINGLE = {
    "noise": lambda env: gymnasium.wrappers.TransformObservation(
        env, lambda seen: seen + np.float32(0.01), env.observation_space
    ),
    "delay": lambda env: gymnasium.wrappers.DelayObservation(env, delay=2),
    "frame stack": lambda env: gymnasium.wrappers.FrameStackObservation(env, 3),
    "normalise": gymnasium.wrappers.NormalizeObservation,
    "normalise reward": gymnasium.wrappers.NormalizeReward,
    "statistics": gymnasium.wrappers.RecordEpisodeStatistics,
    "rescale": lambda env: gymnasium.wrappers.RescaleAction(env, -2.0, 2.0),
}


@pytest.mark.parametrize("wrap", SINGLE.values(), ids=SINGLE)
def test_gymnasiums_wrappers_take_the_environment(wrap):
    env = wrap(gymnasium.make(ID, **SHORT))
    env.reset(seed=0)
    for k in range(3):
        seen, _, _, truncated, info = env.step(env.action_space.sample())
        assert env.observation_space.contains(seen) and truncated == (k == 2)
    assert "c_d" in info


BATCH = {
    "normalise": gymnasium.wrappers.vector.NormalizeObservation,
    "normalise reward": gymnasium.wrappers.vector.NormalizeReward,
    "statistics": gymnasium.wrappers.vector.RecordEpisodeStatistics,
    "rescale": lambda env: gymnasium.wrappers.vector.RescaleAction(env, -2.0, 2.0),
    "infos": gymnasium.wrappers.vector.DictInfoToList,
}


@pytest.mark.parametrize("wrap", BATCH.values(), ids=BATCH)
def test_gymnasiums_wrappers_take_the_batch(wrap):
    env = wrap(gymnasium.make_vec(ID, num_envs=2, **SHORT))
    env.reset(seed=0)
    for k in range(3):
        seen, _, _, truncated, _ = env.step(env.action_space.sample())
        assert seen.shape == env.observation_space.shape and (truncated == (k == 2)).all()


def test_the_statistics_of_an_episode_are_its_rewards():
    env = gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.make(ID, **SHORT))
    env.reset(seed=0)
    steps = [env.step(np.array([0.5], np.float32)) for _ in range(3)]
    assert steps[-1][4]["episode"]["r"] == pytest.approx(sum(step[1] for step in steps))


@pytest.mark.filterwarnings("ignore")  # of TorchRL's own imports
def test_torchrl_takes_ids_environments_and_batches():
    from torchrl import envs

    by_id = envs.GymEnv(ID, **SHORT)
    single = envs.GymWrapper(gymnasium.make(ID, **SHORT))
    single.auto_register_info_dict()
    batch = envs.GymWrapper(FlowVectorEnv(2, autoreset_mode=AutoresetMode.DISABLED, **SHORT))
    assert [tuple(env.rollout(3).batch_size) for env in (by_id, single, batch)] == [(3,), (3,), (2, 3)]
    assert single.rollout(2)["next", "c_d"].shape == (2,)
