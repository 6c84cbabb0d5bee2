"""Every experiment in miniature: its tables, its picture, and the picture again from the tables alone."""

import importlib
import shutil
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from manywake import cli
from manywake.env.task import Task
from manywake.flow import baseline
from manywake.flow.baseline import Baseline
from manywake.flow.sensors import Shedding
from manywake.learn import collect, runs, train
from manywake.learn.engine import Threads
from manywake.learn.rollout import JetFlows

from .conftest import TINY, tiny_mesh

FOLDER = Path(__file__).parents[1] / "experiments"
EPISODES = {"series", "seed", "arrived", "update", "staleness", "c_d", "c_l", "reward", "jet_rms"}
UPDATES = {"series", "seed", "update", "staleness_max", "clipped_before", "burst", "learner_s", "wall_s"}
TABLES = {
    "configuration": {"configuration": {"x", "y", "pressure"}},
    "timescales": {"timescales": {"step", "action", "exponential", "linear"}},
    "synced": {
        "synced": EPISODES,
        "synced-updates": UPDATES,
        "synced-final": {"c_d", "c_l"},
        "synced-times": {"environments", "episode_s", "spread", "update_s", "wall_s", "schedule_s"},
        "synced-proof": {"environments", "workers", "lanes", "episodes", "different", "policy", "identical"},
    },
    "overparallel": {"overparallel": EPISODES | {"clock"}, "overparallel-updates": UPDATES},
    "staleness": {"staleness": EPISODES, "staleness-updates": UPDATES, "staleness-final": {"c_d"}},
    "action-period": {"action-period": EPISODES, "action-period-final": {"c_d"}},
    "smoothing": {"smoothing": EPISODES, "smoothing-final": {"c_d"}},
    "cheating": {
        "cheating": {"x", "y", "none", "penalty", "no_penalty"},
        "cheating-numbers": {"series", "c_d", "c_l", "jet"},
    },
    "shares": {"shares": {"environments", "part", "seconds"}, "shares-threads": {"part", "threads", "ms"}},
    "controlled-wake": {
        "controlled-wake": {"series", "time", "c_d", "c_l", "jet", "area"},
        "controlled-wake-spectra": {"series", "strouhal", "c_l", "jet"},
        "controlled-wake-numbers": {"series", "mesh", "c_d", "c_l_rms", "area"},
    },
}


def script(name: str):
    return importlib.import_module(name.replace("-", "_"))


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    """One miniature for all, so that experiments share their trainings as they do at full size."""
    sys.path.insert(0, str(FOLDER))
    folder = tmp_path_factory.mktemp("miniature")
    yield script("experiment").Setup(folder / "runs", folder / "results", folder / "pictures", miniature=True)
    sys.path.remove(str(FOLDER))


@pytest.mark.parametrize("name", TABLES)
def test_an_experiment_leaves_its_tables_and_its_figure_is_drawn_from_them_alone(setup, tmp_path, name):
    module = script(name)
    module.run(setup)
    for table, columns in TABLES[name].items():
        assert columns <= set(script("experiment").read(setup.csv(table)))
    module.plot(setup)
    assert set(module.summary(setup))
    elsewhere = replace(setup, runs=tmp_path / "none", figures=tmp_path)
    module.plot(elsewhere)
    assert elsewhere.png(name).read_bytes() == setup.png(name).read_bytes()
    assert {"Claim:", "Command:", "Cost:"} <= set((module.__doc__ or "").split())


def test_there_is_an_experiment_for_every_name():
    assert set(TABLES) == set(get_args(cli.FigureName))


def test_a_training_that_is_done_is_kept_and_one_that_was_stopped_goes_on_to_the_same_rows(setup, monkeypatch):
    trainings, curves = script("trainings"), script("learning_curves")
    chosen = trainings.settings(setup, 7, 400)
    setup = replace(setup, miniature=False)  # side by side, in processes
    whole, stopped, beside = (
        trainings.Training("kept", name, given)
        for name, given in (("whole", chosen), ("stopped", chosen), ("beside", replace(chosen, seed=8)))
    )
    trainings.train_all(setup, [whole])
    whole = whole.run(setup)
    before = (whole.folder / "episodes.csv").read_bytes()

    class Stop(Exception):
        pass

    def stop(episodes, shares, failures):
        if episodes[0].index >= 4:
            raise Stop

    run = stopped.run(setup)
    with closing(Threads(1)) as engine, pytest.raises(Stop):
        train.train(run.folder, chosen, engine, collect.layout(4, 1, 4, 4), stop)
    assert len(runs.rows(run.folder / "updates.csv")) == 1
    trainings.train_all(setup, [stopped, beside])
    assert len(runs.rows(beside.run(setup).folder / "episodes.csv")) == 12
    rows = [curves._episodes("", each, 3) for each in (whole, run)]
    without = [[{k: v for k, v in row.items() if k != "clock_s"} for row in table] for table in rows]
    assert without[0] == without[1]

    def fail(*arguments):
        raise AssertionError("trained again")

    monkeypatch.setattr(trainings, "_train_on", fail)
    trainings.train_all(setup, [trainings.Training("kept", "whole", chosen)])
    assert (whole.folder / "episodes.csv").read_bytes() == before
    with pytest.raises(ValueError, match="made with other settings; .* --fresh"):
        trainings.train_all(setup, [trainings.Training("kept", "whole", replace(chosen, task=Task()))])


def test_all_trainings_of_all_experiments_are_made_in_one_go_and_each_once(setup):
    scripts = [script(name) for name in TABLES]
    cli._train_all(setup, scripts)
    sets = [series for each in scripts if hasattr(each, "wanted") for series in each.wanted(setup).values()]
    wanted = {training for series in sets for training in series}
    assert len(wanted) < sum(map(len, sets))  # they share some
    assert all((training.run(setup).folder / "training.json").exists() for training in wanted)


def test_the_proof_names_the_longest_training_of_each_n(setup):
    synced = script("synced")
    synced.run(setup)
    found = synced.summary(setup)["episodes_compared"]
    assert found == {"1": 12, "2": 12, "4": 12}


def test_a_rerun_that_differs_in_one_digit_fails_loudly(setup, tmp_path):
    synced = script("synced")
    other = replace(setup, runs=tmp_path / "runs", results=tmp_path)
    synced.run(other)
    table = other.runs / "synced" / "2-s0" / "episodes.csv"
    rows = runs.rows(table)
    rows[3]["reward"] = rows[3]["reward"][:-1] + str((int(rows[3]["reward"][-1]) + 1) % 10)
    table.unlink()
    runs.append(table, rows)
    with pytest.raises(RuntimeError, match=r"seed 0 with \[2\] environments differs"):
        synced.run(other)


def test_harm_is_a_difference_beyond_the_seeds_spread(setup):
    harm = script("overparallel").harm
    drag = {"synced 20": [3.00, 3.01, 3.02], "same": [3.00, 3.02, 3.03], "worse": [3.10, 3.11, 3.12]}
    found = harm(drag)
    assert found["same"]["no_harm"] and not found["worse"]["no_harm"]
    assert found["worse"]["p_of_harm"] < 0.01 < found["same"]["p_of_harm"]


def test_minibatches_are_a_fifth_of_the_batch_whatever_the_episode_is(setup):
    trainings = script("trainings")
    full = replace(setup, miniature=False)
    for actions, batch in ((80, 320), (1322, 5288), (60, 240), (6, 24)):
        assert trainings.settings(full, 0, 300, actions_per_episode=actions).learning.batch_size == batch
    assert trainings.settings(replace(full, protocol="code"), 0, 300).task.reward == "code"


def test_the_finer_mesh_has_four_times_the_triangles_and_the_same_flow(setup, tiny):
    start = baseline.kicked(tiny)
    zero = Shedding(*[0.0] * 8, 0)
    base = Baseline("", tiny_mesh(), start, np.zeros((len(start.u), 2)), zero, 0.0, 0.0, "")
    fine = script("controlled_wake").finer(JetFlows(tiny, base, Task()))
    assert len(fine.baseline.mesh.triangles) == 4 * len(tiny_mesh().triangles)
    assert fine.operators.case.time_step == TINY.time_step / 2
    assert np.abs(fine.baseline.start.u[:, 1]).max() == pytest.approx(np.abs(start.u[:, 1]).max(), rel=0.1)


def test_the_command_draws_in_miniature_and_says_where_experiments_are_not(setup, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.Figure("timescales", miniature=True, json=True).run() == 0
    assert (tmp_path / "runs" / "miniature" / "pictures" / "timescales.png").exists()
    assert '"steps_to_5_per_cent": 29' in capsys.readouterr().out
    with pytest.raises(ValueError, match="timescales does not depend on it"):
        cli.Figure("timescales", protocol="code").run()
    shutil.rmtree(tmp_path / "runs")
    monkeypatch.setattr(cli, "__file__", str(tmp_path / "site-packages" / "manywake" / "cli.py"))
    with pytest.raises(ValueError, match="experiments are of the source checkout, not of the package"):
        cli.Figure("timescales").run()
