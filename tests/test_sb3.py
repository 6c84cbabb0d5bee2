"""Flows under Stable-Baselines3: the bits of the batch, its contract, its algorithms and wrappers."""

import dataclasses
import functools
import re
import warnings

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from sb3_contrib import TQC
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

from examples import train_sb3
from manywake.env.env import FlowEnv, FlowVectorEnv
from manywake.sb3 import FlowVecEnv

SHORT = {"interval": 0.002, "actions": 3}
"""Two solver steps an action, three actions an episode."""
CHANCE = SHORT | {"starts": "any"}
FEW = {"learning_starts": 4, "batch_size": 4, "gradient_steps": 1}


@pytest.fixture
def pair():
    flows = FlowVecEnv(2, **SHORT)
    yield flows
    flows.close()


def plan(steps, flows, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, flows, 1)).astype(np.float32)


def assert_same_info(ours, theirs):
    assert set(ours) == set(theirs)
    for name in ours:
        assert np.asarray(ours[name]).dtype == np.asarray(theirs[name]).dtype
        np.testing.assert_array_equal(ours[name], theirs[name])


# ---- what it gives is what the batch gives, and what single environments give


def test_bits_are_those_of_the_batch_of_the_same_seeds_and_actions():
    ours, batch = FlowVecEnv(3, **CHANCE), FlowVectorEnv(3, autoreset_mode=AutoresetMode.SAME_STEP, **CHANCE)
    ours.seed(7)
    np.testing.assert_array_equal(ours.reset(), batch.reset(seed=7)[0])
    ends = 0
    for action in plan(7, 3):
        mine, (observation, reward, terminated, truncated, info) = ours.step(action), batch.step(action)
        np.testing.assert_array_equal(mine[0], observation)
        np.testing.assert_array_equal(mine[1], reward.astype(np.float32))
        np.testing.assert_array_equal(mine[2], terminated | truncated)
        last = info.get("final_info", info)
        for b in range(3):
            assert mine[3][b]["c_d"] == last["c_d"][b] and mine[3][b]["c_l"] == last["c_l"][b]
            np.testing.assert_array_equal(mine[3][b]["amplitudes"], last["amplitudes"][b])
        ends += truncated.all()
    assert ends == 2


def test_sb3_gets_of_the_batch_what_it_gets_of_single_environments(pair):
    twin = DummyVecEnv([lambda: FlowEnv(**SHORT)] * 2)
    for env in (pair, twin):
        assert env.seed(3) == [3, 4]
    np.testing.assert_array_equal(pair.reset(), twin.reset())
    for env in (pair.flows, twin.envs[0]._batch):  # one flow blows up, the other goes on
        flows = env._flows._parts[0]
        start = flows.batch.state(0)
        flows.reset([0], [0], dataclasses.replace(start, u=np.full_like(start.u, np.nan)))
    ends = []
    for action in plan(8, 2):
        mine, theirs = pair.step(action), twin.step(action)
        for a, b in zip(mine[:3], theirs[:3], strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
        for b in range(2):
            assert_same_info(mine[3][b], theirs[3][b])
            assert_same_info(pair.reset_infos[b], twin.reset_infos[b])
        ends.append([info["TimeLimit.truncated"] if end else None for end, info in zip(*mine[2:], strict=True)])
    assert ends[0] == [False, None] and ends[2] == [None, True] and ends[3] == [True, None]
    twin.close()


def test_the_horizon_is_a_time_limit_with_the_last_observation_beside_the_first_of_the_next_episode(pair):
    first, batch = pair.reset(), FlowVectorEnv(2, autoreset_mode=AutoresetMode.DISABLED, **SHORT)
    assert all("c_d" not in info and info["time"] == 0.0 for info in pair.reset_infos)
    batch.reset()
    for k, action in enumerate(plan(3, 2)):
        observation, _, done, infos = pair.step(action)
        last = batch.step(action)[0]
        assert done.tolist() == [k == 2] * 2 == [info["TimeLimit.truncated"] for info in infos]
        assert ["terminal_observation" in info for info in infos] == [k == 2] * 2
    np.testing.assert_array_equal([info["terminal_observation"] for info in infos], last)
    np.testing.assert_array_equal(observation, first)
    assert [info["time"] for info in infos] == pytest.approx([0.006] * 2)
    assert [info["time"] for info in pair.reset_infos] == [0.0] * 2


# ---- SB3's contract


def test_a_seed_is_that_of_the_first_flow_and_holds_for_one_reset():
    flows, singles = FlowVecEnv(2, **CHANCE), [FlowEnv(**CHANCE) for _ in range(2)]
    for seed in (5, 11):
        assert flows.seed(seed) == [seed, seed + 1]
        first, second = flows.reset(), flows.reset()
        for b, single in enumerate(singles):
            np.testing.assert_array_equal(first[b], single.reset(seed=seed + b)[0])
            np.testing.assert_array_equal(second[b], single.reset()[0])
        assert not np.array_equal(first, second) and not np.array_equal(*first)


def test_attributes_and_methods_are_the_batchs_and_spaces_a_flows(pair):
    assert pair.get_attr("task") == [pair.flows.task] * 2 and pair.get_attr("num_envs", 1) == [2]
    assert pair.get_attr("observation_space", [0]) == [pair.observation_space]
    assert pair.get_attr("action_space") == [pair.action_space] * 2
    assert pair.has_attr("case") and not pair.has_attr("absent")
    pair.set_attr("label", "mine")
    assert pair.flows.label == "mine" and pair.get_attr("label") == ["mine"] * 2
    assert [observation.shape for observation, _ in pair.env_method("reset", seed=1)] == [(2, 151)] * 2
    assert pair.env_is_wrapped(Monitor) == [False, False]
    assert pair.metadata["coefficients"] == FlowVectorEnv.metadata["coefficients"]


def test_one_flow_alone_is_not_reset_or_changed(pair):
    wanted = pytest.raises(ValueError, match=r"got indices=1, wanted None; all flows share one environment")
    with wanted:
        pair.env_method("reset", indices=1)
    with wanted:
        pair.set_attr("label", "mine", 1)


def test_pictures_are_the_batchs(pair):
    assert pair.render_mode is None and pair.get_images() == [None, None]
    shown = FlowVecEnv(2, render_mode="rgb_array", **SHORT)
    shown.reset()
    frames = shown.flows.render()
    np.testing.assert_array_equal(shown.get_images(), frames)
    assert shown.render().shape == (2 * frames[0].shape[0], *frames[0].shape[1:])
    shown.close()


def test_settings_are_the_batchs():
    flows = FlowVecEnv(1, "cylinder-jets", "paper", interval=0.002)
    assert flows.flows.task.actions == 80 and flows.flows.task.interval == 0.002


# ---- its algorithms and wrappers


@pytest.mark.parametrize(
    ("algorithm", "settings"),
    [(PPO, {"n_steps": 6, "batch_size": 6, "n_epochs": 1}), (SAC, FEW), (TQC, FEW)],
    ids=["ppo", "sac", "tqc"],
)
def test_algorithms_learn_on_it(pair, algorithm, settings, one_thread, tmp_path):
    model = algorithm("MlpPolicy", pair, seed=0, device="cpu", policy_kwargs={"net_arch": [8]}, **settings)
    before = [part.detach().clone() for part in model.policy.parameters()]
    model.learn(12)
    assert model.num_timesteps == 12
    losses = [value for name, value in model.logger.name_to_value.items() if name.endswith("loss")]
    assert losses and np.isfinite(losses).all()
    assert any(not torch.equal(a, b) for a, b in zip(before, model.policy.parameters(), strict=True))
    model.save(tmp_path / "model")
    again, observation = algorithm.load(tmp_path / "model", env=pair, device="cpu"), pair.reset()
    for one, other in zip(*(m.predict(observation, deterministic=True) for m in (model, again)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_same_seed_trains_the_same_policy(one_thread):
    def trained(seed):
        model = PPO("MlpPolicy", FlowVecEnv(2, **SHORT), n_steps=3, batch_size=6, n_epochs=1, seed=seed, device="cpu")
        return torch.cat([part.flatten() for part in model.learn(6).policy.parameters()])

    assert torch.equal(trained(0), trained(0)) and not torch.equal(trained(0), trained(1))


def test_sb3s_wrappers_take_it(pair):
    wrapped = VecNormalize(VecMonitor(pair, info_keywords=("c_d",)))
    first = wrapped.reset()
    rewards = []
    for action in plan(3, 2):
        _, _, done, infos = wrapped.step(action)
        rewards.append(wrapped.get_original_reward())
    assert np.isfinite(first).all() and done.all()
    for b, info in enumerate(infos):
        assert info["episode"]["l"] == 3 and info["episode"]["c_d"] == info["c_d"]
        assert info["episode"]["r"] == pytest.approx(sum(reward[b] for reward in rewards), abs=1e-5)
        terminal = wrapped.unnormalize_obs(info["terminal_observation"])
        assert terminal.shape == (151,) and np.isfinite(terminal).all()
    wrapped.seed(4)
    assert pair._seeds == [4, 5]


def test_sb3s_evaluation_counts_its_episodes(pair, one_thread):
    model = PPO("MlpPolicy", pair, device="cpu", n_steps=3, batch_size=6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rewards, lengths = evaluate_policy(model, VecMonitor(pair), n_eval_episodes=4, return_episode_rewards=True)
    assert lengths == [3] * 4 and np.isfinite(rewards).all()


# ---- the example


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_the_example_trains_saves_and_says_what_its_policy_saves(algorithm, one_thread, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(train_sb3, "FlowVecEnv", functools.partial(FlowVecEnv, **SHORT))
    train_sb3.main(algorithm, total=96, seed=3, folder=tmp_path)
    said = re.search(r"saved (\S+); without noise the policy saves (-?[\d.]+)% of the drag", capsys.readouterr().out)
    assert abs(float(said[2])) < 5.0  # in six solver steps the jets do little
    model = {"ppo": PPO, "sac": SAC}[algorithm].load(said[1], device="cpu")
    wrapped = VecNormalize.load(said[1].replace(".zip", ".pkl"), FlowVecEnv(1, **SHORT))
    assert model.num_timesteps == 96 and wrapped.obs_rms.count == pytest.approx(96 + 16, abs=1)


def test_a_policy_that_does_nothing_saves_no_drag(pair, one_thread):
    model = PPO("MlpPolicy", VecNormalize(pair), device="cpu", n_steps=3, batch_size=6)
    for part in model.policy.action_net.parameters():
        torch.nn.init.zeros_(part)
    assert train_sb3.drag_saved(model, **SHORT) == 0.0
    torch.nn.init.constant_(model.policy.action_net.bias, 0.5)
    assert train_sb3.drag_saved(model, **SHORT) != 0.0
