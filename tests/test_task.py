"""The task completed: history, delay, errors of sensors, Reynolds numbers that seeds draw, snapshots; to the bit."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from manywake.case import Pressure, Velocity, replace
from manywake.env.control import ControlledFlows
from manywake.env.env import FlowEnv, FlowVectorEnv
from manywake.env.errors import Errors
from manywake.learn import train
from manywake.learn.blocks import Layout
from manywake.learn.engine import Processes, Threads
from manywake.learn.flows import open_flows
from manywake.learn.rollout import context
from manywake.learn.runs import Run
from manywake.learn.settings import Collection, Settings
from manywake.suite import load
from manywake.suite.cylinder_jets import CASE, TASK

from .conftest import pretended

POINTS = ((0.1, 0.0), (0.2, 0.05))
FEW = replace(CASE, sensors=(Pressure("pressure", POINTS, noise=0.02), Velocity("velocity", POINTS)))
NUMBERS = (90.0, 100.0)
SHORT = replace(TASK, interval=0.002, actions=4, observe=("pressure", "velocity", "c_l"))
WHOLE = replace(SHORT, history=3, delay=2, starts="any", reynolds_numbers=NUMBERS)
"""All of it at once."""


@pytest.fixture(scope="module", autouse=True)
def flows(base, tmp_path_factory):
    """Put a baseline where those of other Reynolds numbers are looked for."""
    with pretended(tmp_path_factory.mktemp("cache"), base, replace(CASE, reynolds=90.0)):
        yield


def plan(steps, flows, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (steps, flows, 1)).astype(np.float32)


def played(env, actions, seed=0):
    """Return the observations of an episode, that of the reset first."""
    return np.stack([env.reset(seed=seed)[0], *(env.step(action)[0] for action in actions)])


# ---- history


def test_history_holds_the_last_observations_the_oldest_first():
    actions = plan(4, 1)[:, 0]
    one, three = (played(FlowEnv(FEW, replace(SHORT, history=k)), actions) for k in (1, 3))
    assert three.shape == (5, 3 * one.shape[1])
    padded = np.concatenate([one[:1], one[:1], one])
    for t, seen in enumerate(three):
        np.testing.assert_array_equal(seen, padded[t : t + 3].ravel())


# ---- delay


def test_a_delayed_action_acts_so_many_actions_later_and_nothing_before():
    actions = plan(4, 1)[:, 0]
    late = FlowEnv(FEW, replace(SHORT, delay=2))
    prompt = FlowEnv(FEW, SHORT)
    twin = [np.zeros_like(actions[0])] * 2 + list(actions[:2])
    np.testing.assert_array_equal(played(late, actions), played(prompt, twin))
    # and what is on its way at the end of an episode acts in no other
    np.testing.assert_array_equal(played(late, actions), played(prompt, twin))


# ---- errors of sensors


def test_errors_have_the_rms_that_is_asked_for_no_mean_and_no_memory():
    errors = Errors(FEW, 2)
    for column, seed in enumerate((3, 4)):
        errors.reset(column, seed)
    drawn = np.stack([errors.added("pressure", np.zeros((2, 2)), [0, 1]) for _ in range(4000)]).reshape(4000, 4)
    assert drawn.std(axis=0) == pytest.approx(0.02, rel=0.05)
    assert abs(drawn.mean(axis=0)).max() < 4 * 0.02 / np.sqrt(4000)
    assert abs(np.corrcoef(drawn.T) - np.eye(4)).max() < 0.06
    assert abs(np.corrcoef(drawn[1:, 0], drawn[:-1, 0])[0, 1]) < 0.06
    assert abs(drawn).max() < 6 * 0.02


def test_errors_are_added_to_their_sensor_and_to_nothing_else():
    actions, clean = plan(4, 1)[:, 0], replace(FEW, sensors=tuple(replace(s, noise=0.0) for s in FEW.sensors))
    noisy, true = (played(FlowEnv(case, SHORT), actions, seed=5) for case in (FEW, clean))
    assert (noisy[:, :2] != true[:, :2]).all()
    np.testing.assert_array_equal(noisy[:, 2:], true[:, 2:])


def test_errors_are_settings_by_name():
    assert [s.noise for s in load.choose("cylinder-jets", **{"noise.velocity": 0.1}).case.sensors] == [0.0, 0.1]
    with pytest.raises(ValueError, match="sensor 'pressure': got the noise -1, wanted an rms, at least 0"):
        load.choose("cylinder-jets", **{"noise.pressure": -1.0})


# ---- Reynolds numbers


def test_an_episode_s_seed_draws_its_reynolds_number():
    env = FlowEnv(FEW, WHOLE)
    drawn = [env.reset(seed=seed)[1]["reynolds"] for seed in range(24)]
    assert set(drawn) == set(NUMBERS) and min(drawn.count(one) for one in NUMBERS) >= 6
    assert drawn == [env.reset(seed=seed)[1]["reynolds"] for seed in range(24)]


def test_a_reynolds_number_that_is_given_is_that_of_every_episode():
    env = FlowEnv(FEW, WHOLE, reynolds=90.0)
    assert {env.reset(seed=seed)[1]["reynolds"] for seed in range(8)} == {90.0}


def test_a_viscosity_is_felt():
    at = [played(FlowEnv(FEW, SHORT, reynolds=one), plan(4, 1)[:, 0]) for one in NUMBERS]
    assert abs(at[0] - at[1]).max() > 1e-4


def test_an_interval_that_one_of_the_steps_does_not_divide_is_refused():
    case = replace(CASE, time_step=None)
    wanted = replace(SHORT, interval=1.5e-3, reynolds_numbers=(400.0, 100.0))
    with pytest.raises(ValueError, match="interval: got 0.0015, wanted a multiple of the time step 0.001"):
        load.choose(replace(case, reynolds=400), wanted)


# ---- to the bit


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_flow_i_of_a_batch_has_the_episodes_of_a_single_environment_of_its_seed(mode):
    batch = FlowVectorEnv(5, FEW, WHOLE, mode)
    twin = SyncVectorEnv([lambda: FlowEnv(FEW, WHOLE)] * 5, autoreset_mode=mode)
    for given in (11, [3, None, 1, 7, 2]):
        np.testing.assert_array_equal(batch.reset(seed=given)[0], twin.reset(seed=given)[0])
        for action in plan(9, 5):
            for ours, theirs in zip(batch.step(action)[:4], twin.step(action)[:4], strict=True):
                np.testing.assert_array_equal(ours, theirs)
    twin.close()


def test_a_flow_goes_on_from_a_snapshot_in_another_batch_and_column(shipped):
    case = replace(FEW, reynolds=100.0)
    chosen = load.choose(case, replace(WHOLE, reynolds_numbers=(), actions=12))
    flow = open_flows(chosen).flows[0]
    actions = plan(8, 3)
    batch, other = ControlledFlows(flow, chosen.task, 3), ControlledFlows(flow, chosen.task, 2)
    batch.reset(range(3), [5, 6, 7])
    for action in actions[:5]:
        batch.act(action)
    other.restore(0, batch.snapshot(2))
    np.testing.assert_array_equal(other.observe()[0], batch.observe()[2])
    for action in actions[5:]:
        ours, theirs = batch.act(action), other.act(action[[2, 0]])
        assert ours.reward[2] == theirs.reward[0]
        np.testing.assert_array_equal(batch.observe()[2], other.observe()[0])
    assert batch.actions[2] == other.actions[0] == 8


def test_episodes_have_the_same_bits_however_they_are_spread(tmp_path):
    chosen = load.choose(FEW, WHOLE, update_period=6, episodes=12, hidden=(8,), n_epochs=1, batch_size=8)
    found = []
    for k, (engine, grid) in enumerate(((Threads(1), Layout(1, 1, 1)), (Processes(2), Layout(6, 2, 4)))):
        settings = Settings(chosen.learning, Collection(), seed=2)
        result = train.train(tmp_path / str(k), open_flows(chosen), settings, engine, grid)
        engine.close()
        found.append((result.policy_sha256, (tmp_path / str(k) / "operators-90.npz").exists()))
    assert found[0] == found[1] and found[0][1]
    assert Run(tmp_path / "0").version(2).version == 2


def test_a_block_plays_the_flow_that_its_episodes_draw():
    simulation = open_flows(load.choose(FEW, WHOLE))
    seeds = [context(0, index, 4, 1).seed for index in range(12)]
    assert {simulation.variant(seed) for seed in seeds} == {0, 1}
