"""A training that is killed, stopped or starved goes on to the same bits; what cannot go on says why."""

import _thread
import base64
import dataclasses
import json
import multiprocessing
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest

from manywake import api
from manywake.case.learning import Learning
from manywake.learn import checkpoints, external, flows, milestones, replay, tables, train
from manywake.learn.blocks import Layout
from manywake.learn.engine import Processes, Threads
from manywake.learn.flows import Flows
from manywake.learn.rollout import Simulation
from manywake.learn.runs import Run
from manywake.learn.settings import Collection, Settings
from manywake.learn.train import Trained
from manywake.suite import load

from .external import Trap
from .toy import LEARNING as TOY_LEARNING
from .toy import Toy

pytestmark = pytest.mark.alone

LEARNING = Learning(update_period=4, episodes=16, learner_threads=1, batch_size=8, n_epochs=2, hidden=(8, 8))
LAYOUT = Layout(4, 2, 2)
UNSYNCED = Collection(schedule="unsynced", clock="virtual", envs=6, episode_spread=0.2, update_seconds=1.0)

NEWEST = dataclasses.replace(UNSYNCED, newest_policy="action", episode_seconds=2.0)
"""Updates of half an episode's time: they come amid episodes."""


def settings(collection=Collection(), seed=5, learning=LEARNING) -> Settings:  # noqa: B008
    return Settings(learning, collection, seed)


def short() -> Flows:
    """The default case with two actions an episode."""
    return flows.open_flows(load.choose("cylinder-jets", actions=2))


def point(name="tests.external:make", actions=4) -> Simulation:
    """An environment that is not ours."""
    return external.open_simulation(name, actions, os.getcwd())


def resume(folder, engine, grid, show=train.quiet, env=None) -> Trained:
    """Go on with a run as its folder has it."""
    return train.resume(folder, api.load_run(folder, env=env).simulation, engine, grid, show)


def replayed(folder, index, env=None) -> replay.Replay:
    """Play an episode of a run again, as its folder has it."""
    opened = api.load_run(folder, env=env)
    return replay.replay(opened.run, opened.simulation, index)


def played(folder) -> list[tuple]:
    """The rows of episodes.csv without their times."""
    return tables.untimed(tables.read(folder / "episodes.csv"))


def final(folder) -> tuple:
    """All that the end of a training is: weights and moments, to the bit, and the episodes."""
    _, _, weights, moments = checkpoints.newest(Run(folder))
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
    for name, collection, grid in kinds:
        made[name] = tmp_path_factory.mktemp("runs") / name
        train.train(made[name], short(), settings(collection), Threads(2), grid)
    return made


class Stop(Exception):
    pass


def stopped_after(folder, updates, collection=Collection(), grid=LAYOUT, simulation=None, learning=LEARNING):  # noqa: B008
    """Train, and stop amid the collection that follows a number of updates."""
    seen = []

    def show(episodes, shares, failures):
        seen.extend(episodes)
        if len(tables.read(folder / "updates.csv")) >= updates:
            raise Stop

    with pytest.raises(Stop):
        train.train(folder, simulation or short(), settings(collection, learning=learning), Threads(1), grid, show)


def test_training_stops_when_patience_is_out_and_not_before(tmp_path):
    folder, asked = tmp_path / "run", settings(learning=dataclasses.replace(LEARNING, episodes=64, patience=2))
    trained = train.train(folder, short(), asked, Threads(1), LAYOUT)
    rewards = [float(row["reward"]) for row in tables.read(folder / "episodes.csv")]
    means = [sum(rewards[k : k + 4]) / 4 for k in range(0, len(rewards), 4)]
    waited = [update - max(range(update + 1), key=means.__getitem__) for update in range(len(means))]
    assert trained.episodes == len(rewards) < 64
    assert waited[-1] == 2 and max(waited[:-1]) < 2
    assert resume(folder, Threads(1), LAYOUT).policy_sha256 == trained.policy_sha256


@pytest.mark.parametrize("updates", [0, 1, 3])
def test_a_synced_training_goes_on_to_the_same_bits(tmp_path, whole, updates):
    stopped_after(tmp_path / "run", updates)
    resume(tmp_path / "run", Threads(2), Layout(4, 1, 4))
    assert final(tmp_path / "run") == final(whole["synced"])


@pytest.mark.parametrize("updates", [0, 2])
@pytest.mark.parametrize(("kind", "how"), [("unsynced", UNSYNCED), ("newest", NEWEST)])
def test_an_unsynced_training_on_the_virtual_clock_goes_on_with_what_was_on_its_way(
    tmp_path, whole, updates, kind, how
):
    ages = {float(row["staleness"]) for row in tables.read(whole[kind] / "episodes.csv")}
    assert max(ages) > 0.0 and any(age % 1 for age in ages) == (kind == "newest")
    stopped_after(tmp_path / "run", updates, how, Layout(6, 1, 3))
    resume(tmp_path / "run", Threads(2), Layout(6, 2, 3))
    assert final(tmp_path / "run") == final(whole[kind])


def test_an_episode_of_several_policies_is_replayed_to_the_bit(whole):
    mixed = [row for row in tables.read(whole["newest"] / "episodes.csv") if float(row["staleness"]) % 1]
    assert mixed
    assert all(replayed(whole["newest"], int(row["episode"])).same for row in mixed)


def test_an_unsynced_training_on_the_real_clock_goes_on_without_losing_an_episode(tmp_path):
    stopped_after(tmp_path / "run", 2, Collection(schedule="unsynced"), Layout(6, 2, 3))
    resume(tmp_path / "run", Threads(2), Layout(6, 2, 3))
    rows = tables.read(tmp_path / "run" / "episodes.csv")
    assert sorted(int(row["episode"]) for row in rows) == list(range(16))


def test_resuming_a_training_that_is_done_changes_nothing(whole):
    before = final(whole["synced"])
    resume(whole["synced"], Threads(1), LAYOUT)
    assert final(whole["synced"]) == before


def test_kill_9_of_the_trainer_then_resume_gives_the_same_bits(tmp_path, whole):
    folder = tmp_path / "run"
    words = [
        *("--seed", "5", "--update-period", "4", "--episodes", "16", "--batch-size", "8", "--n-epochs", "2"),
        *("--hidden", "8", "8", "--actions", "2", "--workers", "2", "--lanes", "2", "--envs", "4"),
    ]
    command = [sys.executable, "-m", "manywake.cli", "train", "--run", str(folder), *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as trainer:
        try:
            while len(tables.read(folder / "updates.csv")) < 2 and trainer.poll() is None:
                time.sleep(0.005)
        finally:
            trainer.kill()
    assert len(tables.read(folder / "updates.csv")) < 4, "it was too fast to be killed"
    resume(folder, Threads(2), LAYOUT)
    assert final(folder) == final(whole["synced"])


def test_a_truncated_checkpoint_falls_back_to_the_one_before(tmp_path, whole):
    shutil.copytree(whole["synced"], tmp_path / "run")
    last = tmp_path / "run" / "checkpoints" / "last.zip"
    last.write_bytes(last.read_bytes()[: last.stat().st_size // 2])
    assert checkpoints.newest(Run(tmp_path / "run"))[1].version == 3
    resume(tmp_path / "run", Threads(1), LAYOUT)
    assert final(tmp_path / "run") == final(whole["synced"])


def test_a_killed_trainer_leaves_its_last_row_cut_short_and_resume_drops_it(tmp_path, whole):
    stopped_after(tmp_path / "run", 2)
    with open(tmp_path / "run" / "episodes.csv", "a") as file:
        file.write("8,2,2,0,2,-0.1")
    resume(tmp_path / "run", Threads(1), LAYOUT)
    assert final(tmp_path / "run") == final(whole["synced"])


def test_without_a_whole_checkpoint_resume_says_so(tmp_path, whole):
    shutil.copytree(whole["synced"], tmp_path / "run")
    for path in (tmp_path / "run" / "checkpoints").glob("*.zip"):
        path.write_bytes(b"")
    with pytest.raises(ValueError, match="has no whole checkpoint .*it must be trained anew"):
        resume(tmp_path / "run", Threads(1), LAYOUT)


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
        trained = train.train(tmp_path / "run", short(), settings(), engine, Layout(4, 2, 1), show)
    finally:
        engine.close()
    assert final(tmp_path / "run") == final(whole["synced"])
    rows = tables.read(tmp_path / "run" / "failures.csv")
    assert trained.failures == len(rows) >= 1
    assert all(row["kind"] == "died" for row in rows)


def test_a_fork_server_killed_in_mid_training_changes_no_bit(tmp_path, whole):
    engine = Processes(2)
    victims = {engine.submit(os.getppid).result(60)}

    def show(episodes, shares, failures):
        while victims:
            os.kill(victims.pop(), signal.SIGKILL)

    try:
        trained = train.train(tmp_path / "run", short(), settings(), engine, Layout(4, 2, 1), show)
    finally:
        engine.close()
    assert final(tmp_path / "run") == final(whole["synced"])
    assert trained.failures >= 1


def test_a_training_that_is_stopped_by_hand_counts_no_block_as_lost(tmp_path, whole):
    once = [_thread.interrupt_main]

    def stop(episodes, shares, failures):
        while once:
            once.pop()()  # as Ctrl-C does, while the other worker plays

    engine = Processes(2)
    try:
        with pytest.raises(KeyboardInterrupt):
            train.train(tmp_path / "run", short(), settings(), engine, Layout(4, 2, 1), stop)
    finally:
        engine.close()
    assert not (tmp_path / "run" / "failures.csv").exists()
    assert resume(tmp_path / "run", Threads(1), LAYOUT).failures == 0
    assert final(tmp_path / "run") == final(whole["synced"])


def test_a_full_disk_stops_the_training_and_says_how_to_go_on(tmp_path, whole):
    folder = tmp_path / "run"
    stopped_after(folder, 1)

    def fill(episodes, shares, failures):
        table = folder / "episodes.csv"
        if not table.is_symlink():
            table.rename(folder / "kept")
            table.symlink_to("/dev/full")

    with pytest.raises(RuntimeError, match="cannot write .*No space left.* go on with: manywake resume"):
        resume(folder, Threads(1), LAYOUT, fill)
    (folder / "kept").replace(folder / "episodes.csv")
    resume(folder, Threads(1), LAYOUT)
    assert final(folder) == final(whole["synced"])


def test_a_disk_that_is_too_small_is_refused_before_the_first_episode(tmp_path):
    long = Learning(update_period=1, episodes=10**9, learner_threads=1, hidden=(8, 8))
    with pytest.raises(ValueError, match="of free space, wanted"):
        asked = settings(Collection(schedule="unsynced"), learning=long)
        train.train(tmp_path / "run", short(), asked, Threads(1), Layout(1, 1, 1))


def test_more_environments_than_a_synced_update_has_episodes_are_refused(tmp_path):
    with pytest.raises(ValueError, match="envs: got 6, wanted at most the 4 episodes"):
        train.train(tmp_path / "run", short(), settings(), Threads(1), Layout(6, 2, 3))


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
    version = checkpoints.newest(Run(tmp_path / "run"))[1].version
    assert version == (4 if member == "data" else 3)
    assert not (tmp_path / "sprung").exists()


def test_a_table_that_a_full_disk_left_empty_does_not_keep_a_run_from_going_on(tmp_path, whole):
    stopped_after(tmp_path / "run", 1)
    (tmp_path / "run" / "updates.csv").write_text("upd")
    resume(tmp_path / "run", Threads(1), LAYOUT)
    assert final(tmp_path / "run") == final(whole["synced"])


def test_an_episode_that_always_fails_names_itself_and_how_to_replay_it(tmp_path):
    broken = point("tests.external:broken", 2)
    with pytest.raises(RuntimeError, match=r"seed 5 failed 3 times.*out of order; play it alone with: manywake replay"):
        train.train(tmp_path / "run", broken, settings(), Threads(1), LAYOUT)
    failures = tables.read(tmp_path / "run" / "failures.csv")
    assert [row["attempt"] for row in failures][-1] == "3"
    with pytest.raises(ArithmeticError, match="out of order"):
        replayed(tmp_path / "run", int(failures[-1]["episodes"]), env="tests.external:broken")


def test_any_gymnasium_environment_is_trained_resumed_and_replayed_alike(tmp_path):
    name, engine = "tests.external:make", Processes(2)
    try:
        trained = train.train(tmp_path / "a", point(name), settings(), engine, LAYOUT)
    finally:
        engine.close()
    again = train.train(tmp_path / "b", point(name), settings(), Threads(1), Layout(1, 1, 1))
    assert again.policy_sha256 == trained.policy_sha256
    assert played(tmp_path / "a") == played(tmp_path / "b")
    assert replayed(tmp_path / "a", 7, env=name).same is True
    assert {"info_distance", "length", "reward"} <= set(tables.read(tmp_path / "a" / "episodes.csv")[0])
    stopped_after(tmp_path / "c", 2, simulation=point(name))
    resume(tmp_path / "c", Threads(2), LAYOUT, env=name)
    assert final(tmp_path / "c") == final(tmp_path / "a")


def test_a_gymnasium_environment_is_evaluated_by_its_rewards(tmp_path):
    train.train(tmp_path / "run", point(), settings(), Threads(1), LAYOUT)
    opened = api.load_run(tmp_path / "run", env="tests.external:make")
    found, again = api.evaluate(opened), api.evaluate(opened, workers=1)
    assert found.summary() == again.summary()
    rewards = found.summary()["rewards"]
    assert len(set(rewards)) == external.EVALUATED  # each from a start of its own
    assert found.summary()["reward_mean"] == pytest.approx(sum(rewards) / external.EVALUATED)
    assert found.table()[0] == ("policy without noise", "16 episodes")


def test_a_registered_environment_is_found_by_its_id(tmp_path):
    train.train(tmp_path / "run", point("Pendulum-v1"), settings(), Threads(1), LAYOUT)
    assert tables.read(tmp_path / "run" / "episodes.csv")[0]["length"] == "200"  # its own limit


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
        api.train(env=name, learning=LEARNING, run=tmp_path / "run")
    assert not (tmp_path / "run").exists()


# ---- a third kind of simulation, which nothing of manywake has heard of

THIRD = Toy(horizon=6, variants=3)


def test_a_simulation_of_another_kind_is_trained_and_resumed_to_the_same_bits(tmp_path):
    engine = Processes(2)
    try:
        trained = train.train(tmp_path / "whole", THIRD, settings(), engine, LAYOUT)
    finally:
        engine.close()
    serial = train.train(tmp_path / "serial", THIRD, settings(), Threads(1), Layout(1, 1, 1))
    assert serial.policy_sha256 == trained.policy_sha256
    assert final(tmp_path / "serial") == final(tmp_path / "whole")
    stopped_after(tmp_path / "stopped", 2, simulation=THIRD)
    about = Run(tmp_path / "stopped").simulation
    assert about.pop("kind") == "toy"
    train.resume(tmp_path / "stopped", Toy(**{**about, "faults": ()}), Threads(2), Layout(4, 1, 4))
    assert final(tmp_path / "stopped") == final(tmp_path / "whole")
    assert json.loads((tmp_path / "whole" / "toy.json").read_text())["variants"] == 3
    assert Run(tmp_path / "whole").described()["kept"] == {"drift": "0.1"}


@pytest.mark.parametrize("collection", [UNSYNCED, NEWEST])
def test_a_simulation_of_another_kind_goes_on_with_what_was_on_its_way(tmp_path, collection):
    learning = dataclasses.replace(LEARNING, episodes=24)  # some of them begin after two updates only
    train.train(tmp_path / "whole", THIRD, settings(collection, learning=learning), Threads(2), Layout(6, 2, 3))
    stopped_after(tmp_path / "stopped", 2, collection, Layout(6, 1, 3), THIRD, learning)
    assert checkpoints.newest(Run(tmp_path / "stopped"))[1].pending
    train.resume(tmp_path / "stopped", THIRD, Threads(2), Layout(6, 2, 2))
    assert final(tmp_path / "stopped") == final(tmp_path / "whole")


@pytest.mark.parametrize("collection", [Collection(), UNSYNCED, NEWEST, Collection(schedule="unsynced")])
def test_every_episode_of_a_simulation_of_another_kind_is_replayed_to_the_bit(tmp_path, collection):
    train.train(tmp_path / "run", THIRD, settings(collection), Threads(2), Layout(4, 2, 2))
    run = Run(tmp_path / "run")
    for row in tables.read(run.folder / "episodes.csv"):
        again = replay.replay(run, THIRD, int(row["episode"]))
        assert again.same is True
        assert str(again.numbers["x"]) == row["x"]


def test_a_simulation_of_another_kind_is_evaluated(tmp_path):
    toy = Toy(variants=2)
    train.train(tmp_path / "run", toy, settings(seed=2, learning=TOY_LEARNING), Threads(1), LAYOUT)
    opened = api.OpenRun(Run(tmp_path / "run"), toy)
    found, again = api.evaluate(opened), api.evaluate(opened, workers=1)
    assert found.summary() == again.summary()
    first = toy.evaluate(opened.run.version(0), Threads(1))
    assert found.summary()["x"] < 0.5 * first.summary()["x"]
    gained = milestones.gains(opened.run, toy, Threads(1))
    np.testing.assert_array_equal(gained, milestones.gains(opened.run, toy, Threads(2)))
    updates = TOY_LEARNING.episodes // TOY_LEARNING.update_period
    assert len(gained) == updates + 1 and gained[-1] > max(gained[0], 0.05)
    episodes, seconds = milestones.held(opened.run, gained)["0.05"]
    assert 0 < episodes <= TOY_LEARNING.episodes and episodes % TOY_LEARNING.update_period == 0 and seconds > 0
    found.draw(opened.folder, "-x")
    assert (opened.folder / "distances-x.txt").exists()


def test_a_gain_is_held_from_the_version_on_after_which_none_falls_short(tmp_path):
    rows = [{"update": k, "episodes": 4 * (k + 1), "wall_s": 10.0 * (k + 1)} for k in range(4)]
    tables.append(tmp_path / "updates.csv", rows)
    gained = np.array([0.0, 0.08, 0.06, 0.074, 0.09])
    assert milestones.held(Run(tmp_path), gained) == {"0.05": (4, 10.0), "0.07": (12, 30.0), "0.075": (16, 40.0)}
    gained[-1] = np.nan  # it blew up
    assert set(milestones.held(Run(tmp_path), gained).values()) == {None}


def test_a_simulation_of_another_kind_goes_on_by_the_api_too(tmp_path):
    how = Collection(engine="serial", envs=4, workers=2, lanes=2)
    trained = api.train_into(tmp_path / "whole", THIRD, settings(how))
    stopped_after(tmp_path / "run", 1, how, simulation=THIRD)
    opened = api.OpenRun(Run(tmp_path / "run"), THIRD)
    assert api.resume(opened, engine="threads", workers=1).policy_sha256 == trained.policy_sha256
