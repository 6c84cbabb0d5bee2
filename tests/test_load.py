"""Cases by name, by file and from Python; single settings overridden by their names; files that travel to workers."""

import hashlib
import math

import cloudpickle
import numpy as np
import pytest

from manywake.case import Exponential, Held, Jet, Learning, Linear, Pressure, alike, describe, replace
from manywake.case.schemes import GODA
from manywake.learn import flows
from manywake.learn.engine import Processes, Threads
from manywake.learn.policy import Policy
from manywake.learn.rollout import context
from manywake.suite import cylinder_jets, cylinder_jets_goda, load
from manywake.suite.cylinder_jets import CASE, LEARNING, PROTOCOLS, REWARDS, TASK

PAPERS = ("cylinder-jets", "cylinder-jets-goda")
TOP, BOTTOM = CASE.actuators
PRESSURE, VELOCITY = CASE.sensors


def test_the_shipped_cases_have_names():
    free = ["fluidgym-cylinder", "free-cylinder-jets", "free-cylinder-rotation"]
    alone = ["gartling-step", "lid-driven-cavity", "pinball", "pinball-deng"]
    others = [*alone, "square-jets", "step", "wide-cylinder"]
    assert load.names() == ["channel", *PAPERS, *free, *others]
    for name in load.names():
        definition = load.load(name)
        assert definition.name == name and definition.shipped
        assert definition.sha256 == hashlib.sha256(definition.file.read_bytes()).hexdigest()
    goda = load.load("cylinder-jets-goda").case
    assert goda == replace(CASE, scheme=GODA, time_step=5e-4, sizes=cylinder_jets_goda.SIZES)


def test_a_case_without_a_word_is_as_its_file_says():
    chosen = load.choose("cylinder-jets")
    assert (chosen.case, chosen.task, chosen.learning) == (CASE, TASK, LEARNING)
    assert (chosen.protocol, chosen.overrides) == ("default", {})
    assert load.choose(load.DEFAULT) == chosen


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_protocol_is_task_and_learner_s_settings(protocol):
    chosen = load.choose("cylinder-jets", protocol, actions=40)
    task, learning = PROTOCOLS[protocol]
    assert (chosen.case, chosen.task, chosen.learning) == (CASE, replace(task, actions=40), learning)
    assert chosen.protocol == protocol


# ---- settings by name


@pytest.mark.parametrize("protocol", ["default", *PROTOCOLS])
@pytest.mark.parametrize("name", PAPERS)
def test_every_setting_has_a_sentence_and_the_value_of_the_file(name, protocol):
    definition = load.load(name)
    task = definition.protocol(protocol)[0]
    found = load.settings(definition, protocol)
    for setting in found.values():
        assert setting.help[0].isupper() and setting.help.endswith(".") and "\n" not in setting.help
    assert set(found) == {
        *("reynolds", "spin_up", "time_step", "scheme", "limit", "limit.cylinder.top", "limit.cylinder.bottom"),
        *(f"sizes.{part}" for part in ("body", "part_facets", "layers", "layer_height", "layer_growth")),
        *("sizes.wake", "sizes.wake_axis", "sizes.far", "points.pressure", "points.velocity"),
        *("noise.pressure", "noise.velocity", "history", "delay", "reynolds_numbers"),
        *("interval", "actions", "observe", "reward", "law", "starts"),
        *(("law.alpha", "law.per") if isinstance(task.law, Exponential) else ()),
    }
    assert found["reynolds"].value == 100
    assert found["time_step"].value == definition.case.dt
    assert found["limit.cylinder.top"].value == 0.01
    assert found["points.pressure"].value == cylinder_jets.PROBES
    assert definition.rewards[found["reward"].value] is task.reward
    assert found["law"].value == type(task.law).__name__.lower()


def limited(jet: Jet, limit: float) -> Jet:
    """Return a jet with a smaller limit, which has the baseline that it had."""
    return replace(jet, limit=limit, strength=jet.limit)


POINTS = [[0.3, 0.0], (0.4, 0.05)]
OVERRIDES = {
    "reynolds": (120.0, "case", {"reynolds": 120.0}),
    "time_step": (5e-4, "case", {"time_step": 5e-4}),
    "spin_up": (80.0, "case", {"spin_up": 80.0}),
    "sizes.body": (0.06, "case", {"sizes": replace(CASE.sizes, body=0.06)}),
    "sizes.wake_axis": (None, "case", {"sizes": replace(CASE.sizes, wake_axis=None)}),
    "limit": (0.005, "case", {"actuators": (limited(TOP, 0.005), limited(BOTTOM, 0.005))}),
    "limit.cylinder.top": (0.005, "case", {"actuators": (limited(TOP, 0.005), BOTTOM)}),
    "points.pressure": (POINTS, "case", {"sensors": (Pressure("pressure", ((0.3, 0.0), (0.4, 0.05))), VELOCITY)}),
    "sensors": ((PRESSURE,), "case", {"sensors": (PRESSURE,)}),
    "interval": (0.05, "task", {"interval": 0.05}),
    "actions": (40, "task", {"actions": 40}),
    "observe": (("velocity", "c_l"), "task", {"observe": ("velocity", "c_l")}),
    "reward": ("paper", "task", {"reward": REWARDS["paper"]}),
    "law": ("held", "task", {"law": Held()}),
    "law.alpha": (0.2, "task", {"law": Exponential(0.2, per=5e-4)}),
    "mixing": (alike(2), "task", {"mixing": alike(2)}),
    "episodes": (32, "learning", {"episodes": 32}),
    "hidden": ((8,), "learning", {"hidden": (8,)}),
}
"""Settings: the value that is given, and the fields that it changes."""


@pytest.mark.parametrize("name", OVERRIDES)
def test_a_setting_is_overridden_by_its_name_and_no_other_changes(name):
    value, part, fields = OVERRIDES[name]
    chosen = load.choose("cylinder-jets", **{name: value})
    expected = {"case": CASE, "task": TASK, "learning": LEARNING}
    expected[part] = replace(expected[part], **fields)
    assert {part: getattr(chosen, part) for part in expected} == expected
    assert chosen.overrides == {name: value}


@pytest.mark.parametrize("limit, strength", [(0.002, 0.01), (0.01, 0.01), (0.012, 0.012)])
def test_a_smaller_limit_shares_the_baseline_and_a_larger_one_has_its_own(limit, strength):
    case = load.choose("cylinder-jets", limit=limit).case
    assert [(jet.limit, jet.strongest) for jet in case.actuators] == [(limit, strength)] * 2
    assert (describe.flow_digest(case) == describe.flow_digest(CASE)) == (limit <= 0.01)


def test_what_a_word_stands_for_can_be_given_itself():
    reward = lambda now, free: -now["power"]  # noqa: E731
    chosen = load.choose("cylinder-jets", law=Held(), reward=reward)
    assert chosen.task == replace(TASK, law=Held(), reward=reward)
    named = load.choose("cylinder-jets-goda", scheme="bdf2-mean", reward="drag", law="linear", interval=0.05)
    assert named.case == replace(CASE, time_step=5e-4, sizes=cylinder_jets_goda.SIZES)
    assert named.task == replace(TASK, reward=REWARDS["drag"], law=Linear(), interval=0.05)


@pytest.mark.parametrize("turn", [1, -1])
def test_a_part_is_set_after_the_whole_in_whichever_order_they_are_named(turn):
    words = {"limit": 0.005, "limit.cylinder.top": 0.002, "law": Exponential(0.5, per=1e-3), "law.alpha": 0.2}
    chosen = load.choose("cylinder-jets", **dict(list(words.items())[::turn]))
    assert chosen.case.actuators == (limited(TOP, 0.002), limited(BOTTOM, 0.005))
    assert chosen.task.law == Exponential(0.2, per=1e-3)


# ---- cases made in Python


def test_a_case_made_in_python_is_chosen_with_its_task():
    case, task = replace(CASE, reynolds=120), replace(TASK, reward=REWARDS["drag"])
    chosen = load.choose(case, task, actions=40, **{"limit.cylinder.top": 0.005})
    assert chosen.case == replace(case, actuators=(limited(TOP, 0.005), BOTTOM))
    assert (chosen.task, chosen.learning) == (replace(task, actions=40), Learning())
    definition = chosen.definition
    assert (definition.name, definition.file, definition.sha256, definition.shipped) == ("python", None, None, False)


def test_a_reward_without_a_value_somewhere_is_described_by_its_error_there():
    chosen = load.choose("cylinder-jets", reward=lambda now, free: math.log(now["c_d"]))
    values = describe.task(chosen.case, chosen.task)["reward"]["values"]
    assert "ValueError" in values and any(isinstance(value, float) for value in values)


def test_a_task_made_in_python_is_played_on_a_case_by_name():
    task = replace(TASK, observe=("velocity",))
    chosen = load.choose("cylinder-jets", task, reynolds=120)
    assert (chosen.case, chosen.task) == (replace(CASE, reynolds=120), task)
    assert (chosen.learning, chosen.definition.name) == (LEARNING, "cylinder-jets")


# ---- a user's file

MINE = '''"""Jets that are paid for."""

from dataclasses import dataclass

import numpy as np

from manywake import *
from manywake.suite.cylinder_jets import CASE

WEIGHT = 0.5


@dataclass(frozen=True)
class Late:
    """Half of what is wanted, from the second step on."""

    share: float = 0.5

    def series(self, steps, time_step, amplitude, previous, wanted):
        series = np.repeat(self.share * wanted[None], steps, axis=0)
        series[0] = amplitude
        return series


def paid(now):
    return WEIGHT * now["power"]


REWARDS = {"saved": lambda now, free: free["c_d"] - now["c_d"] - paid(now), "drag": lambda now, free: -now["c_d"]}
TASK = Task(0.002, 3, REWARDS["saved"], observe=("pressure", "amplitudes"), mixing=PAIR, law=Late())
LEARNING = Learning(hidden=(8,))
PROTOCOLS = {"long": (replace(TASK, actions=5, reward=REWARDS["drag"]), replace(LEARNING, gamma=0.9))}
'''


@pytest.fixture
def mine(tmp_path):
    path = tmp_path / "paid-jets.py"
    path.write_text(MINE)
    return path


def test_a_user_s_file_says_what_a_shipped_one_does(mine, monkeypatch):
    chosen = load.choose(mine)
    definition = chosen.definition
    assert (definition.name, definition.file, definition.shipped) == ("paid-jets", mine, False)
    assert definition.sha256 == hashlib.sha256(MINE.encode()).hexdigest()
    assert (chosen.case, chosen.task.actions, chosen.learning) == (CASE, 3, Learning(hidden=(8,)))
    assert list(definition.protocols) == ["default", "long"]
    long = load.choose(mine, "long", reward="saved", **{"law.share": 0.25})
    assert (long.task.actions, long.task.law.share, long.learning.gamma) == (5, 0.25, 0.9)
    now, free = {"c_d": 3.0, "power": 0.1}, {"c_d": 3.2}
    assert chosen.task.reward(now, free) == long.task.reward(now, free) == pytest.approx(0.15)
    assert load.choose(mine, reward="drag").task.reward(now, free) == -3.0
    assert load.settings(definition)["law.share"].value == 0.5
    monkeypatch.chdir(mine.parent)
    assert load.load("paid-jets.py").file == mine


def test_a_file_is_read_anew_whenever_it_is_asked_for(mine):
    assert load.choose(mine).task.actions == 3
    mine.write_text(MINE.replace("Task(0.002, 3,", "Task(0.002, 4,"))
    assert load.choose(mine).task.actions == 4


def test_a_file_needs_a_case_and_a_task_only(tmp_path):
    path = tmp_path / "least.py"
    path.write_text("from manywake.suite.cylinder_jets import CASE, TASK\n")
    definition = load.choose(path).definition
    assert definition.protocols == {"default": (TASK, Learning())}
    assert (definition.rewards, definition.references) == ({"reduction": TASK.reward}, ())


def policy(values: int) -> Policy:
    """Return an untrained policy that pushes one way or the other."""
    rng = np.random.default_rng(0)
    layers = tuple((rng.normal(0, 0.1, shape).astype(np.float32), np.zeros(shape[0], np.float32)) for shape in SHAPES)
    return Policy(0, np.zeros(values), np.ones(values), layers, np.full(1, -1.0), np.exp(np.full(1, -1.0)))


VALUES = 151 + 2
SHAPES = ((8, VALUES), (1, 8))


def test_a_user_s_file_with_lambdas_and_classes_plays_in_processes_that_have_not_got_it(mine):
    simulation = flows.open_flows(load.choose(mine))
    again = cloudpickle.loads(cloudpickle.dumps(simulation.chosen))
    now, free = {"c_d": 3.0, "power": 0.1}, {"c_d": 3.2}
    assert again.task.reward is not simulation.task.reward
    assert again.task.reward(now, free) == simulation.task.reward(now, free)
    assert again.case == CASE and again.definition.sha256 == simulation.chosen.definition.sha256
    mine.unlink()
    contexts = [[context(3, index, 3, 1)] for index in range(2)]
    rewards = {}
    for name, make in (("here", lambda: Threads(1)), ("there", lambda: Processes(2))):
        engine = make()
        try:
            shared = engine.share(simulation)
            futures = [engine.submit(flows.Flows.play, shared, [policy(VALUES)], each) for each in contexts]
            episodes = [episode for future in futures for episode in future.result(120)]
        finally:
            engine.close()
        rewards[name] = np.stack([episode.rewards for episode in episodes])
        free = simulation.flows[0].baseline.free
        for episode in episodes:
            saved = free["c_d"] - episode.readings["c_d"] - 0.5 * episode.readings["power"]
            np.testing.assert_array_equal(episode.rewards, saved)
            assert episode.readings["amplitude_rms"].all()  # the file's own law drives the jets
    np.testing.assert_array_equal(rewards["there"], rewards["here"])


# ---- cases without a task

FLOW = """from manywake.suite.cylinder_jets import CASE
from manywake.case import Statistic

REFERENCES = (Statistic("drag", {of!r}, 3.2, None, "mine"),)
"""


def written(tmp_path, of="c_d mean"):
    path = tmp_path / "flow.py"
    path.write_text(FLOW.format(of=of))
    return path


def test_a_case_may_have_no_task(tmp_path):
    definition = load.load(written(tmp_path))
    assert definition.task is None and definition.protocols == {} and definition.rewards == {}
    assert load.load("cylinder-jets").task is TASK
    assert load.override_case(definition, {"reynolds": 80.0}) == replace(CASE, reynolds=80.0)
    with pytest.raises(ValueError, match="got the setting 'interval', wanted one of"):
        load.override_case(definition, {"interval": 0.05})


def test_what_plays_wants_a_task_and_says_where(tmp_path):
    path = written(tmp_path)
    with pytest.raises(ValueError, match=r"task: got none in .*flow\.py, wanted TASK = Task\(\.\.\.\)"):
        load.choose(path)
    assert load.choose(path, TASK).task == TASK


def test_a_reference_that_fits_no_case_is_refused_when_the_file_is_loaded(tmp_path):
    with pytest.raises(ValueError, match="reference 'drag': got 'c_x mean', wanted one of c_d mean"):
        load.load(written(tmp_path, "c_x mean"))
