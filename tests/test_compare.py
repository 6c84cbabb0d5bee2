"""Runs that differ in the seed alone are one group; groups are compared as the experiments compare theirs."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from manywake.cli.comparing import Compare
from manywake.learn import compare, train
from manywake.learn.blocks import Layout
from manywake.learn.compare import welch
from manywake.learn.engine import Threads
from manywake.learn.settings import Collection, Settings

from .toy import LEARNING, Toy


@pytest.fixture(scope="module")
def toy(tmp_path_factory) -> Path:
    """A run of the toy."""
    folder = tmp_path_factory.mktemp("toy") / "run"
    settings = Settings(LEARNING, Collection(engine="serial"), 0)
    train.train(folder, Toy(), settings, Threads(1), Layout(10, 1, 10))
    return folder


def made(toy: Path, folder: Path, seed: int, saved: float | None = None, drag: bool = True, **learning) -> Path:
    """Copy the run under another seed, with other settings of its learner, as one that saved so much drag."""
    shutil.copytree(toy, folder)
    described = json.loads((folder / "settings.json").read_text())
    described["seed"] = seed
    described["learning"] |= learning
    (folder / "settings.json").write_text(json.dumps(described))
    if saved is not None:
        phase = {"cd_uncontrolled": 3.2, "cd_steady": 2.9, "reward": saved / 2, "diverged": False}
        phases = [phase | {"drag_reduction": saved - 0.01}, phase | {"drag_reduction": saved + 0.01}]
        (folder / "evaluation.json").write_text(json.dumps({"phases": phases}))
    if drag:
        with open(folder / "episodes.csv") as file:
            rows = [row | {"c_d_second_half": row["x"]} for row in csv.DictReader(file)]
        with open(folder / "episodes.csv", "w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
    return folder


FIRST, SECOND = (0.05, 0.06, 0.07), (0.08, 0.10, 0.09)


@pytest.fixture(scope="module")
def two(toy, tmp_path_factory) -> list[Path]:
    """Two groups of three seeds."""
    folder = tmp_path_factory.mktemp("two")
    a = [made(toy, folder / f"a{seed}", seed, saved) for seed, saved in enumerate(FIRST)]
    return a + [made(toy, folder / f"b{seed}", seed, saved, clip_range=0.3) for seed, saved in enumerate(SECOND)]


def test_groups_are_runs_that_differ_in_the_seed_alone(two):
    found = compare.compare([two[3], *two[:3], *two[4:]])
    assert [[result.folder.name for result in group.results] for group in found.groups] == [
        ["b0", "b1", "b2"],
        ["a0", "a1", "a2"],
    ]
    assert [group.name for group in found.groups] == ["toy, clip_range 0.3", "toy, clip_range 0.2"]


def test_where_a_run_was_played_makes_no_other_group(toy, tmp_path):
    folders = [made(toy, tmp_path / str(seed), seed) for seed in range(2)]
    described = json.loads((folders[1] / "settings.json").read_text())
    described["collection"] |= {"engine": "threads", "workers": 2, "time_limit": 9.0}
    described["layout"] = {"environments": 10, "workers": 2, "lanes": 5}
    (folders[1] / "settings.json").write_text(json.dumps(described))
    assert len(compare.compare(folders).groups) == 1
    described["collection"]["schedule"] = "unsynced"
    (folders[1] / "settings.json").write_text(json.dumps(described))
    assert len(compare.compare(folders).groups) == 2


def test_intervals_and_differences_are_those_of_student_and_welch(two):
    found = compare.compare(two)
    mean, error = found.groups[0].interval("saved")
    assert mean == pytest.approx(0.06)
    assert (mean - error, mean + error) == pytest.approx(stats.t.interval(0.95, 2, 0.06, 0.01 / np.sqrt(3)))
    saved, reward = found.differences
    assert (saved.measure, saved.first, saved.second, reward.measure) == ("saved", "A", "B", "reward")
    assert saved.difference == pytest.approx(0.03)
    assert saved.p == pytest.approx(stats.ttest_ind(SECOND, FIRST, equal_var=False).pvalue)
    interval = stats.ttest_ind(SECOND, FIRST, equal_var=False).confidence_interval(0.95)
    assert (saved.low, saved.high) == pytest.approx((interval.low, interval.high))
    assert reward.difference == pytest.approx(0.015)


def test_of_numbers_without_spread_there_is_no_test():
    assert welch([0.1, 0.1], [0.3, 0.3, 0.3]) == (pytest.approx(0.2), pytest.approx(0.2), pytest.approx(0.2), None)
    assert welch([0.1, 0.1], [0.3, 0.4])[3] == pytest.approx(stats.ttest_1samp([0.3, 0.4], 0.1).pvalue)


def test_a_single_seed_has_a_mean_without_an_interval_and_is_not_tested(two):
    found = compare.compare([two[0], *two[3:]])
    assert found.groups[0].interval("saved") == (pytest.approx(0.05), None)
    assert found.differences == []


def test_a_run_that_is_not_evaluated_is_said_to_be_so(toy, two, tmp_path, capsys):
    alone = made(toy, tmp_path / "alone", 3)
    assert Compare((alone, *two), tmp_path / "curves.png", json=True).run() == 0
    shown = capsys.readouterr()
    assert "not evaluated" in shown.out and f"manywake evaluate {alone}" in shown.err.replace("\n", "")
    numbers = json.loads(shown.out.splitlines()[-1])
    assert [run["evaluated"] for run in numbers["runs"]].count(False) == 1
    assert [group["seeds"] for group in numbers["groups"]] == [[3, 0, 1, 2], [0, 1, 2]]
    assert numbers["groups"][0]["saved"]["mean"] == pytest.approx(0.06)
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_a_run_counts_once(toy, two, tmp_path):
    with pytest.raises(ValueError, match="a run twice"):
        compare.compare([two[0], two[0]])
    with pytest.raises(ValueError, match="one training with one seed"):
        compare.compare([two[0], made(toy, tmp_path / "again", 0)])
    with pytest.raises(ValueError, match=r"has no settings\.json"):
        compare.compare([tmp_path])


def test_what_blew_up_is_no_number(toy, tmp_path):
    folder = made(toy, tmp_path / "run", 0, 0.05)
    found = json.loads((folder / "evaluation.json").read_text())
    found["phases"][1] |= {"diverged": True, "drag_reduction": None}
    (folder / "evaluation.json").write_text(json.dumps(found))
    result = compare.compare([folder]).groups[0].results[0]
    assert (result.blew_up, result.saved) == (True, None)
    (folder / "evaluation.json").write_text("{")
    with pytest.raises(ValueError, match="is damaged"):
        compare.compare([folder])


def test_without_drag_the_reward_is_drawn(toy, two, tmp_path, monkeypatch):
    from manywake import plots

    drawn = []
    monkeypatch.setattr(plots, "compare", lambda groups, label, lines, path: drawn.append((groups, label, lines)))
    compare.compare(two).draw(tmp_path / "x.png")
    compare.compare([made(toy, tmp_path / "other", 7, drag=False), *two]).draw(tmp_path / "x.png")
    assert [label for _, label, _ in drawn] == ["$C_D$, 2nd half of episode", "reward of an episode"]
    assert drawn[0][2] == {"uncontrolled, mean": 3.2, "steady flow": 2.9} and drawn[1][2] == {}
    assert [len(curves) for _, curves in drawn[0][0]] == [3, 3]
    np.testing.assert_array_equal(drawn[0][0][0][1][0][0], np.arange(10, 101, 10))
