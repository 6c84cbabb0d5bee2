"""Simple controllers against what they say, a user's function, and the search; on a few steps of the shipped flow."""

import json
import subprocess
import sys

import numpy as np
import pytest

import manywake
from manywake.case import replace
from manywake.env.control import ControlledFlows, spaces
from manywake.learn import controllers
from manywake.learn import policy as policies
from manywake.learn.controllers import FAMILIES, Learnt, Own, Simple, simple
from manywake.learn.engine import Threads
from manywake.learn.flows import Flows
from manywake.learn.policy import Policy
from manywake.suite import load
from manywake.suite.cylinder_jets import TASK

SHORT = replace(TASK, interval=0.002, actions=4)
SEEN = np.zeros((2, 151), np.float32)


@pytest.fixture(scope="module")
def pair(shipped):
    """Two flows whose agent has an action for each jet."""
    return ControlledFlows(shipped, replace(SHORT, mixing=None), 2)


def test_nothing_acts_without_control(pair):
    assert not simple("none", (), 2).on(pair)(3, SEEN).any()


def test_a_constant_is_held(pair):
    choose = simple("constant", (0.2, -0.3), 2).on(pair)
    for t in (0, 5):
        np.testing.assert_array_equal(choose(t, SEEN), [[0.2, -0.3]] * 2)


def test_a_harmonic_has_its_amplitudes_frequency_and_phase(pair):
    choose = simple("harmonic", (0.5, 0.2, 0.3, 0.25), 2).on(pair)
    t = np.arange(40)
    found = np.stack([choose(k, SEEN)[0] for k in t])
    turns = 0.3 * t * 0.002 / 0.1  # a frequency of 0.3 U / L, L / U being 0.1
    np.testing.assert_allclose(found[:, 0], 0.5 * np.sin(2 * np.pi * turns), atol=1e-12)
    np.testing.assert_allclose(found[:, 1], 0.2 * np.sin(2 * np.pi * (turns + 0.25)), atol=1e-12)


def test_feedback_is_proportional_to_the_lift_and_its_change(shipped):
    flows = ControlledFlows(shipped, SHORT, 1)
    lift = shipped.baseline.statistics["c_l"]
    size, rate = np.sqrt(lift.rms**2 - lift.mean**2), shipped.baseline.statistics.period / (2 * np.pi * 0.002)
    gains = {"p": (0.1, 0.0), "d": (0.0, 0.01), "pd": (0.1, 0.01)}
    chosen = {name: simple("feedback", numbers, 1).on(flows) for name, numbers in gains.items()}
    before = 0.0
    for t in range(4):
        found = {name: choose(t, flows.observe())[0, 0] for name, choose in chosen.items()}
        now = (flows.means["c_l"][0] - lift.mean) / size
        change = rate * (now - before) if t > 1 else 0.0
        assert found["p"] == pytest.approx(0.1 * now)
        assert found["d"] == pytest.approx(0.01 * change)
        assert found["pd"] == pytest.approx(np.clip(0.1 * now + 0.01 * change, -1, 1))
        before = now
        flows.act(np.full((1, 1), 0.3))


def test_candidates_side_by_side_act_as_alone(pair):
    numbers = np.array([[0.1, 0.2, 0.3, 0.4], [0.5, 0.6, 0.2, 0.1]])
    both = Simple(FAMILIES["harmonic"], numbers).on(pair)(3, SEEN)
    for b in range(2):
        np.testing.assert_array_equal(both[b], simple("harmonic", numbers[b], 2).on(pair)(3, SEEN)[b])


class Counting:
    """A controller with a memory of its own."""

    def __init__(self):
        self.calls = 0

    def __call__(self, observation, info):
        self.calls += 1
        return [0.1 * self.calls]


def test_a_user_s_controller_sees_its_own_flow_and_remembers_by_itself(shipped):
    flows, seen = ControlledFlows(shipped, SHORT, 2), []

    def act(observation, info):
        seen.append((observation.shape, dict(info)))
        return [0.0]

    choose = Own(act).on(flows)
    choose(0, flows.observe())
    outcome = flows.act(np.array([[0.3], [-0.3]]))
    choose(1, flows.observe())
    assert [shape for shape, _ in seen] == [(151,)] * 4
    assert [set(info) for _, info in seen[:2]] == [{"time"}] * 2
    for b in range(2):
        assert seen[2 + b][1]["c_l"] == outcome.means["c_l"][b]
        assert seen[2 + b][1]["time"] == pytest.approx(0.002)
    counting = Own(Counting).on(flows)
    assert [counting(t, SEEN).tolist() for t in range(2)] == [[[0.1]] * 2, [[0.2]] * 2]


@pytest.mark.parametrize("bad", [[0.1, 0.2], [np.nan], "left"])
def test_what_is_no_action_is_refused(shipped, bad):
    with pytest.raises(ValueError, match="controller|could not convert"):
        Own(lambda observation, info: bad).on(ControlledFlows(shipped, SHORT, 1))(0, SEEN[:1])


def test_wrong_names_and_numbers_are_refused_with_the_remedy():
    with pytest.raises(ValueError, match="numbers: got 1, wanted 2 for harmonic .*; find them with: manywake search"):
        simple("harmonic", (0.1,), 1)
    with pytest.raises(
        ValueError, match="controller: got 'best', wanted none, constant, harmonic, feedback, pretrained, or"
    ):
        simple("best", (), 1)
    for name in ("nothing_there:act", "json:nothing_there"):
        with pytest.raises(ValueError, match="wanted module:function"):
            controllers.own(name)


def test_the_search_finds_the_constant_that_the_reward_asks_for(shipped):
    def half(now, free):
        """Largest where the lift is that of half the limit."""
        return -abs(now["c_l"] - wanted)

    chosen = load.choose("cylinder-jets", actions=2, interval=0.002)
    flows = ControlledFlows(shipped, chosen.task, 1)
    for _ in range(2):
        wanted = float(flows.act(np.full((1, 1), 0.5)).means["c_l"][0])
    simulation = Flows((shipped,), replace(chosen, task=replace(chosen.task, reward=half)))
    told = []
    found = [
        controllers.search(simulation, "constant", Threads(slots), 6, 1, lambda what, share: told.append(share))
        for slots in (1, 2)
    ]
    assert found[0] == found[1]
    assert found[0].numbers[0] == pytest.approx(0.5, abs=0.02)
    assert found[0].tried == 7 * 16 and told[-1] == 1.0


def test_a_search_that_finds_nothing_better_ends_at_nothing(shipped):
    def still(now, free):
        """Largest where nothing acts."""
        return -abs(now["power"])

    chosen = load.choose("cylinder-jets", actions=6, interval=0.002)
    simulation = Flows((shipped,), replace(chosen, task=replace(chosen.task, reward=still)))
    for name in ("constant", "feedback"):
        found = controllers.search(simulation, name, Threads(1), 1, 1, lambda what, share: None)
        assert not any(found.numbers)


def test_a_policy_s_evaluation_has_means_and_intervals_over_its_starts(shipped):
    layers = ((np.zeros((1, 151), np.float32), np.array([0.3], np.float32)),)
    policy = Policy(0, np.zeros(151), np.ones(151), layers, np.zeros(1), np.ones(1))
    simulation = Flows((shipped,), load.choose("cylinder-jets", actions=2))
    held = simulation.judge(Learnt(policy), Threads(2))
    numbers = np.array([control.cd_controlled for control in held.phases])
    mean, error = held.over_starts("cd_controlled")
    assert mean == pytest.approx(numbers.mean())
    assert error == pytest.approx(2.3646 * numbers.std(ddof=1) / np.sqrt(8), rel=1e-3)


def test_the_command_plays_a_controller_of_a_case():
    words = ["evaluate", "--controller", "constant", "--numbers", "0.3", "--actions", "2", "--json"]
    done = subprocess.run([sys.executable, "-m", "manywake.cli", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    same = manywake.judge(controller="constant", numbers=(0.3,), actions=2).summary()
    assert json.loads(done.stdout.splitlines()[-1]) == json.loads(json.dumps(same))


def test_a_policy_that_ships_is_played_by_its_case_and_refused_by_another_task(shipped, tmp_path):
    layers = ((np.zeros((1, 151), np.float32), np.array([0.3], np.float32)),)
    policies.write(Policy(0, np.zeros(151), np.ones(151), layers, np.zeros(1), np.ones(1)), tmp_path / "policy.npz")
    flows = ControlledFlows(shipped, SHORT, 2)
    choose = controllers.shipped(tmp_path / "policy.npz", "cylinder-jets", 151).on(flows)
    np.testing.assert_allclose(choose(0, flows.observe()), 0.3, rtol=1e-6)
    with pytest.raises(ValueError, match="made for 151 observed values, got a task with 302"):
        controllers.shipped(tmp_path / "policy.npz", "cylinder-jets", 302)
    with pytest.raises(ValueError, match="no policy ships with wake, wanted one; train one, and give its run"):
        controllers.shipped(None, "wake", 151)


@pytest.mark.parametrize("name", [name for name in load.names() if load.load(name).policy])
def test_a_policy_that_ships_fits_the_task_of_its_case(name):
    definition = load.load(name)
    seen, acts = spaces(definition.case, definition.task)
    found = policies.read(definition.policy)
    assert found.mean.shape == seen.shape and found.std.shape == acts.shape


def test_the_numbers_of_a_case_s_controllers_are_as_many_as_they_want():
    for name in load.names():
        definition = load.load(name)
        for family, numbers in definition.controllers.items():
            assert definition.task is not None
            controllers.simple(family, numbers, spaces(definition.case, definition.task)[1].shape[0])
