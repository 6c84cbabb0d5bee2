"""Training at full length: it calms the wake, the wake stays calm, and nothing changes a bit of it."""

import dataclasses
import os
import pickle
import subprocess
import sys

import pytest

from manywake import api
from manywake.learn import checkpoints, flows, ppo, tables, train
from manywake.learn.blocks import Layout
from manywake.learn.engine import Processes, Threads
from manywake.learn.flows import Flows
from manywake.learn.ray_engine import Ray
from manywake.learn.rollout import context
from manywake.learn.settings import Collection, Settings
from manywake.suite import load

from ..test_rollout import physics, taken

CHOSEN = load.choose("cylinder-jets")
LEARNING = CHOSEN.learning


def test_default_training_removes_seven_and_a_half_per_cent_of_the_drag_and_holds(tmp_path):
    engine = Processes(2)
    settings = Settings(LEARNING, Collection(), seed=0)
    train.train(tmp_path / "run", flows.open_flows(CHOSEN), settings, engine, Layout(16, 2, 8))
    engine.close()
    opened = api.load_run(tmp_path / "run")
    result = opened.simulation.evaluate(checkpoints.policy(opened.run), Threads(2))
    for control in (result.episode, result.long_run, *result.phases):
        assert 0.075 <= control.drag_reduction <= 0.0805
        assert abs(control.cl_mean) <= 0.15


@pytest.fixture(scope="module")
def three_updates(tmp_path_factory):
    """Return train(name, engine, grid) of three updates at full length."""

    def run(name, engine, grid):
        folder = tmp_path_factory.mktemp("runs") / name
        settings = Settings(dataclasses.replace(LEARNING, episodes=48), Collection(), seed=1)
        try:
            return folder, train.train(folder, flows.open_flows(CHOSEN), settings, engine, grid).policy_sha256
        finally:
            engine.close()

    return run


def columns(folder) -> list[tuple]:
    """The rows of episodes.csv without their times."""
    return tables.untimed(tables.read(folder / "episodes.csv"))


def test_three_updates_are_the_same_for_every_number_of_environments_and_engine(three_updates):
    folder, wanted = three_updates("16", Processes(2), Layout(16, 2, 8))
    for name, engine, grid in (
        ("10", Threads(2), Layout(10, 2, 5)),
        ("5", Processes(2), Layout(5, 2, 3)),
        ("2", Processes(2), Layout(2, 2, 1)),
        ("1", Threads(1), Layout(1, 1, 1)),
        ("ray", Ray(2), Layout(16, 2, 8)),
    ):
        other, found = three_updates(name, engine, grid)
        assert (name, found) == (name, wanted)
        assert columns(other) == columns(folder)


def test_an_older_processor_plays_the_same_episode(tmp_path, shipped):
    """A worker that must do without this machine's instructions gives this machine's bits."""
    script = tmp_path / "play.py"
    script.write_text(
        "import sys, pickle\n"
        "flows, policy, contexts = pickle.load(open(sys.argv[1], 'rb'))\n"
        "pickle.dump(flows.play([policy], contexts), open(sys.argv[2], 'wb'))\n"
    )
    simulation = Flows((shipped,), CHOSEN)
    policy = ppo.snapshot(ppo.build(LEARNING, taken(simulation)))
    contexts = [context(3, index, simulation.horizon, 1) for index in range(3)]
    (tmp_path / "in").write_bytes(pickle.dumps((simulation, policy, contexts)))
    old = {"NUMBA_CPU_NAME": "haswell", "OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": "X86_V4"}
    environment = os.environ | old | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    subprocess.run([sys.executable, script, tmp_path / "in", tmp_path / "out"], check=True, env=environment)
    theirs = pickle.loads((tmp_path / "out").read_bytes())
    ours = simulation.play([policy], contexts)
    assert [physics(episode) for episode in ours] == [physics(episode) for episode in theirs]
