"""Training at full length: it calms the wake, the wake stays calm, and nothing changes a bit of it."""

import dataclasses
import os
import subprocess
import sys

import pytest

from manywake.flow import case
from manywake.learn import evaluate, runs, train
from manywake.learn.collect import Layout
from manywake.learn.engine import Processes, Threads
from manywake.learn.ray_engine import Ray
from manywake.learn.settings import PROTOCOLS, Collection, Settings

from ..test_rollout import physics

TASK, LEARNING = PROTOCOLS["default"]


def test_default_training_removes_seven_and_a_half_per_cent_of_the_drag_and_holds(tmp_path):
    settings = Settings(case.by_name("cylinder-jets"), TASK, LEARNING, Collection(), seed=0)
    engine = Processes(2)
    train.train(tmp_path / "run", settings, engine, Layout(16, 2, 8))
    engine.close()
    run = runs.Run(tmp_path / "run")
    result = evaluate.evaluate(run.simulation(), run.policy(), Threads(2))
    for control in (result.episode, result.long_run, *result.phases):
        assert 0.075 <= control.drag_reduction <= 0.0805
        assert abs(control.cl_mean) <= 0.15


@pytest.fixture(scope="module")
def three_updates(tmp_path_factory):
    """Return train(name, engine, layout) of three updates at full length."""

    def run(name, engine, layout):
        folder = tmp_path_factory.mktemp("runs") / name
        settings = Settings(
            case.by_name("cylinder-jets"), TASK, dataclasses.replace(LEARNING, episodes=48), Collection(), seed=1
        )
        try:
            return folder, train.train(folder, settings, engine, layout).policy_sha256
        finally:
            engine.close()

    return run


def columns(folder) -> list[tuple]:
    """The rows of episodes.csv without their times."""
    return runs.untimed(runs.rows(folder / "episodes.csv"))


def test_three_updates_are_the_same_for_every_number_of_environments_and_engine(three_updates):
    folder, wanted = three_updates("16", Processes(2), Layout(16, 2, 8))
    for name, engine, layout in (
        ("10", Threads(2), Layout(10, 2, 5)),
        ("5", Processes(2), Layout(5, 2, 3)),
        ("2", Processes(2), Layout(2, 2, 1)),
        ("1", Threads(1), Layout(1, 1, 1)),
        ("ray", Ray(2), Layout(16, 2, 8)),
    ):
        other, found = three_updates(name, engine, layout)
        assert (name, found) == (name, wanted)
        assert columns(other) == columns(folder)


def test_an_older_processor_plays_the_same_episode(tmp_path, shipped):
    """A worker that must do without this machine's instructions gives this machine's bits."""
    script = tmp_path / "play.py"
    script.write_text(
        "import sys, pickle\n"
        "flows, policy, explorations = pickle.load(open(sys.argv[1], 'rb'))\n"
        "pickle.dump(flows.play([policy], explorations), open(sys.argv[2], 'wb'))\n"
    )
    from manywake.learn import ppo
    from manywake.learn.rollout import JetFlows, explore

    from ..test_rollout import taken

    flows = JetFlows(*shipped, TASK)
    policy = ppo.snapshot(ppo.build(LEARNING, taken(flows)))
    explorations = [explore(3, index, flows.horizon, 1) for index in range(3)]
    import pickle

    (tmp_path / "in").write_bytes(pickle.dumps((flows, policy, explorations)))
    old = {"NUMBA_CPU_NAME": "haswell", "OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": "X86_V4"}
    environment = os.environ | old | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    subprocess.run([sys.executable, script, tmp_path / "in", tmp_path / "out"], check=True, env=environment)
    theirs = pickle.loads((tmp_path / "out").read_bytes())
    ours = flows.play([policy], explorations)
    assert [physics(episode) for episode in ours] == [physics(episode) for episode in theirs]
