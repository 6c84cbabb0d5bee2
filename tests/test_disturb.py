"""Chance: the noise that it drives, and that an episode, wherever it is played, is a function of its seed."""

import dataclasses

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from manywake.case import BodyForce, Noise
from manywake.env.control import ControlledFlows
from manywake.env.env import FlowEnv, FlowVectorEnv
from manywake.flow import archive, baseline, spinup, store
from manywake.flow.batch import FlowBatch
from manywake.flow.disturb import WARM_UP, Disturbances
from manywake.flow.store import Flow
from manywake.learn import controllers, evaluate
from manywake.learn.engine import Processes, Threads
from manywake.learn.flows import Flows
from manywake.learn.policy import Policy
from manywake.learn.rollout import context, seed
from manywake.suite import load
from manywake.suite.cylinder_jets import CASE, TASK

from .conftest import pretended

RMS, TIME = 3.0, 0.01
NOISES = (
    Noise(BodyForce("upstream", at=(-0.12, 0.0), radius=0.03, along=(0.0, 1.0)), rms=RMS, time=TIME),
    Noise(BodyForce("above", limit=2.0, at=(0.0, 0.1), radius=0.03), rms=1.5, time=0.03),
)
STILL = controllers.simple("none", (), 1)
NOISY = dataclasses.replace(CASE, disturbances=NOISES)
SHORT = {"interval": 0.002, "actions": 3}


def disturbances(ops, seeds, *noise) -> Disturbances:
    """Return the noise (rms, time, limit) of some seeds, at the time step of the operators."""
    return Disturbances(dataclasses.replace(ops, noise=np.array(noise).reshape(-1, 3)), seeds)


# ---- the noise itself; the time step is 5e-4


def test_noise_has_the_rms_and_the_correlation_that_it_is_given(tiny):
    lags, time = np.array([1, 5, 10, 20, 40]), 10 * tiny.time_step
    series = disturbances(tiny, range(32), (2.5, time, np.inf)).series(20_000)[:, 0]
    # the mean of 32000 independent pieces
    assert abs(series.mean()) < 0.02 * 2.5
    assert np.sqrt(np.mean(series**2)) == pytest.approx(2.5, rel=0.02)
    found = [np.mean(series[lag:] * series[:-lag]) / 2.5**2 for lag in lags]
    np.testing.assert_allclose(found, np.exp(-lags / 10), atol=0.03)
    # and flows have nothing in common
    across = np.corrcoef(series.T) - np.eye(32)
    assert abs(across).max() < 0.12


def test_noise_is_stationary_from_its_first_step_on(tiny):
    first = disturbances(tiny, range(4000), (1.0, 20 * tiny.time_step, np.inf)).series(3)[:, 0]
    np.testing.assert_allclose(np.sqrt(np.mean(first**2, axis=1)), 1.0, rtol=0.05)
    assert np.exp(-2 * WARM_UP) < 1e-6


def test_noise_is_bounded_and_cut_off_at_a_limit(tiny):
    time = 3 * tiny.time_step
    free, cut = (disturbances(tiny, range(8), (1.0, time, most)).series(4000) for most in (np.inf, 1.2))
    keep = np.exp(-1 / 3)
    assert abs(free).max() < np.sqrt(3 * (1 + keep) / (1 - keep))
    assert abs(free).max() > 2.0
    np.testing.assert_array_equal(cut, np.clip(free, -1.2, 1.2))


def test_noise_is_its_slow_twin(tiny):
    rms, time, seeds, steps = (1.5, 0.7), (4.3 * tiny.time_step, 0.2 * tiny.time_step), (5, 2**31), 25
    both = list(zip(rms, time, (np.inf, np.inf), strict=True))
    series = disturbances(tiny, seeds, *both).series(steps)
    for k, each in enumerate(time):
        keep = round(float(np.exp(-tiny.time_step / each)), 12)
        for b, own in enumerate(seeds):
            draw = np.random.Generator(np.random.PCG64(np.random.SeedSequence(own, spawn_key=(1, k)))).random
            n, warm_up = 0.0, int(np.ceil(WARM_UP * each / tiny.time_step))
            for s in range(-warm_up, steps):
                n = keep * n + (3.0 * (1.0 - keep**2)) ** 0.5 * rms[k] * (2.0 * draw() - 1.0)
                if s >= 0:
                    assert series[s, k, b] == n


def test_noise_does_not_depend_on_calls_batch_column_or_neighbours(tiny):
    noise = (1.0, 8 * tiny.time_step, np.inf), (2.0, 3 * tiny.time_step, 1.5)
    whole = disturbances(tiny, [7, 8, 9], *noise).series(20)
    parts = disturbances(tiny, [9, 3, 7, 8, 1], *noise)
    split = np.concatenate([parts.series(steps) for steps in (7, 0, 12, 1)])
    np.testing.assert_array_equal(split[:, :, [2, 3, 0]], whole)
    np.testing.assert_array_equal(disturbances(tiny, [8], *noise).series(20)[:, :, 0], whole[:, :, 1])
    # begun anew while its neighbours go on
    parts.reset([1, 4], [8, 9])
    again = parts.series(20)
    np.testing.assert_array_equal(again[:, :, [1, 4]], whole[:, :, 1:])
    twin = disturbances(tiny, [7], *noise)
    np.testing.assert_array_equal(again[:, :, 2], twin.series(40)[20:, :, 0])
    # and every disturbance of every seed has a stream of its own
    alike = disturbances(tiny, [7, 8], noise[0], noise[0]).series(20).reshape(20, 4)
    assert (abs(np.corrcoef(alike.T) - np.eye(4)) < 0.9).all()


def test_without_disturbances_there_is_none(tiny):
    assert disturbances(tiny, range(3)).series(4).shape == (4, 0, 3)
    assert FlowBatch(tiny, _still(tiny), 2).disturbed(np.ones((4, 2, 2))).shape == (4, 2, 2)


def _still(ops) -> baseline.Start:
    return baseline.Start(*np.zeros((2, len(ops.velocity_order), 2)), *np.zeros((3, len(ops.pressure_order))))


# ---- flows that it disturbs


@pytest.fixture(scope="module")
def noisy(base, tmp_path_factory):
    """The noisy flow, its start state that of the shipped one, put where the environments look for it."""
    with pretended(tmp_path_factory.mktemp("cache"), base, NOISY):
        yield store.flow(NOISY)


def test_inputs_are_the_agent_s_then_chance_s_and_only_the_agent_s_have_power(noisy):
    ops = noisy.operators
    assert ops.inputs == ("cylinder.top", "cylinder.bottom", "upstream", "above")
    assert (ops.actuators, ops.noise.tolist()) == (2, [[RMS, TIME, np.inf], [1.5, 0.03, 2.0]])
    assert [name for name in ops.functionals if "work" in name] == ["work.cylinder.top", "work.cylinder.bottom"]
    flows = ControlledFlows(noisy, TASK, 2)
    quiet = flows.act(np.zeros((2, 1)))
    assert quiet.amplitudes.shape == (25, 2, 2)
    assert not quiet.amplitudes.any() and not quiet.series["power"].any()
    assert flows.observe().shape == (2, 151)


def test_noise_drives_the_flow_as_amplitudes_that_are_given_do(noisy):
    ops, steps = noisy.operators, 12
    chance = Disturbances(ops, [4]).series(steps)
    given = np.concatenate([np.zeros((steps, 2, 1)), chance], axis=1)
    twin = FlowBatch(ops, noisy.baseline.start, 1).advance(given)
    flow = FlowBatch(ops, noisy.baseline.start, 3)
    flow.reset([2], seeds=[4])
    read = [flow.advance(flow.disturbed(np.zeros((some, 2, 3)))) for some in (5, 7)]
    np.testing.assert_array_equal(np.concatenate(read)[:, :, 2], twin[:, :, 0])
    # the uncontrolled flow is that of seed 0, whatever the calls
    free = [spinup.free_run(FlowBatch(ops, noisy.baseline.start, 1), steps)["c_l"][:, 0]]
    batch = FlowBatch(ops, noisy.baseline.start, 1)
    free.append(np.concatenate([spinup.free_run(batch, some)["c_l"][:, 0] for some in (1, 11)]))
    np.testing.assert_array_equal(*free)
    zero = np.concatenate([np.zeros((steps, 2, 1)), Disturbances(ops, [0]).series(steps)], axis=1)
    c_l = FlowBatch(ops, noisy.baseline.start, 1).advance(zero)[:, ops.functionals.index("c_l.cylinder"), 0]
    np.testing.assert_array_equal(c_l, free[0])
    assert abs(c_l - read[0][0, 1, 0]).max() > 1e-6


def test_operators_of_a_noisy_flow_come_back_from_their_file(noisy, tmp_path):
    archive.save(noisy.operators, tmp_path / "operators.npz")
    back = archive.load(tmp_path / "operators.npz", noisy.baseline.mesh)
    np.testing.assert_array_equal(back.noise, noisy.operators.noise)
    assert (back.digest, back.inputs) == (noisy.operators.digest, noisy.operators.inputs)


# ---- environments


def observations(env, resets) -> list[np.ndarray]:
    """Return what an environment shows at rest in episodes that begin with some seeds, or None."""
    still, found = np.zeros(env.action_space.shape, np.float32), []
    for own in resets:
        env.reset(seed=own)
        found.append(np.stack([env.step(still)[0] for _ in range(SHORT["actions"])]))
    return found


def test_an_episode_is_that_of_its_seed_and_the_next_is_drawn(noisy):
    env, again = (FlowEnv(NOISY, TASK, **SHORT) for _ in range(2))
    first, second, other = observations(env, [3, None, 4])
    np.testing.assert_array_equal([first, second], observations(again, [3, None]))
    assert abs(second - first).max() > 1e-6 and abs(other - first).max() > 1e-6
    np.testing.assert_array_equal(first, observations(env, [3])[0])
    # one that was never seeded is another every time
    a, b = (observations(FlowEnv(NOISY, TASK, **SHORT), [None])[0] for _ in range(2))
    assert abs(a - b).max() > 1e-6


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_flow_i_of_a_batch_has_the_episodes_of_a_single_environment_of_its_seed(noisy, mode):
    plan = np.random.default_rng(0).uniform(-1, 1, (9, 3, 1)).astype(np.float32)
    batch = FlowVectorEnv(3, NOISY, TASK, mode, **SHORT)
    twin = SyncVectorEnv([lambda: FlowEnv(NOISY, TASK, **SHORT)] * 3, autoreset_mode=mode)
    for given in (11, None, [5, 4, 3], [None, 7, None]):
        np.testing.assert_array_equal(batch.reset(seed=given)[0], twin.reset(seed=given)[0])
        for action in plan:
            for ours, theirs in zip(batch.step(action)[:4], twin.step(action)[:4], strict=True):
                np.testing.assert_array_equal(ours, theirs)
    twin.close()


def test_a_flow_that_is_reset_alone_begins_its_own_next_episode(noisy):
    still, mask = np.zeros((2, 1), np.float32), np.array([False, True])
    batch, alone = (FlowVectorEnv(count, NOISY, TASK, AutoresetMode.DISABLED, **SHORT) for count in (2, 1))
    batch.reset(seed=6)
    alone.reset(seed=7)
    batch.step(still)
    batch.reset(options={"reset_mask": mask})
    alone.reset()
    np.testing.assert_array_equal(batch.step(still)[0][1], alone.step(still[:1])[0][0])
    batch.reset(seed=[1, 7], options={"reset_mask": mask})
    alone.reset(seed=7)
    np.testing.assert_array_equal(batch.step(still)[0][1], alone.step(still[:1])[0][0])


def test_too_few_seeds_are_refused(noisy):
    batch = FlowVectorEnv(3, NOISY, TASK, **SHORT)
    with pytest.raises(ValueError, match="seed: got 2, wanted one for each of the 3 flows, or one for all"):
        batch.reset(seed=[1, 2])


# ---- training and evaluation


@pytest.fixture(scope="module")
def flows(noisy) -> Flows:
    chosen = load.choose(NOISY, TASK, **SHORT)
    return Flows((Flow(chosen.case, noisy.operators, noisy.baseline),), chosen)


def policy(action: float) -> Policy:
    """A policy that draws its action around one."""
    layers = ((np.zeros((1, 151), np.float32), np.array([action], np.float32)),)
    return Policy(0, np.zeros(151), np.ones(151), layers, np.full(1, -2.0), np.full(1, 0.1))


def episode(flows, indices, **changes):
    contexts = [context(7, index, flows.horizon, 1) for index in indices]
    return flows.play([policy(0.2)], [dataclasses.replace(own, **changes) for own in contexts])


def test_an_episode_of_a_training_is_the_same_alone_in_a_block_and_in_another_process(flows):
    whole = episode(flows, [0, 1, 2, 3])
    contexts = [context(7, index, flows.horizon, 1) for index in (2, 0)]
    (alone,), engine = episode(flows, [2]), Processes(1)
    try:
        there = engine.submit(Flows.play, engine.share(flows), [policy(0.2)], contexts).result(120)
    finally:
        engine.close()
    for twin in (alone, there[0]):
        np.testing.assert_array_equal(twin.observations, whole[2].observations)
        np.testing.assert_array_equal(twin.rewards, whole[2].rewards)
    np.testing.assert_array_equal(there[1].rewards, whole[0].rewards)


def test_chance_is_of_the_episode_s_seed_and_not_of_its_exploration(flows):
    (one,), (other,) = episode(flows, [2]), episode(flows, [2], seed=seed(7, 3))
    np.testing.assert_array_equal(one.observations[0], other.observations[0])  # of the same start
    assert abs(one.observations[1:] - other.observations[1:]).max() > 1e-6
    (twin,) = episode(flows, [2], seed=seed(7, 2))
    np.testing.assert_array_equal(twin.observations, one.observations)


def test_an_evaluation_has_the_same_chance_for_any_number_of_slots(flows):
    results = [flows.evaluate(policy(0.2), Threads(slots)) for slots in (1, 3)]
    assert results[0].summary() == results[1].summary()
    # every start has a seed of its own: two from one state go apart
    start = flows.flows[0].baseline.start
    two = evaluate.play(flows.flows[0], flows.task, STILL, [start] * 2, 2, first=4)
    one = evaluate.play(flows.flows[0], flows.task, STILL, [start], 2, first=5)
    np.testing.assert_array_equal(two.series["c_l"][:, 1], one.series["c_l"][:, 0])
    assert abs(np.diff(two.series["c_l"], axis=1)).max() > 1e-6
