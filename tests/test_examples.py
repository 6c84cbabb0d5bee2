"""The examples, run for real and short."""

import gc
import json
import math
import os
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from examples.own_solver import environment
from examples.own_solver.environment import SolverLost, Wake
from manywake.case.learning import Learning
from manywake.learn import external, tables, train
from manywake.learn.blocks import Layout
from manywake.learn.engine import Processes, Threads
from manywake.learn.settings import Collection, Settings

from .test_engine import alive, gone

pytestmark = pytest.mark.alone

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "examples" / "own_solver"
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(ROOT)])}

SHORT = {"interval": 0.002, "actions": 3}
"""Two solver steps an action, three actions an episode."""


@pytest.fixture
def wake():
    made = Wake(seconds=20.0)
    yield made
    made.close()


# ---- a solver of one's own


def played(wake: Wake, seed: int, actions: int = 10) -> np.ndarray:
    """Return observation, reward and readings of an episode, one row an action."""
    observation, info = wake.reset(seed=seed)
    rows = [[*observation, 0.0, *info.values()]]
    for k in range(actions):
        observation, reward, terminated, truncated, info = wake.step(np.array([math.sin(k)], np.float32))
        assert not terminated and not truncated
        rows.append([*observation, reward, *info.values()])
    return np.array(rows)


def test_gymnasiums_checker_is_content_with_the_wake(wake):
    check_env(wake, skip_render_check=True)


def test_an_episode_of_the_wake_depends_on_its_seed_and_actions_only(wake):
    first = played(wake, 5)
    assert not np.array_equal(played(wake, 6), first)
    np.testing.assert_array_equal(played(wake, 5), first)
    wake.close()
    np.testing.assert_array_equal(played(wake, 5), first)


def test_the_uncontrolled_wake_sheds_with_the_period_of_the_cylinder(wake):
    wake.reset(seed=0)
    rows = [wake.step(np.zeros(1, np.float32))[4] for _ in range(400)]
    lift, drag = (np.array([row[name] for row in rows]) for name in ("c_l", "c_d"))
    np.testing.assert_allclose(drag, environment.CD_UNCONTROLLED, rtol=1e-4)
    upward = np.flatnonzero((lift[:-1] < 0) & (lift[1:] >= 0)) + 1.0
    assert np.diff(upward).mean() * 0.025 == pytest.approx(0.332, rel=0.02)


def test_opposing_the_lift_calms_the_wake(wake):
    _, info = wake.reset(seed=0)
    for _ in range(80):
        info = wake.step(np.array([-2 * info["c_l"]], np.float32))[4]
    assert info["c_d"] < 2.96


def test_no_solver_runs_before_the_first_reset_nor_after_close_or_loss_of_the_environment():
    made = Wake()
    assert made.solver is None
    made.reset(seed=0)
    closed = made.solver.pid
    assert alive(closed)
    made.close()
    assert gone(closed)
    made.reset(seed=0)
    dropped = made.solver.pid
    del made
    gc.collect()
    assert gone(dropped)


def test_a_killed_solver_is_told_and_started_anew_by_reset_with_the_same_bits(wake):
    first = played(wake, 3)
    wake.reset(seed=3)
    killed = wake.solver.pid
    os.kill(killed, signal.SIGKILL)
    with pytest.raises(SolverLost, match=f"solver {killed}: got its end \\(signal 9\\) .*wanted a line; reset"):
        wake.step(np.zeros(1, np.float32))
    with pytest.raises(SolverLost, match="step: got no solver, .*call reset"):
        wake.step(np.zeros(1, np.float32))
    np.testing.assert_array_equal(played(wake, 3), first)


def test_a_solver_that_hangs_is_told_within_the_time_limit_and_ended(wake):
    first = played(wake, 3)
    stopped = wake.solver.pid
    os.kill(stopped, signal.SIGSTOP)
    wake.seconds, begin = 0.5, time.monotonic()
    with pytest.raises(SolverLost, match="got no answer to .* within 0.5 s"):
        wake.step(np.zeros(1, np.float32))
    assert 0.4 < time.monotonic() - begin < 5
    assert gone(stopped)
    wake.seconds = 20.0
    np.testing.assert_array_equal(played(wake, 3), first)


@pytest.mark.parametrize(
    ("program", "message"),
    [
        ("print('hello')", "is no JSON"),
        ("print('{\"c_d\": 3}')", "wanted c_d, c_l, probes"),
        ("print('[]')", "got \\[\\]"),
        ("print('{', end='')", "got its end"),
        ("raise SystemExit(3)", "got its end \\(exit code 3\\)"),
        ("import os, time; os.close(1); time.sleep(60)", "it closed its output"),
    ],
)
def test_a_solver_that_makes_no_sense_is_told(program, message):
    made = Wake((sys.executable, "-c", f"{program}; import sys; sys.stdout.flush(); input()"), seconds=20.0)
    with pytest.raises(SolverLost, match=message):
        made.reset(seed=0)
    assert made.solver is None


def test_a_solver_that_cannot_be_started_is_told():
    with pytest.raises(SolverLost, match="no-such-program.*check the command"):
        Wake(("no-such-program",)).reset(seed=0)


def test_the_solver_tells_of_a_line_that_it_cannot_obey():
    lines = '{"do": "step", "jet": 0}\n{"do": "dance"}\n{"do": "reset", "seed": 1}\n'
    done = subprocess.run(environment.COMMAND, input=lines, capture_output=True, text=True, timeout=30)
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert [set(answer) for answer in answers] == [{"error"}, {"error"}, environment.READINGS]
    assert done.returncode == 0 and done.stderr == ""


def test_no_solver_is_left_when_all_above_it_is_killed():
    script = (
        "import time; from examples.own_solver.environment import make\n"
        "e = make(); e.reset(seed=0); print(e.solver.pid, flush=True); time.sleep(600)"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, env=ENVIRONMENT, text=True)
    with parent, parent.stdout:
        solver = int(parent.stdout.readline())
        assert alive(solver)
        parent.kill()
        assert gone(solver)


# ---- a solver of one's own, under manywake's training

LEARNING = Learning(
    update_period=10,
    episodes=60,
    learning_rate=3e-3,
    batch_size=100,
    log_std_init=-1.0,
    hidden=(32, 32),
    learner_threads=1,
)


def trained(folder: Path, env: str, engine, layout: Layout):
    try:
        simulation = external.open_simulation(env, 40, os.getcwd())
        return train.train(folder, simulation, Settings(LEARNING, Collection(), 0), engine, layout)
    finally:
        engine.close()


FRAGILE = """
import os, signal
from pathlib import Path
from examples.own_solver.environment import Wake

HERE = Path(__file__).parent

class Fragile(Wake):
    steps = 0

    def step(self, action):
        self.steps += 1
        (HERE / f"pid-{self.solver.pid}").touch()
        if self.steps in (130, 210) and not (HERE / f"done-{self.steps}").exists():
            (HERE / f"done-{self.steps}").touch()
            os.kill(self.solver.pid, signal.SIGKILL)
        return super().step(action)
"""
"""An environment whose solver is killed in mid-episode, twice in the training."""


def test_a_training_calms_the_wake_and_solvers_killed_in_mid_episode_change_no_bit_of_it(
    tmp_path, monkeypatch, one_thread
):
    monkeypatch.chdir(ROOT)
    calm = trained(tmp_path / "calm", "examples.own_solver.environment:make", Threads(1), Layout(10, 1, 10))
    rewards = tables.columns(tmp_path / "calm" / "episodes.csv")["reward"].reshape(-1, 10).mean(axis=1)
    assert rewards[0] < -3 and rewards[-1] > 1
    assert calm.failures == 0

    (tmp_path / "fragile.py").write_text(FRAGILE)
    monkeypatch.syspath_prepend(ROOT)
    monkeypatch.chdir(tmp_path)
    hit = trained(tmp_path / "hit", "fragile:Fragile", Processes(2), Layout(10, 2, 5))
    assert hit.failures >= 2
    assert {path.name for path in tmp_path.glob("done-*")} == {"done-130", "done-210"}
    causes = tables.read(tmp_path / "hit" / "failures.csv")
    assert all("got its end (signal 9)" in row["cause"] for row in causes)
    assert hit.policy_sha256 == calm.policy_sha256
    solvers = [int(path.name.removeprefix("pid-")) for path in tmp_path.glob("pid-*")]
    assert len(solvers) >= 4
    assert all(gone(solver) for solver in solvers)


def solvers_under(ancestor: int) -> list[int]:
    """Return the running solvers among the descendants of a process."""
    parents, solvers = {}, []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            state = (entry / "stat").read_text().rpartition(")")[2].split()
            if b"solver.py" in (entry / "cmdline").read_bytes():
                solvers.append(int(entry.name))
        except (FileNotFoundError, ProcessLookupError):
            continue
        parents[int(entry.name)] = int(state[1])

    def under(process: int) -> bool:
        return process in parents and (parents[process] == ancestor or under(parents[process]))

    return [solver for solver in solvers if under(solver)]


def test_the_command_of_the_page_trains_and_leaves_no_solver_when_it_is_killed(tmp_path):
    lines = (ROOT / "docs" / "own-solver.md").read_text().splitlines()
    command = next(line for line in lines if line.startswith("manywake train"))
    words = command.replace("--episodes 200", "--episodes 100000").split()[1:]
    words += ["--workers", "2", "--learner-threads", "1", "--run", str(tmp_path / "run")]
    with open(tmp_path / "log", "w") as log:
        trainer = subprocess.Popen(
            [sys.executable, "-m", "manywake.cli", *words], cwd=FOLDER, env=ENVIRONMENT, stdout=log, stderr=log
        )
    with trainer:
        until, solvers = time.monotonic() + 60, []
        while trainer.poll() is None and time.monotonic() < until:
            time.sleep(0.2)
            if (tmp_path / "run" / "episodes.csv").exists():
                solvers = solvers_under(trainer.pid)
                break
        trainer.kill()
    assert len(solvers) == 2, (tmp_path / "log").read_text()
    assert tables.read(tmp_path / "run" / "episodes.csv")
    assert all(gone(solver) for solver in solvers)


# ---- the native environment under other libraries


@pytest.mark.parametrize(
    ("algorithm", "losses"), [("ppo", ("loss", "value_loss")), ("sac", ("actor_loss", "critic_loss"))]
)
def test_stable_baselines3_takes_steps_with_finite_losses(algorithm, losses, one_thread):
    from examples import train_sb3

    model = train_sb3.train(algorithm, total=24, flows=2, **SHORT)
    assert model.num_timesteps == 24
    assert all(np.isfinite(model.logger.name_to_value[f"train/{name}"]) for name in losses)
    assert all(episode["l"] == 3 for episode in model.ep_info_buffer) and len(model.ep_info_buffer) == 8


def test_skrl_takes_steps_with_finite_losses(one_thread, capsys):
    from examples import train_skrl

    agent = train_skrl.train(total=64, flows=4, **SHORT)
    for name in ("policy", "value"):
        losses = agent.tracking_data[f"Loss / {name.title()} loss"]
        assert len(losses) == 4 and np.isfinite(losses).all()
    assert float(capsys.readouterr().out.split()[-1]) < 0  # the mean reward


@pytest.mark.filterwarnings("ignore")  # of TorchRL's own experiments
@pytest.mark.parametrize("name", ["train_cleanrl", "train_torchrl"])
def test_ppo_in_other_words_takes_steps(name, one_thread, capsys):
    module = import_module(f"examples.{name}")
    assert abs(module.train(episodes=4, flows=2, actions=3, interval=0.002)) < 0.1
    rewards = [float(line.split()[-1]) for line in capsys.readouterr().out.splitlines() if "episodes" in line]
    assert len(rewards) == 2 and np.isfinite(rewards).all()
