"""The environment: Gymnasium's and SB3's contracts, control laws, rewards, and flows that blow up."""

import dataclasses
import math
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3.common.env_checker import check_env as check_env_of_sb3

from manywake.case.case import readings
from manywake.case.laws import Exponential, Held, Linear
from manywake.case.task import PAIR, balanced, pairs, twice_the_worst
from manywake.env.control import OBSERVATION_LIMIT, ControlledFlows
from manywake.env.env import FlowEnv, FlowVectorEnv
from manywake.flow.batch import FlowBatch, Start
from manywake.suite import load
from manywake.suite.cylinder_jets import CASE, PROBES, PROTOCOLS, REWARDS, TASK

ID = "manywake/CylinderJets-v0"

SHORT = {"interval": 0.002, "actions": 3}
"""Two solver steps an action, three actions an episode."""
READINGS = ("c_d", "c_l", "c_m", "c_d.cylinder", "c_l.cylinder", "c_m.cylinder", "power")
LAWS = {"exponential": Exponential(0.1, per=5e-4), "linear": Linear(), "held": Held()}


def actions(steps, flows, seed=0, each=1):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, flows, each)).astype(np.float32)


def spoilt(start, value):
    """Return a start state whose flow cannot go on."""
    return dataclasses.replace(start, u=np.full_like(start.u, value))


def vector(flows, mode=AutoresetMode.NEXT_STEP, **settings):
    return FlowVectorEnv(flows, autoreset_mode=mode, **(SHORT | settings))


# ---- Gymnasium's contract


@pytest.fixture
def made():
    env = gymnasium.make(ID, **SHORT)
    yield env
    env.close()


def test_gymnasiums_checker_is_content(made):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(made.unwrapped)


IDS = sorted(spec.id for spec in gymnasium.registry.values() if spec.namespace == "manywake" and spec.name != "Flow")


@pytest.mark.parametrize("name", IDS)
def test_every_id_passes_the_checkers_and_has_the_same_bits_alone_and_in_a_batch(name):
    task = {"interval": 2 * load.load(gymnasium.spec(name).kwargs["case"]).case.dt, "actions": 3}
    env = gymnasium.make(name, **task).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)
        check_env_of_sb3(env)
    batch = gymnasium.make_vec(name, 3, "vector_entry_point", **task)
    plan = np.random.default_rng(1).uniform(-1, 1, (2, 3, *env.action_space.shape)).astype(np.float32)
    batch.reset(seed=4)
    seen = [batch.step(action)[0][2] for action in plan]
    env.reset(seed=6)
    for action, theirs in zip(plan[:, 2], seen, strict=True):
        np.testing.assert_array_equal(env.step(action)[0], theirs)


def test_spaces_are_151_pressures_and_one_action(made):
    assert made.observation_space.shape == (151,)
    assert made.observation_space.dtype == np.float32
    assert made.action_space == gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    velocity = gymnasium.make(ID, observe=("velocity",), **SHORT)
    observation, _ = velocity.reset(seed=0)
    assert velocity.observation_space.contains(observation)
    assert observation.shape == (302,)


def test_make_vec_gives_the_true_batch():
    batch = gymnasium.make_vec(ID, num_envs=3, vectorization_mode="vector_entry_point", **SHORT)
    assert isinstance(batch.unwrapped, FlowVectorEnv)
    assert batch.num_envs == 3
    observation, info = batch.reset(seed=0)
    assert observation.shape == (3, 151)
    assert batch.observation_space.contains(observation)
    step = batch.step(actions(1, 3)[0])
    assert [part.shape for part in step[:4]] == [(3, 151), (3,), (3,), (3,)]
    assert info.keys() == step[4].keys()
    batch.close()


def test_info_has_every_reading_of_the_last_action(made):
    _, info = made.reset(seed=0)
    assert set(info) == {"amplitudes", "reynolds", "time", "diverged"}  # no action yet, no mean of C_D and C_L over it
    assert "drag positive downstream, lift positive up" in made.metadata["coefficients"]
    _, _, _, _, info = made.step(np.zeros(1, np.float32))
    assert set(info) == {*READINGS, "amplitudes", "reynolds", "time", "diverged"}
    assert READINGS == readings(CASE)
    assert info["c_d"] == pytest.approx(3.17, abs=0.02)
    assert abs(info["c_l"]) < 0.05
    assert (info["c_d.cylinder"], info["c_l.cylinder"]) == (info["c_d"], info["c_l"])
    assert info["power"] == 0.0
    _, _, _, _, info = made.step(np.array([0.5], np.float32))
    assert info["amplitudes"].shape == (2,)
    assert info["amplitudes"].sum() == 0.0
    assert info["amplitudes"][0] > 0
    assert info["time"] == pytest.approx(0.004)
    assert not info["diverged"]


def test_truncated_at_the_horizon_and_only_there(made):
    for _ in range(2):
        made.reset(seed=0)
        ends = [made.step(np.zeros(1, np.float32))[2:4] for _ in range(3)]
        assert ends == [(False, False), (False, False), (False, True)]


def test_every_episode_starts_from_the_same_state(made):
    first, _ = made.reset(seed=0)
    made.step(np.ones(1, np.float32))
    again, info = made.reset(seed=1)
    np.testing.assert_array_equal(again, first)
    assert not info["amplitudes"].any()


def test_settings_are_those_named_in_the_call():
    paper = PROTOCOLS["paper"][0]
    env = FlowEnv(task=paper, **SHORT)
    assert env.task == dataclasses.replace(paper, **SHORT)
    assert FlowEnv(task="paper").task.actions == 80
    assert FlowEnv(task="paper").task.steps(5e-4) == 50
    assert FlowEnv(**{"points.pressure": ((0.3, 0.0),)}).observation_space.shape == (1,)


# ---- a column of the batch is a single environment


@pytest.mark.parametrize("flows", [3, 9])
def test_a_column_has_the_bits_of_the_single_environment(flows):
    plan = actions(3, flows)
    batch = vector(flows)
    single = FlowEnv(**SHORT)
    columns = {0, flows // 2, flows - 1}
    results = [batch.reset(seed=0)[0]], [batch.step(action) for action in plan]
    for column in columns:
        observation, _ = single.reset(seed=0)
        np.testing.assert_array_equal(results[0][0][column], observation)
        for action, whole in zip(plan, results[1], strict=True):
            ours = single.step(action[column])
            np.testing.assert_array_equal(whole[0][column], ours[0])
            assert [part[column] for part in whole[1:4]] == list(ours[1:4])
            for key, value in ours[4].items():
                np.testing.assert_array_equal(whole[4][key][column], value)


# ---- autoreset, against Gymnasium's own vector environment


def assert_same_step(ours, twin, mode):
    for a, b in zip(ours[:4], twin[:4], strict=True):
        np.testing.assert_array_equal(a, b)
    for key in (*READINGS, "amplitudes", "time", "diverged"):
        if key not in twin[4]:  # Gymnasium leaves out what no environment tells
            assert not ours[4][f"_{key}"].any()
            continue
        np.testing.assert_array_equal(ours[4][key], twin[4][key])
        np.testing.assert_array_equal(ours[4][f"_{key}"], twin[4][f"_{key}"])
    assert ("final_obs" in ours[4]) == ("final_obs" in twin[4])
    if "final_obs" not in twin[4]:
        return
    assert mode == AutoresetMode.SAME_STEP
    ended = twin[4]["_final_obs"]
    np.testing.assert_array_equal(ours[4]["_final_obs"], ended)
    np.testing.assert_array_equal(ours[4]["_final_info"], twin[4]["_final_info"])
    for column in range(len(ended)):
        if ended[column]:
            np.testing.assert_array_equal(ours[4]["final_obs"][column], twin[4]["final_obs"][column])
        else:
            assert ours[4]["final_obs"][column] is None
    for key in (*READINGS, "amplitudes", "time", "diverged"):
        mine, theirs = ours[4]["final_info"], twin[4]["final_info"]
        np.testing.assert_array_equal(mine[key][ended], theirs[key][ended])
        np.testing.assert_array_equal(mine[f"_{key}"], theirs[f"_{key}"])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_autoreset_is_gymnasiums(mode):
    plan = actions(8, 2)
    batch = vector(2, mode)
    twin = SyncVectorEnv([lambda: FlowEnv(**SHORT)] * 2, autoreset_mode=mode)
    assert batch.metadata["autoreset_mode"] == mode
    np.testing.assert_array_equal(batch.reset(seed=0)[0], twin.reset(seed=0)[0])
    for action in plan:
        assert_same_step(batch.step(action), twin.step(action), mode)
    twin.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_autoreset_is_gymnasiums_when_flows_end_at_different_times(mode):
    plan = actions(6, 3)
    batch = vector(3, mode)
    twin = SyncVectorEnv([lambda: FlowEnv(**SHORT)] * 3, autoreset_mode=mode)
    batch.reset(seed=0)
    twin.reset(seed=0)
    start = spoilt(batch._flows._parts[0].batch.state(0), 1e4)
    for k, action in enumerate(plan):
        if k == 1:
            batch._flows._parts[0].reset([1], [1], start)
            twin.envs[1].unwrapped._batch._flows._parts[0].reset([0], [0], start)
        assert_same_step(batch.step(action), twin.step(action), mode)
    twin.close()


def test_next_step_spends_a_step_on_the_reset():
    batch = vector(2)
    first, _ = batch.reset(seed=0)
    for action in actions(3, 2):
        observation, _, _, truncated, _ = batch.step(action)
    assert truncated.all()
    assert not np.array_equal(observation, first)
    observation, reward, terminated, truncated, info = batch.step(actions(1, 2)[0])
    np.testing.assert_array_equal(observation, first)
    assert not reward.any() and not terminated.any() and not truncated.any()
    assert not info["time"].any() and not info["amplitudes"].any()


def test_same_step_gives_the_final_observation_beside_the_new_one():
    batch, plain = vector(2, AutoresetMode.SAME_STEP), vector(2, AutoresetMode.DISABLED)
    first, _ = batch.reset(seed=0)
    plain.reset(seed=0)
    for action in actions(3, 2):
        ours, twin = batch.step(action), plain.step(action)
    assert ours[3].all()
    np.testing.assert_array_equal(ours[0], first)
    np.testing.assert_array_equal(ours[1], twin[1])
    np.testing.assert_array_equal(np.stack(ours[4]["final_obs"]), twin[0])
    np.testing.assert_array_equal(ours[4]["final_info"]["c_d"], twin[4]["c_d"])


def test_a_single_flow_wants_a_reset_before_its_first_action_past_its_end_and_once_closed():
    environment = FlowEnv(actions=2)
    still = np.zeros(environment.action_space.shape)
    wanted = pytest.raises(ValueError, match="while no episode is under way, wanted reset")
    with wanted:
        environment.step(still)
    environment.reset(seed=0)
    assert [environment.step(still)[3] for _ in range(2)] == [False, True]
    with wanted:
        environment.step(still)
    environment.reset(seed=0)
    environment.close()
    with wanted:
        environment.step(still)


def test_seeds_may_be_an_array():
    flows = FlowVectorEnv(2, actions=2)
    np.testing.assert_array_equal(flows.reset(seed=np.array([4, 9]))[0], flows.reset(seed=[4, 9])[0])
    with pytest.raises(ValueError, match="seed: got 1, wanted one for each of the 2 flows, or one for all"):
        flows.reset(seed=np.array([4]))


def test_disabled_wants_a_reset_of_those_that_ended():
    batch = vector(3, AutoresetMode.DISABLED)
    first, _ = batch.reset(seed=0)
    plan = actions(5, 3)
    batch.step(plan[0])
    batch.reset(options={"reset_mask": np.array([False, True, True])})
    ends = [batch.step(action)[3].tolist() for action in plan[1:3]]
    assert ends == [[False] * 3, [True, False, False]]
    with pytest.raises(ValueError, match="step: flow 0 has ended; .*reset_mask"):
        batch.step(plan[3])
    observation, info = batch.reset(options={"reset_mask": np.array([True, False, False])})
    np.testing.assert_array_equal(observation[0], first[0])
    assert not np.array_equal(observation[1], first[1])
    np.testing.assert_allclose(info["time"], [0.0, 0.004, 0.004])
    assert batch.step(plan[4])[3].tolist() == [False, True, True]


# ---- Stable-Baselines3


def test_sb3_gets_terminal_observation_and_time_limit():
    from stable_baselines3.common.vec_env import DummyVecEnv

    twin = vector(1, AutoresetMode.DISABLED)
    twin.reset(seed=0)
    wrapped = DummyVecEnv([lambda: gymnasium.make(ID, **SHORT)] * 2)
    first = wrapped.reset()
    for k, action in enumerate(actions(3, 1)):
        observation, _, done, infos = wrapped.step(np.repeat(action, 2, axis=0))
        last = twin.step(action)[0][0]
        assert done.tolist() == [k == 2] * 2
        assert [info["TimeLimit.truncated"] for info in infos] == [k == 2] * 2
        assert ("terminal_observation" in infos[0]) == (k == 2)
    np.testing.assert_array_equal(infos[1]["terminal_observation"], last)
    np.testing.assert_array_equal(observation, first)
    wrapped.close()


def test_sb3_sees_a_flow_that_blew_up_as_an_end_and_not_as_a_time_limit():
    from stable_baselines3.common.vec_env import DummyVecEnv

    wrapped = DummyVecEnv([lambda: FlowEnv(**SHORT)] * 2)
    wrapped.reset()
    flows = wrapped.envs[0]._batch._flows._parts[0]
    flows.reset([0], [0], spoilt(flows.batch.state(0), np.nan))
    _, _, done, infos = wrapped.step(np.zeros((2, 1), np.float32))
    assert done.tolist() == [True, False]
    assert infos[0]["TimeLimit.truncated"] is False
    assert np.isfinite(infos[0]["terminal_observation"]).all()


# ---- flows that blow up


def charged(flows):
    """Return the default's charge by hand: twice what the worst of the forced flows loses."""
    tried, free = flows.flow.baseline.withstood, flows.free
    c_d, c_l = (tried.samples[:, tried.names.index(name)].astype(float) for name in ("c_d", "c_l"))
    nothing = -0.5 * abs(free["c_l"])
    loss = nothing - (free["c_d"] - c_d - 0.5 * abs(c_l)).min()
    assert loss > 3.0  # square waves lose more than all drag
    return nothing - 2 * loss


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e4, 1e200])
def test_a_flow_that_blows_up_ends_alone_finite_and_at_a_price(value):
    plan = actions(3, 5)
    batch, twin = vector(5, AutoresetMode.DISABLED), vector(5, AutoresetMode.DISABLED)
    batch.reset(seed=0)
    twin.reset(seed=0)
    batch._flows._parts[0].reset([3], [3], spoilt(batch._flows._parts[0].batch.state(0), value))
    ours, good = batch.step(plan[0]), twin.step(plan[0])
    assert ours[2].tolist() == [False, False, False, True, False]
    assert not ours[3].any()
    assert ours[4]["diverged"].tolist() == ours[2].tolist()
    assert batch.observation_space.contains(ours[0])
    assert all(np.isfinite(ours[4][key]).all() for key in ("amplitudes", "time"))
    assert all(np.isnan(ours[4][key]).tolist() == ours[2].tolist() for key in READINGS)
    # worse than three more actions of anything a flow does
    assert ours[1][3] == pytest.approx(3 * charged(batch._flows._parts[0]))
    others = [0, 1, 2, 4]
    for a, b in zip(ours[:2], good[:2], strict=True):
        np.testing.assert_array_equal(a[others], b[others])
    batch.reset(options={"reset_mask": np.arange(5) == 3})
    for action in plan[1:]:
        ours, good = batch.step(action), twin.step(action)
        np.testing.assert_array_equal(ours[0][others], good[0][others])
        np.testing.assert_array_equal(ours[1][others], good[1][others])


@pytest.mark.parametrize("reward", REWARDS)
def test_blowing_up_never_pays(reward, shipped, base):
    task = dataclasses.replace(TASK, reward=REWARDS[reward], interval=0.001, actions=4)
    flows = ControlledFlows(shipped, task, 2)
    flows.reset([1], [1], spoilt(base.start, np.nan))
    outcome = flows.act(np.zeros((2, 1)))
    assert outcome.diverged.tolist() == [False, True]
    assert outcome.reward[1] < 4 * outcome.reward[0]
    worst = REWARDS[reward]({"c_d": 4.0, "c_l": 1.2}, base.free)
    assert outcome.reward[1] < 4 * worst


def test_a_flow_that_blows_up_at_the_horizon_is_terminated_not_truncated():
    env = FlowEnv(**SHORT)
    env.reset(seed=0)
    for _ in range(2):
        env.step(np.zeros(1, np.float32))
    flows = env._batch._flows._parts[0]
    flows.batch.reset([0], spoilt(flows.batch.state(0), np.nan))
    _, reward, terminated, truncated, info = env.step(np.zeros(1, np.float32))
    assert (terminated, truncated, info["diverged"]) == (True, False, True)
    assert reward == pytest.approx(charged(flows))


# ---- the door


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_an_action_that_is_not_finite_is_refused(bad):
    env = FlowEnv(**SHORT)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=rf"action: got {bad}, wanted finite numbers in \[-1, 1\]"):
        env.step(np.array([bad], np.float32))
    batch = vector(2)
    batch.reset(seed=0)
    with pytest.raises(ValueError, match=f"action: got {bad}, wanted finite"):
        batch.step(np.array([[0.0], [bad]]))


@pytest.mark.parametrize("shape", [(), (2,), (1, 1)])
def test_an_action_of_the_wrong_shape_is_refused(shape):
    env = FlowEnv(**SHORT)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"action: got shape \(.*\), wanted \(1,\)"):
        env.step(np.zeros(shape, np.float32))


@pytest.mark.parametrize("shape", [(3,), (2, 1), (1, 3), (3, 2)])
def test_actions_of_the_wrong_shape_are_refused(shape):
    batch = vector(3)
    batch.reset(seed=0)
    with pytest.raises(ValueError, match=r"action: got shape \(.*\), wanted \(3, 1\)"):
        batch.step(np.zeros(shape))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"case": "sphere"}, "case: got 'sphere', wanted one of channel, cylinder-jets"),
        ({"task": "easy"}, "protocol: got 'easy', wanted one of default, paper, code"),
        ({"reward": "money"}, "reward: got 'money', wanted one of reduction, paper"),
        ({"law": "pid"}, "law: got 'pid', wanted one of linear, held, exponential"),
        ({"observe": ("vorticity",)}, "observe: got 'vorticity', wanted some of pressure, velocity"),
        ({"law.alpha": 0.0}, r"alpha: got 0, wanted a value in \(0, 1\]"),
        ({"law.alpha": math.nan}, "alpha: got nan, wanted"),
        ({"actions": 1}, "actions: got 1, wanted at least 2"),
        ({"limit": 1.0}, "Jet: got the limit 1, wanted"),
        ({"points.pressure": ((0.0, 0.0),)}, "point 0 is .* inside 'cylinder'; wanted"),
        ({"time_step": 2e-3}, "time_step: got 0.002, wanted"),
        ({"interval": 0.0252}, "interval: got 0.0252, wanted a multiple of the time step 0.001; the nearest is 0.025"),
        ({"interval": 0.0}, "interval: got 0, wanted a positive time"),
        ({"interval": -0.025}, "interval: got -0.025, wanted a positive time"),
        ({"interval": math.nan}, "interval: got nan, wanted a positive time"),
        ({"interval": math.inf}, "interval: got inf, wanted a multiple"),
    ],
)
@pytest.mark.parametrize("make", [FlowEnv, FlowVectorEnv])
def test_bad_settings_are_refused(make, settings, message):
    with pytest.raises(ValueError, match=message):
        make(**settings)


@pytest.mark.parametrize("make", [FlowEnv, FlowVectorEnv])
def test_a_keyword_that_is_no_setting_is_a_type_error_as_of_any_python_function(make):
    with pytest.raises(TypeError, match=r"got an unexpected keyword argument 'smoothing', wanted one of .*law\.alpha"):
        make(smoothing=0.1)


def test_a_step_before_the_first_reset_or_after_the_end_is_refused():
    batch = vector(2)
    with pytest.raises(ValueError, match=r"step: got actions before the first reset\(\)"):
        batch.step(np.zeros((2, 1)))
    batch.reset(seed=0)
    batch.close()
    with pytest.raises(ValueError, match=r"step: got actions after close\(\)"):
        batch.step(np.zeros((2, 1)))


def test_max_episode_steps_is_the_length_of_an_episode():
    batch = gymnasium.make_vec("manywake/CylinderJets-v0", num_envs=2, max_episode_steps=3)
    assert batch.unwrapped.task.actions == 3
    single = gymnasium.make("manywake/CylinderJets-v0", max_episode_steps=3)
    single.reset(seed=0)
    assert [single.step(np.zeros(1))[3] for _ in range(3)] == [False, False, True]


def test_a_reset_mask_of_the_wrong_length_is_refused():
    batch = vector(3, AutoresetMode.DISABLED)
    batch.reset(seed=0)
    with pytest.raises(ValueError, match="reset_mask"):
        batch.reset(options={"reset_mask": np.array([True, False])})


# ---- control laws


def series(law, action, before=0.0, previous=0.0, time_step=5e-4, interval=0.025):
    steps = dataclasses.replace(TASK, interval=interval).steps(time_step)
    amplitude, last, wanted = (np.array([[value]]) for value in (before, previous, action))
    found = LAWS[law].series(steps, time_step, amplitude, last, wanted)
    assert found.shape == (steps, 1, 1)
    return found[:, 0, 0]


def test_exponential_reaches_1_minus_09_to_the_50_of_the_action():
    c = series("exponential", 0.01)
    assert len(c) == 50
    np.testing.assert_allclose(c, 0.01 * (1 - 0.9 ** np.arange(1, 51)), rtol=1e-12)
    c = series("exponential", 0.01, before=-0.004)
    np.testing.assert_allclose(c, 0.01 - 0.014 * 0.9 ** np.arange(1, 51), rtol=1e-12)


def test_exponential_is_the_paper_s_update_bit_for_bit_at_its_step():
    c, twin = 0.0, []
    for _ in range(50):
        c = c + 0.1 * (0.01 - c)
        twin.append(c)
    np.testing.assert_array_equal(series("exponential", 0.01), twin)


def test_exponential_is_the_same_law_in_time_for_half_the_step():
    coarse, fine = (series("exponential", 0.01, before=-0.003, time_step=dt) for dt in (5e-4, 2.5e-4))
    assert len(fine) == 2 * len(coarse)
    np.testing.assert_allclose(fine[1::2], coarse, atol=1e-13)


def test_linear_goes_evenly_from_the_previous_action():
    c = series("linear", 0.01, before=0.1, previous=-0.002)
    np.testing.assert_allclose(np.diff(c), 0.012 / 50, rtol=1e-10)
    assert c[0] == pytest.approx(-0.002 + 0.012 / 50)


@pytest.mark.parametrize("previous", [0.0, -0.01, 0.01, 0.003, -0.0071, 0.0001])
@pytest.mark.parametrize("action", [0.01, -0.01, 0.0, 0.0037, -0.0002])
def test_linear_reaches_the_action_exactly(previous, action):
    assert series("linear", action, previous=previous)[-1] == action


def test_held_is_there_at_once():
    np.testing.assert_array_equal(series("held", 0.01, before=-0.01, previous=-0.01), np.full(50, 0.01))


@pytest.mark.parametrize("law", LAWS)
def test_a_law_treats_every_input_of_every_flow_by_itself(law):
    rng = np.random.default_rng(0)
    amplitude, previous, wanted = rng.uniform(-1, 1, (3, 2, 3))
    found = LAWS[law].series(7, 1e-3, amplitude, previous, wanted)
    assert found.shape == (7, 2, 3)
    for i, b in np.ndindex(2, 3):
        alone = [part[i : i + 1, b : b + 1] for part in (amplitude, previous, wanted)]
        np.testing.assert_array_equal(found[:, i, b], LAWS[law].series(7, 1e-3, *alone)[:, 0, 0])


@pytest.mark.parametrize("law", LAWS)
def test_the_environment_s_jets_follow_the_law(law, ops):
    env = FlowEnv(law=law, **SHORT)
    assert env.task.law == LAWS[law]
    env.reset(seed=0)
    before = previous = 0.0
    for a in (1.0, -0.5, 7.0):
        info = env.step(np.array([a], np.float32))[4]
        wanted = 0.01 * min(a, 1.0)
        before = series(law, wanted, before, previous, ops.time_step, interval=0.002)[-1]
        previous = wanted
        np.testing.assert_array_equal(info["amplitudes"], [before, -before])


def test_jets_of_one_paper_action_reach_99_5_percent():
    env = FlowEnv()
    env.reset(seed=0)
    info = env.step(np.ones(1, np.float32))[4]
    np.testing.assert_allclose(info["amplitudes"], 0.01 * (1 - 0.9**50) * np.array([1, -1]), rtol=1e-12)
    assert info["time"] == pytest.approx(0.025)


# ---- several actions


def test_two_actions_are_mixed_to_amplitudes_within_the_limits():
    rows = np.array([[1.0, 0.5], [-1.0, 0.5]])
    settings = SHORT | {"actions": 5, "limit.cylinder.bottom": 0.004}
    env = FlowEnv(mixing=tuple(map(tuple, rows)), law=Held(), **settings)
    assert env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
    env.reset(seed=0)
    limits = np.array([0.01, 0.004])
    for action in ((1.0, 1.0), (-1.0, 1.0), (0.5, -0.25), (0.0, 7.0)):
        info = env.step(np.array(action, np.float32))[4]
        np.testing.assert_allclose(info["amplitudes"], limits * (rows @ np.clip(action, -1, 1)) / 1.5, rtol=1e-12)
        assert (abs(info["amplitudes"]) <= limits * (1 + 1e-12)).all()
    with pytest.raises(ValueError, match=r"action: got shape \(1,\), wanted \(2,\)"):
        env.step(np.zeros(1, np.float32))


def test_without_a_mixing_every_input_has_an_action_of_its_own():
    env = FlowEnv(mixing=None, law=Held(), **SHORT)
    env.reset(seed=0)
    info = env.step(np.array([0.5, 0.25], np.float32))[4]
    np.testing.assert_array_equal(info["amplitudes"], [0.005, 0.0025])


def test_one_pair_is_the_pair_bit_for_bit():
    assert pairs(1) == PAIR
    plan, ours, twin = actions(3, 2), vector(2, mixing=pairs(1)), vector(2)
    ours.reset(seed=0)
    twin.reset(seed=0)
    for action in plan:
        for a, b in zip(ours.step(action)[:4], twin.step(action)[:4], strict=True):
            np.testing.assert_array_equal(a, b)


def test_balanced_actions_have_no_net_flux_and_follow_their_differences():
    np.testing.assert_array_equal(np.array(balanced(2)), [[0.5, -0.5], [-0.5, 0.5]])
    batch = vector(3, mixing=balanced(2), law=Held())
    batch.reset(seed=0)
    for action in actions(3, 3, each=2):
        amplitudes = batch.step(action)[4]["amplitudes"]
        np.testing.assert_array_equal(amplitudes.sum(axis=1), 0.0)
        wanted = 0.01 * 0.5 * (action[:, 0].astype(float) - action[:, 1])
        np.testing.assert_allclose(amplitudes[:, 0], wanted, rtol=1e-12)
    assert abs(np.array(balanced(3)).sum(axis=0)).max() < 1e-15


# ---- rewards and observations


def test_rewards_are_those_computed_by_hand():
    by_hand = {
        "paper": -3.5,  # -3.0 - 0.5
        "paper-offset": -0.3,  # 3.2 - 3.0 - 0.5
        "code": 0.004,  # 0.159 - 0.150 - 0.2 * 0.025
        "drag": -3.0,
        "drag-offset": 0.2,
        "reduction": -0.05,  # 3.2 - 3.0 - 0.5 * 0.5
    }
    assert set(by_hand) == set(REWARDS)
    for name, wanted in by_hand.items():
        for c_l in (0.5, -0.5):
            got = REWARDS[name]({"c_d": 3.0, "c_l": c_l}, {"c_d": 3.2, "c_l": 0.0})
            np.testing.assert_allclose(got, wanted, rtol=1e-12, err_msg=name)


@pytest.mark.parametrize("name", REWARDS)
def test_the_environment_pays_the_named_reward_of_its_mean_coefficients(name, ops, base):
    env = FlowEnv(reward=name, **SHORT)
    env.reset(seed=0)
    _, reward, _, _, info = env.step(np.ones(1, np.float32))
    jets = series("exponential", 0.01, time_step=ops.time_step, interval=0.002)
    read = FlowBatch(ops, base.start, 1).advance(np.stack([jets, -jets], axis=1)[:, :, None])
    c_d, c_l = read.mean(axis=0)[:2, 0]
    assert (info["c_d"], info["c_l"]) == pytest.approx((c_d, c_l), rel=1e-12)
    assert reward == REWARDS[name](info, base.free)
    assert base.free["c_d"] == base.statistics["c_d"].mean


def reference_probes():
    """The order of the released code's observation: two grids, then two rings."""
    points = []
    for x in [0.075, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45]:
        for y in [-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15]:
            points.append((x, y))
    for x in [-0.025, 0.0, 0.025, 0.05]:
        for y in [-0.15, -0.1, 0.1, 0.15]:
            points.append((x, y))
    for r in [0.07, 0.10]:
        for angle in range(0, 360, 10):
            points.append((r * math.cos(math.radians(angle)), r * math.sin(math.radians(angle))))
    return points


def test_observation_is_the_pressure_at_the_reference_s_probes_in_its_order(ops):
    points = reference_probes()
    assert len(points) == 151
    np.testing.assert_allclose(PROBES, points, atol=1e-10)
    assert {sensor.name: sensor.points for sensor in CASE.sensors} == {"pressure": PROBES, "velocity": PROBES}
    env = FlowEnv(**SHORT)
    env.reset(seed=0)
    observation = env.step(np.ones(1, np.float32))[0]
    p = env._batch._flows._parts[0].batch.state(0).p
    wanted = ops.space.pressure.probes(np.array(points).T) @ p
    np.testing.assert_allclose(observation, wanted, atol=1e-6)
    assert observation.dtype == np.float32


def test_observation_of_velocity_is_u_then_v_of_each_probe(ops, base):
    env = FlowEnv(observe=("velocity",), **{"points.velocity": ((0.1, 0.0), (0.2, 0.05))}, **SHORT)
    observation, _ = env.reset(seed=0)
    probes = ops.space.velocity.probes(np.array([(0.1, 0.0), (0.2, 0.05)]).T)
    np.testing.assert_allclose(observation, (probes @ base.start.u).ravel(), atol=1e-6)
    assert set(ops.sensors) == {"pressure", "velocity"}


def test_observation_stays_in_its_space_when_the_pressure_does_not(shipped, base):
    flows = ControlledFlows(shipped, TASK, 2)
    flows.reset([0], [0], Start(base.start.u, base.start.u_old, 1e6 * base.start.p, base.start.phi, base.start.phi_old))
    observation = flows.observe()
    assert abs(observation[0]).max() == OBSERVATION_LIMIT
    assert abs(observation[1]).max() < 10


def test_tasks_by_name_are_the_papers_and_the_codes():
    protocols = load.load("cylinder-jets").protocols
    tasks = {name: task for name, (task, _) in protocols.items()}
    assert set(tasks) == {"default", "paper", "code"}
    assert (tasks["paper"].law, tasks["paper"].reward) == (Exponential(0.1, per=5e-4), REWARDS["paper"])
    assert (tasks["code"].law, tasks["code"].reward) == (Linear(), REWARDS["code"])
    assert all(tasks[name].actions == 80 for name in ("paper", "code"))


def test_observation_of_readings_and_amplitudes_beside_sensors_in_the_order_asked_for(base):
    batch = vector(2, observe=("pressure", "c_l", "amplitudes"))
    assert batch.single_observation_space.shape == (151 + 1 + 2,)
    observation, _ = batch.reset(seed=0)
    pressure = batch._flows._parts[0].batch.read("pressure")
    np.testing.assert_allclose(observation[:, :151], pressure, atol=1e-6)
    # before any action: the uncontrolled flow's mean, and jets at rest
    np.testing.assert_array_equal(observation[:, 151], np.float32(base.free["c_l"]))
    assert not observation[:, 152:].any()
    observation, _, _, _, info = batch.step(np.array([[1.0], [-0.3]], np.float32))
    np.testing.assert_array_equal(observation[:, 151], info["c_l"].astype(np.float32))
    np.testing.assert_array_equal(observation[:, 152:], (info["amplitudes"] / 0.01).astype(np.float32))
    assert observation[0, 152] > 0 > observation[0, 153]
    turned = vector(2, observe=("amplitudes", "power"))
    assert turned.single_observation_space.shape == (3,)
    turned.reset(seed=0)
    observation, _, _, _, info = turned.step(np.array([[1.0], [-0.3]], np.float32))
    np.testing.assert_array_equal(observation[:, :2], (info["amplitudes"] / 0.01).astype(np.float32))
    np.testing.assert_array_equal(observation[:, 2], info["power"].astype(np.float32))


def asked(charge=twice_the_worst):
    """Return a batch of three flows, the second of which cannot go on, and what its reward is asked."""
    seen = []

    def reward(now, free):
        seen.append((dict(now), dict(free)))
        return -now["c_d"]

    batch = vector(3, AutoresetMode.DISABLED, reward=reward, charge=charge)
    batch.reset(seed=0)
    batch._flows._parts[0].reset([1], [1], spoilt(batch._flows._parts[0].batch.state(0), np.nan))
    seen.clear()
    return batch, seen


def test_a_reward_is_asked_once_for_each_flow_about_python_floats(base):
    batch, seen = asked(charge=lambda reward, forced, free: -100.0)
    _, rewards, terminated, _, info = batch.step(actions(1, 3)[0])
    assert terminated.tolist() == [False, True, False]
    assert len(seen) == 2  # never for the flow that blew up
    for (now, free), b in zip(seen, (0, 2), strict=True):
        assert set(now) == set(free) == set(READINGS)
        assert {type(value) for value in (*now.values(), *free.values())} == {float}
        assert now == {name: info[name][b] for name in READINGS}
        assert free == base.free
        assert rewards[b] == -now["c_d"]
    assert rewards[1] == -300.0


def test_a_reward_never_sees_what_a_flow_that_blew_up_reads():
    batch, seen = asked()
    batch.step(actions(1, 3)[0])
    assert len(seen) == 2
    assert all(math.isfinite(value) for now, _ in seen for value in now.values())
