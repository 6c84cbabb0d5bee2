"""A run folder holds what a run is, refuses what would spoil it, and gives the policy back."""

import json

import numpy as np
import pytest
from filelock import FileLock
from stable_baselines3 import PPO

from manywake.env.task import Task
from manywake.flow import baseline, case
from manywake.learn import policy as policies
from manywake.learn import ppo, runs, train
from manywake.learn.collect import Layout
from manywake.learn.engine import Threads
from manywake.learn.settings import PROTOCOLS, Collection, Learning, Settings

SETTINGS = Settings(
    case.by_name("cylinder-jets"),
    Task(actions_per_episode=2),
    Learning(update_period=2, episodes=4, learner_threads=1, batch_size=4, hidden=(8,)),
    Collection(engine="serial"),
    seed=3,
)
LAYOUT = Layout(2, 1, 2)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "a"
    trained = train.train(folder, SETTINGS, Threads(1), LAYOUT)
    return folder, trained


def test_settings_come_back_as_they_went(run):
    assert runs.Run(run[0]).settings == SETTINGS


def test_every_episode_has_its_row(run):
    table = runs.read_episodes(run[0])
    np.testing.assert_array_equal(table["episode"], [0, 1, 2, 3])
    np.testing.assert_array_equal(table["version"], [0, 0, 1, 1])
    np.testing.assert_array_equal(table["update"], [0, 0, 1, 1])
    assert np.isfinite(table["c_d"]).all()
    assert (table["length"] == 2).all()


def test_the_folder_keeps_the_baseline_and_tensorboard_events(run):
    assert baseline.load(run[0] / "baseline.npz").digest() == baseline.get(SETTINGS.case).digest()
    assert list((run[0] / "tensorboard").glob("events*"))


@pytest.mark.parametrize("checkpoint", ["last", "best"])
def test_a_checkpoint_is_a_plain_zip_and_its_tensors_are_enough(run, checkpoint):
    policy = runs.Run(run[0]).policy(checkpoint)
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
        train.train(run[0], SETTINGS, Threads(1), LAYOUT)


def test_a_folder_in_use_is_refused(tmp_path):
    with FileLock(tmp_path / ".lock"), pytest.raises(ValueError, match="being written by another training"):
        train.train(tmp_path, SETTINGS, Threads(1), LAYOUT)


def test_a_folder_that_cannot_be_written_is_refused_before_the_first_episode(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="cannot write"):
        train.train(tmp_path / "file" / "run", SETTINGS, Threads(1), LAYOUT)


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(ValueError, match="has no settings.json"):
        _ = runs.Run(tmp_path).settings


def test_an_unknown_checkpoint_is_refused_with_those_there_are(run):
    with pytest.raises(ValueError, match=r"wanted one of \['best', 'last', 'previous'\]"):
        runs.Run(run[0]).policy("first")


def test_episodes_must_be_a_multiple_of_the_update_period():
    with pytest.raises(ValueError, match="got 30, wanted a multiple of the update period 20"):
        Learning(update_period=20, episodes=30)


def test_the_papers_protocol_is_there_by_name():
    task, learning = PROTOCOLS["paper"]
    assert (task.actions_per_episode, task.reward, task.control, task.alpha) == (80, "paper", "exponential", 0.1)
    assert (learning.update_period, learning.learning_rate, learning.hidden) == (20, 1e-3, (512, 512))


def test_settings_file_is_plain_json(run):
    data = json.loads((run[0] / "settings.json").read_text())
    assert data["seed"] == 3
    assert data["versions"]["manywake"]


def test_the_folder_keeps_the_operators_its_episodes_were_played_with(run):
    simulation = runs.Run(run[0]).simulation()
    assert simulation.operators.digest == json.loads((run[0] / "settings.json").read_text())["operators"]


def test_every_version_is_kept(run):
    kept = [runs.Run(run[0]).version(number) for number in range(3)]
    last = runs.Run(run[0]).policy()
    np.testing.assert_array_equal(kept[2].layers[0][0], last.layers[0][0])
    with pytest.raises(ValueError, match="version: got 3, wanted one of those in"):
        runs.Run(run[0]).version(3)


@pytest.mark.parametrize("index", [0, 3])
def test_an_episode_replayed_alone_has_the_numbers_it_had(run, index):
    replayed = train.replay(runs.Run(run[0]), index)
    assert replayed.same is True
    assert set(replayed.episode.versions) == {index // 2}


def test_an_episode_that_never_was_cannot_be_replayed(run):
    with pytest.raises(ValueError, match="episode: got 4, wanted one of the run's 4"):
        train.replay(runs.Run(run[0]), 4)


def test_updates_have_their_row(run):
    rows = runs.rows(run[0] / "updates.csv")
    assert [row["update"] for row in rows] == ["0", "1"]
    assert all(row["clipped_before"] == "0.0" and float(row["staleness_max"]) == 0.0 for row in rows)
