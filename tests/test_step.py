"""The backward-facing step: its actuator and its inflow are HydroGym's, its episodes those of their seeds alone."""

import gymnasium
import numpy as np
import pytest

from examples.feedforward import GAIN, from_lip
from manywake import plots
from manywake.case import replace
from manywake.env.control import ControlledFlows
from manywake.flow import baseline, problem, readings, store
from manywake.flow import batch as batches
from manywake.flow.batch import FlowBatch
from manywake.learn import evaluate
from manywake.learn.evaluate import Trajectory
from manywake.suite.step import CASE, NOISE, TASK, calmed

NAMES = ("power", "gauge", "energy")


@pytest.fixture(scope="module")
def flow():
    return store.flow(CASE)


@pytest.fixture(scope="module")
def posed(flow):
    return problem.pose(CASE, flow.baseline.mesh)


def played(flow, seeds, actions=3):
    """Return what flows of some seeds see, and their means and rewards, under the same actions."""
    flows = ControlledFlows(flow, replace(TASK, interval=0.05), len(seeds))
    flows.reset(range(len(seeds)), seeds)
    found = [flows.observe()]
    for t in range(actions):
        outcome = flows.act(np.full((len(seeds), 1), 0.5 - t))
        found += [flows.observe(), *(outcome.means[name][:, None] for name in NAMES), outcome.reward[:, None]]
    return np.concatenate(found, axis=1)


def test_the_slot_blows_the_parabola_that_hydrogym_gives(posed):
    space = posed.space
    nodes = space.boundary_nodes(["slot"])
    x = space.x[nodes, 0]
    np.testing.assert_allclose(posed.profiles[0, nodes, 1], -x * (1600 * x + 560) / 147, atol=1e-12)
    assert abs(posed.profiles[0, :, 0]).max() == 0
    flux, _ = problem.boundary_flux(space, space.facets("slot"), posed.profiles[0])
    assert flux == pytest.approx(7 / 90, rel=1e-12)


def test_the_inflow_peaks_at_one_and_the_viscosity_is_half_over_re(posed):
    y = posed.space.x[posed.space.boundary_nodes(["inlet"]), 1]
    u = posed.steady[posed.space.boundary_nodes(["inlet"]), 0]
    np.testing.assert_allclose(u, 16 * y * (0.5 - y), atol=1e-12)
    assert CASE.viscosity == pytest.approx(0.5 / 600)


def test_the_noise_has_the_rms_and_the_correlation_of_hydrogyms_filter():
    share = 0.01 / 0.05  # of the way to a normal number, of rms 1, that theirs goes in a step of 0.01
    assert NOISE.rms == pytest.approx(np.sqrt(share / (2 - share)))
    assert np.exp(-0.01 / NOISE.time) == pytest.approx(1 - share, abs=1e-3)


def test_the_baseline_withstands_full_strength_and_knows_what_noise_does(flow):
    base = flow.baseline
    assert (base.withstood.held, base.withstood.smooth) == (1.0, 1.0)
    assert base.statistics.kind == "aperiodic" and len(base.starts) == baseline.APART
    energy = base.statistics["energy"]
    assert energy.low > 0 and energy.error < 0.1 * energy.mean
    # what the energy is about is the steady flow, whose shear is known too
    flows = ControlledFlows(flow, TASK, 1)
    mass, off = flow.operators.space.mass, flows.batch.state(0).u - base.still
    assert flows.batch.read("energy")[0, 0] == pytest.approx(0.5 * np.sum(off * (mass @ off)), rel=1e-5)
    assert base.steady["energy"] == 0.0 and calmed(base.free, base.free) == 0.0


def test_episodes_of_the_step_are_functions_of_their_seeds(flow):
    together = played(flow, [5, 6, 7, 8, 9])
    for seeds in ([7], [8, 9, 5]):
        assert (played(flow, seeds) == together[[seed - 5 for seed in seeds]]).all()
    assert len(np.unique(together[:, -1])) == 5


def test_a_reward_sees_the_mean_over_the_action_and_the_agent_the_flow_as_it_is(flow):
    flows = ControlledFlows(flow, replace(TASK, observe=("gauge",), history=1), 2)
    flows.reset(range(2), [3, 4])
    assert (flows.observe()[:, 0] == flows.batch.read("gauge")[:, 0].astype(np.float32)).all()
    outcome = flows.act(np.zeros((2, 1)))
    assert (outcome.means["energy"] == readings.means({"energy": outcome.series["energy"]})["energy"]).all()
    assert outcome.reward[0] == 1.0 - outcome.means["energy"][0] / flow.baseline.free["energy"]
    assert (flows.observe()[:, 0] == outcome.series["gauge"][-1].astype(np.float32)).all()
    assert (outcome.series["gauge"][-1] != outcome.means["gauge"]).all()


def test_the_line_on_the_probe_reads_what_it_says(flow):
    flows, seen = ControlledFlows(flow, TASK, 1), []
    for _ in range(4):
        flows.act(np.zeros((1, 1)))
        seen.append(float(flows.batch.read("lip")[0, 0]))
    assert from_lip(flows.observe()[0], {}) == pytest.approx([GAIN * (seen[-1] - seen[0])], abs=1e-4)
    assert from_lip(np.arange(8.0), {}) == [1.0] and from_lip(-np.arange(8.0), {}) == [-1.0]


def test_the_step_has_an_id_and_its_readings_stand_in_the_info():
    env = gymnasium.make("manywake/Step-v0", interval=0.05)
    env.reset(seed=1)
    *_, info = env.step(np.ones(1, np.float32))
    assert info["energy"] > 0 and {"gauge", "power", "amplitudes"} <= set(info)


def test_pictures_of_a_flow_without_bodies_show_what_it_measures(flow, tmp_path):
    batch, amplitudes = FlowBatch(flow.operators, flow.baseline.start, 1), np.zeros((20, 1, 1))
    record = batches.recorded(batch, amplitudes, lambda what, share: None, "")
    whole = Trajectory(record, amplitudes, np.zeros((1, 1)), [])
    table, state = evaluate.record(flow.case, flow.baseline.shown, whole, record), batch.state(0)
    plots.wake(flow, state, state, table, "", tmp_path / "wake.png")
    numbers = {f"{name}_second_half": np.arange(4.0) for name in record} | {"reward": np.arange(4.0)}
    episodes = numbers | {"update": np.zeros(4), "episode": np.arange(4), "wall_s": np.arange(4.0)}
    plots.learning_curve(episodes, flow.baseline, "", tmp_path / "curve.png")
    assert (tmp_path / "wake.png").exists() and (tmp_path / "curve.png").exists()
