"""A run folder holds what a run is, refuses what would spoil it, and gives the policy back."""

import dataclasses
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from stable_baselines3 import PPO

from manywake import api
from manywake.case.laws import Exponential
from manywake.case.learning import Learning
from manywake.flow import baseline, store
from manywake.learn import checkpoints, flows, ppo, replay, tables, train
from manywake.learn import policy as policies
from manywake.learn.blocks import Layout
from manywake.learn.collect import play
from manywake.learn.engine import Processes, Threads
from manywake.learn.flows import Flows
from manywake.learn.rollout import context
from manywake.learn.runs import Run
from manywake.learn.settings import Collection, Settings
from manywake.suite import cylinder_jets, load

from . import external
from .external import case_file
from .test_rollout import physics
from .toy import collector

pytestmark = pytest.mark.alone

CHOSEN = load.choose("cylinder-jets", actions=2)
SETTINGS = Settings(
    Learning(update_period=2, episodes=4, learner_threads=1, batch_size=4, hidden=(8,)),
    Collection(engine="serial"),
    seed=3,
)
LAYOUT = Layout(2, 1, 2)


def start(folder, chosen=CHOSEN) -> train.Trained:
    return train.train(folder, flows.open_flows(chosen), SETTINGS, Threads(1), LAYOUT)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "a"
    return folder, start(folder)


def test_settings_come_back_as_they_went(run):
    opened = api.load_run(run[0])
    assert opened.run.settings == SETTINGS
    assert opened.run.layout == LAYOUT
    assert opened.simulation.chosen == CHOSEN
    assert opened.simulation.flows[0].case == cylinder_jets.CASE
    assert opened.simulation.task == dataclasses.replace(cylinder_jets.TASK, actions=2)


def test_what_was_overridden_comes_back(tmp_path):
    plain = {"actions": 2, "limit.cylinder.top": 0.005, "reward": "drag", "points.pressure": ((0.1, 0.0), (0.2, 0.05))}
    chosen = load.choose("cylinder-jets", "code", **plain)
    start(tmp_path / "run", chosen)
    found = api.load_run(tmp_path / "run").simulation.chosen
    assert (found.case, found.task, found.protocol) == (chosen.case, chosen.task, "code")
    assert [actuator.limit for actuator in found.case.actuators] == [0.005, 0.01]
    assert replay.replay(Run(tmp_path / "run"), api.load_run(tmp_path / "run").simulation, 3).same is True


def test_every_episode_has_its_row(run):
    table = tables.columns(run[0] / "episodes.csv")
    np.testing.assert_array_equal(table["episode"], [0, 1, 2, 3])
    np.testing.assert_array_equal(table["version"], [0, 0, 1, 1])
    np.testing.assert_array_equal(table["update"], [0, 0, 1, 1])
    assert np.isfinite(table["c_d"]).all()
    assert (table["length"] == 2).all()


def test_the_folder_keeps_the_baseline_and_tensorboard_events(run):
    assert baseline.load(run[0] / "baseline.npz", CHOSEN.case).digest() == store.get(CHOSEN.case).digest()
    assert list((run[0] / "tensorboard").glob("events*"))


@pytest.mark.parametrize("checkpoint", ["last", "best"])
def test_a_checkpoint_is_a_plain_zip_and_its_tensors_are_enough(run, checkpoint):
    policy = checkpoints.policy(Run(run[0]), checkpoint)
    model = PPO.load(run[0] / "checkpoints" / f"{checkpoint}.zip", device="cpu")
    theirs = ppo.snapshot(model)
    for ours, other in zip(policy.layers, theirs.layers, strict=True):
        np.testing.assert_array_equal(ours[0], other[0])
    observation = np.zeros((2, 151), np.float32)
    np.testing.assert_array_equal(policies.act(policy, observation), policies.act(theirs, observation))


def test_last_is_the_policy_whose_hash_is_reported(run):
    model = PPO.load(run[0] / "checkpoints" / "last.zip", device="cpu")
    assert ppo.digest(model) == run[1].policy_sha256


def test_a_second_training_in_the_same_folder_is_refused(run):
    with pytest.raises(
        ValueError, match="already holds a training; choose another --run, delete it, or go on with: manywake resume"
    ):
        start(run[0])


def test_a_folder_in_use_is_refused(tmp_path):
    with FileLock(tmp_path / ".lock"), pytest.raises(ValueError, match="being written by another training"):
        start(tmp_path)


def test_a_folder_that_cannot_be_written_is_refused_before_the_first_episode(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="cannot write"):
        start(tmp_path / "file" / "run")


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(ValueError, match="has no settings.json"):
        _ = Run(tmp_path).settings


def test_an_unknown_checkpoint_is_refused_with_those_there_are(run):
    with pytest.raises(ValueError, match=r"wanted one of \['best', 'last', 'previous'\]"):
        checkpoints.policy(Run(run[0]), "first")


def test_episodes_must_be_a_multiple_of_the_update_period():
    with pytest.raises(ValueError, match="got 30, wanted a multiple of the update period 20"):
        Learning(update_period=20, episodes=30)


def test_the_papers_protocol_is_there_by_name():
    task, learning = cylinder_jets.PROTOCOLS["paper"]
    assert (task.actions, task.reward, task.law) == (80, cylinder_jets.paper, Exponential(0.1, per=5e-4))
    assert task.reward is cylinder_jets.REWARDS["paper"]
    assert (learning.update_period, learning.learning_rate, learning.hidden) == (20, 1e-3, (512, 512))


def test_settings_file_is_plain_json(run):
    data = json.loads((run[0] / "settings.json").read_text())
    assert data["seed"] == 3
    assert data["versions"]["manywake"]


def test_the_folder_keeps_the_operators_its_episodes_were_played_with(run):
    kept = json.loads((run[0] / "settings.json").read_text())["kept"]
    (opened,) = api.load_run(run[0]).simulation.flows
    assert [opened.operators.digest] == kept["operators"]
    assert [opened.baseline.digest()] == kept["baseline"]


def test_every_version_is_kept(run):
    kept = [Run(run[0]).version(number) for number in range(3)]
    last = checkpoints.policy(Run(run[0]))
    np.testing.assert_array_equal(kept[2].layers[0][0], last.layers[0][0])
    with pytest.raises(ValueError, match="version: got 3, wanted one of those in"):
        Run(run[0]).version(3)


@pytest.mark.parametrize("index", [0, 3])
def test_an_episode_replayed_alone_has_the_numbers_it_had(run, index):
    replayed = replay.replay(Run(run[0]), api.load_run(run[0]).simulation, index)
    assert replayed.same is True
    assert set(replayed.episode.versions) == {index // 2}


def test_an_episode_that_never_was_cannot_be_replayed(run):
    with pytest.raises(ValueError, match="episode: got 4, wanted one of the run's 4"):
        replay.replay(Run(run[0]), api.load_run(run[0]).simulation, 4)


def test_updates_have_their_row(run):
    rows = tables.read(run[0] / "updates.csv")
    assert [row["update"] for row in rows] == ["0", "1"]
    assert all(row["clipped_before"] == "0.0" and float(row["staleness_max"]) == 0.0 for row in rows)


# ---- runs of other versions


def of_0_1_0(folder: Path) -> Path:
    """Write the settings of a run as version 0.1.0 did."""
    folder.mkdir()
    old = {
        "case": {"name": "cylinder-jets", "reynolds": 100.0, "jets": [{"angle": 90.0, "width": 10.0}]},
        "task": {"action_interval": 0.025, "actions_per_episode": 2, "control": "exponential", "reward": "reduction"},
        "learning": dataclasses.asdict(SETTINGS.learning),
        "collection": dataclasses.asdict(SETTINGS.collection),
        "seed": 3,
        "env": None,
        "env_folder": ".",
        "layout": {"environments": 2, "workers": 1, "lanes": 2},
        "versions": {"manywake": "0.1.0", "torch": "2.13.0"},
    }
    (folder / "settings.json").write_text(json.dumps(old))
    return folder


def test_a_run_of_the_version_before_is_refused_and_told_so(tmp_path):
    folder = of_0_1_0(tmp_path / "old")
    refused = "has format of 0.1.0, wanted 3; install the version that made it, or train anew"
    for opening in (
        lambda: Run(folder).settings,
        lambda: Run(folder).layout,
        lambda: api.load_run(folder),
        lambda: api.evaluate(folder),
        lambda: train.resume(folder, flows.open_flows(CHOSEN), Threads(1), LAYOUT),
        lambda: replay.replay(Run(folder), flows.open_flows(CHOSEN), 0),
    ):
        with pytest.raises(ValueError, match=refused):
            opening()


def test_a_run_of_a_version_to_come_is_refused(run, tmp_path):
    data = json.loads((run[0] / "settings.json").read_text()) | {"format": 99}
    (tmp_path / "settings.json").write_text(json.dumps(data))
    with pytest.raises(ValueError, match="has format 99, wanted 3; install the version that made it"):
        api.load_run(tmp_path)


@pytest.mark.parametrize("text", ['{"format": 2', "", "[]", "7"])
def test_settings_that_are_damaged_are_refused(tmp_path, text):
    (tmp_path / "settings.json").write_text(text)
    with pytest.raises(ValueError, match="run: "):
        api.load_run(tmp_path)


# ---- opening a run runs nothing that the folder names


def manywake(*words, cwd=None) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "manywake.cli", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A user's case file and a run of it."""
    folder = tmp_path_factory.mktemp("own")
    file = case_file(folder)
    api.train(file, learning=SETTINGS.learning, collection=SETTINGS.collection, seed=3, run=folder / "run")
    return file, folder / "run"


@pytest.fixture
def mine(own):
    """The same, with no sign that the file was run."""
    own[0].with_name("marker").unlink(missing_ok=True)
    return own


def executed(file: Path) -> bool:
    return file.with_name("marker").exists()


def test_the_folder_keeps_a_copy_of_the_case_file_to_read(mine):
    file, folder = mine
    assert (folder / "case.py").read_bytes() == file.read_bytes()
    assert Run(folder).simulation["file"] == str(file)


@pytest.mark.parametrize("words", [["evaluate"], ["resume"], ["replay", "1"]])
def test_a_run_of_a_users_case_is_not_opened_unless_the_file_is_given_again(mine, words):
    file, folder = mine
    done = manywake(words[0], folder, *words[1:])
    assert done.returncode == 2
    assert "give it again: --case FILE" in " ".join(done.stderr.split())
    assert not executed(file) and not (folder / "marker").exists()
    with pytest.raises(ValueError, match="is not run because a folder names it"):
        api.load_run(folder)
    assert not executed(file) and not (folder / "marker").exists()


def test_a_run_of_a_users_case_is_opened_with_its_file(mine):
    file, folder = mine
    done = manywake("replay", folder, 1, "--case", file, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["same_as_recorded"] is True
    assert executed(file)
    opened = api.load_run(folder, file)
    before = checkpoints.policy(opened.run)
    resumed = api.resume(opened)
    assert resumed.episodes == 4
    np.testing.assert_array_equal(checkpoints.policy(opened.run).layers[0][0], before.layers[0][0])
    assert replay.replay(opened.run, opened.simulation, 3).same is True
    found = api.evaluate(opened).summary()
    assert found["reward"] == pytest.approx(0.25 * (found["cd_uncontrolled"] - found["cd_controlled"]))


def test_a_copy_of_the_file_elsewhere_is_the_same_case(mine, tmp_path):
    file, folder = mine
    shutil.copy(file, tmp_path / "moved.py")
    opened = api.load_run(folder, tmp_path / "moved.py")
    assert replay.replay(opened.run, opened.simulation, 0).same is True
    assert not executed(file)


def test_a_file_that_was_changed_is_not_the_runs(mine, tmp_path):
    file, folder = mine
    other = tmp_path / "mine.py"
    other.write_text(file.read_text() + "# as it was, but for this line\n")
    with pytest.raises(ValueError, match="is not the file that .* was made with .* to read, is .*case.py"):
        api.load_run(folder, other)
    with pytest.raises(ValueError, match="is not the file that"):
        api.load_run(folder, "cylinder-jets")


def test_settings_that_lie_about_where_a_case_is_from_run_nothing(mine, tmp_path):
    """Whoever wrote the folder wrote its settings too."""
    file, folder = mine
    shutil.copytree(folder, tmp_path / "run")
    data = json.loads((folder / "settings.json").read_text())
    data["simulation"] |= {"shipped": True, "name": str(file)}
    (tmp_path / "run" / "settings.json").write_text(json.dumps(data))
    with pytest.raises(ValueError, match="case: "):
        api.load_run(tmp_path / "run")
    assert not executed(file)


def test_a_case_made_in_python_is_given_again_and_compared(tmp_path):
    case = dataclasses.replace(cylinder_jets.CASE, sensors=())
    task = dataclasses.replace(cylinder_jets.TASK, actions=2, observe=("c_l", "amplitudes"))
    api.train(case, task, learning=SETTINGS.learning, collection=SETTINGS.collection, run=tmp_path / "run")
    with pytest.raises(ValueError, match="made in Python.* give it again"):
        api.load_run(tmp_path / "run")
    opened = api.load_run(tmp_path / "run", case, task)
    assert replay.replay(opened.run, opened.simulation, 0).same is True
    louder = dataclasses.replace(task, reward=lambda now, free: 2 * cylinder_jets.reduction(now, free))
    with pytest.raises(ValueError, match="the task of 'python' are not those"):
        api.load_run(tmp_path / "run", case, louder)
    limited = dataclasses.replace(
        case, actuators=tuple(dataclasses.replace(actuator, limit=0.02) for actuator in case.actuators)
    )
    with pytest.raises(ValueError, match="the case of 'python' are not those"):
        api.load_run(tmp_path / "run", limited, task)


def test_a_users_reward_reaches_a_worker_where_the_file_is_not(tmp_path):
    file = case_file(tmp_path)
    simulation = flows.open_flows(load.choose(file))
    file.unlink()
    engine = Processes(2)
    try:
        ours, theirs = there_and_here(simulation, engine)
    finally:
        engine.close()
    assert theirs == ours


def there_and_here(simulation: Flows, engine) -> tuple[list[bytes], list[bytes]]:
    """Play two episodes of a user's case here and by an engine, with its reward; return all of both but the times."""
    policy = ppo.snapshot(ppo.build(SETTINGS.learning, collector(simulation, learning=SETTINGS.learning)))
    contexts = [context(7, index, simulation.horizon, 1) for index in range(2)]
    ours = simulation.play([policy], contexts)
    theirs = engine.submit(play, engine.share(simulation), contexts, policy).result(120)
    for episode in theirs:
        saved = simulation.flows[0].baseline.free["c_d"] - episode.readings["c_d"]
        np.testing.assert_allclose(episode.rewards, 0.25 * saved, rtol=1e-12)
    return [physics(episode) for episode in ours], [physics(episode) for episode in theirs]


def test_training_on_processes_has_the_bits_of_a_serial_one_for_a_users_reward_too(mine, tmp_path):
    file, folder = mine
    how = Collection(engine="processes", workers=2, lanes=1)
    api.train(file, learning=SETTINGS.learning, collection=how, seed=3, run=tmp_path / "run")
    theirs, ours = (tables.read(each / "episodes.csv") for each in (tmp_path / "run", folder))
    assert tables.untimed(theirs) == tables.untimed(ours)


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """A folder with a user's module, and a run of its environment."""
    folder = tmp_path_factory.mktemp("foreign")
    telling = 'Path(__file__).with_name("marker").touch()\n'
    (folder / "own_point.py").write_text(Path(external.__file__).read_text() + telling)
    words = ["--episodes", "2", "--update-period", "2", "--hidden", "8", "--actions", "4", "--engine", "serial"]
    done = manywake("train", "--env", "own_point:make", "--run", "run", *words, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize("words", [["evaluate"], ["resume"], ["replay", "1"]])
def test_no_module_is_imported_because_a_run_names_it(foreign, words):
    marker = foreign / "marker"
    marker.unlink(missing_ok=True)
    done = manywake(words[0], "run", *words[1:], cwd=foreign)
    assert done.returncode == 2
    assert "give it again: --env own_point:make" in " ".join(done.stderr.split())
    assert not marker.exists()
    done = manywake(words[0], "run", *words[1:], "--env", "own_point:make", cwd=foreign)
    assert done.returncode == 0, done.stderr
    assert marker.exists()


def test_another_environment_than_the_runs_is_refused_and_not_imported(foreign):
    (foreign / "marker").unlink(missing_ok=True)
    with pytest.raises(ValueError, match="env: got 'nowhere:make' for .*, which was made with 'own_point:make'"):
        api.load_run(foreign / "run", env="nowhere:make")
    with pytest.raises(ValueError, match="env: got None"):
        api.evaluate(foreign / "run")
    assert not (foreign / "marker").exists()
    assert "own_point" not in sys.modules
