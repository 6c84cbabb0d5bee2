"""Every experiment in miniature: its tables, its picture, and the picture again from the tables alone."""

import json
import subprocess
import sys
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from experiments import __main__ as commands
from experiments import controlled_wake, experiment, learning_curves, overparallel, synced, trainings
from experiments.__main__ import BY_PROTOCOL, FIGURES, Figure, train_all
from manywake.cli import main
from manywake.flow import spinup
from manywake.flow.baseline import Baseline
from manywake.flow.stability import Withstood
from manywake.flow.statistics import Statistics
from manywake.flow.store import Flow
from manywake.learn import blocks, flows, tables, train
from manywake.learn.engine import Threads
from manywake.suite.cylinder_jets import REWARDS

from .conftest import TINY, tiny_mesh

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


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    """One miniature for all, so that experiments share their trainings as they do at full size."""
    folder = tmp_path_factory.mktemp("miniature")
    return experiment.Setup(folder / "runs", folder / "results", folder / "pictures", miniature=True)


@pytest.mark.parametrize("name", TABLES)
def test_an_experiment_leaves_its_tables_and_its_figure_is_drawn_from_them_alone(setup, tmp_path, name):
    module = FIGURES[name]
    module.run(setup)
    for table, columns in TABLES[name].items():
        assert columns <= set(experiment.read(setup.csv(table)))
    module.plot(setup)
    assert set(module.summary(setup))
    elsewhere = replace(setup, runs=tmp_path / "none", figures=tmp_path)
    module.plot(elsewhere)
    assert elsewhere.png(name).read_bytes() == setup.png(name).read_bytes()
    assert {"Claim:", "Command:", "Cost:"} <= set((module.__doc__ or "").split())


def test_there_is_an_experiment_for_every_name():
    assert set(TABLES) == set(FIGURES)


def test_a_training_that_is_done_is_kept_and_one_that_was_stopped_goes_on_to_the_same_rows(setup, monkeypatch):
    chosen = trainings.by_protocol(setup, "kept", "whole", 7, 400)
    setup = replace(setup, miniature=False)  # side by side, in processes
    whole, stopped = chosen, replace(chosen, name="stopped")
    beside = replace(chosen, name="beside", settings=replace(chosen.settings, seed=8))
    trainings.train_all(setup, [whole])
    whole = whole.run(setup)
    before = (whole.folder / "episodes.csv").read_bytes()

    class Stop(Exception):
        pass

    def stop(episodes, shares, failures):
        if episodes[0].index >= 4:
            raise Stop

    run, simulation = stopped.run(setup), flows.open_flows(stopped.chosen)
    with closing(Threads(1)) as engine, pytest.raises(Stop):
        train.train(run.folder, simulation, stopped.settings, engine, blocks.Layout(4, 1, 4), stop)
    assert len(tables.read(run.folder / "updates.csv")) == 1
    trainings.train_all(setup, [stopped, beside])
    assert len(tables.read(beside.run(setup).folder / "episodes.csv")) == 12
    rows = [learning_curves._episodes("", each, 3) for each in (whole, run)]
    without = [[{k: v for k, v in row.items() if k != "clock_s"} for row in table] for table in rows]
    assert without[0] == without[1]

    def fail(*arguments):
        raise AssertionError("trained again")

    monkeypatch.setattr(trainings, "_train_on", fail)
    trainings.train_all(setup, [chosen])
    assert (whole.folder / "episodes.csv").read_bytes() == before
    changes = dict(chosen.changes)
    learning = replace(chosen.settings.learning, gamma=0.9)
    others = [
        replace(chosen, protocol="default"),
        replace(chosen, case="cylinder-jets"),
        *(replace(chosen, changes=tuple((changes | more).items())) for more in ({"actions": 3}, {"limit": 0.02})),
        replace(chosen, settings=replace(chosen.settings, learning=learning)),
    ]
    for other in others:
        with pytest.raises(ValueError, match="made with other settings; .* --fresh"):
            trainings.train_all(setup, [other])


def test_all_trainings_of_all_experiments_are_made_in_one_go_and_each_once(setup):
    scripts = list(FIGURES.values())
    train_all(setup, scripts)
    sets = [series for each in scripts if hasattr(each, "wanted") for series in each.wanted(setup).values()]
    wanted = {training for series in sets for training in series}
    assert len(wanted) < sum(map(len, sets))  # they share some
    assert all((training.run(setup).folder / "training.json").exists() for training in wanted)


def test_the_proof_names_the_longest_training_of_each_n(setup):
    synced.run(setup)
    found = synced.summary(setup)["episodes_compared"]
    assert found == {"1": 12, "2": 12, "4": 12}


def test_a_rerun_that_differs_in_one_digit_fails_loudly(setup, tmp_path):
    other = replace(setup, runs=tmp_path / "runs", results=tmp_path)
    synced.run(other)
    table = other.runs / "synced" / "2-s0" / "episodes.csv"
    rows = tables.read(table)
    rows[3]["reward"] = rows[3]["reward"][:-1] + str((int(rows[3]["reward"][-1]) + 1) % 10)
    table.unlink()
    tables.append(table, rows)
    with pytest.raises(RuntimeError, match=r"seed 0 with \[2\] environments differs"):
        synced.run(other)


def test_harm_is_a_difference_whose_interval_leaves_nought_out():
    drag = {"synced 20": [3.00, 3.01, 3.02], "same": [3.00, 3.02, 3.03], "worse": [3.10, 3.11, 3.12]}
    found = overparallel.harm(drag)
    assert found["same"]["low"] < 0.0 < found["same"]["high"] and 0.0 < found["worse"]["low"]
    assert found["worse"]["p"] < 0.01 < found["same"]["p"]
    # by hand: both have the standard deviation 0.01, so the difference 0.1 has the error 0.01 sqrt(2 / 3), and t(4)
    # leaves 2.5 % above 2.7764
    assert found["worse"]["difference"] == pytest.approx(0.1)
    assert found["worse"]["high"] == pytest.approx(0.1 + 2.7764 * 0.01 * np.sqrt(2 / 3), rel=1e-4)
    assert found["same"] == pytest.approx(
        overparallel.harm({"same": drag["same"], "synced 20": drag["synced 20"]})["same"]
    )


def test_a_policy_that_is_no_better_than_no_control_is_named_by_its_seed():
    final = {"series": ["a", "a", "b"], "seed": [0.0, 1.0, 0.0], "c_d": [2.95, 3.5, 3.0]}
    assert overparallel.failed({name: np.array(column) for name, column in final.items()}) == {"a": [1]}


def test_a_speed_up_is_that_of_the_model_and_never_more_than_there_are_environments(setup):
    full = replace(setup, miniature=False)
    assert overparallel.speedup(full, 1, False) == pytest.approx(1.0)
    # 300 episodes by 60 environments are five rounds, three updates each, of which the learner's three stand in a row
    assert 55.0 < overparallel.speedup(full, 60, True) < 60.0
    assert overparallel.speedup(full, 60, True, update=5.0) < overparallel.speedup(full, 60, True)


def test_a_spectrum_has_each_line_where_it_is_and_as_high_as_it_is():
    time = TINY.dt * np.arange(40000)
    mine = {"c_l": 2.0 + 0.3 * np.sin(2 * np.pi * 3.0 * time), "jet": 5e-4 * np.cos(2 * np.pi * 6.0 * time)}
    rows = controlled_wake._spectrum(TINY, mine, "mine")
    for name, strouhal, height in (("c_l", 0.3, 0.3), ("jet", 0.6, 0.5)):  # the jet in units of 1e-3
        highest = max(rows, key=lambda row, name=name: row[name])
        assert highest["strouhal"] == pytest.approx(strouhal, abs=0.005)
        assert highest[name] == pytest.approx(height, rel=0.01)


def test_minibatches_are_a_fifth_of_the_batch_whatever_the_episode_is(setup):
    full = replace(setup, miniature=False)
    for actions, batch in ((80, 320), (1322, 5288), (60, 240), (6, 24)):
        made = trainings.by_protocol(full, "", "", 0, 300, actions=actions)
        assert made.settings.learning.batch_size == batch and made.chosen.task.actions == actions
    code = trainings.by_protocol(replace(full, protocol="code"), "", "", 0, 300)
    assert code.chosen.task.reward is REWARDS["code"]


def test_every_training_can_be_asked_for_by_either_protocol(setup):
    for protocol in ("paper", "code"):
        full = replace(setup, miniature=False, protocol=protocol)
        for module in (FIGURES[name] for name in BY_PROTOCOL):
            for group in module.wanted(full).values() if hasattr(module, "wanted") else ():
                assert all(training.protocol == protocol and training.chosen.task for training in group)


def test_the_finer_mesh_has_four_times_the_triangles_and_the_same_flow(tiny):
    start = spinup.kicked(TINY, tiny, 0.3)
    none, zero = Statistics("steady", None, 0.0, {}), np.zeros((len(start.u), 2))
    withstood = Withstood(1.0, 1.0, (), np.zeros((0, 0)))
    base = Baseline("", "", tiny_mesh(), (start,), zero, zero[:, 0], none, {}, withstood, "")
    fine = controlled_wake.finer(Flow(TINY, tiny, base))
    assert len(fine.baseline.mesh.triangles) == 4 * len(tiny_mesh().triangles)
    assert len(fine.operators.mesh.triangles) == 4 * len(tiny_mesh().triangles)
    assert fine.case.dt == fine.operators.time_step == TINY.dt / 2
    assert np.abs(fine.baseline.start.u[:, 1]).max() == pytest.approx(np.abs(start.u[:, 1]).max(), rel=0.1)


def test_the_command_draws_in_miniature_and_says_where_experiments_are_not(tmp_path, monkeypatch):
    done = subprocess.run(
        [sys.executable, "-m", "manywake.cli", "figure", "timescales", "--miniature", "--json"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "runs" / "miniature" / "pictures" / "timescales.png").exists()
    assert json.loads(done.stdout.splitlines()[-1])["timescales"]["steps_to_5_per_cent"] == 29
    with pytest.raises(ValueError, match="timescales does not depend on it"):
        Figure("timescales", protocol="code").run()
    with pytest.raises(ValueError, match="committed: got it with --miniature"):
        Figure("timescales", committed=True, miniature=True).run()
    monkeypatch.setattr(main, "__file__", str(tmp_path / "site-packages" / "manywake" / "cli" / "main.py"))
    with pytest.raises(ValueError, match="experiments are of the source checkout, not of the package"):
        main._hand_over("figure", ["timescales"])


def test_the_checkout_s_tables_and_figures_are_written_when_asked_for_and_never_else(tmp_path, monkeypatch, capsys):
    checkout = tmp_path / "results", tmp_path / "figures"
    monkeypatch.setattr(commands, "COMMITTED", checkout)
    monkeypatch.chdir(tmp_path)
    Figure("timescales", committed=True).run()
    published = {path: path.read_bytes() for folder in checkout for path in folder.iterdir()}
    assert {path.name for path in published} == {"timescales.csv", "timescales.png"}
    for path in checkout[1].iterdir():
        path.write_bytes(b"as committed")
    Figure("timescales", replot=True).run()  # from the checkout's table, as there is no other
    own = tmp_path / "runs" / "figures"
    assert not (own / "results").exists()
    assert (own / "pictures" / "timescales.png").read_bytes() == published[checkout[1] / "timescales.png"]
    Figure("timescales").run()
    assert (own / "results" / "timescales.csv").read_bytes() == published[checkout[0] / "timescales.csv"]
    (checkout[0] / "timescales.csv").unlink()
    Figure("timescales", replot=True).run()  # from its own
    assert (checkout[1] / "timescales.png").read_bytes() == b"as committed" and not list(checkout[0].iterdir())
