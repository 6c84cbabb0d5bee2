"""A training that is killed, stopped or starved goes on to the same bits; what cannot go on says why."""

import base64
import dataclasses
import multiprocessing
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
import zipfile

import pytest

from manywake.env.task import Task
from manywake.flow import case
from manywake.learn import runs, train
from manywake.learn.collect import Layout
from manywake.learn.engine import Processes, Threads
from manywake.learn.settings import Collection, Learning, Settings

LEARNING = Learning(update_period=4, episodes=16, learner_threads=1, batch_size=8, n_epochs=2, hidden=(8, 8))
LAYOUT = Layout(4, 2, 2)
UNSYNCED = Collection(schedule="unsynced", clock="virtual", envs=6, episode_spread=0.2, update_seconds=1.0)

NEWEST = dataclasses.replace(UNSYNCED, newest_policy="action", episode_seconds=2.0)
"""Updates of half an episode's time: they come amid episodes."""


def settings(collection=Collection(), seed=5) -> Settings:  # noqa: B008
    return Settings(case.by_name("cylinder-jets"), Task(actions_per_episode=2), LEARNING, collection, seed)


def played(folder) -> list[tuple]:
    """The rows of episodes.csv without their times."""
    return runs.untimed(runs.rows(folder / "episodes.csv"))


def final(folder) -> tuple:
    """All that the end of a training is: weights and moments, to the bit, and the episodes."""
    _, _, weights, moments = runs.newest(runs.Run(folder))
    tensors = [tensor for state in moments["state"].values() for tensor in state.values()]
    return [t.numpy().tobytes() for t in [*weights.values(), *tensors]], played(folder)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of an undisturbed training, by kind of schedule."""
    made = {}
    kinds = (
        ("synced", Collection(), LAYOUT),
        ("unsynced", UNSYNCED, Layout(6, 2, 3)),
        ("newest", NEWEST, Layout(6, 2, 3)),
    )
    for name, collection, layout in kinds:
        made[name] = tmp_path_factory.mktemp("runs") / name
        train.train(made[name], settings(collection), Threads(2), layout)
    return made


class Stop(Exception):
    pass


def stopped_after(folder, updates, collection=Collection(), layout=LAYOUT):  # noqa: B008
    """Train, and stop amid the collection that follows a number of updates."""
    seen = []

    def show(episodes, shares, failures):
        seen.extend(episodes)
        if len(runs.rows(folder / "updates.csv")) >= updates:
            raise Stop

    with pytest.raises(Stop):
        train.train(folder, settings(collection), Threads(1), layout, show)


def test_training_stops_when_patience_is_out_and_not_before(tmp_path):
    folder, asked = tmp_path / "run", settings()
    asked = dataclasses.replace(asked, learning=dataclasses.replace(LEARNING, episodes=64, patience=2))
    trained = train.train(folder, asked, Threads(1), LAYOUT)
    rewards = [float(row["reward"]) for row in runs.rows(folder / "episodes.csv")]
    means = [sum(rewards[k : k + 4]) / 4 for k in range(0, len(rewards), 4)]
    waited = [update - max(range(update + 1), key=means.__getitem__) for update in range(len(means))]
    assert trained.episodes == len(rewards) < 64
    assert waited[-1] == 2 and max(waited[:-1]) < 2
    assert train.resume(folder, Threads(1), LAYOUT).policy_sha256 == trained.policy_sha256


@pytest.mark.parametrize("updates", [0, 1, 3])
def test_a_synced_training_goes_on_to_the_same_bits(tmp_path, whole, updates):
    stopped_after(tmp_path / "run", updates)
    train.resume(tmp_path / "run", Threads(2), Layout(4, 1, 4))
    assert final(tmp_path / "run") == final(whole["synced"])


@pytest.mark.parametrize("updates", [0, 2])
@pytest.mark.parametrize(("kind", "how"), [("unsynced", UNSYNCED), ("newest", NEWEST)])
def test_an_unsynced_training_on_the_virtual_clock_goes_on_with_what_was_on_its_way(
    tmp_path, whole, updates, kind, how
):
    ages = {float(row["staleness"]) for row in runs.rows(whole[kind] / "episodes.csv")}
    assert max(ages) > 0.0 and any(age % 1 for age in ages) == (kind == "newest")
    stopped_after(tmp_path / "run", updates, how, Layout(6, 1, 3))
    train.resume(tmp_path / "run", Threads(2), Layout(6, 2, 3))
    assert final(tmp_path / "run") == final(whole[kind])


def test_an_episode_of_several_policies_is_replayed_to_the_bit(whole):
    mixed = [row for row in runs.rows(whole["newest"] / "episodes.csv") if float(row["staleness"]) % 1]
    assert mixed
    assert all(train.replay(runs.Run(whole["newest"]), int(row["episode"])).same for row in mixed)


def test_an_unsynced_training_on_the_real_clock_goes_on_without_losing_an_episode(tmp_path):
    stopped_after(tmp_path / "run", 2, Collection(schedule="unsynced"), Layout(6, 2, 3))
    train.resume(tmp_path / "run", Threads(2), Layout(6, 2, 3))
    rows = runs.rows(tmp_path / "run" / "episodes.csv")
    assert sorted(int(row["episode"]) for row in rows) == list(range(16))


def test_resuming_a_training_that_is_done_changes_nothing(whole):
    before = final(whole["synced"])
    train.resume(whole["synced"], Threads(1), LAYOUT)
    assert final(whole["synced"]) == before


def test_kill_9_of_the_trainer_then_resume_gives_the_same_bits(tmp_path, whole):
    folder = tmp_path / "run"
    words = [
        *("--seed", "5", "--update-period", "4", "--episodes", "16", "--batch-size", "8", "--n-epochs", "2"),
        *("--hidden", "8", "8", "--actions-per-episode", "2", "--workers", "2", "--lanes", "2", "--envs", "4"),
    ]
    command = [sys.executable, "-m", "manywake.cli", "train", "--run", str(folder), *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as trainer:
        try:
            while len(runs.rows(folder / "updates.csv")) < 2 and trainer.poll() is None:
                time.sleep(0.005)
        finally:
            trainer.kill()
    assert len(runs.rows(folder / "updates.csv")) < 4, "it was too fast to be killed"
    train.resume(folder, Threads(2), LAYOUT)
    assert final(folder) == final(whole["synced"])


def test_a_truncated_checkpoint_falls_back_to_the_one_before(tmp_path, whole):
    shutil.copytree(whole["synced"], tmp_path / "run")
    last = tmp_path / "run" / "checkpoints" / "last.zip"
    last.write_bytes(last.read_bytes()[: last.stat().st_size // 2])
    assert runs.newest(runs.Run(tmp_path / "run"))[1].version == 3
    train.resume(tmp_path / "run", Threads(1), LAYOUT)
    assert final(tmp_path / "run") == final(whole["synced"])


def test_a_killed_trainer_leaves_its_last_row_cut_short_and_resume_drops_it(tmp_path, whole):
    stopped_after(tmp_path / "run", 2)
    with open(tmp_path / "run" / "episodes.csv", "a") as file:
        file.write("8,2,2,0,2,-0.1")
    train.resume(tmp_path / "run", Threads(1), LAYOUT)
    assert final(tmp_path / "run") == final(whole["synced"])


def test_without_a_whole_checkpoint_resume_says_so(tmp_path, whole):
    shutil.copytree(whole["synced"], tmp_path / "run")
    for path in (tmp_path / "run" / "checkpoints").glob("*.zip"):
        path.write_bytes(b"")
    with pytest.raises(ValueError, match="has no whole checkpoint .*it must be trained anew"):
        train.resume(tmp_path / "run", Threads(1), LAYOUT)


def test_a_worker_killed_in_mid_training_changes_no_bit(tmp_path, whole):
    engine = Processes(2)
    engine.submit(os.getpid).result(60)
    victims = {child.pid for child in multiprocessing.active_children()}

    def show(episodes, shares, failures):
        # one block has come, another is played, two wait: all workers go
        while victims:
            os.kill(victims.pop(), signal.SIGKILL)

    try:
        assert len(victims) >= 2
        trained = train.train(tmp_path / "run", settings(), engine, Layout(4, 2, 1), show)
    finally:
        engine.close()
    assert final(tmp_path / "run") == final(whole["synced"])
    rows = runs.rows(tmp_path / "run" / "failures.csv")
    assert trained.failures == len(rows) >= 1
    assert all(row["kind"] == "died" for row in rows)


def test_a_full_disk_stops_the_training_and_says_how_to_go_on(tmp_path, whole):
    folder = tmp_path / "run"
    stopped_after(folder, 1)

    def fill(episodes, shares, failures):
        table = folder / "episodes.csv"
        if not table.is_symlink():
            table.rename(folder / "kept")
            table.symlink_to("/dev/full")

    with pytest.raises(RuntimeError, match="cannot write .*No space left.* go on with: manywake resume"):
        train.resume(folder, Threads(1), LAYOUT, fill)
    (folder / "kept").replace(folder / "episodes.csv")
    train.resume(folder, Threads(1), LAYOUT)
    assert final(folder) == final(whole["synced"])


def test_a_disk_that_is_too_small_is_refused_before_the_first_episode(tmp_path):
    long = Learning(update_period=1, episodes=10**9, learner_threads=1, hidden=(8, 8))
    with pytest.raises(ValueError, match="of free space, wanted"):
        train.train(
            tmp_path / "run",
            dataclasses.replace(settings(Collection(schedule="unsynced")), learning=long),
            Threads(1),
            Layout(1, 1, 1),
        )


def test_more_environments_than_a_synced_update_has_episodes_are_refused(tmp_path):
    with pytest.raises(ValueError, match="envs: got 6, wanted at most the 4 episodes"):
        train.train(tmp_path / "run", settings(), Threads(1), Layout(6, 2, 3))


class Trap:
    """Unpickled, it writes a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("member", ["data", "policy.pth"])
def test_code_in_a_checkpoint_is_never_run(tmp_path, whole, member):
    shutil.copytree(whole["synced"], tmp_path / "run")
    with zipfile.ZipFile(tmp_path / "run" / "checkpoints" / "last.zip") as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    trap = pickle.dumps(Trap(tmp_path / "sprung"), protocol=2)
    content[member] = (
        trap if member.endswith("pth") else b'{"policy": {":serialized:": "' + base64.b64encode(trap) + b'"}}'
    )
    with zipfile.ZipFile(tmp_path / "run" / "checkpoints" / "last.zip", "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    version = runs.newest(runs.Run(tmp_path / "run"))[1].version
    assert version == (4 if member == "data" else 3)
    assert not (tmp_path / "sprung").exists()


def test_a_table_that_a_full_disk_left_empty_does_not_keep_a_run_from_going_on(tmp_path, whole):
    stopped_after(tmp_path / "run", 1)
    (tmp_path / "run" / "updates.csv").write_text("upd")
    train.resume(tmp_path / "run", Threads(1), LAYOUT)
    assert final(tmp_path / "run") == final(whole["synced"])


def test_an_episode_that_always_fails_names_itself_and_how_to_replay_it(tmp_path):
    broken = dataclasses.replace(settings(), env="tests.external:broken")
    with pytest.raises(RuntimeError, match=r"seed 5 failed 3 times.*out of order; play it alone with: manywake replay"):
        train.train(tmp_path / "run", broken, Threads(1), LAYOUT)
    failures = runs.rows(tmp_path / "run" / "failures.csv")
    assert [row["attempt"] for row in failures][-1] == "3"
    with pytest.raises(ArithmeticError, match="out of order"):
        train.replay(runs.Run(tmp_path / "run"), int(failures[-1]["episodes"]))


def test_any_gymnasium_environment_is_trained_resumed_and_replayed_alike(tmp_path):
    own = dataclasses.replace(settings(), env="tests.external:make", task=Task(actions_per_episode=4))
    engine = Processes(2)
    try:
        trained = train.train(tmp_path / "a", own, engine, LAYOUT)
    finally:
        engine.close()
    assert train.train(tmp_path / "b", own, Threads(1), Layout(1, 1, 1)).policy_sha256 == trained.policy_sha256
    assert played(tmp_path / "a") == played(tmp_path / "b")
    assert train.replay(runs.Run(tmp_path / "a"), 7).same is True
    assert {"info_distance", "length", "reward"} <= set(runs.rows(tmp_path / "a" / "episodes.csv")[0])


def test_a_registered_environment_is_found_by_its_id(tmp_path):
    registered = dataclasses.replace(settings(), env="Pendulum-v1", task=Task(actions_per_episode=4))
    train.train(tmp_path / "run", registered, Threads(1), LAYOUT)
    assert runs.rows(tmp_path / "run" / "episodes.csv")[0]["length"] == "200"  # its own limit


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere:make", "the module 'nowhere' cannot be loaded"),
        ("tests.external:nothing", "wanted module:factory or an id registered"),
        ("CartPole-v1", "got the action space Discrete"),
        ("NoSuch-v3", "wanted module:factory or an id registered"),
    ],
)
def test_an_environment_that_cannot_be_collected_is_refused(tmp_path, name, message):
    with pytest.raises(ValueError, match=message):
        train.train(tmp_path / "run", dataclasses.replace(settings(), env=name), Threads(1), LAYOUT)
